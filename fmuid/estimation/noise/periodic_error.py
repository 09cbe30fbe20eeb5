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

What returns in several outputs at the same time may add up in the estimates, or cancel. The mean cycles z_a of the
outputs of one grid have the covariances Σ_k Re z_a z̄_b, of which those of the noise are F = Σ_k Re S_ab(ω_k). Outputs
for which both differ by more than chance are replaced by the sums Σ_a w_a z_a that make both matrices diagonal,
WᵀFW = 1. Each sum is then treated as one output is; what returns in it acts on all of these outputs, by A = FW.

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
from scipy import fft, linalg

from fmuid.array_types import Complexes, Flags, Floats
from fmuid.data import Noise
from fmuid.errors import InputError
from fmuid.estimation.noise.autoregression import SETTINGS as AUTOREGRESSION
from fmuid.estimation.noise.low_frequency import Bins, rises
from fmuid.estimation.noise.model import NoiseModel
from fmuid.estimation.noise.output_series import SETTINGS as SERIES
from fmuid.estimation.noise.output_series import OutputSeries


@dataclass(frozen=True)
class PeriodicErrorSettings:
    """Numbers of the search for what returns."""

    whole: float = 1e-3
    """Periods are whole numbers of samples to this."""
    nothing: float = 0.9
    """The weight of there being nothing that returns, before the data are asked."""
    shortest: float = 0.5
    """Memories in samples, from so many ..."""
    longest_share: float = 0.5
    """... to this share of the cycle, ..."""
    least: float = 0.03
    """... and variances, from this share of the noise's least power ..."""
    weakest: float = 1e-6
    """... (of its mean one, where that is more) ..."""
    most: float = 2.0
    """... to so many times all there is, ..."""
    step: float = 0.5 * math.log(2.0)
    """... have points this far from each other in their logarithms; ..."""
    fine: int = 31
    """... so many follow where few variances matter."""
    near: float = 10.0
    """Points matter whose log-likelihood is no further below the greatest."""
    related: float = 2.0
    """What returns in two series is correlated where their mean cycles are, by so many std of chance."""
    taken: float = 0.01
    """Directions of which the fit has taken more than this share out of the mean cycle are not in the likelihood."""


SETTINGS = PeriodicErrorSettings()


@dataclass(frozen=True, eq=False)
class PeriodicError:
    """What returns with each cycle in one series, or in several at once.

    Attributes
    ----------
    series : tuple of OutputSeries
    factors : (s,) array
        By which it acts on each of them.
    period : int
        Samples of a cycle.
    powers : (f,) array
        G at the bins of its harmonics.
    points : (m, f) array
        G of each point of the grid that matters ...
    weights : (m,) array
        ... and its weight; the rest is that of nothing that returns.
    shares : (s,) array
        Of the variance of the residual of each that it has.
    """

    series: tuple[OutputSeries, ...]
    factors: Floats
    period: int
    powers: Floats
    points: Floats
    weights: Floats
    shares: Floats

    @property
    def probability(self) -> float:
        """That something returns."""
        return float(self.weights.sum())

    def gram(self, columns: Floats) -> Floats:
        """Return what returns adds to CᵀΓC (k, k), of columns (n, k) over all rows."""
        parts = _products(self._cycle(columns))
        return np.asarray(np.tensordot(self.powers, parts, 1))

    def scatter(self, columns: Floats, others: Floats) -> Floats:
        """Return the variances (k,) of log(cᵀΓc) over the grid, of each column, `others` (k,) what else is in it."""
        powers = np.einsum("fii->if", _products(self._cycle(columns)))
        logs = np.log1p(powers @ self.points.T / np.maximum(others, np.finfo(float).tiny)[:, None])
        return np.asarray((logs**2) @ self.weights - (logs @ self.weights) ** 2)

    def _cycle(self, columns: Floats) -> Floats:
        parts = zip(self.factors, self.series, strict=True)
        return np.asarray(sum(factor * _summed(columns, series, self.period) for factor, series in parts))


def check_periods(series: Sequence[OutputSeries], noise: Noise, parameters: int) -> None:
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
        cycle, least, count = period / each.step, max(AUTOREGRESSION.enough, 2 * parameters), int(each.places[-1]) + 1
        named = f"noise.excitation_period, {period:g} s, of experiment {each.experiment!r}"
        if not each.regular:
            raise InputError(f"{named}: the samples are not equally spaced; resample the table, or leave it out")
        if abs(cycle - round(cycle)) > SETTINGS.whole or cycle < least:
            raise InputError(
                f"{named} is {cycle:.7g} samples of {each.output!r}, and must be a whole number, {least} at least: "
                "give the time of several periods that are"
            )
        if cycle > SERIES.longest * count:
            raise InputError(f"{named} is {cycle:.7g} of {count} samples: there must be nearly two cycles")


