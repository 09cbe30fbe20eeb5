"""Texts of instruments that are no header above rows, rewritten as one."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from fmuid.data.cells import is_number
from fmuid.data.readers.block_texts import BLOCKS
from fmuid.data.readers.keyed_lines import KEYED
from fmuid.data.readers.row_checks import check_count
from fmuid.errors import InputError

_TABLE = re.compile(r"(?:double|float)\s+(?P<name>[\w.]+)\s*\(\s*(?P<rows>\d+)\s*,\s*(?P<columns>\d+)\s*\)(?P<rest>.*)")


def _one_channel(lines: Sequence[str], _source: str) -> Iterator[str]:
    """Yield Tektronix TDS: settings in the first two columns, times and samples in the next."""
    rows = [row for row in csv.reader(lines) if any(cell.strip() for cell in row)]
    said = {row[0].strip().lower(): row[1].strip() for row in rows if row[0].strip()}
    yield f"time [{said.get('horizontal units') or 's'}],{said.get('source', 'CH1')} [{said.get('vertical units', '')}]"
    yield from (",".join(row[3:5]) for row in rows)


@dataclass(frozen=True)
class RewrittenHead:
    """Lines in place of the first `count` of a text; start and step, s, of times that are written as row numbers."""

    lines: Sequence[str]
    count: int
    clock: tuple[float, float] | None = None


def _numbered(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of Rigol: row numbers in place of times, start and increment in the header."""
    names, units = csv.reader(lines[:2])
    place = names.index("Start")
    heads = (f"{name} [{unit}]" for name, unit in zip(names[1:place], units[1:place], strict=True))
    return RewrittenHead([",".join(("time [s]", *heads))], 2, (float(units[place]), float(units[place + 1])))


