"""Starting points: given, from equations, corrected, of the box.

Corrected simulations move the states at each sample by the measured outputs, x += C⁺ (y* − y), C = ∂y/∂x. They drift
little and have few local optima. Measurement noise biases them: they give a starting point, never a result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats, numbers
from fmuid.data import ParameterSet
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation import (
    MAX_NOISE_RATIO,
    Evaluator,
    Marquardt,
    RestartAttempt,
    Result,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
    sobol_points,
)
from fmuid.events import Progress
from fmuid.identification.equation_error_start import SETTINGS as WEAK_FORM
from fmuid.identification.equation_error_start import equation_start
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check import EQUAL_COST
from fmuid.identification.strategies import START_LIMIT, Searches, Trial
from fmuid.simulation import RightHandSide, Simulator


@dataclass(frozen=True)
class RestartSettings:
    """Numbers of restarts and of corrected simulations."""

    far_share: float = 1.0  # of an output's variance; larger residuals are worse than the mean of the output
    other_start_limit: float = 1e-6  # as `START_LIMIT`, of other starting points
    points: int = 16  # of the box that are simulated ...
    best_points: int = 3  # ... and optimized from
    seed: int = 0
    factor: float = 10.0  # reach of the box without bounds ...
    multiple: float = 3.0  # ... or so many nominal magnitudes from zero
    patience: int = 60  # iterations of a restart before the next starting point
    largest_square: float = 1e12  # clip of squared residuals, noise variances; one wild sample must not decide
    same_stds: float = 1.0  # σ; estimates that differ by less agree
    tolerance: float = 1e-5  # of the solver in rough searches
    most_steps: int = 1000  # of the solver between two samples, for a usable point
    states_per_sample: int = 20  # a correction costs one evaluation per state
    unseen: float = 1e-6  # smallest relative effect of a corrected direction


SETTINGS = RestartSettings()
# Searches with corrections, then without.
ROUGH = Marquardt(max_iterations=25, tolerance=1e-3), Marquardt(max_iterations=60, tolerance=1e-3)
UNFINISHED = (
    TerminationReason.STALLED,
    TerminationReason.ITERATION_LIMIT,
    TerminationReason.FAILING,
    TerminationReason.RUNAWAY,
    TerminationReason.UNSETTLED,
)


@dataclass(frozen=True, eq=False)
class EndedSearch:
    """A finished search."""

    result: Result
    attempt: RestartAttempt
    number: int  # of the attempt
    worth: float  # Σ K_j log σ̂_j², comparable for all noise variances


def search_starting_points(trial: Trial) -> Searches:
    """Search from starting points until one fits, or two agree."""
    return _Restarts(trial).run()


class _Restarts:
    """The attempts of one search, and their ends."""

    def __init__(self, trial: Trial) -> None:
        self.trial, self.problem, self.is_given = trial, trial.evaluator.problem, trial.start is None
        self.optimizer = trial.method.marquardt
        self.spent = trial.evaluator.simulations
        self.attempts: list[RestartAttempt] = []
        self.ended: list[EndedSearch] = []
        self.equation_ratio = math.nan

    @property
    def evaluator(self) -> Evaluator[Problem]:
        return self.trial.evaluator

    def run(self) -> Searches:
        problem, start, error = self.problem, self.trial.start, None
        given = problem.parameters.start if start is None else numbers(start, "start")
        if given.shape != problem.parameters.start.shape:
            return (yield self._from(given))  # raises the error
        problem.check_measured()
        for remedy, theta in self._starts(given):
            own = remedy is StartingPointSource.GIVEN
            try:
                result = yield self._from(theta, given=own and self.is_given, patient=own)
            except (InputError, SimulationError) as failure:
                error = failure if error is None or own else error
                failed = isinstance(failure, SimulationError)
                self._note(remedy, SearchFailure.FAILED if failed else SearchFailure.NO_EFFECT)
                continue
            self._end(remedy, result)
            if self._is_settled() or (len(self.ended) == 1 and self._has_other_convention(result)):
                return self._concluded(given)
        if not self.ended:
            raise error or InputError("no starting point.")
        best = best_of(self.ended)
        if best.result.outcome is TerminationReason.ITERATION_LIMIT and (
            best.result.history.iterations < self.optimizer.max_iterations
        ):  # it was stopped early
            self._end(best.attempt.remedy, (yield self._from(best.result.values)))
        return self._concluded(given)

    def _from(self, theta: Floats, *, given: bool = False, patient: bool = True) -> Trial:
        """Return the search from a starting point (N,)."""
        most = self.optimizer.max_iterations if patient else min(SETTINGS.patience, self.optimizer.max_iterations)
        self.trial = replace(
            self.trial,
            method=replace(self.optimizer, max_iterations=most),
            start=None if given else theta,
            start_limit=START_LIMIT if given else SETTINGS.other_start_limit,
        )
        return self.trial

    # --- starting points

    def _starts(self, given: Floats) -> Iterator[tuple[StartingPointSource, Floats]]:
        better = self._better(given)
        first = next(better, None) if self._is_far(given) else None
        if first is not None:
            self.attempts.append(RestartAttempt(StartingPointSource.GIVEN, SearchFailure.FAR, simulations=1))
            self.spent += 1
            yield first
        yield StartingPointSource.GIVEN, given
        yield from better
        for theta in self._points(given):
            yield StartingPointSource.SOBOL, theta

    def _better(self, given: Floats) -> Iterator[tuple[StartingPointSource, Floats]]:
        """Yield the starting points found from the given one, the cheapest first."""
        equation = equation_start(self.evaluator.problem, given)
        if equation is not None:
            theta, self.equation_ratio = equation
            yield StartingPointSource.EQUATION_ERROR, theta
        corrected = corrected_start(self.evaluator, given, self.trial.progress)
        if corrected is not None:
            yield StartingPointSource.CORRECTION, corrected

    def _is_far(self, given: Floats) -> bool:
        """Tell if a start fails, or explains little of an output."""
        problem, predicted = self.problem, self.evaluator.predict_start(given[None])[0]
        if not np.isfinite(predicted).all():
            return True
        outputs = [problem.groups == j for j in range(problem.counts.size)]
        with np.errstate(over="ignore"):
            left = [float(np.mean((problem.measured - predicted)[own] ** 2)) for own in outputs]
        spread = [float(np.var(problem.measured[own])) for own in outputs]
        return any(a > SETTINGS.far_share * b for a, b in zip(left, spread, strict=True))

    def _points(self, given: Floats) -> Iterator[Floats]:
        """Yield the best of some points of the box."""
        parameters = self.problem.parameters
        units = sobol_points(given.size, SETTINGS.points, SETTINGS.seed)
        scale = parameters.magnitudes(given)
        multiples = given + (2.0 * units - 1.0) * SETTINGS.multiple * scale
        factors = given * SETTINGS.factor ** (2.0 * units - 1.0)
        points = np.where(np.abs(given) > 0.0, factors, multiples)
        width = parameters.upper - parameters.lower
        narrow = width < SETTINGS.factor * scale
        points[:, narrow] = parameters.lower[narrow] + units[:, narrow] * width[narrow]
        points = np.clip(points, parameters.lower, parameters.upper)
        predicted = self.evaluator.predict(points)
        noise = self.problem.shown_noise[self.problem.groups]
        noise = np.where(np.isnan(noise), np.abs(self.problem.measured), noise)  # without a time: relative errors
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            squares = ((predicted - self.problem.measured) / noise) ** 2
        squared = np.minimum(np.nan_to_num(squares, nan=np.inf), SETTINGS.largest_square).sum(axis=1)
        best = np.argsort(squared, kind="stable")[: SETTINGS.best_points]
        yield from (points[i] for i in best if np.isfinite(predicted[i]).all())

    # --- one search

    def _end(self, remedy: StartingPointSource, result: Result) -> None:
        variances = [result.fit.noise_variance[name] for name in self.problem.output_names]
        ratio = self.problem.noise_ratio(result.fit.noise_variance)
        trouble = SearchFailure.NONE
        if result.outcome in UNFINISHED:
            trouble = SearchFailure.UNFINISHED
        elif ratio > MAX_NOISE_RATIO:
            trouble = SearchFailure.LARGE_RESIDUAL
        self._note(remedy, trouble, ratio)
        with np.errstate(divide="ignore"):
            worth = float(self.problem.counts @ np.log(variances))
        self.ended.append(EndedSearch(result, self.attempts[-1], len(self.attempts) - 1, worth))

    def _note(self, remedy: StartingPointSource, trouble: SearchFailure, ratio: float = math.nan) -> None:
        self.attempts.append(RestartAttempt(remedy, trouble, ratio, self.evaluator.simulations - self.spent))
        self.spent = self.evaluator.simulations

    def _is_settled(self) -> bool:
        """Tell if the last search fits, was interrupted or is confirmed."""
        last = self.ended[-1]
        if last.attempt.trouble is SearchFailure.NONE or last.result.outcome is TerminationReason.INTERRUPTED:
            return True
        return is_confirmed(last, self.ended, self.equation_ratio)

    def _has_other_convention(self, result: Result) -> bool:
        """Tell if the data fit with another sign or unit: no other starting point fits them as they are."""
        return any(self.problem.other_conventions(result))

    def _concluded(self, given: Floats) -> Result:
        best = best_of(self.ended)
        is_wrong = is_confirmed(best, self.ended, self.equation_ratio)
        trouble = SearchFailure.MODEL_ERROR if is_wrong else best.attempt.trouble
        self.attempts[best.number] = replace(best.attempt, kept=True, trouble=trouble)
        history = replace(best.result.history, restarts=tuple(self.attempts) if len(self.attempts) > 1 else ())
        return replace(best.result, estimates=replace(best.result.estimates, start=given.copy()), history=history)


def best_of(ended: Sequence[EndedSearch]) -> EndedSearch:
    """Return the best fit, finished if several are as good."""
    least = min(each.worth for each in ended)
    alike = [each for each in ended if each.worth - EQUAL_COST <= least]
    return min(alike, key=lambda each: (each.attempt.trouble is SearchFailure.UNFINISHED, each.worth))


def is_confirmed(one: EndedSearch, ended: Sequence[EndedSearch], equation_ratio: float = math.nan) -> bool:
    """Tell if other searches confirm a bad fit; an optimum that the equations contradict needs two.

    `equation_ratio` is the RMS residual of the equations at the measured states over its noise, NaN where unknown.
    """
    if one.attempt.trouble is not SearchFailure.LARGE_RESIDUAL:
        return False
    confirmed = sum(_agree(one, other) for other in ended if other.number != one.number)
    ratio = one.attempt.noise_ratio
    is_explicable = ratio > WEAK_FORM.poor and ratio > MAX_NOISE_RATIO * equation_ratio
    return confirmed > (1 if is_explicable else 0)


def _agree(one: EndedSearch, other: EndedSearch) -> bool:
    """Tell if two searches from independent starts ended at the same optimum."""
    # corrections begin at the given start: the two do not confirm each other
    if {one.attempt.remedy, other.attempt.remedy} == {StartingPointSource.GIVEN, StartingPointSource.CORRECTION}:
        return False
    if other.attempt.trouble is not SearchFailure.LARGE_RESIDUAL or not abs(one.worth - other.worth) <= EQUAL_COST:
        return False
    std = np.fmax(one.result.std, other.result.std)
    apart = np.abs(one.result.values - other.result.values)
    return bool((apart <= np.where(np.isfinite(std), SETTINGS.same_stds * std, np.inf)).all())


def corrected_start(evaluator: Evaluator[Problem], start: Floats, progress: Progress | None = None) -> Floats | None:
    """Return a starting point (N,) by corrected simulations, or None."""
    problem = evaluator.problem
    found = [_corrected(problem, index, start) for index in range(len(problem.experiments))]
    pairs = [each for each in found if each is not None]
    if len(pairs) < len(found):
        return None
    parameters, theta = _near(problem, start), start
    for method, simulators in zip(ROUGH, zip(*pairs, strict=True), strict=True):
        try:
            result = method.search(evaluator.of(problem.simulated_by(simulators, parameters)), progress, theta)
        except FmuidError:  # the exact search begins at the last point
            break
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        theta = result.values
    return None if theta is start else theta


def _near(problem: Problem, start: Floats) -> ParameterSet:
    """Return the parameters within the reach of a start: rough searches do not come back from vanishing ones."""
    reach, sign = np.abs(start), np.sign(start)
    least = np.where(sign > 0.0, reach / WEAK_FORM.reach, -WEAK_FORM.reach * reach)
    most = np.where(sign < 0.0, -reach / WEAK_FORM.reach, WEAK_FORM.reach * reach)
    zero = sign == 0.0
    return problem.parameters.within(np.where(zero, -np.inf, least), np.where(zero, np.inf, most))


def _corrected(problem: Problem, index: int, start: Floats) -> tuple[Simulator, Simulator] | None:
    """Return simulators with corrections and without, None without states."""
    simulator = problem.simulators[index]
    if not isinstance(simulator, Simulator):
        return None
    try:
        side = RightHandSide.of(simulator)
        if side is None or simulator.observed is not None:
            return None
        slopes, _, _ = side.output_slopes(start[problem.parameters.for_experiment(index)[1]])
    except FmuidError:  # the search itself reports errors of the model
        return None
    if not np.isfinite(slopes).all() or not slopes.any():
        return None
    of_fmu = slopes / simulator.output_factors[:, None]
    sizes = np.nanstd(problem.experiments[index].output_values, axis=0) / np.abs(simulator.output_factors)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    gain = side.nominals[:, None] * np.linalg.pinv(of_fmu / sizes[:, None], rcond=SETTINGS.unseen) / sizes
    every = math.ceil(len(side.states) / SETTINGS.states_per_sample)
    how = SETTINGS.tolerance, SETTINGS.most_steps
    return side.corrected(gain, *how, every), side.simulator(*how)
