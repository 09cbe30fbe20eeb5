"""Test for changes: statistics of causes and their null distribution."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.information_matrix import ScoreStatistics


@dataclass(frozen=True)
class DetectionSettings:
    """Numbers of the tests."""

    overshoot: float = 0.583  # of a random walk: exp(−this · step) (Siegmund, "Sequential Analysis", 1985, p. 82)
    draws: int = 20_000  # of the smallest probability of all causes: a level of 1 % to a fourteenth of itself
    seed: int = 0  # of the draws
    counted: int = 100  # draws below which the bound m p is closer than the count


SETTINGS = DetectionSettings()


def log_chance(statistics: Floats, cause: Cause) -> Floats:
    """Return the log probability of statistics without the cause."""
    found = log_tail(statistics, len(cause.columns))
    return np.where(statistics > 0, found - (math.log(2.0) if cause.sign else 0.0), 0.0)


def log_tail(statistics: Floats, degrees: int) -> Floats:
    """Return the log probability of a larger χ², without underflow."""
    at = np.maximum(statistics, 0.0)
    if degrees == 1:
        return np.asarray(special.log_ndtr(-np.sqrt(at)) + math.log(2.0))
    if degrees == 2:
        return -at / 2.0
    with np.errstate(divide="ignore"):
        tail = np.log(special.chdtrc(degrees, at))
    half = degrees / 2.0
    far = -at / 2.0 + (half - 1.0) * np.log(np.maximum(at, 1.0) / 2.0) - special.gammaln(half)
    return np.where(np.isfinite(tail), tail, far)


def as_normal(statistics: Floats, freedom: Floats) -> Floats:
    """Return the χ² as rare as statistics with an F law.

    Exact for two coordinates (Wallace, 1959).
    """
    few = np.minimum(freedom, 1e9)
    return np.asarray(few * np.log1p(statistics / few))


def log_chances(statistics: Floats, causes: Sequence[Cause]) -> Floats:
    """Return `log_chance` of several causes: of statistics (T, m), one column a cause."""
    return np.column_stack([log_chance(own, cause) for own, cause in zip(statistics.T, causes, strict=True)])


def log_limit(level: float, causes: Sequence[Cause], windows: int) -> float:
    """Return the alarm limit of an onset's and cause's log probability.

    D of an onset is χ²_k. Over all onsets it first exceeds b² at a rate of b² f_k(b²) ∫ x ν²(x) dx per window, beside
    the newest onset. There x goes from b/√windows to b (Siegmund and Venkatraman for k = 1).
    """
    from scipy.optimize import brentq  # slow to import

    def rate(log_p: float) -> float:
        return sum(_rate(log_p, cause, windows) for cause in causes) - level

    low, high = math.log(level) - 60.0, math.log(level) + math.log(2.0)
    return float(brentq(rate, low, high, xtol=1e-6)) if rate(high) > 0 else high


def _rate(log_p: float, cause: Cause, windows: int) -> float:
    k = len(cause.columns)
    p = math.exp(log_p)
    one_sided = 0.5 if cause.sign else 1.0
    square = float(special.chdtri(k, min(1.0, p / one_sided)))
    b = math.sqrt(square)
    density = math.exp((k / 2 - 1) * math.log(square / 2) - square / 2 - special.gammaln(k / 2)) / 2 if square else 0.0
    x = np.array([b / math.sqrt(windows), b])
    # ∫ x exp(−2 · overshoot · x) dx
    a = 2.0 * SETTINGS.overshoot
    integral = -np.exp(-a * x) * (x / a + 1.0 / a**2)
    return p + one_sided * square * density * float(integral[1] - integral[0])


@dataclass(frozen=True, eq=False)
class CauseFit:
    """Sizes of causes that fit best."""

    statistic: float  # D = 2 (log-likelihood with them − without)
    sizes: Floats  # (k,) in the order of the causes' coordinates; zero where a sign keeps it there
    covariance: Floats  # (k, k), zero for a size kept at zero

    def moved(self, other: CauseFit) -> float:
        """Return the largest difference of sizes, in standard deviations."""
        std = np.sqrt(np.diag(self.covariance))
        return float(np.max(np.abs(self.sizes - other.sizes) / np.where(std > 0, std, math.inf)))


def fit(news: ScoreStatistics, causes: Sequence[Cause]) -> CauseFit:
    """Return the maximum-likelihood sizes of causes, each with its sign."""
    columns = [i for cause in causes for i in cause.columns]
    signs = np.array([cause.sign for cause in causes for _ in cause.columns])
    information, score = news.part(columns)
    signed = np.flatnonzero(signs)
    best = CauseFit(0.0, np.zeros(len(columns)), np.zeros((len(columns), len(columns))))
    # of a few causes all choices of what stays at zero are tried: the constrained optimum is one of them
    for count in range(signed.size + 1):
        for dropped in itertools.combinations(signed.tolist(), count):
            kept = [i for i in range(len(columns)) if i not in dropped]
            try:
                covariance = np.linalg.inv(information[kept][:, kept])
            except np.linalg.LinAlgError:  # these causes cannot be told apart; each by itself is tried too
                continue
            sizes = covariance @ score[kept]
            statistic = float(score[kept] @ sizes)
            if np.all(sizes * signs[kept] >= 0) and statistic > best.statistic:
                # sizes kept at zero have no covariance
                best = CauseFit(statistic, np.zeros_like(best.sizes), np.zeros_like(best.covariance))
                best.sizes[kept], best.covariance[np.ix_(kept, kept)] = sizes, covariance
        if best.statistic > 0 and count == 0:
            break  # the free optimum has the right signs
    return best


def probability(statistic: float, cause: Cause, news: ScoreStatistics) -> float:
    """Return the probability of a statistic without the cause."""
    return 1.0 if statistic <= 0 else news.tail(statistic, cause.columns) * (0.5 if cause.sign else 1.0)


@dataclass(frozen=True, eq=False)
class MinPDistribution:
    """Null distribution of the smallest probability (min-p, Westfall and Young)."""

    smallest: Floats  # (draws,), sorted
    causes: int

    @classmethod
    def of(cls, news: ScoreStatistics, causes: Sequence[Cause], draws: int = SETTINGS.draws) -> MinPDistribution:
        """Return the distribution for scores drawn from N(0, F)."""
        values, vectors = np.linalg.eigh(news.information)
        normal = np.random.default_rng(SETTINGS.seed).standard_normal((draws, values.size))
        scores = (normal * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        largest: dict[tuple[int, bool], Floats] = {}  # D, of causes with the same law
        for cause in causes:
            at = list(cause.columns)
            information, _ = news.part(at)
            mine = scores[:, at]
            statistic = np.einsum("di,ij,dj->d", mine, np.linalg.inv(information), mine)
            if cause.sign:
                statistic = np.where(mine[:, 0] * cause.sign > 0, statistic, -1.0)
            kind = (len(at), bool(cause.sign))
            largest[kind] = np.maximum(largest.get(kind, -1.0), statistic)
        found = np.ones(draws)
        for (degrees, signed), statistic in largest.items():
            tail = np.exp(log_tail(statistic, degrees)) / (2.0 if signed else 1.0)
            found = np.where(statistic > 0, np.minimum(found, tail), found)
        return cls(np.sort(found), len(causes))

    def limit(self, level: float) -> float:
        """Return the quantile of a level."""
        return float(np.quantile(self.smallest, level))

    def adjusted(self, smallest: float) -> float:
        """Return the probability of a smaller minimum by chance; below the draws' reach an upper bound."""
        below = int(np.searchsorted(self.smallest, smallest, side="right"))
        bound = min(1.0, self.causes * smallest)
        return min(bound, below / self.smallest.size) if below >= SETTINGS.counted else bound


def detectable(news: ScoreStatistics, cause: Cause, limit: float, miss: float) -> float:
    """Return the detectable size of a cause; `miss` is its missed-alarm rate, below one half."""
    information, _ = news.part(cause.columns)
    std = 1.0 / math.sqrt(float(np.linalg.eigvalsh(information)[0]))  # the direction that shows least
    if len(cause.columns) > 1:
        count, freedom = len(cause.columns), min(news.freedom_of(cause.columns), 1e7)
        threshold = count * float(special.fdtri(count, freedom, 1.0 - limit))
        return math.sqrt(float(special.chndtrinc(threshold, len(cause.columns), miss))) * std
    freedom = min(news.freedom_of(cause.columns), 1e7)
    return -float(special.stdtrit(freedom, limit if cause.sign else limit / 2.0) + special.stdtrit(freedom, miss)) * std