def _modelica(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a table of Modelica's CombiTimeTable: times first, names perhaps in a comment."""
    found = [(k, head) for k, line in enumerate(lines) if (head := _TABLE.match(line.strip()))]
    if len(found) > 1:
        raise InputError(f"{source}: {len(found)} Modelica tables. Keep one of them in a file.")
    ((place, head),) = found
    comments = [head["rest"], *(line for line in lines[1:place][::-1])]
    names = [comment.strip().lstrip("#").replace(",", " ").split() for comment in comments]
    count = int(head["columns"])
    yield " ".join(
        next((each for each in names if len(each) == count), ["time", *map("c{}".format, range(2, count + 1))])
    )
    rows = [line.partition("#")[0].replace(",", " ").replace(";", " ") for line in lines[place + 1 :]]
    check_count(sum(len(row.split()) for row in rows) // max(count, 1), head["rows"], source)
    yield from rows


def _after_said_lines(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of BioLogic: the second line counts its lines."""
    count = int(lines[1].rpartition(":")[2])
    return RewrittenHead([lines[count - 1]], count)


def _twincat(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of TwinCAT Scope: "Name" is above times in ms, names and units are above samples."""
    place, *_ = [k for k, line in enumerate(lines) if k > 3 and line.startswith("Name")]
    blank, *_ = [k for k, line in enumerate(lines) if k > place and not line.strip()]
    rows = [line.split(lines[place][4]) for line in lines[place:blank]]
    names = rows[0]
    units = next((row for row in rows if row[0] == "Unit"), names)
    heads = ["time [ms]"]
    for before, name, unit in zip(names, names[1:], units[1:], strict=False):
        clock = name == "Name" and before != "Name"
        heads.append(f"time {len(heads)} [ms]" if clock else name if unit in ("(None)", "") else f"{name} [{unit}]")
    return RewrittenHead([lines[place][4].join(heads)], blank + 1)


def _tecplot(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of Tecplot: names in VARIABLES, then zones."""
    count = next(k for k, line in enumerate(lines) if line.strip() and all(map(is_number, line.split())))
    head = "\n".join(lines[:count])
    said, _, zone = re.split(r"VARIABLES\s*=", head, maxsplit=1, flags=re.IGNORECASE)[1].partition("ZONE")
    if re.search(r"=\s*F?BLOCK", zone, re.IGNORECASE):
        raise ValueError
    names = re.findall(r'"([^"]*)"', said) or said.replace(",", " ").split()
    return RewrittenHead([" ".join(f'"{name}"' for name in names)], count)


def _ignition(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of Ignition: names, types and the number of rows, each below its key."""
    count = next(k for k, line in enumerate(lines) if line.startswith(('"#ROWS', "#ROWS")))
    return RewrittenHead([lines[1]], count + 1)


def _haltech(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of Haltech: a line per channel, then rows without a header."""
    names = [line.partition(":")[2].strip() for line in lines if re.match(r"Channel\s*:", line)]
    count = next(k for k, line in enumerate(lines) if re.match(r"\d{1,2}:\d{2}:\d{2}", line))
    return RewrittenHead([",".join(f'"{name}"' for name in ("time", *names))], count)


def _labchart(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of LabChart: names and units behind keys that end in an equals sign."""
    said = {key: cells for key, *cells in (line.split("\t") for line in lines if "=\t" in line[:30])}
    count = next(k for k, line in enumerate(lines) if "=\t" not in line[:30])
    names, units = (said[f"{key}="] for key in ("ChannelTitle", "UnitName"))
    heads = (f"{name} [{unit}]" if unit not in ("", "*") else name for name, unit in zip(names, units, strict=True))
    return RewrittenHead(["\t".join(("time [s]", *heads))], count)


def _acqknowledge(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield the table of AcqKnowledge: a line for each name and unit, rows at an interval."""
    step, unit = re.match(r"([\d.]+) (\w+)/sample", lines[1]).groups()  # type: ignore[union-attr]
    count = int(lines[2].split()[0])
    names = [f"{name.strip()} [{unit.strip()}]" for name, unit in zip(lines[3::2], lines[4::2], strict=False)][:count]
    head, samples, *rows = [line.rstrip("\t").split("\t") for line in lines[3 + 2 * count :] if line.strip()]
    if len(head) == count + 1:  # times are there
        yield "\t".join((f"time [{head[0]}]", *names))
        yield from map("\t".join, rows)
        return
    check_count(len(rows), samples[0], source)  # times are those of row numbers
    yield "\t".join((f"time [{'ms' if unit == 'msec' else 's'}]", *names))
    yield from ("\t".join((repr(k * float(step)), *row)) for k, row in enumerate(rows))


def _msr(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of MSR loggers: sections that begin with a star."""
    below = {line.strip(): lines[k + 1] for k, line in enumerate(lines[:-1]) if line.startswith("*")}
    names, units = (below[key].split(";") for key in ("*CHANNEL", "*UNIT"))
    heads = (f"{name} [{unit}]" if unit.strip() else name for name, unit in zip(names, units, strict=True))
    return RewrittenHead([";".join(heads)], [line.strip() for line in lines].index("*DATA") + 1)


def _gw_instek(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of GW Instek in detail: time and sample of each channel."""
    said = {cells[0]: cells[1::2] for cells in (line.split(",") for line in lines[:40])}
    count = next(k for k, line in enumerate(lines) if line.startswith("Waveform Data")) + 1
    if {*filter(None, said["Mode"])} != {"Detail"}:
        raise ValueError
    heads = (f"time [s],{name} [{unit}]" for name, unit in zip(said["Source"], said["Vertical Units"], strict=True))
    return RewrittenHead([",".join(heads)], count)


def _kostal(lines: Sequence[str]) -> RewrittenHead:
    """Return the head of Kostal: a legend of units for the last words of headers."""
    count = next(k for k, line in enumerate(lines) if line.startswith("Zeit\t"))
    units = dict(re.findall(r"(\w+)\[([^\]]+)\]", next(line for line in lines if line.startswith("Logdaten"))))
    heads = [(name, units.get(name.split()[-1] if name.split() else "")) for name in lines[count].split("\t")]
    return RewrittenHead(["\t".join(f"{name} [{unit}]" if unit else name for name, unit in heads)], count + 1)


def _text_of_dymola(_lines: Sequence[str], source: str) -> Iterator[str]:
    raise InputError(f"{source}: a text result of Dymola. Save it as .mat or .csv.")


_LAYOUTS: tuple[tuple[re.Pattern[str], Callable[[Sequence[str], str], Iterator[str]]], ...] = (
    (re.compile(r'"?Record Length"?,[^,\n]*,[^,\n]*,[^,\n]*\d,[^,\n]*\d', re.IGNORECASE), _one_channel),
    (re.compile(r"#1\s*\nchar Aclass"), _text_of_dymola),
    (re.compile(r"#1\s*\n(?:\s*#.*\n|\s*\n)*\s*(?:double|float)\s"), _modelica),
    (re.compile(r"[^\n]*\.acq\s*\n[\d.]+ m?sec/sample\s*\n\d+ channels\s*\n"), _acqknowledge),
    *BLOCKS,
    *KEYED,
)
"""How the text begins, and who rewrites it."""


_HEADS: tuple[tuple[re.Pattern[str], Callable[[Sequence[str]], RewrittenHead]], ...] = (
    (re.compile(r"[^\n]* ASCII FILE\s*\nNb header lines *: *\d+"), _after_said_lines),
    (re.compile(r"Name\W[^\n]*\nFile\W[^\n]*\n\"?Starttime of export\W"), _twincat),
    (re.compile(r"(?:\s*(?:#|TITLE\s*=)[^\n]*\n)*\s*VARIABLES\s*=", re.IGNORECASE), _tecplot),
    (re.compile(r"\"?#NAMES\"?\s*\n"), _ignition),
    (re.compile(r"X,.*\bStart,Increment\b.*\n"), _numbered),
    (re.compile(r"%DataLog%\s*\n"), _haltech),
    (re.compile(r"Interval=\t"), _labchart),
    (re.compile(r"\*CREATOR\s*\n"), _msr),
    (re.compile(r"Format,[\d.]+[A-Z],.*\n(?:[^\n]*\n){1,40}?Waveform Data"), _gw_instek),
    (re.compile(r"(?:[^\n]*\n){1,6}?Logdaten U\[V\]"), _kostal),
)
"""The same where only lines above the samples are rewritten."""


def head_of(start: str) -> RewrittenHead | None:
    """Return the head in place of a text's own, by its begin; None for others."""
    function = next((function for begin, function in _HEADS if begin.match(start)), None)
    return None if function is None else function([line.rstrip("\r") for line in start.split("\n")])


def rewriter_of(start: str) -> Callable[[Sequence[str], str], Iterator[str]] | None:
    """Return what rewrites a text, by its begin; None for plain tables."""
    return next((function for begin, function in _LAYOUTS if begin.match(start)), None)
