"""Covariance and identifiability from the Jacobian at the optimum (1.31).

With J M = U S Vᵀ (M: magnitudes), the relative standard deviation along v_i is 1/s_i. A robust loss needs a sandwich:
`local_covariance` takes √mean ψ′ J and the spread √(mean ψ²/mean ψ′) (P. J. Huber, Robust Statistics, Wiley 1981, 7.6).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.search.trust_region import triangle


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """Limits of identifiability, and of named components."""

    weak_std: float = 1.0  # weakly identifiable: larger relative σ
    lost_std: float = 10.0  # practically non-identifiable: larger; sign and power of ten are unknown
    astray_std: float = 100.0  # the same against the initial scale, if σ exceeds the estimate too: wandering hides σ
    jacobian_errors: float = 2.0  # times the foreseen error: singular values below are zero; usual are 0.1 to 1
    named_share: float = 0.05  # minimum component of a named parameter, of the largest
    rounding_share: float = 1e-6  # of the measured values: smaller residuals are no noise
    involved_share: float = 1e-3  # minimum component of a parameter with infinite variance


LIMITS = IdentifiabilitySettings()


def check_level(level: float, of: str = "an interval") -> None:
    """Raise `InputError` unless a level lies between 0 and 1."""
    if not (isinstance(level, float | np.floating) and 0.0 < level < 1.0):
        raise InputError(f"the level of {of} must lie between 0 and 1, not {level!r}")


class IdentifiabilityLevel(Enum):
    """Identifiability along a direction."""

    NOT = "not"  # no effect on the outputs
    HIDDEN = "hidden"  # effect below the simulation error
    NOT_IN_EFFECT = "not_in_effect"  # relative σ above `LIMITS.lost_std`
    HARDLY = "hardly"  # relative σ above `LIMITS.weak_std`


@dataclass(frozen=True)
class ActiveBound:
    """Parameter at a bound.

    Attributes
    ----------
    name : str
    value : float
        The bound.
    """

    name: str
    value: float


@dataclass(frozen=True)
class WeakDirection:
    """Direction in parameter space that is not or weakly identifiable.

    Attributes
    ----------
    level : IdentifiabilityLevel
    names : tuple of str
        Parameters with the largest components.
    coefficients : tuple of float
        Components in the units of the parameters; any length.
    std : float
        Standard deviation relative to the magnitudes; infinite if not identifiable.
    values, magnitudes : tuple of float
        Values and magnitudes of these parameters.
    """

    level: IdentifiabilityLevel
    names: tuple[str, ...]
    coefficients: tuple[float, ...]
    std: float
    values: tuple[float, ...]
    magnitudes: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.coefficients) == len(self.values) == len(self.magnitudes) > 0:
            raise ValueError("a direction has not as many numbers as names")


@dataclass(frozen=True, eq=False)
class LocalCovariance:
    """Covariance of the parameters, and weak directions."""

    covariance: Floats  # (N, N), (JᵀJ)⁻¹; if not identifiable, variances are infinite and covariances NaN
    undetermined: tuple[WeakDirection, ...]
    weak: tuple[WeakDirection, ...]
    rank: int  # number of directions with a finite variance
    root: Floats  # (N, k), R Rᵀ is the covariance along the k directions that the data determine

    def leverage(self, jacobian: Floats) -> Floats:
        """Return the diagonal (n_rows,) of the hat matrix; its sum is k."""
        columns = self.root.T @ jacobian.T
        return np.asarray(np.einsum("ij,ij->j", columns, columns), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class WhitenedJacobian:
    """Jacobian of the whitened residual, with its errors."""

    rows: Floats  # (n_rows, N), the prior's rows are the last
    error: Floats  # (N,), norm of the error of each column
    prior_rows: int = 0  # number of rows of the prior, without error
    spread: Floats | None = None  # (n_rows,), standard deviation of each row; default 1
    reduced: Floats | None = None  # (N+1, N+1), triangle of the Jacobian and any residual, if known


def local_covariance(
    names: Sequence[str],
    given: WhitenedJacobian,
    magnitudes: Floats,
    *,
    theta: Floats | None = None,
    scale: Floats | None = None,
) -> LocalCovariance:
    """Return covariance and identifiability of a whitened Jacobian.

    `theta`, and the initial `scale`, by which estimates near zero stay identifiable, are the magnitudes by default.
    """
    jacobian, prior_rows = given.rows, given.prior_rows
    reduced = triangle(jacobian, np.zeros(len(jacobian))) if given.reduced is None else given.reduced
    reduced = reduced[:, :-1] * magnitudes
    _, values, directions = np.linalg.svd(reduced)
    values = np.concatenate([values, np.zeros(len(names) - values.size)])
    rounding = np.finfo(float).eps * max(jacobian.shape) * values[0]
    # the errors of the columns have nothing to do with each other
    seen = LIMITS.jacobian_errors * np.linalg.norm(directions * given.error * magnitudes, axis=1)
    unseen = values <= np.maximum(rounding, seen)
    prior = jacobian[len(jacobian) - prior_rows :] * magnitudes
    by_prior = np.linalg.norm(prior @ directions.T, axis=0)
    values = np.where(unseen, by_prior, values)
    zero = unseen & (by_prior <= np.finfo(float).eps * len(names) * float(np.linalg.norm(prior)))
    inverse = np.where(zero, 0.0, 1.0 / np.where(zero, 1.0, values))
    root = magnitudes[:, None] * directions.T * inverse
    middle = np.eye(len(names))
    with np.errstate(over="ignore"):  # an infinite variance is what it says
        if given.spread is not None:
            rows = jacobian @ root * given.spread[:, None]
            rows[: len(rows) - prior_rows, unseen] = 0.0  # error of the data's rows
            middle = rows.T @ rows
        covariance = root @ middle @ root.T
    null = directions[zero]
    lost = (np.abs(null) > LIMITS.involved_share).any(axis=0) if zero.any() else np.zeros(len(names), dtype=np.bool_)
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    named = partial(_direction, names, magnitudes if theta is None else theta, magnitudes)
    first = magnitudes if scale is None else scale
    undetermined, weak = [], []
    for row in _sparse(null):
        effect, error = (float(np.linalg.norm(part)) for part in (reduced @ row, given.error * magnitudes * row))
        none = max(rounding, min(LIMITS.jacobian_errors * error, float(np.linalg.norm(row)) / LIMITS.lost_std))
        level = IdentifiabilityLevel.NOT if effect <= none else IdentifiabilityLevel.HIDDEN
        undetermined.append(named(level, row, math.inf))
    for direction, std in zip(directions[~zero], (1.0 / values[~zero]).tolist(), strict=True):
        if _lost_in_effect(np.abs(direction) * std * magnitudes, magnitudes, first):
            undetermined.append(named(IdentifiabilityLevel.NOT_IN_EFFECT, direction, std))
        elif std > LIMITS.weak_std:
            weak.append(named(IdentifiabilityLevel.HARDLY, direction, std))
    rank = len(names) - int(zero.sum())
    return LocalCovariance(covariance, tuple(undetermined), tuple(weak), rank, root[:, ~unseen])


def _direction(
    names: Sequence[str], theta: Floats, magnitudes: Floats, level: IdentifiabilityLevel, relative: Floats, std: float
) -> WeakDirection:
    """Return a direction of relative components (N,), without the small ones."""
    main = np.flatnonzero(np.abs(relative) >= LIMITS.named_share * np.abs(relative).max()).tolist()
    coefficients, values, sizes = (tuple(each[main].tolist()) for each in (relative * magnitudes, theta, magnitudes))
    return WeakDirection(level, tuple(names[i] for i in main), coefficients, std, values, sizes)


def _lost_in_effect(std: Floats, magnitudes: Floats, scale: Floats) -> bool:
    """Return True if σ (N,) along a direction is too large."""
    beyond = std > LIMITS.lost_std * np.maximum(magnitudes, scale)
    astray = (std > LIMITS.astray_std * scale) & (std > magnitudes)
    return bool((beyond | astray).any())


def _sparse(rows: Floats) -> list[Floats]:
    """Return a basis of the same space by elimination; each row has few parameters."""
    basis = rows.copy()
    used: list[int] = []
    for k in range(len(basis)):
        candidates = np.abs(basis[k])
        candidates[used] = 0.0
        pivot = int(np.argmax(candidates))
        used.append(pivot)
        basis[k] /= basis[k, pivot]
        for other in range(len(basis)):
            if other != k:
                basis[other] -= basis[other, pivot] * basis[k]
    return list(basis)
