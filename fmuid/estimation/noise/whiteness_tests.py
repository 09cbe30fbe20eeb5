"""What a series of samples says of itself: its autocorrelation, whether it is white, whether it is normal.

Samples may be missing. What noise of its colour shows by chance is said by its model (`fmuid.estimation.noise.model`):
the model's autocorrelation decays, so that sums over all lags converge, and belongs to a positive spectrum, which the
sample autocorrelation cut off somewhere does not.

References
----------
G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (2), 1978;
D. S. Stoffer, C. M. C. Toloi, "A note on the Ljung–Box–Pierce portmanteau statistic with missing data", Statistics &
Probability Letters 13 (5), 1992;
M. S. Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", Supplement to
the J. of the Royal Statistical Society 8 (1), 1946 (variances of correlations);
P. J. Brockwell, R. A. Davis, "Time Series: Theory and Methods", 2nd ed., Springer 1991, sections 5.2 and 11.2.
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

    tested_lags: int = 25
    """Whiteness is tested over so many lags, the habit of the field, ..."""
    lags_divisor: int = 5
    """... but over no more than this part of the samples."""
    shown_lags: int = 40
    """The autocorrelation is kept for figures to this lag."""
    short_record: int = 500
    """Whiteness of longer records is as its limit says, and of shorter ones drawn, ..."""
    clear_probabilities: tuple[float, float] = (1e-9, 0.15)
    """... but for what nobody would doubt, for or against."""
    draws: int = 600
    """Enough for the mean and variance of the statistic to some percent."""
    seed: int = 0
    """The same record has the same probability each time."""


SETTINGS = WhitenessSettings()


def autocorrelation(grid: Floats, lags: int) -> tuple[Floats, Floats]:
    """Return the autocorrelation at lags 0 to `lags`, and how many pairs of samples each comes from.

    The mean over the pairs that are there, against the variance; NaN at lags without any.

    Parameters
    ----------
    grid : (m,) array
        NaN where a sample is missing; not constant.
    lags : int
        Less than m.
    """
    there = np.isfinite(grid)
    centred = np.where(there, grid - np.nanmean(grid), 0.0)
    # by transforms: of long series with a long memory thousands of lags are asked for
    length = fft.next_fast_len(len(grid) + lags, real=True)
    both = np.stack([centred, there.astype(np.float64)])
    sums, pairs = fft.irfft(np.abs(fft.rfft(both, length)) ** 2, length)[:, : lags + 1]
    pairs = np.rint(pairs)
    with np.errstate(invalid="ignore"):
        return np.where(pairs > 0, sums / np.maximum(pairs, 1.0), np.nan) / (sums[0] / pairs[0]), pairs


def ljung_box(correlations: Floats, pairs: Floats) -> tuple[float, float]:
    """Return Ljung and Box's statistic over the lags given, and the probability that white noise exceeds it.

    n (n + 2) Σ r_k²/(n − k) where no sample is missing, r_k the sums over the pairs divided by n; with gaps each lag
    counts by its pairs (Stoffer and Toloi). In long records: of short ones see `whiteness`.

    Parameters
    ----------
    correlations, pairs : (lags + 1,) arrays
        Of `autocorrelation`.
    """
    count = pairs[0]
    known = pairs[1:] > 0
    statistic = float((count + 2.0) / count * np.sum(pairs[1:][known] * correlations[1:][known] ** 2))
    return statistic, float(special.chdtrc(int(known.sum()), statistic))


@dataclass(frozen=True, eq=False)
class FitProjection:
    """What a fit takes out of the noise e of one output: the residual is e_a − C_a Σ_b C_bᵀ e_b over all outputs.

    Attributes
    ----------
    columns : (n, k) array
        C_a = J_a R, R Rᵀ the covariance of the estimates for white noise of variance 1.
    gram : (k, k) array
        Σ_b C_bᵀ C_b.
    """

    columns: Floats
    gram: Floats

    @classmethod
    def nothing(cls, count: int) -> FitProjection:
        """Return that of a residual that was not fitted."""
        return cls(np.zeros((count, 0)), np.zeros((0, 0)))

    def of(self, rows: Indices) -> FitProjection:
        """Return that of some rows: those of one output."""
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
        Over which whiteness was tested.
    statistic : float
    probability : float
        That the residual of white noise exceeds it.
    autocorrelation : (m,) array
        From lag 0 on, for figures; NaN where no two samples are so far apart.
    band : float
        Half-width of the 95 % band of each of them, if the series were white.
    """

    lags: int
    statistic: float
    probability: float
    autocorrelation: Floats
    band: float

    @property
    def strongest(self) -> tuple[int, float]:
        """The lag, in samples, at which the autocorrelation is largest, of those tested, and its value there."""
        tested = np.nan_to_num(self.autocorrelation[: self.lags + 1])
        lag = 1 + int(np.argmax(np.abs(tested[1:])))
        return lag, float(tested[lag])


