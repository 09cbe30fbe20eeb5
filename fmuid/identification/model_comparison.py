"""Comparison of models by information criteria and likelihood-ratio tests.

    AIC = −2 ln L + 2k,   BIC = −2 ln L + k ln n

with k parameters and estimated variances, n samples (Burnham and Anderson, 2002; Schwarz, Annals of Stat. 6, 1978).
For colored residuals ln L and n are divided by c, the integrated correlation time of the best fit (quasi-likelihood,
Lebreton et al., Ecological Monographs 62, 1992).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from fmuid.errors import InputError, check_kind
from fmuid.estimation import Reason, Result


@dataclass(frozen=True, eq=False)
class ModelCandidate:
    """A result to compare.

    Attributes
    ----------
    name : str
    result : Result
    dependence : float
        c, integrated correlation time of its residual in samples; 1 for white noise, NaN where unknown.
    held : mapping of str to float, int, bool or str, or None
        Fixed variables of its study; None where unknown, then no nesting is claimed.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> one = fmuid.identification.ModelCandidate("coil", result)
    >>> one.count, one.samples
    (3, 200)
    """

    name: str
    result: Result
    dependence: float = 1.0
    held: Mapping[str, float | int | bool | str] | None = None

    @property
    def count(self) -> int:
        """k: the identifiable parameters and estimated variances."""
        variances = len(set(self.result.fit.noise_variance) - set(self.result.fit.given_variance))
        sizes = self._freed.count(Reason.MODEL_ERROR)
        return len(self.result.names) + sizes - len(self.result.identifiability.non_identifiable) + variances

    @property
    def excludes(self) -> bool:
        """True if clipped stretches, found with its model, do not count."""
        return Reason.DATA_DEFECT in self._freed

    @property
    def _freed(self) -> list[Reason]:
        return [] if self.result.verdict is None else [each.reason for each in self.result.verdict.freed]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(series.samples for series in self.result.setup.data)

    @property
    def has_prior(self) -> bool:
        """True if priors keep it from the maximum likelihood."""
        return bool(np.isfinite(self.result.estimates.prior_mean).any())


@dataclass(frozen=True)
class Rank:
    """One of the compared results."""

    name: str
    parameters: int  # k, estimated variances included
    log_likelihood: float
    aic: float  # of independent samples
    bic: float
    corrected_aic: float  # log-likelihood and samples divided by c
    corrected_bic: float
    behind: float  # `corrected_aic` less the least of all
    weight: float  # Akaike weight: probability of predicting best among these models


@dataclass(frozen=True)
class LikelihoodRatioTest:
    """Test of a model against one that contains it."""

    smaller: str
    larger: str
    freed: tuple[str, ...]  # parameters of the larger that the smaller one fixes
    statistic: float  # twice the difference of the log-likelihoods, divided by c
    probability: float  # of as much by chance if the smaller one is right
    uncorrected: float  # the probability for independent samples


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Comparison of results of the same data.

    Attributes
    ----------
    ranks : tuple of Rank
        The best first, by `Rank.corrected_aic`.
    tests : tuple of LikelihoodRatioTest
        Of all nested pairs.
    dependence, samples : float and int
        c and n.
    with_priors : tuple of str
        Results with priors: their log-likelihood is not the maximum.
    """

    ranks: tuple[Rank, ...]
    tests: tuple[LikelihoodRatioTest, ...]
    dependence: float
    samples: int
    with_priors: tuple[str, ...]

    @property
    def table(self) -> pd.DataFrame:
        """A row for each result, the best first."""
        return pd.DataFrame(vars(rank) for rank in self.ranks)


