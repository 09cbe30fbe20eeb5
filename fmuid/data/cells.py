"""Cells of data files: numbers, and marks of missing samples."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from datetime import date, datetime, time, timedelta
from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]
Cell = str | float | int | bool | date | datetime | time | timedelta | None
"""Of a text all cells are str; spreadsheets have typed ones."""

MISSING = ("", "-", "--", "---", "nan", "nat", "na", "n/a", "#n/a", "null", "none", "inf", "-inf")
"""Cells without a sample, in small letters; infinite numbers are refused where they are used."""

_MARKS = """---- ----- – — ? * nil ∞ -∞ +∞ missing nodata bad invalid error err fault burnout open ******** ###### +++++
1.#inf -1.#inf 1.#ind -1.#ind 1.#qnan #value! #num! #div/0! #ref! #name? #wert! #zahl! #bezug! #valeur! #n/v #nv
ol -ol +ol o.l o.l. 0.l .ol 0l overload overflow over +over -over overrange over-range ovld ovl ovr under underflow"""
_WORDS = """over range, no data, no signal, underrange, bad input, bad output, i/o timeout, comm fail, pt created,
shutdown, not connected, out of serv, no result, no sample, unavailable, unknown, not available, (null)"""
NO_SAMPLE = frozenset((*MISSING, *_MARKS.split(), *_WORDS.replace("\n", " ").split(", ")))
"""The same of samples alone: errors of spreadsheets, overload of instruments, states of historians."""

OVERLOADS = (9.9e37, 9.91e37)
"""Numbers for infinity and no number in SCPI (1999.0, section 7.2.1)."""

_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?\s*", re.ASCII)
_COMMA_NUMBER = re.compile(r"\s*[+-]?(\d+,?\d*|,\d+)([eEdD][+-]?\d+)?\s*", re.ASCII)
_SPACES = " \u00a0\u202f'’"
_GROUPED = re.compile(rf"\s*[+-]?\d{{1,3}}(?:([.,{_SPACES}])\d{{3}})(?:\1\d{{3}})*(?:([.,])\d+)?\s*", re.ASCII)


def is_number(cell: Cell, decimal: str = ".") -> bool:
    """Return whether a cell holds a number."""
    if isinstance(cell, str):
        pattern = _NUMBER if decimal == "." else _COMMA_NUMBER
        return pattern.fullmatch(cell) is not None or cell.strip().lower() in ("true", "false")
    return isinstance(cell, bool | int | float) and not (isinstance(cell, float) and math.isnan(cell))


def may_be_number(cell: str, decimal: str) -> bool:
    """Return whether a text is a number, perhaps with marks between thousands."""
    grouped = _GROUPED.fullmatch(cell)
    return is_number(cell, decimal) or (grouped is not None and grouped[1] != decimal and grouped[2] in (None, decimal))


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
        return cell.strip().lower() in NO_SAMPLE
    return cell is None or (isinstance(cell, float) and math.isnan(cell))
