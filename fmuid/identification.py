"""Identification from start to result: search, repetition on the noise variances, covariance."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from fmuid import __version__
from fmuid.covariance import LocalCovariance, local_covariance
from fmuid.criterion import Criterion, prepare
from fmuid.estimators.marquardt import Iteration, Marquardt, State, Status, search
from fmuid.problem import Problem
from fmuid.result import Result

Floats = NDArray[np.float64]
Progress = Callable[[Iteration], None]

# The search is repeated with new noise variances where one of them, against the others or against a prior, moved by
# more than this share; it changes the estimates by far less than their standard deviations.
MOVED = 0.02
# The repetition converges at once in practice (method.md §8: one repetition); more than this is a fault of the model.
MAX_ROUNDS = 10


def identify(
    problem: Problem,
    settings: Marquardt | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
) -> Result:
    """Identify the parameters of a problem by Marquardt's search.

    Parameters
    ----------
    problem : Problem
    settings : Marquardt, optional
    progress : callable, optional
        Called with every `Iteration` of the search.
    start : (N,) array, optional
        Start elsewhere than the parameters say.

    Returns
    -------
    Result
        Also where the search did not converge or was interrupted from the keyboard: its status says so.

    Raises
    ------
    SimulationError
        If the simulation at the start fails.
    InputError
        If a parameter without prior acts on no output.
    """
    return _Identification(problem, settings or Marquardt(), progress, start).run()


class _Identification:
    """The rounds of one identification and what they leave behind."""

    def __init__(
        self, problem: Problem, settings: Marquardt, progress: Progress | None, start: ArrayLike | None
    ) -> None:
        self.problem, self.settings, self.progress = problem, settings, progress
        self.clock, self.simulations = time.perf_counter(), problem.simulations
        ready = prepare(problem, start)
        self.start, self.criterion = ready.theta, ready.criterion
        self.state = State(ready.theta, ready.evaluation.residual, ready.evaluation.jacobian)
        self.trace: list[tuple[object, ...]] = []
        self.rounds: list[dict[str, float]] = []

    def run(self) -> Result:
        settled = True
        try:
            for number in range(1, MAX_ROUNDS + 1):
                self._search(number)
                settled = not (number == 1 and self._repeats()) and not self._moved()
                if settled or not self._status.converged or number == MAX_ROUNDS:
                    break
                self._reweight()
        except KeyboardInterrupt:
            self.state.status = Status.INTERRUPTED
            self._end_round(len(self.rounds) + 1)
        return self._result(settled)

    @property
    def _status(self) -> Status:
        return self.state.status or Status.INTERRUPTED

    def _search(self, number: int) -> None:
        # where the variances will move the optimum, the first search is only on the way
        rough = number == 1 and self._repeats()
        for iteration in search(self.criterion, self.state, self.settings, rough=rough):
            self.trace.append(
                (
                    number,
                    iteration.number,
                    iteration.criterion,
                    iteration.damping,
                    iteration.accepted,
                    *iteration.theta.tolist(),
                )
            )
            if self.progress is not None:
                self.progress(iteration)
        self._end_round(number)

    def _end_round(self, number: int) -> None:
        """Estimate each output's variance from the residual (1.12), and note what this round used and found."""
        state, problem = self.state, self.problem
        covariance = self._covariance(self.criterion, state.residual, state.jacobian)
        data = problem.measured.size
        self.shares: Floats = np.zeros(problem.counts.size)
        np.add.at(self.shares, problem.groups, covariance.leverage[:data])
        estimated = problem.output_variances(self.criterion.unwhiten(state.residual), self.shares)
        self.estimated = np.maximum(estimated, self.criterion.least_variance)
        self.rounds.append(
            {
                "round": number,
                "iterations": state.iterations,
                "criterion": float(state.residual @ state.residual),
                **{f"used.{n}": v for n, v in zip(problem.output_names, self.criterion.variance.tolist(), strict=True)},
                **{f"estimated.{n}": v for n, v in zip(problem.output_names, self.estimated.tolist(), strict=True)},
            }
        )

    def _next_variance(self) -> Floats:
        return np.where(np.isnan(self.problem.variance), self.estimated, self.problem.variance)

    def _repeats(self) -> bool:
        """Whether the search may have to be repeated with other variances: some are estimated, and have a rival."""
        estimated = np.isnan(self.problem.variance)
        rivals = self.problem.counts.size + len(self.problem.parameters.prior_whitening) > 1
        return bool(estimated.any()) and rivals

    def _moved(self) -> bool:
        """Whether the variances moved so much that the optimum moves too."""
        ratios = self._next_variance() / self.criterion.variance
        if not len(self.problem.parameters.prior_whitening):
            ratios = ratios / ratios[0]  # without a prior only their proportions matter
        return bool((np.abs(ratios - 1.0) > MOVED).any())

    def _reweight(self) -> None:
        """Go on from the same point with the new variances: the rows change their weights, nothing is simulated."""
        state, before = self.state, self.criterion
        self.criterion = before.reweighted(self._next_variance())
        weights = self._row_weights(before, self.criterion)
        self.state = State(
            state.theta,
            state.residual * weights,
            state.jacobian * weights[:, None],
            state.central,
            state.fresh,
            state.iterations,
            state.rate,
        )

    def _row_weights(self, before: Criterion, after: Criterion) -> Floats:
        weights = np.ones(self.state.residual.size)
        data = self.problem.measured.size
        weights[:data] = np.sqrt(before.variance / after.variance)[self.problem.groups]
        return weights

    def _covariance(self, criterion: Criterion, residual: Floats, jacobian: Floats) -> LocalCovariance:
        theta = self.state.theta
        error = criterion.jacobian_error(theta, residual, central=self.state.central)
        names, data = self.problem.parameters.names, self.problem.measured.size
        return local_covariance(names, jacobian, criterion.magnitudes(theta), error, len(jacobian) - data)

    def _result(self, settled: bool) -> Result:
        state, problem, parameters = self.state, self.problem, self.problem.parameters
        final = self.criterion.reweighted(self._next_variance())
        weights, data = self._row_weights(self.criterion, final), problem.measured.size
        residual, jacobian = state.residual * weights, state.jacobian * weights[:, None]
        local = self._covariance(final, residual, jacobian)
        alone = self._covariance(final, residual, jacobian[:data]) if len(jacobian) > data else local
        at_bounds = tuple(
            f"{parameters.names[i]} is at its bound {state.theta[i]:g}" for i in np.flatnonzero(state.held)
        )
        all_given = not np.isnan(problem.variance).any()
        return Result(
            status=self._words(settled, local.undetermined, at_bounds),
            converged=self._status.converged and settled and not local.undetermined,
            names=parameters.names,
            values=state.theta.copy(),
            start=self.start.copy(),
            prior_mean=parameters.prior_mean,
            prior_std=parameters.prior_std,
            covariance=local.covariance,
            noise_variance=dict(zip(problem.output_names, self.estimated.tolist(), strict=True)),
            given_variance={
                name: float(value)
                for name, value in zip(problem.output_names, problem.variance, strict=True)
                if not np.isnan(value)
            },
            criterion=float(state.residual @ state.residual),
            degrees_of_freedom=math.inf if all_given else float(problem.counts.sum() - self.shares.sum()),
            iterations=state.iterations,
            fit=self._fit(),
            simulations=problem.simulations - self.simulations,
            elapsed_s=time.perf_counter() - self.clock,
            undetermined=local.undetermined,
            weak=local.weak,
            prior_determined=() if alone is local else alone.undetermined,
            at_bounds=at_bounds,
            trace=pd.DataFrame(
                self.trace, columns=["round", "iteration", "criterion", "lambda", "accepted", *parameters.names]
            ),
            rounds=pd.DataFrame(self.rounds),
            version=__version__,
        )

    def _words(self, settled: bool, undetermined: tuple[str, ...], at_bounds: tuple[str, ...]) -> str:
        words = [self._status.value]
        if self._status.converged and not settled:
            words = [f"the noise variances still move after {MAX_ROUNDS} repetitions: give them as noise.variance"]
        elif self._status.converged and undetermined:
            words = ["undetermined"]
        if undetermined:
            words.append("; ".join(undetermined) + ": give a prior, hold one of them at a value, or measure more")
        if at_bounds:
            words.append(
                "; ".join(at_bounds) + ", and the data would move it further: widen the bound or check the model"
            )
        return ": ".join(words) if words[0] == "undetermined" else "; ".join(words)

    def _fit(self) -> tuple[pd.DataFrame, ...]:
        frames = []
        for experiment, simulated in zip(self.problem.experiments, self.problem.outputs(self.state.theta), strict=True):
            columns = {"time": experiment.times}
            for k, name in enumerate(experiment.output_names):
                columns[f"measured.{name}"] = experiment.output_values[:, k]
                columns[f"simulated.{name}"] = simulated[:, k]
            frames.append(pd.DataFrame(columns))
        return tuple(frames)
