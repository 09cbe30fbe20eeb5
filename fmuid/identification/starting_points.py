"""Starting points: the one given, better ones from equations and measured states, points of the box; one by one.

A start that explains little is not searched from at once where the equations of the model give a better one
(`fmuid.identification.equation_error_start`), or corrected simulations do. After each search it is asked whether it
ended, and whether its residual is about as large as the noise of the data themselves; if not, the next start is tried.

Simulations are corrected at each sample by what was measured: x += C⁺ (y* − y), C = ∂y/∂x. What is measured cannot
drift away then, so that the criterion has few secondary optima; what is not is simulated, and must be stable. The noise
of the measurements enters the states, and biases what is found, so that a search without corrections follows: a start,
and never a result. Both are rough, by simulations that are rough too: parameters that are far away often make a model
stiff, and an accurate simulation of such a one takes many times as long.

A search from elsewhere that ends where another did, with the same criterion and the same estimates within chance,
confirms it: then it is the model, not the start. An agreement far above the noise may still be a secondary optimum: a
third search decides where the equations of the model hold far better at the measured states than the simulation fits.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.data import ParameterSet
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation import (
    MAX_NOISE_RATIO,
    Evaluator,
    Marquardt,
    Method,
    RestartAttempt,
    Result,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
    sobol_points,
)
from fmuid.identification.equation_error_start import FARTHEST, POOR, equation_start
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check import RIVAL_CRITERION, START_LIMIT, SolverCheckedSearch
from fmuid.progress import Progress
from fmuid.simulation import RightHandSide, Simulator


@dataclass(frozen=True)
class RestartSettings:
    """Numbers of restarts and of the simulations that measurements correct."""

    far_share: float = 1.0  # of an output's variance; a start that leaves more is worse than the output's mean
    other_start_limit: float = 1e-6  # as `START_LIMIT`; elsewhere there is no past to agree with
    points: int = 16  # of the box that are simulated ...
    best_points: int = 3  # ... and searched from
    seed: int = 0
    factor: float = 10.0  # how far the box reaches without bounds ...
    multiple: float = 3.0  # ... or so many nominal magnitudes from zero
    patience: int = 60  # iterations from a start that nobody gave, before others have had their turn
    largest_square: float = 1e12  # of residuals in noise; one wild sample must not decide between points
    same_stds: float = 1.0  # estimates that differ by less agree
    tolerance: float = 1e-5  # of the integration of rough searches
    most_steps: int = 1000  # of the integrator between two samples; a point that needs more is no start
    states_per_sample: int = 20  # a correction costs a Jacobian of one evaluation a state, as the steps that follow do
    unseen: float = 1e-6  # directions of the states that change outputs by less, relative, are not corrected


SETTINGS = RestartSettings()
ROUGH = Marquardt(max_iterations=25, tolerance=1e-3), Marquardt(max_iterations=60, tolerance=1e-3)
"""The searches with corrections and without."""
UNFINISHED = (
    TerminationReason.STALLED,
    TerminationReason.ITERATION_LIMIT,
    TerminationReason.FAILING,
    TerminationReason.RUNAWAY,
    TerminationReason.UNSETTLED,
)


def search_restarting(
    evaluator: Evaluator[Problem],
    method: Method,
    progress: Progress | None,
    start: ArrayLike | None,
    *,
    accuracy: str,
) -> Result:
    """Search from one starting point after the other until one leads to an end that fits, or two to the same.

    Parameters
    ----------
    evaluator : Evaluator
    method, progress, start, accuracy
        As for `fmuid.identify`.

    Raises
    ------
    InputError, SimulationError
        As for `fmuid.identify`, where no start can be searched from.
    """
    return _RestartingSearch(evaluator, method, progress, accuracy).run(start)


class _RestartingSearch:
    """The starts of one search, and what became of them."""

    def __init__(
        self,
        evaluator: Evaluator[Problem],
        method: Method,
        progress: Progress | None,
        accuracy: str,
    ) -> None:
        self.evaluator, self.problem, self.method, self.progress = evaluator, evaluator.problem, method, progress
        self.accuracy = accuracy
        self.clock, self.before = time.perf_counter(), evaluator.simulations
        self.spent = self.before
        self.attempts: list[RestartAttempt] = []
        self.ended: list[EndedSearch] = []
        self.equation_ratio = math.nan
        self.error: FmuidError | None = None

    def run(self, start: ArrayLike | None) -> Result:
        """Try one start after the other until one leads to an end that fits, or two to the same."""
        problem = self.problem
        given = problem.parameters.start if start is None else numbers(start, "start")
        if given.shape != problem.parameters.start.shape:
            return self._search(given)  # which says what is wrong
        problem.check_measured()
        for remedy, theta in self._starts(given):
            try:
                own = remedy is StartingPointSource.GIVEN
                result = self._search(theta, given=own and start is None, most=math.inf if own else SETTINGS.patience)
            except (InputError, SimulationError) as error:
                failed = isinstance(error, SimulationError)
                self.error = error if self.error is None or remedy is StartingPointSource.GIVEN else self.error
                self._note(remedy, SearchFailure.FAILED if failed else SearchFailure.NO_EFFECT)
                continue
            self._end(remedy, result)
            if self._settled():
                break
        else:
            self._go_on()
        if not self.ended:
            raise self.error or InputError("there is no start to search from")
        return self._concluded(given)

    def _go_on(self) -> None:
        """Finish the best search, if patience with it had come to an end."""
        if not self.ended:
            return
        best, limit = self._best(), self.method.marquardt.max_iterations
        if best.result.outcome is TerminationReason.ITERATION_LIMIT and best.result.iterations < limit:
            self._end(best.attempt.remedy, self._search(best.result.values))

    # --- where to begin

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
        """Return the starts that are found from the one that was given, the cheapest first."""
        equation = equation_start(self.evaluator.problem, given)
        if equation is not None:
            self.equation_ratio = equation.noise_ratio
            yield StartingPointSource.EQUATION_ERROR, equation.theta
        corrected = corrected_start(self.evaluator, given, self.progress)
        if corrected is not None:
            yield StartingPointSource.CORRECTION, corrected

    def _is_far(self, given: Floats) -> bool:
        """Whether the simulation at a start fails, or explains little of an output."""
        problem, predicted = self.problem, self.evaluator.predict_start(given[None])[0]
        if not np.isfinite(predicted).all():
            return True
        for j in range(problem.counts.size):
            own = problem.groups == j
            measured = problem.measured[own]
            with np.errstate(over="ignore"):
                left = float(np.mean((measured - predicted[own]) ** 2))
            if left > SETTINGS.far_share * float(np.var(measured)):
                return True
        return False

    def _points(self, given: Floats) -> Iterator[Floats]:
        """Return the best of some points of the box, by one batch of simulations."""
        parameters = self.problem.parameters
        units = sobol_points(given.size, SETTINGS.points, SETTINGS.seed)
        scale = parameters.magnitudes(given)
        multiples = given + (2.0 * units - 1.0) * SETTINGS.multiple * scale
        factors = given * SETTINGS.factor ** (2.0 * units - 1.0)
        points = np.where(np.abs(given) > 0.0, factors, multiples)
        bounded = np.isfinite(parameters.lower) & np.isfinite(parameters.upper)
        width = np.where(bounded, parameters.upper, 0.0) - np.where(bounded, parameters.lower, 0.0)
        narrow = bounded & (width < SETTINGS.factor * scale)
        points[:, narrow] = (np.where(bounded, parameters.lower, 0.0) + units * width)[:, narrow]
        points = np.clip(points, parameters.lower, parameters.upper)
        predicted = self.evaluator.predict(points)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = ((predicted - self.problem.measured) / self.problem.shown_noise[self.problem.groups]) ** 2
        squared = np.minimum(np.nan_to_num(squares, nan=np.inf), SETTINGS.largest_square).sum(axis=1)
        yield from (
            points[i]
            for i in np.argsort(squared, kind="stable")[: SETTINGS.best_points]
            if np.isfinite(predicted[i]).all()
        )

    # --- one search

    def _search(self, theta: Floats, *, given: bool = False, most: float = math.inf) -> Result:
        method = self.method.marquardt
        method = replace(method, max_iterations=int(min(most, method.max_iterations)))
        limit = START_LIMIT if given else SETTINGS.other_start_limit
        search = SolverCheckedSearch(self.evaluator, method, self.progress, self.accuracy, limit)
        try:
            return search.run(None if given else theta)
        finally:  # what had to be refined stays so for the starts that follow
            self.evaluator = search.evaluator

    def _end(self, remedy: StartingPointSource, result: Result) -> None:
        ratio = self._noise_ratio(result)
        trouble = SearchFailure.NONE
        if result.outcome in UNFINISHED:
            trouble = SearchFailure.UNFINISHED
        elif ratio > MAX_NOISE_RATIO:
            trouble = SearchFailure.LARGE_RESIDUAL
        attempt = self._note(remedy, trouble, ratio)
        self.ended.append(EndedSearch(result, attempt, len(self.attempts) - 1, self._worth(result)))

    def _note(self, remedy: StartingPointSource, trouble: SearchFailure, ratio: float = math.nan) -> RestartAttempt:
        self.attempts.append(RestartAttempt(remedy, trouble, ratio, self.evaluator.simulations - self.spent))
        self.spent = self.evaluator.simulations
        return self.attempts[-1]

    def _noise_ratio(self, result: Result) -> float:
        """Return the largest root mean square of an output's residual, by its noise."""
        variances = [result.noise_variance[name] for name in self.problem.output_names]
        ratios = np.sqrt(variances) / self.problem.shown_noise
        return float(np.nanmax(ratios)) if np.isfinite(ratios).any() else math.nan

    def _settled(self) -> bool:
        """Whether the last search ended well, was interrupted, or ended where another did."""
        last = self.ended[-1]
        if last.attempt.trouble is SearchFailure.NONE or last.result.outcome is TerminationReason.INTERRUPTED:
            return True
        return is_confirmed(last, self.ended, self.equation_ratio)

    def _concluded(self, given: Floats) -> Result:
        """Return the best result with all that was tried."""
        best = self._best()
        is_wrong = is_confirmed(best, self.ended, self.equation_ratio)
        self.attempts[best.number] = replace(
            best.attempt, kept=True, trouble=SearchFailure.MODEL_ERROR if is_wrong else best.attempt.trouble
        )
        tried = tuple(self.attempts) if len(self.attempts) > 1 else ()
        return replace(
            best.result,
            start=given.copy(),
            simulations=self.evaluator.simulations - self.before,
            elapsed_s=time.perf_counter() - self.clock,
            attempts=tried,
        )

    def _best(self) -> EndedSearch:
        """Return the one that fits best; of those that fit alike, one that came to an end."""
        least = min(each.worth for each in self.ended)
        alike = [each for each in self.ended if each.worth - RIVAL_CRITERION <= least]
        return min(alike, key=lambda each: (each.attempt.trouble is SearchFailure.UNFINISHED, each.worth))

    def _worth(self, result: Result) -> float:
        """Return Σ K_j log σ̂_j², by which results of any variances compare."""
        variances = [result.noise_variance[name] for name in self.problem.output_names]
        with np.errstate(divide="ignore"):
            return float(self.problem.counts @ np.log(variances))


