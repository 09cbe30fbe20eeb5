"""Numbers of time columns that count from a date."""

from __future__ import annotations

import itertools
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
_MATLAB_1970, _SPREADSHEET_1970 = 719_529.0, 25_569.0
"""1970-01-01 in these days."""
_TICKS, _TICKS_OF_1970 = (630_822_816_000_000_000, 662_380_416_000_000_000), 621_355_968_000_000_000
"""Tenths of microseconds since year 1 (.NET) of the years 2000 to 2100, and of 1970."""
_LOGGED_SECONDS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Usual intervals of loggers; as seconds, their fractions of a day are odd sampling rates such as 8640 Hz."""
DATES = ("date", "datum", "datetime", "date/time", "date time", "datum/zeit", "datum zeit", "timestamp", "zeitstempel")
"""Names of columns with dates."""


_CLOCK_PARTS = (
    ("h", "hh", "hr", "hour", "hours", "std", "stunde", "stunden"),
    ("m", "mm", "min", "minute", "minutes", "minuten"),
    ("s", "ss", "sec", "second", "seconds", "sek", "sekunde", "sekunden"),
)
"""Headers of three columns with a time of day."""


_DATE_PARTS = {
    "year": ("year", "yyyy", "yy", "yr", "jahr"),
    "month": ("month", "mon", "mo", "mm", "monat"),
    "day": ("day", "dd", "dy", "tag"),
    "hour": _CLOCK_PARTS[0],
    "minute": (*_CLOCK_PARTS[1], "mn"),
    "second": _CLOCK_PARTS[2],
}
"""Parts of dates in their order, and what columns call them."""


def since_1970(values: Any, unit: str | None) -> Literal["s", "ms", "us", "ns"] | None:
    """Return the unit of this century's epoch times, else None."""
    first = values.iloc[0] if pd.api.types.is_numeric_dtype(values.dtype) and len(values) else 0
    units: tuple[Literal["s", "ms", "us", "ns"], ...] = ("s", "ms", "us", "ns")
    possible = [each for each in units if unit is None or SECONDS[unit] == SECONDS[each]]
    return next((each for each in possible if _CENTURY[0] <= first * SECONDS[each] < _CENTURY[1]), None)


def _time_of_day(frame: pd.DataFrame) -> Any:
    """Return durations of three columns of hours, minutes and seconds; None without them."""
    names = [str(name).strip().lower() for name in frame.columns]
    if len(names) > 2 and names[0] in _CLOCK_PARTS[0] and names[1] in ("t", "time"):
        return _of_hours(frame.iloc[:, 0], frame.iloc[:, 1])
    triples = (zip(names[k : k + 3], _CLOCK_PARTS, strict=True) for k in range(len(names) - 2))
    place = next((k for k, triple in enumerate(triples) if all(name in known for name, known in triple)), None)
    if place is None or any(map(is_time_name, (*names[:place], *names[place + 3 :]))):
        return None
    parts = frame.iloc[:, place : place + 3]
    if not all(pd.api.types.is_numeric_dtype(column.dtype) for _, column in parts.items()):
        return None
    hours, minutes, seconds = (parts.iloc[:, k].astype(float) for k in range(3))
    if (hours % 1).any() or (minutes % 1).any() or max(minutes.max(), seconds.max()) >= 60 or parts.min().min() < 0:
        return None
    found = 3600.0 * hours + 60.0 * minutes + seconds
    return pd.to_timedelta(found + SECONDS["d"] * (found.diff() < 0).cumsum(), unit="s")


def _of_hours(hours: Any, seconds: Any) -> Any:
    """Return durations of hours and seconds of each (OpenDSS); None for others."""
    if not all(pd.api.types.is_numeric_dtype(each.dtype) for each in (hours, seconds)):
        return None
    found = 3600.0 * hours + seconds
    whole = (hours % 1 == 0).all() and seconds.between(0, 3600).all() and found.is_monotonic_increasing
    return pd.to_timedelta(found, unit="s") if whole else None


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


def dates_of_days(values: Any, column: str, unit: str | None) -> Any:
    """Return days of MATLAB and spreadsheets as dates: those in days, and a spreadsheet's in a column of dates."""
    numeric = pd.api.types.is_numeric_dtype(values.dtype) and len(values) > 0
    dated = unit is None and column.strip().lower() in DATES
    for known, zero in ((_MATLAB_DAYS, _MATLAB_1970), (_DAY_NUMBERS, _SPREADSHEET_1970)):
        likely = unit == "d" or (dated and zero == _SPREADSHEET_1970)
        if likely and numeric and values.between(*known).all() and (values % 1.0 > 0.0).any():
            return pd.to_datetime(values - zero, unit="D").dt.round("us")
    return None


