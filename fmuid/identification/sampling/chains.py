"""Convergence diagnostics of Markov chains: agreement of the chains, and effective sample size.

References
----------
A. Vehtari, A. Gelman, D. Simpson, B. Carpenter, P.-C. Bürkner, "Rank-normalization, folding, and localization: an
improved R-hat for assessing convergence of MCMC", Bayesian Analysis 16 (2), 2021, whose equations are cited;
C. J. Geyer, "Practical Markov chain Monte Carlo", Stat. Science 7 (4), 1992.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from fmuid.array_types import Floats

# Diagnostics of shorter chains are meaningless.
LEAST_LENGTH = 8


def r_hat(draws: Floats) -> float:
    """Return R-hat of draws (n, chains), rank-normalised, of split chains, the greater of plain and folded ones.

    The spread of all draws over that within chains: 1 where all chains, and their halves, agree. NaN for too few draws
    or identical ones (eqs 1 to 6 and 14 to 17).
    """
    if len(draws) < LEAST_LENGTH:
        return math.nan
    split = _split(draws)
    return max(_ratio(_normalised(split)), _ratio(_normalised(np.abs(split - np.median(split)))))


def effective_size(draws: Floats) -> float:
    """Return the effective sample size of draws (n, chains): the lesser of that of the bulk and that of the tails.

    NaN for too few draws or identical ones (section 4.3 and eqs 10 to 13).
    """
    if len(draws) < LEAST_LENGTH:
        return math.nan
    split = _split(draws)
    tails = [(split <= end).astype(np.float64) for end in np.quantile(split, [0.05, 0.95])]
    return min(_size(part) for part in (_normalised(split), *tails))


def _split(draws: Floats) -> Floats:
    half = len(draws) // 2
    return np.concatenate([draws[:half], draws[len(draws) - half :]], axis=1)


def _normalised(draws: Floats) -> Floats:
    """Replace draws by the normal quantiles of their ranks (eq 14)."""
    from scipy.stats import rankdata  # slow to import

    ranks = rankdata(draws).reshape(draws.shape)
    return np.asarray(special.ndtri((ranks - 0.375) / (draws.size + 0.25)), dtype=np.float64)


def _variances(draws: Floats) -> tuple[float, float]:
    """Return the variance within chains, and that of all draws as estimated from within and between (eqs 1 to 3)."""
    within = float(draws.var(axis=0, ddof=1).mean())
    return within, within * (1.0 - 1.0 / len(draws)) + float(draws.mean(axis=0).var(ddof=1))


def _ratio(draws: Floats) -> float:
    within, overall = _variances(draws)
    return math.sqrt(overall / within) if within > 0 else math.nan


def _size(draws: Floats) -> float:
    """Return the effective size by the autocorrelation of all chains, up to where its pairs are positive (Geyer)."""
    count = len(draws)
    within, overall = _variances(draws)
    if not overall > 0:
        return math.nan
    spectrum = np.abs(np.fft.rfft(draws - draws.mean(axis=0), 2 * count, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, axis=0)[:count].mean(axis=1) / count
    correlation = 1.0 - (within - covariance) / overall
    correlation[0] = 1.0
    pairs = correlation[: count - count % 2].reshape(-1, 2).sum(axis=1)
    positive = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else pairs.size
    length = -1.0 + 2.0 * float(np.minimum.accumulate(pairs[:positive]).sum())
    return draws.size / max(length, 1.0 / math.log10(draws.size))
