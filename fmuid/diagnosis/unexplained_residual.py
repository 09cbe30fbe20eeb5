"""Something else: a change that no listed cause explains, by what the residual still owes to the inputs.

The variance of the residual hardly shows it: a change that is small against the noise but goes with the inputs is
seen in the regression of the residual on lagged inputs and a constant, the model's own columns projected out. Lags go
in spans that double, as a response fades: few coefficients, so that little chance is let in. Only the *change* of the
coefficients from the healthy record to the new one counts, so that what the healthy model does not know is no alarm.
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
    """Numbers of the tests of what no cause explains.

    Attributes
    ----------
    level_share : float
        Of the level, spent on what no cause explains, so that the level as a whole is met.
    spans : tuple of int
        Lags of the inputs, in samples; those from each to before the next are one regressor, their sum.
    nothing : float
        Directions of the regressors with so little information, against the best, say nothing.
    spanned : float
        Columns of the model that go together up to this share span no direction more.
    """

    level_share: float = 0.1
    spans: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32)
    nothing: float = 1e-8
    spanned: float = 1e-12


SETTINGS = UnexplainedSettings()


@dataclass(frozen=True)
class UnexplainedResidual:
    """What no cause explains.

    Attributes
    ----------
    statistic : float
        χ² of the change of what the residual owes to the inputs.
    degrees : int
        Of freedom.
    probability : float
        That chance alone changes it so much.
    """

    statistic: float
    degrees: int
    probability: float


NOTHING_LEFT = UnexplainedResidual(0.0, 0, 1.0)


def lagged(inputs: Floats, spans: Sequence[int] = SETTINGS.spans) -> Floats:
    """Return a constant and the inputs (n, m) before, summed over spans of lags: (n, 1 + (len(spans) - 1) m)."""
    sums = np.vstack([np.zeros((1, inputs.shape[1])), np.cumsum(inputs, axis=0)])
    ends = 1 + np.arange(len(inputs))
    until = [sums[np.maximum(ends - lag, 0)] for lag in spans]
    return np.hstack([np.ones((len(inputs), 1)), *(a - b for a, b in itertools.pairwise(until))])


def regression(residual: Floats, regressors: Floats, jacobian: Floats) -> InformationMatrix:
    """Return what a residual says of its regression on some columns, beside the model's own.

    Parameters
    ----------
    residual : (n,) array
        Whitened.
    regressors : (n, k) array
        Whitened like it.
    jacobian : (n, N) array
        Of the fitted coordinates, whitened: what they could have taken out of the residual.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    basis, values, _ = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1.0), full_matrices=False)
    spanned = basis[:, values > SETTINGS.spanned * values.max(initial=0.0)]
    shared = spanned.T @ regressors
    return InformationMatrix(
        regressors.T @ regressors - shared.T @ shared, regressors.T @ residual - shared.T @ (spanned.T @ residual)
    )


def change(healthy: InformationMatrix, new: InformationMatrix) -> tuple[float, int]:
    """Return the χ² of the change of the coefficients between two records, and its degrees of freedom.

    Directions that either record does not determine are left out.
    """
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
    """Return how likely chance alone changes the coefficients so much."""
    return float(special.chdtrc(degrees, statistic)) if degrees else 1.0


@dataclass(frozen=True)
class VarianceRatio:
    """The residual against the noise of the healthy machine.

    Attributes
    ----------
    ratio : float
        Of the variances.
    probability : float
        That noise alone gives as much.
    larger : bool
        Whether that is too unlikely.
    """

    ratio: float
    probability: float
    larger: bool

    @classmethod
    def of(cls, ratio: float, samples: float, freedom: float, level: float) -> VarianceRatio:
        """Test a ratio over independent samples: χ², or F where the noise was estimated with `freedom`."""
        exact = math.isinf(freedom)
        tail = float(special.chdtrc(samples, samples * ratio) if exact else special.fdtrc(samples, freedom, ratio))
        return cls(ratio, tail, bool(ratio > SAME_VARIANCE_RATIO and tail < SETTINGS.level_share * level))