@dataclass(frozen=True, eq=False)
class EndedSearch:
    """A search that came to an end.

    Attributes
    ----------
    result : Result
    attempt : RestartAttempt
    number : int
        Of the attempt.
    worth : float
        Σ K_j log σ̂_j², by which results of any variances compare.
    """

    result: Result
    attempt: RestartAttempt
    number: int
    worth: float


def is_confirmed(one: EndedSearch, ended: Sequence[EndedSearch], equation_ratio: float = math.nan) -> bool:
    """Return whether other searches confirm a bad fit as the best of the model.

    Parameters
    ----------
    one : EndedSearch
    ended : sequence of EndedSearch
        All, `one` among them or not.
    equation_ratio : float
        Root mean square of the equations' residual at the measured states by its noise; NaN where it is unknown.
    """
    if one.attempt.trouble is not SearchFailure.LARGE_RESIDUAL:
        return False
    confirmed = sum(_agree(one, other) for other in ended if other.number != one.number)
    ratio = one.attempt.noise_ratio
    is_explicable = ratio > POOR and ratio > MAX_NOISE_RATIO * equation_ratio
    return confirmed > (1 if is_explicable else 0)


def _agree(one: EndedSearch, other: EndedSearch) -> bool:
    """Return whether two searches from independent starts ended at the same optimum."""
    # corrections set out from the start that was given: the two confirm nothing of each other
    if {one.attempt.remedy, other.attempt.remedy} == {StartingPointSource.GIVEN, StartingPointSource.CORRECTION}:
        return False
    if other.attempt.trouble is not SearchFailure.LARGE_RESIDUAL or not abs(one.worth - other.worth) <= RIVAL_CRITERION:
        return False
    std = np.fmax(one.result.std, other.result.std)
    apart = np.abs(one.result.values - other.result.values)
    return bool((apart <= np.where(np.isfinite(std), SETTINGS.same_stds * std, np.inf)).all())


