"""Texts with one block per signal or point, rewritten as tables: circuit simulators, OpenModelica, UFF, Igor, Weka."""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from fmuid.data.cells import is_number
from fmuid.data.headers import is_unit, split_header
from fmuid.data.readers.row_checks import check_count
from fmuid.data.said_values import interval_of
from fmuid.data.time_names import is_time_name
from fmuid.errors import InputError

_QUCS = re.compile(r"<(?P<kind>indep|dep) (?P<name>\S+)(?: (?P<rest>[^>]*))?>\n(?P<values>[^<]*)</(?P=kind)>")
_COLUMN = re.compile(r"Index\s+\S")
_SIGNAL = r"\"?[^\W\d][^,;\t\n]*([,;\t])[ ]*[-+]?[\d.][^,;\t\n]*(?:[,;\t][ ]*[-+]?[\d.][^,;\t\n]*){5,}\s*\n"
"""Row of a name and numbers."""
_REAL = ("2", "4")
"""Real ordinates of UFF, dataset 58."""


def _spice_raw(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield points of a raw file of SPICE in ASCII."""
    places = {line.partition(":")[0].strip().lower(): k for k, line in enumerate(lines) if ":" in line[:20]}
    count = int(lines[places["no. variables"]].partition(":")[2])
    if "complex" in lines[places["flags"]]:
        raise InputError(f"{source}: complex values of an AC analysis. Export magnitude and phase as CSV.")
    if sum(line.startswith("Plotname:") for line in lines) > 1:
        raise InputError(f"{source}: several plots. Write one of them into a file.")
    first = places["variables"] + 1
    yield _row(line.split()[1] for line in lines[first : first + count])
    cells = " ".join(lines[places["values"] + 1 :]).split()
    points = int(lines[places["no. points"]].partition(":")[2])
    check_count(len(cells) / (count + 1), str(points), source)
    yield from (",".join(cells[k + 1 : k + 1 + count]) for k in range(0, len(cells), count + 1))


def _spice_pages(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a table that SPICE prints in pages."""
    heads = {" ".join(line.split()) for line in lines if _COLUMN.match(line)}
    if len(heads) > 1:
        raise InputError(f"{source}: several printed tables. Print all columns in one, or use wrdata.")
    yield _row(heads.pop().split())
    rows = [line.split() for line in lines]
    yield from (",".join(row) for row in rows if len(row) > 1 and row[0].isdecimal() and all(map(is_number, row)))


def _qucs(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a transient of Qucs."""
    found = {each["name"]: each for each in _QUCS.finditer("\n".join(lines))}
    axes = [name for name, each in found.items() if each["kind"] == "indep" and len(each["values"].split()) > 1]
    if len(axes) != 1 or any("j" in each["values"] for each in found.values()):
        raise InputError(f"{source}: no single transient. Simulate it alone.")
    own = [axes[0], *(name for name, each in found.items() if each["rest"] == axes[0])]
    yield from _of_columns({name: found[name]["values"].split() for name in own}, source)


def _ptolemy(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a result of OpenModelica in Ptolemy's format: time and value in each block."""
    columns: dict[str, list[str]] = {}
    times: list[list[str]] = []
    for line in lines:
        if line.startswith("DataSet:"):
            columns[line.partition(":")[2].strip()] = []
            times.append([])
        elif columns and line.strip():
            stamp, value = line.split(",")
            times[-1].append(stamp)
            [*columns.values()][-1].append(value)
    if any(each != times[0] for each in times):
        raise InputError(f"{source}: signals of different times. Simulate with the format csv.")
    yield from _of_columns(columns, source)


def _universal(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield evenly spaced time functions of a universal file, dataset 58."""
    marks = [k for k, line in enumerate(lines) if line.strip() == "-1"]
    blocks = [lines[a + 1 : b] for a, b in zip(marks[::2], marks[1::2], strict=True)]
    columns: dict[str, list[str]] = {}
    axes: set[tuple[int, float, float]] = set()
    for kind, *block in blocks:
        if kind.strip() != "58":
            continue
        form = block[6].split()
        if form[0] not in _REAL or form[2] != "1" or block[7].split()[0] != "17":
            raise InputError(f"{source}: no evenly spaced real times. Export them as CSV.")
        unit = block[8].split()[-1]
        name = block[0].strip() if block[0].strip() not in ("", "NONE") else f"signal {len(columns) + 1}"
        axes.add((int(form[1]), float(form[3]), float(form[4])))
        columns[name if unit == "NONE" else f"{name} [{unit}]"] = " ".join(block[11:]).split()
    ((count, start, step),) = axes
    yield from _of_columns({"time [s]": [repr(start + step * k) for k in range(count)], **columns}, source)


def _igor(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield the waves of an Igor text."""
    heads = [k for k, line in enumerate(lines) if line.strip().upper() == "BEGIN"]
    if len(heads) != 1:
        raise InputError(f"{source}: {len(heads)} tables of Igor. Save one in a file.")
    end = next(k for k, line in enumerate(lines) if line.strip().upper() == "END")
    yield _row(re.split(r"[\s,]+", lines[heads[0] - 1].strip())[1:])
    yield from (",".join(line.split()) for line in lines[heads[0] + 1 : end])


def _weka(lines: Sequence[str], _source: str) -> Iterator[str]:
    """Yield the rows of Weka's ARFF."""
    found = [re.match(r"\s*@attribute\s+('[^']*'|\S+)", line, re.IGNORECASE) for line in lines]
    yield _row(each[1].strip("'\"") for each in found if each)
    begin = next(k for k, line in enumerate(lines) if line.strip().lower() == "@data")
    yield from ("" if cells == "?" else cells for cells in (line.replace(",?", ",") for line in lines[begin + 1 :]))


def _transposed(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a table whose rows are the signals, each after its name."""
    mark = next(each for each in ",;\t" if each in lines[0])
    rows = [[cell.strip() for cell in row] for row in csv.reader(filter(str.strip, lines), delimiter=mark)]
    if not is_time_name(split_header(rows[0][0])[0]) or len({len(row) for row in rows}) != 1:
        raise InputError(f"{source}: no header and no row of times. Write names into the first line, or transpose.")
    yield from (mark.join(f'"{cell}"' for cell in row) for row in zip(*rows, strict=True))


def _hantek(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield samples of Hantek, with all channels or one per block."""
    starts = [k for k, line in enumerate(lines) if re.match(r"#\s*CHANNEL", line)]
    heads, columns, clocks = list[str](), list[list[str]](), set[str]()
    for first, end in itertools.pairwise([*starts, len(lines)]):
        block = [line.strip() for line in lines[first:end] if line.strip()]
        said = dict(re.split(r"[:=,]", line.lstrip("# "), maxsplit=1) for line in block if line.startswith("#"))
        names = [name for name in said["CHANNEL"].split(",") if name.strip()]
        units = [unit for unit in said.get("UNITS", "").split(",") if unit.strip()]
        if len(units) not in (1, len(names)):
            raise ValueError
        rows = [line.rstrip(",").split(",") for line in block if not line.startswith("#")]
        check_count(len(rows), said.get("SIZE", "").strip(", "), source)
        heads += (f"{name.strip()} [{units[k % len(units)].strip()}]" for k, name in enumerate(names))
        columns += [[*column] for column in zip(*rows, strict=True)]
        clocks.add(said["CLOCK"].strip(", "))
    (step,) = map(interval_of, clocks)
    if step is None or len(columns) != len(heads):
        raise ValueError
    times = [repr(step * k) for k in range(max(map(len, columns)))]
    yield from _of_columns({"time [s]": times, **dict(zip(heads, columns, strict=True))}, source)


def _hantek_dso(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield samples of Hantek's bench scopes: V, or mV where they are far beyond the screen of eight divisions."""
    said = dict(re.split(r"=", line.strip(",# "), maxsplit=1) for line in lines[:3])
    rows = [line for line in lines[3:] if line.strip()]
    check_count(len(rows), said["size"], source)
    screen = 8e-6 * float(said["voltbase"].partition("(")[0])
    largest = max(abs(float(row.split(",")[1])) for row in rows)
    yield f"time [s],CH1 [{'mV' if largest > 10 * screen else 'V'}]"
    yield from rows


def _iris(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield a time series of IRIS: samples row by row, or pairs of time and sample."""
    if sum(line.startswith("TIMESERIES") for line in lines) > 1:
        raise InputError(f"{source}: several time series. Keep one in a file.")
    name, count, rate, _, form, _, unit = (cell.strip() for cell in lines[0].removeprefix("TIMESERIES").split(","))
    cells = [line.split() for line in lines[1:] if line.strip()]
    step = 1.0 / float(rate.split()[0])
    samples = (cell for row in cells for cell in row)
    rows = cells if form == "TSPAIR" else [[repr(step * k), cell] for k, cell in enumerate(samples)]
    check_count(len(rows), count.split()[0], source)
    yield f"time,{name} [{unit if is_unit(unit) else unit.lower()}]"
    yield from map(",".join, rows)


def _octave(_lines: Sequence[str], source: str) -> Iterator[str]:
    raise InputError(f"{source}: a matrix of Octave without names. Put one line of names in place of the comments.")


def _of_columns(columns: Mapping[str, Sequence[str]], source: str) -> Iterator[str]:
    """Yield header and rows of equally long columns."""
    yield _row(columns)
    lengths = {len(each) for each in columns.values()}
    if len(lengths) != 1:
        raise InputError(f"{source}: signals of {min(lengths)} to {max(lengths)} samples. Write the whole file again.")
    yield from (",".join(row) for row in zip(*columns.values(), strict=True))


def _row(cells: Iterator[str] | Sequence[str] | Mapping[str, object]) -> str:
    """Return a line of names, quoted where they have commas."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([*cells])
    return line.getvalue()


BLOCKS: tuple[tuple[re.Pattern[str], Callable[[Sequence[str], str], Iterator[str]]], ...] = (
    (re.compile(r"Title:[^\n]*\n(?:[^\n]*\n){1,12}?Variables:(?:[^\n]*\n)*?Values:"), _spice_raw),
    (re.compile(r"(?:[^\n]*\n){0,6}?-{20,}\s*\nIndex\s+\S[^\n]*\n-{20,}"), _spice_pages),
    (re.compile(r"<Qucs Dataset"), _qucs),
    (re.compile(r"#Ptolemy Plot file"), _ptolemy),
    (re.compile(r"\s*-1\s*\n\s*(?:58|151|164)\s*\n"), _universal),
    (re.compile(r"IGOR\s*\n"), _igor),
    (re.compile(r"(?:\s*%[^\n]*\n|\s*\n)*\s*@relation\b", re.IGNORECASE), _weka),
    (re.compile(r"(?:#[^\n]*\n)*# type: matrix"), _octave),
    (re.compile(r"#\s*CHANNEL[,:](?:[^\n]*\n){1,4}?#\s*CLOCK="), _hantek),
    (re.compile(r"TIMESERIES [^\n]*, (?:TSPAIR|SLIST), "), _iris),
    (re.compile(r"#timebase=[^\n]*\n,?#voltbase=[^\n]*\n#size="), _hantek_dso),
    (re.compile(rf"{_SIGNAL}{_SIGNAL}"), _transposed),
)
"""How the text begins, and who rewrites it."""
