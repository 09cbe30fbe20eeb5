"""Tests of a series: autocorrelation, whiteness, normality, cross-correlation (docs/method/residuals.md).

References: Ljung and Box, Biometrika 65 (2), 1978; Stoffer and Toloi, Statistics & Probability Letters 13 (5), 1992;
Bartlett, Suppl. J. R. Stat. Soc. 8 (1), 1946; Brockwell and Davis, "Time Series", 1991, sections 5.2 and 11.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from fmuid.array_types import Flags, Floats, Indices
from fmuid.estimation.noise.model import NoiseModel


@dataclass(frozen=True)
class WhitenessSettings:
    """Numbers of the tests."""

    tested_lags: int = 25  # lags of the whiteness test, as usual, ...
    lags_divisor: int = 5  # ... but at most the samples divided by this
    shown_lags: int = 40  # lags kept for figures
    short_record: int = 500  # samples up to which the statistic is drawn, not asymptotic ...
    clear_probabilities: tuple[float, float] = (1e-9, 0.15)  # ... except outside of these probabilities
    draws: int = 600  # give mean and variance of the statistic to some percent
    seed: int = 0  # same record, same probability


SETTINGS = WhitenessSettings()


def autocorrelation(grid: Floats, lags: int) -> tuple[Floats, Floats]:
    """Return autocorrelations at lags 0 to `lags`, and their pairs; NaN without pairs."""
    there = np.isfinite(grid)
    centred = np.where(there, grid - np.nanmean(grid), 0.0)
    # by transforms: long memories need thousands of lags
    length = fft.next_fast_len(len(grid) + lags, real=True)
    both = np.stack([centred, there.astype(np.float64)])
    sums, pairs = fft.irfft(np.abs(fft.rfft(both, length)) ** 2, length)[:, : lags + 1]
    pairs = np.rint(pairs)
    with np.errstate(invalid="ignore"):
        return np.where(pairs > 0, sums / np.maximum(pairs, 1.0), np.nan) / (sums[0] / pairs[0]), pairs


def ljung_box(correlations: Floats, pairs: Floats) -> tuple[float, float]:
    """Return Ljung and Box's statistic, and its probability under white noise."""
    count = pairs[0]
    known = pairs[1:] > 0
    statistic = float((count + 2.0) / count * np.sum(pairs[1:][known] * correlations[1:][known] ** 2))
    return statistic, float(special.chdtrc(int(known.sum()), statistic))


