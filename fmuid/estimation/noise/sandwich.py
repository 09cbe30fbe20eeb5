"""Covariance of least-squares estimates whose residuals are coloured, and the degrees of freedom of its variances.

Near the truth an estimate moves with the whitened noise e of the data and with the error w of its prior as
H⁻¹(Jᵀe + Wᵀw), H = JᵀJ + WᵀW, so that whatever the noise's covariance Γ is, the estimate's is

    V = R (Cᵀ Γ C + (WR)ᵀ WR) Rᵀ,   C = J R,   R Rᵀ = H⁻¹.

Each output's noise is an autoregressive process, and innovations w of the outputs of one experiment belong together at
the same time only, cov(w_a, w_b) = S_ab (Parks). With Z_a the columns C_a filtered by 1/A_a backwards in time, CᵀΓC =
Σ_ab S_ab Z_aᵀ Z_b. All filters are products of spectra, of records padded to where the noise's memory ends.

The residual r has less of slow noise than e, for the fit takes part of it. What is missing on average under the model
found last,

    E[e eᵀ − r rᵀ] = Q Hᵀ + H Qᵀ,   H = ΓQ − Q (QᵀΓQ)/2,   Q an orthonormal basis of J,

is added to the residual's second moments, and the model fitted again, a few times over (Worsley et al., for their
images); this works with gaps, and comes close to what restricted likelihood gives.

The variances V_ii come from estimates themselves. By the scatter of the coefficients, cov φ = σ²R_p⁻¹/n, and of the
innovations' variances, 2σ⁴/n, they have ν_i = 2/var(log V_ii) degrees of freedom (Satterthwaite), and the interval of
an estimate is θ_i ± t(ν_i) √V_ii. Where an output's variance is given, its noise has that variance and the residual's
correlation: all models are fitted at the residual's own level, what is missing included, and scaled at the end.

With a robust loss the rows are those of its influence function (`fmuid.estimation.covariance`), and Γ is theirs.

References
----------
K. J. Worsley et al., "A general statistical analysis for fMRI data", NeuroImage 15, 2002;
R. W. Parks, "Efficient estimation of a system of regression equations when disturbances are both serially and
contemporaneously correlated", J. Am. Stat. Assoc. 62, 1967;
F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics Bulletin 2, 1946;
H. White, "Maximum likelihood estimation of misspecified models", Econometrica 50 (1), 1982.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.estimation.noise.autoregression import Autoregression, fit, most_orders
from fmuid.estimation.noise.model import NoiseModel
from fmuid.estimation.noise.output_series import OutputSeries
from fmuid.estimation.noise.periodic_error import PeriodicError, returning
from fmuid.estimation.noise.sample_grid import Rows, SampleGrid, Spectra
from fmuid.estimation.problem import LeastSquares

if TYPE_CHECKING:
    from fmuid.estimation.linearized_problem import LinearizedProblem


@dataclass(frozen=True)
class SandwichSettings:
    """Numbers of the rounds of correction for what the fit takes away."""

    rounds: int = 4
    """At most; ..."""
    long: int = 50_000
    """... one round for longer records, where it is slight, ..."""
    most_values: int = 30_000_000
    """... and none where it would take too much memory."""
    settled: float = 2e-3
    """They end when a round moves no variance by more than this share."""
    runaway: float = 100.0
    """A round that changes a variance by this factor, as near a random walk, does not count, and is the last."""
    slight: float = 2e-3
    """There is none where the fit has taken no more than this share of the squares of each output's noise."""
    least_freedom: float = 1.0
    """Fewer degrees of freedom than this are no fewer."""


