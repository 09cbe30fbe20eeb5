"""One step of Marquardt's search: the linear algebra (1.16), within bounds.

Near a point θ the residual is nearly r + J p for a step p. Minimising ‖r + J p‖² + λ ‖D p‖² is the chapter's
θ − [J″ + λI]⁻¹ J′ with J″ ≈ 2 JᵀJ, only that each parameter is measured by its column's length D, so that λ has no unit
and the step does not depend on the units of the parameters. λ ≫ 1 is a short step along the gradient, λ = 0 the
Gauss–Newton step. The normal equations JᵀJ would square the condition number: instead [J r] is reduced once by
orthogonal reflections to a small triangle [R q], and every λ is solved from the singular values of R D⁻¹, where
‖D p‖ is a plain function of λ. λ is the one whose step has the length ‖D p‖ = Δ.

Bounds: a step that would leave them is stopped at the bound that it meets first, and the other parameters' step is
solved again with that one held there; what lies on a bound and is pushed outwards is held from the beginning.

References
----------
J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630, 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import numpy as np
import scipy

from fmuid.array_types import Flags, Floats

# Steps need not have the length Δ more precisely than this.
RADIUS_TOLERANCE = 0.1
MOST_SECULAR_ITERATIONS = 30
# Singular values below this one are zero whatever the accuracy, or quotients overflow.
SMALLEST_SINGULAR_VALUE = 1e-100


Decomposed: TypeAlias = tuple[Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class Step:
    """A step p (N,), its λ, the fall of ‖r‖² that the linear model predicts, and what was held at a bound (N,)."""

    step: Floats
    damping: float
    predicted: float
    held: Flags


def triangle(jacobian: Floats, residual: Floats) -> Floats:
    """Return the small matrix [R q] (N+1, N+1) with ‖R p + q‖ = ‖J p + r‖ for every p.

    Householder reflections on [J r] (LAPACK geqrf). The last column's last entry is what no step changes.
    """
    rows, count = jacobian.shape
    both = np.empty((rows, count + 1), order="F")
    both[:, :count], both[:, count] = jacobian, residual
    reduced = scipy.linalg.lapack.dgeqrf(both, overwrite_a=True)[0]
    return np.where(_upper(*reduced[: count + 1].shape), reduced[: count + 1], 0.0)


@cache
def _upper(rows: int, columns: int) -> Flags:
    return np.triu(np.ones((rows, columns), dtype=np.bool_))


def best_step(
    reduced: Floats,
    lengths: Floats,
    lower: Floats,
    upper: Floats,
    radius: float = math.inf,
    least: float = 0.0,
    decomposed: Decomposed | None = None,
) -> Step:
    """Return the step that minimises ‖R p + q‖² within lower ≤ p ≤ upper and ‖D p‖ ≤ radius.

    Parameters
    ----------
    reduced : (k, N+1) array
        [R q] of `triangle`.
    lengths : (N,) array
        The diagonal of D.
    lower, upper : (N,) arrays
        Distances to the bounds, ≤ 0 and ≥ 0.
    radius : float
        Longest ‖D p‖ of the free parameters; infinite for the Gauss–Newton step.
    least : float
        Singular values of R D⁻¹ up to this one are taken as zero, and no step goes in their directions.
    decomposed : U, S and Vᵀ, optional
        The singular value decomposition of R D⁻¹, where it is known.
    """
    matrix, vector = reduced[:, :-1], reduced[:, -1]
    scaled, slope = matrix / lengths, matrix.T @ vector
    step = np.zeros(lengths.size)
    held = ((lower >= 0) & (slope > 0)) | ((upper <= 0) & (slope < 0))
    damping = 0.0
    while not held.all():
        free = ~held
        target = vector + matrix[:, held] @ step[held]
        known = decomposed if decomposed is not None and free.all() else _svd(scaled[:, free])
        inner, damping = _damped(known, target, radius, least)
        step[free] = inner / lengths[free]
        above, below = step > upper, step < lower
        if not (above | below).any():
            break
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reach = np.where(above, upper / step, np.where(below, lower / step, np.inf))
        first = int(np.argmin(reach))
        step[first] = upper[first] if above[first] else lower[first]
        held[first] = True
    after = matrix @ step + vector
    return Step(step, damping, float(vector @ vector - after @ after), held)


def _svd(matrix: Floats) -> Decomposed:
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    return u, s, vt


def _damped(decomposed: Decomposed, vector: Floats, radius: float, least: float) -> tuple[Floats, float]:
    """Return the p that minimises ‖A p + b‖² + λ‖p‖², and λ ≥ 0 such that ‖p‖ is at most about the radius.

    With A = U S Vᵀ and z = Uᵀb, p = −V S z/(S² + λ); 1/‖p‖ is nearly linear in λ, which is why Newton's method on
    1/‖p‖ − 1/Δ (Hebden, Moré) needs two or three steps. Singular values that may as well be zero move nothing.
    """
    u, s, vt = decomposed
    sz = s * (u.T @ vector)
    least = min(max(least, np.finfo(float).eps * max(len(u), vt.shape[1]) * s[0]), s[0] / 2.0)
    square = np.where(s > max(least, SMALLEST_SINGULAR_VALUE), s**2, np.inf)
    damping = 0.0
    for _ in range(MOST_SECULAR_ITERATIONS):
        parts = sz / (square + damping)
        length = math.hypot(*parts.tolist())
        if length <= radius * (1.0 + RADIUS_TOLERANCE):
            break
        fall = float(np.sum((parts / length) ** 2 / (square + damping)))
        damping += (length / radius - 1.0) / fall
    return -(vt.T @ parts), damping
