"""Errors of the model that return with each cycle of an excitation, found in the mean cycle of the residual.

Under the same cycle again and again an error of the model is the same again and again, and averages out over no number
of cycles. A noise model of the whole record takes the cycles for independent: its spectrum S is right between the
harmonics of the cycle, at the harmonics it lacks what returns. With the columns of C and the residual summed over the n
cycles and divided by √n, C̄ and z (T samples each), what returns adds to CᵀΓC

    Σ_k G(ω_k) c_k c_kᴴ,   c_k the transform of C̄ at the harmonic ω_k, divided by √T,

for a signal that repeats has no power elsewhere. G is a variance times the shape of an autoregression of order 1, of
some memory, or of S itself, and z has the spectrum S + G. Its restricted likelihood, that of what the fit has left in
z (Patterson and Thompson), is

    −½ [Σ_k log(S + G) + log|D| + z*z − (d*z)ᵀ D⁻¹ (d*z)],   D = d*d,   a*b = Σ_k Re(ā_k b_k)/(S + G),

d an orthonormal basis of C̄. Variance and shape are not selected but weighed by it over a grid, equal in the
logarithms, beside nothing that returns, which has the weight NOTHING before: a single optimum would be too sure where
an error is as weak as the noise or as slow as the cycle. log(S + G) is the mean over the grid, never less than log S,
and the scatter of log V over the grid takes degrees of freedom away.

References
----------
H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58, 1971;
R. Pintelon, J. Schoukens, "System identification: a frequency domain approach", Wiley 2012 (harmonics and the lines
between them).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from fmuid.arrays import Flags, Floats
from fmuid.data import Noise
from fmuid.errors import InputError
from fmuid.estimation.colour.autoregression import ENOUGH, Autoregression
from fmuid.estimation.colour.series import LONGEST, Series
from fmuid.estimation.colour.slow import Bins, rises

# Periods are whole numbers of samples to this.
WHOLE = 1e-3
# The weight of there being nothing that returns, before the data are asked.
NOTHING = 0.9
# Memories in samples, from so many to this share of the cycle, ...
SHORTEST, LONGEST_SHARE = 0.5, 0.5
# ... and variances, from this share of the noise's least power (of its mean one, where that is more) to so many times
# all there is, have points this far from each other in their logarithms; so many follow where few variances matter.
LEAST, WEAKEST, MOST, STEP, FINE = 0.03, 1e-6, 2.0, 0.5 * math.log(2.0), 31
# Points matter whose log-likelihood is no further below the greatest.
NEAR = 10.0
# Directions of which the fit has taken more than this share out of the mean cycle are not in the likelihood.
TAKEN = 0.01


@dataclass(frozen=True, eq=False)
class Returning:
    """What returns with each cycle in one series.

    Attributes
    ----------
    series : Series
    period : int
        Samples of a cycle.
    powers : (f,) array
        G at the bins of its harmonics.
    points : (m, f) array
        G of each point of the grid that matters ...
    weights : (m,) array
        ... and its weight; the rest is that of nothing that returns.
    share : float
        Of the residual's variance that it has.
    """

    series: Series
    period: int
    powers: Floats
    points: Floats
    weights: Floats
    share: float

    @property
    def probability(self) -> float:
        """That something returns."""
        return float(self.weights.sum())

    def gram(self, columns: Floats) -> Floats:
        """Return what returns adds to CᵀΓC (k, k), of columns (n, k) over all rows."""
        parts = _products(_summed(columns, self.series, self.period))
        return np.asarray(np.tensordot(self.powers, parts, 1))

    def scatter(self, columns: Floats, others: Floats) -> Floats:
        """Return the variances (k,) of log(cᵀΓc) over the grid, of each column, `others` (k,) what else is in it."""
        powers = np.einsum("fii->if", _products(_summed(columns, self.series, self.period)))
        logs = np.log1p(powers @ self.points.T / np.maximum(others, np.finfo(float).tiny)[:, None])
        return np.asarray((logs**2) @ self.weights - (logs @ self.weights) ** 2)


def check_periods(series: Sequence[Series], noise: Noise, parameters: int) -> None:
    """Check that each period said of an excitation is one that errors in its series can be asked for.

    Raises
    ------
    InputError
        If not.
    """
    for each in series:
        period = noise.period_in(each.experiment)
        if period is None:
            continue
        cycle, least, count = period / each.step, max(ENOUGH, 2 * parameters), int(each.places[-1]) + 1
        named = f"noise.period, {period:g} s, of experiment {each.experiment!r}"
        if not each.regular:
            raise InputError(f"{named}: the samples are not equally spaced; resample the table, or leave it out")
        if abs(cycle - round(cycle)) > WHOLE or cycle < least:
            raise InputError(
                f"{named} is {cycle:.7g} samples of {each.output!r}, and must be a whole number, {least} at least: "
                "give the time of several periods that are"
            )
        if cycle > LONGEST * count:
            raise InputError(f"{named} is {cycle:.7g} of {count} samples: there must be nearly two cycles")


def returning(
    residual: Floats,
    basis: Floats,
    periods: Mapping[str, float],
    noise: Sequence[tuple[Series, Autoregression]],
    given: Flags,
) -> tuple[Returning, ...]:
    """Return what returns with each cycle of the excitation, of each series whose experiment has some.

    Parameters
    ----------
    residual, basis : (n,) and (n, k) arrays
        As in `fmuid.estimation.colour.grid.Rows`.
    periods : mapping of str to float
        Of the excitation of each experiment, s; 0 where it does not repeat.
    noise : sequence of (Series, Autoregression)
    given : (n_outputs,) array of bool
        Outputs whose variance was given.
    """
    found = []
    for series, model in noise:
        time = periods[series.experiment] / series.step
        period, own = round(time), residual[series.rows]
        square = float(own @ own) / own.size
        if period < max(ENOUGH, 2 * basis.shape[1]) or abs(time - period) > WHOLE or not square * model.variance > 0.0:
            continue
        if np.bincount(series.places % period, minlength=period).min() == 0:
            continue
        # where a variance is given the residual says how it is spread
        unit = square / (model.variance * model.gain) if given[series.group] else 1.0
        spectrum = unit * model.variance * np.abs(model.transfer(period)) ** 2
        rows = _summed(np.column_stack([residual, basis]), series, period)
        found.append(_weighed(rows, spectrum, series, period, unit, square))
    return tuple(found)


def _summed(columns: Floats, series: Series, period: int) -> Floats:
    """Return the columns (n, k) of all rows summed over the cycles of a series (T, k), divided by the root of these."""
    sums = np.zeros((period, columns.shape[1]))
    np.add.at(sums, series.places % period, columns[series.rows])
    return sums / math.sqrt(series.rows.size / period)


def _products(cycle: Floats) -> Floats:
    """Return the parts of CᵀC, C (T, k), at the bins of harmonics (f, k, k)."""
    lines, edges = fft.rfft(cycle, axis=0) / math.sqrt(len(cycle)), Bins.of(len(cycle)).edges
    sides, count = _sides(len(cycle))[:, None], cycle.shape[1]
    parts = np.empty((edges.size, count, count))
    for i in range(count):  # one after the other: long cycles have many lines
        own = np.add.reduceat((np.conj(lines[:, i, None]) * lines[:, i:]).real * sides, edges, axis=0)
        parts[:, i, i:] = parts[:, i:, i] = own
    return parts


def _sides(period: int) -> Floats:
    """Return how many lines of the whole transform each of the real one stands for."""
    found = np.full(period // 2 + 1, 2.0)
    found[0] = 1.0
    if period % 2 == 0:
        found[-1] = 1.0
    return found


def _weighed(cycle: Floats, spectrum: Floats, series: Series, period: int, unit: float, square: float) -> Returning:
    """Return what returns in a cycle of the residual and its basis (T, 1 + k) with noise of some spectrum (f,)."""
    bins, sides, counts = Bins.of(period), _sides(period), 2.0 * Bins.of(period).counts
    floor = np.add.reduceat(spectrum * sides, bins.edges) / counts
    vectors, sizes, _ = np.linalg.svd(cycle[:, 1:], full_matrices=False)
    parts = _products(np.column_stack([cycle[:, 0], vectors[:, sizes**2 > TAKEN]]))
    mean = float(floor @ counts) / period
    cycles = series.rows.size / period
    least, most = max(LEAST * float(floor.min()), WEAKEST * mean), MOST * cycles * mean
    variances = np.arange(math.log(least), math.log(most), STEP)
    memories = np.exp(np.arange(math.log(SHORTEST), math.log(LONGEST_SHARE * period), STEP))
    shapes = np.vstack([rises(memories, bins.cosines), floor])
    shapes *= period / (shapes @ counts)[:, None]
    nothing = float(_likelihoods(floor[None], parts, counts)[0])

    def heights(variances: Floats, shapes: Floats) -> tuple[Floats, Floats]:
        powers = (np.exp(variances)[:, None, None] * shapes).reshape(-1, floor.size)
        return powers, _likelihoods(floor + powers, parts, counts) - nothing

    powers, logs = heights(variances, shapes)
    total, area = logs.size, 1.0
    matter = logs.reshape(variances.size, len(shapes)) > logs.max() - NEAR
    own = variances[matter.any(axis=1)]
    if own.size < FINE // 2:
        finer = np.linspace(own[0] - STEP, own[-1] + STEP, FINE)
        area = (finer[1] - finer[0]) / STEP
        powers, logs = heights(finer, shapes[matter.any(axis=0)])
    top = max(float(logs.max()), 0.0)
    weights = np.exp(logs - top) * area / total * (1.0 - NOTHING)
    weights /= weights.sum() + NOTHING * math.exp(-top)
    kept = weights > np.exp(-NEAR) * weights.max()
    powers, weights = powers[kept], weights[kept]
    point = floor * np.expm1(weights @ np.log1p(powers / floor))
    # of what returns the noise model of the whole record has one cycle's share already
    share = min(float(point @ counts) / period / max(cycles - 1.0, 1.0) / square, 1.0)
    return Returning(series, period, point / unit, powers / unit, weights, share)


def _likelihoods(spectra: Floats, parts: Floats, counts: Floats) -> Floats:
    """Return the restricted log-likelihoods (m,) of spectra (m, f) from the parts of the residual and the basis."""
    moments = ((1.0 / spectra) @ parts.reshape(len(parts), -1)).reshape(-1, *parts.shape[1:])
    across, among = moments[:, 0, 1:], moments[:, 1:, 1:]
    taken = np.einsum("mi,mi->m", across, np.linalg.solve(among, across[:, :, None])[:, :, 0])
    logs = np.log(spectra) @ counts + np.linalg.slogdet(among)[1]
    return np.asarray(-0.5 * (logs + moments[:, 0, 0] - taken))