SETTINGS = SandwichSettings()


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """The noise of all rows of data.

    Attributes
    ----------
    models : tuple of NoiseModel
        Experiment by experiment, output by output.
    innovations : tuple of (m, m) arrays
        The covariance S of the innovations of the series of each grid, in the order of the series.
    returning : tuple of PeriodicError
        Errors that come back with each cycle of the excitation.
    """

    models: tuple[NoiseModel, ...]
    innovations: tuple[Floats, ...]
    returning: tuple[PeriodicError, ...] = ()

    def gram(self, columns: Floats) -> Floats:
        """Return XᵀΓX (k, k) of columns X (n, k) over the rows, Γ the covariance of their whitened noise."""
        total = np.zeros((columns.shape[1], columns.shape[1]))
        for members, common in self.grids():
            spectra = Spectra.of(columns, [each.series for each in members], [each.process for each in members])
            total += spectra.gram(spectra.coupled(common))
        return total + sum(each.gram(columns) for each in self.returning)

    def grids(self) -> list[tuple[list[NoiseModel], Floats]]:
        """Return the models of each grid, and the covariance of their innovations."""
        grids = _members([each.series.grid for each in self.models])
        return [([self.models[i] for i in own], s) for own, s in zip(grids, self.innovations, strict=True)]


@dataclass(frozen=True, eq=False)
class SandwichCovariance:
    """A covariance, and what it rests on.

    Attributes
    ----------
    covariance : (N, N) array
        V.
    freedom : (N,) array
        Degrees of freedom of its diagonal.
    noise : ResidualNoise
    """

    covariance: Floats
    freedom: Floats
    noise: ResidualNoise


def sandwich_of(problem: LeastSquares, local: LinearizedProblem, rounding: Flags) -> SandwichCovariance:
    """Return the covariance of the estimates of a problem under the noise that their residual shows.

    Parameters
    ----------
    problem : LeastSquares
    local : LinearizedProblem
        At the estimate.
    rounding : (n_outputs,) array of bool
        Outputs whose residual is nothing but rounding and the noise of the simulation.
    """
    root, given = local.root, ~np.isnan(problem.variance)
    # of a robust loss the scale of the influence function is the residual's own
    given &= problem.loss is None
    own, columns = local.prior_jacobian @ root, local.jacobian @ root
    residual, basis = local.residual, columns
    if len(own):
        basis = local.data_basis
        residual = residual - basis @ (basis.T @ residual)
    rows = Rows(residual, basis, columns, root, own.T @ own, given, rounding)
    found = sandwich(rows, problem.series)
    found = _with_returning(found, rows, problem.periods)
    lost = ~np.isfinite(np.diag(local.combined.covariance))
    covariance = found.covariance.copy()
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    return replace(found, covariance=covariance)


def sandwich(rows: Rows, series: Sequence[OutputSeries]) -> SandwichCovariance:
    """Return the covariance of estimates under the noise that their residual shows.

    Parameters
    ----------
    rows : Rows
    series : sequence of OutputSeries
        Of all rows.
    """
    grids, pools = _members([each.grid for each in series]), _members([each.pool for each in series])
    parts = [SampleGrid(rows, [series[i] for i in members], members) for members in grids]
    rounds, spread = _rounds(rows), np.full(rows.basis.shape[1], math.inf)
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
        if not done and _slight(float(spread.sum()), models.values()):
            break
        for part in parts:
            part.add_removed(gram)
    if rows.given.any():
        models = _as_given(models, rows, series)
        gram = _taken(parts, models, rows)
    if rows.columns is not rows.basis:
        gram = np.sum([part.take(part.models, rows.columns, part.innovations) for part in parts], axis=0)
    inner = gram + rows.prior
    covariance = rows.root @ inner @ rows.root.T
    freedom = _freedom(rows, np.diag(covariance), series, parts, pools)
    noise = ResidualNoise(
        tuple(NoiseModel(each, models[i]) for i, each in enumerate(series)), tuple(part.innovations for part in parts)
    )
    return SandwichCovariance(covariance, freedom, noise)


def _with_returning(found: SandwichCovariance, rows: Rows, periods: Mapping[str, float]) -> SandwichCovariance:
    """Return a sandwich with what returns with each cycle of the excitation."""
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
    """Return the indices that have each number."""
    found: dict[int, list[int]] = {}
    for index, number in enumerate(numbers):
        found.setdefault(number, []).append(index)
    return list(found.values())


