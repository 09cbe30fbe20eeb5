"""Time columns: their name, unit and dates, converted to seconds."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Literal

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.headers import TIME_NAMES, RawTable, split_header
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.units import SECONDS, TIME_UNITS

REMEDY = "Name it, give sample_rate, or set kind for rows without times."
_LISTED_NAMES = 12
"""Names listed in a message."""
_WITH_SUFFIX = re.compile(rf"(.*\S)[_ ]({'|'.join(SECONDS)})", re.IGNORECASE)
_ORDERS = ("%d{0}%m{0}%Y", "%m{0}%d{0}%Y", "%Y{0}%m{0}%d", "%d{0}%b{0}%Y")
_CLOCKS = (" %H:%M:%S.%f", " %H:%M:%S", " %H:%M", " %I:%M:%S.%f %p", " %I:%M:%S %p", " %I:%M %p")
_CENTURY = (946_684_800.0, 4_102_444_800.0)
"""Seconds from 1970 to the years 2000 and 2100."""
_CLOCK = re.compile(r"(\d+ days )?\d{1,3}:\d{2}(:\d{2}([.,]\d+)?)?")
_OFFSET = r"(?:Z|[+-]\d{2}:?\d{2})$"
_HOUR, _DAY = 3600.0, 86_400.0


def time_name(time: str | int) -> str:
    """Return the final name of the time column."""
    return time if isinstance(time, str) else "time"


def with_time(
    raw: RawTable, time: str | int, unit: str | None, sample_rate: float | None, source: str
) -> tuple[pd.DataFrame, pd.Timestamp | None]:
    """Return a table with time in s, and the first date."""
    name = time_name(time)
    if sample_rate is not None:
        if name in raw.frame.columns:
            raise InputError(f"{source}: column {name!r} and sample_rate are both given. Give one of them.")
        return raw.frame.assign(**{name: np.arange(len(raw.frame)) / sample_rate}), None
    column = _column(raw, time, source)
    if unit is not None and unit not in SECONDS:
        raise InputError(f"{source}: time_unit {unit!r} is unknown. Use {', '.join(TIME_UNITS)}.")
    values, begin = _as_numbers(raw.frame[column], column, source)
    if begin is not None and begin.tzinfo is None:
        _check_clock(raw.frame[column], np.asarray(values, dtype=np.float64), column, source)
    said_unit = unit or _unit_said(raw, column)
    if begin is None and (since_1970 := _since_1970(values, said_unit)):
        values, begin = _seconds(pd.to_datetime(values, unit=since_1970))
    if said_unit is None and column in raw.days:
        raise InputError(f'{source}: column {column or "(no name)"!r} may be in days. Set time_unit = "d" or "s".')
    factor = 1.0 if begin is not None else SECONDS[said_unit or "s"]
    frame = raw.frame.assign(**{column: values if factor == 1.0 else _scaled(values, factor)})
    return frame.rename(columns={column: name}), begin


def _are_times(values: Any, source: str) -> bool:
    """Return whether an unnamed column holds dates or times, not row numbers."""
    try:
        numbers, begin = _as_numbers(values, "", source)
        steps = np.diff(np.asarray(numbers, dtype=np.float64))
    except (InputError, ValueError, TypeError):
        return False
    return bool((steps > 0).all() and (begin is not None or (steps != 1).any()))


def _scaled(values: Any, factor: float) -> Any:
    """Return times in s, by division where it rounds less: 3 ms are 0.003 s."""
    return values / round(1 / factor) if factor < 1 else values * factor


def _column(raw: RawTable, time: str | int, source: str) -> str:
    names = [str(name) for name in raw.frame.columns]
    if isinstance(time, int):
        if not 1 <= time <= len(names):
            said = f"no time column {time}; the table has {len(names)} columns"
            raise InputError(f"{source}: {said}. Give a name or a place from 1.")
        if "time" in set(names) - {names[time - 1]}:
            said = f"time is column {time}, {names[time - 1]!r}, but there is a column 'time'"
            raise InputError(f"{source}: {said}. Give the right name.")
        return names[time - 1]
    found = column_of(names, time)
    if found is not None:
        return found
    if time == "time":
        if raw.time is not None:
            return raw.time
        timely = [name for name in names if raw.units.get(name) in (None, *SECONDS)]
        for known in TIME_NAMES:
            near = [name for name in timely if _bare(name).lower() == known and name != "T"]
            if len(near) == 1:
                return near[0]
        if "T" in timely:  # which is a temperature where there is another time
            return "T"
        if names[0] == "" and _are_times(raw.frame[""], source):  # an index of pandas
            return ""
    raise InputError(f"{source}: {missing_column('time', time, names, REMEDY)}")


def column_of(columns: Iterable[object], wanted: str) -> str | None:
    """Return the column of a name, with or without its unit; None if missing."""
    names = [str(each) for each in columns]
    return next((each for each in (wanted, split_header(wanted)[0]) if each in names), None)


def missing_column(role: str, column: str, known: Iterable[object], remedy: str = "Name the right column.") -> str:
    """Return the sentences on a missing column, with near names."""
    names = [str(name) or "(no name)" for name in known]
    listed = ", ".join(names[:_LISTED_NAMES]) + (", …" if len(names) > _LISTED_NAMES else "")
    found = nearest(column, names) or f" (columns: {listed or 'nothing numeric'})"
    return f"{role} column {column!r} not found{found}. {remedy}"


def _bare(name: str) -> str:
    """Return a name without a unit suffix: ``time_ms`` is ``time``."""
    found = _WITH_SUFFIX.fullmatch(name)
    return found[1] if found else name


def _unit_said(raw: RawTable, column: str) -> str | None:
    """Return the time unit stated by the table, if any."""
    said = raw.units.get(column)
    if said in SECONDS:
        return str(said)
    suffix = _WITH_SUFFIX.fullmatch(column)
    return suffix[2].lower() if suffix and said is None else None


def _since_1970(values: Any, unit: str | None) -> Literal["s", "ms", "us", "ns"] | None:
    """Return the unit of this century's epoch times, else None."""
    first = values.iloc[0] if pd.api.types.is_numeric_dtype(values.dtype) and len(values) else 0
    units: tuple[Literal["s", "ms", "us", "ns"], ...] = ("s", "ms", "us", "ns")
    possible = [each for each in units if unit is None or SECONDS[unit] == SECONDS[each]]
    return next((each for each in possible if _CENTURY[0] <= first * SECONDS[each] < _CENTURY[1]), None)


