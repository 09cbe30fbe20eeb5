"""Delay of the acquisition in every interval: outputs read up to half a sample before or after the inputs.

Late and early outputs move by different secants, because held inputs bend the outputs at the samples. Each has a prior
of `Noise.delay_std`/√2, together a uniform delay's variance; the estimates are those beside both sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Simulations
from fmuid.data import Experiment, Normal, Parameter, usual_step
from fmuid.errors import InputError
from fmuid.estimation import (
    AcquisitionDelay,
    AugmentedProblem,
    CostFunction,
    Evaluator,
    LeastSquares,
    LinearizedProblem,
    Marquardt,
    Predictor,
    ResidualNoise,
    Result,
    SandwichCovariance,
    WhitenedJacobian,
    augmented,
    local_covariance,
)
from fmuid.identification.conditional_optimum import cost_at
from fmuid.identification.final_covariance import std_without_shift, with_covariance


@dataclass(frozen=True)
class DelaySettings:
    """Numbers of the included delay."""

    steps: int = 4  # Gauss-Newton; a delay moves estimates by a few σ
    far: float = 0.5  # σ; estimates that moved so far need another Jacobian, and another step
    box: float = 6.0  # σ; bounds of the sizes, for searches of a box


SETTINGS = DelaySettings()
HALF = math.sqrt(0.5)  # of the delay's σ: late and early outputs share its variance
DELAY_PRIOR = np.full(2, HALF)
SIZES = ("delay of outputs", "advance of outputs")


def include_delay(evaluator: Evaluator[LeastSquares], result: Result) -> Result:
    """Return a result whose estimates and covariance allow for a delay.

    Unchanged where nothing can be said: no inputs, no convergence, a robust loss, or a parameter at a bound.
    """
    local, problem = result.fit.linearization, evaluator.problem.as_in(result)
    delays = _delays(problem)
    if local is None or not result.converged or problem.loss is not None or result.estimates.at_bounds:
        return result
    if not any(delays) or not np.isfinite(result.std).all() or not result.fit.is_noisy:
        return result
    evaluator = evaluator.finer(problem.refinement) if not result.chosen else evaluator.of(problem)
    limits, before, levels = problem.parameters, evaluator.simulations, local.levels
    theta, count, now, begin = result.values, len(result.names), result, result.values
    for _ in range(SETTINGS.steps):
        columns = delay_columns(problem, now)
        if not columns.any():
            return result
        freed = augmented(local, columns, DELAY_PRIOR)
        theta = np.clip(theta + freed.step[:count], limits.lower, limits.upper)
        rows = evaluator.predict(theta[None])[0]
        if not np.isfinite(rows).all():
            return result
        prior = limits.prior_residual(theta[None])[0]
        local = replace(local, residual=(problem.measured - rows) / levels, prior_residual=prior)
        far = np.abs(theta - begin) > SETTINGS.far * np.sqrt(np.sum(freed.root[:count] ** 2, axis=1))
        if far.any():
            begin, local = theta, _linearized(cost_at(evaluator, result), theta, local)
        fit = replace(result.fit, linearization=local, simulated=tuple(evaluator.outputs(theta, rows)))
        now = replace(result, fit=fit, estimates=replace(result.estimates, values=theta))
        if not far.any():
            break
    spent = replace(result.history, simulations=result.history.simulations + evaluator.simulations - before)
    return _allowing(replace(now, history=spent), freed, freed.sandwich(problem), max(delays))


def _linearized(function: CostFunction, theta: Floats, local: LinearizedProblem) -> LinearizedProblem:
    """Return the problem linearized at theta, where `local` has its residual."""
    residual = np.concatenate([local.residual, local.prior_residual])
    jacobian = function.jacobian(theta, residual, central=True)
    error, magnitudes = function.jacobian_error(theta, residual, central=True), function.magnitudes(theta)
    names, data = function.problem.parameters.names, len(local.residual)
    made = [
        local_covariance(names, WhitenedJacobian(jacobian[:rows], error, max(rows - data, 0)), magnitudes, theta=theta)
        for rows in (data, len(jacobian))
    ]
    rows = residual[:data], jacobian[:data], residual[data:], jacobian[data:]
    return LinearizedProblem(*rows, local.levels, magnitudes, *made)


def _allowing(result: Result, freed: AugmentedProblem, found: SandwichCovariance, delay: float) -> Result:
    """Return a result with its delay and covariance."""
    count, net = len(result.names), delay * np.array([1.0, -1.0])
    covariance, white = found.covariance[:count, :count], freed.spread * freed.root[:count] @ freed.root[:count].T
    std, size = math.sqrt(net @ found.covariance[count:, count:] @ net), float(net @ freed.step[count:])
    own = AcquisitionDelay(size, std, np.sqrt(np.diag(covariance)) / std_without_shift(result))
    fit = replace(result.fit, delay=own)
    return with_covariance(replace(result, fit=fit), covariance, white, found.freedom[:count])


def delay_columns(problem: LeastSquares, result: Result) -> Floats:
    """Return the change (n, 2) of whitened outputs by one σ each."""
    tables = zip(*map(secants, problem.experiments, result.fit.simulated, _delays(problem)), strict=True)
    columns = np.stack([problem.stacked(each) for each in tables], axis=1)
    local = result.fit.linearization
    assert local is not None, "checked before"
    return np.asarray(columns / local.levels[:, None])


@dataclass(frozen=True, eq=False)
class DelayedNoise:
    """Noise of rows that allow for a delay (`delay_basis`)."""

    noise: ResidualNoise
    basis: Floats
    shares: Floats

    @classmethod
    def of(cls, problem: LeastSquares, result: Result, noise: ResidualNoise) -> DelayedNoise:
        """Return the noise with the delay of a result; m = 0 without one."""
        if result.fit.delay is None:
            return cls(noise, np.zeros((problem.measured.size, 0)), np.zeros(0))
        return cls(noise, *delay_basis(delay_columns(problem, result)))

    def rows(self, given: Floats) -> Floats:
        """Return W½ times rows (n,) or (n, k)."""
        return without_delay(given, self.basis, self.shares)

    def local(self, given: LinearizedProblem) -> LinearizedProblem:
        """Return a linearized problem in these rows."""
        return replace(given, residual=self.rows(given.residual), jacobian=self.rows(given.jacobian))

    def gram(self, columns: Floats) -> Floats:
        """Return XᵀΓX (k, k) of columns (n, k)."""
        along = self.shares[:, None] * (self.basis.T @ columns)
        return self.noise.gram(self.rows(columns)) + along.T @ along


def delay_basis(columns: Floats) -> tuple[Floats, Floats]:
    """Return a delay's basis (n, m) and singular values (m,).

    W = (I + D Dᵀ)⁻¹ and D the columns (n, 2) by one σ: least squares of W½ r have the delay's sizes as parameters.
    """
    u, s, _ = np.linalg.svd(HALF * columns, full_matrices=False)
    return u, s / np.sqrt(1.0 + s**2)


def without_delay(rows: Floats, basis: Floats, shares: Floats) -> Floats:
    """Return W½ times rows (n,) or (n, k)."""
    return np.asarray(rows - (basis * (1.0 - np.sqrt(1.0 - shares**2))) @ (basis.T @ rows))


def _delays(problem: LeastSquares) -> list[float]:
    """Return σ of the delay in each experiment, samples."""
    return [
        problem.noise.delay_in(each.name) if each.kind == "time" and each.input_names else 0.0
        for each in problem.experiments
    ]


class DelayedPredictor:
    """Predictor with late and early outputs: the last two numbers of theta."""

    def __init__(self, predictor: Predictor, experiment: Experiment, delay: float) -> None:
        self._predictor, self._experiment, self._delay = predictor, experiment, delay

    def many(self, thetas: ArrayLike) -> Simulations:
        """Simulate thetas (m, N_i + 2), equal ones of the model once."""
        given = np.asarray(thetas, dtype=np.float64)
        own, back = np.unique(given[:, :-2], axis=0, return_inverse=True)
        found, places = self._predictor.many(own), back.ravel().tolist()
        outputs = np.array(found.outputs)[places]
        for each, sizes in zip(outputs, given[:, -2:], strict=True):
            late, early = secants(self._experiment, each, self._delay)
            each += sizes[0] * late + sizes[1] * early
        return Simulations(outputs, tuple(found.errors[i] for i in places))


def with_delay(problem: LeastSquares, result: Result) -> tuple[LeastSquares, Result]:
    """Return problem and result with an included delay as parameters."""
    base = problem.as_in(result)
    if result.fit.delay is None:
        return base, result
    made = [DelayedPredictor(*each) for each in zip(base.predictors, base.experiments, _delays(base), strict=True)]
    size = Parameter(0.0, nominal=HALF, min=-SETTINGS.box * HALF, max=SETTINGS.box * HALF, prior=Normal(0.0, HALF))
    given = {**base.given_parameters, **dict.fromkeys(SIZES, size)}
    delayed = LeastSquares(made, base.experiments, given, noise=base.noise, joint_prior=base.joint_prior)
    start = np.concatenate([result.values, np.zeros(2)])
    return delayed, Marquardt().search(Evaluator(delayed), None, start)


def delayed(problem: LeastSquares, result: Result) -> tuple[Evaluator[LeastSquares], Result]:
    """Return evaluator and result, with an included delay (`with_delay`); names are checked."""
    for what, has, needs in (
        ("parameters", result.names, problem.parameters.names),
        ("outputs", tuple(result.fit.noise_variance), problem.output_names),
    ):
        if has != needs:
            raise InputError(
                f"the result is of another problem: its {what} are {', '.join(has)}, not {', '.join(needs)}. "
                "Give a result of this problem."
            )
    problem, result = with_delay(problem, result)
    return Evaluator(problem), result


def secants(experiment: Experiment, outputs: Floats, delay: float) -> tuple[Floats, Floats]:
    """Return the change of outputs (K, n_outputs) by delay and advance, samples."""
    steps, edge = np.diff(experiment.times)[:, None], np.zeros((1, outputs.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(steps > 0.0, np.diff(outputs, axis=0) / steps, 0.0)
    moved = slopes * usual_step(experiment.times) * delay
    return np.vstack([edge, -moved]), np.vstack([moved, edge])
