"""Covariance of a result, known better than in its search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    LeastSquares,
    Result,
    SolverCheck,
    sandwich_of,
    share_left,
    uneven_levels,
    with_shift,
)


def with_covariance(result: Result, covariance: Floats, white: Floats, freedom: Floats) -> Result:
    """Return a result with another covariance; its solver error moves it by as much as before.

    `white` (N, N) is the covariance under white noise, `freedom` (N,) that of the variances.
    """
    check, before = result.accuracy, std_without_shift(result)
    found = replace(result.estimates, covariance=covariance, covariance_white_noise=white, variance_dof=freedom)
    return with_solver_error(replace(result, estimates=found, accuracy=None), check, before)


def with_solver_error(result: Result, check: SolverCheck | None, before: Floats) -> Result:
    """Return a result with a solver check made in other σ.

    These (k,) are `before`, of its first estimates. Its own σ allow for a large error.
    """
    if check is None:
        return result
    shift = np.full(len(result.std), np.nan)
    shift[: len(before)] = check.shift * before / result.std[: len(before)]
    check = replace(check, shift=shift)
    if check.outcome is AccuracyOutcome.PASSED and check.largest > SHIFT_LIMIT:
        check = replace(check, outcome=AccuracyOutcome.SHIFTED)
    result = replace(result, accuracy=check)
    return with_shift(result, check) if check.outcome is AccuracyOutcome.SHIFTED else result


def std_without_shift(result: Result) -> Floats:
    """Return σ (N,) without the solver error."""
    check = result.accuracy
    if check is None or check.outcome is not AccuracyOutcome.SHIFTED:
        return result.std
    return np.asarray(result.std / np.sqrt(1.0 + np.nan_to_num(check.shift) ** 2))


def include_uneven_noise(problem: LeastSquares, result: Result) -> Result:
    """Return a result whose covariance allows for noise that follows its signal.

    Not during the search: errors of a solver follow the signal, too, and would pass for its noise.
    """
    local = result.fit.linearization
    if local is None or not result.converged or not result.fit.is_noisy or not np.isfinite(result.std).all():
        return result
    noise, simulated = result.fit.noise, problem.measured - local.levels * local.residual
    if problem.loss is not None or noise is None:
        return result
    left = None if len(local.prior_jacobian) else share_left(problem, local.jacobian @ local.root)
    if uneven_levels(noise.models, local.residual, simulated, left) is None:
        return result
    found = sandwich_of(problem, local, np.zeros(problem.counts.size, dtype=np.bool_), uneven=True)
    white = local.root @ local.root.T  # without the solver error, which is added again
    return with_covariance(
        replace(result, fit=replace(result.fit, noise=found.noise)), found.covariance, white, found.freedom
    )
