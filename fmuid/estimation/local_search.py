"""Estimation from one starting point: iterations on the noise variance, covariance."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.data import Loss
from fmuid.estimation.cost_components import log_likelihood
from fmuid.estimation.cost_function import CostFunction, prepare
from fmuid.estimation.covariance import ActiveBound, LocalCovariance, WhitenedJacobian, local_covariance
from fmuid.estimation.estimates import Estimates
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.linearized_problem import LinearizedProblem
from fmuid.estimation.noise.output_noise import output_noise
from fmuid.estimation.noise.sandwich import ResidualNoise, sandwich_of
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.result_groups import Fit, History, Identifiability, Setup
from fmuid.estimation.search.marquardt import Descent, MarquardtSettings, iterate
from fmuid.estimation.search.state import Iteration, State, TerminationReason
from fmuid.events import Progress, SearchStep
from fmuid.version import __version__


@dataclass(frozen=True)
class EstimateSettings:
    """Numbers of the repetition for the noise variances."""

    variance_change: float = 0.02  # relative; needs another search; a smaller one moves estimates far below 1 σ
    most_rounds: int = 40  # searches; one repetition is usual, few points beside a prior take 20
    least_curvature: float = 0.05  # mean ψ′ of a robust loss; with many outliers it can be 0 or negative


ROUNDS = EstimateSettings()


@runtime_checkable
class Method(Protocol):
    """Optimization method: `Marquardt` or `GlobalSearch`."""

    @property
    def marquardt(self) -> Marquardt:
        """Settings of the fits."""

    whole_box: ClassVar[bool]  # a global search

    def check(self, problem: LeastSquares) -> None:
        """Check the problem without simulation; raise `InputError` if it does not fit."""

    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Optimize; with an initial guess (N,), skip the global search.

        An interrupted search returns a result, too.
        """


