"""Unexplained change: structure of the residual that no listed cause has, and that healthy records have less of.

Groups of columns: each output's regression on earlier inputs (lags in doubling spans, as a response fades), and healthy
parameters that vary with the size of a signal. Coefficients of healthy records are a `Population`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.information_matrix import LEAST, InformationMatrix, ScoreStatistics
from fmuid.diagnosis.population import SETTINGS as POPULATION
from fmuid.diagnosis.population import Population, Scales
from fmuid.identification import SAME_VARIANCE_RATIO


@dataclass(frozen=True)
class UnexplainedSettings:
    """Numbers of the tests."""

    level_share: float = 0.1  # of the level, spent on these tests
    spans: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32)  # lags of the inputs, samples; summed between
    structure_share: float = 0.2  # of the level, for structure beside healthy data
    smooth: int = 32  # samples over which the size of a signal is averaged
    nothing: float = 1e-8  # information of a direction, over the best, below which it is left out
    spanned: float = 1e-12  # singular value of the model's columns, over the largest, of no direction
    normal: float = 100.0  # of a group's effect in a sound machine, in standard deviations of the noise
    scatter: float = 0.1  # the same, between operating points, before any healthy record


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


def regression(residual: Floats, regressors: Floats, jacobian: Floats) -> InformationMatrix:
    """Return the regression of a whitened residual beside the Jacobian."""
    norms = np.linalg.norm(jacobian, axis=0)
    basis, values, _ = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1.0), full_matrices=False)
    spanned = basis[:, values > SETTINGS.spanned * values.max(initial=0.0)]
    left = regressors - spanned @ (spanned.T @ regressors)
    # of a regressor that the Jacobian spans, rounding and errors of differences are left
    own = np.sum(left**2, axis=0) > LEAST * np.sum(regressors**2, axis=0)
    return InformationMatrix.of(left * own, residual)


def signal_sizes(signals: Floats) -> Floats:
    """Return the smoothed sizes of signals (n, m)."""
    window = np.ones(SETTINGS.smooth) / SETTINGS.smooth
    padded = np.pad(np.abs(signals), ((SETTINGS.smooth - 1, 0), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(each, window, mode="valid") for each in padded.T], axis=1)
    return np.asarray(smooth)


@dataclass(frozen=True, eq=False)
class HealthyStructure:
    """Structure of healthy residuals."""

    groups: Mapping[str, tuple[int, ...]]  # columns by name
    records: Sequence[InformationMatrix]  # of each record, on the columns beside all coordinates
    samples: int  # of all records

    @cached_property
    def _compared(self) -> _Healthy:
        return _Healthy.of(self)

    def test(self, new: InformationMatrix, temper: float) -> UnexplainedResidual:
        """Test a new record's structure; evidence is divided by `temper` for the fault models' error."""
        healthy = self._compared
        each = healthy.statistics(ScoreStatistics.of(new, healthy.population.known))
        found = [(q / factor / temper, k) for (q, k), factor in zip(each, healthy.factors, strict=True)]
        chances = [float(special.chdtrc(k, q)) if k else 1.0 for q, k in found]
        best = int(np.argmin(chances))
        chance = healthy.surprise(min(1.0, chances[best] * max(1, sum(k > 0 for _, k in found))))
        return UnexplainedResidual(*found[best], chance, list(self.groups)[best])


@dataclass(frozen=True, eq=False)
class _Healthy:
    """The population of healthy structure, and its records against the others."""

    population: Population
    groups: Sequence[Sequence[int]]
    factors: Floats  # (groups,), mean χ² per degree, at least 1
    surprises: tuple[float, int]  # mean −log p of a healthy record, at least 1, and their number; 0 records: χ²

    @classmethod
    def of(cls, given: HealthyStructure) -> _Healthy:
        power = sum(np.diag(each.matrix) for each in given.records) / given.samples
        size = np.where(power > 0, 1.0 / np.sqrt(np.where(power > 0, power, 1.0)), 0.0)
        scales = Scales(SETTINGS.normal * size, 0.0 * size, SETTINGS.scatter * size)
        plain = cls(
            Population.of(given.records, scales), list(given.groups.values()), np.ones(len(given.groups)), (1.0, 0)
        )
        count = len(given.records)
        if count <= POPULATION.least:
            return plain
        others = plain.population.without_each(given.records, scales)
        news = map(ScoreStatistics.of, given.records, others)
        each = np.array([plain.statistics(one) for one in news])
        degrees = np.maximum(each[:, :, 1], 1.0)
        factors = np.maximum(1.0, np.mean(each[:, :, 0] / degrees, axis=0))
        chances = special.chdtrc(degrees, each[:, :, 0] / factors).min(axis=1) * each.shape[1]
        mean = max(1.0, float(np.mean(-np.log(np.clip(chances, 1e-300, 1.0)))))
        return cls(plain.population, plain.groups, factors, (mean, count))

    def statistics(self, news: ScoreStatistics) -> list[tuple[float, int]]:
        """Return χ² and degrees of freedom of each group: directions that the record determines."""
        found = []
        for group in self.groups:
            information, score = news.part(group)
            values, vectors = np.linalg.eigh(information)
            kept = values > SETTINGS.nothing * max(float(values[-1]), np.finfo(float).tiny)
            along = vectors[:, kept].T @ score
            found.append((float(np.sum(along**2 / values[kept])), int(np.count_nonzero(kept))))
        return found

    def surprise(self, chance: float) -> float:
        """Return a probability as of healthy records: Lomax of the mean −log p of K records."""
        mean, count = self.surprises
        if not count:
            return chance
        return float((1.0 - math.log(max(chance, 1e-300)) / mean / count) ** -count)


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
