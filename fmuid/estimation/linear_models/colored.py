"""Covariance of linear estimates whose residual is colored, and the degrees of freedom of its variances.

The estimate is θ̂ = A Qᵀ y, with Q an orthonormal basis of the instruments. Noise e of covariance Γ gives it the
covariance A QᵀΓQ Aᵀ. The residual is r = (I − P) e, P = F Qᵀ, F = Φ A: it lacks what the fit took, mostly at the slow
frequencies of the regressors. What is missing on average,

    E[e eᵀ − r rᵀ] = F Hᵀ + H Fᵀ,   H = ΓQ − F (QᵀΓQ)/2,

is added to the residual's sums of products, with the Γ found last (Worsley, for least squares). Γ is Toeplitz, with
the correlations under Parzen's window. The window is long: a short one smooths the spectrum, and a filter's falls to
zero.

A variance V_ii = rᵀBr is quadratic in the residual, B Toeplitz with the correlations of the weights A Qᵀ. It has
ν_i = tr(BR)²/tr(BRBR) degrees of freedom, R = (I − P) Γ (I − P)ᵀ (Satterthwaite).

References
----------
A. R. Gallant, "Nonlinear Statistical Models", Wiley 1987, section 2.2 (Parzen's window);
K. J. Worsley et al., "A general statistical analysis for fMRI data", NeuroImage 15, 2002;
F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics Bulletin 2, 1946.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from fmuid.array_types import Floats

# Correlations count up to this share of the record, 1/LAGS_SHARE.
LAGS_SHARE = 2
# Rounds that add what the fit took; a fifth moves no standard deviation by more than 1 %.
ROUNDS = 4
LEAST_FREEDOM = 1.0


def colored_covariance(basis: Floats, solution: Floats, rows: Floats, residual: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of an estimate and the degrees of freedom of its variances.

    Parameters
    ----------
    basis : (K, n) array
        Q, an orthonormal basis of the instruments.
    solution : (n, n) array
        A, from Qᵀy to the estimate.
    rows : (K, n) array
        Φ, the regressors.
    residual : (K,) array
        y − Φθ̂, in the order of time, without gaps.

    Returns
    -------
    covariance : (n, n) array
    freedom : (n,) array
    """
    lags = _Lags(residual.size)
    taken, sums = rows @ solution, lags.products(residual[:, None], residual[:, None])
    missing = np.zeros(residual.size)
    for _ in range(ROUNDS + 1):
        # few pairs at long lags may make the transform improper
        power = np.maximum(lags.spectrum(lags.window * (sums + missing)), 0.0)
        seen = lags.convolved(power, basis)
        inner = basis.T @ seen
        half = seen - taken @ inner / 2.0
        missing = lags.products(taken, half) + lags.products(half, taken)
    covariance = solution @ inner @ solution.T
    weights = basis @ solution.T
    freedom = [lags.freedom(column, power, taken, half) for column in weights.T]
    return (covariance + covariance.T) / 2.0, np.array(freedom)


class _Lags:
    """Toeplitz matrices of a record of so many samples, by their spectra."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.size = fft.next_fast_len(2 * count, real=True)
        self.pairs = np.arange(count, 0, -1, dtype=np.float64)
        share = np.arange(count) * LAGS_SHARE / count
        inner, outer = 1.0 - 6.0 * share**2 * (1.0 - share), 2.0 * np.maximum(1.0 - share, 0.0) ** 3
        self.window = np.where(share < 0.5, inner, outer) / self.pairs

    def products(self, one: Floats, other: Floats) -> Floats:
        """Return Σ_j Σ_t one_j(t) other_j(t + τ) for all lags τ ≥ 0 (count,)."""
        spectra = np.conj(fft.rfft(one, self.size, axis=0)) * fft.rfft(other, self.size, axis=0)
        return np.asarray(fft.irfft(spectra.sum(axis=1), self.size)[: self.count])

    def spectrum(self, column: Floats) -> Floats:
        """Return the spectrum of the symmetric Toeplitz matrix with a first column (count,)."""
        padded = np.zeros(self.size)
        padded[: self.count] = column
        padded[self.size - self.count + 1 :] = column[:0:-1]
        return np.asarray(fft.rfft(padded).real)

    def convolved(self, spectrum: Floats, columns: Floats) -> Floats:
        """Return a Toeplitz matrix of a spectrum times columns (count, n)."""
        spectra = spectrum[:, None] * fft.rfft(columns, self.size, axis=0)
        return np.asarray(fft.irfft(spectra, self.size, axis=0)[: self.count])

    def freedom(self, weights: Floats, power: Floats, taken: Floats, half: Floats) -> float:
        """Return tr(BR)²/tr(BRBR) with R = Γ − F Hᵀ − H Fᵀ; products of B and Γ are taken for Toeplitz."""
        of_weights = self.spectrum(self.window * self.products(weights[:, None], weights[:, None]))
        along = fft.irfft(of_weights * power, self.size)[: self.count]
        left, right = np.column_stack([taken, half]), np.column_stack([half, taken])
        seen, other = self.convolved(of_weights, left), self.convolved(of_weights, right)
        inner = right.T @ seen
        mean = self.count * along[0] - np.trace(inner)
        scatter = 2.0 * self.pairs @ along**2 - self.count * along[0] ** 2
        scatter += np.sum(inner * inner.T) - 2.0 * np.sum(other * self.convolved(power, seen))
        if not scatter > 0.0:
            return LEAST_FREEDOM
        return float(np.clip(mean**2 / scatter, LEAST_FREEDOM, self.count))
