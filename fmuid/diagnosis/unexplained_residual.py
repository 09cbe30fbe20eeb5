"""Unexplained change: structure of the residual that no listed cause has, and that healthy records have less of.

Groups of columns: each output of the model by earlier inputs (lags in doubling spans, as a response fades), and
each healthy parameter by the inputs and outputs: by their sizes, or by their slow levels such as that of a flux.
Coefficients of healthy records are a `Population`, beside coordinates that are known as those of a new record are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.information_matrix import LEAST, ChangePrior, InformationMatrix, ScoreStatistics
from fmuid.diagnosis.population import SETTINGS as POPULATION
from fmuid.diagnosis.population import Population, Scales
from fmuid.identification import SAME_VARIANCE_RATIO


@dataclass(frozen=True)
class UnexplainedSettings:
    """Numbers of the tests."""

    level_share: float = 0.1  # of the level, spent on these tests
    spans: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32)  # lags of the inputs, samples; summed between
    structure_share: float = 0.2  # of the level, for structure beside healthy data
    smooth: int = 32  # samples, time constant of a signal's size ...
    slow: int = 8  # ... and parts of a record, one of which is that of its level
    nothing: float = 1e-8  # information of a direction, over the best, below which it is left out
    normal: float = 1e3  # of a group's directions in a sound machine, in standard deviations of a record's estimate
    scatter: float = 0.1  # the same, between operating points, before any healthy record; of noise a share


SETTINGS = UnexplainedSettings()


@dataclass(frozen=True)
class UnexplainedResidual:
    """Change without a listed cause."""

    statistic: float  # χ² of the clearest group
    degrees: int
    probability: float  # by chance, for all groups
    group: str = ""


NOTHING_LEFT = UnexplainedResidual(0.0, 0, 1.0)


def lagged(inputs: Floats, spans: Sequence[int] = SETTINGS.spans) -> Floats:
    """Return a constant and inputs (n, m) summed over spans of lags: (n, 1 + (len(spans) − 1) m)."""
    sums = np.vstack([np.zeros((1, inputs.shape[1])), np.cumsum(inputs, axis=0)])
    ends = 1 + np.arange(len(inputs))
    until = [sums[np.maximum(ends - lag, 0)] for lag in spans]
    return np.hstack([np.ones((len(inputs), 1)), *(a - b for a, b in itertools.pairwise(until))])


def levels(signals: Floats) -> tuple[Floats, Floats]:
    """Return sizes and squared slow levels of signals (n, m)."""
    slow = _smoothed(signals, max(1.0, len(signals) / SETTINGS.slow))
    return _smoothed(np.abs(signals), SETTINGS.smooth), slow**2


def _smoothed(signals: Floats, samples: float) -> Floats:
    """Return first-order lags of signals (n, m), from their first values on."""
    from scipy.signal import lfilter  # slow to import

    gain = 1.0 / samples
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], signals, axis=0, zi=(1.0 - gain) * signals[:1])[0])


def beside(whole: InformationMatrix, known: ChangePrior) -> InformationMatrix:
    """Return the information on columns that follow N known coordinates."""
    first, more = known.mean.size, (0, whole.score.size - known.mean.size)
    news = ScoreStatistics.of(whole, ChangePrior(np.pad(known.mean, more), np.pad(known.covariance, more)))
    # of a column that coordinates span, rounding and errors of differences are left
    own = (np.diag(news.information) > LEAST * np.diag(whole.matrix))[first:]
    return InformationMatrix(news.information[first:, first:] * np.outer(own, own), news.score[first:] * own)


@dataclass(frozen=True, eq=False)
class HealthyStructure:
    """Sums of healthy records on coordinates, then on groups' columns."""

    groups: Mapping[str, tuple[int, ...]]  # columns by name, after the coordinates
    records: Sequence[InformationMatrix]
    samples: int  # of all records

    def among(self, at: Sequence[int]) -> HealthyStructure:
        """Return the sums of some coordinates, in their order."""
        count = sum(map(len, self.groups.values()))
        records = [one.among([*at, *range(one.score.size - count, one.score.size)]) for one in self.records]
        return replace(self, records=records)


