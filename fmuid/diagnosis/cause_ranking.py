"""Odds of single causes and pairs; indistinguishable causes."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import CauseFit, MinPDistribution, fit, probability
from fmuid.diagnosis.information_matrix import ScoreStatistics
from fmuid.diagnosis.rule import MODEL_ERROR


@dataclass(frozen=True)
class RankingSettings:
    """Numbers of the ranking."""

    odds: float = 20.0  # of the best cause over those named beside it: strong evidence (Kass and Raftery, section 3.2)
    scales: tuple[float, ...] = (1.0, 3.0, 10.0)  # of changes, each rarer by itself
    excluded: float = 0.9  # share of records in which a rival must be excluded so
    own_share: float = 0.25  # of κ in a fault's size: 0.04 to 0.4 in experiments/machine_faults
    hopeless: float = 30.0  # statistic below the best pair's from which a pair cannot come within the odds
    same: float = 1e-9  # sin² of the angle of identical signatures


SETTINGS = RankingSettings()


@dataclass(frozen=True, eq=False)
class CauseSet:
    """One or two causes that explain a change."""

    causes: tuple[Cause, ...]
    odds: float  # against the best explanation
    fit: CauseFit  # each cause has the error of the other's model

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its causes."""
        return tuple(cause.name for cause in self.causes)

    @property
    def columns(self) -> list[int]:
        """Coordinates of its causes, in the order of the sizes."""
        return [i for cause in self.causes for i in cause.columns]


@dataclass(frozen=True, eq=False)
class CauseRanking:
    """Decision about a change, and its causes."""

    probability: float  # of the likeliest cause by chance, for all causes
    alarm: bool
    named: tuple[CauseSet, ...] = ()  # best first, then those not excluded; empty without an alarm
    temper: float = 1.0  # divisor of evidence after the alarm: 1 + κ² D of the strongest fault


def name(
    news: ScoreStatistics,
    causes: Sequence[Cause],
    level: float,
    *,
    chance: MinPDistribution | None = None,
    model_error: float = MODEL_ERROR,
    without: Container[tuple[str, ...]] = (),
) -> CauseRanking:
    """Decide about a change, and rank single causes and pairs, but some; κ is `model_error`.

    The null distribution `chance` is drawn where it is not given.
    """
    if not causes:
        return CauseRanking(1.0, False)
    chance = chance or MinPDistribution.of(news, causes)
    smallest = min(probability(fit(news, (cause,)).statistic, cause, news) for cause in causes)
    adjusted = chance.adjusted(smallest)
    if smallest > chance.limit(level):
        return CauseRanking(adjusted, False)
    temper, likely = rank_with_model_error(news, causes, level, model_error, without)
    return CauseRanking(adjusted, True, likely, temper)


def rank_with_model_error(
    news: ScoreStatistics,
    causes: Sequence[Cause],
    level: float,
    model_error: float,
    without: Container[tuple[str, ...]] = (),
) -> tuple[float, tuple[CauseSet, ...]]:
    """Return the divisor of the evidence, and the causes; arguments as for `name`."""
    alone = {cause: fit(news, (cause,)).statistic for cause in causes}
    temper = 1.0 + model_error**2 * max((d for cause, d in alone.items() if cause.modelled), default=0.0)
    sets = _pairs(news, causes, max(alone.values()), temper, level) or [(cause,) for cause in causes]
    sets = [each for each in sets if tuple(cause.name for cause in each) not in without]
    if not sets:
        return temper, ()
    evidence = news.tempered(temper)
    found = np.array([log_odds(evidence, each) for each in sets])
    variants, best = Counter(cause.name for cause in causes), found.max()
    groups: dict[tuple[str, ...], list[int]] = {}
    for i in np.argsort(-found, kind="stable").tolist():
        groups.setdefault(tuple(cause.name for cause in sets[i]), []).append(i)
    means = {names: math.prod(variants[name] for name in names) for names in groups}
    odds = {names: float(np.exp(found[each] - best).sum()) / means[names] for names, each in groups.items()}
    most = max(odds.values())
    ranked = sorted((names for names in groups if odds[names] * SETTINGS.odds > most), key=lambda names: -odds[names])
    named = []
    for names in ranked:
        fits = [estimate_sizes(news, sets[i], model_error) for i in groups[names]]
        named.append(CauseSet(sets[groups[names][0]], odds[names] / most, mixture(fits, found[groups[names]])))
    return temper, tuple(named)


