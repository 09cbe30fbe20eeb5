"""Covariance under colored noise, with degrees of freedom (docs/method/covariance.md, with its symbols)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.estimation.noise.autoregression import Autoregression, fit, most_orders
from fmuid.estimation.noise.model import NoiseModel
from fmuid.estimation.noise.output_series import OutputSeries
from fmuid.estimation.noise.periodic_error import PeriodicError, returning
from fmuid.estimation.noise.sample_grid import Rows, SampleGrid, Spectra
from fmuid.estimation.noise.uneven import uneven_levels
from fmuid.estimation.problem import LeastSquares

if TYPE_CHECKING:
    from fmuid.estimation.linearized_problem import LinearizedProblem


@dataclass(frozen=True)
class SandwichSettings:
    """Numbers of the corrections for the fitted part."""

    rounds: int = 4  # maximum; ...
    long: int = 50_000  # ... one round for more samples, where the correction is slight, ...
    most_values: int = 30_000_000  # ... and none beyond this memory
    settled: float = 2e-3  # largest relative change of a variance in the last round
    runaway: float = 100.0  # factor of a variance that discards a round, near a random walk
    slight: float = 2e-3  # share of each output's squares that the fit may take without a round
    least_freedom: float = 1.0  # lower limit of the degrees of freedom


SETTINGS = SandwichSettings()


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Noise of all rows of data."""

    models: tuple[NoiseModel, ...]  # by experiment and output
    innovations: tuple[Floats, ...]  # (m, m), covariance S of each grid's series
    returning: tuple[PeriodicError, ...] = ()
    levels: Floats | None = None  # (n,), relative std of each row where the noise is uneven

    def gram(self, columns: Floats) -> Floats:
        """Return XᵀΓX (k, k) of columns X (n, k)."""
        columns = columns if self.levels is None else columns * self.levels[:, None]
        total = np.zeros((columns.shape[1], columns.shape[1]))
        for members, common in self.grids():
            spectra = Spectra.of(columns, [each.series for each in members], [each.process for each in members])
            total += spectra.gram(spectra.coupled(common))
        return total + sum(each.gram(columns) for each in self.returning)

    def grids(self) -> list[tuple[list[NoiseModel], Floats]]:
        """Return models and innovation covariance of each grid."""
        grids = _members([each.series.grid for each in self.models])
        return [([self.models[i] for i in own], s) for own, s in zip(grids, self.innovations, strict=True)]


@dataclass(frozen=True, eq=False)
class SandwichCovariance:
    """Covariance (N, N), degrees of freedom (N,) of its diagonal, and noise."""

    covariance: Floats
    freedom: Floats
    noise: ResidualNoise


def sandwich_of(
    problem: LeastSquares, local: LinearizedProblem, rounding: Flags, *, uneven: bool = False
) -> SandwichCovariance:
    """Return the covariance of a problem's estimates under colored noise.

    Outputs with `rounding` (n_outputs,) have nothing but rounding and simulation noise in the residual. `uneven` fits
    variances that follow the signal.
    """
    root, given = local.root, ~np.isnan(problem.variance)
    # the influence function of a robust loss has the residual's own scale
    given &= problem.loss is None
    own, columns = local.prior_jacobian @ root, local.jacobian @ root
    residual, basis = local.residual, columns
    if len(own):
        basis = local.data_basis
        residual = residual - basis @ (basis.T @ residual)
    rows = Rows(residual, basis, columns, root, own.T @ own, given, rounding, problem.levels.pools)
    found = sandwich_of_rows(problem, rows, problem.measured - local.levels * local.residual if uneven else None)
    lost = ~np.isfinite(np.diag(local.combined.covariance))
    covariance = found.covariance.copy()
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    return replace(found, covariance=covariance)


def sandwich_of_rows(problem: LeastSquares, rows: Rows, simulated: Floats | None) -> SandwichCovariance:
    """Return the covariance under the noise of rows; uneven noise has its variances fitted.

    `simulated` (n,) are the outputs, which the variance may follow; None: it is constant.
    """
    found = sandwich(rows, problem.series, problem.periods)
    levels = None
    if simulated is not None and problem.loss is None and not rows.white.any():
        left = None if rows.prior.any() else share_left(problem, rows.basis)
        levels = uneven_levels(found.noise.models, rows.residual, simulated, left)
    if levels is None:
        return found
    residual, basis = evened(rows.residual, rows.basis, levels)
    even = replace(rows, residual=residual, basis=basis, columns=rows.columns * levels[:, None])
    again = sandwich(even, problem.series, problem.periods)
    return replace(again, noise=replace(again.noise, levels=levels))


