"""Minima of the criterion near a result: of all parameters, and of all others with one held at a value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation import (
    CostFunction,
    Descent,
    Evaluator,
    LeastSquares,
    Marquardt,
    Result,
    SensitivityError,
    State,
    TerminationReason,
    best_step,
    last_state,
    prepare,
    triangle,
)


@dataclass(frozen=True, eq=False)
class ConditionalOptimum:
    """A point that is the best one for some parameter held.

    Attributes
    ----------
    theta : (N,) array
        All parameters.
    residual, jacobian : (n_rows,) and (n_rows, N) arrays
        There, or very nearly so; of all parameters.
    outcome : TerminationReason
        How the search for the others ended.
    at_bounds : tuple of int
        The others that lie on a bound and are pushed outwards.
    """

    theta: Floats
    residual: Floats
    jacobian: Floats
    outcome: TerminationReason = TerminationReason.CONVERGED
    at_bounds: tuple[int, ...] = ()

    @property
    def criterion(self) -> float:
        """The sum of squares J_C (1.37)."""
        return float(self.residual @ self.residual)


def evaluator_of(problem: LeastSquares, result: Result) -> Evaluator[LeastSquares]:
    """Check that a result is one of this problem, and return what simulates it as the result was.

    Raises
    ------
    InputError
        If their parameters or outputs differ.
    """
    pairs = (
        ("parameters", result.names, problem.parameters.names),
        ("outputs", tuple(result.noise_variance), problem.output_names),
    )
    for what, has, needs in pairs:
        if has != needs:
            raise InputError(
                f"the result is of another problem: its {what} are {', '.join(has)}, and the problem's are "
                f"{', '.join(needs)}; give the result of this problem's identification"
            )
    return Evaluator(problem.as_in(result))


def best_near(evaluator: Evaluator[LeastSquares], result: Result) -> tuple[CostFunction, ConditionalOptimum]:
    """Return the criterion with the result's variances, and its minimum; the result's own may be a hair beside it."""
    # prepared where the search began: what has an effect there may have none left at the estimate, and is then flat
    problem, ready = evaluator.problem, prepare(evaluator, result.start)
    criterion = ready.criterion.reweighted(np.array([result.variance[name] for name in problem.output_names]))
    theta = np.array(result.values)
    at = criterion.evaluate(theta)
    state = last_state(Descent(Marquardt()), criterion, State(theta, at.residual, at.jacobian))
    jacobian = state.jacobian
    if not state.fresh:
        jacobian = criterion.jacobian(state.theta, state.residual, central=True)
    return criterion, ConditionalOptimum(state.theta, state.residual, jacobian)


class FixedParameterResidual:
    """A criterion as a function of all parameters but one, which is held at its value in theta; a `ResidualFunction`.

    Attributes
    ----------
    others : (N − 1,) array of int
        Their places among all parameters.
    lower, upper, noise
        As the criterion's, of the others.
    whole_jacobian : (n_rows, N) array or None
        The last Jacobian made, with the held parameter's column, which tells how the criterion changes with it.
    """

    def __init__(self, criterion: CostFunction, index: int, theta: Floats) -> None:
        self._criterion, self._theta = criterion, theta
        self.others = np.delete(np.arange(theta.size), index)
        self.lower, self.upper = criterion.lower[self.others], criterion.upper[self.others]
        self.noise = criterion.noise
        self.whole_jacobian: Floats | None = None

    def whole(self, thetas: Floats) -> Floats:
        """Return all parameters (..., N) of the others' values (..., N − 1)."""
        found = np.tile(self._theta, (*thetas.shape[:-1], 1)) if thetas.ndim > 1 else self._theta.copy()
        found[..., self.others] = thetas
        return found

    def magnitudes(self, theta: Floats) -> Floats:
        """Return how large each of the others is (N − 1,)."""
        return self._criterion.magnitudes(self.whole(theta))[self.others]

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, N − 1), NaN rows where failed."""
        return self._criterion.residuals(self.whole(thetas))

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N − 1)."""
        self.whole_jacobian = self._criterion.jacobian(self.whole(theta), residual, central=central)
        return self.whole_jacobian[:, self.others]

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation's noise anew, in steps (N − 1,) of the others."""
        whole = np.zeros(self._theta.size)
        whole[self.others] = steps
        found = self._criterion.measure_noise(self.whole(theta), residual, whole)
        self.noise = self._criterion.noise
        return found

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N − 1,)."""
        return self._criterion.jacobian_error(self.whole(theta), residual, central=central)[self.others]


def best_with(
    criterion: CostFunction, index: int, value: float, start: ConditionalOptimum
) -> ConditionalOptimum | None:
    """Return the best point with one parameter at a value, from a point near it; None where simulations fail.

    The others start where the linear model of the residual puts them: the step p that minimises
    ‖r + (∂r/∂ψ) Δψ + J p‖ within their bounds. Marquardt's search does the rest.

    Parameters
    ----------
    criterion : CostFunction
    index : int
        The parameter to hold.
    value : float
    start : ConditionalOptimum
    """
    theta = start.theta.copy()
    theta[index] = value
    rest = FixedParameterResidual(criterion, index, theta)
    inner = start.jacobian[:, rest.others]
    moved = start.residual + (value - start.theta[index]) * start.jacobian[:, index]
    others = _followed(rest, start, inner, moved) if rest.others.size else theta[:0]
    residual = rest.residuals(others[None])[0]
    if np.isnan(residual).any():
        return None
    state = State(others, residual, inner, fresh=False)
    try:
        if rest.others.size:
            state = last_state(Descent(Marquardt()), rest, state)
        else:
            rest.jacobian(others, residual, central=True)
            state = replace(state, outcome=TerminationReason.CONVERGED)
    except SensitivityError:  # as where it cannot be simulated: the profile has a gap here
        return None
    if state.outcome is None or state.outcome is TerminationReason.FAILING or rest.whole_jacobian is None:
        return None
    at_bounds = tuple(int(i) for i in rest.others[state.held]) if rest.others.size else ()
    return ConditionalOptimum(rest.whole(state.theta), state.residual, rest.whole_jacobian, state.outcome, at_bounds)


def _followed(rest: FixedParameterResidual, start: ConditionalOptimum, inner: Floats, moved: Floats) -> Floats:
    """Return where the Gauss–Newton step of the moved residual takes the others (N − 1,)."""
    others = start.theta[rest.others]
    reduced = triangle(inner, moved)
    lengths = np.linalg.norm(reduced[:, :-1], axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0 / rest.magnitudes(others))
    # singular directions are left alone, as the search itself does
    least = float(np.linalg.norm(rest.jacobian_error(others, start.residual, central=True) / lengths))
    step = best_step(reduced, lengths, rest.lower - others, rest.upper - others, least=least)
    return np.clip(others + step.step, rest.lower, rest.upper)