@dataclass(frozen=True, eq=False)
class FitProjection:
    """Fitted part of one output's noise e: C_a Σ_b C_bᵀ e_b over all outputs."""

    columns: Floats  # (n, k), C_a = J_a R, R Rᵀ the covariance for white noise
    gram: Floats  # (k, k), Σ_b C_bᵀ C_b

    @classmethod
    def nothing(cls, count: int) -> FitProjection:
        """Return the projection of an unfitted residual."""
        return cls(np.zeros((count, 0)), np.zeros((0, 0)))

    def of(self, rows: Indices) -> FitProjection:
        """Return the projection of some rows."""
        return FitProjection(self.columns[rows], self.gram)

    def draws(self, random: np.random.Generator, count: int) -> Floats:
        """Return residuals of white noise (count, n)."""
        noise = random.standard_normal((count, len(self.columns)))
        values, vectors = np.linalg.eigh(self.gram - self.columns.T @ self.columns)
        others = random.standard_normal((count, values.size)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(noise - (noise @ self.columns + others) @ self.columns.T, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class WhitenessTest:
    """Ljung and Box's test of a series.

    Attributes
    ----------
    lags : int
        Number of tested lags.
    statistic : float
    probability : float
        Probability of a larger statistic under white noise.
    autocorrelation : (m,) array
        From lag 0 on; NaN without pairs.
    band : float
        Half-width of the 95 % band under white noise.
    """

    lags: int
    statistic: float
    probability: float
    autocorrelation: Floats
    band: float

    @property
    def strongest(self) -> tuple[int, float]:
        """Tested lag, in samples, of the largest autocorrelation, and its value."""
        tested = np.nan_to_num(self.autocorrelation[: self.lags + 1])
        lag = 1 + int(np.argmax(np.abs(tested[1:])))
        return lag, float(tested[lag])


def whiteness(grid: Floats, taken: FitProjection) -> WhitenessTest:
    """Test a residual on a grid (m,) for whiteness; missing samples are NaN.

    χ² in long records, else a scaled χ² with mean and variance from seeded draws (Satterthwaite).
    """
    there = np.isfinite(grid)
    count, most = int(there.sum()), len(grid) - 1
    lags = min(SETTINGS.tested_lags, count // SETTINGS.lags_divisor, most)
    shown, known = autocorrelation(grid, min(SETTINGS.shown_lags, most))
    pairs = known[: lags + 1]
    statistic, probability = ljung_box(shown[: lags + 1], pairs)
    certain, possible = SETTINGS.clear_probabilities
    if count <= SETTINGS.short_record and certain < probability < possible:
        drawn = _statistics(taken.draws(np.random.default_rng(SETTINGS.seed), SETTINGS.draws), pairs, there)
        mean, variance = float(drawn.mean()), float(drawn.var())
        probability = float(special.chdtrc(2.0 * mean**2 / variance, 2.0 * mean * statistic / variance))
    return WhitenessTest(lags, statistic, probability, shown, 1.96 / math.sqrt(count))


def _statistics(residuals: Floats, pairs: Floats, there: Flags) -> Floats:
    """Return the statistic (m,) of residuals (m, n)."""
    grid = np.zeros((len(residuals), there.size))
    grid[:, there] = residuals - residuals.mean(axis=1, keepdims=True)
    size = fft.next_fast_len(there.size + pairs.size, real=True)
    sums = fft.irfft(np.abs(fft.rfft(grid, size)) ** 2, size)[:, : pairs.size]
    known = np.flatnonzero(pairs[1:] > 0) + 1
    found = sums[:, known] / sums[:, :1] * pairs[0] / pairs[known]
    return np.asarray((pairs[0] + 2.0) / pairs[0] * (found**2 @ pairs[known]), dtype=np.float64)


@dataclass(frozen=True)
class NormalityTest:
    """Skewness and kurtosis against normal noise (Jarque and Bera).

    Attributes
    ----------
    skewness, kurtosis : float
        0 for normal noise.
    probability : float
        Probability of larger values under normal noise of this color.
    """

    skewness: float
    kurtosis: float
    probability: float


def normality(values: Floats, noise: NoiseModel) -> NormalityTest:
    """Test samples (n,), not constant, for a normal distribution."""
    centred = values - values.mean()
    spread = math.sqrt(float(np.mean(centred**2)))
    skewness = float(np.mean((centred / spread) ** 3))
    kurtosis = float(np.mean((centred / spread) ** 4)) - 3.0
    third, fourth = (values.size / noise.variance_factor(power) for power in (3, 4))
    statistic = third * skewness**2 / 6.0 + fourth * kurtosis**2 / 24.0
    return NormalityTest(skewness, kurtosis, float(special.chdtrc(2, statistic)))


@dataclass(frozen=True, eq=False)
class CrossCorrelation:
    """Correlation of two series over several lags."""

    values: Floats  # (lags + 1,), NaN if unknown
    std: float  # of each value for unrelated series
    strongest: int  # lag of the largest magnitude
    probability: float  # of such a magnitude by chance at any lag


class LaggedSeries:
    """A series on its grid (g,), to correlate others with.

    `lagged` (n, lags + 1) has its values at each sample's time minus each lag, NaN before the beginning.
    """

    def __init__(self, lagged: Floats, grid: Floats) -> None:
        there = np.isfinite(lagged)
        self._known, self._pairs = there.any(axis=0), np.maximum(there.sum(axis=0), 1)
        self._centred = np.where(there, lagged - np.nanmean(grid), 0.0)
        self._spread = float(np.nanstd(grid))
        # tapered: a positive spectrum
        own = np.nan_to_num(autocorrelation(grid, len(grid) - 1)[0])
        self._autocorrelation = own * (1.0 - np.arange(len(grid)) / len(grid))

    def correlate(self, values: Floats, correlation: Floats) -> CrossCorrelation:
        """Correlate a series (n,), of a noise's autocorrelation (m,), with these lags.

        The variance is Σ ρ(k) ρ'(k)/n (Bartlett); Šidák's bound covers several lags.
        """
        sums = (values - values.mean()) @ self._centred
        found = np.where(self._known, sums / self._pairs / (values.std() * self._spread), np.nan)
        reach = min(correlation.size, self._autocorrelation.size)
        product = self._autocorrelation[:reach] * correlation[:reach]
        std = math.sqrt(max(2.0 * product.sum() - product[0], 1.0 / values.size) / values.size)
        strongest = int(np.nanargmax(np.abs(found)))
        single = min(2.0 * special.ndtr(-abs(found[strongest]) / std), 1.0 - np.finfo(float).eps)
        return CrossCorrelation(found, std, strongest, float(-np.expm1(self._known.sum() * np.log1p(-single))))