def evened(residual: Floats, basis: Floats, levels: Floats) -> tuple[Floats, Floats]:
    """Return residual (n,) and basis (n, k) of an even fit."""
    residual, basis = residual / levels, np.linalg.qr(basis / levels[:, None])[0]
    return residual - basis @ (basis.T @ residual), basis


def share_left(problem: LeastSquares, basis: Floats) -> Floats | None:
    """Return the share (n,) of each variance that a fit leaves.

    0 where the noise is known; None: its form is stated.
    """
    if problem.levels.scale is not None:
        return None
    return np.where(np.isnan(problem.variance)[problem.groups], 1.0 - np.sum(basis**2, axis=1), 0.0)


def sandwich(
    rows: Rows, series: Sequence[OutputSeries], periods: Mapping[str, float] | None = None
) -> SandwichCovariance:
    """Return the covariance under the noise of all series, and periodic errors."""
    grids, pools = _members([each.grid for each in series]), _members([each.pool for each in series])
    parts = [SampleGrid(rows, [series[i] for i in members], members) for members in grids]
    rounds = SETTINGS.rounds if len(rows.residual) <= SETTINGS.long else 1
    rounds = 0 if rows.columns.size > SETTINGS.most_values else rounds
    spread = np.full(rows.basis.shape[1], math.inf)
    models: dict[int, Autoregression] = {}
    for done in range(rounds + 1):
        earlier, models = models, _models(rows, series, parts, pools)
        gram = _taken(parts, models, rows)
        before, spread = spread, np.diag(gram)
        if done and ((spread > SETTINGS.runaway * before) | (SETTINGS.runaway * spread < before)).any():
            models = earlier
            gram = _taken(parts, models, rows)
            break
        if done == rounds or (np.abs(spread - before) <= SETTINGS.settled * spread).all():
            break
        taken = float(spread.sum())
        if not done and all(taken <= SETTINGS.slight * m.samples * m.variance * m.gain for m in models.values()):
            break
        for part in parts:
            part.add_removed(gram)
    if rows.given.any():
        scaled = rows.given & ~rows.white
        models = {i: each.of_variance(1.0) if scaled[series[i].group] else each for i, each in models.items()}
        gram = _taken(parts, models, rows)
    if rows.columns is not rows.basis:
        gram = np.sum([part.take(part.models, rows.columns, part.innovations) for part in parts], axis=0)
    inner = gram + rows.prior + _of_weights(rows, series)
    covariance = rows.root @ inner @ rows.root.T
    freedom = _freedom(rows, np.diag(covariance), series, parts, pools)
    noise = ResidualNoise(
        tuple(NoiseModel(each, models[i]) for i, each in enumerate(series)), tuple(part.innovations for part in parts)
    )
    found = SandwichCovariance(covariance, freedom, noise)
    return found if periods is None else _with_returning(found, rows, periods)


def _with_returning(found: SandwichCovariance, rows: Rows, periods: Mapping[str, float]) -> SandwichCovariance:
    """Add periodic errors to a covariance."""
    own = found.noise
    known = []
    for members, common in own.grids():
        told = [k for k, each in enumerate(members) if not rows.white[each.series.group]]
        known.append(([members[k] for k in told], common[np.ix_(told, told)]))
    returns = returning(rows.residual, rows.basis, periods, known, rows.given)
    noise = replace(own, returning=returns)
    if not returns:
        return replace(found, noise=noise)
    columns, before = rows.columns @ rows.root.T, np.diag(found.covariance)
    added = [each.gram(columns) for each in returns]
    covariance = found.covariance + sum(added)
    spread = np.diag(covariance)
    share = np.divide(before, spread, out=np.ones_like(before), where=spread > 0.0)
    scatter = 2.0 / found.freedom * share**2
    for each, part in zip(returns, added, strict=True):
        scatter = scatter + each.scatter(columns, spread - np.diag(part))
    with np.errstate(divide="ignore"):
        freedom = np.clip(2.0 / scatter, SETTINGS.least_freedom, found.freedom)
    return SandwichCovariance(covariance, freedom, noise)


