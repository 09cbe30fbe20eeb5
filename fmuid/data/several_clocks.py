"""Tables with several time columns: each column at its own times, all on one time axis."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_float_dtype, is_numeric_dtype

from fmuid.array_types import Flags, Floats
from fmuid.data.filters import GAP, SAME, usual_step
from fmuid.data.interpolation import HELD
from fmuid.errors import InputError

CLOCKS = "clocks"
"""Attribute of a frame: column to time column. A time column has NaN in rows that are not its own."""
_GRIDS = (1.0, 0.1, 0.01)
"""Steps of rounded times, s."""
_JITTER = 0.05
"""Share of a step by which times of one row may differ besides a constant that nobody knows."""
_WORDS = re.compile(r"[^\W\d_]+|\d+")


def same_clock(one: Floats, other: Floats, *, anywhere: bool = False) -> bool:
    """Return whether two time columns are one, `anywhere`: up to a constant; the coarser may be rounded."""
    there = np.isfinite(one)
    if not np.array_equal(there, np.isfinite(other)) or there.sum() < 2:
        return False
    difference = other[there] - one[there]
    if anywhere:
        difference = difference - difference[0]
    coarser = max((resolution(each[there]) for each in (one, other)), default=0.0)
    usual = usual_step(one[there])
    limit = max(coarser * (1 + SAME), _JITTER * usual)
    rounded = anywhere and float(np.ptp(difference)) <= limit
    if rounded or float(np.abs(difference).max()) <= 100 * SAME * usual:
        return True
    return anywhere and _keep_step(one, other, limit)


def _keep_step(one: Floats, other: Floats, limit: float) -> bool:
    """Return whether two clocks share their uneven steps."""
    steps, others = np.diff(one), np.diff(other)
    usual = usual_step(one)
    uneven = np.abs(steps - usual) > usual / 2
    alike = np.abs(steps - others) <= limit
    return bool(uneven.mean() > 0.01 and alike.mean() > 0.99 and alike[uneven].mean() > 0.9)


def resolution(times: Floats) -> float:
    """Return the step of repeated or rounded times, s; 0 of others."""
    steps = np.diff(times[np.isfinite(times)])
    if steps.size == 0:
        return 0.0
    if (steps == 0).any() and (steps > 0).any():
        return float(steps[steps > 0].min())
    multiples = ((grid, steps / grid) for grid in _GRIDS)
    return next((grid for grid, each in multiples if np.abs(each - np.round(each)).max() < SAME), 0.0)


def assigned(names: Sequence[str], clocks: Sequence[str], there: Mapping[str, Flags], source: str) -> dict[str, str]:
    """Return the time column of each column: by the words of names, else by position.

    Raises
    ------
    InputError
        If neither decides, or a column has samples where its time column has none.
    """
    columns = [name for name in names if name not in clocks]
    found = _by_words(columns, clocks) or _by_position(names, clocks, source)
    for column, clock in found.items():
        if (there[column] & ~there[clock]).any():
            raise _undecided(clocks, column, source)
    return found


def _by_words(columns: Sequence[str], clocks: Sequence[str]) -> dict[str, str]:
    """Return clocks by additions to their names that columns share: ``t_fast`` and ``u_fast``."""
    words = {clock: set(_WORDS.findall(clock.lower())) for clock in clocks}
    shared = set.intersection(*words.values())
    own = {clock: each - shared - {"time", "t", "zeit", "timestamp"} for clock, each in words.items()}
    plain = [clock for clock in clocks if not own[clock]]
    if len(plain) > 1 or any(word.isdecimal() for each in own.values() for word in each):
        return {}
    found: dict[str, str] = {}
    for column in columns:
        has = set(_WORDS.findall(column.lower()))
        fitting = [clock for clock in clocks if own[clock] and own[clock] <= has] or plain
        if len(fitting) != 1:
            return {}
        found[column] = fitting[0]
    return found if {*found.values()} == {*clocks} else {}


def _by_position(names: Sequence[str], clocks: Sequence[str], source: str) -> dict[str, str]:
    """Return the last clock before each column; each clock has columns, and the first comes first."""
    found: dict[str, str] = {}
    clock = ""
    for name in names:
        clock = name if name in clocks else clock
        if name not in clocks:
            if not clock:
                raise _undecided(clocks, name, source)
            found[name] = clock
    if {*found.values()} != {*clocks}:
        raise _undecided(clocks, next(iter(found), ""), source)
    return found


def _undecided(clocks: Sequence[str], column: str, source: str) -> InputError:
    listed = ", ".join(map(repr, clocks))
    remedy = f'Set clocks = {{ "{column}" = "{clocks[-1]}" }}, or {{ "{clocks[-1]}" = "{clocks[0]}" }} to ignore it.'
    return InputError(f"{source}: several time columns, {listed}; that of {column!r} is not clear. {remedy}")


def joined(
    frame: pd.DataFrame, time: str, seconds: Mapping[str, Floats], clocks: Mapping[str, str], source: str
) -> pd.DataFrame:
    """Return columns at the times of all clocks, NaN at others; s.

    Raises
    ------
    InputError
        If a clock repeats or goes back, or two clocks have no time in common.
    """
    own: dict[str, Floats] = {}
    rows: dict[str, Flags] = {}
    for clock, times in seconds.items():
        rows[clock] = np.isfinite(times)
        own[clock] = times[rows[clock]]
        back = np.flatnonzero(np.diff(own[clock]) <= 0)
        if back.size or own[clock].size < 2:
            said = f"does not increase in row {back[0] + 2}" if back.size else "has fewer than two times"
            raise InputError(f"{source}: time column {clock!r} {said}. Sort its rows, or write a file for each.")
    first, last = max(each[0] for each in own.values()), min(each[-1] for each in own.values())
    if first >= last:
        names = ", ".join(map(repr, own))
        raise InputError(f"{source}: time columns {names} have no time in common. Write them with one zero.")
    every = np.sort(np.concatenate([*own.values()]))
    apart = np.diff(every, prepend=-np.inf) > SAME * min(map(usual_step, own.values()))
    times = every[apart]
    places = {clock: np.searchsorted(times, each * (1 + 1e-15), side="right") - 1 for clock, each in own.items()}
    found: dict[str, Any] = {time: times}
    for clock, place in places.items():
        at = np.full(times.size, np.nan)
        at[place] = own[clock]
        found[f"{clock} 1" if clock == time else clock] = at
    for column in frame.columns:
        if column in clocks:
            clock = clocks[column]
            samples = frame[column][rows[clock]]
            if is_float_dtype(samples.dtype):
                found[column] = np.full(times.size, np.nan)
                found[column][places[clock]] = samples.to_numpy()
            else:
                found[column] = samples.set_axis(places[clock]).reindex(np.arange(times.size))
    return pd.DataFrame(found)


def inputs_at_all_times(
    frame: pd.DataFrame, time: str, inputs: Mapping[str, str], outputs: Iterable[str], source: str
) -> pd.DataFrame:
    """Return a frame whose inputs have values at all times.

    `inputs` are columns with their interpolation.

    Rows of unused time columns, and those outside the times of an input, are left out.
    """
    clocks: Mapping[str, str] = frame.attrs.get(CLOCKS, {})
    own = {column: clocks.get(column, column) for column in (*inputs, *outputs)}
    timed = any(clock in frame.columns for column, clock in own.items() if clock != column)
    if not timed and not any(_is_slower(frame[time], frame[column]) for column in inputs):
        return frame
    times, rows = frame[time].to_numpy(dtype=np.float64), dict[str, Flags]()
    for column, clock in own.items():
        rows[column] = frame[clock if clock in frame.columns else column].notna().to_numpy()
        if not rows[column].any():
            raise InputError(f"{source}: column {column!r} has no sample here. Cut the data elsewhere.")
    kept, values = np.logical_or.reduce([*rows.values()]), dict[str, Floats]()
    for column, how in inputs.items():
        at, samples = times[rows[column]], np.array(frame[column], dtype=np.float64)
        samples[~rows[column]] = _between(at, samples[rows[column]], times[~rows[column]], how)
        values[column] = samples
        kept &= (times >= at[0]) & (times <= at[-1])
    found = frame.assign(**values)[kept].reset_index(drop=True)
    found.attrs = dict(frame.attrs)
    return found


def _is_slower(times: pd.Series[Any], column: pd.Series[Any], most: float = 0.6) -> bool:
    """Return whether a column has samples at a slower rate than others: in even steps, and no gaps."""
    there = column.notna().to_numpy()
    if not 5 <= there.sum() <= most * there.size or not is_numeric_dtype(times.dtype):
        return False
    steps = np.diff(times.to_numpy()[there])
    return bool(steps.min() > 0 and steps.max() <= GAP * np.median(steps))


def _between(times: Floats, values: Floats, at: Floats, how: str) -> Floats:
    """Return samples at other times by an input's interpolation."""
    if how in HELD:
        place = np.searchsorted(times, at, side="right") - (how == "zoh")
        return np.asarray(values[np.clip(place, 0, times.size - 1)])
    if how == "pchip" and times.size > 1:
        from scipy.interpolate import PchipInterpolator

        return np.asarray(PchipInterpolator(times, values)(np.clip(at, times[0], times[-1])))
    return np.interp(at, times, values)
