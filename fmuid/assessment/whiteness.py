"""Whether a residual is white, where a fit has taken some of the noise out of it.

Ljung and Box's statistic is χ² of as many degrees of freedom as lags in long records. In short ones its tail is
heavier, and parameters make the residual of white noise look coloured: a test at 1 % then alarms in 2 to 6 %. Its mean
and variance there come from seeded draws of white noise with the same samples and the same fit, and a multiple of a χ²
that has them takes the place of the other (Satterthwaite).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

from fmuid.arrays import Floats, Indices
from fmuid.assessment.series import ljung_box

# In longer records chance and fit are as the limit says.
SHORT = 500
# What nobody would doubt, for or against, is not drawn.
CLEAR = (1e-9, 0.15)
DRAWS, SEED = 600, 0


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


def whiteness(correlations: Floats, pairs: Floats, there: NDArray[np.bool_], taken: Taken) -> tuple[float, float]:
    """Return Ljung and Box's statistic, and the probability that the residual of white noise exceeds it.

    Parameters
    ----------
    correlations, pairs : (lags + 1,) arrays
        Of `fmuid.assessment.series.autocorrelation`.
    there : (m,) array of bool
        Which samples of the grid there are, n of them.
    taken : Taken
    """
    statistic, probability = ljung_box(correlations, pairs)
    if pairs[0] > SHORT or not CLEAR[0] < probability < CLEAR[1]:
        return statistic, probability
    drawn = _statistics(taken.draws(np.random.default_rng(SEED), DRAWS), pairs, there)
    mean, variance = float(drawn.mean()), float(drawn.var())
    return statistic, float(special.chdtrc(2.0 * mean**2 / variance, 2.0 * mean * statistic / variance))


def _statistics(residuals: Floats, pairs: Floats, there: NDArray[np.bool_]) -> Floats:
    """Return the statistic (m,) of residuals (m, n)."""
    grid = np.zeros((len(residuals), there.size))
    grid[:, there] = residuals - residuals.mean(axis=1, keepdims=True)
    size = fft.next_fast_len(there.size + pairs.size, real=True)
    sums = fft.irfft(np.abs(fft.rfft(grid, size)) ** 2, size)[:, : pairs.size]
    known = np.flatnonzero(pairs[1:] > 0) + 1
    found = sums[:, known] / sums[:, :1] * pairs[0] / pairs[known]
    return np.asarray((pairs[0] + 2.0) / pairs[0] * (found**2 @ pairs[known]), dtype=np.float64)