def _as_numbers(series: pd.Series[Any], column: str, source: str) -> tuple[Any, pd.Timestamp | None]:
    """Return dates and times of day in s; else the series unchanged."""
    if pd.api.types.is_timedelta64_dtype(series.dtype):
        return series.dt.total_seconds(), None
    if pd.api.types.is_datetime64_any_dtype(series.dtype):
        return _seconds(series)
    is_text = series.dtype == object or pd.api.types.is_string_dtype(series.dtype)
    texts = series.dropna().astype(str) if is_text else series[:0]
    if texts.empty:
        return series, None
    if texts.map(lambda text: _CLOCK.fullmatch(text) is not None).all():
        clock = texts.str.replace(",", ".").map(lambda text: f"{text}:00" if text.count(":") == 1 else text)
        seconds = pd.to_timedelta(clock).dt.total_seconds()
        if seconds.max() < _DAY:
            seconds += _DAY * (seconds.diff() < -_DAY / 2).cumsum()  # past midnight
        return (seconds - seconds.iloc[0]).reindex(series.index), None
    dates = _dates(texts, column, source)
    return (series, None) if dates is None else _seconds(dates.reindex(series.index))


def _seconds(dates: pd.Series[Any]) -> tuple[Any, pd.Timestamp]:
    begin = dates.iloc[0]
    return (dates - begin).dt.total_seconds(), begin


def _check_clock(dates: pd.Series[Any], seconds: Floats, column: str, source: str) -> None:
    """Refuse dates without an offset that go back by one hour once."""
    steps = np.diff(seconds)
    back = np.flatnonzero(steps < 0)
    if back.size == 1 and 0 <= steps[back[0]] + _HOUR <= 2 * np.median(steps):
        before, after = dates.iloc[back[0] : back[0] + 2]
        said = f"goes back by an hour in row {back[0] + 2} ({before} to {after})"
        raise InputError(f"{source}: time column {column!r} {said}. Write times in UTC or with offsets (+01:00).")


def _dates(texts: pd.Series[Any], column: str, source: str) -> pd.Series[Any] | None:
    """Return texts as dates, None if they are none."""
    with suppress(ValueError, TypeError):  # the other orders are tried below
        return pd.to_datetime(texts, format="ISO8601")
    with suppress(ValueError, TypeError):  # offsets that change where the clock is put forward or back
        if texts.str.contains(_OFFSET, regex=True).all():
            in_utc = pd.to_datetime(texts, format="ISO8601", utc=True)
            return in_utc.dt.tz_convert(pd.Timestamp(texts.iloc[0]).tz)
    if not texts.str.contains(r"\d+[./-]\w+[./-]\d+.*:", regex=True).all():
        return None
    points = texts.str.replace(",", ".")
    forms = [order.format(mark) + clock for order, mark, clock in itertools.product(_ORDERS, "./-", _CLOCKS)]
    fitting = [form for form in forms if not pd.isna(pd.to_datetime(points.iloc[0], format=form, errors="coerce"))]
    every = [pd.to_datetime(points, format=form, errors="coerce") for form in fitting]
    readings = [read for read in every if not read.isna().any()]
    if any(not (read == readings[0]).all() for read in readings[1:]):
        said = f"day and month of {texts.iloc[0]!r} are ambiguous"
        raise InputError(f"{source}: column {column!r}: {said}. Write dates as 2026-02-28 12:00:00.")
    return readings[0] if readings else None
