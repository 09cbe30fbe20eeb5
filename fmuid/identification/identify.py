"""Identification: each combination of discrete parameters, from starting points, with the solver error checked.

Combinations compare by −2 ln L of the data plus the square of the prior's rows, which noise variances of their own do
not spoil; with a robust loss, which has no likelihood, by the logarithms of the variances instead of ln L.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.errors import FmuidError, InputError, SimulationError, check_kind
from fmuid.estimation import (
    Cache,
    CombinationFit,
    Evaluator,
    LeastSquares,
    Marquardt,
    Method,
    Result,
    TerminationReason,
)
from fmuid.formatting import nearest
from fmuid.identification.discrete_parameters import combinations
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check import ACCURACIES, SolverCheckedSearch
from fmuid.identification.starting_points import search_restarting
from fmuid.progress import Progress
from fmuid.simulation import Value


@single_threaded
def identify(
    problem: LeastSquares,
    settings: Method | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    accuracy: str = "refine",
    remedies: bool = True,
    cache: Cache | None = None,
) -> Result:
    """Identify the parameters of a problem, and check what the error of the simulation does to them.

    Parameters
    ----------
    problem : LeastSquares
        Only a `Problem`, whose predictors run FMUs, has a simulation to check, and remedies. One that measurements
        correct (`fmuid.identification.with_observer`) has neither, and its result says so by `Result.observer`.
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
    cache : Cache, optional
        What problems share that differ in their measurements only (`Problem.measuring`).

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
    if accuracy not in ACCURACIES:
        raise InputError(
            f"accuracy {accuracy!r} is not known{nearest(str(accuracy), ACCURACIES)}: give {' or '.join(ACCURACIES)}"
        )
    return identify_by(Evaluator(problem, cache), method, progress, start, accuracy=accuracy, remedies=remedies)


def identify_by(
    evaluator: Evaluator[LeastSquares],
    method: Method,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    accuracy: str,
    remedies: bool,
) -> Result:
    """Identify as `identify` does, by an evaluator, which has counted the simulations afterwards."""
    problem = evaluator.problem
    if not isinstance(problem, Problem):
        return method.search(evaluator, progress, start)

    def search(held: Evaluator[Problem]) -> Result:
        if held.problem.corrected:
            return replace(method.search(held, progress, start), observer=held.problem.observer)
        if remedies and not method.whole_box:
            return search_restarting(held, method, progress, start, accuracy=accuracy)
        return SolverCheckedSearch(held, method, progress, accuracy).run(start)

    of_problem = evaluator.of(problem)
    found = _best_combination(of_problem, search) if problem.choices else search(of_problem)
    return replace(found, made_with=problem.made_with)


@dataclass(frozen=True, eq=False)
class _CombinationResult:
    values: Mapping[str, Value]
    result: Result
    deviance: float


def _best_combination(evaluator: Evaluator[Problem], search: Callable[[Evaluator[Problem]], Result]) -> Result:
    """Search with each combination of the values in `Problem.choices` and return the best result.

    Raises
    ------
    InputError, SimulationError
        Of the first combination, where none can be searched.
    """
    problem, clock, before = evaluator.problem, time.perf_counter(), evaluator.simulations
    tried: list[_CombinationResult] = []
    failed: list[Mapping[str, Value]] = []
    first: FmuidError | None = None
    for values in combinations(problem.choices):
        held = evaluator.of(problem.holding(values))
        try:
            result = search(held)
        except (InputError, SimulationError) as error:
            first = first or error
            failed.append(values)
            continue
        tried.append(_CombinationResult(values, result, _deviance(problem, result)))
        if result.outcome is TerminationReason.INTERRUPTED:
            break
    if not tried:
        assert first is not None
        raise first
    tried.sort(key=lambda each: each.deviance if math.isfinite(each.deviance) else math.inf)
    best = tried[0]
    told = [
        CombinationFit(each.values, each.result.outcome, each.deviance - best.deviance, _estimates(each.result))
        for each in tried
    ]
    return replace(
        best.result,
        outcome=TerminationReason.INTERRUPTED
        if any(c.outcome is TerminationReason.INTERRUPTED for c in told)
        else best.result.outcome,
        combinations=(*told, *(CombinationFit(values, None, math.inf, {}) for values in failed)),
        simulations=evaluator.simulations - before,
        elapsed_s=time.perf_counter() - clock,
    )


def _estimates(result: Result) -> dict[str, float]:
    return dict(zip(result.names, result.values.tolist(), strict=True))


def _deviance(problem: Problem, result: Result) -> float:
    away: Floats = np.nan_to_num(problem.parameters.prior_mean - result.values)
    prior = float(np.sum((problem.parameters.prior_whitening @ away) ** 2))
    if math.isfinite(result.log_likelihood):
        return prior - 2.0 * result.log_likelihood
    if len(result.given_variance) == len(problem.output_names):
        return result.criterion
    variances = [result.variance.get(name, math.nan) for name in problem.output_names]
    with np.errstate(divide="ignore"):
        return prior + float(problem.counts @ np.log(variances))
