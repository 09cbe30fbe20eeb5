"""Cost and likelihood at many points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result

LEAST_RESIDUAL = 1e-6  # minimum residual, share of the measurements; smaller ones are rounding


@dataclass(frozen=True)
class MemorySettings:
    """Simulations at a time."""

    samples: int = 1_000_000  # simulated samples in memory, 8 MB
    least: int = 64  # minimum of simulations, for all processors


MEMORY = MemorySettings()


@dataclass(frozen=True, eq=False)
class CostComponents:
    """Parts of the cost at m points."""

    squares: Floats  # (m, n_outputs), Σ ε² of each output, NaN if the simulation failed
    prior: Floats  # (m,), ‖W(θ₀ − θ)‖² of (1.37)

    def compound(self, variance: Floats) -> Floats:
        """Return J_C (1.37) with noise variances (n_outputs,), (m,)."""
        with np.errstate(over="ignore"):  # where simulations explode without failing
            return np.asarray((self.squares / variance).sum(axis=1) + self.prior, dtype=np.float64)

    def concentrated(self, problem: LeastSquares) -> Floats:
        """Return J_C (m,); each point implies the variances that are not given."""
        least = least_variance(problem)
        implied = np.maximum(problem.levels.pooled(self.squares, problem.counts) / problem.counts, least)
        estimated = np.isnan(problem.variance)
        given = self.squares / np.where(estimated, 1.0, problem.variance)
        parts = np.where(estimated, problem.counts * np.log(implied), given)
        return np.asarray(parts.sum(axis=1) + self.prior, dtype=np.float64)


def misfits(evaluator: Evaluator[LeastSquares], thetas: Floats) -> CostComponents:
    """Return the cost components at thetas (m, N), simulated in batches."""
    problem = evaluator.problem
    problem.check_measured()
    members = np.eye(problem.counts.size)[problem.groups]
    at_a_time = max(MEMORY.least, MEMORY.samples // problem.measured.size)
    squares = np.empty((len(thetas), problem.counts.size))
    for first in range(0, len(thetas), at_a_time):
        rows = evaluator.predict(thetas[first : first + at_a_time])
        with np.errstate(over="ignore", invalid="ignore"):  # too large to be squared is as bad as failed
            squares[first : first + at_a_time] = (rows - problem.measured) ** 2 @ members
    return CostComponents(squares, np.sum(problem.parameters.prior_residual(thetas) ** 2, axis=1))


def fitted(problem: LeastSquares, result: Result) -> CostComponents:
    """Return the parts of the cost at a result, without simulation."""
    errors = problem.measured - problem.stacked(result.fit.simulated)
    return CostComponents(
        problem.squares(errors)[None], np.sum(problem.parameters.prior_residual(result.values[None]) ** 2, axis=1)
    )


def least_variance(problem: LeastSquares) -> Floats:
    """Return the minimum noise variance of each output (n_outputs,)."""
    least = LEAST_RESIDUAL**2 * problem.output_variances(problem.measured)
    return np.where(least > 0, least, 1.0)


def variances(problem: LeastSquares, result: Result) -> Floats:
    """Return the given or estimated noise variance of each output (n_outputs,)."""
    estimated = np.array([result.fit.noise_variance[name] for name in problem.output_names])
    return np.where(np.isnan(problem.variance), np.maximum(estimated, least_variance(problem)), problem.variance)


def refuse_loss(problem: LeastSquares, what: str) -> None:
    """Raise `InputError` if the problem has a robust loss."""
    if problem.loss is not None:
        raise InputError(f"{what} needs the linear loss. Remove the robust loss, or {what}.")


def log_likelihood(problem: LeastSquares, residual: Floats, least: Floats) -> float:
    """Return Σ −(ln 2πσ_j² + r²/σ_j²)/2 of residuals (n,), without priors; NaN with a robust loss."""
    if problem.loss is not None:
        return math.nan
    sums = problem.squares(residual)
    implied = np.maximum(problem.levels.pooled(sums, problem.counts) / problem.counts, least)
    variance = np.where(np.isnan(problem.variance), implied, problem.variance)
    scale = 0.0 if problem.levels.scale is None else float(np.log(problem.levels.scale).sum())
    return -0.5 * float(np.sum(problem.counts * np.log(2.0 * math.pi * variance) + sums / variance)) - scale