def corrected_start(evaluator: Evaluator[Problem], start: Floats, progress: Progress | None = None) -> Floats | None:
    """Return a start (N,) by corrected simulations, None where it cannot be had.

    Parameters
    ----------
    evaluator : Evaluator
    start : (N,) array
        Where the search for it sets out.
    progress : callable, optional

    Raises
    ------
    KeyboardInterrupt
        If the search for it is interrupted.
    """
    problem = evaluator.problem
    found = [_corrected(problem, index, start) for index in range(len(problem.experiments))]
    pairs = [each for each in found if each is not None]
    if len(pairs) < len(found):
        return None
    parameters, theta = _near(problem, start), start
    for method, simulators in zip(ROUGH, zip(*pairs, strict=True), strict=True):
        try:
            result = method.search(evaluator.of(problem.simulated_by(simulators, parameters)), progress, theta)
        except FmuidError:  # the exact search sets out from where this one did
            break
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        theta = result.values
    return None if theta is start else theta


def _near(problem: Problem, start: Floats) -> ParameterSet:
    """Return the parameters within `FARTHEST` of a start: a rough search does not come back from where one vanishes."""
    reach, sign = np.abs(start), np.sign(start)
    least = np.where(sign > 0.0, reach / FARTHEST, -FARTHEST * reach)
    most = np.where(sign < 0.0, -reach / FARTHEST, FARTHEST * reach)
    zero = sign == 0.0
    return problem.parameters.within(np.where(zero, -np.inf, least), np.where(zero, np.inf, most))


def _corrected(problem: Problem, index: int, start: Floats) -> tuple[Simulator, Simulator] | None:
    """Return the simulators of an experiment with corrections and without, None where there are none."""
    simulator = problem.simulators[index]
    try:
        side = RightHandSide.of(simulator)
        if side is None:
            return None
        slopes, _, _ = side.output_slopes(start[problem.parameters.for_experiment(index)[1]])
    except FmuidError:  # a start is not worth an error: the search itself says what is wrong with the model
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