@dataclass(frozen=True, eq=False)
class MeanCycle:
    """The mean cycle of a series, times the root of the number of cycles.

    Attributes
    ----------
    series : OutputSeries
    values : (T, 1 + k) array
        Of its residual and of the basis, in the units of its noise model.
    response : (f,) array
        Of its noise to its innovation at the harmonics.
    unit, square : float
        Squares of its units, and the residual's mean one.
    """

    series: OutputSeries
    values: Floats
    response: Complexes
    unit: float
    square: float

    @classmethod
    def of(cls, rows: Floats, noise: NoiseModel, period: float, *, given: bool) -> MeanCycle | None:
        """Return that of all rows (n, 1 + k); None where they have no whole cycles."""
        series, model = noise.series, noise.process
        time, residual = period / series.step, rows[series.rows, 0]
        samples, square = round(time), float(residual @ residual) / residual.size
        if samples < max(AUTOREGRESSION.enough, 2 * (rows.shape[1] - 1)) or abs(time - samples) > SETTINGS.whole:
            return None
        if not square * model.variance > 0.0 or np.bincount(series.places % samples, minlength=samples).min() == 0:
            return None
        # where a variance is given the residual says how it is spread
        unit = square / (model.variance * model.gain) if given else 1.0
        values = _summed(rows, series, samples) / math.sqrt(unit)
        return cls(series, values, model.transfer(samples), unit, square)


def returning(
    residual: Floats,
    basis: Floats,
    periods: Mapping[str, float],
    grids: Sequence[tuple[Sequence[NoiseModel], Floats]],
    given: Flags,
) -> tuple[PeriodicError, ...]:
    """Return what returns with each cycle of the excitation, in the series of experiments that have some.

    Parameters
    ----------
    residual, basis : (n,) and (n, k) arrays
        As in `fmuid.estimation.noise.sample_grid.Rows`.
    periods : mapping of str to float
        Of the excitation of each experiment, s; 0 where it does not repeat.
    grids : sequence of (sequence of NoiseModel, (m, m) array)
        The noise of the series of each grid, and the covariance of their innovations.
    given : (n_outputs,) array of bool
        Outputs whose variance was given.
    """
    rows, found = np.column_stack([residual, basis]), []
    for noise, innovations in grids:
        each = [
            MeanCycle.of(rows, model, periods[model.series.experiment], given=bool(given[model.series.group]))
            for model in noise
        ]
        known = [index for index, own in enumerate(each) if own is not None]
        folded, common = [own for own in each if own is not None], innovations[np.ix_(known, known)]
        alone = [_weighed([own], np.ones(1), np.ones(1), common[i : i + 1, i : i + 1]) for i, own in enumerate(folded)]
        found += _together(folded, alone, common) if len(alone) > 1 else alone
    return tuple(found)


def _together(folded: Sequence[MeanCycle], alone: Sequence[PeriodicError], innovations: Floats) -> list[PeriodicError]:
    """Return what returns in the series of one grid, where it is correlated between some in all of these at once."""
    period = alone[0].period
    taken = _taken(np.hstack([each.values[:, 1:] for each in folded]), 1.0)
    left = period - taken.shape[1]
    if left < period // 2:
        return list(alone)
    cycles = np.column_stack([each.values[:, 0] for each in folded])
    cycles -= taken @ (taken.T @ cycles)
    responses, counts = np.array([each.response for each in folded]), 2.0 * Bins.of(period).counts
    noise = innovations * ((responses * _sides(period)) @ responses.conj().T).real
    powers = np.array([_floor([each], np.ones(1), innovations[i : i + 1, i : i + 1]) for i, each in enumerate(folded)])
    powers += np.array([each.powers for each in alone])
    chance = np.sqrt((powers * counts) @ powers.T)
    squares = cycles.T @ cycles
    related = np.abs(squares * period / left - noise) > SETTINGS.related * chance
    found: list[PeriodicError] = []
    for group in np.unique(np.linalg.matrix_power(related.astype(np.float64), len(alone)) > 0.0, axis=0):
        members = np.flatnonzero(group)
        if members.size == 1:
            found.append(alone[int(members[0])])
            continue
        own = np.ix_(members, members)
        vectors = linalg.eigh(squares[own], noise[own])[1]
        factors = noise[own] @ vectors
        chosen = [folded[i] for i in members.tolist()]
        found += [_weighed(chosen, vectors[:, i], factors[:, i], innovations[own]) for i in range(members.size)]
    return found


