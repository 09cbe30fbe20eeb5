"""Time stamps coarser than the sampling: found, and replaced by the regular times behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.errors import InputError


@dataclass(frozen=True)
class CoarseClockSettings:
    """Numbers of the decision."""

    repeated: float = 0.02  # share of repeated stamps; fewer are steps of an input
    max_relative_width: float = 1e-3  # of the possible intervals: the time scale is that uncertain
    max_width_round: float = 1e-2  # the same around an interval or a rate of one digit
    step_ratio: float = 5.0  # of changes within pairs of one stamp to others: a step, no coarse clock
    min_rows: int = 20  # fewer show no pattern
    max_devices: int = 20  # in the rows of one table
    min_changes: int = 10  # of a column that is asked


SETTINGS = CoarseClockSettings()


def regular_times(times: Floats, columns: pd.DataFrame, rate: float | None, name: str, source: str) -> Floats | None:
    """Return the regular times behind coarse stamps, s; None if stamps are no coarse ones.

    Parameters
    ----------
    times : (K,) array
        Stamps, s.
    columns : DataFrame
        Other columns: a step of an input is no coarse stamp.
    rate : float or None
        Samples per second, if given.
    name, source : str
        Time column and file in messages.

    Raises
    ------
    InputError
        If stamps are coarse and the interval cannot be known from them, or `rate` contradicts them.
    """
    steps = np.diff(times)
    if times.size < SETTINGS.min_rows or not np.isfinite(times).all() or (steps < 0).any() or not (steps > 0).any():
        return None
    pairs = steps == 0
    thrice = bool((pairs[1:] & pairs[:-1]).any())
    if pairs.mean() <= SETTINGS.repeated and not thrice:
        return None
    _check_devices(times, columns, source)
    resolution = float(steps[steps > 0].min())
    if not _on_grid(steps, resolution):
        return None
    low, high = _possible_intervals(times, resolution)
    if rate is not None:
        wide = 1e-9 / rate
        if not low - wide <= 1 / rate <= high + wide:
            said = f"sample_rate = {rate:g} contradicts {times.size} rows from {times[0]:g} to {times[-1]:g} s"
            raise InputError(f"{source}: {said}. Correct or remove it.")
        return np.asarray(times[0] + np.arange(times.size) / rate)
    if not thrice and _are_steps(columns, pairs):
        return None
    said = f"time column {name!r} repeats {int(pairs.sum())} of {times.size} times (steps of {resolution:.3g} s)"
    found = _shortest(low, high)
    one_digit = any(f"{each:.0e}" == f"{each:.9e}".replace(".000000000", "") for each in (found, 1 / found))
    widest = SETTINGS.max_width_round if one_digit else SETTINGS.max_relative_width
    if low > high or high - low > widest * high:
        more = " and the rows are not regular" if low > high else ""
        raise InputError(f"{source}: {said}{more}. Set sample_rate, or write more digits.")
    return np.asarray(times[0] + np.arange(times.size) * found)


def _check_devices(times: Floats, columns: pd.DataFrame, source: str) -> None:
    """Refuse rows of several devices that a column of texts tells apart."""
    for name, column in columns.select_dtypes(["object", "str"]).items():
        apart = not pd.DataFrame({"time": times, "device": column.to_numpy()}).duplicated().any()
        if 1 < column.nunique() <= SETTINGS.max_devices and apart:
            called = f"column {name!r}" if name else "the column without a name"
            raise InputError(f"{source}: {called} has several values at one time. Keep the rows of {column.iloc[0]!r}.")


def _possible_intervals(times: Floats, resolution: float) -> tuple[float, float]:
    """Return the least and largest interval of regular samples that stamps allow; the first is larger if none."""
    k = np.arange(times.size, dtype=np.float64)
    limit = resolution * (1 + 1e-6)
    middle = float((times[-1] - times[0]) / (times.size - 1))

    def spread(interval: float) -> float:
        return float(np.ptp(times - times[0] - interval * k))

    reach = 2 * resolution / (times.size - 1)
    low, high = middle - reach, middle + reach
    for _ in range(60):  # the spread is convex in the interval
        a, b = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, b) if spread(a) < spread(b) else (a, high)
    best = (low + high) / 2
    if spread(best) > limit:
        return 1.0, 0.0
    ends = []
    for outside in (middle - reach, middle + reach):
        inside = best
        for _ in range(50):
            half = (inside + outside) / 2
            inside, outside = (half, outside) if spread(half) <= limit else (inside, half)
        ends.append(inside)
    return min(ends), max(ends)


def _shortest(low: float, high: float) -> float:
    """Return the interval between two with the fewest digits, or its rate."""
    middle = abs(low + high) / 2
    for digits in range(1, 17):
        for value in (float(f"{middle:.{digits}g}"), 1 / float(f"{1 / middle:.{digits}g}")):
            if low <= value <= high:
                return value
    return middle


def _on_grid(steps: Floats, resolution: float) -> bool:
    """Return whether steps are multiples of the least one."""
    ratio = steps / resolution
    return bool(np.abs(ratio - np.round(ratio)).max() < 1e-3)


def _are_steps(columns: pd.DataFrame, pairs: Flags) -> bool:
    """Return whether a column changes otherwise within pairs of one stamp."""
    for _, series in columns.items():
        if not pd.api.types.is_numeric_dtype(series.dtype) or pd.api.types.is_bool_dtype(series.dtype):
            continue
        changes = np.abs(np.diff(series.to_numpy(dtype=np.float64, na_value=np.nan)))
        if (np.isfinite(changes) & (changes > 0)).sum() < SETTINGS.min_changes:
            continue
        inside, outside = changes[pairs], changes[~pairs]
        if not np.isfinite(inside).any():
            return True
        ratio = float(np.nanmean(inside)) / (float(np.nanmean(outside)) or np.inf)
        if not np.isfinite(ratio) or not 1 / SETTINGS.step_ratio <= ratio <= SETTINGS.step_ratio:
            return True
        if ratio == 0:
            return True
    return False