def may_be_fractions(values: Any) -> bool:
    """Return whether whole numbers are rather ms, µs or ns: no logger samples each 1000 s, or after 118, 121, 117 s."""
    if not pd.api.types.is_integer_dtype(values.dtype) or len(values) < 2:
        return False
    steps = np.abs(np.diff(values))
    step = float(np.median(steps))
    uneven = len(steps) > 5 and step >= 20.0 and np.ptp(steps) > 0 and (steps % 5 != 0).mean() > 0.5
    return bool(uneven) or (step >= 1000.0 and step % SECONDS["min"] != 0)


def dates_in_digits(values: Any) -> Any:
    """Return numbers such as 20260131235959, and ticks of .NET, as dates; None for others."""
    if pd.api.types.is_integer_dtype(values.dtype) and values.between(*_TICKS).all():
        return pd.to_datetime((values - _TICKS_OF_1970) * 100, unit="ns")
    if (
        not pd.api.types.is_integer_dtype(values.dtype)
        or not values.between(19_000_101_000_000, 21_001_231_235_959).all()
    ):
        return None
    dates = pd.to_datetime(values.astype(str), format="%Y%m%d%H%M%S", errors="coerce")
    return None if dates.isna().any() else dates


def clock_in_digits(values: Any) -> Any:
    """Return times of day such as 125959.9 in s; None for others: only the leap to 130000 tells them."""
    numbers = values if pd.api.types.is_numeric_dtype(values.dtype) and len(values) > 10 else None
    if numbers is None or not 10_000 <= numbers.iloc[0] < 240_000 or not numbers.between(0, 240_000).all():
        return None
    hours, minutes, seconds = numbers // 10_000, numbers // 100 % 100, numbers % 100
    if minutes.max() >= 60 or seconds.max() >= 60:
        return None
    found = 3600.0 * hours + 60.0 * minutes + seconds
    found += SECONDS["d"] * (found.diff() < 0).cumsum()  # past midnight
    steps, read = np.diff(numbers), np.diff(found)
    usual = float(np.median(read))
    regular = 0 < usual < 30 and read.min() > 0 and read.max() <= 1.5 * usual
    return found if regular and np.abs(steps).max() > 30 + usual else None


def with_dates_of_days(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame whose dates are those of WinCC's numbers: ``Time_ms`` holds millionths of days since 1899."""
    names = {str(name).lower(): name for name in frame.columns}
    if not {"timestring", "time_ms"} <= names.keys():
        return frame
    numbers = frame[names["time_ms"]]
    if not pd.api.types.is_float_dtype(numbers.dtype) or not (numbers / 1e6).between(*_DAY_NUMBERS).all():
        return frame
    dates = pd.to_datetime(numbers / 1e6, unit="D", origin="1899-12-30").dt.round("ms")
    return frame.assign(**{names["timestring"]: dates}).drop(columns=names["time_ms"])


def _in_a_row(frame: pd.DataFrame, year: int = 2001) -> dict[str, Any]:
    """Return columns such as YY MM DD, by default of `year`."""
    names = [str(name).strip().lower() for name in frame.columns]
    for first, parts in itertools.product(range(len(names)), ([*_DATE_PARTS], [*_DATE_PARTS][1:])):
        pairs = zip(names[first:], (_DATE_PARTS[part] for part in parts), strict=False)
        count = len([*itertools.takewhile(lambda pair: pair[0] in pair[1], pairs)])
        if count >= 3 and parts[count - 1] in ("hour", "minute", "second"):
            found = {part: frame.iloc[:, first + k] for k, part in enumerate(parts[:count])}
            return {"year": found["month"] * 0 + year} | found
    return {}


def dates_of_parts(frame: pd.DataFrame) -> Any:
    """Return dates or times of day from columns of parts."""
    parts = {str(name).strip().lower().rstrip("s"): column for name, column in frame.items()}
    parts = {name: parts[name] for name in _DATE_PARTS if name in parts}
    parts = parts if {"year", "month", "day"} <= parts.keys() else _in_a_row(frame) or parts
    numeric = all(pd.api.types.is_numeric_dtype(column.dtype) for column in parts.values())
    others = [name for name in map(str, frame.columns) if is_time_name(name) and not name.lower().startswith("second")]
    if {"year", "month", "day"}.isdisjoint(parts):
        return _time_of_day(frame)
    if others or len(parts) < 4 or not {"year", "month", "day"} <= parts.keys() or not numeric:
        return None
    parts["year"] = parts["year"] + 2000 * (parts["year"].max() < 100)
    dates = pd.to_datetime(pd.DataFrame(parts), errors="coerce")
    return None if dates.isna().any() else dates
