"""Prior–data conflict, and residual variance against the known noise (docs/method/noise-variances.md).

Both tests allow for colored noise: P_opt is larger then, and degrees of freedom are fewer (Bartlett).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import special

from fmuid.errors import InputError
from fmuid.estimation import LeastSquares, LinearizedProblem, Result
from fmuid.formatting import nearest
from fmuid.identification.acquisition_delay import DelayedNoise
from fmuid.identification.residual_analysis import ResidualAnalysis

SIGNIFICANCE_LEVEL = 0.01  # tests fail below this probability
SAME_VARIANCE_RATIO = 1.1  # equal variances; with many samples the smallest difference is significant


class Deviation(Enum):
    """Result of comparing a variance with the known one."""

    NONE = "none"
    LARGER = "larger"
    SMALLER = "smaller"


@dataclass(frozen=True)
class VarianceTest:
    """Test of an estimated residual variance against the known one."""

    output: str  # "" for all outputs together
    known: float  # σ_b², NaN for all outputs together
    estimated: float  # σ̂_b², likewise
    ratio: float  # χ²_ν/ν if the model with this prior is right
    degrees_of_freedom: float  # ν: effective sample size of the residual, less the parameters
    probability: float  # of this ratio or more by chance
    deviation: Deviation  # significant by all outputs together, and large


@dataclass(frozen=True)
class PriorDataTest:
    """Test of the prior against the data.

    Attributes
    ----------
    statistic : float
        (θ_opt − θ₀)ᵀ (M₀ + P_opt)⁻¹ (θ_opt − θ₀) over the directions that both determine.
    degrees_of_freedom : int
    probability : float
        Of this distance or more by chance.
    """

    statistic: float
    degrees_of_freedom: int
    probability: float

    @property
    def holds(self) -> bool:
        """True if prior and data agree within chance."""
        return self.probability >= SIGNIFICANCE_LEVEL


def agree(local: LinearizedProblem, noise: DelayedNoise) -> PriorDataTest | None:
    """Test prior against data, best at the optimum of data alone."""
    found = local.combine(noise.gram(local.data_basis)) if len(local.prior_residual) else None
    if found is None or found.degrees_of_freedom <= 0:
        return None
    probability = float(special.chdtrc(found.degrees_of_freedom, found.disagreement))
    return PriorDataTest(found.disagreement, found.degrees_of_freedom, probability)


def known_variances(problem: LeastSquares, given: Mapping[str, float]) -> dict[str, float]:
    """Return the checked noise variances in the order of the problem's outputs."""
    for output, value in given.items():
        if output not in problem.output_names:
            raise InputError(f"healthy: unknown output {output!r}{nearest(output, problem.output_names)}")
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"healthy: variance of {output!r} must be positive and finite, not {value!r}.")
    return {output: float(given[output]) for output in problem.output_names if output in given}


def variance_tests(
    problem: LeastSquares,
    result: Result,
    known: Mapping[str, float],
    local: LinearizedProblem,
    diagnostics: ResidualAnalysis,
) -> tuple[VarianceTest, ...]:
    """Test noise variances against known ones: each output, then all."""
    leverages, level = np.sum((local.jacobian @ local.root) ** 2, axis=1), SIGNIFICANCE_LEVEL / max(len(known), 1)
    leverage = np.bincount(problem.groups, weights=leverages, minlength=problem.counts.size)
    tests, frees = [], []
    for output, variance in known.items():
        j, estimated = problem.output_names.index(output), result.fit.noise_variance[output]
        free = max(float(problem.counts[j] - leverage[j]), 1.0)
        parts = [each for each in diagnostics.series if each.output == output]
        # sums of squares of several experiments: their variances add (Welch and Satterthwaite)
        worth = problem.counts[j] ** 2 / sum(each.samples * each.noise.variance_factor(2) for each in parts)
        tests.append(_test(output, variance, estimated, estimated / variance, free / problem.counts[j] * worth, level))
        frees.append(free)
    if len(tests) > 1:
        weights = np.array(frees)
        ratio = float(weights @ [test.ratio for test in tests] / weights.sum())
        freedom = float(weights.sum() ** 2 / np.sum(weights**2 / [test.degrees_of_freedom for test in tests]))
        tests.append(_test("", math.nan, math.nan, ratio, freedom, level))
    return tuple(tests)


def _test(output: str, known: float, estimated: float, ratio: float, freedom: float, level: float) -> VarianceTest:
    probability, deviation = float(special.chdtrc(freedom, ratio * freedom)), Deviation.NONE
    if ratio > SAME_VARIANCE_RATIO and probability < level:
        deviation = Deviation.LARGER
    elif ratio < 1.0 / SAME_VARIANCE_RATIO and probability > 1.0 - level:
        deviation = Deviation.SMALLER
    return VarianceTest(output, known, estimated, ratio, float(freedom), probability, deviation)
