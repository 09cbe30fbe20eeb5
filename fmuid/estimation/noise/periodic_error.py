"""Periodic model error in the mean cycle of the residual (docs/method/periodic-error.md)."""

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
from fmuid.estimation.noise.low_frequency import Bins, line_counts, rises
from fmuid.estimation.noise.model import NoiseModel
from fmuid.estimation.noise.output_series import SETTINGS as SERIES
from fmuid.estimation.noise.output_series import OutputSeries


@dataclass(frozen=True)
class PeriodicErrorSettings:
    """Numbers of the search for a periodic error."""

    whole: float = 1e-3  # deviation of a period from whole samples
    nothing: float = 0.9  # prior weight of no periodic error
    shortest: float = 0.5  # memories from this, samples, ...
    longest_share: float = 0.5  # ... to this share of the cycle, ...
    least: float = 0.03  # ... variances from this share of the least noise power ...
    weakest: float = 1e-6  # ... (or this share of its mean, if larger) ...
    most: float = 2.0  # ... to this multiple of the total power, ...
    step: float = 0.5 * math.log(2.0)  # ... at this logarithmic distance; ...
    fine: int = 31  # ... this many more if few variances matter
    near: float = 10.0  # log-likelihood below the best that still matters
    related: float = 2.0  # mean cycles correlated beyond this many std of chance are joined
    taken: float = 0.01  # share of a direction that the fit may take from the mean cycle


SETTINGS = PeriodicErrorSettings()


@dataclass(frozen=True, eq=False)
class PeriodicError:
    """Periodic error of one series, or of several at once."""

    series: tuple[OutputSeries, ...]
    factors: Floats  # (s,), on each series
    period: int  # samples of a cycle
    powers: Floats  # (f,), G at the bins of harmonics
    points: Floats  # (m, f), G of each grid point that matters ...
    weights: Floats  # (m,), ... and its weight; the rest is no error
    shares: Floats  # (s,), of the variance of each residual

    @property
    def probability(self) -> float:
        """Probability of a periodic error."""
        return float(self.weights.sum())

    def gram(self, columns: Floats) -> Floats:
        """Return the addition to CᵀΓC (k, k) for columns (n, k)."""
        parts = _products(self._cycle(columns))
        return np.asarray(np.tensordot(self.powers, parts, 1))

    def scatter(self, columns: Floats, others: Floats) -> Floats:
        """Return the variances (k,) of log(cᵀΓc) over the grid; `others` (k,) is the rest."""
        powers = np.einsum("fii->if", _products(self._cycle(columns)))
        logs = np.log1p(powers @ self.points.T / np.maximum(others, np.finfo(float).tiny)[:, None])
        return np.asarray((logs**2) @ self.weights - (logs @ self.weights) ** 2)

    def _cycle(self, columns: Floats) -> Floats:
        parts = zip(self.factors, self.series, strict=True)
        return np.asarray(sum(factor * _summed(columns, series, self.period) for factor, series in parts))


def check_periods(series: Sequence[OutputSeries], noise: Noise, parameters: int) -> None:
    """Check the stated excitation periods; `InputError` if one does not fit."""
    for each in series:
        period = noise.period_in(each.experiment)
        if period is None:
            continue
        cycle, least, count = period / each.step, max(AUTOREGRESSION.enough, 2 * parameters), int(each.places[-1]) + 1
        named = f"noise.excitation_period, {period:g} s, of experiment {each.experiment!r}"
        if not each.regular:
            raise InputError(f"{named}: samples are not equally spaced. Resample the data, or remove this key.")
        if abs(cycle - round(cycle)) > SETTINGS.whole or cycle < least:
            raise InputError(
                f"{named} is {cycle:.7g} samples of {each.output!r}: not a whole number from {least} on. "
                "Give a multiple that is."
            )
        if cycle > SERIES.longest * count:
            raise InputError(f"{named} is {cycle:.7g} of {count} samples. Nearly two cycles are needed.")


