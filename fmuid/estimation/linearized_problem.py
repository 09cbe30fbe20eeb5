"""Linearized problem: cost paraboloids of data and prior (1.54).

For a step p, J_data = ‖r + J p‖² and J_prior = ‖w + W p‖². With J M = U S Vᵀ, M the magnitudes, the data reduce to
S Vᵀ M⁻¹ p + Uᵀr, without directions that are not identifiable.
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
    """Optimum of data and prior."""

    step: Floats  # (N,) (1.55), NaN if not identifiable
    disagreement: float  # rise of both costs above their minima; χ² of `degrees_of_freedom` if they agree
    degrees_of_freedom: int  # directions that both data and prior determine


@dataclass(frozen=True, eq=False)
class LinearizedProblem:
    """Rows of the cost function (1.37) and their derivatives at one point."""

    residual: Floats  # (n,), whitened data; counted samples only
    jacobian: Floats  # (n, N)
    prior_residual: Floats  # (q,), W(θ₀ − θ); q = 0 without prior
    prior_jacobian: Floats  # (q, N), −W
    levels: Floats  # (n,), noise level of each row, by which it is whitened
    magnitudes: Floats  # (N,), of the parameters
    data: LocalCovariance  # from the data alone
    combined: LocalCovariance  # with the prior

    @cached_property
    def _decomposed(self) -> tuple[Floats, Floats, Floats]:
        """U (n, k), S (k,), V (N, k) of identifiable directions."""
        u, s, vt = np.linalg.svd(self.jacobian * self.magnitudes, full_matrices=False)
        kept = min(len(s), self.data.rank)
        return u[:, :kept], s[:kept], vt[:kept].T

    @property
    def _compliance(self) -> Floats:
        """M V/S (N, k), a root of (JᵀJ)⁻¹."""
        _, s, v = self._decomposed
        return self.magnitudes[:, None] * v / s

    @property
    def data_basis(self) -> Floats:
        """U (n, k): orthonormal basis of the fitted part of the residual."""
        return self._decomposed[0]

    def data_step(self) -> Floats:
        """Return the step (N,) to the data's optimum, NaN if not identifiable."""
        u, s, v = self._decomposed
        return _known(self.data, -self.magnitudes * (v @ ((u.T @ self.residual) / s)))

    def data_std(self, noise: Floats) -> Floats:
        """Return σ (N,) of the data's optimum, infinite if unknown; noise (k, k) of `data_basis`."""
        give = self._compliance
        return np.nan_to_num(_known(self.data, np.sqrt(np.sum((give @ noise) * give, axis=1))), nan=np.inf)

    def moves(self) -> Floats:
        """Return the shift (N, N) of estimates by priors (columns); NaN if not identifiable."""
        give, force = self._compliance, -self.prior_jacobian.T @ self.prior_residual
        return _known(self.data, ((give @ give.T) * force).T).T

    def combine(self, noise: Floats | None = None) -> PriorDataOptimum:
        """Return the optimum of data and prior together; noise (k, k) of `data_basis`, default: white."""
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
        """R (N, k) with R Rᵀ the covariance of the combined estimate."""
        if self.combined.root.shape[1] == len(self.magnitudes):  # the same, from the same rows
            return self.combined.root
        stacked = np.vstack([self.jacobian, self.prior_jacobian])
        reduced = triangle(stacked, np.zeros(len(stacked)))[:, :-1]
        _, s, vt = np.linalg.svd(reduced * self.magnitudes, full_matrices=False)
        rank = min(len(s), self.combined.rank)
        return np.asarray(self.magnitudes[:, None] * vt[:rank].T / s[:rank], dtype=np.float64)


def _known(covariance: LocalCovariance, values: Floats) -> Floats:
    return np.where(np.isfinite(np.diag(covariance.covariance)), values, np.nan)
