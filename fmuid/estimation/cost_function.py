"""The compound criterion (1.37) as a sum of squares: whitened residuals of all experiments, and the prior's rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Flags, Floats
from fmuid.errors import FmuidError, InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.finite_differences import FiniteDifferences, SensitivityError
from fmuid.estimation.inactive_parameters import find_active_point, inactive_parameters
from fmuid.estimation.model_sensitivities import JacobianProvider, ModelSensitivities
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.simulation_noise import SimulationNoise, noise_along, shares_of, table_noise

# Of data that are fitted to the last digits of double precision, the residual says nothing about their noise: its
# standard deviation counts as this share of the measured values at least.
LEAST_NOISE = 2.0**-47
# Noise that is measured again counts where it is so many times what was known.
MORE_NOISE = 2.0


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The least-squares function at one theta.

    Attributes
    ----------
    residual : (n_rows,) array
        Whitened (measured − simulated)/σ of all counted samples, then the prior rows W(θ₀ − θ) of (1.37).
    jacobian : (n_rows, N) array
        Its derivative by theta.
    """

    residual: Floats
    jacobian: Floats


class CostFunction:
    """The compound criterion J_C (1.37) of a problem with noise variances chosen, as a sum of squares of theta.

    With a robust loss the rows of the data are the roots ±√ρ(f²) of the whitened residuals f (`fmuid.data.losses`).

    Attributes
    ----------
    problem : LeastSquares
    variance : (n_outputs,) array
        The noise variances that whiten the residual.
    least_variance : (n_outputs,) array
        What the noise of the simulation and rounding leave of any residual.
    lower, upper : (N,) arrays
        Bounds.
    noise : float
        Root mean square of the simulation's noise in the whitened residual.
    """

    def __init__(
        self,
        evaluator: Evaluator[LeastSquares],
        variance: Floats,
        noise: SimulationNoise,
        least_variance: Floats,
        start: Floats,
        derivatives: JacobianProvider | None = None,
    ) -> None:
        self.evaluator, self.problem = evaluator, evaluator.problem
        self.variance, self.least_variance = variance, least_variance
        self.lower, self.upper = self.problem.parameters.lower, self.problem.parameters.upper
        self._weights = (1.0 / np.sqrt(variance))[self.problem.groups]
        self._level, self._start = noise, start
        self._size = _rms(start * self._weights)
        rows = noise.outputs[self.problem.groups] * self._weights
        self.noise = _rms(rows)
        self._shrunk: tuple[Floats, float] | None = None  # a residual, and what became of the outputs against the start
        if derivatives is None:
            self._derivatives = self._chosen_derivatives(rows)
        else:
            self._derivatives = derivatives.weighted(-self._weights, rows)

    def _chosen_derivatives(self, noise: Floats) -> JacobianProvider:
        problem, reach = self.problem, self.problem.parameters.reach
        differences = FiniteDifferences(
            self.evaluator.predict,
            self.lower,
            self.upper,
            reach,
            noise,
            self._size,
            -self._weights,
            start=self.evaluator.predict_start,
            alike=self.evaluator.cache.problems > 1,
        )
        if problem.sensitivity == "finite-difference":
            return differences
        return ModelSensitivities(
            self.evaluator.derivatives, differences, reach, noise, -self._weights, self.evaluator.refuse_derivatives
        )

    def reweighted(self, variance: Floats) -> CostFunction:
        """Return the criterion with other noise variances and the same difference steps."""
        return CostFunction(self.evaluator, variance, self._level, self.least_variance, self._start, self._derivatives)

    def converted(self, other: CostFunction, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian of this criterion as those of another that differs in its variances only."""
        residual, jacobian = self.unrooted(residual, jacobian)
        scale = np.ones(residual.size)
        scale[: self._weights.size] = other._weights / self._weights
        return other._rooted(residual * scale, jacobian * scale[:, None])

    def unrooted(self, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian with the whitened residuals f themselves in place of their roots ±√ρ(f²)."""
        if self.problem.loss is None:
            return residual, jacobian
        residual, jacobian, data = residual.copy(), jacobian.copy(), self._weights.size
        residual[:data] = self._whitened(residual)
        jacobian[:data] /= self.problem.loss.slope(residual[:data])[:, None]
        return residual, jacobian

    def _rooted(self, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian, which are changed, with roots ±√ρ(f²) in place of whitened residuals f."""
        if self.problem.loss is not None:
            data = self._weights.size
            jacobian[:data] *= self.problem.loss.slope(residual[:data])[:, None]
            residual[:data] = self.problem.loss.root(residual[:data])
        return residual, jacobian

    def _whitened(self, residual: Floats) -> Floats:
        """Return the whitened residuals f (n,) of the data."""
        rows = residual[: self._weights.size]
        return rows if self.problem.loss is None else self.problem.loss.unroot(rows)

    def magnitudes(self, theta: Floats) -> Floats:
        """Return how large each parameter is at theta (N,)."""
        return self.problem.parameters.magnitudes(theta)

    def residuals(self, thetas: Floats) -> Floats:
        """Return the residual (m, n_rows) at thetas (m, N), NaN rows where a simulation failed."""
        return self.whiten(thetas, self.evaluator.predict(thetas))

    def whiten(self, thetas: Floats, predictions: Floats) -> Floats:
        """Return the residual (m, n_rows) of simulations already made."""
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
        """Return the derivative (n_rows, N) of the residual at theta, by differences or from the model.

        Raises
        ------
        SensitivityError
            If all simulations around theta fail.
        """
        base = self.problem.measured - self.unwhiten(residual)
        return self._completed(self._derivatives.jacobian(theta, base, central=central), residual)

    def known_jacobian(self, theta: Floats, residual: Floats) -> Floats | None:
        """Return the Jacobian (n_rows, N) at the center of the cell of theta, None where there is none."""
        derivatives = self.evaluator.jacobian_near(theta)
        return None if derivatives is None else self._completed(derivatives * -self._weights, residual)

    def first_jacobian(self, theta: Floats, base: Floats, residual: Floats) -> tuple[Floats, Flags]:
        """Return the Jacobian at the start, and which parameters act on any output (N,).

        The simulation itself is `base` (n,): made of the residual, its rounding would pass for an effect.
        """
        derivatives, acting = self._derivatives.first_jacobian(theta, base)
        return self._completed(derivatives, residual), acting

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation's noise anew at theta, and take it and steps of differences to match if it is larger.

        Parameters
        ----------
        theta, residual : (N,) and (n_rows,) arrays
        steps : (N,) array
            Between the seven points of the table: noise is what is seen at this distance.

        Returns
        -------
        noise : float
            Standard deviation of the noise of ‖residual‖², 0 where none is seen.
        larger : bool
            Whether the simulation's noise is larger than was known.
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
        larger = bool((outputs > MORE_NOISE * self._level.outputs).any())
        if larger:
            outputs = np.maximum(outputs, self._level.outputs)
            self.least_variance = np.maximum(self.least_variance, outputs**2)
            self._level = SimulationNoise(outputs, self._level.simulations + len(table) - 1)
            weighed = outputs[problem.groups] * self._weights
            self._start, self._size, self._shrunk = base, _rms(base * self._weights), None
            self.noise, self._derivatives = _rms(weighed), self._derivatives.renoised(weighed, self._size)
        return float(of_square[0]), larger

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each column of a Jacobian at theta (N,).

        Where the outputs are smaller than at the start, so is what noise there was in proportion to them.
        """
        if self._shrunk is None or self._shrunk[0] is not residual:  # asked for several times at each point
            outputs = self.problem.measured * self._weights - self._whitened(residual)
            self._shrunk = residual, min(1.0, _rms(outputs) / self._size) if self._size > 0 else 1.0
        return self._shrunk[1] * self._derivatives.error(theta, central=central)

    def evaluate(self, theta: ArrayLike) -> Evaluation:
        """Return residual and (central) Jacobian at theta (N,).

        Raises
        ------
        SimulationError
            If the simulation fails.
        SensitivityError
            If all simulations around theta fail.
        """
        at = np.array(theta, dtype=np.float64)
        residual = self.residuals(at[None])[0]
        if np.isnan(residual).any():
            raise _failure(self.evaluator, at, "evaluate elsewhere")
        return Evaluation(residual, self.jacobian(at, residual, central=True))

    def _completed(self, derivatives: Floats, residual: Floats) -> Floats:
        """Return the Jacobian (n_rows, N) of derivatives (N, n) of whitened residuals, with the loss and the prior."""
        if self.problem.loss is not None:
            derivatives *= self.problem.loss.slope(self._whitened(residual))
        whitening = self.problem.parameters.prior_whitening
        # the transpose is what LAPACK works on without a copy: columns one after the other
        return (np.hstack([derivatives, -whitening.T]) if whitening.size else derivatives).T


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.vdot(values, values)) / values.size)


