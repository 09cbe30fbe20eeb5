"""Likelihood scaled to the colored noise (docs/method/profiles-and-posterior.md, with its symbols).

The prior stays as it is (Ribatet et al., Statistica Sinica 22, 2012).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats, Indices
from fmuid.estimation import LeastSquares, Result

LEAST_SHARE = 1e-6  # of the information; directions with less from the data are the prior's
LEVEL = 0.95  # of the intervals whose widths are kept


@dataclass(frozen=True, eq=False)
class LikelihoodScaling:
    """Scaling of the data's log-likelihood."""

    at: Indices  # (k,), the identifiable parameters
    center: Floats  # (k,), θ_d
    white: Floats  # (k, k), H
    colored: Floats  # (k, k), V⁻¹
    above: float  # l at θ_d less l at the estimate
    known: float  # n − q, infinite where variances are given
    freedom: float  # ν

    def __call__(self, thetas: Floats, likelihood: Floats, at_estimate: float) -> Floats:
        """Return the scaled log-likelihood (m,) from that of white noise."""
        away = thetas[:, self.at] - self.center
        white, colored = (np.einsum("mi,ij,mj->m", away, each, away) for each in (self.white, self.colored))
        factor = np.divide(colored, white, out=np.ones_like(white), where=white > 0)
        top, count = at_estimate + self.above, self.at.size
        fall = np.maximum(top - likelihood, 0.0)
        if math.isfinite(self.known):
            fall = 0.5 * self.known * np.expm1(2.0 * fall / (self.known + count))
        fall = factor * fall
        if math.isfinite(self.freedom):
            fall = 0.5 * (self.freedom + count) * np.log1p(2.0 * fall / self.freedom)
        return np.asarray(top - fall, dtype=np.float64)


def adjustment(problem: LeastSquares, result: Result, known: float) -> LikelihoodScaling:
    """Return the scaling around a result; `known` are degrees of freedom."""
    local = result.fit.linearization
    curvature = result.estimates.covariance_white_noise if local is None else local.root @ local.root.T
    at = np.flatnonzero(np.isfinite(result.std) & (np.diag(curvature) > 0))
    if not at.size:
        return LikelihoodScaling(at, np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), 0.0, known, known)
    own, unit = np.ix_(at, at), np.sqrt(np.diag(curvature))[at]
    scale = np.outer(unit, unit)
    # t quantiles of each estimate, against those that the density has
    freedom = result.estimates.test_dof([result.names[i] for i in at])
    wider = result.estimates.quantiles(LEVEL)[at] / quantile(freedom, LEVEL)
    whole = np.linalg.pinv(curvature[own] / scale, hermitian=True)
    whitening = problem.parameters.prior_whitening[:, at] * unit
    prior = whitening.T @ whitening
    values, vectors = np.linalg.eigh(whole - prior)
    kept = values > LEAST_SHARE * np.linalg.eigvalsh(whole)[-1]
    basis, information = vectors[:, kept], values[kept]
    # of the estimate's covariance H⁻¹ (B + P) H⁻¹, B is what the noise of the data gives
    noise = whole @ (result.covariance[own] / scale * np.outer(wider, wider)) @ whole - prior
    inner = basis.T @ noise @ basis
    root = np.sqrt(information)
    spectrum, turned = np.linalg.eigh(inner / np.outer(root, root))
    spectrum = np.maximum(spectrum, LEAST_SHARE * max(float(spectrum.max(initial=0.0)), np.finfo(float).tiny))
    half = basis * root @ turned
    force = whitening.T @ problem.parameters.prior_residual(result.values[None])[0]
    shift = -basis @ ((basis.T @ force) / information)
    return LikelihoodScaling(
        at,
        result.values[at] + unit * shift,
        (basis * information) @ basis.T / scale,
        (half / spectrum) @ half.T / scale,
        0.5 * float(np.sum((basis.T @ shift) ** 2 * information)),
        known,
        freedom,
    )


def quantile(freedom: float, level: float) -> float:
    """Return the two-sided quantile of Student's t, normal for infinite freedom."""
    tail = 0.5 + level / 2.0
    return float(special.stdtrit(freedom, tail) if math.isfinite(freedom) else special.ndtri(tail))