def _pairs(
    news: ScoreStatistics, causes: Sequence[Cause], single: float, temper: float, level: float
) -> list[tuple[Cause, ...]]:
    """Return candidate pairs; none if a single cause explains as much."""
    pairs = [pair for pair in itertools.combinations(causes, 2) if pair[0].name != pair[1].name]
    if not pairs:
        return []
    gains = (_together(news, pairs) - single) / temper
    best = int(np.argmax(gains))
    more = max(len(cause.columns) for cause in pairs[best])
    if special.chdtrc(more, max(gains[best], 0.0)) * len(pairs) > level:
        return []
    return [pair for pair, gain in zip(pairs, gains, strict=True) if gain > gains[best] - SETTINGS.hopeless]


def _together(news: ScoreStatistics, pairs: Sequence[tuple[Cause, Cause]]) -> Floats:
    """Return D of pairs; of two single coordinates in closed form."""
    found = np.array([0.0 if len(a.columns + b.columns) == 2 else fit(news, (a, b)).statistic for a, b in pairs])
    plain = [k for k, (a, b) in enumerate(pairs) if len(a.columns + b.columns) == 2]
    i, j = np.array([[cause.columns[0] for cause in pairs[k]] for k in plain], dtype=int).reshape(-1, 2).T
    signs = np.array([[cause.sign for cause in pairs[k]] for k in plain], dtype=int).reshape(-1, 2).T
    own, score = np.diag(news.information), news.score
    mixed, scores = news.information[i, j], np.array([score[i], score[j]])
    sizes = np.array([own[j] * score[i] - mixed * score[j], own[i] * score[j] - mixed * score[i]])
    determinant = own[i] * own[j] - mixed**2
    apart = determinant > SETTINGS.same * own[i] * own[j]
    sizes /= np.where(apart, determinant, 1.0)
    alone = np.where(signs * scores >= 0, scores**2 / np.array([own[i], own[j]]), 0.0).max(axis=0)
    # where a sign is wrong, that size is zero and the other cause is alone
    found[plain] = np.where(apart & (signs * sizes >= 0).all(axis=0), (scores * sizes).sum(axis=0), alone)
    return found


def estimate_sizes(news: ScoreStatistics, causes: Sequence[Cause], model_error: float) -> CauseFit:
    """Return the sizes of one or two causes, with the models' error.

    Along another's orthogonal part a model has the error κ √D, which the other size takes for its own. The own size is
    wrong by a share of κ.
    """
    found = fit(news, causes)
    first = np.arange(len(found.sizes)) < len(causes[0].columns)
    information, _ = news.part([i for cause in causes for i in cause.columns])
    shift, wrong = np.zeros_like(information), np.zeros_like(information)
    for cause, own in zip(causes, (first, ~first), strict=False):
        if not cause.modelled:
            continue
        sizes = np.where(own, found.sizes, 0.0)
        wrong += (SETTINGS.own_share * model_error) ** 2 * np.outer(sizes, sizes)
        beside = ~own  # empty where a cause is alone
        mixed = information[np.ix_(beside, own)] @ np.linalg.solve(
            information[np.ix_(own, own)], information[np.ix_(own, beside)]
        )
        shift[np.ix_(beside, beside)] += (
            model_error**2 * float(sizes @ information @ sizes) * (information[np.ix_(beside, beside)] - mixed)
        )
    return replace(found, covariance=found.covariance + found.covariance @ shift @ found.covariance + wrong)


def mixture(fits: Sequence[CauseFit], log_weights: Floats) -> CauseFit:
    """Return mean and covariance of the variants' sizes; the statistic is the first one's."""
    weights = special.softmax(log_weights)
    sizes = np.array([each.sizes for each in fits])
    mean = weights @ sizes
    spread = np.einsum("k,ki,kj->ij", weights, sizes - mean, sizes - mean)
    within = np.einsum("k,kij->ij", weights, np.array([each.covariance for each in fits]))
    return CauseFit(fits[0].statistic, mean, within + spread)