@dataclass(frozen=True, eq=False)
class InitializedProblem:
    """A problem made ready at one theta.

    Attributes
    ----------
    theta : (N,) array
    criterion : CostFunction
    evaluation : Evaluation
        Residual and central Jacobian there.
    noise : SimulationNoise
        Of the simulation itself.
    moved : tuple of str
        Parameters that change no output at the theta given, and were moved to where they do.
    """

    theta: Floats
    criterion: CostFunction
    evaluation: Evaluation
    noise: SimulationNoise
    moved: tuple[str, ...] = ()


def prepare(evaluator: Evaluator[LeastSquares], theta: ArrayLike | None = None) -> InitializedProblem:
    """Simulate the start, measure the simulation's noise, choose variances and steps, check influence.

    Where parameters act on nothing at the start but elsewhere in their box, that is where the search sets out from.

    Parameters
    ----------
    evaluator : Evaluator
    theta : (N,) array, optional
        Start elsewhere than the parameters say.

    Raises
    ------
    SimulationError
        If the simulation at the start fails.
    InputError
        If an output has not been measured, theta lies outside the bounds, all simulations around it fail, or a
        parameter without prior has no effect.
    """
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    problem.check_measured()
    at = parameters.start if theta is None else np.array(theta, dtype=np.float64)
    _check_inside(problem, at)
    ready, acting = _prepared(evaluator, at)
    idle = inactive_parameters(problem, acting)
    if not idle.size:
        return ready
    noise = ready.noise.outputs[problem.groups]
    there = find_active_point(evaluator, at, idle, noise, 1.0 / np.sqrt(ready.criterion.variance[problem.groups]))
    names = tuple(parameters.names[i] for i in idle if there[i] != at[i])
    return replace(_prepared(evaluator, there)[0], moved=names)


