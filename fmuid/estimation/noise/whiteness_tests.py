"""What a series of samples says of itself: its autocorrelation, whether it is white, whether it is normal.

Samples may be missing. The noise behind a series is described by an autoregressive model: its autocorrelation decays,
so that sums over all lags converge, and belongs to a positive spectrum, which the sample autocorrelation cut off
somewhere does not. Its order is Akaike's choice, as in R's ``ar`` and in coda's effective sample sizes.

References
----------
G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (2), 1978;
D. S. Stoffer, C. M. C. Toloi, "A note on the Ljung–Box–Pierce portmanteau statistic with missing data", Statistics &
Probability Letters 13 (5), 1992;
M. S. Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", Supplement to
the J. of the Royal Statistical Society 8 (1), 1946 (variances of correlations and of a variance);
Z. A. Lomnicki, "Tests for departure from normality in the case of linear stochastic processes", Metrika 4, 1961;
P. J. Brockwell, R. A. Davis, "Time Series: Theory and Methods", 2nd ed., Springer 1991, sections 5.2 and 11.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from fmuid.array_types import Flags, Floats, Indices
from fmuid.estimation.noise.output_series import table_grid

# The autocorrelation of a model is followed until it stays below this.
NEGLIGIBLE_CORRELATION = 1e-6
# Reflection coefficients do not exceed this; gaps can make them, and beyond 1 no noise has such correlations.
LARGEST_REFLECTION = 1.0 - 1e-9
# Whiteness of longer records is as its limit says, and of shorter ones drawn ...
SHORT_RECORD = 500
# ... but for what nobody would doubt, for or against.
CLEAR_PROBABILITIES = (1e-9, 0.15)
DRAWS, SEED = 600, 0


def positions(times: Floats) -> tuple[Indices, float]:
    """Return where samples stand on the grid of their usual step, and that step in s.

    Parameters
    ----------
    times : (n,) array
        Never decreasing, s; n ≥ 2. Where they are not near a grid, or two are the same, the samples themselves are
        counted, and the step is the mean one.
    """
    places, step, _ = table_grid(times)
    if (np.diff(places) == 0).any():
        return np.arange(times.size), float(times[-1] - times[0]) / (times.size - 1)
    return places, step


def on_grid(values: Floats, places: Indices) -> Floats:
    """Return the series with its gaps, NaN where a sample is missing."""
    grid = np.full(int(places[-1]) + 1, np.nan)
    grid[places] = values
    return grid


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
class Taken:
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
    def nothing(cls, count: int) -> Taken:
        """Return that of a residual that was not fitted."""
        return cls(np.zeros((count, 0)), np.zeros((0, 0)))

    def of(self, rows: Indices) -> Taken:
        """Return that of some rows: those of one output."""
        return Taken(self.columns[rows], self.gram)

    def draws(self, random: np.random.Generator, count: int) -> Floats:
        """Return residuals of white noise (count, n)."""
        noise = random.standard_normal((count, len(self.columns)))
        values, vectors = np.linalg.eigh(self.gram - self.columns.T @ self.columns)
        others = random.standard_normal((count, values.size)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(noise - (noise @ self.columns + others) @ self.columns.T, dtype=np.float64)


def whiteness(correlations: Floats, pairs: Floats, there: Flags, taken: Taken) -> tuple[float, float]:
    """Return Ljung and Box's statistic, and the probability that the residual of white noise exceeds it.

    The statistic is χ² of as many degrees of freedom as lags in long records. In short ones its tail is heavier, and
    parameters make the residual of white noise look coloured: a test at 1 % then alarms in 2 to 6 %. Its mean and
    variance there come from seeded draws of white noise with the same samples and the same fit, and a multiple of a χ²
    that has them takes the place of the other (Satterthwaite).

    Parameters
    ----------
    correlations, pairs : (lags + 1,) arrays
        Of `autocorrelation`.
    there : (m,) array of bool
        Which samples of the grid there are, n of them.
    taken : Taken
    """
    statistic, probability = ljung_box(correlations, pairs)
    if pairs[0] > SHORT_RECORD or not CLEAR_PROBABILITIES[0] < probability < CLEAR_PROBABILITIES[1]:
        return statistic, probability
    drawn = _statistics(taken.draws(np.random.default_rng(SEED), DRAWS), pairs, there)
    mean, variance = float(drawn.mean()), float(drawn.var())
    return statistic, float(special.chdtrc(2.0 * mean**2 / variance, 2.0 * mean * statistic / variance))


def _statistics(residuals: Floats, pairs: Floats, there: Flags) -> Floats:
    """Return the statistic (m,) of residuals (m, n)."""
    grid = np.zeros((len(residuals), there.size))
    grid[:, there] = residuals - residuals.mean(axis=1, keepdims=True)
    size = fft.next_fast_len(there.size + pairs.size, real=True)
    sums = fft.irfft(np.abs(fft.rfft(grid, size)) ** 2, size)[:, : pairs.size]
    known = np.flatnonzero(pairs[1:] > 0) + 1
    found = sums[:, known] / sums[:, :1] * pairs[0] / pairs[known]
    return np.asarray((pairs[0] + 2.0) / pairs[0] * (found**2 @ pairs[known]), dtype=np.float64)


def noise_model(grid: Floats) -> Floats:
    """Return the autocorrelation of the autoregressive model of a series, (m,) from lag 0 on to where it has decayed.

    The orders up to 10 log₁₀ n are fitted one after the other (Durbin and Levinson), and Akaike's criterion chooses
    among them; up to its order the model's autocorrelation is the series' own.
    """
    count, length = int(np.isfinite(grid).sum()), len(grid)
    own, pairs = autocorrelation(grid, max(0, min(int(10.0 * math.log10(count)), count // 4, length - 1)))
    usable = int(np.argmin(pairs > 0)) if (pairs == 0).any() else len(pairs)
    # without gaps the sums divided by n, which belong to a positive spectrum
    known = own[:usable] * (1.0 - np.arange(usable) / length)
    best, model = 0.0, np.zeros(0)
    for order, (variance, coefficients) in enumerate(_levinson(known), start=1):
        akaike = count * math.log(variance) + 2.0 * order
        if akaike < best:
            best, model = akaike, coefficients
    if not model.size:
        return np.ones(1)
    start = np.clip(known[: model.size + 1], -1.0, 1.0)
    whole = _continued(start, model, length)
    return whole[: int(np.flatnonzero(np.abs(whole) >= NEGLIGIBLE_CORRELATION)[-1]) + 1]


def _continued(start: Floats, model: Floats, length: int) -> Floats:
    """Return the autocorrelation (length,) that begins with `start` and goes on as the model says."""
    whole = np.zeros(length)  # scipy.signal would do this too, and takes half a second to import
    whole[: start.size] = start
    for lag in range(start.size, length):
        before = whole[lag - model.size : lag]
        if lag % model.size == 0 and np.abs(before).max() < NEGLIGIBLE_CORRELATION * NEGLIGIBLE_CORRELATION:
            break
        whole[lag] = before @ model[::-1]
    return whole


def _levinson(correlations: Floats) -> Iterator[tuple[float, Floats]]:
    """Yield the variance that is left, relative to the series', and the coefficients of each order (Durbin)."""
    variance, model = 1.0, np.zeros(0)
    for order in range(1, len(correlations)):
        reflection = (correlations[order] - model @ correlations[order - 1 : 0 : -1]) / variance
        impossible = abs(reflection) > LARGEST_REFLECTION
        reflection = min(max(reflection, -LARGEST_REFLECTION), LARGEST_REFLECTION)
        model = np.concatenate([model - reflection * model[::-1], [reflection]])
        variance *= 1.0 - reflection**2
        yield variance, model
        if impossible:
            return


