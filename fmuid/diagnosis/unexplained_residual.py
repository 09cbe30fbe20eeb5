"""Unexplained change: the residual's regression on earlier inputs, beside all listed causes.

Lags go in doubling spans, as a response fades. Only the change of the coefficients since the healthy record counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.information_matrix import InformationMatrix
from fmuid.identification import SAME_VARIANCE_RATIO


@dataclass(frozen=True)
class UnexplainedSettings:
    """Numbers of the tests."""

    level_share: float = 0.1  # of the level, spent on these tests
    spans: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32)  # lags of the inputs, samples; summed between
    nothing: float = 1e-8  # information of a direction, over the best, below which it is left out
    spanned: float = 1e-12  # singular value of the model's columns, over the largest, of no direction


SETTINGS = UnexplainedSettings()


@dataclass(frozen=True)
class UnexplainedResidual:
    """Change without a listed cause: of the regression on the inputs."""

    statistic: float  # χ²
    degrees: int
    probability: float  # by chance


NOTHING_LEFT = UnexplainedResidual(0.0, 0, 1.0)


def lagged(inputs: Floats, spans: Sequence[int] = SETTINGS.spans) -> Floats:
    """Return a constant and inputs (n, m) summed over spans of lags: (n, 1 + (len(spans) − 1) m)."""
    sums = np.vstack([np.zeros((1, inputs.shape[1])), np.cumsum(inputs, axis=0)])
    ends = 1 + np.arange(len(inputs))
    until = [sums[np.maximum(ends - lag, 0)] for lag in spans]
    return np.hstack([np.ones((len(inputs), 1)), *(a - b for a, b in itertools.pairwise(until))])


def regression(residual: Floats, regressors: Floats, jacobian: Floats) -> InformationMatrix:
    """Return the regression of a whitened residual beside the Jacobian."""
    norms = np.linalg.norm(jacobian, axis=0)
    basis, values, _ = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1.0), full_matrices=False)
    spanned = basis[:, values > SETTINGS.spanned * values.max(initial=0.0)]
    shared = spanned.T @ regressors
    own = InformationMatrix.of(regressors, residual)
    return InformationMatrix(own.matrix - shared.T @ shared, own.score - shared.T @ (spanned.T @ residual))


def change(healthy: InformationMatrix, new: InformationMatrix) -> tuple[float, int]:
    """Return χ² of the coefficients' change, and its degrees of freedom: directions that both records determine."""
    basis = np.eye(healthy.score.size)
    for matrix in (healthy.matrix + new.matrix, healthy.matrix, new.matrix):
        values, vectors = np.linalg.eigh(basis.T @ matrix @ basis)
        basis = basis @ vectors[:, values > SETTINGS.nothing * max(float(values[-1]), np.finfo(float).tiny)]
        if not basis.size:
            return 0.0, 0
    found, spread = np.zeros(basis.shape[1]), np.zeros((basis.shape[1],) * 2)
    for each, sign in ((new, 1.0), (healthy, -1.0)):
        covariance = np.linalg.inv(basis.T @ each.matrix @ basis)
        found, spread = found + sign * covariance @ (basis.T @ each.score), spread + covariance
    return float(found @ np.linalg.solve(spread, found)), found.size


def probability(statistic: float, degrees: int) -> float:
    """Return the probability of such a change by chance."""
    return float(special.chdtrc(degrees, statistic)) if degrees else 1.0


@dataclass(frozen=True)
class VarianceRatio:
    """Variance of the residual over that of the healthy noise."""

    ratio: float
    probability: float  # by noise alone
    larger: bool  # significantly

    @classmethod
    def of(cls, ratio: float, samples: float, freedom: float, level: float) -> VarianceRatio:
        """Test a ratio over independent samples: χ², or F if the noise was estimated with `freedom`."""
        exact = math.isinf(freedom)
        tail = float(special.chdtrc(samples, samples * ratio) if exact else special.fdtrc(samples, freedom, ratio))
        return cls(ratio, tail, bool(ratio > SAME_VARIANCE_RATIO and tail < SETTINGS.level_share * level))