@dataclass(frozen=True)
class Marquardt(MarquardtSettings):
    """Settings of the Levenberg–Marquardt optimization.

    Parameters
    ----------
    max_iterations : int
        Maximum number of steps, accepted or not.
    tolerance : float
        Largest remaining relative change of a parameter. The change must be small against σ, too (Bates and Watts).
    first_radius : float
        Length of the first step relative to the parameters.

    Raises
    ------
    InputError
        If a setting is not positive.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> fmuid.identify(problem, fmuid.Marquardt(max_iterations=2)).outcome.value
    'converged'
    """

    @property
    def marquardt(self) -> Marquardt:
        """These settings."""
        return self

    whole_box: ClassVar[bool] = False

    def check(self, problem: LeastSquares) -> None:
        """Accept any problem."""

    @single_threaded
    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Optimize from one starting point; arguments and errors as of `fmuid.identify`."""
        return _Identification(evaluator, self, progress, start).run()


def point_result(evaluator: Evaluator[LeastSquares], theta: Floats) -> Result:
    """Return theta (N,) of an interrupted search as a result."""
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    covariance, dof = np.full((len(parameters), len(parameters)), np.nan), np.full(len(parameters), math.inf)
    np.fill_diagonal(covariance, np.inf)
    return Result(
        outcome=TerminationReason.INTERRUPTED,
        estimates=_estimates(problem, theta, parameters.start, covariance, covariance, dof),
        fit=Fit(math.nan, math.nan, math.inf, {}, _given_variance(problem)),
        identifiability=Identifiability(),
        history=History(),
        setup=_setup(evaluator),
    )


def _estimates(
    problem: LeastSquares, values: Floats, start: Floats, covariance: Floats, white: Floats, dof: Floats
) -> Estimates:
    parameters = problem.parameters
    limits = parameters.lower, parameters.upper, parameters.prior_mean, parameters.prior_std
    return Estimates(parameters.names, values.copy(), start.copy(), *limits, covariance, white, dof, problem.units)


def _given_variance(problem: LeastSquares) -> dict[str, float]:
    given = np.flatnonzero(~np.isnan(problem.variance))
    return {problem.output_names[j]: float(problem.variance[j]) for j in given}


def _setup(evaluator: Evaluator[LeastSquares]) -> Setup:
    problem = evaluator.problem
    return Setup(__version__, problem.models, evaluator.used_sensitivity, problem.data)


class _Identification:
    """State of one estimation: iterations on the noise variances."""

    def __init__(
        self, evaluator: Evaluator[LeastSquares], settings: MarquardtSettings, progress: Progress | None, start: Any
    ) -> None:
        self.evaluator, self.problem, self.settings, self.progress = evaluator, evaluator.problem, settings, progress
        self.clock, self.simulations = time.perf_counter(), evaluator.simulations
        ready = prepare(evaluator, start)
        self.start, self.criterion, self.moved_start = ready.theta, ready.criterion, ready.moved
        self.state = State(ready.theta, ready.residual, ready.jacobian)
        self.trace: list[tuple[int, Iteration]] = []
        self.rounds: list[dict[str, float]] = []

    def run(self) -> Result:
        settled = True
        try:
            for number in range(1, ROUNDS.most_rounds + 1):
                rough = number == 1 and self._repeats()
                self._search(number, rough)
                settled = not rough and not self._moved()
                if settled or not self._outcome.converged or number == ROUNDS.most_rounds:
                    break
                self._reweight()
        except KeyboardInterrupt:
            self.state = replace(self.state, outcome=TerminationReason.INTERRUPTED)
            self._end_round(len(self.rounds) + 1)
        if self._outcome.converged and not settled:
            self.state = replace(self.state, outcome=TerminationReason.UNSETTLED)
        return self._result()

    @property
    def _outcome(self) -> TerminationReason:
        return self.state.outcome or TerminationReason.INTERRUPTED

    def _search(self, number: int, rough: bool) -> None:
        search = Descent(self.settings, rough, self.criterion.known_jacobian)
        for state in iterate(search, self.criterion, self.state):
            self.state = state
            if state.last is None:
                continue
            self.trace.append((number, state.last))
            if self.progress is not None:
                self.progress(self._step(state.last))
        self._end_round(number)

    def _step(self, iteration: Iteration) -> SearchStep:
        return SearchStep(
            number=iteration.number,
            cost=iteration.criterion,
            damping=iteration.damping,
            accepted=iteration.accepted,
            values=dict(zip(self.problem.parameters.names, iteration.theta.tolist(), strict=True)),
        )

    # --- the repetition on the noise variances

    def _end_round(self, number: int) -> None:
        """Estimate the noise variances from the residual (1.12), and record the round."""
        state, problem = self.state, self.problem
        reduced = None if state.linear is None else state.linear.reduced
        self.local = self._covariance(self.criterion, state.residual, state.jacobian, reduced=reduced)
        leverage = self.local.leverage(state.jacobian)[: problem.measured.size]
        self.shares: Floats = np.zeros(problem.counts.size)
        self.shares += np.bincount(problem.groups, weights=leverage, minlength=problem.counts.size)
        estimated = problem.noise_variances(self.criterion.unwhiten(state.residual), self.shares)
        self.estimated = np.maximum(estimated, self.criterion.least_variance)
        names = problem.output_names
        self.rounds.append(
            {"round": number, "iterations": state.iterations, "cost": float(state.residual @ state.residual)}
            | {f"used.{n}": v for n, v in zip(names, self.criterion.variance.tolist(), strict=True)}
            | {f"estimated.{n}": v for n, v in zip(names, self.estimated.tolist(), strict=True)}
        )

    def _next_variance(self) -> Floats:
        return np.where(np.isnan(self.problem.variance), self.estimated, self.problem.variance)

    def _repeats(self) -> bool:
        """Return True if other variances will move the optimum: several, with a robust loss, or larger than given."""
        problem = self.problem
        estimated = np.isnan(problem.variance)
        matters = problem.counts.size + len(problem.parameters.prior_whitening) > 1 or problem.loss is not None
        larger = (self.criterion.variance != problem.variance)[~estimated]
        return (bool(estimated.any()) and matters) or bool(larger.any())

    def _moved(self) -> bool:
        """Return True if the new variances move the optimum."""
        ratios = self._next_variance() / self.criterion.variance
        if not len(self.problem.parameters.prior_whitening) and self.problem.loss is None:
            ratios = ratios / ratios[0]  # only their proportions matter
        return bool((np.abs(ratios - 1.0) > ROUNDS.variance_change).any())

    def _reweight(self) -> None:
        """Continue from the same point with the new variances, without simulations."""
        state, before = self.state, self.criterion
        self.criterion = before.reweighted(self._next_variance())
        residual, jacobian = before.converted(self.criterion, state.residual, state.jacobian)
        self.state = replace(state, residual=residual, jacobian=jacobian, outcome=None, linear=None)

    # --- the result

    def _covariance(
        self,
        criterion: CostFunction,
        residual: Floats,
        jacobian: Floats,
        spread: Floats | None = None,
        reduced: Floats | None = None,
    ) -> LocalCovariance:
        """Analyze a Jacobian at the point found, with or without prior rows."""
        theta, parameters = self.state.theta, self.problem.parameters
        error = criterion.jacobian_error(theta, residual, central=self.state.central)
        found = WhitenedJacobian(jacobian, error, len(jacobian) - self.problem.measured.size, spread, reduced)
        names, magnitudes = parameters.names, parameters.magnitudes(theta)
        return local_covariance(names, found, magnitudes, theta=theta, scale=parameters.scale)

    def _local_model(self) -> LinearizedProblem:
        """Linearize the problem at the point found, with the final variances."""
        state, data = self.state, self.problem.measured.size
        residual, jacobian, combined, spread = state.residual, state.jacobian, self.local, None
        whole = residual
        variance, loss, final = self._next_variance(), self.problem.loss, self.criterion
        if loss is not None or (variance != self.criterion.variance).any():
            final = self.criterion.reweighted(variance)
            whole, jacobian = self.criterion.converted(final, residual, jacobian)
            residual = whole
            if loss is not None:
                residual, jacobian, spread = self._weighed(loss, *final.unrooted(residual, jacobian))
            combined = self._covariance(final, whole, jacobian, spread)
        alone = combined
        if len(jacobian) > data:
            alone = self._covariance(final, whole, jacobian[:data], None if spread is None else spread[:data])
        rows = residual[:data], jacobian[:data], residual[data:], jacobian[data:]
        levels = np.sqrt(final.variance)[self.problem.groups]
        magnitudes = self.problem.parameters.magnitudes(state.theta)
        return LinearizedProblem(*rows, levels, magnitudes, alone, combined)

    def _weighed(self, loss: Loss, residual: Floats, jacobian: Floats) -> tuple[Floats, Floats, Floats]:
        """Return rows ψ/√a, Jacobian √a J and spread √(mean ψ²/a); a is an output's mean ψ′."""
        groups, counts = self.problem.groups, self.problem.counts
        f = residual[: groups.size]
        influence = loss.influence(f)
        curvature = np.bincount(groups, weights=loss.curvature(f), minlength=counts.size) / counts
        curvature = np.maximum(curvature, ROUNDS.least_curvature)
        free = np.maximum(counts - self.shares, np.finfo(float).eps)
        power = np.bincount(groups, weights=influence**2, minlength=counts.size) / free
        root = np.sqrt(curvature)[groups]
        jacobian[: groups.size] *= root[:, None]
        residual[: groups.size] = influence / root
        spread = np.ones(residual.size)
        spread[: groups.size] = np.sqrt(power / curvature)[groups]
        return residual, jacobian, spread

    def _result(self) -> Result:
        state, problem = self.state, self.problem
        model = self._local_model()
        local = model.combined
        colored = sandwich_of(problem, model, self.estimated <= self.criterion.least_variance)
        # a Jacobian away from a minimum, where the simulation jumps, does not describe the parameters
        stalled = self._outcome is TerminationReason.STALLED
        undetermined = () if stalled else local.undetermined
        ended = self._outcome.converged or self._outcome is TerminationReason.RUNAWAY
        covariances = (colored.covariance, local.covariance)
        shown = [np.full_like(local.covariance, np.nan) if stalled else each for each in covariances]
        names, theta = problem.parameters.names, state.theta.tolist()
        held = tuple(ActiveBound(names[i], theta[i]) for i in np.flatnonzero(state.held))
        estimates = _estimates(problem, state.theta, self.start, shown[0], shown[1], colored.freedom)
        return Result(
            outcome=TerminationReason.UNDETERMINED if undetermined and ended else self._outcome,
            estimates=replace(estimates, at_bounds=held),
            fit=self._fit(model, colored.noise),
            identifiability=Identifiability(
                undetermined,
                () if stalled else local.weak,
                () if stalled or model.data is local else model.data.undetermined,
                self.moved_start,
            ),
            history=History(
                state.iterations,
                self.evaluator.simulations - self.simulations,
                time.perf_counter() - self.clock,
                tuple(self.trace),
                tuple(self.rounds),
            ),
            setup=_setup(self.evaluator),
        )

    def _fit(self, model: LinearizedProblem, noise: ResidualNoise) -> Fit:
        state, problem = self.state, self.problem
        residual = self.criterion.unwhiten(state.residual)
        # who interrupts a slow search waits for no simulation
        ended = self._outcome is not TerminationReason.INTERRUPTED
        given = ~np.isnan(problem.variance)
        simulated = self.evaluator.outputs(state.theta, problem.measured - residual, simulate=ended)
        variance = np.where(given, problem.variance, self.estimated)
        return Fit(
            cost=float(state.residual @ state.residual),
            log_likelihood=log_likelihood(problem, residual, self.criterion.least_variance),
            degrees_of_freedom=math.inf if given.all() else float(problem.counts.sum() - self.shares.sum()),
            noise_variance=dict(zip(problem.output_names, self.estimated.tolist(), strict=True)),
            given_variance=_given_variance(problem),
            output_noise=output_noise(
                [(each, each.output_values - own) for each, own in zip(problem.experiments, simulated, strict=True)],
                dict(zip(problem.output_names, variance.tolist(), strict=True)),
            ),
            linearization=model,
            noise=noise,
            experiments=problem.experiments,
            simulated=tuple(simulated),
        )