def _prepared(evaluator: Evaluator[LeastSquares], at: Floats) -> tuple[InitializedProblem, Flags]:
    """Return a problem made ready at a theta (N,), and which parameters act there."""
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    base, noise = evaluator.noise_near(at)
    if np.isnan(base).any():
        raise _failure(evaluator, at, "start elsewhere")
    least = np.maximum(noise.outputs**2, LEAST_NOISE**2 * problem.output_variances(problem.measured))
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
            f"the simulation succeeds at the start, but not with {parameters.names[error.index]!r} moved to either "
            f"side of {at[error.index]:g}; start from where the model is sound, or give bounds"
        ) from None
    if evaluator.cache.problems > 1:
        evaluator.scatter = _expected_std(problem, jacobian, variance)
    return InitializedProblem(at, criterion, Evaluation(residual, jacobian), noise), acting


def _failure(evaluator: Evaluator[LeastSquares], theta: Floats, remedy: str) -> FmuidError:
    """Return why nothing can be simulated at theta."""
    error, names = evaluator.failure(theta), evaluator.problem.parameters.names
    if isinstance(error, FmuidError):
        return error
    why = f"fails ({error})" if error else "gives outputs that are huge or not finite"
    values = ", ".join(f"{n} = {v:g}" for n, v in zip(names, theta.tolist(), strict=True))
    return InputError(f"the simulation with {values} {why}; {remedy}")


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
    """Return the standard deviations (N,) of the estimates, for a Jacobian with these variances and the noise shown."""
    rows, unit = jacobian * problem.parameters.scale, problem.parameters.scale
    rows[: problem.groups.size] *= (np.sqrt(variance) / problem.shown_noise)[problem.groups][:, None]
    _, values, directions = np.linalg.svd(rows, full_matrices=False)
    with np.errstate(divide="ignore"):
        return np.asarray(unit * np.linalg.norm(directions / values[:, None], axis=0))
