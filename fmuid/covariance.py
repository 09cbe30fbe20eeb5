"""What the Jacobian at the optimum says of the parameters: their covariance (1.31), and what the data leave open.

Everything follows from the singular values of the whitened Jacobian with its columns scaled by the parameters'
magnitudes, J M = U S Vᵀ. Along the direction v_i the parameters (relative to their magnitudes) have the standard
deviation 1/s_i. A direction along which this exceeds 100 % is hardly determined; where s_i is not even distinguishable
from zero by the accuracy of the Jacobian, it is not determined at all, and its parameters have no finite variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmuid.estimators.steps import triangle

Floats = NDArray[np.float64]

# A direction whose standard deviation exceeds this share of the parameters' magnitudes is hardly determined.
WEAK_STD = 1.0
# Singular values are zero where they are below so many times the error that finite differences may have made.
JACOBIAN_ERRORS = 5.0
# Parameters with less than this share of a direction's largest component are left out of its words ...
WORTH_NAMING = 0.05
# ... and are no longer considered part of an undetermined direction below this share.
INVOLVED = 1e-3
# Of all coefficients in words, so many digits are shown.
DIGITS = 3


@dataclass(frozen=True, eq=False)
class LocalCovariance:
    """Covariance of the parameters, and the directions that are not or hardly determined.

    Attributes
    ----------
    covariance : (N, N) array
        (JᵀJ)⁻¹ of the whitened Jacobian; infinite variances and NaN covariances for parameters that are not determined.
    undetermined, weak : tuple of str
        Sentences, one a direction.
    leverage : (n_rows,) array
        How much of the parameters each row determines, the diagonal of the hat matrix; its sum is the number of
        directions that the data determine.
    """

    covariance: Floats
    undetermined: tuple[str, ...]
    weak: tuple[str, ...]
    leverage: Floats


def local_covariance(
    names: Sequence[str], jacobian: Floats, magnitudes: Floats, jacobian_error: Floats, prior_rows: int = 0
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
    """
    reduced = triangle(jacobian, np.zeros(len(jacobian)))[:, :-1] * magnitudes
    _, values, directions = np.linalg.svd(reduced)
    values = np.concatenate([values, np.zeros(len(names) - values.size)])
    rounding = np.finfo(float).eps * max(jacobian.shape) * values[0]
    zero = values <= max(rounding, JACOBIAN_ERRORS * float(np.linalg.norm(jacobian_error * magnitudes)))
    prior = jacobian[len(jacobian) - prior_rows :] * magnitudes
    by_prior = np.linalg.norm(prior @ directions.T, axis=0)
    unseen = zero  # by the data
    values = np.where(unseen, by_prior, values)
    zero = unseen & (by_prior <= np.finfo(float).eps * len(names) * float(np.linalg.norm(prior)))
    inverse = np.where(zero, 0.0, 1.0 / np.where(zero, 1.0, values))
    root = magnitudes[:, None] * directions.T * inverse
    covariance = root @ root.T
    null = directions[zero]
    lost = (np.abs(null) > INVOLVED).any(axis=0) if zero.any() else np.zeros(len(names), dtype=np.bool_)
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    undetermined = tuple(describe_lost(names, row * magnitudes, magnitudes) for row in _sparse(null))
    weak = tuple(
        describe_weak(names, direction * magnitudes, magnitudes, 1.0 / value)
        for direction, value in zip(directions[~zero], values[~zero], strict=True)
        if value < 1.0 / WEAK_STD
    )
    return LocalCovariance(covariance, undetermined, weak, np.sum((jacobian @ root[:, ~unseen]) ** 2, axis=1))


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


def _main(direction: Floats, magnitudes: Floats) -> list[int]:
    size = np.abs(direction) / magnitudes
    return [int(i) for i in np.flatnonzero(size >= WORTH_NAMING * size.max())]


def _combinations(names: Sequence[str], direction: Floats, main: Sequence[int]) -> str:
    """Return the combinations that stay the same along a direction: θ_i − (v_i/v_last) θ_last."""
    last = main[-1]
    found = []
    for i in main[:-1]:
        share = -direction[i] / direction[last]
        found.append(f"{names[i]} {'-' if share < 0 else '+'} {_times(abs(share), names[last])}")
    return _listed(found)


def _times(factor: float, name: str) -> str:
    shown = f"{factor:.{DIGITS}g}"
    return name if shown == "1" else f"{shown} {name}"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def describe_lost(names: Sequence[str], direction: Floats, magnitudes: Floats) -> str:
    """Say in words that moving the parameters along a direction changes no output.

    Parameters
    ----------
    names : sequence of str
    direction : (N,) array
        In the parameters' units.
    magnitudes : (N,) array
    """
    main = _main(direction, magnitudes)
    who = _listed([names[i] for i in main])
    if len(main) == 1:
        return f"{who} is not determined: changing it changes no output"
    only = _combinations(names, direction, main)
    if len(main) == 2:
        return f"{who} cannot be told apart: only {only} is determined"
    scaled = direction / direction[main[0]]
    moves = [f"{names[i]} {'rises' if scaled[i] > 0 else 'falls'} by {abs(scaled[i]):.{DIGITS}g}" for i in main[1:]]
    return (
        f"{who} cannot be told apart: raising {names[main[0]]} by 1 while {_listed(moves)} changes no output; "
        f"only {only} are determined"
    )


def describe_weak(names: Sequence[str], direction: Floats, magnitudes: Floats, std: float) -> str:
    """Say in words that a direction is hardly determined; `std` is relative to the magnitudes."""
    main = _main(direction, magnitudes)
    who = _listed([names[i] for i in main])
    if len(main) == 1:
        return f"{who} is hardly determined: its standard deviation is {std:.0%} of its magnitude"
    only = _combinations(names, direction, main)
    verb = "is" if len(main) == 2 else "are"
    return (
        f"{who} can hardly be told apart: {only} {verb} determined better than each of them, "
        f"whose standard deviation together is {std:.0%} of their magnitude"
    )
