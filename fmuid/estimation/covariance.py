"""What the Jacobian at the optimum says of the parameters: their covariance (1.31), and what the data leave open.

Everything follows from the singular values of the whitened Jacobian with its columns scaled by the parameters'
magnitudes, J M = U S Vᵀ. Along the direction v_i the parameters (relative to their magnitudes) have the standard
deviation 1/s_i. A direction along which this exceeds 100 % is hardly determined, and where it exceeds 1000 %, not
determined in effect. Where s_i is not even distinguishable from zero by the accuracy of the Jacobian, the direction is
not determined at all, and its parameters have no finite variance.

A robust loss follows the noise less closely than the sum of squares does: with ψ(f) the influence of a residual, the
estimate scatters as H⁻¹ (Σ ψ² J Jᵀ + prior) H⁻¹ with H = Σ ψ′ J Jᵀ + prior, each output's ψ′ and ψ² taken at their
means (Huber, section 7.6, a "sandwich"): `local_covariance` is given √mean ψ′ J, and the spread √(mean ψ²/mean ψ′).

References
----------
P. J. Huber, "Robust Statistics", Wiley 1981.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.errors import InputError
from fmuid.estimation.search.trust_region import triangle

# A direction whose standard deviation exceeds this share of the parameters' magnitudes is hardly determined ...
WEAK_STD = 1.0
# ... and not determined in effect beyond this: not even the sign and the power of ten of the parameters are known then,
# and the linear model, on which the standard deviation rests, holds nowhere near so far.
UNDETERMINED_STD = 10.0
# Estimates wander about as far as their standard deviations, and so hide how large these are: a direction is not
# determined in effect either where they exceed so many times the magnitude at the start and the estimate too.
ASTRAY_STD = 100.0
# Singular values are zero where they are below so many times the error that finite differences may have made along
# their direction: where nothing is determined they come out at 0.1 to 1 times what is foreseen of it.
JACOBIAN_ERRORS = 2.0
# Parameters with less than this share of a direction's largest component are no part of what is told of it.
NAMED_SHARE = 0.05
# Below this share they are no longer considered part of an undetermined direction.
INVOLVED_SHARE = 1e-3


def check_level(level: float, of: str = "an interval") -> None:
    """Check the level of an interval or a region: an `InputError` if it is not between 0 and 1."""
    if not (isinstance(level, float | np.floating) and 0.0 < level < 1.0):
        raise InputError(f"the level of {of} must lie between 0 and 1, not {level!r}")


class Identifiability(Enum):
    """How little is known along a direction, within the limits above."""

    NOT = "not"
    """Moving along it changes nothing, or less than could ever tell the parameters."""
    HIDDEN = "hidden"
    """Moving along it changes the outputs by no more than the simulation's errors, which are large enough to hide what
    data can tell."""
    NOT_IN_EFFECT = "not_in_effect"
    """The standard deviation is so large that not even the parameters' power of ten is known."""
    HARDLY = "hardly"
    """The standard deviation is larger than the parameters' own magnitudes."""


