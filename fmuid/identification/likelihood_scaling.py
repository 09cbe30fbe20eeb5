"""The likelihood of data whose noise is coloured: scaled, direction by direction, to how estimates really scatter.

The log-likelihood l of white noise bends by the information H of the data where their optimum θ_d scatters by V. With
n − q degrees of freedom of its variance, l(θ_d) − l(θ) = n/2 log(1 + R/(n − q)), R the rise of the sum of squares by
the variance, dᵀHd near the optimum, d = θ − θ_d. What takes its place is

    l(θ_d) − (ν + q)/2 log(1 + Q/ν),   Q = R (dᵀV⁻¹d)/(dᵀHd),

of the curvature V⁻¹ (Chandler and Bate; for posteriors Ribatet et al.: one factor for all directions is wrong where the
noise's colour meets the parameters differently) and of the tails of Student's t with the ν degrees of freedom that V
has: scaled itself, the logarithm of a sum of squares would have none to speak of. The prior stays as it is.

References
----------
R. E. Chandler, S. Bate, "Inference for clustered data using the independence loglikelihood", Biometrika 94 (1), 2007;
M. Ribatet, D. Cooley, A. C. Davison, "Bayesian inference from composite likelihoods, with an application to spatial
extremes", Statistica Sinica 22, 2012.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats, Indices
from fmuid.estimation import LeastSquares, Result

# Directions of which the data tell less than this share of all that is known are the prior's.
LEAST_SHARE = 1e-6
# The intervals whose widths are kept where variances have few degrees of freedom.
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class LikelihoodScaling:
    """How the log-likelihood of the data is scaled.

    Attributes
    ----------
    at : (k,) array of int
        The parameters that are determined.
    centre : (k,) array
        θ_d of them.
    white, coloured : (k, k) arrays
        H and V⁻¹.
    above : float
        By how much l at θ_d exceeds that at the estimate.
    known : float
        n − q, infinite where variances are given.
    freedom : float
        ν.
    """

    at: Indices
    centre: Floats
    white: Floats
    coloured: Floats
    above: float
    known: float
    freedom: float

    def __call__(self, thetas: Floats, likelihood: Floats, at_estimate: float) -> Floats:
        """Return the scaled log-likelihood (m,) of thetas (m, N), from that of white noise, there and at the estimate.

        At the estimate both are the same where there is no prior.
        """
        away = thetas[:, self.at] - self.centre
        white, coloured = (np.einsum("mi,ij,mj->m", away, each, away) for each in (self.white, self.coloured))
        factor = np.divide(coloured, white, out=np.ones_like(white), where=white > 0)
        top, count = at_estimate + self.above, self.at.size
        fall = np.maximum(top - likelihood, 0.0)
        if math.isfinite(self.known):
            fall = 0.5 * self.known * np.expm1(2.0 * fall / (self.known + count))
        fall = factor * fall
        if math.isfinite(self.freedom):
            fall = 0.5 * (self.freedom + count) * np.log1p(2.0 * fall / self.freedom)
        return np.asarray(top - fall, dtype=np.float64)


def adjustment(problem: LeastSquares, result: Result, known: float) -> LikelihoodScaling:
    """Return how the likelihood of a problem, whose variances have `known` freedom, is to be scaled around a result."""
    local = result.local
    curvature = result.white_covariance if local is None else local.root @ local.root.T
    at = np.flatnonzero(np.isfinite(result.std) & (np.diag(curvature) > 0))
    if not at.size:
        return LikelihoodScaling(at, np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), 0.0, known, known)
    own, unit = np.ix_(at, at), np.sqrt(np.diag(curvature))[at]
    scale = np.outer(unit, unit)
    # t quantiles of each estimate, against those that the density has
    freedom = result.test_freedom([result.names[i] for i in at])
    wider = result.quantiles(LEVEL)[at] / _quantile(freedom)
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


def _quantile(freedom: float) -> float:
    tail = 0.5 + LEVEL / 2.0
    return float(special.ndtri(tail) if np.isinf(freedom) else special.stdtrit(freedom, tail))