def lag_sum(correlation: Floats, count: int, power: int = 1) -> float:
    """Return Σ (1 − |k|/n) ρ(k)^power over all lags of both signs, of n samples; not less than 1/n.

    Power 1: by so much the variance of a mean is larger than that of white noise, the integrated correlation time in
    samples. Power 2: likewise of a variance (Bartlett); powers 3 and 4: of skewness and kurtosis (Lomnicki).
    """
    rest = correlation[1:count]
    weights = 1.0 - np.arange(1, rest.size + 1) / count
    return max(1.0 + 2.0 * float(weights @ rest**power), 1.0 / count)


def normality(values: Floats, correlation: Floats) -> tuple[float, float, float]:
    """Return skewness, excess kurtosis, and the probability that normal noise shows as much (Jarque and Bera).

    The variances of both, 6/n and 24/n for white noise, are those of noise that has the given autocorrelation.

    Parameters
    ----------
    values : (n,) array
        Not constant.
    correlation : (m,) array
        Of `noise_model`.
    """
    centred = values - values.mean()
    spread = math.sqrt(float(np.mean(centred**2)))
    skewness = float(np.mean((centred / spread) ** 3))
    kurtosis = float(np.mean((centred / spread) ** 4)) - 3.0
    third, fourth = (values.size / lag_sum(correlation, values.size, power) for power in (3, 4))
    statistic = third * skewness**2 / 6.0 + fourth * kurtosis**2 / 24.0
    return skewness, kurtosis, float(special.chdtrc(2, statistic))


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
            Of this series' noise, from `noise_model`.
        """
        sums = (values - values.mean()) @ self._centred
        found = np.where(self._known, sums / self._pairs / (values.std() * self._spread), np.nan)
        reach = min(correlation.size, self._autocorrelation.size)
        product = self._autocorrelation[:reach] * correlation[:reach]
        std = math.sqrt(max(2.0 * product.sum() - product[0], 1.0 / values.size) / values.size)
        strongest = int(np.nanargmax(np.abs(found)))
        single = min(2.0 * special.ndtr(-abs(found[strongest]) / std), 1.0 - np.finfo(float).eps)
        return CrossCorrelation(found, std, strongest, float(-np.expm1(self._known.sum() * np.log1p(-single))))
