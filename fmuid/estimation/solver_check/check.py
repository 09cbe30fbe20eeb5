"""What the error of a simulation does to the estimates, from one finer simulation.

An error d of the outputs moves the residual by −d, and the estimates by (JᵀJ)⁻¹Jᵀ d of the whitened rows: the first
step of a search that would go on with the error taken away.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation.cost_components import fitted, misfits
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.identification import LEAST_CURVATURE
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.solver_check.outcome import SHIFT_LIMIT, AccuracyOutcome, SolverCheck

CLEARLY_BETTER_CRITERION = 10.0
"""Criteria that differ by more are not alike by chance."""
# No measurement is better than this share of its spread; a table without noise is, and no solver follows it.
LEAST_NOISE = 1e-5


def stack_simulated(problem: LeastSquares, result: Result) -> Floats:
    """Return the counted samples (n,) as they were simulated at a result, as `LeastSquares.measured` has them."""
    assert result.history is not None, "not of a result that was read from a file"
    return problem.stacked(result.history.simulated)


def estimate_solver_error(
    problem: LeastSquares, result: Result, error: Floats, *, controlled: bool = False
) -> SolverCheck:
    """Return what an error of the simulation does to the estimates.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Its optimum, with `Result.local`.
    error : (n,) array
        Of the counted samples: what a finer simulation gives less what was simulated; NaN where it fails.
    controlled : bool
        Whether both control their error: where they are the same to the last bit, steps as long as the samples keep
        even the finer tolerance. Others give the same because they step as they like.
    """
    unknown = np.full(len(result.names), np.nan)
    if not np.isfinite(error).all():
        return SolverCheck(AccuracyOutcome.FAILED, unknown)
    if not error.any() and not controlled:
        return SolverCheck(AccuracyOutcome.UNCHECKABLE, unknown)
    assert result.local is not None
    rows = error * _weights(problem, result)
    root, std = result.local.combined.root, result.std
    # not 0 where a standard deviation is infinite: it would hide everything
    with np.errstate(over="ignore", invalid="ignore"):  # of what explodes without failing
        step = root @ (root.T @ (result.local.jacobian.T @ rows))
        shift = step / np.where(np.isfinite(std) & (std > 0), std, np.nan)
        found = SolverCheck(AccuracyOutcome.PASSED, shift, change=float(np.linalg.norm(rows)))
    if found.largest > SHIFT_LIMIT:
        return replace(found, outcome=AccuracyOutcome.SHIFTED)
    return replace(found, outcome=AccuracyOutcome.UNKNOWN) if found.doubtful else found


def _weights(problem: LeastSquares, result: Result) -> Floats:
    """Return what a change of each counted sample counts in the rows of `Result.local` (n,)."""
    variance = np.array([result.variance[name] for name in problem.output_names])
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
    return np.asarray((weights * np.sqrt(np.maximum(mean, LEAST_CURVATURE)))[groups])


def with_shift(result: Result, accuracy: SolverCheck) -> Result:
    """Return a result whose covariance has what its estimates are shifted by, as far as that is known."""
    moved = np.nan_to_num(accuracy.shift) * np.where(np.isfinite(result.std), result.std, 0.0)
    both = np.outer(moved, moved)
    return replace(result, covariance=result.covariance + both, white_covariance=result.white_covariance + both)


def fits_worse(problem: LeastSquares, result: Result, other: Result) -> bool:
    """Return whether a result fits the data clearly worse than another one.

    An error e of the simulation, in standard deviations, makes the criterion larger by ‖e‖² on average, with a standard
    deviation of 2‖e‖: that a wrong simulation is better by `CLEARLY_BETTER_CRITERION` happens in
    less than one of 1000 cases.
    """
    return misfit_of(problem, result) - misfit_of(problem, other) > CLEARLY_BETTER_CRITERION


def would_fit_better(problem: LeastSquares, result: Result, other: Evaluator[LeastSquares], shift: Floats) -> bool:
    """Return whether another simulation of a problem may fit the data better than a result does.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Its optimum.
    other : Evaluator
        Of the same problem, simulated in another way; once more for this.
    shift : (N,) array
        By which the other simulation moves the estimates, in their standard deviations (`checked`).
    """
    if not np.isfinite(shift).all():
        return False
    there = np.clip(result.values + shift * result.std, problem.parameters.lower, problem.parameters.upper)
    reached, here = misfits(other, there[None]), fitted(problem, result)
    return bool(reached.concentrated(problem)[0] < here.concentrated(problem)[0])


def misfit_of(problem: LeastSquares, result: Result) -> float:
    """Return the criterion of a result with the variances that it implies where none is given."""
    if problem.loss is None:
        return float(fitted(problem, result).concentrated(problem)[0])
    counts = zip(problem.output_names, problem.counts.tolist(), strict=True)
    return math.fsum(count * math.log(result.noise_variance[name]) for name, count in counts)
