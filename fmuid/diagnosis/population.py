"""Healthy records as a population: what always is, what drifts, and what scatters between operating points.

Record k has coordinates x_k = μ + drift_k + b_k with μ ~ N(0, B²), drift ~ N(0, P²) and b ~ N(0, M). M is learned by EM
with an inverse Wishart prior: ν₀ records of the scatter M₀ (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39, 1977).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics


@dataclass(frozen=True)
class PopulationSettings:
    """Numbers of the population."""

    least: int = 4  # records from which their scatter is learned
    known: float = 3.0  # ν₀, records that the prior scatter counts for
    steps: int = 60  # of EM; ...
    few: int = 4  # ... and of EM without one record, begun at the result of all


SETTINGS = PopulationSettings()


@dataclass(frozen=True, eq=False)
class Scales:
    """Standard deviations of coordinates (N,)."""

    normal: Floats  # B, what always is
    drift: Floats  # P, what may change at any time
    scatter: Floats  # M₀, between operating points


@dataclass(frozen=True, eq=False)
class Population:
    """Healthy records together."""

    known: ChangePrior  # mean and covariance of a further record's coordinates, without drift
    scatter: Floats  # (N, N), M
    records: int
    temper: float = 1.0  # mean χ² per degree of freedom of a record against the others, at least 1

    @classmethod
    def of(cls, records: Sequence[InformationMatrix], scales: Scales) -> Population:
        """Return the population of records, at least one; of fewer than four without scatter."""
        if len(records) < SETTINGS.least:
            whole = sum(records[1:], start=records[0])
            none = np.zeros((scales.normal.size,) * 2)
            return cls(ChangePrior.after(whole, scales.normal), none, len(records))
        # from above, where EM is fast: all scatter of the records' own estimates
        means = np.array([ChangePrior.after(record, scales.normal).mean for record in records])
        return _learned(records, scales, np.diag(scales.scatter**2) + np.cov(means.T), SETTINGS.steps)

    def without_each(self, records: Sequence[InformationMatrix], scales: Scales) -> Iterator[ChangePrior]:
        """Yield the distribution of each record's coordinates by the others; of few records by all."""
        for k in range(len(records)):
            others = [*records[:k], *records[k + 1 :]]
            few = len(records) <= SETTINGS.least
            without = self if few else _learned(others, scales, self.scatter, SETTINGS.few)
            yield without.known.drifting(scales.drift)

    def judged(self, news: ScoreStatistics) -> ScoreStatistics:
        """Return statistics tempered, with the freedom of the scatter."""
        if not self.scatter.any():
            return news
        open_ = replace(news, excess=self.temper * self.scatter, freedom=self.records - 1.0)
        return open_.tempered(self.temper)


def _learned(records: Sequence[InformationMatrix], scales: Scales, scatter: Floats, steps: int) -> Population:
    """Return the population by EM, from a scatter on; in units of the prior's standard deviations."""
    unit = np.where(scales.scatter > 0, scales.scatter, scales.normal)
    unit = np.where(unit > 0, unit, 1.0)
    size, count, both = unit.size, len(records), np.outer(unit, unit)
    given = [(each.matrix * both, each.score * unit) for each in records]
    drift = np.diag((scales.drift / unit) ** 2)
    tight = np.diag((unit / np.maximum(scales.normal, 1e-12 * unit)) ** 2)
    first, learned = np.diag((scales.scatter / unit) ** 2), scatter / both
    for _ in range(steps):
        spread = drift + learned
        left = [np.linalg.inv(np.eye(size) + matrix @ spread) for matrix, _ in given]
        covariance = np.linalg.inv(tight + sum(a @ matrix for a, (matrix, _) in zip(left, given, strict=True)))
        covariance = 0.5 * (covariance + covariance.T)
        mean = covariance @ sum(a @ score for a, (_, score) in zip(left, given, strict=True))
        gain = learned @ np.linalg.pinv(spread)
        total = SETTINGS.known * first
        for (matrix, score), a in zip(given, left, strict=True):
            inside = spread @ a
            reach = inside @ matrix
            off = inside @ score - reach @ mean
            moment = np.outer(off, off) + inside + reach @ covariance @ reach.T
            total = total + learned - gain @ spread @ gain.T + gain @ moment @ gain.T
        learned = total / (SETTINGS.known + count)
        learned = 0.5 * (learned + learned.T)
    # the mode of an inverse Wishart is below the scatter that K records show
    learned = learned * (SETTINGS.known + count) / (count - 1.0)
    return Population(ChangePrior(mean * unit, (covariance + learned) * both), learned * both, count)


def tempered(population: Population, records: Sequence[InformationMatrix], others: Sequence[ChangePrior]) -> Population:
    """Return the population with the factor that records against the others show; of few as it is."""
    if len(records) <= SETTINGS.least:
        return population

    def each(news: ScoreStatistics) -> Floats:
        own = np.diag(news.information)
        return np.where(own > 0, news.score**2 / np.where(own > 0, own, 1.0), 1.0)

    factors = [each(ScoreStatistics.of(*both)) for both in zip(records, others, strict=True)]
    return replace(population, temper=max(1.0, float(np.mean(factors))))