def log_odds(news: ScoreStatistics, causes: Sequence[Cause]) -> float:
    """Return the log odds of some causes against no change."""
    return log_bayes_factor(news, causes) + sum(math.log(cause.probability) for cause in causes)


def log_bayes_factor(news: ScoreStatistics, causes: Sequence[Cause]) -> float:
    """Return the log Bayes factor of some causes against no change.

    Changes may be far larger than usual: their slab is a mixture of scales.
    """
    if not any(cause.heavy for cause in causes):
        return _log_bayes_factor(news, causes)
    scales = np.array(SETTINGS.scales)
    scaled = ([replace(c, size=scale * c.size) if c.heavy else c for c in causes] for scale in SETTINGS.scales)
    found = np.array([_log_bayes_factor(news, each) for each in scaled])
    return float(special.logsumexp(found, b=scales**-1.0 / np.sum(scales**-1.0)))


def _log_bayes_factor(news: ScoreStatistics, causes: Sequence[Cause]) -> float:
    """Return the log Bayes factor of sizes N(0, τ²) with known signs.

    It is ½ hᵀ(F + τ⁻²)⁻¹h − ½ ln|I + τFτ|.
    """
    columns = [i for cause in causes for i in cause.columns]
    slab = np.array([cause.size for cause in causes for _ in cause.columns])
    information, score = news.part(columns)
    precision = slab[:, None] * information * slab + np.eye(slab.size)
    covariance = np.linalg.inv(precision)
    mean = covariance @ (slab * score)
    found = 0.5 * float(slab * score @ mean) - 0.5 * float(np.linalg.slogdet(precision)[1])
    signs = np.array([cause.sign for cause in causes for _ in cause.columns])
    signed = np.flatnonzero(signs)
    std = np.sqrt(np.diag(covariance))[signed]
    own = (mean * signs)[signed] / std
    if signed.size > 1:
        from scipy.stats import multivariate_normal  # slow to import

        part = covariance[np.ix_(signed, signed)] * np.outer(signs[signed], signs[signed])
        both = float(multivariate_normal.cdf(own, cov=part / np.outer(std, std)))
        if both > 0.0:
            return found + signed.size * math.log(2.0) + math.log(both)
    return found + signed.size * math.log(2.0) + float(special.log_ndtr(own).sum())


def angle(news: ScoreStatistics, one: Cause, other: Cause) -> float:
    """Return the smallest angle between two signatures, rad."""
    roots = [np.linalg.cholesky(news.part(cause.columns)[0]) for cause in (one, other)]
    between = news.information[np.ix_(list(one.columns), list(other.columns))]
    cosines = np.linalg.solve(roots[0], np.linalg.solve(roots[1], between.T).T)
    return float(math.acos(min(1.0, float(np.linalg.svd(cosines, compute_uv=False)[0]))))


def nearest_cause(news: ScoreStatistics, cause: Cause, others: Sequence[Cause]) -> tuple[str, float]:
    """Return name and angle, rad, of the cause with the nearest signature; "" and NaN without others."""
    angles = {other.name: angle(news, cause, other) for other in others if other.name != cause.name}
    return min(angles.items(), key=lambda each: each[1], default=("", math.nan))


def distinguishable_size(news: ScoreStatistics, one: Cause, other: Cause, model_error: float = MODEL_ERROR) -> float:
    """Return the size that excludes the other cause in 90 % of records; infinite if none.

    From ½ D sin²φ − z √D sin φ > ln 20 (1 + κ² D), with z the 90 % point of the normal distribution.
    """
    sine = math.sin(angle(news, one, other))
    z, strong = float(special.ndtri(SETTINGS.excluded)), math.log(SETTINGS.odds)
    room = 0.5 * sine**2 - strong * model_error**2
    if room <= 0.0:
        return math.inf
    root = (z * sine + math.sqrt((z * sine) ** 2 + 4.0 * room * strong)) / (2.0 * room)
    information, _ = news.part(one.columns)
    return root / math.sqrt(float(np.linalg.eigvalsh(information)[0]))