def _floor(folded: Sequence[MeanCycle], weights: Floats, innovations: Floats) -> Floats:
    """Return the spectrum at the bins of harmonics (f,) of the noise of a sum of series with weights (m,)."""
    responses = weights[:, None] * np.array([each.response for each in folded])
    period = len(folded[0].values)
    spectrum = np.sum(responses * (innovations @ responses.conj()), axis=0).real
    return np.asarray(
        np.add.reduceat(spectrum * _sides(period), Bins.of(period).edges) / (2.0 * Bins.of(period).counts)
    )


def _taken(values: Floats, scale: float) -> Floats:
    """Return an orthonormal basis of what the fit has taken out of mean cycles, of columns (T, k) times a scale."""
    vectors, sizes, _ = np.linalg.svd(values, full_matrices=False)
    return np.asarray(vectors[:, sizes**2 > SETTINGS.taken * scale])


def _summed(columns: Floats, series: OutputSeries, period: int) -> Floats:
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


def _weighed(folded: Sequence[MeanCycle], weights: Floats, factors: Floats, innovations: Floats) -> PeriodicError:
    """Return what returns in a sum of series with weights (m,), acting on each of them by factors (m,)."""
    cycle = np.sum([weight * each.values for weight, each in zip(weights, folded, strict=True)], axis=0)
    period, floor = len(cycle), _floor(folded, weights, innovations)
    bins, counts = Bins.of(period), 2.0 * Bins.of(period).counts
    scale = sum(weight**2 / each.unit for weight, each in zip(weights, folded, strict=True))
    parts = _products(np.column_stack([cycle[:, 0], _taken(cycle[:, 1:], scale)]))
    mean = float(floor @ counts) / period
    cycles = folded[0].series.rows.size / period
    least, most = max(SETTINGS.least * float(floor.min()), SETTINGS.weakest * mean), SETTINGS.most * cycles * mean
    variances = np.arange(math.log(least), math.log(most), SETTINGS.step)
    memories = np.exp(np.arange(math.log(SETTINGS.shortest), math.log(SETTINGS.longest_share * period), SETTINGS.step))
    shapes = np.vstack([rises(memories, bins.cosines), floor])
    shapes *= period / (shapes @ counts)[:, None]
    nothing = float(_likelihoods(floor[None], parts, counts)[0])

    def heights(variances: Floats, shapes: Floats) -> tuple[Floats, Floats]:
        powers = (np.exp(variances)[:, None, None] * shapes).reshape(-1, floor.size)
        return powers, _likelihoods(floor + powers, parts, counts) - nothing

    powers, logs = heights(variances, shapes)
    total, area = logs.size, 1.0
    matter = logs.reshape(variances.size, len(shapes)) > logs.max() - SETTINGS.near
    own = variances[matter.any(axis=1)]
    if own.size < SETTINGS.fine // 2:
        finer = np.linspace(own[0] - SETTINGS.step, own[-1] + SETTINGS.step, SETTINGS.fine)
        area = (finer[1] - finer[0]) / SETTINGS.step
        powers, logs = heights(finer, shapes[matter.any(axis=0)])
    top = max(float(logs.max()), 0.0)
    likely = np.exp(logs - top) * area / total * (1.0 - SETTINGS.nothing)
    likely /= likely.sum() + SETTINGS.nothing * math.exp(-top)
    kept = likely > np.exp(-SETTINGS.near) * likely.max()
    powers, likely = powers[kept], likely[kept]
    point = floor * np.expm1(likely @ np.log1p(powers / floor))
    # of what returns the noise model of the whole record has one cycle's share already
    level = float(point @ counts) / period / max(cycles - 1.0, 1.0)
    shares = factors**2 * level * np.array([each.unit / each.square for each in folded])
    return PeriodicError(
        tuple(each.series for each in folded), factors, period, point, powers, likely, np.minimum(shares, 1.0)
    )


def _likelihoods(spectra: Floats, parts: Floats, counts: Floats) -> Floats:
    """Return the restricted log-likelihoods (m,) of spectra (m, f) from the parts of the residual and the basis."""
    moments = ((1.0 / spectra) @ parts.reshape(len(parts), -1)).reshape(-1, *parts.shape[1:])
    across, among = moments[:, 0, 1:], moments[:, 1:, 1:]
    taken = np.einsum("mi,mi->m", across, np.linalg.solve(among, across[:, :, None])[:, :, 0])
    logs = np.log(spectra) @ counts + np.linalg.slogdet(among)[1]
    return np.asarray(-0.5 * (logs + moments[:, 0, 0] - taken))