def _members(numbers: Sequence[int]) -> list[list[int]]:
    """Return the indices of each number."""
    found: dict[int, list[int]] = {}
    for index, number in enumerate(numbers):
        found.setdefault(number, []).append(index)
    return list(found.values())


def _taken(parts: Sequence[SampleGrid], models: dict[int, Autoregression], rows: Rows) -> Floats:
    """Adopt models on all grids; return the sum of QᵀΓQ."""
    return np.asarray(np.sum([part.take([models[i] for i in part.members], rows.basis) for part in parts], axis=0))


def _models(
    rows: Rows, series: Sequence[OutputSeries], parts: Sequence[SampleGrid], pools: Sequence[Sequence[int]]
) -> dict[int, Autoregression]:
    """Fit each pool's noise, with the fitted part restored."""
    columns = {index: own for part in parts for index, own in zip(part.members, part.columns, strict=True)}
    there = {index: own for part in parts for index, own in zip(part.members, part.there, strict=True)}
    models: dict[int, Autoregression] = {}
    for members in pools:
        group, samples = series[members[0]].group, sum(series[i].rows.size for i in members)
        # samples without an order are independent, with the variance of their output
        if rows.white[group] or not all(series[i].ordered for i in members):
            model = Autoregression(np.zeros(0), 1.0, samples)
        else:
            orders = most_orders(samples, max(there[i].size for i in members))
            extra = len(columns[members[0]]) // 2
            weights = np.repeat([1.0, 0.5, -0.5], [1, extra, extra])
            model = fit(*_joined([(columns[i], there[i]) for i in members], orders + 1), weights, orders)
        models |= dict.fromkeys(members, model)
    return models


def _joined(blocks: Sequence[tuple[Floats, Flags]], gap: int) -> tuple[Floats, Flags]:
    """Join series with gaps that separate them."""
    if len(blocks) == 1:
        return blocks[0]
    columns = [np.pad(block, ((0, 0), (0, gap))) for block, _ in blocks]
    return np.concatenate(columns, axis=1), np.concatenate([np.pad(there, (0, gap)) for _, there in blocks])


def _of_weights(rows: Rows, series: Sequence[OutputSeries]) -> Floats:
    """Return what the estimated weights of outputs add to QᵀΓQ.

    Σ 4/ν (G − G²), G the part of QᵀQ with one variance (Kenward and Roger, Biometrics 53, 1997).
    """
    added = np.zeros((rows.columns.shape[1],) * 2)
    first = {j: int(pool[0]) for pool in rows.shared for j in pool.tolist()}
    outputs = _members([first.get(each.group, each.group) for each in series])
    for members in outputs if len(outputs) > 1 else ():
        own = np.concatenate([series[i].rows for i in members])
        if not (rows.given | rows.white)[series[members[0]].group]:
            part = rows.columns[own].T @ rows.columns[own]
            added += 4.0 / max(own.size - float(np.trace(part)), 1.0) * (part - part @ part)
    return added


def _freedom(
    rows: Rows,
    variances: Floats,
    series: Sequence[OutputSeries],
    parts: Sequence[SampleGrid],
    pools: Sequence[Sequence[int]],
) -> Floats:
    """Return the degrees of freedom (N,) of variances, from the models' scatter."""
    taken = np.einsum("ij,ij->i", rows.basis, rows.basis)
    slopes = {index: own for part in parts for index, own in zip(part.members, part.slopes(), strict=True)}
    model = {index: own for part in parts for index, own in zip(part.members, part.models, strict=True)}
    scatter = np.zeros(len(variances))
    for members in pools:
        total = np.sum([slopes[i] for i in members], axis=0)
        # relative: squares of variances may overflow in some units
        share = np.divide(total, variances[:, None], out=np.zeros_like(total), where=variances[:, None] > 0.0)
        own = model[members[0]]
        left = own.samples - sum(float(taken[series[i].rows].sum()) for i in members)
        scatter += np.einsum("ij,jl,il->i", share, own.scatter(), share) / max(left, np.finfo(float).tiny)
    with np.errstate(divide="ignore"):
        freedom = 2.0 / scatter
    return np.where(scatter > 0.0, np.maximum(freedom, SETTINGS.least_freedom), math.inf)
