"""Parameters with listed choices: a search for each combination of their values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation import CombinationFit, Result, TerminationReason
from fmuid.identification.problem import Problem
from fmuid.identification.strategies import Searches, Trial
from fmuid.simulation import Value


def search_combinations(trial: Trial) -> Searches:
    """Search with each combination of the `choices`; return the best result."""
    evaluator, problem = trial.evaluator, trial.evaluator.problem
    tried: list[tuple[float, Mapping[str, Value], Result]] = []
    failed: list[CombinationFit] = []
    first: FmuidError | None = None
    for each in product(*problem.choices.values()):
        values = dict(zip(problem.choices, each, strict=True))
        held = evaluator.of(problem.holding(values))
        try:
            result = yield replace(trial, evaluator=held)
        except (InputError, SimulationError) as error:
            first = first or error
            failed.append(CombinationFit(values, None, math.inf, {}))
            continue
        tried.append((_deviance(problem, result), values, result))
        if result.outcome is TerminationReason.INTERRUPTED:
            break
    if not tried:
        assert first is not None
        raise first
    tried.sort(key=lambda each: each[0] if math.isfinite(each[0]) else math.inf)
    least, _, best = tried[0]
    fits = [
        CombinationFit(values, one.outcome, own - least, dict(zip(one.names, one.values.tolist(), strict=True)))
        for own, values, one in tried
    ]
    is_interrupted = any(fit.outcome is TerminationReason.INTERRUPTED for fit in fits)
    outcome = TerminationReason.INTERRUPTED if is_interrupted else best.outcome
    return replace(best, outcome=outcome, history=replace(best.history, combinations=(*fits, *failed)))


def _deviance(problem: Problem, result: Result) -> float:
    """Return −2 ln L (or Σ K ln σ²) with the prior."""
    away: Floats = np.nan_to_num(problem.parameters.prior_mean - result.values)
    prior = float(np.sum((problem.parameters.prior_whitening @ away) ** 2))
    if math.isfinite(result.fit.log_likelihood):
        return prior - 2.0 * result.fit.log_likelihood
    if len(result.fit.given_variance) == len(problem.output_names):
        return result.fit.cost
    variances = [result.fit.variance.get(name, math.nan) for name in problem.output_names]
    with np.errstate(divide="ignore"):
        return prior + float(problem.counts @ np.log(variances))
