"""Noise of a record beside that of healthy records, by output.

The log of a residual's variance over the healthy noise has a normal distribution between healthy records. Its variance
is learned as that of coordinates is: some records of a prior scatter, then t (docs/method/diagnosis.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.information_matrix import Whitening
from fmuid.diagnosis.population import SETTINGS as POPULATION
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import VarianceRatio
from fmuid.estimation import FitProjection, whiteness


@dataclass(frozen=True, eq=False)
class NoiseRatios:
    """Variances of whitened residuals, by record and output."""

    ratios: Floats  # (K, n_outputs), 1 of the noise model
    samples: Floats  # (K, n_outputs), independent ones

    @classmethod
    def of(cls, white: Mapping[str, Floats], whitening: Whitening) -> NoiseRatios:
        """Return the ratios of one record's whitened residual, by output (n,)."""
        # an output without samples has variance 1, of one sample: no change
        found = {output: white.get(output, np.ones(1)) for output in whitening.models}
        samples = [noise.share * len(found[output]) for output, noise in whitening.models.items()]
        return cls(np.array([[np.mean(each**2) for each in found.values()]]), np.array([samples]))

    @property
    def pooled(self) -> NoiseRatios:
        """Levels of all outputs together, weighted by their samples."""
        samples = self.samples.sum(axis=1, keepdims=True)
        return NoiseRatios((self.samples * self.ratios).sum(axis=1, keepdims=True) / samples, samples)

    def compared(self, new: NoiseRatios, temper: float = 1.0) -> list[NoiseChange]:
        """Compare one record with the healthy ones, by output; `temper` is the allowance for the models' error."""
        (ratios,), (samples,), least = new.ratios, new.samples, np.finfo(float).tiny
        logs, own, count = np.log(np.maximum(self.ratios, least)), np.mean(2.0 / self.samples, axis=0), len(self.ratios)
        mean, freedom = np.mean(logs, axis=0), POPULATION.known + count - 1.0
        squares = POPULATION.known * (UNEXPLAINED_RESIDUAL.scatter**2 + own) + np.sum((logs - mean) ** 2, axis=0)
        variance = (1.0 + 1.0 / count) * squares / freedom + np.maximum(2.0 / samples - own, 0.0)
        found = np.log(np.maximum(ratios, least)) - mean
        over = found - math.log(temper)
        chances = special.stdtr(freedom, -over / np.sqrt(variance))
        statistics = samples * (np.expm1(over) - over)
        each = zip(np.exp(found), chances, np.sqrt(variance), np.where(over > 0, statistics, 0.0), strict=True)
        return [NoiseChange(*map(float, numbers)) for numbers in each]


@dataclass(frozen=True)
class NoiseChange(VarianceRatio):
    """Variance of an output's noise over that of healthy records."""

    log_std: float  # of the ratio's logarithm
    statistic: float  # twice the log-likelihood ratio

    @property
    def size(self) -> tuple[float, float]:
        """Change of the standard deviation as a share, and its own."""
        root = math.sqrt(self.ratio)
        return root - 1.0, 0.5 * root * self.log_std


def is_white(residual: Floats, level: float) -> bool:
    """Return whether a whitened residual (n,) is white."""
    return whiteness(residual, FitProjection.nothing(len(residual))).probability >= level
