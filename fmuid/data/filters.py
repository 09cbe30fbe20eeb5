"""Zero-phase filters, resampling, gaps, trends and thinning; missing samples stay missing."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.data.interpolation import HELD
from fmuid.errors import InputError

GAP = 1.5
"""A step longer than so many usual ones is a gap, in which samples are missing."""
FILLED = 20
"""Sampling intervals that a filled gap may last by default: an interruption of a logger, not a pause."""
SAME = 1e-6
"""Share of a step by which times that are the same may differ: they are rounded decimals."""


def usual_step(times: Floats) -> float:
    """Return the median step of time, s."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def missing_rows(times: Floats, most: float = FILLED) -> Indices:
    """Return the rows (from 0) before gaps of more than `most` samples.

    A gap lies between equal steps. Frequent or adjacent long steps are the sampling itself.
    """
    steps = np.diff(times)
    usual = usual_step(times)
    alone = (steps > 0) & (steps <= GAP * usual)
    found = np.flatnonzero((steps[1:-1] > most * usual * (1 + SAME)) & alone[:-2] & alone[2:]) + 1
    # more long steps than 2 % are the sampling itself
    return found if found.size <= max(1.0, 0.02 * steps.size) else found[:0]


def dropouts(times: Floats) -> tuple[float, ...]:
    """Return the times, s, after which samples are missing."""
    return tuple(times[missing_rows(times, GAP)].tolist())


def with_missing_rows(times: Floats, longest: float) -> tuple[Floats, Indices]:
    """Return times with missing ones inserted, and their rows (-1: inserted)."""
    usual, after = usual_step(times), missing_rows(times)
    lengths = times[after + 1] - times[after]
    counts = [round(each / usual) - 1 if each <= longest * (1 + SAME) else 1 for each in lengths.tolist()]
    new = [times[row] + usual * np.arange(1, count + 1) for row, count in zip(after.tolist(), counts, strict=True)]
    at = np.repeat(after + 1, counts)
    return np.insert(times, at, np.concatenate([[], *new])), np.insert(np.arange(times.size), at, -1)


def check_equal_steps(times: Floats, word: str, source: str) -> None:
    """Refuse unequal steps of time other than gaps."""
    steps, usual = np.diff(times), usual_step(times)
    # clocks of loggers jitter
    odd = np.flatnonzero((np.abs(steps - usual) > 0.01 * usual) & (steps <= GAP * usual))
    if usual <= 0 or odd.size:
        row = int(odd[0]) if odd.size else 0
        said = f"unequal sampling, {steps[row]:.6g} s after row {row + 1}, usually {usual:.6g} s"
        raise InputError(f"{source}: {word}: {said}. Filter before resampling, or remove {word}.")


def low_passed(times: Floats, values: Floats, frequency: float, source: str) -> Floats:
    """Return columns (K, n), low-passed between gaps; frequency in Hz."""
    from scipy.signal import butter, sosfiltfilt

    check_equal_steps(times, "lowpass_frequency", source)
    rate = 1.0 / usual_step(times)
    if not 0 < frequency < rate / 2:
        said = f"{frequency:g} Hz must be below half the sampling rate, {rate / 2:g} Hz"
        raise InputError(f"{source}: lowpass_frequency = {said}. Lower or remove it.")
    sections = butter(2, frequency, fs=rate, output="sos")
    reach = 3 * (2 * len(sections) + 1)  # what scipy continues at either end by default
    found = np.full_like(values, np.nan)
    breaks = np.diff(times) > GAP / rate
    for k in range(values.shape[1]):
        for stretch in _stretches(np.isfinite(values[:, k]), breaks):
            if stretch.size >= 4:
                ends = min(reach, stretch.size - 1)
                found[stretch, k] = sosfiltfilt(sections, values[stretch, k], padlen=ends)
    return found


def _stretches(there: Flags, breaks: Flags) -> list[Indices]:
    """Return the rows of each stretch without missing samples and gaps."""
    rows = np.flatnonzero(there)
    part = np.concatenate([[0], np.cumsum(breaks)])[rows]
    cuts = np.flatnonzero((np.diff(rows) > 1) | (np.diff(part) > 0)) + 1
    return [each for each in np.split(rows, cuts) if each.size]


def filling_keys(times: Floats, values: Floats, column: str) -> str:
    """Return the keys that fill an input's gaps and cut its ends."""
    own = times[np.isfinite(values)]
    longest = float(np.diff(own).max(initial=0.0))
    keys = [f'fill_missing = {{ {json.dumps(column)} = "linear" }}']
    keys += [f"max_gap = {longest:.9g}"] * bool(longest > FILLED * usual_step(times))
    ends = (("start_time", own[:1], times[0]), ("end_time", own[-1:], times[-1]))
    keys += [f"{key} = {each[0]:.9g}" for key, each, end in ends if each.size and each[0] != end]
    return f"preprocess = {{ {', '.join(keys)} }}"


