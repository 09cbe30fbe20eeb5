"""Solver error of the estimates, from one finer simulation.

An output error d shifts the estimates by (JᵀJ)⁻¹Jᵀ d in whitened rows (docs/method/solver-error.md).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation.cost_components import fitted, misfits
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.local_search import ROUNDS
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.solver_check import SHIFT_LIMIT, AccuracyOutcome, SolverCheck

# Significant cost difference: a solver error ‖e‖ adds ‖e‖² ± 2‖e‖, thus lowers the cost by 10 in < 0.1 % of cases.
CLEARLY_BETTER_CRITERION = 10.0
LEAST_NOISE = 1e-5  # minimum noise level, share of the spread of an output; data without noise have less


def stack_simulated(problem: LeastSquares, result: Result) -> Floats:
    """Return the simulated samples (n,) of a result, as `LeastSquares.measured`."""
    return problem.stacked(result.fit.simulated)


def estimate_solver_error(
    problem: LeastSquares, result: Result, error: Floats, *, controlled: bool = False
) -> SolverCheck:
    """Return the shift of an optimum by an error of the simulation.

    The error (n,) is the finer minus the used simulation of the scored samples, NaN if failed. If both simulations are
    `controlled`, identical outputs mean no error.
    """
    unknown = np.full(len(result.names), np.nan)
    if not np.isfinite(error).all():
        return SolverCheck(AccuracyOutcome.FAILED, unknown)
    if not error.any() and not controlled:
        return SolverCheck(AccuracyOutcome.UNCHECKABLE, unknown)
    assert result.fit.linearization is not None
    rows = error * _weights(problem, result)
    root, std = result.fit.linearization.combined.root, result.std
    # not 0 where a standard deviation is infinite: it would hide everything
    with np.errstate(over="ignore", invalid="ignore"):  # of what explodes without failing
        step = root @ (root.T @ (result.fit.linearization.jacobian.T @ rows))
        shift = step / np.where(np.isfinite(std) & (std > 0), std, np.nan)
        found = SolverCheck(AccuracyOutcome.PASSED, shift, change=float(np.linalg.norm(rows)))
    if found.largest > SHIFT_LIMIT:
        return replace(found, outcome=AccuracyOutcome.SHIFTED)
    return replace(found, outcome=AccuracyOutcome.UNKNOWN) if found.doubtful else found


def _weights(problem: LeastSquares, result: Result) -> Floats:
    """Return the weights (n,) of samples in `Result.fit.linearization`."""
    variance = np.array([result.fit.variance[name] for name in problem.output_names])
    groups = problem.groups
    spread = np.array([np.std(problem.measured[groups == j]) for j in range(variance.size)])
    # all together, as the rows of the Jacobian have their proportions
    scale = min(1.0, float(np.max(np.sqrt(variance) / np.maximum(LEAST_NOISE * spread, np.finfo(float).tiny))))
    weights = scale / np.sqrt(variance)
    if problem.loss is None:
        return np.asarray(weights[groups])
    curvature = problem.loss.curvature(
        (problem.measured - stack_simulated(problem, result)) / np.sqrt(variance)[groups]
    )
    mean = np.bincount(groups, weights=curvature, minlength=variance.size) / problem.counts
    return np.asarray((weights * np.sqrt(np.maximum(mean, ROUNDS.least_curvature)))[groups])


def with_shift(result: Result, accuracy: SolverCheck) -> Result:
    """Return the result with the known solver error in its covariance."""
    moved = np.nan_to_num(accuracy.shift) * np.where(np.isfinite(result.std), result.std, 0.0)
    both = np.outer(moved, moved)
    found = result.estimates
    white = found.covariance_white_noise + both
    wider = replace(found, covariance=found.covariance + both, covariance_white_noise=white)
    return replace(result, estimates=wider)


def fits_worse(problem: LeastSquares, result: Result, other: Result) -> bool:
    """Return True if a result fits significantly worse than another."""
    return misfit_of(problem, result) - misfit_of(problem, other) > CLEARLY_BETTER_CRITERION


def would_fit_better(problem: LeastSquares, result: Result, other: Evaluator[LeastSquares], shift: Floats) -> bool:
    """Return True if another simulation fits better, with shifted estimates."""
    if not np.isfinite(shift).all():
        return False
    there = np.clip(result.values + shift * result.std, problem.parameters.lower, problem.parameters.upper)
    reached, here = misfits(other, there[None]), fitted(problem, result)
    return bool(reached.concentrated(problem)[0] < here.concentrated(problem)[0])


def misfit_of(problem: LeastSquares, result: Result) -> float:
    """Return the concentrated cost of a result."""
    if problem.loss is None:
        return float(fitted(problem, result).concentrated(problem)[0])
    counts = zip(problem.output_names, problem.counts.tolist(), strict=True)
    return math.fsum(count * math.log(result.fit.noise_variance[name]) for name, count in counts)
