"""Cells with units, such as ``12.1 V``: numbers and the unit of their column."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from fmuid.data.cells import is_missing, numbers_of
from fmuid.data.headers import is_unit
from fmuid.data.time_names import is_time_name
from fmuid.units import parse_unit

_WITH_UNIT = re.compile(r"\s*(?P<number>[+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*(?P<unit>[^\d\s.,:].*?)\s*")


def number_in(cell: str) -> str | None:
    """Return the number of a cell with a known unit; None of others."""
    found = _WITH_UNIT.fullmatch(cell)
    return found["number"] if found is not None and is_unit(found["unit"]) else None


def without_units(column: pd.Series[Any], decimal: str) -> tuple[pd.Series[Any], str | None]:
    """Return numbers of cells with units, in the first unit; other columns as they are.

    The units may be several of one quantity.
    """
    first = next((cell for cell in column if isinstance(cell, str) and not is_missing(cell)), "")
    found = _WITH_UNIT.fullmatch(first)
    if found is None or is_time_name(str(column.name)) or not is_unit(found["unit"]):
        return column, None
    there = column[[isinstance(cell, str) and not is_missing(cell) for cell in column]]
    cells = [_WITH_UNIT.fullmatch(cell) for cell in there]
    units = {cell["unit"] for cell in cells if cell is not None}
    known = {unit: parse_unit(unit) for unit in units}
    alike = {(each.exponents, each.offset) for each in known.values() if each is not None}
    numbers = numbers_of((cell["number"] if cell else "" for cell in cells), decimal)
    if numbers is None or len(alike) != 1 or None in known.values() or (len(units) > 1 and alike.pop()[1]):
        return column, None
    own = {unit: each.factor for unit, each in known.items() if each is not None}
    scaled = [
        number * own[cell["unit"]] / own[found["unit"]] for number, cell in zip(numbers, cells, strict=True) if cell
    ]
    return pd.Series(scaled, there.index, dtype=np.float64).reindex(column.index), found["unit"]