def whiteness(grid: Floats, taken: FitProjection) -> WhitenessTest:
    """Test whether a series is the residual of white noise.

    The statistic is χ² of as many degrees of freedom as lags in long records. In short ones its tail is heavier, and
    parameters make the residual of white noise look coloured: a test at 1 % then alarms in 2 to 6 %. Its mean and
    variance there come from seeded draws of white noise with the same samples and the same fit, and a multiple of a χ²
    that has them takes the place of the other (Satterthwaite).

    Parameters
    ----------
    grid : (m,) array
        NaN where a sample is missing; not constant.
    taken : FitProjection
        By the fit that left the series.
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
    """Shape of a distribution against that of normal noise (Jarque and Bera).

    Attributes
    ----------
    skewness, kurtosis : float
        Of the normal distribution 0 and (excess) 0.
    probability : float
        That normal noise of this colour shows as much.
    """

    skewness: float
    kurtosis: float
    probability: float


def normality(values: Floats, noise: NoiseModel) -> NormalityTest:
    """Test whether samples (n,), not constant, are normal.

    The variances of skewness and kurtosis, 6/n and 24/n for white noise, are those of noise of this colour.
    """
    centred = values - values.mean()
    spread = math.sqrt(float(np.mean(centred**2)))
    skewness = float(np.mean((centred / spread) ** 3))
    kurtosis = float(np.mean((centred / spread) ** 4)) - 3.0
    third, fourth = (values.size / noise.variance_factor(power) for power in (3, 4))
    statistic = third * skewness**2 / 6.0 + fourth * kurtosis**2 / 24.0
    return NormalityTest(skewness, kurtosis, float(special.chdtrc(2, statistic)))


@dataclass(frozen=True, eq=False)
class CrossCorrelation:
    """Correlation of a series with another one at several lags.

    Attributes
    ----------
    values : (lags + 1,) array
        NaN where nothing is known.
    std : float
        Of each, if both series had nothing to do with each other.
    strongest : int
        The lag with the largest magnitude.
    probability : float
        That chance gives as much at any of the lags.
    """

    values: Floats
    std: float
    strongest: int
    probability: float


class LaggedSeries:
    """A series at the samples of others and so many lags before, with which they are correlated one after the other.

    Parameters
    ----------
    lagged : (n, lags + 1) array
        The series at each sample's time minus each lag, NaN where it has not begun.
    grid : (g,) array
        The series on the grid of the others; not constant.
    """

    def __init__(self, lagged: Floats, grid: Floats) -> None:
        there = np.isfinite(lagged)
        self._known, self._pairs = there.any(axis=0), np.maximum(there.sum(axis=0), 1)
        self._centred = np.where(there, lagged - np.nanmean(grid), 0.0)
        self._spread = float(np.nanstd(grid))
        # tapered: the sums over n that belong to a positive spectrum
        own = np.nan_to_num(autocorrelation(grid, len(grid) - 1)[0])
        self._autocorrelation = own * (1.0 - np.arange(len(grid)) / len(grid))

    def correlate(self, values: Floats, correlation: Floats) -> CrossCorrelation:
        """Correlate a series with the lagged values of this one.

        The variance of each correlation of unrelated series is Σ ρ(k) ρ'(k)/n over all k (Bartlett; Brockwell and
        Davis, theorem 11.2.2), 1/n where one of them is white. Over several lags the probability is Šidák's bound,
        which holds however these correlations depend on each other.

        Parameters
        ----------
        values : (n,) array
        correlation : (m,) array
            Of this series' noise.
        """
        sums = (values - values.mean()) @ self._centred
        found = np.where(self._known, sums / self._pairs / (values.std() * self._spread), np.nan)
        reach = min(correlation.size, self._autocorrelation.size)
        product = self._autocorrelation[:reach] * correlation[:reach]
        std = math.sqrt(max(2.0 * product.sum() - product[0], 1.0 / values.size) / values.size)
        strongest = int(np.nanargmax(np.abs(found)))
        single = min(2.0 * special.ndtr(-abs(found[strongest]) / std), 1.0 - np.finfo(float).eps)
        return CrossCorrelation(found, std, strongest, float(-np.expm1(self._known.sum() * np.log1p(-single))))
