"""Texts whose names and scales stand in a second file: COMTRADE (IEEE C37.111) and PSCAD."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from fmuid.data.cells import is_number
from fmuid.errors import InputError

Rewrite = Callable[[Sequence[str], str], Iterator[str]]
_COUNTS = re.compile(r"[^\n]*\n\s*\d+\s*,\s*(?P<analog>\d+)A\s*,\s*(?P<digital>\d+)D\s*\n", re.IGNORECASE)
_COUNTED = re.compile(r"\s*(\d+)\s*,\s*\d+\s*(,\s*-?\d+\s*){2,}")
_COMBINED = re.compile(r"-+ *file type: *(?P<type>CFG|INF|HDR|DAT)[^\n]*?-+ *\n", re.IGNORECASE)
_CHANNEL = re.compile(r"PGB\((?P<place>\d+)\)[^\n]*?Desc=\"(?P<name>[^\"]*)\"(?:[^\n]*?Units=\"(?P<unit>[^\"]*)\")?")
_PART = re.compile(r"(?P<stem>.*)_(?P<part>\d+)")


def rewriter_beside(path: Path, start: str, source: str) -> Rewrite | None:
    """Return what rewrites a text by the file beside it; None for others."""
    suffix, start = path.suffix.lower(), start.replace("\r\n", "\n")
    if suffix == ".cff" and _COMBINED.match(start):
        return _combined
    if suffix == ".cfg" and _COUNTS.match(start):
        return partial(_from_samples, _beside(path, ".dat"))
    if suffix == ".dat" and _is_counted(start):
        settings = _beside(path, ".cfg")
        if settings is None:
            raise InputError(f"{source}: rows of COMTRADE without scales. Put the .cfg file beside it.")
        return partial(_scaled, settings.read_text("utf-8", errors="replace"))
    if suffix == ".out" and (names := _pscad(path)):
        return partial(_with_names, names)
    return None


def _beside(path: Path, suffix: str) -> Path | None:
    """Return the file of the same name with another suffix."""
    return next((each for each in (path.with_suffix(suffix), path.with_suffix(suffix.upper())) if each.is_file()), None)


def _is_counted(start: str) -> bool:
    """Return whether rows are those of COMTRADE: numbers from 1, times in µs, integers."""
    found = [_COUNTED.fullmatch(line) for line in islice(start.splitlines(), 3)]
    return len(found) > 1 and [each and int(each[1]) for each in found] == [*range(1, len(found) + 1)]


@dataclass(frozen=True)
class _Settings:
    """Channels and times of a COMTRADE configuration: header, factor and offset per channel, rate, s per time unit."""

    heads: Sequence[str]
    scales: Sequence[tuple[float, float]]
    rate: float | None
    unit: float

    @classmethod
    def read(cls, text: str, source: str) -> _Settings:
        """Read a configuration; secondary values become primary ones."""
        found = _COUNTS.match(text)
        if found is None:
            raise ValueError
        analog, digital = int(found["analog"]), int(found["digital"])
        rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines())]
        channels, (_, rates, *rest) = rows[2 : 2 + analog], rows[2 + analog + digital :]
        several = int(rates[0])
        count = max(several, 1)
        rate = float(rest[0][0]) if several == 1 else 0.0
        first, _, kind, *more = rest[count:]
        if kind[0].upper() != "ASCII":
            raise InputError(f"{source}: samples of COMTRADE in binary form. Convert it to ASCII.")
        unit = 1e-9 if len(first[-1].rpartition(".")[2]) > 6 else 1e-6
        multiple = float(more[0][0]) if more and more[0] and more[0][0] else 1.0
        heads, scales = ["time [s]"], list[tuple[float, float]]()
        for row in channels:
            heads.append(f"{row[1]} [{row[4]}]" if row[4] else row[1])
            secondary = len(row) > 12 and row[12].upper() == "S" and float(row[11] or 0.0) > 0.0
            ratio = float(row[10]) / float(row[11]) if secondary else 1.0
            scales.append((ratio * float(row[5]), ratio * float(row[6])))
        heads += [row[1] or f"D{row[0]}" for row in rows[2 + analog : 2 + analog + digital]]
        return cls(heads, scales, rate or None, unit * multiple)


def _scaled(settings: str, lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield rows with times in s and scaled samples; 99999 and empty cells are missing."""
    known = _Settings.read(settings, source)
    yield ",".join(f'"{head}"' for head in known.heads)
    for line in lines:
        number, stamp, *cells = line.strip().rstrip("\x1a").split(",") if line.strip("\x1a \r\n") else ("",) * 2
        if not number:
            continue
        if len(cells) != len(known.heads) - 1 or not (known.rate or stamp.strip()):
            raise InputError(f"{source}: row {number} has other cells than its .cfg says. Write both files again.")
        time = (int(number) - 1) / known.rate if known.rate else float(stamp) * known.unit
        samples = (
            "" if cell.strip() in ("", "99999") else repr(factor * float(cell) + offset)
            for cell, (factor, offset) in zip(cells, known.scales, strict=False)
        )
        yield ",".join((repr(time), *samples, *cells[len(known.scales) :]))


def _from_samples(samples: Path | None, lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield rows of the samples beside a configuration."""
    if samples is None:
        raise InputError(f"{source}: configuration of COMTRADE without samples. Put the .dat file beside it.")
    _Settings.read("\n".join(lines), source)  # binary samples are no text
    yield from _scaled("\n".join(lines), samples.read_text("utf-8").splitlines(), source)


def _combined(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield rows of a combined file, ``.cff``."""
    _, *parts = _COMBINED.split("\n".join((*lines, "")))
    found = {kind.upper(): text for kind, text in zip(parts[::2], parts[1::2], strict=True)}
    yield from _scaled(found["CFG"], found["DAT"].splitlines(), source)


def _pscad(path: Path) -> list[str]:
    """Return the headers of an output of PSCAD: ten channels a file; none without its ``.inf``."""
    part = _PART.fullmatch(path.stem)
    beside = _beside(path.with_name(f"{part['stem'] if part else path.stem}.inf"), ".inf")
    if beside is None:
        return []
    text = beside.read_text("utf-8", errors="replace")
    found = {int(each["place"]): each for each in _CHANNEL.finditer(text)}
    first = 10 * (int(part["part"]) - 1 if part else 0)
    names = [found[k] for k in range(first + 1, first + 11) if k in found]
    return ["time [s]", *(f"{each['name']} [{each['unit']}]" if each["unit"] else each["name"] for each in names)]


def _with_names(names: Sequence[str], lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield rows below a header; a title is left out."""
    yield "\t".join(names)
    rows = [line.split() for line in lines if line.strip()]
    samples = [row for k, row in enumerate(rows) if k or all(map(is_number, row))]
    if any(len(row) != len(names) for row in samples):
        raise InputError(f"{source}: rows have other cells than the .inf file says. Write both files again.")
    yield from map("\t".join, samples)
