"""Residuals as series, each output on its own grid.

Samples without a grid are counted one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import fft

from fmuid.array_types import Floats, Indices
from fmuid.codec import Layout
from fmuid.data import Experiment


@dataclass(frozen=True)
class SeriesSettings:
    """Numbers of grids and periods."""

    regular_share: float = 0.95  # times are equally spaced if this share of the steps ...
    regular_tolerance: float = 0.2  # ... are whole multiples of the usual one, within this share of it
    longest_gap: int = 1000  # samples; longer gaps count as this
    pooled: int = 100  # samples; shorter experiments share one noise model per output and step
    same_step: float = 1e-3  # relative difference of equal steps
    repeated: float = 0.05  # inputs repeat within this share of their std ...
    away: float = 0.5  # ... after being further apart than this
    longest: float = 0.55  # longest period, share of the record: nearly two cycles


SETTINGS = SeriesSettings()


@dataclass(frozen=True, eq=False)
class OutputSeries:
    """One output of one experiment.

    Attributes
    ----------
    experiment, output : str
    group : int
        Index of the output in the problem.
    rows : (n,) array of int
        Its rows of the residual.
    places : (n,) array of int
        Their positions on the grid.
    step : float
        Grid step, s.
    regular : bool
        False if samples are counted in place of a grid.
    grid : int
        Equal for series on one grid.
    pool : int
        Equal for series with one noise model.
    ordered : bool
        False if the order of the samples means nothing: then they are independent.
    """

    experiment: str
    output: str
    group: int
    rows: Indices
    places: Indices
    step: float
    regular: bool
    grid: int
    pool: int
    ordered: bool = True

    json_layout: ClassVar = Layout(omitted={"rows", "places", "ordered"})

    def on_grid(self, values: Floats) -> Floats:
        """Return samples (n,) on the grid (m,), NaN if missing."""
        grid = np.full(int(self.places[-1]) + 1, np.nan)
        grid[self.places] = values
        return grid


def output_series(experiments: Sequence[Experiment], outputs: Sequence[str]) -> tuple[OutputSeries, ...]:
    """Return the series of all counted samples, by experiment and output."""
    found: list[OutputSeries] = []
    pools: dict[tuple[str, int, int, bool], int] = {}
    first = grids = 0
    for experiment in experiments:
        rows = first - 1 + np.cumsum(experiment.counted.ravel()).reshape(experiment.counted.shape)
        places, step, regular = table_grid(experiment.times)
        known: dict[tuple[int, int, int], int] = {}
        ordered = experiment.kind == "time"
        for column, output in enumerate(experiment.output_names):
            mine = experiment.counted[:, column]
            if not mine.any():
                continue
            own, stride, offset = _thinned(places[mine])
            alike = stride, offset, -1 if ordered else column
            known.setdefault(alike, grids + len(known))
            alone = len(found) if own.size >= SETTINGS.pooled else -1
            same = int(np.rint(np.log(max(stride * step, np.finfo(float).tiny)) / SETTINGS.same_step))
            pool = pools.setdefault((output, same, alone, ordered), len(pools))
            names, grid = (experiment.name, output, outputs.index(output)), known[alike]
            found.append(OutputSeries(*names, rows[mine, column], own, stride * step, regular, grid, pool, ordered))
        first, grids = first + int(experiment.counted.sum()), grids + len(known)
    return tuple(found)


def _thinned(places: Indices) -> tuple[Indices, int, int]:
    """Return places (n,) on their coarsest grid, its stride and offset; samples that share a time are counted."""
    steps = np.diff(places)
    least = int(steps.min()) if steps.size else 1
    if least == 0:
        return np.arange(places.size), 1, 0
    if least == 1:
        return places, 1, 0
    stride = int(np.gcd.reduce(steps))
    offset = int(places[0]) % stride
    return (places - offset) // stride, stride, offset


def table_grid(times: Floats) -> tuple[Indices, float, bool]:
    """Return grid places of the rows, step in s, and regularity; irregular rows (K,) are counted."""
    steps = np.diff(times)
    moving = steps > 0
    if not moving.any():
        return np.arange(times.size), 1.0, times.size < 2
    usual = float(np.median(steps[moving]))
    whole = np.rint(steps[moving] / usual)
    near = np.abs(steps[moving] / usual - whole) <= SETTINGS.regular_tolerance
    if (whole >= 1).all() and near.mean() >= SETTINGS.regular_share:
        jumps = np.zeros(steps.size, dtype=np.intp)
        jumps[moving] = np.minimum(whole, SETTINGS.longest_gap)
        return np.concatenate([[0], np.cumsum(jumps)]), usual, True
    return np.arange(times.size), float(times[-1] - times[0]) / max(times.size - 1, 1), False


def period_of(experiment: Experiment) -> float:
    """Return the period of all moving inputs of an experiment, s; 0 without."""
    if not experiment.input_names or experiment.kind != "time":
        return 0.0
    places, step, regular = table_grid(experiment.times)
    values = experiment.input_values - experiment.input_values.mean(axis=0)
    values = values[:, values.any(axis=0)]
    if not regular or places[-1] != len(places) - 1 or not values.size:
        return 0.0
    longest = int(SETTINGS.longest * len(values))
    away = np.max([_away(column, longest) for column in values.T], axis=0)
    begun = np.flatnonzero(away > SETTINGS.away)
    again = np.flatnonzero(away[begun[0] :] <= SETTINGS.repeated) + begun[0] if begun.size else begun
    if not again.size:
        return 0.0
    last = again[0] + int(np.argmax(np.append(away[again[0] :], np.inf) > SETTINGS.repeated))
    found = again[0] + int(np.argmin(away[again[0] : last]))
    # where it is least at the very end it may be less beyond
    return found * step if found < longest - 1 else 0.0


def _away(values: Floats, longest: int) -> Floats:
    """Return a signal's distance from itself by lag, in √2 std."""
    count = values.size
    size = fft.next_fast_len(count + longest, real=True)
    product = fft.irfft(np.abs(fft.rfft(values, size)) ** 2, size)[:longest]
    power = np.concatenate([[0.0], np.cumsum(values**2)])
    lags = np.arange(longest)
    squares = power[count - lags] + power[count] - power[lags] - 2.0 * product
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / (count - lags) / (2.0 * power[count] / count)))
