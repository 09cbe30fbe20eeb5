"""Which of several results to prefer: information criteria, and likelihood ratios where one model contains another.

A model with more parameters always fits better. Akaike's and Schwarz's criteria charge for them,

    AIC = −2 ln L + 2k,   BIC = −2 ln L + k ln n,

k parameters and estimated variances, n samples; the least is the best. Where one model is another with some of its
parameters held, twice the difference of their log-likelihoods is χ² of as many degrees of freedom if those are right.

All three take the samples for independent. Coloured residuals make n samples worth n/c of them only, c the integrated
correlation time, and the log-likelihood, which counts them all, c times too sure of every difference. It is divided by
c as an overdispersed one is by its variance factor (quasi-likelihood, Lebreton et al.), one c for all models that are
compared: that of the one that fits best, whose residual has the least of its model's errors. For white residuals c = 1
and nothing changes.

References
----------
K. P. Burnham, D. R. Anderson, "Model Selection and Multimodel Inference", 2nd ed., 2002, sections 2.2, 2.5 and 6.4;
J.-D. Lebreton et al., "Modeling survival and testing biological hypotheses using marked animals", Ecological Monographs
62 (1), 1992; G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (2), 1978.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from fmuid.errors import InputError, check_kind
from fmuid.estimation import Result


@dataclass(frozen=True, eq=False)
class ModelCandidate:
    """A result to be compared.

    Attributes
    ----------
    name : str
    result : Result
    dependence : float
        c: how many samples of its residual are worth one that is independent; 1 for a white one, NaN where it is not
        known.
    held : mapping of str to float, int, bool or str, or None
        The variables that its study holds at a value; None where that is not known, and no nesting is claimed.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> one = fmuid.ModelCandidate("coil", result)
    >>> one.count, one.samples
    (3, 200)
    """

    name: str
    result: Result
    dependence: float = 1.0
    held: Mapping[str, float | int | bool | str] | None = None

    @property
    def count(self) -> int:
        """k: the parameters that are determined, and the estimated variances."""
        variances = len(set(self.result.noise_variance) - set(self.result.given_variance))
        return len(self.result.names) - len(self.result.undetermined) + variances

    @property
    def samples(self) -> int:
        """How many samples it was made from."""
        return sum(series.samples for series in self.result.data)

    @property
    def has_prior(self) -> bool:
        """Whether it is not the most likely one by the data alone."""
        return bool(np.isfinite(self.result.prior_mean).any())


@dataclass(frozen=True)
class Rank:
    """One result among those compared.

    Attributes
    ----------
    name : str
    parameters : int
        k, estimated variances included.
    log_likelihood : float
    aic, bic : float
        As if the samples were independent.
    corrected_aic, corrected_bic : float
        With the log-likelihood and the samples divided by c.
    behind : float
        `corrected_aic` less the least of all.
    weight : float
        Akaike's: the probability, among these models, that this one predicts best.
    """

    name: str
    parameters: int
    log_likelihood: float
    aic: float
    bic: float
    corrected_aic: float
    corrected_bic: float
    behind: float
    weight: float


@dataclass(frozen=True)
class LikelihoodRatioTest:
    """A model tested against one that contains it.

    Attributes
    ----------
    smaller, larger : str
        Their names.
    freed : tuple of str
        The parameters of the larger one that the smaller one holds.
    statistic : float
        Twice the difference of the log-likelihoods, divided by c.
    probability : float
        That chance gives as much if the smaller one is right.
    uncorrected : float
        The same as if the samples were independent.
    """

    smaller: str
    larger: str
    freed: tuple[str, ...]
    statistic: float
    probability: float
    uncorrected: float


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Results of the same data beside each other.

    Attributes
    ----------
    ranks : tuple of Rank
        The best first, by `Rank.corrected_aic`.
    tests : tuple of LikelihoodRatioTest
        Of all pairs of which one is known to contain the other.
    dependence : float
        c.
    samples : int
        n.
    with_priors : tuple of str
        Results with priors, whose log-likelihood is not the largest that their models can reach.
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
    """Results whose likelihoods cannot be compared.

    Attributes
    ----------
    reason : str
        Why, in a sentence.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"{reason}: compare on a common table (--data)")


def same_data(candidates: Sequence[ModelCandidate]) -> bool:
    """Return whether all results were made from the same measurements, whatever they call the outputs."""
    found = {tuple(sorted((s.unit, s.samples, s.digest) for s in each.result.data)) for each in candidates}
    return len(found) == 1 and () not in found


