"""Searches over parameters that take few values: one search for each combination of them, the best one kept.

Searches compare by −2 ln L of the data plus the square of the prior's rows, which noise variances of their own do not
spoil; with a robust loss, which has no likelihood, by the logarithms of the variances instead of ln L.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation import CombinationFit, Result, TerminationReason
from fmuid.identification.discrete_parameters import combinations
from fmuid.identification.problem import Problem
from fmuid.simulation import Value


@dataclass(frozen=True, eq=False)
class _CombinationResult:
    values: Mapping[str, Value]
    result: Result
    deviance: float


def identify_each(problem: Problem, search: Callable[[], Result]) -> Result:
    """Search with each combination of the values in `problem.choices`, and leave the problem at the best.

    Parameters
    ----------
    problem : Problem
    search : callable
        Of the problem as it is.

    Returns
    -------
    Result
        The best one, with `Result.combinations`.

    Raises
    ------
    InputError, SimulationError
        Of the first combination, where none can be searched.
    """
    clock, before = time.perf_counter(), problem.simulations
    tried: list[_CombinationResult] = []
    failed: list[Mapping[str, Value]] = []
    first: FmuidError | None = None
    for values in combinations(problem.choices):
        problem.choose(values)
        try:
            result = search()
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
    result = replace(
        best.result,
        outcome=TerminationReason.INTERRUPTED
        if any(c.outcome is TerminationReason.INTERRUPTED for c in told)
        else best.result.outcome,
        combinations=(*told, *(CombinationFit(values, None, math.inf, {}) for values in failed)),
        simulations=problem.simulations - before,
        elapsed_s=time.perf_counter() - clock,
    )
    problem.become(result)
    return result


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
