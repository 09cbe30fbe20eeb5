"""Directed tests of model errors (docs/method/directed-tests.md).

With whitened residual r, sensitivities S and direction d, all orthogonal to S: t = dᵀr/(s |d|). The probability of the
largest |t| of all directions is simulated with their correlations. Size dᵀr/|d|²; the estimates take S⁺d of a unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from scipy import special

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.estimation import LeastSquares, LinearizedProblem, ResidualNoise, Result, augmented
from fmuid.identification.acquisition_delay import DELAY_PRIOR, delay_columns
from fmuid.identification.feedback import find_feedback
from fmuid.identification.model_errors import LEVEL, DirectedTest, Direction, ErrorKind, ModelError, ModelErrors


@dataclass(frozen=True)
class DirectedTestSettings:
    """Numbers of the directed tests."""

    draws: int = 20_000  # of the null; 200 of them are beyond the level
    seed: int = 0
    least_share: float = 0.01  # of a direction that the parameters leave; less is not testable
    alternative: float = 4.0  # of −2 ln L: directions that explain as much
    close_share: float = 0.6  # of the strongest score²: a dead time that scores so much may be the error
    most: int = 3  # errors named
    power: float = 0.95  # of records in which a detectable size shows
    checked: int = 3  # strongest unweighted directions, tested with the noise that is left beside them: ...
    prior_share: float = 0.1  # usual error of a prior's mean, of the parameter's magnitude
    checked_share: float = 0.25  # ... they have this part of the level, for noise models that took an offset for noise


SETTINGS = DirectedTestSettings()


class WhitenedRows:
    """Residual, sensitivities and directions of a result, whitened by its noise model; prior rows beside them."""

    def __init__(self, problem: LeastSquares, result: Result, directions: Sequence[Direction]) -> None:
        local, noise = result.fit.linearization, result.fit.noise
        assert local is not None and noise is not None, "a result from a file has neither"
        columns = np.stack([each.column for each in directions], axis=1) / local.levels[:, None]
        self.directions, self.problem, self.result = directions, problem, result
        self.is_colored = is_colored(noise)
        self.raw = np.column_stack([local.residual, -local.jacobian, columns])
        self.prior = np.column_stack([local.prior_residual, -local.prior_jacobian])
        none = np.zeros(len(self.prior))
        priors = np.stack([each.prior if each.prior.size else none for each in directions], axis=1)
        self.shift = np.nan_to_num(_response(problem, result, columns) / result.std[:, None])
        beside = np.hstack([self.prior, priors])
        rows, first = np.vstack([whitened(noise, self.raw), beside]), 1 + len(result.names)
        self.residual, self.sensitivities, self.columns = rows[:, 0], rows[:, 1:first], rows[:, first:]
        self.innovations = self.residual[: len(self.raw)]


def is_colored(noise: ResidualNoise) -> bool:
    """Return True if noise differs from white noise significantly (2 σ)."""
    processes = [each.process for each in noise.models]
    return any(p.pole or np.abs(p.coefficients).sum() > 2.0 / math.sqrt(max(p.samples, 1)) for p in processes)


def _response(problem: LeastSquares, result: Result, columns: Floats) -> Floats:
    """Return the change (N, k) of the estimates by whitened outputs."""
    local = result.fit.linearization
    assert local is not None, "checked before"
    if result.fit.delay is None:
        return np.asarray(local.root @ (local.root.T @ (-local.jacobian.T @ columns)))
    delays = delay_columns(problem, result)
    return augmented(local, delays, DELAY_PRIOR).response(columns)[: len(result.names)]


def whitened(noise: ResidualNoise, rows: Floats) -> Floats:
    """Return uncorrelated innovations (n, k) of rows, of unit variance."""
    rows = rows if noise.levels is None else rows / noise.levels[:, None]
    found = np.array(rows)
    for members, common in noise.grids():
        places = members[0].series.places
        parts = [each.whiten(rows[each.series.rows]) for each in members]
        if len(members) > 1 and all(np.array_equal(each.series.places, places) for each in members):
            std = np.sqrt(np.diag(common))
            factor = np.linalg.cholesky(common / np.outer(std, std) + 1e-9 * np.eye(len(std)))
            stacked = np.stack(parts).reshape(len(parts), -1)
            parts = list(scipy.linalg.solve_triangular(factor, stacked, lower=True).reshape(np.stack(parts).shape))
        for each, part in zip(members, parts, strict=True):
            found[each.series.rows] = part
    return found


def score_directions(rows: WhitenedRows, known: Sequence[int] = ()) -> list[DirectedTest]:
    """Test all directions beside the parameters and those already `known` (indices)."""
    fitted = np.hstack([rows.sensitivities, rows.columns[:, list(known)]])
    basis = orthonormal_basis(fitted)
    residual = rows.residual - basis @ (basis.T @ rows.residual)
    left = rows.columns - basis @ (basis.T @ rows.columns)
    free = len(residual) - fitted.shape[1]
    spread = math.sqrt(float(residual @ residual) / max(free, 1))
    whole, lengths = np.linalg.norm(rows.columns, axis=0), np.linalg.norm(left, axis=0)
    share = lengths / np.maximum(whole, 1e-300)
    testable = [j for j in range(len(share)) if share[j] > SETTINGS.least_share and j not in known and spread > 0.0]
    unit = left[:, testable] / lengths[testable]
    products = unit.T @ residual
    rest = np.maximum(float(residual @ residual) - products**2, 1e-300) / max(free - 1, 1)
    scores = np.sign(products) * normal_scores(np.abs(products) / np.sqrt(rest), free - 1)
    beside = np.zeros(len(testable))
    checked = SETTINGS.checked if rows.is_colored else 0
    for k in np.argsort(-np.abs(_unweighted(rows, known, testable)))[:checked].tolist():
        beside[k] = _wald_score(rows, [*known, testable[k]])
    one_sided = np.array([rows.directions[j].one_sided for j in testable], bool)
    if one_sided.any():
        scores, beside = (np.where(one_sided, np.maximum(each, 0.0), each) for each in (scores, beside))
    null = largest_scores(unit.T @ unit)
    critical = float(np.quantile(null, 1.0 - LEVEL)) if len(null) else math.inf
    found = []
    for j, each in enumerate(rows.directions):
        shift = rows.shift[:, j]
        if j not in testable:
            found.append(DirectedTest(each, float(share[j]), 0.0, 1.0, 0.0, math.inf, math.inf, shift))
            continue
        k = testable.index(j)
        std = spread / lengths[j]
        detectable = float(std * (critical + special.ndtri(SETTINGS.power)))
        score, probability = _larger(
            null, float(scores[k]), float(beside[k]), SETTINGS.checked_share if checked else 0.0
        )
        size = float(products[k] / lengths[j])
        found.append(DirectedTest(each, float(share[j]), score, probability, size, float(std), detectable, shift))
    return found


def orthonormal_basis(columns: Floats) -> Floats:
    """Return an orthonormal basis of columns (n, k)."""
    u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s.max(initial=0.0)])


def _wald_score(rows: WhitenedRows, chosen: Sequence[int]) -> float:
    """Return the normal score of the last direction, freed beside the others: its size over σ of the noise left."""
    local = rows.result.fit.linearization
    assert local is not None, "checked before"
    seen = [j for j in chosen if rows.directions[j].kind is not ErrorKind.PRIOR]
    freed = augmented(local, rows.raw[:, [1 + len(rows.result.names) + j for j in seen]])
    found = freed.sandwich(rows.problem)
    wald = float(freed.step[-1] / math.sqrt(found.covariance[-1, -1]))
    return float(np.sign(wald) * normal_scores(np.array([abs(wald)]), float(found.freedom[-1]))[0])


def _unweighted(rows: WhitenedRows, known: Sequence[int], among: Sequence[int]) -> Floats:
    """Return unweighted scores of directions beside the parameters and those known."""
    first = 1 + len(rows.result.names)
    fitted = rows.raw[:, [*range(1, first), *(first + j for j in known)]]
    basis = orthonormal_basis(fitted)
    columns = rows.raw[:, [first + j for j in among]]
    columns = columns - basis @ (basis.T @ columns)
    return np.asarray(columns.T @ rows.raw[:, 0] / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def normal_scores(t: Floats, freedom: float) -> Floats:
    """Return normal scores of t statistics (m,), exact far into the tails."""
    if not freedom < 1e4:
        return t
    return np.asarray(-special.ndtri_exp(np.log(np.maximum(special.stdtr(freedom, -t), 1e-300))))


def _larger(null: Floats, score: float, beside: float, share: float) -> tuple[float, float]:
    """Return the more significant of two scores; the second has a share."""
    own = probability_of(null, abs(score)) / (1.0 - share)
    other = probability_of(null, abs(beside)) / share if beside else 1.0
    return (score, min(own, 1.0)) if own <= other else (beside, min(other, 1.0))


@lru_cache(maxsize=4)  # the tests of a refit have nearly as many directions
def _draws(count: int) -> Floats:
    """Return normal draws (draws, count)."""
    return np.random.default_rng(SETTINGS.seed).standard_normal((SETTINGS.draws, count))


def largest_scores(correlation: Floats) -> Floats:
    """Return the sorted largest |z| of correlated draws (m, m)."""
    if not len(correlation):
        return np.zeros(0)
    values, vectors = np.linalg.eigh(correlation)
    return np.sort(np.abs(_draws(len(correlation)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T).max(axis=1))


def probability_of(null: Floats, score: float) -> float:
    """Return the probability of a largest score; beyond the draws by Bonferroni with the effective number of tests."""
    counted = 1.0 - np.searchsorted(null, score) / len(null)
    if counted > 40 / len(null):
        return float(counted)
    effective = max(1.0, (1.0 - np.searchsorted(null, 3.0) / len(null)) / (2.0 * special.ndtr(-3.0)))
    return float(min(1.0, effective * 2.0 * special.ndtr(-score)))


@single_threaded
def find_model_errors(problem: LeastSquares, result: Result) -> ModelErrors | None:
    """Test all directions of a result; select significant ones, the strongest first, each beside the others.

    None where there is nothing to test: no FMU, a robust loss, or a residual of rounding errors.
    """
    local = result.fit.linearization
    if local is None or problem.loss is not None or not np.isfinite(local.jacobian).all():
        return None
    if not result.fit.is_noisy:
        return None
    directions = problem.directions(result)
    if not directions:
        return None
    directions = (*directions, *_prior_directions(result, local))
    rows = WhitenedRows(problem, result, directions)
    first = found = score_directions(rows)
    known: list[int] = []
    errors: list[ModelError] = []
    while len(known) < SETTINGS.most:
        significant = [each for each in found if each.probability <= LEVEL]
        if not significant:
            break
        strongest = max(significant, key=lambda each: each.evidence)
        alternatives = [each.direction for each in found if _is_alternative(each, strongest)]
        errors.append(ModelError(strongest, tuple(alternatives)))
        known.append(found.index(strongest))
        found = score_directions(rows, known)
    tests = tuple(each for each in first if each.direction.kind is not ErrorKind.PRIOR)  # intervals have the prior's σ
    return ModelErrors(result.names, tests, tuple(errors), feedback=find_feedback(problem, rows.innovations))


def _prior_directions(result: Result, local: LinearizedProblem) -> Iterator[Direction]:
    """Yield a wrong mean of each parameter's prior, in its standard deviations."""
    for i, (name, std) in enumerate(zip(result.names, result.estimates.prior_std.tolist(), strict=True)):
        if math.isfinite(std) and local.prior_jacobian[:, i].any():
            usual = max(1.0, SETTINGS.prior_share * float(local.magnitudes[i]) / std)
            own = -std * local.prior_jacobian[:, i]
            yield Direction(ErrorKind.PRIOR, (name,), "σ", usual, column=np.zeros(len(local.residual)), prior=own)


def _is_alternative(test: DirectedTest, strongest: DirectedTest) -> bool:
    """Return True if another direction explains as much; a dead time is not linear in its size and scores too low."""
    share = SETTINGS.close_share if test.direction.kind is ErrorKind.DEAD_TIME else 1.0
    least = min(strongest.evidence - SETTINGS.alternative, share * strongest.score**2)
    return test is not strongest and bool(test.score) and test.evidence > least
