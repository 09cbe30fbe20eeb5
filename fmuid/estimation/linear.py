"""Least squares for models linear in their parameters (1.1–1.12): a closed form, by QR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.errors import InputError


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The least-squares estimate of y = Φ θ + noise.

    Attributes
    ----------
    theta : (N,) array
        The estimate (1.6).
    covariance : (N, N) array
        σ̂² (ΦᵀΦ)⁻¹ (1.11).
    noise_variance : float
        σ̂² = J(θ̂)/(K − N) (1.12).
    criterion : float
        J(θ̂), the sum of squared residuals.
    """

    theta: Floats
    covariance: Floats
    noise_variance: float
    criterion: float


def linear_least_squares(regressors: ArrayLike, measured: ArrayLike) -> LinearFit:
    """Estimate the parameters of a model y = Φ θ, linear in them.

    With Φ = Q R the estimate solves R θ = Qᵀy, and (ΦᵀΦ)⁻¹ = R⁻¹R⁻ᵀ; ΦᵀΦ itself, whose condition number is the
    square, is never formed.

    Parameters
    ----------
    regressors : (K, N) array
        Φ, one row φᵀ a sample; more rows than columns.
    measured : (K,) array

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, or the columns of Φ are linearly dependent.
    """
    phi, y = np.array(regressors, dtype=np.float64), np.array(measured, dtype=np.float64)
    if phi.ndim != 2 or y.shape != (len(phi),):
        raise InputError(f"regressors (K, N) and measured (K,) do not fit: their shapes are {phi.shape} and {y.shape}")
    rows, count = phi.shape
    if rows <= count:
        raise InputError(f"{rows} samples are too few for {count} parameters and a noise variance; measure more")
    if not (np.isfinite(phi).all() and np.isfinite(y).all()):
        raise InputError("regressors and measured must be finite; leave missing samples out")
    lengths = np.linalg.norm(phi, axis=0)
    q, r = np.linalg.qr(phi / np.where(lengths > 0, lengths, 1.0))
    if np.linalg.svd(r, compute_uv=False)[-1] <= np.finfo(float).eps * rows:
        raise InputError("the columns of the regressors are linearly dependent; leave one of them out")
    inverse = scipy.linalg.solve_triangular(r, np.eye(count)) / lengths[:, None]
    theta = inverse @ (q.T @ y)
    residual = y - phi @ theta
    criterion = float(residual @ residual)
    variance = criterion / (rows - count)
    return LinearFit(theta, variance * inverse @ inverse.T, variance, criterion)
