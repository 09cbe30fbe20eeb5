"""The rows of a residual as series in time: each output of each experiment on the grid of its samples.

Samples may be missing. Those of a slow sensor, every tenth row of a table say, have a grid of their own. Outputs of one
experiment that share a grid may have innovations in common. Samples on no grid at all are counted one by one, as if
they were equally spaced, and the series says so.
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

    regular_share: float = 0.95
    """Times count as equally spaced where so many steps ..."""
    regular_tolerance: float = 0.2
    """... are whole multiples of the usual one to this share of it."""
    longest_gap: int = 1000
    """A longer gap than this is as good as endless."""
    pooled: int = 100
    """Experiments shorter than this share one noise model with others of the same output and step."""
    same_step: float = 1e-3
    """Steps in time of two experiments are the same to this."""
    repeated: float = 0.05
    """Inputs repeat where they are no further from themselves than this share of their std, as with noise, ..."""
    away: float = 0.5
    """... and were further than this in between."""
    longest: float = 0.55
    """The longest period as a share of the record: nearly two cycles."""


SETTINGS = SeriesSettings()


@dataclass(frozen=True, eq=False)
class OutputSeries:
    """One output of one experiment.

    Attributes
    ----------
    experiment, output : str
    group : int
        Which of the problem's outputs it is.
    rows : (n,) array of int
        Which rows of the residual it has.
    places : (n,) array of int
        Where they stand on the grid of its step.
    step : float
        s.
    regular : bool
        Whether the samples stand on a grid; else they are counted.
    grid : int
        Series of the same number share a grid, and may have innovations in common.
    pool : int
        Series of the same number share a noise model.
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

    json_layout: ClassVar = Layout(omitted={"rows", "places"})

    def on_grid(self, values: Floats) -> Floats:
        """Return its samples (n,) on the grid (m,), NaN where one is missing."""
        grid = np.full(int(self.places[-1]) + 1, np.nan)
        grid[self.places] = values
        return grid


def output_series(experiments: Sequence[Experiment], outputs: Sequence[str]) -> tuple[OutputSeries, ...]:
    """Return the series of all counted samples, experiment by experiment, output by output.

    Parameters
    ----------
    experiments : sequence of Experiment
    outputs : sequence of str
        The problem's outputs.
    """
    found: list[OutputSeries] = []
    pools: dict[tuple[str, int, int], int] = {}
    first = grids = 0
    for experiment in experiments:
        rows = first - 1 + np.cumsum(experiment.counted.ravel()).reshape(experiment.counted.shape)
        places, step, regular = table_grid(experiment.times)
        known: dict[tuple[int, int], int] = {}
        for column, output in enumerate(experiment.output_names):
            mine = experiment.counted[:, column]
            if not mine.any():
                continue
            own, stride, offset = _thinned(places[mine])
            known.setdefault((stride, offset), grids + len(known))
            alone = len(found) if own.size >= SETTINGS.pooled else -1
            pool = pools.setdefault((output, _rounded(stride * step), alone), len(pools))
            found.append(
                OutputSeries(
                    experiment.name,
                    output,
                    outputs.index(output),
                    rows[mine, column],
                    own,
                    stride * step,
                    regular,
                    known[stride, offset],
                    pool,
                )
            )
        first, grids = first + int(experiment.counted.sum()), grids + len(known)
    return tuple(found)


def _rounded(step: float) -> int:
    """Return a number that is the same for steps that are."""
    return int(np.rint(np.log(max(step, np.finfo(float).tiny)) / SETTINGS.same_step))


def _thinned(places: Indices) -> tuple[Indices, int, int]:
    """Return places (n,) on a grid with the coarsest step that has them all, that step, and where it begins.

    Two samples at one time have no place each: all are counted then.
    """
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
    """Return where the rows of a table stand on the grid of their usual step, that step in s, and whether they do.

    Parameters
    ----------
    times : (K,) array
        Never decreasing, s. Where they are not near a grid, the rows themselves are counted, and the step is the mean
        one. A time given twice is one place.
    """
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
    """Return after how long, s, all inputs of an experiment that move repeat, 0 where they do not."""
    if not experiment.input_names:
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
    """Return how far a signal (n,) is from itself so many samples later, from 0 to `longest`, by √2 of its std."""
    count = values.size
    size = fft.next_fast_len(count + longest, real=True)
    product = fft.irfft(np.abs(fft.rfft(values, size)) ** 2, size)[:longest]
    power = np.concatenate([[0.0], np.cumsum(values**2)])
    lags = np.arange(longest)
    squares = power[count - lags] + power[count] - power[lags] - 2.0 * product
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / (count - lags) / (2.0 * power[count] / count)))