def _taken(parts: Sequence[SampleGrid], models: dict[int, Autoregression], rows: Rows) -> Floats:
    """Take models for the noise of the series of all grids, and return the sum of QᵀΓQ."""
    return np.asarray(np.sum([part.take([models[i] for i in part.members], rows.basis) for part in parts], axis=0))


def _rounds(rows: Rows) -> int:
    if rows.columns.size > SETTINGS.most_values:
        return 0
    return SETTINGS.rounds if len(rows.residual) <= SETTINGS.long else 1


def _slight(taken: float, models: Iterable[Autoregression]) -> bool:
    """Return whether the fit, which has taken so much of the sum of squares, has hardly taken any of an output's."""
    return all(taken <= SETTINGS.slight * each.samples * each.variance * each.gain for each in models)


def _models(
    rows: Rows, series: Sequence[OutputSeries], parts: Sequence[SampleGrid], pools: Sequence[Sequence[int]]
) -> dict[int, Autoregression]:
    """Fit the noise of each pool of series to their second moments, with what the fit has removed from them."""
    columns = {index: own for part in parts for index, own in zip(part.members, part.columns, strict=True)}
    there = {index: own for part in parts for index, own in zip(part.members, part.there, strict=True)}
    models: dict[int, Autoregression] = {}
    for members in pools:
        group, samples = series[members[0]].group, sum(series[i].rows.size for i in members)
        if rows.white[group]:
            model = Autoregression(np.zeros(0), 1.0, samples)
        else:
            orders = most_orders(samples, max(there[i].size for i in members))
            extra = len(columns[members[0]]) // 2
            weights = np.repeat([1.0, 0.5, -0.5], [1, extra, extra])
            model = fit(*_joined([(columns[i], there[i]) for i in members], orders + 1), weights, orders)
        models |= dict.fromkeys(members, model)
    return models


def _as_given(
    models: Mapping[int, Autoregression], rows: Rows, series: Sequence[OutputSeries]
) -> dict[int, Autoregression]:
    """Return models with the correlation found, and the variance 1 where it was given."""
    scaled = rows.given & ~rows.white
    return {index: model.of_variance(1.0) if scaled[series[index].group] else model for index, model in models.items()}


def _joined(blocks: Sequence[tuple[Floats, Flags]], gap: int) -> tuple[Floats, Flags]:
    """Return series one after the other, so far apart that they have nothing to do with each other."""
    if len(blocks) == 1:
        return blocks[0]
    columns = [np.pad(block, ((0, 0), (0, gap))) for block, _ in blocks]
    return np.concatenate(columns, axis=1), np.concatenate([np.pad(there, (0, gap)) for _, there in blocks])


def _freedom(
    rows: Rows,
    variances: Floats,
    series: Sequence[OutputSeries],
    parts: Sequence[SampleGrid],
    pools: Sequence[Sequence[int]],
) -> Floats:
    """Return the degrees of freedom of the variances (N,), from the scatter of the models they rest on."""
    taken = np.einsum("ij,ij->i", rows.basis, rows.basis)
    slopes = {index: own for part in parts for index, own in zip(part.members, part.slopes(), strict=True)}
    model = {index: own for part in parts for index, own in zip(part.members, part.models, strict=True)}
    scatter = np.zeros(len(variances))
    for members in pools:
        total = np.sum([slopes[i] for i in members], axis=0)
        # relative, for in some units squares of variances are beyond all numbers
        share = np.divide(total, variances[:, None], out=np.zeros_like(total), where=variances[:, None] > 0.0)
        own = model[members[0]]
        # of what the fit has taken away nothing can be told
        left = own.samples - sum(float(taken[series[i].rows].sum()) for i in members)
        scatter += np.einsum("ij,jl,il->i", share, own.scatter(), share) / max(left, np.finfo(float).tiny)
    with np.errstate(divide="ignore"):
        freedom = 2.0 / scatter
    return np.where(scatter > 0.0, np.maximum(freedom, SETTINGS.least_freedom), math.inf)
