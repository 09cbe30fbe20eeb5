"""Numbers of time columns that count from a date."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pandas as pd

from fmuid.data.time_names import is_time_name
from fmuid.units import SECONDS

_CENTURY = (946_684_800.0, 4_102_444_800.0)
"""Seconds from 1970 to the years 2000 and 2100."""
_DAY_NUMBERS = (36_526.0, 73_051.0)
"""Days of spreadsheets (from 1899-12-30) of the years 2000 to 2100."""
_MATLAB_DAYS = (729_391.0, 767_010.0)
"""Days of MATLAB (datenum) of the years 1997 to 2100."""
_LOGGED_SECONDS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Usual intervals of loggers; as seconds, their fractions of a day are odd sampling rates such as 8640 Hz."""
DATES = ("date", "datum", "datetime", "date/time", "date time", "datum/zeit", "datum zeit", "timestamp", "zeitstempel")
"""Names of columns with dates."""


def since_1970(values: Any, unit: str | None) -> Literal["s", "ms", "us", "ns"] | None:
    """Return the unit of this century's epoch times, else None."""
    first = values.iloc[0] if pd.api.types.is_numeric_dtype(values.dtype) and len(values) else 0
    units: tuple[Literal["s", "ms", "us", "ns"], ...] = ("s", "ms", "us", "ns")
    possible = [each for each in units if unit is None or SECONDS[unit] == SECONDS[each]]
    return next((each for each in possible if _CENTURY[0] <= first * SECONDS[each] < _CENTURY[1]), None)


def may_be_days(values: Any) -> bool:
    """Return whether numbers may be days: of MATLAB, or of a logger's intervals."""
    if not pd.api.types.is_numeric_dtype(values.dtype):
        return False
    if len(values) > 2:
        step = SECONDS["d"] * abs(float(values.iloc[-1]) - float(values.iloc[0])) / (len(values) - 1)
        if any(abs(step - each) < 1e-4 * each for each in _LOGGED_SECONDS):
            return True
    if not values.between(*_MATLAB_DAYS).all():
        return False
    return bool((values % 1.0 > 0.0).any() and np.nanmedian(np.abs(np.diff(values))) < 1.0)


def are_day_numbers(values: Any, column: str) -> bool:
    """Return whether a column of dates holds a spreadsheet's numbers of days."""
    if column.strip().lower() not in DATES or not pd.api.types.is_numeric_dtype(values.dtype):
        return False
    return bool(values.between(*_DAY_NUMBERS).all() and (values % 1.0 > 0.0).any())


def dates_in_digits(values: Any) -> Any:
    """Return numbers such as 20260131235959 as dates; None for others."""
    if (
        not pd.api.types.is_integer_dtype(values.dtype)
        or not values.between(19_000_101_000_000, 21_001_231_235_959).all()
    ):
        return None
    dates = pd.to_datetime(values.astype(str), format="%Y%m%d%H%M%S", errors="coerce")
    return None if dates.isna().any() else dates


def dates_of_parts(frame: pd.DataFrame) -> Any:
    """Return dates of columns such as year, month, day and hour; None without them."""
    parts = {str(name).strip().lower().rstrip("s"): column for name, column in frame.items()}
    parts = {name: parts[name] for name in ("year", "month", "day", "hour", "minute", "second") if name in parts}
    numeric = all(pd.api.types.is_numeric_dtype(column.dtype) for column in parts.values())
    others = [name for name in map(str, frame.columns) if is_time_name(name) and not name.lower().startswith("second")]
    if others or len(parts) < 4 or not {"year", "month", "day"} <= parts.keys() or not numeric:
        return None
    dates = pd.to_datetime(pd.DataFrame(parts), errors="coerce")
    return None if dates.isna().any() else dates
