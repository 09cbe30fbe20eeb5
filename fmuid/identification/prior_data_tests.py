"""Whether prior, data and the known noise agree (docs/method.md section 7).

A wrong prior biases irremediably, so two tests ask whether the data contradict it:

- the prior against the data: (θ_opt − θ₀)ᵀ (M₀ + P_opt)⁻¹ (θ_opt − θ₀) is χ² of as many degrees of freedom as there are
  directions that both speak of, if the prior is right;
- the residual against the noise that is known: σ̂_b²/σ_b² is χ²_ν/ν, if the model with this prior is right.

Both take the correlation of the residual over time into account (`fmuid.identification.residual_analysis`): P_opt is
then larger than stated, and ν smaller than the number of samples (Bartlett).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy import special

from fmuid.errors import InputError
from fmuid.estimation import LeastSquares, LinearizedProblem, ResidualNoise, Result
from fmuid.formatting import nearest
from fmuid.identification.residual_analysis import ResidualAnalysis

# Tests are said to fail below this probability.
SIGNIFICANCE_LEVEL = 0.01
# A variance that differs from the known one by less than this factor is said to be as large: with many samples the
# smallest difference is significant.
SAME_VARIANCE_RATIO = 1.1


class Deviation(Enum):
    """What a variance is against the known one."""

    NONE = "none"
    LARGER = "larger"
    SMALLER = "smaller"


@dataclass(frozen=True)
class VarianceTest:
    """The estimated variance of a residual against the known one.

    Attributes
    ----------
    output : str
        "" for all outputs together.
    known, estimated : float
        σ_b² and σ̂_b²; NaN for all outputs together.
    ratio : float
        σ̂_b²/σ_b².
    degrees_of_freedom : float
        Independent samples that the residual is worth, less the parameters it paid for.
    probability : float
        That noise of the known variance gives as much or more.
    deviation : Deviation
        What is too unlikely to be chance, all outputs together, and large enough to matter.
    """

    output: str
    known: float
    estimated: float
    ratio: float
    degrees_of_freedom: float
    probability: float
    deviation: Deviation = Deviation.NONE


@dataclass(frozen=True)
class PriorDataTest:
    """The prior against the data.

    Attributes
    ----------
    statistic : float
        (θ_opt − θ₀)ᵀ (M₀ + P_opt)⁻¹ (θ_opt − θ₀), over the directions that both determine.
    degrees_of_freedom : int
    probability : float
        That prior and data that agree lie as far apart.
    """

    statistic: float
    degrees_of_freedom: int
    probability: float

    @property
    def holds(self) -> bool:
        """Whether prior and data agree as far as chance lets them."""
        return self.probability >= SIGNIFICANCE_LEVEL


def agree(local: LinearizedProblem, noise: ResidualNoise) -> PriorDataTest | None:
    """Test the prior against the data, by the paraboloids of a local model and the colour of the noise.

    Parameters
    ----------
    local : LinearizedProblem
        At the optimum of the data alone or, where the problem is linear enough, at the estimate.
    noise : ResidualNoise
    """
    if not len(local.prior_residual):
        return None
    found = local.combine(noise.gram(local.data_basis))
    freedom = found.degrees_of_freedom
    if freedom <= 0:
        return None
    return PriorDataTest(found.disagreement, freedom, float(special.chdtrc(freedom, found.disagreement)))


# --- the residual against the known noise -----------------------------------------------


def known_variances(problem: LeastSquares, given: Mapping[str, float]) -> dict[str, float]:
    """Return the known noise variances in the order of the problem's outputs.

    Raises
    ------
    InputError
        If one is of no measured output or not positive.
    """
    for output, value in given.items():
        if output not in problem.output_names:
            raise InputError(
                f"healthy names {output!r}, which is no measured output{nearest(output, problem.output_names)}"
            )
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"the healthy variance of {output!r} must be positive and finite, not {value!r}")
    return {output: float(given[output]) for output in problem.output_names if output in given}


def variance_tests(
    problem: LeastSquares,
    result: Result,
    known: Mapping[str, float],
    local: LinearizedProblem,
    diagnostics: ResidualAnalysis,
) -> tuple[VarianceTest, ...]:
    """Test the estimated noise variances against the known ones: of each output, then of all where there are several.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
    known : mapping of str to float
        Taken as exact.
    local : LinearizedProblem
        At the estimate.
    diagnostics : ResidualAnalysis
    """
    leverage = np.bincount(
        problem.groups, weights=np.sum((local.jacobian @ local.root) ** 2, axis=1), minlength=problem.counts.size
    )
    tests, frees = [], []
    for output, variance in known.items():
        j = problem.output_names.index(output)
        free = max(float(problem.counts[j] - leverage[j]), 1.0)
        parts = [each for each in diagnostics.series if each.output == output]
        # sums of squares of several experiments: their variances add (Welch and Satterthwaite)
        worth = problem.counts[j] ** 2 / sum(each.samples * each.noise.variance_factor(2) for each in parts)
        ratio = result.noise_variance[output] / variance
        freedom = free / problem.counts[j] * worth
        tests.append(_test(output, variance, result.noise_variance[output], ratio, freedom))
        frees.append(free)
    if len(tests) > 1:
        weights = np.array(frees)
        ratio = float(weights @ [test.ratio for test in tests] / weights.sum())
        freedom = float(weights.sum() ** 2 / np.sum(weights**2 / [test.degrees_of_freedom for test in tests]))
        tests.append(_test("", math.nan, math.nan, ratio, freedom))
    return tuple(replace(test, deviation=_deviation(test, len(known))) for test in tests)


def _deviation(test: VarianceTest, outputs: int) -> Deviation:
    level = SIGNIFICANCE_LEVEL / max(outputs, 1)
    if test.ratio > SAME_VARIANCE_RATIO and test.probability < level:
        return Deviation.LARGER
    if test.ratio < 1.0 / SAME_VARIANCE_RATIO and test.probability > 1.0 - level:
        return Deviation.SMALLER
    return Deviation.NONE


def _test(output: str, known: float, estimated: float, ratio: float, freedom: float) -> VarianceTest:
    return VarianceTest(
        output, known, estimated, ratio, float(freedom), float(special.chdtrc(freedom, ratio * freedom))
    )
