"""Headers of data files: first row, names and units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, time, timedelta
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from fmuid.errors import InputError
from fmuid.units import SECONDS, parse_unit

if TYPE_CHECKING:
    import pandas as pd

Array = npt.NDArray[Any]
Cell = str | float | int | bool | date | datetime | time | timedelta | None
"""Of a text all cells are str; spreadsheets have typed ones."""

MISSING = ("", "-", "--", "---", "nan", "na", "n/a", "#n/a", "null", "none", "inf", "-inf")
"""Cells without a sample, in small letters; infinite numbers are refused where they are used."""

TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps", "datetime", "date", "date/time", "datum", "temps")
"""What tables call their time, in small letters, in the order of preference."""

_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?\s*", re.ASCII)
_COMMA_NUMBER = re.compile(r"\s*[+-]?(\d+,?\d*|,\d+)([eEdD][+-]?\d+)?\s*", re.ASCII)
_WITH_UNIT = re.compile(
    r"(?P<name>.*?\S)(?P<gap>\s*)(\((?P<round>[^()]*(\([^()]*\)[^()]*)*)\)|\[(?P<square>[^\[\]]*)\])"
)
_INDEX = re.compile(r"[\d\s,:]*")
_SPACES = " \u00a0\u202f'’"
_GROUPED = re.compile(rf"\s*[+-]?\d{{1,3}}(?:([.,{_SPACES}])\d{{3}})(?:\1\d{{3}})*(?:([.,])\d+)?\s*", re.ASCII)


@dataclass(frozen=True)
class RawTable:
    """Data file before its times are known.

    `units` are as written, `time` is the format's own time column, `days` are columns that may be pandas durations.
    """

    frame: pd.DataFrame
    units: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    days: frozenset[str] = frozenset()


@dataclass(frozen=True)
class TableHeader:
    """Header cells, unit cells and the first row of samples."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int


def split_header(header: str) -> tuple[str, str | None]:
    """Return name and unit of a header: ``w (rpm)``, ``ids [mA]``, but not ``der(y)``."""
    found = _WITH_UNIT.fullmatch(header.strip())
    if found is None:
        return header.strip(), None
    unit = found["round"] if found["round"] is not None else found["square"]
    if found["name"] == "der" or (not found["gap"] and _INDEX.fullmatch(unit)) or not is_unit(unit):
        return header.strip(), None
    return found["name"], unit.strip()


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit."""
    text = text.strip()
    # rows of samples are asked too where decimals are not those of the table
    number = text != "1" and (is_number(text) or is_number(text, ","))
    return text in SECONDS or (not number and parse_unit(text) is not None)


def named(headers: Sequence[str], units: Sequence[str] = ()) -> tuple[list[str], dict[str, str]]:
    """Return the names and units of columns; names that differ in the unit only keep it."""
    split = [split_header(header) for header in headers]
    bare = [name for name, _ in split]
    names = [
        name if bare.count(name) == 1 else header.strip() for (name, _), header in zip(split, headers, strict=True)
    ]
    below = [cell.strip().strip("[]()") for cell in units] or [""] * len(names)
    said = {name: below[k] or split[k][1] for k, name in enumerate(names)}
    return names, {name: unit for name, unit in said.items() if unit}


def check_once(source: str, names: Sequence[str]) -> None:
    """Refuse columns of one name."""
    for name in names:
        if names.count(name) > 1:
            called = f"column {name!r} occurs twice" if name else "two columns have no name"
            raise InputError(f"{source}: {called}. Rename or remove one.")


def find_head(rows: Sequence[Sequence[Cell]], decimal: str = ".") -> TableHeader | None:
    """Return the header above most numeric rows of its length, if any."""
    numeric = [any(is_number(cell, decimal) for cell in row) for row in rows]
    begins = [
        k
        for k in range(1, len(rows))
        if numeric[k] and not numeric[k - 1] and len(rows[k]) == len(rows[k - 1]) and any(map(_there, rows[k - 1]))
    ]
    if not begins:
        return None
    ends = [*begins[1:], len(rows)]
    lengths = [sum(len(row) == len(rows[a]) for row in rows[a:b]) for a, b in zip(begins, ends, strict=True)]
    first = begins[lengths.index(max(lengths))]
    above = first - 1
    while above >= 0 and not numeric[above] and len(rows[above]) == len(rows[first]):
        above -= 1
    header, top = first - 1, _texts(rows[above + 1])
    index, *others = _texts(rows[header])
    if index.lower() in TIME_NAMES and not any(others) and all(top):  # pandas names an index below several header rows
        return TableHeader((index, *top[1:]), (), first)
    for k in range(above + 2, first):
        if _are_units(rows[k]):
            return TableHeader(_texts(rows[k - 1]), _texts(rows[k]), first)
    return TableHeader(_texts(rows[header]), (), first)


def is_number(cell: Cell, decimal: str = ".") -> bool:
    """Return whether a cell holds a number."""
    if isinstance(cell, str):
        pattern = _NUMBER if decimal == "." else _COMMA_NUMBER
        return pattern.fullmatch(cell) is not None or cell.strip().lower() in ("true", "false")
    return isinstance(cell, bool | int | float) and not (isinstance(cell, float) and math.isnan(cell))


def numbers_of(cells: Iterable[str], decimal: str) -> list[float] | None:
    """Return texts as numbers, also 1D3 and 1,069.9; None if one is no number."""
    found, marks = [], set()
    clear = False
    for cell in cells:
        if not is_number(cell, decimal):
            grouped = _GROUPED.fullmatch(cell)
            if grouped is None or grouped[1] == decimal or grouped[2] not in (None, decimal):
                return None
            marks.add(grouped[1])
            clear = clear or grouped[1] in _SPACES or grouped[2] is not None or cell.count(grouped[1]) > 1
            cell = cell.replace(grouped[1], "")
        found.append(_number(cell.replace(decimal, ".")))
    return found if len(marks) <= clear else None


def _number(cell: str) -> float:
    text = cell.strip().lower()
    return float(text == "true") if text in ("true", "false") else float(text.replace("d", "e"))


def is_missing(cell: Cell) -> bool:
    """Return whether a cell holds no sample."""
    if isinstance(cell, str):
        return cell.strip().lower() in MISSING
    return cell is None or (isinstance(cell, float) and math.isnan(cell))


def _there(cell: Cell) -> bool:
    return not is_missing(cell)


def _are_units(row: Sequence[Cell]) -> bool:
    texts = [text.strip("[]() ") for text in _texts(row)]
    return any(texts) and all(text in ("", "-") or is_unit(text) for text in texts)


def _texts(row: Sequence[Cell]) -> tuple[str, ...]:
    return tuple("" if cell is None or is_missing(cell) else str(cell).strip() for cell in row)
