"""Searches that go on from another start where the one that was given leads nowhere, or to a bad fit.

A start that explains little is not searched from at once where the equations of the model give a better one
(`fmuid.identification.equation_error_start`), or corrected simulations do
(`fmuid.identification.state_correction_start`). After each search it is asked whether it ended, and whether its
residual is about as large as the noise of the data themselves; if not, the next start is tried: the others of these
three, then points of the box. A search from elsewhere that ends where another did confirms it
(`fmuid.identification.agreement`): then it is the model, not the start.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.blas import single_threaded
from fmuid.errors import FmuidError, InputError, SimulationError, check_kind
from fmuid.estimation import (
    MAX_NOISE_RATIO,
    LeastSquares,
    Marquardt,
    Method,
    RestartAttempt,
    Result,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
    second_difference_noise,
    sobol_points,
)
from fmuid.identification import solver_checked_search as checked_search
from fmuid.identification.agreement import EndedSearch, is_confirmed
from fmuid.identification.discrete_search import identify_each
from fmuid.identification.equation_error_start import equation_start
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check_region import CheckedRegion
from fmuid.identification.state_correction_start import corrected_start
from fmuid.progress import Progress

# A start that is worse than the mean of an output is a far one.
FAR = 1.0
# From another start than the one that was given the search goes by model exchange where the outputs differ by more than
# this share of their spread: what co-simulation has inside is rough in many places, and there is no past to agree with.
START_LIMIT = 1e-6
# Points of the box that are simulated, how many of the best are searched from, and how far the box reaches without
# bounds: as a factor, or so many times the nominal magnitude.
POINTS, BEST, FACTOR, MULTIPLE, SEED = 16, 3, 10.0, 3.0, 0
# So many iterations has a search from a start that nobody gave, before others have had their turn.
PATIENCE = 60
# One wild sample must not decide between points: squares of residuals count up to here, in those of the noise.
LARGEST_SQUARE = 1e12
UNFINISHED = (
    TerminationReason.STALLED,
    TerminationReason.ITERATION_LIMIT,
    TerminationReason.FAILING,
    TerminationReason.RUNAWAY,
    TerminationReason.UNSETTLED,
)


@single_threaded
def identify(
    problem: LeastSquares,
    settings: Method | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    accuracy: str = "refine",
    remedies: bool = True,
    region: CheckedRegion | None = None,
) -> Result:
    """Identify the parameters of a problem, and check what the error of the simulation does to them.

    Parameters
    ----------
    problem : LeastSquares
        Only a `Problem`, whose predictors run FMUs, has a simulation to check, and remedies. It is simulated in a finer
        way from then on where the search has to go on by one. One that measurements correct
        (`fmuid.identification.with_observer`) has neither, and its result says so by `Result.observer`.
    settings : Marquardt or GlobalSearch, optional
        Default: Marquardt's search from the parameters' starts.
    progress : callable, optional
        Called with every `fmuid.progress.SearchStep`, and `GlobalStep` of a search of the box.
    start : (N,) array, optional
        Start elsewhere than the parameters say.
    accuracy : "refine", "report" or "off"
        Go on by a finer simulation where the error moves an estimate by more than `SHIFT_LIMIT` of its standard
        deviation, if that goes against nothing that was asked for; just say what it does; or do not look. Optima of a
        box that are as good as the best, and that a finer simulation does not bear out, are no optima.
    remedies : bool
        Try other starts where the search cannot begin or end, or where a residual is larger than
        `fmuid.estimation.MAX_NOISE_RATIO` times the noise that the data show; `Result.attempts` says what was tried. A
        search of the whole box needs none.
    region : CheckedRegion, optional
        What is known of the simulation from other searches on like data, of the same parameters.

    Returns
    -------
    Result
        With `Result.accuracy`. Also where the search did not converge or was interrupted from the keyboard: its
        `outcome` says so. Then nothing more is simulated, and samples that do not count are NaN in `Result.fit`.

    Raises
    ------
    SimulationError
        If the simulation at the start fails, and at all others that were tried.
    InputError
        If a parameter without prior acts on no output, neither at the start nor at some points of its box, or a search
        of the box lacks bounds.
    KeyboardInterrupt
        If that comes before the first step: there is no better point than the start then.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> fmuid.identify(problem)
    Result(converged: R = 3.9989 ± 0.0015, L = 0.100016 ± 0.000050)
    """
    check_kind(problem, LeastSquares, "what is identified (a study file: fmuid.run) must be a fmuid.Problem")
    method = settings or Marquardt()
    check_kind(method, Method, "settings must be fmuid.Marquardt() or fmuid.GlobalSearch()")
    if not isinstance(problem, Problem):
        return _identify(problem, method, progress, start, accuracy, remedies, region)
    if problem.choices:
        found = identify_each(problem, lambda: _identify(problem, method, progress, start, accuracy, remedies, None))
    else:
        found = _identify(problem, method, progress, start, accuracy, remedies, region)
    return replace(found, made_with=problem.made_with)


def _identify(
    problem: LeastSquares,
    method: Method,
    progress: Progress | None,
    start: ArrayLike | None,
    accuracy: str,
    remedies: bool,
    region: CheckedRegion | None,
) -> Result:
    """Identify the parameters of a problem whose other values are all known."""
    if isinstance(problem, Problem) and problem.corrected:
        return replace(method.search(problem, progress, start), observer=problem.observer)
    if not remedies or method.whole_box or not isinstance(problem, Problem):
        return checked_search.identify(problem, method, progress, start, accuracy=accuracy, region=region)
    return _RestartingSearch(problem, method, progress, accuracy, region).run(start)


class _RestartingSearch:
    """The starts of one search, and what became of them."""

    def __init__(
        self,
        problem: Problem,
        method: Method,
        progress: Progress | None,
        accuracy: str,
        region: CheckedRegion | None,
    ) -> None:
        self.problem, self.method, self.progress = problem, method, progress
        self.accuracy, self.region = accuracy, region
        self.clock, self.before = time.perf_counter(), problem.simulations
        self.attempts: list[RestartAttempt] = []
        self.ended: list[EndedSearch] = []
        self.equation_ratio = math.nan
        self.error: FmuidError | None = None
        self.noise = _noise(problem)

    def run(self, start: ArrayLike | None) -> Result:
        """Try one start after the other until one leads to an end that fits, or two to the same."""
        problem = self.problem
        given = problem.parameters.start if start is None else numbers(start, "start")
        if given.shape != problem.parameters.start.shape:
            return self._search(given)  # which says what is wrong
        problem.check_measured()
        before = problem.simulations
        for remedy, theta in self._starts(given):
            try:
                own = remedy is StartingPointSource.GIVEN
                result = self._search(theta, given=own and start is None, most=math.inf if own else PATIENCE)
            except (InputError, SimulationError) as error:
                failed = isinstance(error, SimulationError)
                self.error = error if self.error is None or remedy is StartingPointSource.GIVEN else self.error
                self._note(remedy, SearchFailure.FAILED if failed else SearchFailure.NO_EFFECT, before)
                before = problem.simulations
                continue
            self._end(remedy, result, before)
            before = problem.simulations
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
            before = self.problem.simulations
            self._end(best.attempt.remedy, self._search(best.result.values), before)

    # --- where to begin

    def _starts(self, given: Floats) -> Iterator[tuple[StartingPointSource, Floats]]:
        better = self._better(given)
        first = next(better, None) if self._is_far(given) else None
        if first is not None:
            self.attempts.append(RestartAttempt(StartingPointSource.GIVEN, SearchFailure.FAR, simulations=1))
            yield first
        yield StartingPointSource.GIVEN, given
        yield from better
        for theta in self._points(given):
            yield StartingPointSource.SOBOL, theta

    def _better(self, given: Floats) -> Iterator[tuple[StartingPointSource, Floats]]:
        """Return the starts that are found from the one that was given, the cheapest first."""
        equation = equation_start(self.problem, given)
        if equation is not None:
            self.equation_ratio = equation.noise_ratio
            yield StartingPointSource.EQUATION_ERROR, equation.theta
        corrected = corrected_start(self.problem, given, self.progress)
        if corrected is not None:
            yield StartingPointSource.CORRECTION, corrected

    def _is_far(self, given: Floats) -> bool:
        """Whether the simulation at a start fails, or explains little of an output."""
        problem = self.problem
        with problem.uncounted():
            before = problem.simulations
            predicted = problem.predict(given[None])[0]
            spent = problem.simulations - before
        problem.remember(given, predicted, due=spent)
        if not np.isfinite(predicted).all():
            return True
        for j in range(problem.counts.size):
            own = problem.groups == j
            measured = problem.measured[own]
            with np.errstate(over="ignore"):
                left = float(np.mean((measured - predicted[own]) ** 2))
            if left > FAR * float(np.var(measured)):
                return True
        return False

    def _points(self, given: Floats) -> Iterator[Floats]:
        """Return the best of some points of the box, by one batch of simulations."""
        parameters = self.problem.parameters
        units = sobol_points(given.size, POINTS, SEED)
        scale = parameters.magnitudes(given)
        multiples = given + (2.0 * units - 1.0) * MULTIPLE * scale
        factors = given * FACTOR ** (2.0 * units - 1.0)
        points = np.where(np.abs(given) > 0.0, factors, multiples)
        bounded = np.isfinite(parameters.lower) & np.isfinite(parameters.upper)
        width = np.where(bounded, parameters.upper, 0.0) - np.where(bounded, parameters.lower, 0.0)
        narrow = bounded & (width < FACTOR * scale)
        points[:, narrow] = (np.where(bounded, parameters.lower, 0.0) + units * width)[:, narrow]
        points = np.clip(points, parameters.lower, parameters.upper)
        predicted = self.problem.predict(points)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = ((predicted - self.problem.measured) / self.noise[self.problem.groups]) ** 2
        squared = np.minimum(np.nan_to_num(squares, nan=np.inf), LARGEST_SQUARE).sum(axis=1)
        yield from (points[i] for i in np.argsort(squared, kind="stable")[:BEST] if np.isfinite(predicted[i]).all())

    # --- one search

    def _search(self, theta: Floats, *, given: bool = False, most: float = math.inf) -> Result:
        method = self.method.marquardt
        return checked_search.identify(
            self.problem,
            replace(method, max_iterations=int(min(most, method.max_iterations))),
            self.progress,
            None if given else theta,
            accuracy=self.accuracy,
            region=self.region if given else None,
            start_limit=checked_search.START_LIMIT if given else START_LIMIT,
        )

    def _end(self, remedy: StartingPointSource, result: Result, before: int) -> None:
        ratio = self._noise_ratio(result)
        trouble = SearchFailure.NONE
        if result.outcome in UNFINISHED:
            trouble = SearchFailure.UNFINISHED
        elif ratio > MAX_NOISE_RATIO:
            trouble = SearchFailure.LARGE_RESIDUAL
        attempt = self._note(remedy, trouble, before, ratio)
        self.ended.append(EndedSearch(result, attempt, len(self.attempts) - 1, self._worth(result)))

    def _note(
        self, remedy: StartingPointSource, trouble: SearchFailure, before: int, ratio: float = math.nan
    ) -> RestartAttempt:
        self.attempts.append(RestartAttempt(remedy, trouble, ratio, self.problem.simulations - before))
        return self.attempts[-1]

    def _noise_ratio(self, result: Result) -> float:
        """Return the largest root mean square of an output's residual, by its noise."""
        variances = [result.noise_variance[name] for name in self.problem.output_names]
        ratios = np.sqrt(variances) / self.noise
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
            simulations=self.problem.simulations - self.before,
            elapsed_s=time.perf_counter() - self.clock,
            attempts=tried,
        )

    def _best(self) -> EndedSearch:
        """Return the one that fits best; of those that fit alike, one that came to an end."""
        least = min(each.worth for each in self.ended)
        alike = [each for each in self.ended if each.worth - checked_search.RIVAL_CRITERION <= least]
        return min(alike, key=lambda each: (each.attempt.trouble is SearchFailure.UNFINISHED, each.worth))

    def _worth(self, result: Result) -> float:
        """Return Σ K_j log σ̂_j², by which results of any variances compare."""
        variances = [result.noise_variance[name] for name in self.problem.output_names]
        with np.errstate(divide="ignore"):
            return float(self.problem.counts @ np.log(variances))


def _noise(problem: Problem) -> Floats:
    """Return the standard deviation of each output's noise (n_outputs,) as its second differences show it."""
    squares, counts = np.zeros((2, problem.counts.size))
    for experiment, tables in zip(problem.experiments, problem.tables(problem.measured), strict=True):
        for name, values, counted in zip(experiment.output_names, tables.T, experiment.counted.T, strict=True):
            j, own = problem.output_names.index(name), np.where(counted, values, np.nan)
            size, found = int(counted.sum()), second_difference_noise(experiment.times, own)
            if math.isfinite(found):
                squares[j] += size * found**2
                counts[j] += size
    # what does not move, or in steps, shows no noise at all: rounding of its largest value
    floor = [1e-9 * float(np.max(np.abs(problem.measured[problem.groups == j]))) for j in range(counts.size)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.fmax(np.sqrt(squares / counts), np.maximum(floor, 1e-300))