@dataclass(frozen=True, eq=False)
class MeanCycle:
    """Mean cycle of a series times √(number of cycles)."""

    series: OutputSeries
    values: Floats  # (T, 1 + k), residual and basis, in units of the noise model
    response: Complexes  # (f,), noise by innovation at the harmonics
    unit: float  # square of the unit
    square: float  # mean square of the residual

    @classmethod
    def of(cls, rows: Floats, noise: NoiseModel, period: float, *, given: bool) -> MeanCycle | None:
        """Return the mean cycle of rows (n, 1 + k), if any."""
        series, model = noise.series, noise.process
        time, residual = period / series.step, rows[series.rows, 0]
        samples, square = round(time), float(residual @ residual) / residual.size
        if samples < max(AUTOREGRESSION.enough, 2 * (rows.shape[1] - 1)) or abs(time - samples) > SETTINGS.whole:
            return None
        if not square * model.variance > 0.0 or np.bincount(series.places % samples, minlength=samples).min() == 0:
            return None
        # a given variance is spread as the residual is
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
    """Return the periodic errors of all experiments; `grids` have noise and innovations."""
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
    """Return the errors of one grid's series, joined where correlated."""
    period = alone[0].period
    taken = _taken(np.hstack([each.values[:, 1:] for each in folded]), 1.0)
    left = period - taken.shape[1]
    if left < period // 2:
        return list(alone)
    cycles = np.column_stack([each.values[:, 0] for each in folded])
    cycles -= taken @ (taken.T @ cycles)
    responses, counts = np.array([each.response for each in folded]), 2.0 * Bins.of(period).counts
    noise = innovations * ((responses * line_counts(period)) @ responses.conj().T).real
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
    """Return the noise spectrum (f,) of weighted series at harmonics."""
    responses = weights[:, None] * np.array([each.response for each in folded])
    period = len(folded[0].values)
    spectrum = np.sum(responses * (innovations @ responses.conj()), axis=0).real
    return np.asarray(
        np.add.reduceat(spectrum * line_counts(period), Bins.of(period).edges) / (2.0 * Bins.of(period).counts)
    )


def _taken(values: Floats, scale: float) -> Floats:
    """Return an orthonormal basis (T, k) of fitted mean cycles."""
    vectors, sizes, _ = np.linalg.svd(values, full_matrices=False)
    return np.asarray(vectors[:, sizes**2 > SETTINGS.taken * scale])


def _summed(columns: Floats, series: OutputSeries, period: int) -> Floats:
    """Return column sums over cycles (T, k) by √(number of cycles)."""
    sums = np.zeros((period, columns.shape[1]))
    np.add.at(sums, series.places % period, columns[series.rows])
    return sums / math.sqrt(series.rows.size / period)


def _products(cycle: Floats) -> Floats:
    """Return CᵀC of columns (T, k) by harmonic (f, k, k)."""
    lines, edges = fft.rfft(cycle, axis=0) / math.sqrt(len(cycle)), Bins.of(len(cycle)).edges
    sides, count = line_counts(len(cycle))[:, None], cycle.shape[1]
    parts = np.empty((edges.size, count, count))
    for i in range(count):  # one after the other: long cycles have many lines
        own = np.add.reduceat((np.conj(lines[:, i, None]) * lines[:, i:]).real * sides, edges, axis=0)
        parts[:, i, i:] = parts[:, i:, i] = own
    return parts


def _weighed(folded: Sequence[MeanCycle], weights: Floats, factors: Floats, innovations: Floats) -> PeriodicError:
    """Return the error of weighted series, with its factors (m,)."""
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
    # the noise model already contains one cycle's share
    level = float(point @ counts) / period / max(cycles - 1.0, 1.0)
    shares = factors**2 * level * np.array([each.unit / each.square for each in folded])
    return PeriodicError(
        tuple(each.series for each in folded), factors, period, point, powers, likely, np.minimum(shares, 1.0)
    )


def _likelihoods(spectra: Floats, parts: Floats, counts: Floats) -> Floats:
    """Return restricted log-likelihoods (m,) of spectra (m, f)."""
    moments = ((1.0 / spectra) @ parts.reshape(len(parts), -1)).reshape(-1, *parts.shape[1:])
    across, among = moments[:, 0, 1:], moments[:, 1:, 1:]
    taken = np.einsum("mi,mi->m", across, np.linalg.solve(among, across[:, :, None])[:, :, 0])
    logs = np.log(spectra) @ counts + np.linalg.slogdet(among)[1]
    return np.asarray(-0.5 * (logs + moments[:, 0, 0] - taken))