def filled(
    times: Floats, values: Floats, how: str, longest: float | None, within: tuple[float, float], called: str
) -> Floats:
    """Return a column (K,) with gaps up to `longest`, s, filled."""
    there, gone = np.flatnonzero(np.isfinite(values)), np.flatnonzero(~np.isfinite(values))
    if not gone.size:
        return values
    place = np.searchsorted(there, gone)
    first, last = place == 0, place == there.size
    rows = np.append(there, times.size - 1)  # of a column without a sample all are first
    before, after = rows[np.maximum(place - 1, 0)], rows[place]
    length = times[after] - times[before]
    alone = first | (last if how == "linear" else False)
    needed = (times[gone] >= within[0]) & (times[gone] <= within[1])
    limit, said_so = (FILLED * usual_step(times), f"{FILLED} intervals") if longest is None else (longest, "max_gap")
    long = ~alone & (length > limit * (1 + SAME))
    for bad in np.flatnonzero((alone | long) & needed)[:1]:
        said = f"{called}: no value at t = {times[gone[bad]]:.9g} s"
        if alone[bad]:
            raise InputError(f"{said} and none {'before' if first[bad] else 'after'} it. Cut the data there.")
        gap = f"in a gap of {length[bad]:.6g} s; limit {said_so} = {limit:g} s"
        raise InputError(f"{said} {gap}. Raise max_gap or cut the data there.")
    share = np.where(length > 0, (times[gone] - times[before]) / np.where(length > 0, length, 1.0), 0.0)
    found, slope = values.copy(), values[after] - values[before] if how == "linear" else 0.0
    kept = ~(alone | long)
    found[gone[kept]] = (values[before] + share * slope)[kept]
    return found


def resampled(
    times: Floats, values: Floats, interpolation: Sequence[str], step: float, source: str
) -> tuple[Floats, Floats]:
    """Return times in equal steps, s, and columns (K, n) there; NaN in gaps."""
    twice = np.flatnonzero(np.diff(times) == 0)
    if twice.size:
        at = f"t = {times[twice[0]]:.9g} s"
        raise InputError(f"{source}: resample_interval: two samples at {at}. Keep one, or do not resample.")
    count = int((times[-1] - times[0]) / step + SAME) + 1
    if count < 2:
        raise InputError(f"{source}: resample_interval = {step:g} s is longer than the data. Reduce it.")
    at = np.minimum(times[0] + step * np.arange(count), times[-1])
    before = np.searchsorted(times, at + SAME * step, side="right") - 1
    same = np.abs(times[before] - at) <= SAME * step
    after = np.where(same, before, np.minimum(before + 1, times.size - 1))
    length = times[after] - times[before]
    share = np.where(same, 0.0, (at - times[before]) / np.where(same, 1.0, length))
    gap = length > GAP * max(usual_step(times), step)
    found = values[before] + share[:, None] * (values[after] - values[before])
    for k, word in enumerate(interpolation):
        if word in HELD:
            found[:, k] = values[before if word == "zoh" else after, k]
    found[gap] = np.nan
    return at, found


def detrended(times: Floats, values: Floats, degree: int) -> Floats:
    """Return columns (K, n) without mean (degree 0) or straight line (1)."""
    found = values.copy()
    for k in range(values.shape[1]):
        there = np.isfinite(values[:, k])
        if there.sum() > degree:
            centered = times - times[there].mean()
            found[:, k] -= np.polyval(np.polyfit(centered[there], values[there, k], degree), centered)
    return found


def extremes(columns: Floats, count: int) -> Indices:
    """Return the rows that draw the same lines: extremes of each stretch.

    Parameters
    ----------
    columns : (K, m) array
        Lines over one abscissa; NaN in gaps.
    count : int
        Approximate number of rows.
    """
    samples, lines = columns.shape
    if samples <= count:
        return np.arange(samples)
    size = math.ceil(samples / max(1, count // (2 * lines)))
    whole = samples // size * size
    blocks = columns[:whole].reshape(-1, size, lines)
    first = np.arange(0, whole, size)[:, None]
    found = [*(first + each for each in _ends(blocks)), *(whole + each for each in _ends(columns[None, whole:]))]
    return np.unique(np.concatenate([[0, samples - 1], *(each.ravel() for each in found)]))


def _ends(blocks: Floats) -> tuple[Indices, ...]:
    """Return places of minima and maxima of blocks (n, size, m)."""
    ends = [(np.argmin, np.inf), (np.argmax, -np.inf)] if blocks.shape[1] else []
    return tuple(place(np.where(np.isnan(blocks), limit, blocks), axis=1) for place, limit in ends)


def evenly(samples: int, count: int) -> Indices:
    """Return at most `count` evenly spaced rows, first and last included."""
    return np.unique(np.linspace(0, samples - 1, min(samples, count)).round().astype(np.intp))
