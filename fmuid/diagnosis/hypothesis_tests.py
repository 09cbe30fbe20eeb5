"""Whether a fault is there: the reference distributions of likelihood ratios, and the choice between hypotheses.

Between a healthy machine and one with a fault the compound criterion (1.68) falls by D = J_C(no fault) − J_C(fault).
Without a fault D is distributed as

- χ²_k, where the k fault parameters may take either sign;
- a mixture of χ²_0 to χ²_k, where k of them cannot be negative (a ratio of turns): their estimate is then the
  projection of a normal vector onto the positive orthant, and the weights are the probabilities that so many of its
  components come out positive. One parameter: half χ²_0, half χ²_1 (Self and Liang, cases 5 to 7; Shapiro);
- χ²_2, where a size goes with an angle: size and angle are a vector of the plane whose direction nobody knows. Where
  part of the effect does not turn with the angle, that is an upper limit.

Where the variance of the noise was itself estimated, from ν degrees of freedom, F(j, ν) takes the place of χ²_j/j.

References
----------
S. G. Self, K.-Y. Liang, "Asymptotic properties of maximum likelihood estimators and likelihood ratio tests under
nonstandard conditions", J. Am. Stat. Assoc. 82, 1987; A. Shapiro, "Towards a unified theory of inequality constrained
testing in multivariate analysis", Int. Stat. Review 56, 1988; R. E. Kass,
A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90, 1995.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation import check_level

# Of calling a fault where there is none, unless said otherwise: one check in a hundred, the habit of the field.
FALSE_ALARM_LEVEL = 0.01
# The residual may be larger than the noise for other reasons than the causes that are looked for: this share of the
# level is spent on it, so that the level as a whole is met.
UNEXPLAINED_SHARE = 0.1
# Hypotheses whose information criteria differ by less are not told apart: beyond it the evidence is strong (Kass and
# Raftery, section 3.2: 6 is a ratio of 20 : 1).
STRONG_EVIDENCE = 6.0
# The weights of more than three constrained parameters are counted over so many random draws: to 0.004 at most.
WEIGHT_DRAWS, WEIGHT_SEED = 20_000, 0


@dataclass(frozen=True)
class NullDistribution:
    """The distribution of D where there is no fault.

    Attributes
    ----------
    free : int
        Fault parameters that may take either sign; a size with its angle counts two.
    weights : tuple of float
        The probabilities that 0, 1, ... of the constrained parameters leave their bound; (1,) without any.
    freedom : float
        Degrees of freedom of the noise variance, infinite where it is known.
    """

    free: int
    weights: tuple[float, ...] = (1.0,)
    freedom: float = math.inf

    def probability(self, statistic: float) -> float:
        """Return the probability that D is as large as `statistic` or larger."""
        if not statistic > 0:
            return 1.0
        return float(sum(w * self._tail(self.free + j, statistic) for j, w in enumerate(self.weights)))

    def _tail(self, degrees: int, statistic: float) -> float:
        if degrees == 0:
            return 0.0
        if math.isinf(self.freedom):
            return float(special.chdtrc(degrees, statistic))
        return float(special.fdtrc(degrees, self.freedom, statistic / degrees))

    def threshold(self, level: float) -> float:
        """Return what D exceeds with probability `level`; 0 where it is positive more rarely than that.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level, "a test")
        if self.probability(np.nextafter(0.0, 1.0)) <= level:
            return 0.0
        top = 1.0
        while self.probability(top) > level:
            top *= 2.0
        from scipy.optimize import brentq  # slow to import

        return float(brentq(lambda d: self.probability(d) - level if d > 0 else 1.0 - level, 0.0, top))


def orthant_weights(covariance: Floats) -> tuple[float, ...]:
    """Return the probabilities that 0 to k components of a constrained estimate are positive, its truth being zero.

    Parameters
    ----------
    covariance : (k, k) array
        Of the estimates without constraint. k = 1, 2, 3 in closed form (Shapiro), more by seeded draws.

    Raises
    ------
    InputError
        If the covariance is not positive definite.
    """
    k = len(covariance)
    if k == 0:
        return (1.0,)
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    try:
        factor = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        raise InputError("the covariance of the constrained parameters is not positive definite") from None
    if k == 1:
        return (0.5, 0.5)
    if k > 3:
        return _drawn_weights(factor)
    inverse = np.linalg.inv(correlation)
    # all positive: the estimate lies in the orthant; none: in the cone polar to it, an orthant of the dual variables
    every, none = _orthant(correlation), _orthant(inverse)
    return (none, 0.5, every) if k == 2 else (none, 0.5 - every, 0.5 - none, every)


def _orthant(covariance: Floats) -> float:
    """Return the probability that two or three normal variables are all positive (Sheppard)."""
    std = np.sqrt(np.diag(covariance))
    upper = np.triu_indices(len(covariance), 1)
    angles = float(np.arcsin(np.clip((covariance / np.outer(std, std))[upper], -1.0, 1.0)).sum())
    return 0.25 + angles / (2.0 * math.pi) if len(covariance) == 2 else 0.125 + angles / (4.0 * math.pi)


def _drawn_weights(factor: Floats) -> tuple[float, ...]:
    """Return how often so many components are positive, by projecting random draws: least squares that keep signs."""
    from scipy.optimize import nnls  # slow to import

    k, rng = len(factor), np.random.default_rng(WEIGHT_SEED)
    inverse = np.linalg.inv(factor)
    counts = [int((nnls(inverse, z)[0] > 0).sum()) for z in rng.standard_normal((WEIGHT_DRAWS, k))]
    return tuple((np.bincount(counts, minlength=k + 1) / WEIGHT_DRAWS).tolist())


def at_least_one(probabilities: Sequence[float]) -> tuple[float, ...]:
    """Return probabilities adjusted for the number of hypotheses (Bonferroni): m p, at most 1.

    With them the level is that of any alarm at all: as only the most likely fault is named, step-down methods (Holm)
    alarm in exactly the same cases.
    """
    return tuple(min(1.0, len(probabilities) * each) for each in probabilities)


def rivals(information: Sequence[float]) -> tuple[int, ...]:
    """Return the hypotheses that the data do not tell apart from the best one, the best first.

    Parameters
    ----------
    information : sequence of float
        Bayesian information criterion of each, k ln n − D: less is better.
    """
    order = sorted(range(len(information)), key=lambda i: information[i])
    return tuple(i for i in order if information[i] - information[order[0]] < STRONG_EVIDENCE)