@dataclass(frozen=True, eq=False)
class StructureStatistics:
    """Populations of healthy structure, by group, and their records against the others."""

    groups: Mapping[str, tuple[int, ...]]
    bases: Sequence[Floats]  # (columns, n) directions of a group, in standard deviations of a record's estimate
    populations: Sequence[Population]  # along them
    factors: Floats  # (groups,), mean χ² per degree, at least 1
    surprises: tuple[float, int]  # mean −log p of a healthy record, at least 1, and their number; 0 records: χ²

    @classmethod
    def of(cls, given: HealthyStructure, known: Sequence[ChangePrior]) -> StructureStatistics:
        """Return the statistics of records, with the coordinates known of each."""
        records = [beside(*each) for each in zip(given.records, known, strict=True)]
        mean = np.mean([one.matrix for one in records], axis=0)
        bases, populations, found = list[Floats](), list[Population](), list[list[tuple[float, int]]]()
        for group in given.groups.values():
            bases.append(_directions(mean, group))
            own, unit = [one.along(bases[-1]) for one in records], np.ones(bases[-1].shape[1])
            scales = Scales(SETTINGS.normal * unit, 0.0 * unit, SETTINGS.scatter * unit)
            populations.append(Population.of(own, scales))
            others = populations[-1].without_each(own, scales)
            found.append([_statistic(ScoreStatistics.of(*each)) for each in zip(own, others, strict=True)])
        plain, count = cls(given.groups, bases, populations, np.ones(len(bases)), (1.0, 0)), len(records)
        if count <= POPULATION.least:
            return plain
        chi2, degrees = np.moveaxis(np.array(found), 2, 0)
        degrees = np.maximum(degrees, 1.0)
        factors = np.maximum(1.0, np.mean(chi2 / degrees, axis=1))
        chances = special.chdtrc(degrees, chi2 / factors[:, None]).min(axis=0) * len(factors)
        mean = max(1.0, float(np.mean(-np.log(np.clip(chances, 1e-300, 1.0)))))
        return replace(plain, factors=factors, surprises=(mean, count))

    def test(self, new: InformationMatrix, known: ChangePrior, temper: float) -> UnexplainedResidual:
        """Test a new record's structure; evidence is divided by `temper` for the fault models' error."""
        left, found = beside(new, known), list[tuple[float, int]]()
        for basis, population, factor in zip(self.bases, self.populations, self.factors, strict=True):
            statistic, degrees = _statistic(ScoreStatistics.of(left.along(basis), population.known))
            found.append((statistic / factor / temper, degrees))
        chances = [float(special.chdtrc(k, q)) if k else 1.0 for q, k in found]
        best = int(np.argmin(chances))
        chance = self.surprise(min(1.0, chances[best] * max(1, sum(k > 0 for _, k in found))))
        return UnexplainedResidual(*found[best], chance, list(self.groups)[best])

    def surprise(self, chance: float) -> float:
        """Return a probability as of healthy records: Lomax of the mean −log p of K records."""
        mean, count = self.surprises
        if not count:
            return chance
        return float((1.0 - math.log(max(chance, 1e-300)) / mean / count) ** -count)


def _directions(information: Floats, group: Sequence[int]) -> Floats:
    """Return directions (columns, n) of a group with information 1."""
    own = np.sqrt(np.diag(information)[list(group)])
    scale = np.where(own > 0, 1.0 / np.where(own > 0, own, 1.0), 0.0)
    values, vectors = np.linalg.eigh(information[np.ix_(group, group)] * np.outer(scale, scale))
    kept = values > SETTINGS.nothing * max(float(values[-1]), np.finfo(float).tiny)
    basis = np.zeros((len(information), np.count_nonzero(kept)))
    basis[list(group)] = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return basis


def _statistic(news: ScoreStatistics) -> tuple[float, int]:
    """Return χ² and degrees of freedom: directions that the record determines."""
    if not news.score.size:
        return 0.0, 0
    values, vectors = np.linalg.eigh(news.information)
    kept = values > SETTINGS.nothing * max(float(values[-1]), np.finfo(float).tiny)
    along = vectors[:, kept].T @ news.score
    return float(np.sum(along**2 / values[kept])), int(np.count_nonzero(kept))


@dataclass(frozen=True)
class VarianceRatio:
    """Variance of the residual over that of the healthy noise."""

    ratio: float
    probability: float  # by noise alone

    @classmethod
    def of(cls, ratio: float, samples: float, freedom: float) -> VarianceRatio:
        """Test a ratio over independent samples: χ², or F if the noise was estimated with `freedom`."""
        exact = math.isinf(freedom)
        return cls(
            ratio, float(special.chdtrc(samples, samples * ratio) if exact else special.fdtrc(samples, freedom, ratio))
        )

    def is_larger(self, level: float) -> bool:
        """Return whether the variance is larger."""
        return self.ratio > SAME_VARIANCE_RATIO and self.probability < level
