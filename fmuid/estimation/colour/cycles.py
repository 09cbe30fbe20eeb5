"""Records of an excitation that repeats: the residual as its mean cycle, and what is left in each cycle.

An error of the model under the same cycle again and again is the same again and again: no noise model of the whole
record, whose cycles it takes for independent, tells what such an error does to the estimates. With n_t samples at the
place t of the cycle the rows of the data are turned, orthogonally, into √n_t times their mean over the cycles and what
each differs from that. Both are series of their own: the error is in the first, noise in both, and a sensitivity that
is the same in all cycles is in the first alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from fmuid.arrays import Floats, Indices
from fmuid.data import Experiment, Measurements
from fmuid.estimation.colour.series import POOLED, Series, table_grid

# Inputs repeat where they are, after a period, no further from themselves than this share of their standard deviation
# (measured ones have noise); and were further than the other share in between.
REPEATED, AWAY = 0.05, 0.5
# Periods are whole numbers of samples to this, of which there are as many as tell a colour by themselves.
WHOLE = 1e-3
# The longest period as a share of the record: nearly two cycles.
LONGEST = 0.55


def period_of(experiment: Measurements) -> float:
    """Return after how long, s, all inputs of an experiment that move repeat, 0 where they do not."""
    if not isinstance(experiment, Experiment) or not experiment.input_names:
        return 0.0
    places, step, regular = table_grid(experiment.times)
    values = experiment.input_values - experiment.input_values.mean(axis=0)
    values = values[:, values.any(axis=0)]
    if not regular or places[-1] != len(places) - 1 or not values.size:
        return 0.0
    longest = int(LONGEST * len(values))
    away = np.max([_away(column, longest) for column in values.T], axis=0)
    begun = np.flatnonzero(away > AWAY)
    again = np.flatnonzero(away[begun[0] :] <= REPEATED) + begun[0] if begun.size else begun
    if not again.size:
        return 0.0
    last = again[0] + int(np.argmax(np.append(away[again[0] :], np.inf) > REPEATED))
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


@dataclass(frozen=True, eq=False)
class Cycle:
    """One series whose experiment repeats.

    Attributes
    ----------
    rows : (n,) array of int
    places : (n,) array of int
        Of each row in the mean cycle, among those that are there.
    counts : (T,) array
        Samples at each place.
    """

    rows: Indices
    places: Indices
    counts: Floats

    def means(self, columns: Floats) -> Floats:
        """Return the mean cycle (T, k) of the columns (n, k) of all rows."""
        sums = np.zeros((self.counts.size, columns.shape[1]))
        np.add.at(sums, self.places, columns[self.rows])
        return np.asarray(sums / self.counts[:, None])


@dataclass(frozen=True, eq=False)
class Fold:
    """How the rows of data are turned into mean cycles and what differs from them.

    Attributes
    ----------
    series : tuple of Series
        Of the rows then: what is left of each, and the mean cycles behind them all.
    cycles : tuple of Cycle
    """

    series: tuple[Series, ...]
    cycles: tuple[Cycle, ...]

    @classmethod
    def of(cls, series: Sequence[Series], experiments: Sequence[Measurements], rows: int) -> Fold:
        """Return how the series of some experiments, of so many rows, are folded by the periods of their inputs."""
        periods = {each.name: period_of(each) for each in experiments}
        found, cycles = list(series), list[Cycle]()
        grids, pools = 1 + max(each.grid for each in series), 1 + max(each.pool for each in series)
        for each in series:
            period = round(periods[each.experiment] / each.step)
            whole = abs(period * each.step - periods[each.experiment]) < WHOLE * each.step
            if period < POOLED or not whole or np.ptp(each.places) != each.rows.size - 1:
                continue
            own = np.arange(each.rows.size) % period
            counts = np.bincount(own, minlength=period).astype(np.float64)
            cycles.append(Cycle(each.rows, own, counts))
            mean = replace(each, rows=rows + np.arange(period), places=np.arange(period))
            found.append(replace(mean, grid=grids + each.grid, pool=pools + len(cycles)))
            rows += period
        return cls(tuple(found), tuple(cycles))

    def columns(self, columns: Floats) -> Floats:
        """Return columns (n, k) of the rows as those of the folded rows."""
        if not self.cycles:
            return columns
        left, parts = columns.copy(), []
        for each in self.cycles:
            means = each.means(columns)
            left[each.rows] -= means[each.places]
            parts.append(np.sqrt(each.counts)[:, None] * means)
        return np.vstack([left, *parts])

    def residual(self, residual: Floats) -> Floats:
        """Return a residual (n,) as that of the folded rows: what is left of so few cycles has too little variance."""
        folded = self.columns(residual[:, None])[:, 0]
        for each in self.cycles:
            folded[each.rows] *= np.sqrt(each.rows.size / max(each.rows.size - each.counts.size, 1))
        return folded
