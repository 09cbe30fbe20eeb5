"""The problem made linear at one point: the paraboloids of data and prior, and what follows from their sum (1.54).

Near the point the whitened residual of the data is r + J p for a step p, that of the prior w + W p. Both sums of
squares are paraboloids, J_data(p) = ‖r + J p‖² and J_prior(p) = ‖w + W p‖², and everything that is read from them is
linear least squares on these rows: (JᵀJ)⁻¹ and (WᵀW)⁻¹ themselves need not exist. With J M = U S Vᵀ, M the parameters'
magnitudes, the data's rows come down to the few S Vᵀ M⁻¹ p + Uᵀr, without directions that the data do not determine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation.covariance import LocalCovariance
from fmuid.estimation.search.trust_region import triangle


@dataclass(frozen=True, eq=False)
class PriorDataOptimum:
    """Where data and prior together are least, and by how much they disagree.

    Attributes
    ----------
    step : (N,) array
        From the point to the barycentre (1.55); NaN for parameters that neither determines.
    disagreement : float
        By how much both sums of squares together exceed their own least values there. Where data and prior both
        determine every parameter it is (θ_opt − θ₀)ᵀ (M₀ + P_opt)⁻¹ (θ_opt − θ₀).
    degrees_of_freedom : int
        How many directions data and prior both speak of; the disagreement of what agrees is χ² of so many.
    """

    step: Floats
    disagreement: float
    degrees_of_freedom: int


@dataclass(frozen=True, eq=False)
class LinearizedProblem:
    """The rows of the compound criterion (1.37) and their derivatives at one point.

    Attributes
    ----------
    residual, jacobian : (n,) and (n, N) arrays
        Of the data, whitened: experiment by experiment, sample by sample, counted samples only.
    prior_residual, prior_jacobian : (q,) and (q, N) arrays
        Of the prior, W(θ₀ − θ) and −W; q = 0 without.
    magnitudes : (N,) array
        How large each parameter is.
    data, combined : LocalCovariance
        What the data say of the parameters, alone and with the prior.
    """

    residual: Floats
    jacobian: Floats
    prior_residual: Floats
    prior_jacobian: Floats
    magnitudes: Floats
    data: LocalCovariance
    combined: LocalCovariance

    @cached_property
    def _decomposed(self) -> tuple[Floats, Floats, Floats]:
        """U (n, k), S (k,) and V (N, k) of the k directions that the data determine."""
        u, s, vt = np.linalg.svd(self.jacobian * self.magnitudes, full_matrices=False)
        kept = min(len(s), self.data.rank)
        return u[:, :kept], s[:kept], vt[:kept].T

    @property
    def data_basis(self) -> Floats:
        """U (n, k): the residual's directions, orthonormal, that the parameters determined by the data move."""
        return self._decomposed[0]

    def data_step(self) -> Floats:
        """Return the step to the optimum of the data alone (N,), NaN for parameters that they do not determine."""
        u, s, v = self._decomposed
        return _known(self.data, -self.magnitudes * (v @ ((u.T @ self.residual) / s)))

    def data_std(self, noise: Floats) -> Floats:
        """Return the standard deviations (N,) of the data's optimum, infinite for what they do not determine.

        Parameters
        ----------
        noise : (k, k) array
            Covariance of the whitened noise in the coordinates of `data_basis`.
        """
        _, s, v = self._decomposed
        give = self.magnitudes[:, None] * v / s
        return np.nan_to_num(_known(self.data, np.sqrt(np.sum((give @ noise) * give, axis=1))), nan=np.inf)

    def moves(self) -> Floats:
        """Return how far the prior of each parameter (columns) has moved each estimate (rows) from the data's optimum.

        Where both criteria together are least, the prior pulls with the force Wᵀw and the data give way by (JᵀJ)⁻¹
        times it, each parameter's share of the force for itself (N, N). NaN for parameters that the data do not
        determine.
        """
        _, s, v = self._decomposed
        give = self.magnitudes[:, None] * v / s
        force = -self.prior_jacobian.T @ self.prior_residual
        return _known(self.data, ((give @ give.T) * force).T).T

    def combine(self, noise: Floats | None = None) -> PriorDataOptimum:
        """Add the paraboloids of data and prior.

        Parameters
        ----------
        noise : (k, k) array, optional
            Covariance of the whitened noise in the coordinates of `data_basis`; default the identity, white noise.
        """
        u, s, v = self._decomposed
        rows, values = (v * s).T, u.T @ self.residual
        if noise is not None:
            factor = np.linalg.cholesky(noise)
            rows, values = np.linalg.solve(factor, rows), np.linalg.solve(factor, values)
        matrix = np.vstack([rows, self.prior_jacobian * self.magnitudes])
        vector = np.concatenate([values, self.prior_residual])
        left, singular, right = np.linalg.svd(matrix, full_matrices=False)
        rank = min(len(singular), self.combined.rank)
        along = left[:, :rank].T @ vector
        rest = vector - left[:, :rank] @ along
        step = -self.magnitudes * (right[:rank].T @ (along / singular[:rank]))
        return PriorDataOptimum(_known(self.combined, step), float(rest @ rest), len(vector) - rank)

    @cached_property
    def root(self) -> Floats:
        """R (N, k) with R Rᵀ the covariance of the combined estimate, over the k directions that are determined."""
        if self.combined.root.shape[1] == len(self.magnitudes):  # the same, from the same rows
            return self.combined.root
        stacked = np.vstack([self.jacobian, self.prior_jacobian])
        reduced = triangle(stacked, np.zeros(len(stacked)))[:, :-1]
        _, s, vt = np.linalg.svd(reduced * self.magnitudes, full_matrices=False)
        rank = min(len(s), self.combined.rank)
        return np.asarray(self.magnitudes[:, None] * vt[:rank].T / s[:rank], dtype=np.float64)


def _known(covariance: LocalCovariance, values: Floats) -> Floats:
    return np.where(np.isfinite(np.diag(covariance.covariance)), values, np.nan)