class IncomparableError(InputError):
    """Results with incomparable likelihoods; `reason` is a sentence."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"{reason} Compare on a common table (--data).")


def compare_models(candidates: Sequence[ModelCandidate]) -> ModelComparison:
    """Compare results of the same measurements, without simulations.

    Raises
    ------
    InputError
        If there are fewer than two, names repeat, measurements differ, or one has no likelihood.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> result = fmuid.identify(coil.problem())
    >>> held = fmuid.Problem(coil.fmu, coil.experiment, {"R": coil.parameters["R"]}, values={"L": 0.2})
    >>> candidates = {"R, L": result, "R": fmuid.identify(held)}
    >>> both = fmuid.compare_models([fmuid.identification.ModelCandidate(*each) for each in candidates.items()])
    >>> [rank.name for rank in both.ranks]
    ['R, L', 'R']
    """
    check_kind(
        candidates,
        (list, tuple),
        "what is compared must be a list of fmuid.identification.ModelCandidate(name, result)",
    )
    for each in candidates:
        check_kind(each, ModelCandidate, "what is compared must be fmuid.identification.ModelCandidate(name, result)")
    _check(candidates)
    best_fit = max(candidates, key=lambda each: each.result.fit.log_likelihood)
    dependence = max(1.0, np.nan_to_num(best_fit.dependence, nan=1.0))
    samples = candidates[0].samples
    aics = [-2.0 * each.result.fit.log_likelihood / dependence + 2.0 * each.count for each in candidates]
    weights = [math.exp(-0.5 * (aic - min(aics))) for aic in aics]
    ranks = []
    for each, aic, weight in zip(candidates, aics, weights, strict=True):
        likelihood, k = each.result.fit.log_likelihood, each.count
        plain = -2.0 * likelihood + 2.0 * k, -2.0 * likelihood + k * math.log(samples)
        bic = -2.0 * likelihood / dependence + k * math.log(samples / dependence)
        ranks.append(Rank(each.name, k, likelihood, *plain, aic, bic, aic - min(aics), weight / sum(weights)))
    tests = [_ratio(one, other, dependence) for one in candidates for other in candidates if _contains(other, one)]
    priors = tuple(each.name for each in candidates if each.has_prior)
    ranks.sort(key=lambda rank: rank.corrected_aic)
    return ModelComparison(tuple(ranks), tuple(tests), float(dependence), samples, priors)


def _check(candidates: Sequence[ModelCandidate]) -> None:
    if len(candidates) < 2:
        raise InputError("a comparison needs at least two results.")
    names = [each.name for each in candidates]
    for name, each in zip(names, candidates, strict=True):
        if names.count(name) > 1:
            raise InputError(f"two results have the name {name}. Give each once, in folders with different names.")
        if not each.result.setup.data:
            raise IncomparableError(f"{each.name} does not name its data.")
        if not math.isfinite(each.result.fit.log_likelihood):
            raise IncomparableError(f"{each.name} has no likelihood (robust loss).")
    first = candidates[0]
    for other in candidates[1:]:
        one, another = (
            sorted((s.unit, s.samples, s.digest) for s in each.result.setup.data) for each in (first, other)
        )
        if one == another:
            continue
        if first.excludes or other.excludes:
            raise IncomparableError(
                f"{first.name} and {other.name} exclude different clipped samples. "
                'Set `estimation.model_error = "report"` in both studies.'
            )
        raise IncomparableError(
            f"{first.name} and {other.name} have different data. Their likelihoods are not comparable."
        )


def _contains(larger: ModelCandidate, smaller: ModelCandidate) -> bool:
    """Tell if one model is known to be nested in another."""
    one, other = smaller.result, larger.result
    freed = set(other.names) - set(one.names)
    if not freed or not set(one.names) < set(other.names) or smaller.has_prior or larger.has_prior:
        return False
    models = [{c: (m["name"], m["digest"]) for c, m in each.setup.models.items()} for each in (one, other)]
    if not models[0] or models[0] != models[1] or dict(one.fit.given_variance) != dict(other.fit.given_variance):
        return False
    if smaller.held is None or larger.held is None:
        return False
    variables = freed | {name.rpartition("[")[0] for name in freed}
    rest = {name: value for name, value in smaller.held.items() if name not in variables}
    return rest == dict(larger.held)


def _ratio(smaller: ModelCandidate, larger: ModelCandidate, dependence: float) -> LikelihoodRatioTest:
    one, other = smaller.result, larger.result
    freed = tuple(name for name in other.names if name not in one.names)
    twice = max(0.0, 2.0 * (other.fit.log_likelihood - one.fit.log_likelihood))
    chances = (float(special.chdtrc(len(freed), each)) for each in (twice / dependence, twice))
    return LikelihoodRatioTest(smaller.name, larger.name, freed, twice / dependence, *chances)