def compare_models(candidates: Sequence[ModelCandidate]) -> ModelComparison:
    """Compare results that were made from the same measurements; nothing is simulated.

    Raises
    ------
    InputError
        If there are fewer than two, two have one name, they were made from different measurements, or one has no
        likelihood.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> result = fmuid.identify(coil.problem())
    >>> held = fmuid.Problem(coil.fmu, coil.experiment, {"R": coil.parameters["R"]}, values={"L": 0.2})
    >>> candidates = [fmuid.ModelCandidate("R, L", result), fmuid.ModelCandidate("R", fmuid.identify(held))]
    >>> both = fmuid.compare_models(candidates)
    >>> [rank.name for rank in both.ranks]
    ['R, L', 'R']
    """
    check_kind(candidates, (list, tuple), "what is compared must be a list of fmuid.ModelCandidate(name, result)")
    for each in candidates:
        check_kind(each, ModelCandidate, "what is compared must be fmuid.ModelCandidate(name, result)")
    _check(candidates)
    best_fit = max(candidates, key=lambda each: each.result.log_likelihood)
    dependence = max(1.0, np.nan_to_num(best_fit.dependence, nan=1.0))
    samples = candidates[0].samples
    least = min(_corrected(each, dependence) for each in candidates)
    weights = [math.exp(-0.5 * (_corrected(each, dependence) - least)) for each in candidates]
    ranks = []
    for each, weight in zip(candidates, weights, strict=True):
        deviance, k = -2.0 * each.result.log_likelihood, each.count
        corrected = _corrected(each, dependence)
        ranks.append(
            Rank(
                each.name,
                k,
                each.result.log_likelihood,
                deviance + 2.0 * k,
                deviance + k * math.log(samples),
                corrected,
                deviance / dependence + k * math.log(samples / dependence),
                corrected - least,
                weight / sum(weights),
            )
        )
    tests = [_ratio(one, other, dependence) for one in candidates for other in candidates if _contains(other, one)]
    priors = tuple(each.name for each in candidates if each.has_prior)
    ranks.sort(key=lambda rank: rank.corrected_aic)
    return ModelComparison(tuple(ranks), tuple(tests), float(dependence), samples, priors)


def _corrected(candidate: ModelCandidate, dependence: float) -> float:
    return -2.0 * candidate.result.log_likelihood / dependence + 2.0 * candidate.count


def _check(candidates: Sequence[ModelCandidate]) -> None:
    if len(candidates) < 2:
        raise InputError("there is nothing to compare: give at least two results")
    names = [each.name for each in candidates]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two results are called {name}: give each once, and folders of different names")
    for each in candidates:
        if not each.result.data:
            raise IncomparableError(f"{each.name} does not say which measurements it was made from")
        if not math.isfinite(each.result.log_likelihood):
            raise IncomparableError(f"{each.name} has no likelihood, as with a robust loss")
    if not same_data(candidates):
        first = candidates[0]
        other = next(each for each in candidates if not same_data([first, each]))
        raise IncomparableError(
            f"{first.name} and {other.name} were made from different measurements, so that their likelihoods say "
            "nothing of each other"
        )


def _contains(larger: ModelCandidate, smaller: ModelCandidate) -> bool:
    """Return whether a model is known to be another with more of its parameters free, and both were fitted alike."""
    one, other = smaller.result, larger.result
    freed = set(other.names) - set(one.names)
    if not freed or not set(one.names) < set(other.names) or smaller.has_prior or larger.has_prior:
        return False
    models = [{c: (m["name"], m["digest"]) for c, m in each.models.items()} for each in (one, other)]
    if not models[0] or models[0] != models[1] or dict(one.given_variance) != dict(other.given_variance):
        return False
    if smaller.held is None or larger.held is None:
        return False
    variables = freed | {name.rpartition("[")[0] for name in freed}
    rest = {name: value for name, value in smaller.held.items() if name not in variables}
    return rest == dict(larger.held)


def _ratio(smaller: ModelCandidate, larger: ModelCandidate, dependence: float) -> LikelihoodRatioTest:
    one, other = smaller.result, larger.result
    freed = tuple(name for name in other.names if name not in one.names)
    twice = max(0.0, 2.0 * (other.log_likelihood - one.log_likelihood))
    return LikelihoodRatioTest(
        smaller.name,
        larger.name,
        freed,
        twice / dependence,
        float(special.chdtrc(len(freed), twice / dependence)),
        float(special.chdtrc(len(freed), twice)),
    )
