"""Optima near a result: global, and with one parameter fixed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.estimation import (
    CostFunction,
    Descent,
    Evaluator,
    LeastSquares,
    LinearModel,
    Marquardt,
    Result,
    SensitivityError,
    State,
    TerminationReason,
    last_state,
    prepare,
    triangle,
)


@dataclass(frozen=True, eq=False)
class ConditionalOptimum:
    """Optimum of some parameters, the others fixed."""

    theta: Floats  # (N,), all parameters
    residual: Floats  # (n_rows,), there or very nearly so
    jacobian: Floats  # (n_rows, N), likewise
    outcome: TerminationReason = TerminationReason.CONVERGED
    at_bounds: tuple[int, ...] = ()  # parameters at a bound that are pushed outwards

    @property
    def cost(self) -> float:
        """The cost J_C (1.37)."""
        return float(self.residual @ self.residual)


def best_near(evaluator: Evaluator[LeastSquares], result: Result) -> tuple[CostFunction, ConditionalOptimum]:
    """Return the cost function with the result's variances, and its minimum."""
    function = cost_at(evaluator, result)
    theta = np.array(result.values)
    state = minimized(function, State(theta, *function.evaluate(theta)))
    return function, ConditionalOptimum(state.theta, state.residual, state.jacobian)


def cost_at(evaluator: Evaluator[LeastSquares], result: Result) -> CostFunction:
    """Return the cost function with the noise variances of a result.

    It is prepared where the search began: parameters that act there may be without effect at the estimate.
    """
    variance = np.array([result.fit.variance[name] for name in evaluator.problem.output_names])
    return prepare(evaluator, result.estimates.start).criterion.reweighted(variance)


def minimized(function: CostFunction | PartialCost, state: State) -> State:
    """Return the last state of Marquardt's search, with a Jacobian there."""
    state = last_state(Descent(Marquardt()), function, state)
    if state.fresh:
        return state
    return replace(state, jacobian=function.jacobian(state.theta, state.residual, central=True))


class PartialCost:
    """Cost function of some parameters (k,), perhaps of its first rows alone."""

    def __init__(self, function: CostFunction, theta: Floats, free: Indices | slice, rows: int | None = None) -> None:
        self._function, self._theta, self.free, self._rows = function, theta, free, slice(rows)
        self.lower, self.upper = function.lower[free], function.upper[free]
        self.noise = function.noise
        self.whole_jacobian: Floats | None = None  # the last Jacobian, by all parameters

    def whole(self, thetas: Floats) -> Floats:
        """Return all parameters (..., N) by the free ones (..., k)."""
        found = np.tile(self._theta, (*thetas.shape[:-1], 1)) if thetas.ndim > 1 else self._theta.copy()
        found[..., self.free] = thetas
        return found

    def magnitudes(self, theta: Floats) -> Floats:
        """Return the magnitudes (k,)."""
        return self._function.magnitudes(self.whole(theta))[self.free]

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, k), NaN rows where failed."""
        return self._function.residuals(self.whole(thetas))[:, self._rows]

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, k)."""
        self.whole_jacobian = self._function.jacobian(self.whole(theta), residual, central=central)[self._rows]
        return self.whole_jacobian[:, self.free]

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation's noise anew, in steps (k,)."""
        whole = np.zeros(self._theta.size)
        whole[self.free] = steps
        found = self._function.measure_noise(self.whole(theta), residual, whole)
        self.noise = self._function.noise
        return found

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error of each Jacobian column (k,)."""
        return self._function.jacobian_error(self.whole(theta), residual, central=central)[self.free]


def best_with(function: CostFunction, index: int, value: float, start: ConditionalOptimum) -> ConditionalOptimum | None:
    """Return the optimum with one parameter fixed, None where simulations fail.

    The others start where the linear model of the residual at `start` puts them within their bounds.
    """
    theta = start.theta.copy()
    theta[index] = value
    free = np.delete(np.arange(theta.size), index)
    rest = PartialCost(function, theta, free)
    inner = start.jacobian[:, free]
    moved = start.residual + (value - start.theta[index]) * start.jacobian[:, index]
    others = _followed(rest, start, inner, moved) if free.size else theta[:0]
    residual = rest.residuals(others[None])[0]
    if np.isnan(residual).any():
        return None
    state = State(others, residual, inner, fresh=False)
    try:
        if free.size:
            state = last_state(Descent(Marquardt()), rest, state)
        else:
            rest.jacobian(others, residual, central=True)
            state = replace(state, outcome=TerminationReason.CONVERGED)
    except SensitivityError:  # as where it cannot be simulated: the profile has a gap here
        return None
    if state.outcome is None or state.outcome is TerminationReason.FAILING or rest.whole_jacobian is None:
        return None
    at_bounds = tuple(int(i) for i in free[state.held]) if free.size else ()
    return ConditionalOptimum(rest.whole(state.theta), state.residual, rest.whole_jacobian, state.outcome, at_bounds)


def _followed(rest: PartialCost, start: ConditionalOptimum, inner: Floats, moved: Floats) -> Floats:
    """Return the others (N − 1,) after a Gauss–Newton step."""
    others = start.theta[rest.free]
    reduced = triangle(inner, moved)
    lengths = np.linalg.norm(reduced[:, :-1], axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0 / rest.magnitudes(others))
    # singular directions are left alone, as the search itself does
    least = float(np.linalg.norm(rest.jacobian_error(others, start.residual, central=True) / lengths))
    step = LinearModel(reduced, lengths, least).step(rest.lower - others, rest.upper - others)
    return np.clip(others + step.step, rest.lower, rest.upper)
