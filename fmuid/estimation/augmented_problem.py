"""Estimates with further columns beside the parameters: model errors, and delays of the acquisition.

The Gauss-Newton step of [J D] with prior rows, and its covariance under the noise that is left (`sandwich_of_rows`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.estimation.linearized_problem import LinearizedProblem
from fmuid.estimation.noise.sample_grid import Rows
from fmuid.estimation.noise.sandwich import SandwichCovariance, sandwich_of_rows
from fmuid.estimation.problem import LeastSquares


@dataclass(frozen=True, eq=False)
class AugmentedProblem:
    """Linearized problem with m columns beside the N parameters."""

    design: Floats  # (n, N + m), change of the whitened outputs by parameters and columns
    prior: Floats  # (q, N + m)
    target: Floats  # (n + q,), residual, then prior residual
    root: Floats  # (N + m, N + m), R with R Rᵀ the covariance under white noise
    levels: Floats  # (n,), noise level of each row

    @cached_property
    def step(self) -> Floats:
        """Change of the parameters, then sizes of the columns (N + m,)."""
        return self.root @ (self.root.T @ (np.vstack([self.design, self.prior]).T @ self.target))

    @property
    def spread(self) -> float:
        """Mean square of the residual that is left."""
        left = self.target - np.vstack([self.design, self.prior]) @ self.step
        return float(left @ left) / max(len(left) - len(self.root), 1)

    def response(self, columns: Floats) -> Floats:
        """Return changes (N + m, k) of the estimates by outputs (n, k)."""
        return np.asarray(self.root @ (self.root.T @ (self.design.T @ columns)))

    def sandwich(self, problem: LeastSquares) -> SandwichCovariance:
        """Return the covariance under the noise that is left."""
        own, given = self.prior @ self.root, ~np.isnan(problem.variance)
        basis = np.linalg.qr(self.design @ self.root)[0]
        left = self.target[: len(self.design)] - self.design @ self.step
        simulated = problem.measured - self.levels * left
        left = left - basis @ (basis.T @ left)
        white = np.zeros(len(given), np.bool_)
        rows = Rows(left, basis, self.design @ self.root, self.root, own.T @ own, given, white, problem.levels.pools)
        return sandwich_of_rows(problem, rows, simulated)


def augmented(local: LinearizedProblem, columns: Floats, prior_std: Floats | None = None) -> AugmentedProblem:
    """Return a linearized problem with columns (n, m) of whitened outputs.

    Their sizes have mean zero and `prior_std` (m,), or no prior.
    """
    count, more = local.jacobian.shape[1], columns.shape[1]
    design = np.hstack([-local.jacobian, columns])
    prior = np.hstack([-local.prior_jacobian, np.zeros((len(local.prior_jacobian), more))])
    target = np.concatenate([local.residual, local.prior_residual])
    if prior_std is not None:
        prior = np.vstack([prior, np.hstack([np.zeros((more, count)), np.diag(1.0 / prior_std)])])
        target = np.concatenate([target, np.zeros(more)])
    whole = np.vstack([design, prior])
    scale = np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    triangle = np.linalg.qr(whole / scale, mode="r")
    root = scipy.linalg.solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return AugmentedProblem(design, prior, target, root, local.levels)
