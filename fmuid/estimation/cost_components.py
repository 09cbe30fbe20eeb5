"""The criterion at many points: sums of squares, simulated in batches as large as memory allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result

# Residuals below a millionth of the measurements are as good as none: comparing them would compare rounding.
LEAST_RESIDUAL = 1e-6


# Simulated samples held at a time, 8 MB; but never fewer simulations than keep all processors busy.
CHUNK_SAMPLES, LEAST_BATCH = 1_000_000, 64


@dataclass(frozen=True, eq=False)
class CostComponents:
    """The parts of the criterion at several thetas.

    Attributes
    ----------
    squares : (m, n_outputs) array
        Σ ε² of each output, NaN where the simulation failed.
    prior : (m,) array
        ‖W(θ₀ − θ)‖², the prior's part of (1.37).
    """

    squares: Floats
    prior: Floats

    def compound(self, variance: Floats) -> Floats:
        """Return J_C (1.37) with noise variances (n_outputs,), (m,)."""
        with np.errstate(over="ignore"):  # where simulations explode without failing
            return np.asarray((self.squares / variance).sum(axis=1) + self.prior, dtype=np.float64)

    def concentrated(self, problem: LeastSquares) -> Floats:
        """Return J_C with the variances that each theta implies where none is given, (m,)."""
        least = least_variance(problem)
        implied = np.maximum(problem.levels.pooled(self.squares, problem.counts) / problem.counts, least)
        estimated = np.isnan(problem.variance)
        given = self.squares / np.where(estimated, 1.0, problem.variance)
        parts = np.where(estimated, problem.counts * np.log(implied), given)
        return np.asarray(parts.sum(axis=1) + self.prior, dtype=np.float64)


def misfits(evaluator: Evaluator[LeastSquares], thetas: Floats) -> CostComponents:
    """Simulate thetas (m, N), as many at a time as memory allows, and sum up the squares of their residuals.

    The criterion itself needs no residual afterwards, so that maps and generations of any size fit into memory.
    """
    problem = evaluator.problem
    problem.check_measured()
    members = np.eye(problem.counts.size)[problem.groups]
    at_a_time = max(LEAST_BATCH, CHUNK_SAMPLES // problem.measured.size)
    squares = np.empty((len(thetas), problem.counts.size))
    for first in range(0, len(thetas), at_a_time):
        rows = evaluator.predict(thetas[first : first + at_a_time])
        with np.errstate(over="ignore", invalid="ignore"):  # too large to be squared is as bad as failed
            squares[first : first + at_a_time] = (rows - problem.measured) ** 2 @ members
    return CostComponents(squares, np.sum(problem.parameters.prior_residual(thetas) ** 2, axis=1))


def fitted(problem: LeastSquares, result: Result) -> CostComponents:
    """Return the criterion's parts at a result of this problem, from its fit: nothing is simulated."""
    assert result.history is not None, "not of a result that was read from a file"
    errors = problem.measured - problem.stacked(result.history.simulated)
    return CostComponents(
        problem.squares(errors)[None], np.sum(problem.parameters.prior_residual(result.values[None]) ** 2, axis=1)
    )


def least_variance(problem: LeastSquares) -> Floats:
    """Return the variance of each output (n_outputs,) below which a residual is as good as none."""
    least = LEAST_RESIDUAL**2 * problem.output_variances(problem.measured)
    return np.where(least > 0, least, 1.0)


def variances(problem: LeastSquares, result: Result) -> Floats:
    """Return the noise variance of each output (n_outputs,): the given one, or the one that the result estimates."""
    estimated = np.array([result.noise_variance[name] for name in problem.output_names])
    return np.where(np.isnan(problem.variance), np.maximum(estimated, least_variance(problem)), problem.variance)


def refuse_loss(problem: LeastSquares, what: str) -> None:
    """Refuse what sums plain squares for a problem that has another loss.

    Raises
    ------
    InputError
        If the problem's loss is not the plain square.
    """
    if problem.loss is not None:
        raise InputError(f"{what} knows plain squares only: give the problem no loss, or leave {what} out")


def log_likelihood(problem: LeastSquares, residual: Floats, least: Floats) -> float:
    """Return the logarithm of the density of the data, Σ −(ln 2πσ_j² + r²/σ_j²)/2, its constant included.

    With the variances that were given, and where none was with the most likely one, J_j/K_j: runs on the same data
    compare whatever they take the noise for. Priors are no part of it; NaN with a robust loss, which is none.

    Parameters
    ----------
    problem : LeastSquares
    residual : (n,) array
        Measured − simulated, as `LeastSquares.measured`.
    least : (n_outputs,) array
        The least that an estimated variance may be.
    """
    if problem.loss is not None:
        return math.nan
    sums = problem.squares(residual)
    implied = np.maximum(problem.levels.pooled(sums, problem.counts) / problem.counts, least)
    variance = np.where(np.isnan(problem.variance), implied, problem.variance)
    scale = 0.0 if problem.levels.scale is None else float(np.log(problem.levels.scale).sum())
    return -0.5 * float(np.sum(problem.counts * np.log(2.0 * math.pi * variance) + sums / variance)) - scale
