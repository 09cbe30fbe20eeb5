"""Cost function (1.37): data and prior as one sum of squares."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Flags, Floats
from fmuid.errors import FmuidError, InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.finite_differences import BoundedFunction, Derivatives, SensitivityError
from fmuid.estimation.inactive_parameters import find_active_point
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.simulation_noise import noise_along, shares_of, table_noise

LEAST_NOISE = 2.0**-47  # least noise level, share of the measured values: rounding of exact fits
MORE_NOISE = 2.0  # factor by which newly measured simulation noise replaces the known one


class CostFunction:
    """Cost function (1.37) for fixed noise variances, as a sum of squares.

    Rows are whitened residuals (measured − simulated)/σ, then prior rows W(θ₀ − θ). A robust loss gives roots ±√ρ(f²).

    Variances (n_outputs,) are `variance`, which whitens, and `least_variance`, which simulation noise and rounding
    allow. `simulation_noise` (n_outputs,) is in units of the outputs; `noise` is its RMS in the whitened residual.
    """

    def __init__(
        self, evaluator: Evaluator[LeastSquares], variance: Floats, noise: Floats, least_variance: Floats, start: Floats
    ) -> None:
        self.evaluator, self.problem = evaluator, evaluator.problem
        self.simulation_noise, self.least_variance, self._start = noise, least_variance, start
        parameters = self.problem.parameters
        self.lower, self.upper = parameters.lower, parameters.upper
        simulated = evaluator.predict, self.lower, self.upper, parameters.reach, evaluator.predict_start
        function, rows = BoundedFunction(*simulated, evaluator.derivatives), self._weigh(variance)
        alike = evaluator.cache.problems > 1
        self._derivatives = Derivatives(function, rows, self._size, -self._weights, alike=alike)

    def _weigh(self, variance: Floats) -> Floats:
        """Whiten by noise variances; return the noise of each row (n,)."""
        self.variance = variance
        self._weights = (1.0 / np.sqrt(variance))[self.problem.groups]
        self._size = _rms(self._start * self._weights)
        rows: Floats = self.simulation_noise[self.problem.groups] * self._weights
        self.noise = _rms(rows)
        return rows

    def reweighted(self, variance: Floats) -> CostFunction:
        """Return the cost function with other noise variances, same difference steps."""
        other = copy.copy(self)
        rows = other._weigh(variance)
        other._derivatives = self._derivatives.weighted(-other._weights, rows)
        return other

    def converted(self, other: CostFunction, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
        """Convert residual and Jacobian to a cost function with other variances."""
        residual, jacobian = self.unrooted(residual, jacobian)
        loss, data, scale = self.problem.loss, self._weights.size, np.ones(residual.size)
        scale[:data] = other._weights / self._weights
        residual, jacobian = residual * scale, jacobian * scale[:, None]
        if loss is not None:
            jacobian[:data] *= loss.slope(residual[:data])[:, None]
            residual[:data] = loss.root(residual[:data])
        return residual, jacobian

    def unrooted(self, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian with f in place of ±√ρ(f²)."""
        if self.problem.loss is None:
            return residual, jacobian
        residual, jacobian, data = residual.copy(), jacobian.copy(), self._weights.size
        residual[:data] = self._whitened(residual)
        jacobian[:data] /= self.problem.loss.slope(residual[:data])[:, None]
        return residual, jacobian

    def _whitened(self, residual: Floats) -> Floats:
        """Return the whitened residuals f (n,) of the data."""
        rows = residual[: self._weights.size]
        return rows if self.problem.loss is None else self.problem.loss.unroot(rows)

    def magnitudes(self, theta: Floats) -> Floats:
        """Return the magnitudes (N,) of the parameters at theta."""
        return self.problem.parameters.magnitudes(theta)

    def residuals(self, thetas: Floats) -> Floats:
        """Simulate thetas (m, N); return residuals (m, n_rows), NaN if failed."""
        return self.whiten(thetas, self.evaluator.predict(thetas))

    def whiten(self, thetas: Floats, predictions: Floats) -> Floats:
        """Return the residual (m, n_rows) of given simulations."""
        data, loss = self._weights.size, self.problem.loss
        rows = np.empty((len(thetas), data + len(self.problem.parameters.prior_whitening)))
        np.subtract(self.problem.measured, predictions, out=rows[:, :data])
        with np.errstate(over="ignore"):  # what overflows is rejected like what fails
            rows[:, :data] *= self._weights
        if loss is not None:
            rows[:, :data] = loss.root(rows[:, :data])
        if rows.shape[1] > data:
            rows[:, data:] = self.problem.parameters.prior_residual(thetas)
        return rows

    def unwhiten(self, residual: Floats) -> Floats:
        """Return measured − simulated (n,) of a residual (n_rows,)."""
        return np.asarray(self._whitened(residual) / self._weights, dtype=np.float64)

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N) of the residual; `SensitivityError` if all around theta fail."""
        base = self.problem.measured - self.unwhiten(residual)
        return self._completed(self._derivatives.jacobian(theta, base, central=central), residual)

    def known_jacobian(self, theta: Floats, residual: Floats) -> Floats | None:
        """Return the Jacobian (n_rows, N) at the nearest cell center, if available."""
        derivatives = self.evaluator.jacobian_near(theta)
        return None if derivatives is None else self._completed(derivatives * -self._weights, residual)

    def first_jacobian(self, theta: Floats, base: Floats, residual: Floats) -> tuple[Floats, Flags]:
        """Return the initial Jacobian and flags (N,) of parameters with an effect.

        `base` (n,) is the simulation: recovered from the residual, its rounding would look like an effect.
        """
        derivatives, acting = self._derivatives.first_jacobian(theta, base)
        return self._completed(derivatives, residual), acting

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation noise at theta in `steps` (N,); adopt it if larger.

        Return the standard deviation of the noise of ‖residual‖², 0 if none is visible, and True if it is larger.
        """
        problem, base = self.problem, self.problem.measured - self.unwhiten(residual)
        room = np.minimum(self.upper - theta, theta - self.lower)
        table = noise_along(self.evaluator.predict, theta, base, steps, room)
        if table is None:
            return 0.0, False
        # the prior is left at theta: its rows are smooth
        rows = self.whiten(np.tile(theta, (len(table), 1)), table)
        of_square = table_noise(np.sum(rows**2, axis=1)[:, None], np.ones((1, 1)))
        outputs = table_noise(table, shares_of(problem.groups, problem.counts.size))
        larger = bool((outputs > MORE_NOISE * self.simulation_noise).any())
        if larger:
            outputs = np.maximum(outputs, self.simulation_noise)
            self.least_variance = np.maximum(self.least_variance, outputs**2)
            self.simulation_noise, self._start = outputs, base
            self._derivatives = self._derivatives.renoised(self._weigh(self.variance), self._size)
        return float(of_square[0]), larger

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the error norm of each Jacobian column at theta (N,)."""
        outputs = self.problem.measured * self._weights - self._whitened(residual)
        share = min(1.0, _rms(outputs) / self._size) if self._size > 0 else 1.0
        return share * self._derivatives.error(theta, central=central)

    def evaluate(self, theta: ArrayLike) -> tuple[Floats, Floats]:
        """Return residual and central Jacobian at theta (N,); `SimulationError` or `SensitivityError` if that fails."""
        at = np.array(theta, dtype=np.float64)
        residual = self.residuals(at[None])[0]
        if np.isnan(residual).any():
            raise _failure(self.evaluator, at, "Choose another point")
        return residual, self.jacobian(at, residual, central=True)

    def _completed(self, derivatives: Floats, residual: Floats) -> Floats:
        """Return the Jacobian (n_rows, N) with loss and prior."""
        if self.problem.loss is not None:
            derivatives *= self.problem.loss.slope(self._whitened(residual))
        whitening = self.problem.parameters.prior_whitening
        # the transpose is what LAPACK works on without a copy: columns one after the other
        return (np.hstack([derivatives, -whitening.T]) if whitening.size else derivatives).T


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.vdot(values, values)) / values.size)


@dataclass(frozen=True, eq=False)
class InitializedProblem:
    """A problem simulated at its initial guess, with a cost function."""

    theta: Floats  # (N,)
    criterion: CostFunction
    residual: Floats
    jacobian: Floats  # central
    moved: tuple[str, ...] = ()  # parameters without effect at the given theta


def prepare(evaluator: Evaluator[LeastSquares], theta: ArrayLike | None = None) -> InitializedProblem:
    """Simulate the initial guess (default: of the parameters), measure noise, choose variances and difference steps.

    A parameter without effect there is moved to a point with an effect. `InputError`: an output is not measured, theta
    is out of bounds, all neighbors fail, or a parameter has no effect. `SimulationError`: the simulation fails.
    """
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    problem.check_measured()
    at = parameters.start if theta is None else np.array(theta, dtype=np.float64)
    _check_inside(problem, at)
    ready, acting = _prepared(evaluator, at)
    idle = np.flatnonzero(~acting & ~(parameters.prior_whitening != 0).any(axis=0))
    if not idle.size:
        return ready
    noise = ready.criterion.simulation_noise[problem.groups]
    there = find_active_point(evaluator, at, idle, noise, 1.0 / np.sqrt(ready.criterion.variance[problem.groups]))
    names = tuple(parameters.names[i] for i in idle if there[i] != at[i])
    return replace(_prepared(evaluator, there)[0], moved=names)


def _prepared(evaluator: Evaluator[LeastSquares], at: Floats) -> tuple[InitializedProblem, Flags]:
    """Return a problem initialized at theta, and flags of acting parameters."""
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    base, noise = evaluator.noise_near(at)
    if np.isnan(base).any():
        raise _failure(evaluator, at, "Choose another initial guess")
    least = np.maximum(noise**2, LEAST_NOISE**2 * problem.output_variances(problem.measured))
    least = np.where(least > 0, least, 1.0)
    from_residual = np.maximum(problem.noise_variances(problem.measured - base), least)
    first = np.where(np.isnan(problem.first_variance), from_residual, problem.first_variance)
    # a robust loss must not take the residual of the start for outliers: it sets out from large variances
    given = problem.variance if problem.loss is None else np.maximum(problem.variance, from_residual)
    variance = np.where(np.isnan(problem.variance), first, given)
    criterion = CostFunction(evaluator, variance, noise, least, base)
    residual = criterion.whiten(at[None], base[None])[0]
    try:
        jacobian, acting = criterion.first_jacobian(at, base, residual)
    except SensitivityError as error:
        raise InputError(
            f"simulations beside the initial guess fail: {parameters.names[error.index]!r} near "
            f"{at[error.index]:g}. Choose another initial guess, or give bounds."
        ) from None
    if evaluator.cache.problems > 1:
        evaluator.scatter = _expected_std(problem, jacobian, variance)
    return InitializedProblem(at, criterion, residual, jacobian), acting


def _failure(evaluator: Evaluator[LeastSquares], theta: Floats, remedy: str) -> FmuidError:
    """Return the reason for a failed simulation at theta."""
    error, names = evaluator.failure(theta), evaluator.problem.parameters.names
    if isinstance(error, FmuidError):
        return error
    why = f"fails ({error})" if error else "gives outputs that are huge or not finite"
    values = ", ".join(f"{n} = {v:g}" for n, v in zip(names, theta.tolist(), strict=True))
    return InputError(f"the simulation with {values} {why}. {remedy}.")


def _check_inside(problem: LeastSquares, theta: Floats) -> None:
    parameters = problem.parameters
    if theta.shape != (len(parameters),):
        raise InputError(f"the start must have {len(parameters)} values; its shape is {theta.shape}")
    for i in np.flatnonzero(~((theta >= parameters.lower) & (theta <= parameters.upper))):
        raise InputError(
            f"the start {theta[i]:g} of {parameters.names[i]!r} lies outside its bounds, "
            f"{parameters.lower[i]:g} to {parameters.upper[i]:g}"
        )


def _expected_std(problem: LeastSquares, jacobian: Floats, variance: Floats) -> Floats:
    """Return the expected standard deviations (N,) of the estimates."""
    rows, unit = jacobian * problem.parameters.scale, problem.parameters.scale
    noise = np.where(np.isnan(problem.shown_noise), np.sqrt(variance), problem.shown_noise)
    rows[: problem.groups.size] *= (np.sqrt(variance) / noise)[problem.groups][:, None]
    _, values, directions = np.linalg.svd(rows, full_matrices=False)
    with np.errstate(divide="ignore"):
        return np.asarray(unit * np.linalg.norm(directions / values[:, None], axis=0))