@dataclass(frozen=True)
class ActiveBound:
    """A parameter that lies on a bound, which the data would push it beyond.

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
    """A direction of the parameters that is not, or hardly, determined.

    Attributes
    ----------
    determined : Identifiability
    names : tuple of str
        The parameters that move most along it.
    coefficients : tuple of float
        How far each of them moves, in its unit; the whole has any length.
    std : float
        Standard deviation along it, relative to the parameters' magnitudes; infinite where it is not determined.
    values, magnitudes : tuple of float
        The parameters where this was found, and how large each is.
    """

    determined: Identifiability
    names: tuple[str, ...]
    coefficients: tuple[float, ...]
    std: float
    values: tuple[float, ...]
    magnitudes: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.coefficients) == len(self.values) == len(self.magnitudes) > 0:
            raise ValueError("a direction has not as many numbers as names")

    @classmethod
    def of(
        cls,
        determined: Identifiability,
        names: Sequence[str],
        relative: Floats,
        std: float,
        theta: Floats,
        magnitudes: Floats,
    ) -> WeakDirection:
        """Return a direction (N,) that is relative to the magnitudes, without the parameters that hardly move."""
        size = np.abs(relative)
        main = np.flatnonzero(size >= NAMED_SHARE * size.max()).tolist()
        return cls(
            determined,
            tuple(names[i] for i in main),
            tuple((relative * magnitudes)[main].tolist()),
            std,
            tuple(theta[main].tolist()),
            tuple(magnitudes[main].tolist()),
        )


@dataclass(frozen=True, eq=False)
class LocalCovariance:
    """Covariance of the parameters, and the directions that are not or hardly determined.

    Attributes
    ----------
    covariance : (N, N) array
        (JᵀJ)⁻¹ of the whitened Jacobian; infinite variances and NaN covariances for parameters that are not determined.
    undetermined, weak : tuple of WeakDirection
        What is not determined, at all first, then in effect; what is hardly determined.
    rank : int
        How many directions are determined at all, if only in theory: those of finite variance.
    root : (N, k) array
        R with R Rᵀ the covariance along the k directions that the data themselves determine.
    """

    covariance: Floats
    undetermined: tuple[WeakDirection, ...]
    weak: tuple[WeakDirection, ...]
    rank: int
    root: Floats

    def leverage(self, jacobian: Floats) -> Floats:
        """Return how much of the parameters each row of the Jacobian determines (n_rows,), the hat matrix's diagonal.

        Its sum is the number of directions that the data determine.
        """
        columns = self.root.T @ jacobian.T
        return np.asarray(np.einsum("ij,ij->j", columns, columns), dtype=np.float64)


def local_covariance(
    names: Sequence[str],
    jacobian: Floats,
    magnitudes: Floats,
    jacobian_error: Floats,
    prior_rows: int = 0,
    *,
    theta: Floats | None = None,
    scale: Floats | None = None,
    spread: Floats | None = None,
    reduced: Floats | None = None,
) -> LocalCovariance:
    """Analyse a whitened Jacobian.

    Parameters
    ----------
    names : sequence of str
    jacobian : (n_rows, N) array
        Of the whitened residual; with the prior's rows where they are to count.
    magnitudes : (N,) array
        How large each parameter is.
    jacobian_error : (N,) array
        Norm of the error of each column.
    prior_rows : int
        How many of the last rows are the prior's; they have no error, and what they say of a direction counts even
        where it is less than the errors of the others.
    theta : (N,) array, optional
        The parameters, which directions are told with. Default: the magnitudes.
    scale : (N,) array, optional
        How large each parameter was thought to be at the start: an estimate that happens to lie near zero is not
        undetermined for that. Default: the magnitudes.
    spread : (n_rows,) array, optional
        Standard deviation of each row; default 1.
    reduced : (N+1, N+1) array, optional
        The triangle of the Jacobian and any residual, where it is known.
    """
    reduced = triangle(jacobian, np.zeros(len(jacobian))) if reduced is None else reduced
    reduced = reduced[:, :-1] * magnitudes
    _, values, directions = np.linalg.svd(reduced)
    values = np.concatenate([values, np.zeros(len(names) - values.size)])
    rounding = np.finfo(float).eps * max(jacobian.shape) * values[0]
    # the errors of the columns have nothing to do with each other
    unseen = values <= np.maximum(
        rounding, JACOBIAN_ERRORS * np.linalg.norm(directions * jacobian_error * magnitudes, axis=1)
    )
    prior = jacobian[len(jacobian) - prior_rows :] * magnitudes
    by_prior = np.linalg.norm(prior @ directions.T, axis=0)
    values = np.where(unseen, by_prior, values)
    zero = unseen & (by_prior <= np.finfo(float).eps * len(names) * float(np.linalg.norm(prior)))
    inverse = np.where(zero, 0.0, 1.0 / np.where(zero, 1.0, values))
    root = magnitudes[:, None] * directions.T * inverse
    with np.errstate(over="ignore"):  # an infinite variance is what it says
        middle = np.eye(len(names)) if spread is None else _gram(jacobian @ root, spread, unseen, prior_rows)
        covariance = root @ middle @ root.T
    null = directions[zero]
    lost = (np.abs(null) > INVOLVED_SHARE).any(axis=0) if zero.any() else np.zeros(len(names), dtype=np.bool_)
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    at = magnitudes if theta is None else theta
    undetermined, weak = [], []
    for row in _sparse(null):
        effect, error = (float(np.linalg.norm(part)) for part in (reduced @ row, jacobian_error * magnitudes * row))
        none = max(rounding, min(JACOBIAN_ERRORS * error, float(np.linalg.norm(row)) / UNDETERMINED_STD))
        determined = Identifiability.NOT if effect <= none else Identifiability.HIDDEN
        undetermined.append(WeakDirection.of(determined, names, row, math.inf, at, magnitudes))
    for direction, std in zip(directions[~zero], (1.0 / values[~zero]).tolist(), strict=True):
        if _lost_in_effect(np.abs(direction) * std * magnitudes, magnitudes, magnitudes if scale is None else scale):
            undetermined.append(WeakDirection.of(Identifiability.NOT_IN_EFFECT, names, direction, std, at, magnitudes))
        elif std > WEAK_STD:
            weak.append(WeakDirection.of(Identifiability.HARDLY, names, direction, std, at, magnitudes))
    rank = len(names) - int(zero.sum())
    return LocalCovariance(covariance, tuple(undetermined), tuple(weak), rank, root[:, ~unseen])


def _lost_in_effect(std: Floats, magnitudes: Floats, scale: Floats) -> bool:
    """Whether standard deviations along a direction, in the parameters' units (N,), leave any of them undetermined."""
    beyond = std > UNDETERMINED_STD * np.maximum(magnitudes, scale)
    astray = (std > ASTRAY_STD * scale) & (std > magnitudes)
    return bool((beyond | astray).any())


def _gram(rows: Floats, spread: Floats, unseen: Flags, prior_rows: int) -> Floats:
    """Return (J R)ᵀ spread² J R (N, N), which is the identity where every row's spread is 1.

    Along directions that only the prior determines, what the data's rows show is error.
    """
    rows = rows * spread[:, None]
    rows[: len(rows) - prior_rows, unseen] = 0.0
    return np.asarray(rows.T @ rows, dtype=np.float64)


def _sparse(rows: Floats) -> list[Floats]:
    """Return a basis of the same space with the zeros that elimination gives, so that each row names few parameters."""
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
