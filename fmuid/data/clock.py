"""Time columns: their name, unit and dates, converted to seconds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.coarse_clock import regular_times
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.headers import RawTable
from fmuid.data.several_clocks import assigned, joined, resolution, same_clock
from fmuid.data.time_names import (
    TIME_NAMES,
    counts_part,
    is_time_name,
    is_unit_of_time,
    plain_name,
    unit_in_time_name,
)
from fmuid.data.time_numbers import (
    DATES,
    clock_in_digits,
    dates_in_digits,
    dates_of_days,
    may_be_days,
    may_be_fractions,
    since_1970,
)
from fmuid.data.time_texts import check_local_times, days_of, seconds_of, time_of_day, times_of
from fmuid.errors import InputError
from fmuid.units import SECONDS, TIME_UNITS, time_unit

REMEDY = "Name it, give sample_rate, or a kind for rows without times."
_WITH_SUFFIX = re.compile(rf"(.*\S)[_ ]({'|'.join(SECONDS)})", re.IGNORECASE)
_OF_EXTREMES = re.compile(r"_TM[nx]$|\btime of (max|min|peak)", re.IGNORECASE)
"""Names of times that are data: of the extremes since the row before."""
_PARTS = (1e-3, 1e-6, 1e-9)
"""Units of columns beside times of whole seconds, s."""


def time_name(time: str | int) -> str:
    """Return the final name of the time column."""
    return time if isinstance(time, str) else "time"


@dataclass(frozen=True)
class TimedTable:
    """Table with time in s: the first date, the time column of each column, and what was left out or done, and why."""

    frame: pd.DataFrame
    begin: pd.Timestamp | None = None
    clocks: Mapping[str, str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Clock:
    """Time column in s, NaN where empty."""

    name: str
    values: Any
    begin: pd.Timestamp | None

    def seconds(self, begin: pd.Timestamp | None = None) -> Floats:
        """Return times in s, of dates from another one on."""
        values = np.asarray(self.values, dtype=np.float64)
        if self.begin is None or begin is None or not self.has_zone_as(begin):
            return values
        return values + (self.begin - begin).total_seconds()

    def has_zone_as(self, begin: pd.Timestamp | None) -> bool:
        """Return whether times count from zeros that compare."""
        if self.begin is None or begin is None:
            return self.begin is begin
        return (self.begin.tzinfo is None) == (begin.tzinfo is None)


def with_time(
    raw: RawTable, time: str | int, unit: str | None, sample_rate: float | None, clocks: Mapping[str, str], source: str
) -> TimedTable:
    """Return a table with time in s; columns of several time columns come to one time axis."""
    name = time_name(time)
    if sample_rate is not None and name not in raw.frame.columns:
        return TimedTable(raw.frame.assign(**{name: np.arange(len(raw.frame)) / sample_rate}))
    if unit is not None and unit not in SECONDS:
        raise InputError(f"{source}: time_unit {unit!r} is unknown. Use {', '.join(TIME_UNITS)}.")
    column = time_column(raw, time, source)
    if column is None and raw.step is not None and sample_rate is None:
        return _by_the_lines_above(raw, name, raw.step, source)
    if column is None:
        raise InputError(f"{source}: {missing_column('time', str(time), raw.frame.columns, REMEDY)}")
    main = _clock(raw, column, unit, source)
    if not pd.api.types.is_numeric_dtype(np.asarray(main.values).dtype):  # refused by the reader, with its row
        return TimedTable(raw.frame.rename(columns={column: name}))
    if unit is not None and main.begin is not None and not pd.api.types.is_numeric_dtype(raw.frame[column].dtype):
        said = f"time column {column!r} has dates; time_unit is for numbers"
        raise InputError(f"{source}: {said}. Remove it, or set model_time_unit for that of the FMU.")
    main = _with_parts(raw, _with_days(raw, main, source))
    main, others, notes = _other_clocks(raw, main, unit, clocks, source)
    frame = raw.frame
    if others:
        seconds = {each.name: each.seconds(main.begin) for each in (main, *others)}
        names = [str(each) for each in frame.columns]
        there = {each: raw.frame[each].notna().to_numpy() for each in names}
        there |= {clock: np.isfinite(values) for clock, values in seconds.items()}
        given = clocks or raw.clocks
        found = {each: given.get(each, main.name) for each in names if each not in seconds}
        found = {each: clock if clock in seconds else main.name for each, clock in found.items()}  # the same times
        filled = [each for each in names if there[each].any()]
        found |= {} if given else assigned(filled, [each for each in filled if each in seconds], there, source)
        final = {each: f"{clock} 1" if clock == name else clock for each, clock in found.items()}
        return TimedTable(joined(frame, name, seconds, found, source), main.begin, final, notes)
    frame = frame.assign(**{main.name: main.values}).rename(columns={main.name: name})
    times = np.asarray(frame[name], dtype=np.float64)
    regular = regular_times(times, frame.drop(columns=name), sample_rate, name, source)
    if regular is not None:
        said = f"repeated; rebuilt with {regular[1] - regular[0]:.6g} s between rows"
        return TimedTable(frame.assign(**{name: regular}), main.begin, notes=notes | {name: said})
    if sample_rate is not None:
        raise InputError(f"{source}: column {name!r} and sample_rate are both given. Give one of them.")
    return TimedTable(frame, main.begin, notes=notes)


def _by_the_lines_above(raw: RawTable, name: str, step: float, source: str) -> TimedTable:
    """Return a table at the times said above the header."""
    rows = len(raw.frame)
    if raw.rows and rows % raw.rows:  # loggers write several times
        said = f"{rows} rows of samples, {raw.rows} by the lines above the header"
        raise InputError(f"{source}: {said}. Write the whole file again, or set sample_rate.")
    count = raw.frame.iloc[:, 0]
    skips = np.flatnonzero(np.diff(count) != 1) if pd.api.types.is_integer_dtype(count.dtype) else np.zeros(0, int)
    if 0 < skips.size < 0.1 * rows:
        said = f"row numbers in column {str(count.name)!r} do not go on in row {skips[0] + 2}"
        raise InputError(f"{source}: {said}. Write times into a column.")
    said = f"no time column; {step:.6g} s between rows by the lines above the header"
    return TimedTable(raw.frame.assign(**{name: step * np.arange(rows)}), notes={name: said})


def _clock(raw: RawTable, column: str, unit: str | None, source: str, usual: str | None = None) -> _Clock:
    """Return a time column in s; `usual` is its unit where nothing says one."""
    values, begin = times_of(raw.frame[column], column, source, raw.units.get(column, column))
    if begin is not None and begin.tzinfo is None:
        check_local_times(raw.frame[column], (np.asarray(values, dtype=np.float64), begin), column, source)
    if begin is None and (dates := dates_in_digits(values)) is not None:
        values, begin = seconds_of(dates)
    if begin is None and unit is None and (clock := clock_in_digits(values)) is not None:
        values = clock
    said_unit = unit or _unit_said(raw, column)
    is_number = pd.api.types.is_numeric_dtype(raw.frame[column].dtype)  # else the unit may be hh:mm:ss
    if begin is None and said_unit is None and column in raw.units and is_number:
        said = f"time column {column!r} has the unit {raw.units[column]!r}, which is no time"
        raise InputError(f'{source}: {said}. Set time_unit, such as "s", or another time column.')
    if begin is None and (unit_since := since_1970(values, said_unit)):
        values, begin = seconds_of(pd.to_datetime(values, unit=unit_since))
    if begin is None and (dates := dates_of_days(values, column, said_unit)) is not None:
        values, begin = seconds_of(dates)
    if said_unit is None and (column in raw.days or (begin is None and may_be_days(values))):
        raise InputError(f'{source}: column {column or "(no name)"!r} may be in days. Set time_unit = "d" or "s".')
    if begin is None and said_unit is None and usual is None and may_be_fractions(values):
        raise InputError(f'{source}: column {column!r} may be in ms, µs or ns. Set time_unit, such as "us".')
    numeric = pd.api.types.is_numeric_dtype(values.dtype)  # texts are refused by the reader, with their row
    factor = SECONDS[said_unit or usual or "s"] if begin is None and numeric else 1.0
    return _Clock(column, values if factor == 1.0 else _scaled(values, factor), begin)


def _other_clocks(
    raw: RawTable, main: _Clock, unit: str | None, given: Mapping[str, str], source: str
) -> tuple[_Clock, list[_Clock], dict[str, str]]:
    """Return the main and further time columns with times of their own; others by the reason that they are left out."""
    names = [str(name) for name in raw.frame.columns]
    for column in (*given, *given.values()):
        if column not in names:
            raise InputError(f"{source}: {missing_column('clocks', column, names)}")
    said = {*(given or raw.clocks).values()} - {main.name}
    asked = [each for each in names if each in said] if given or raw.clocks else [n for n in names if n != main.name]
    usual = unit or _unit_said(raw, main.name)
    found, notes = list[_Clock](), dict[str, str]()
    for name in asked:
        clock = _clock(raw, name, unit, source, usual) if said else _likely_clock(raw, name, unit, usual, source)
        if clock is None:
            continue
        if not pd.api.types.is_numeric_dtype(np.asarray(clock.values).dtype):
            raise InputError(f"{source}: time column {name!r} has texts. Write dates as 2026-02-28 12:00:00.")
        times, other = main.seconds(), clock.seconds(main.begin)
        if slow := unit is None and main.name not in notes and _unit_by_dates(raw, main, clock):
            main = replace(main, values=_scaled(main.values, SECONDS[slow]))
            times, notes[main.name] = main.seconds(), f"counts in {slow} by the dates of {name!r}"
        if slow := unit is None and _unit_by_dates(raw, clock, main):
            notes[name] = f"the same times as {main.name!r}, in {slow}"
            continue
        apart = not _overlap(times, other) or not clock.has_zone_as(main.begin)
        trails = names[0] == main.name and not any(_is_data(raw, each) for each in names[names.index(name) + 1 :])
        if same_clock(times, other, anywhere=apart):
            notes[name] = f"the same times as {main.name!r}"
        elif apart and trails and not said:
            notes[name] = f"times without a common zero with {main.name!r}, and no columns after them"
        else:
            found.append(clock)
    return main, found, notes


def _unit_by_dates(raw: RawTable, clock: _Clock, dated: _Clock) -> str | None:
    """Return the unit of numbers without one, by the dates beside them; None for s."""
    column = raw.frame[clock.name]
    bare = clock.begin is None and _unit_said(raw, clock.name) is None and pd.api.types.is_numeric_dtype(column.dtype)
    if not bare or dated.begin is None:
        return None
    span, length = (float(np.fmax.reduce(each) - np.fmin.reduce(each)) for each in (clock.seconds(), dated.seconds()))
    units = ("ms", "min", "h", "d")
    return next((each for each in units if abs(span * SECONDS[each] - length) < 0.01 * length), None)


def _is_data(raw: RawTable, name: str) -> bool:
    return bool(pd.api.types.is_numeric_dtype(raw.frame[name].dtype)) and not is_time_name(name)


def _overlap(one: Floats, other: Floats) -> bool:
    first = np.maximum(np.fmin.reduce(one), np.fmin.reduce(other))
    return bool(np.minimum(np.fmax.reduce(one), np.fmax.reduce(other)) > first)


def _likely_clock(raw: RawTable, name: str, unit: str | None, usual: str | None, source: str) -> _Clock | None:
    """Return a time column if name, unit and values say so."""
    said, series = raw.units.get(name), raw.frame[name]
    if _OF_EXTREMES.search(name):
        return None
    dated = pd.api.types.is_datetime64_any_dtype(series.dtype)
    timed = said is not None and time_unit(said) is not None
    if (said is not None and not timed) or not (dated or timed or is_time_name(name)) or counts_part(name):
        return None
    try:
        clock = _clock(raw, name, unit if said is None else None, source, usual)
        times = clock.seconds()
    except (InputError, ValueError, TypeError):
        return None
    steps = np.diff(times[np.isfinite(times)])
    if steps.size < 2 or (steps < 0).any() or not (steps > 0).any():
        return None
    if clock.begin is not None and (steps == 0).any() and not (steps % SECONDS["d"]).any():  # days of other times
        return None
    usual_one = np.median(steps)
    regular = float((np.abs(steps - usual_one) <= 0.5 * usual_one).mean()) > 0.9
    return clock if dated or timed or clock.begin is not None or regular else None


def _of_time(unit: str) -> bool:
    """Return whether a unit is a word for time."""
    return plain_name(unit) in TIME_NAMES


def _are_times(values: Any, source: str, mostly: float = 1.0) -> bool:
    """Return whether an unnamed column holds dates or times, not row numbers; `mostly` is the share of increases."""
    try:
        numbers, begin = times_of(values, "", source)
        steps = np.diff(np.asarray(numbers, dtype=np.float64))
    except (InputError, ValueError, TypeError):
        return False
    return bool(steps.size and (steps > 0).mean() >= mostly and (begin is not None or np.median(steps) != 1))


def _increases(column: pd.Series[Any]) -> bool:
    values = pd.to_numeric(column, errors="coerce").dropna()
    return bool(values.is_monotonic_increasing or not pd.api.types.is_numeric_dtype(column.dtype))


def _scaled(values: Any, factor: float) -> Any:
    """Return times in s, by division where it rounds less: 3 ms are 0.003 s."""
    return values / round(1 / factor) if factor < 1 else values * factor


def _with_parts(raw: RawTable, clock: _Clock) -> _Clock:
    """Return a clock with the parts of seconds in another column."""
    units = {str(name): _part_of_seconds(raw, str(name)) for name in raw.frame.columns if name != clock.name}
    found = [(name, unit) for name, unit in units.items() if unit and raw.frame[name].dtype.kind in "iuf"]
    if len(found) != 1:
        return clock
    parts = raw.frame[found[0][0]].to_numpy(dtype=np.float64) * found[0][1]
    values = clock.seconds()
    whole = bool(np.isfinite(values).all() and not (values % 1.0).any() and (np.diff(values) == 0.0).any())
    return replace(clock, values=values + parts) if whole and parts.min() >= 0.0 and parts.max() < 1.0 else clock


def _part_of_seconds(raw: RawTable, name: str) -> float | None:
    """Return the unit of parts of seconds, s: ``ms``, ``stamp.nsecs``, ``Time (ms)``."""
    said = raw.units.get(name, "") if is_time_name(name) else ""
    unit = SECONDS.get(said or unit_in_time_name(name) or "")
    return 1.0 if "fractional" in name.lower() else unit if unit in _PARTS else None


def _with_days(raw: RawTable, clock: _Clock, source: str) -> _Clock:
    """Return a clock of times of day with the dates beside it."""
    found = [str(name) for name in raw.frame.columns if plain_name(str(name)) in DATES and name != clock.name]
    if clock.begin is not None or len(found) != 1 or (part := time_of_day(raw.frame[clock.name])) is None:
        return clock
    days = days_of(raw.frame[found[0]], found[0], source, raw.units.get(found[0], found[0]))
    if days is None:
        return clock
    first = pd.Timedelta(seconds=float(part.iloc[0]))
    return replace(clock, values=days[0] + part - part.iloc[0], begin=days[1] + first)


def time_column(raw: RawTable, time: str | int, source: str) -> str | None:
    """Return the time column; None if there is none."""
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
        units = {name: raw.units.get(name) for name in names}
        timely = [each for each, unit in units.items() if unit is None or time_unit(unit) is not None or _of_time(unit)]
        plain = {name: plain_name(_bare(name)) for name in timely if _bare(name) != "T"}
        called = [name for known in TIME_NAMES for name in plain if plain[name] == known]
        if called and (best := _best_clock(raw, called, source)):
            return best
        if "T" in timely and _increases(raw.frame["T"]):  # else a temperature
            return "T"
        if names[0] == "" and _are_times(raw.frame[""], source):  # an index of pandas
            return ""
        likely = [name for name in timely if is_time_name(name) and _likely_clock(raw, name, None, None, source)]
        if likely:
            return likely[0]
        if called:
            return called[0]
        if time_unit(raw.units.get(names[0], "")) is not None and _are_times(raw.frame[names[0]], source, mostly=0.9):
            return names[0]
        counted = [name for name in timely if is_unit_of_time(name) and _are_times(raw.frame[name], source)]
        if len(counted) == 1:
            return counted[0]
        texts = [str(name) for name in raw.frame.select_dtypes(exclude="number").columns]
        dated = [name for name in texts if _are_times(raw.frame[name].head(1000), source)]
        if dated:
            return dated[0]
    return None


def _best_clock(raw: RawTable, names: Sequence[str], source: str) -> str | None:
    """Return the time column that increases, the least rounded of several; None if there is none."""
    raw = replace(raw, frame=raw.frame.head(1000))  # which decide
    known = {name: clock for name in names if (clock := _read_clock(raw, name, source)) is not None}
    ranks = {name: _rank(clock) for name, clock in known.items()}
    dated = next(
        (known[name] for name, rank in ranks.items() if rank[0] == 0.0 and known[name].begin is not None), None
    )
    ranks = {name: rank for name, rank in ranks.items() if dated is None or _lasts_as(known[name], dated)}
    if not ranks:
        return None
    best = min(ranks, key=ranks.__getitem__)
    others = [str(name) for name in raw.frame.columns if is_time_name(str(name)) and str(name) not in known]
    for name in others if ranks[best] > (0.0, 1.0) else ():
        clock = _likely_clock(raw, name, None, None, source)
        if (
            clock is not None
            and _rank(clock) < ranks[best]
            and same_clock(known[best].seconds(), clock.seconds(), anywhere=True)
        ):
            return name
    return best


def _lasts_as(clock: _Clock, dated: _Clock) -> bool:
    """Return whether times last as long as dates, up to their rounding."""
    span, length = (float(np.ptp(each[np.isfinite(each)])) for each in (clock.seconds(), dated.seconds()))
    return abs(span - length) <= 0.01 * length + 2 * resolution(dated.seconds())


def _rank(clock: _Clock) -> tuple[float, float, float]:
    """Return whether times go back, whether they repeat, and their rounding, s."""
    times = clock.seconds()
    steps = np.diff(times[np.isfinite(times)])
    return float((steps < 0).any() or not steps.any()), float((steps == 0).any()), resolution(times)


def _read_clock(raw: RawTable, name: str, source: str) -> _Clock | None:
    try:
        clock = _clock(raw, name, None, source)
        return clock if np.isfinite(clock.seconds()).any() else None
    except (InputError, ValueError, TypeError):
        return None


def _bare(name: str) -> str:
    """Return a name without a unit suffix: ``time_ms`` is ``time``."""
    found = _WITH_SUFFIX.fullmatch(name)
    return found[1] if found else name


def _unit_said(raw: RawTable, column: str) -> str | None:
    """Return the time unit stated by the table, if any."""
    said = raw.units.get(column)
    if said is not None and time_unit(said) is not None:
        return time_unit(said)
    if said is not None:
        return None
    suffix, numeric = _WITH_SUFFIX.fullmatch(column), pd.api.types.is_numeric_dtype(raw.frame[column].dtype)
    return suffix[2].lower() if suffix else unit_in_time_name(column) if numeric else None
