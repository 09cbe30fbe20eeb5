"""Whether prior, data and the known noise agree (docs/method.md section 7).

A wrong prior biases irremediably, so two tests ask whether the data contradict it:

- the prior against the data: (θ_opt − θ₀)ᵀ (M₀ + P_opt)⁻¹ (θ_opt − θ₀) is χ² of as many degrees of freedom as there are
  directions that both speak of, if the prior is right;
- the residual against the noise that is known: σ̂_b²/σ_b² is χ²_ν/ν, if the model with this prior is right.

Both take the correlation of the residual over time into account (`fmuid.assessment.residuals`): P_opt is then larger
than stated, and ν smaller than the number of samples (Bartlett).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.arrays import Floats
from fmuid.assessment.residuals import Diagnostics
from fmuid.errors import InputError
from fmuid.estimation import LeastSquares, LocalModel, Result
from fmuid.text import listed, nearest

# Tests are said to fail below this probability.
SIGNIFICANT = 0.01
# A variance that differs from the known one by less than this factor is said to be as large: with many samples the
# smallest difference is significant.
SAME_VARIANCE = 1.1


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
    """

    output: str
    known: float
    estimated: float
    ratio: float
    degrees_of_freedom: float
    probability: float


@dataclass(frozen=True)
class Agreement:
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


def agree(local: LocalModel, diagnostics: Diagnostics) -> Agreement | None:
    """Test the prior against the data, by the paraboloids of a local model and the correlation of the residuals.

    Parameters
    ----------
    local : LocalModel
        At the optimum of the data alone or, where the problem is linear enough, at the estimate.
    diagnostics : Diagnostics
    """
    if not len(local.prior_residual):
        return None
    found = local.combine(diagnostics.gram(local.noisy(local.data_basis)))
    freedom = found.degrees_of_freedom
    if freedom <= 0:
        return None
    return Agreement(found.disagreement, freedom, float(special.chdtrc(freedom, found.disagreement)))


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
    problem: LeastSquares, result: Result, known: Mapping[str, float], local: LocalModel, diagnostics: Diagnostics
) -> tuple[VarianceTest, ...]:
    """Test the estimated noise variances against the known ones: of each output, then of all where there are several.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
    known : mapping of str to float
        Taken as exact.
    local : LocalModel
        At the estimate.
    diagnostics : Diagnostics
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
        worth = problem.counts[j] ** 2 / sum(each.samples**2 / each.variance_samples for each in parts)
        ratio = result.noise_variance[output] / variance
        freedom = free / problem.counts[j] * worth
        tests.append(_test(output, variance, result.noise_variance[output], ratio, freedom))
        frees.append(free)
    if len(tests) > 1:
        weights = np.array(frees)
        ratio = float(weights @ [test.ratio for test in tests] / weights.sum())
        freedom = float(weights.sum() ** 2 / np.sum(weights**2 / [test.degrees_of_freedom for test in tests]))
        tests.append(_test("", math.nan, math.nan, ratio, freedom))
    return tuple(tests)


def _test(output: str, known: float, estimated: float, ratio: float, freedom: float) -> VarianceTest:
    return VarianceTest(
        output, known, estimated, ratio, float(freedom), float(special.chdtrc(freedom, ratio * freedom))
    )


def agreement_words(agreement: Agreement, names: tuple[str, ...], conflict: Floats) -> str:
    """Say whether prior and data agree and, where not, on which parameter they disagree most."""
    chance = (
        f"χ² {agreement.statistic:.3g} with {agreement.degrees_of_freedom} degrees of freedom, "
        f"probability {agreement.probability:.2g}"
    )
    if agreement.probability >= SIGNIFICANT:
        return f"Prior and data agree ({chance})"
    sizes = np.abs(np.nan_to_num(conflict))
    i = int(np.argmax(sizes))
    most = f", most of all on {names[i]}, {sizes[i]:.2g} standard deviations apart" if sizes[i] else ""
    return (
        f"Prior and data disagree ({chance}){most}: the system has changed, the model lacks something, or the prior is "
        "wrong or too sure of itself; the estimate lies between both"
    )


def variance_words(tests: tuple[VarianceTest, ...], *, prior: bool) -> list[str]:
    """Say which residuals are larger or smaller than the known noise, or that all are as large.

    Parameters
    ----------
    tests : tuple of VarianceTest
    prior : bool
        Whether there is a prior, which may be to blame.
    """
    blame = "the model or the prior" if prior else "the model"
    said, outputs = [], [test for test in tests if test.output]
    level = SIGNIFICANT / max(len(outputs), 1)
    for test in outputs:
        times = f"{test.estimated:.3g}, {test.ratio:.2g} times the known {test.known:.3g}"
        if test.ratio > SAME_VARIANCE and test.probability < level:
            said.append(
                f"The residual of {test.output} is larger than its noise (variance {times}; probability "
                f"{test.probability:.2g}): the system has changed, or {blame} is wrong"
            )
        elif test.ratio < 1.0 / SAME_VARIANCE and test.probability > 1.0 - level:
            said.append(
                f"The residual of {test.output} is smaller than its noise (variance {times}): the noise is less than "
                "was said, and the standard deviations are too large"
            )
    if outputs and not said:
        shares = listed([f"{test.ratio:.3g}" for test in outputs])
        which = listed([test.output for test in outputs])
        said.append(
            f"The residual of {which} is as large as the known noise says (variance {shares} times it, probability "
            f"{tests[-1].probability:.2g})"
        )
    return said
