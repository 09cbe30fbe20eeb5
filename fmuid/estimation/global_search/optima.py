"""The optima that a global search met, each once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.estimation.cost_components import CostComponents, fitted, variances
from fmuid.estimation.local_optimum import Optimum
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result

# Optima are one where no parameter differs by more than this share of its standard deviation, or of its magnitude, and
# the criterion by no more than 0.3². Fits end nearer than that even where large residuals make them converge slowly.
SAME_STDS, SAME_SHARE, SAME_CRITERION = 0.3, 1e-4, 0.1


def optima_table(names: Sequence[str], optima: Sequence[Optimum]) -> pd.DataFrame:
    """Return the optima found, a row each: criterion, hits, converged, and each parameter."""
    rows = [(o.criterion, o.hits, o.converged, *o.theta.tolist()) for o in optima]
    return pd.DataFrame(rows, columns=["criterion", "hits", "converged", *names])


def merge_optima(problem: LeastSquares, results: Sequence[Result]) -> tuple[Optimum, ...]:
    """Return the optima at which fits of a problem ended, the best first; nothing is simulated for it."""
    if not results:
        return ()
    ends = [fitted(problem, result) for result in results]
    squares, prior = (np.concatenate([getattr(end, part) for end in ends]) for part in ("squares", "prior"))
    every = CostComponents(squares, prior)
    criteria = every.compound(variances(problem, results[int(np.argmin(every.concentrated(problem)))]))
    groups: list[list[int]] = []  # of fits that ended at one optimum, the best of each first
    for i in map(int, np.argsort(criteria)):
        home = next((group for group in groups if _same(problem, results, criteria, i, group[0])), None)
        if home is None:
            groups.append([i])
        else:
            home.append(i)
    found = []
    for group in groups:
        chosen = next((i for i in group if results[i].converged), group[0])
        fit = results[chosen]
        found.append(Optimum(fit.values, float(criteria[chosen]), len(group), fit.outcome, fit))
    return tuple(sorted(found, key=lambda each: each.criterion))


def _same(problem: LeastSquares, results: Sequence[Result], criteria: Floats, i: int, best: int) -> bool:
    """Whether a fit ended at the same optimum as a better one."""
    # away from the best optimum residuals are larger than their variances, and standard deviations too small
    excess = max(1.0, criteria[best] / max(problem.measured.size - len(problem.parameters), 1))
    there = results[best].values
    stds = SAME_STDS * math.sqrt(excess) * np.nan_to_num(results[best].white_std, nan=0.0, posinf=np.inf)
    reach = np.maximum(stds, SAME_SHARE * problem.parameters.magnitudes(there))
    near = (np.abs(results[i].values - there) <= reach).all()
    return bool(near and criteria[i] - criteria[best] <= SAME_CRITERION * excess)
