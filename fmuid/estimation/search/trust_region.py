"""One step of Marquardt's search: the linear algebra (1.16), within bounds, and how long it may be.

Near a point θ the residual is nearly r + J p for a step p. Minimising ‖r + J p‖² + λ ‖D p‖² is the chapter's
θ − [J″ + λI]⁻¹ J′ with J″ ≈ 2 JᵀJ, only that each parameter is measured by its column's length D, so that λ has no unit
and the step does not depend on the units of the parameters. λ ≫ 1 is a short step along the gradient, λ = 0 the
Gauss–Newton step. The normal equations JᵀJ would square the condition number: instead [J r] is reduced once by
orthogonal reflections to a small triangle [R q], and every λ is solved from the singular values of R D⁻¹, where
‖D p‖ is a plain function of λ. λ is the one whose step has the length ‖D p‖ = Δ.

Bounds: a step that would leave them is stopped at the bound that it meets first, and the other parameters' step is
solved again with that one held there; what lies on a bound and is pushed outwards is held from the beginning.

The length follows the success of the steps before. Particular to simulations: a step to a point that cannot be
simulated is only too long, and below the noise of the simulation the criterion says nothing about a step, which is then
taken for what its prediction is worth.

References
----------
J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630, 1978;
S. Sun, J. Nocedal, "A trust region method for noisy unconstrained optimization", Math. Program. 202, 2023.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np
import scipy

from fmuid.array_types import Flags, Floats


@dataclass(frozen=True)
class TrustRegionSettings:
    """Numbers of a step and of its length; those on success are MINPACK's."""

    radius_tolerance: float = 0.1  # steps need not have the length Δ more precisely
    most_secular_iterations: int = 30  # of Newton's method for λ, which needs two or three
    smallest_singular_value: float = 1e-100  # below, quotients overflow
    least_gain: float = 1e-4  # of the fall predicted: a step that brings more is taken
    poor_gain: float = 0.25  # one that brings less shortens the next ...
    good_gain: float = 0.75  # ... and one that brings more lengthens it
    shrink_least: float = 0.5
    shrink_most: float = 0.1
    grow: float = 2.0
    noisy_miss: float = 0.5  # of a step half as long: a smooth function would miss by a quarter, noise by more
    noise_surprise: float = 10.0  # factor within which the noise measured at the start is believed


REGION = TrustRegionSettings()

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
    square = np.where(s > max(least, REGION.smallest_singular_value), s**2, np.inf)
    damping = 0.0
    for _ in range(REGION.most_secular_iterations):
        parts = sz / (square + damping)
        length = math.hypot(*parts.tolist())
        if length <= radius * (1.0 + REGION.radius_tolerance):
            break
        fall = float(np.sum((parts / length) ** 2 / (square + damping)))
        damping += (length / radius - 1.0) / fall
    return -(vt.T @ parts), damping


@dataclass(frozen=True)
class TrustRegion:
    """The longest ‖D p‖ of the next step.

    Attributes
    ----------
    value : float
    open : float
        The last one before simulations began to fail.
    rejections, failures : int
        Steps refused in a row, and how many of the last ones because their simulation failed.
    learnt_noise : float
        Noise of the criterion that was not seen at the start.
    missed : float, float
        Length of the last rejected step, and by how much it missed its prediction.
    """

    value: float
    open: float
    rejections: int = 0
    failures: int = 0
    learnt_noise: float = 0.0
    missed: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def of(cls, value: float) -> TrustRegion:
        """Return the first one."""
        return cls(value, value)

    def failed(self, length: float) -> TrustRegion:
        """Return a shorter one after a step of a length to where nothing can be simulated."""
        wide = self.open if self.failures else self.value
        value = REGION.poor_gain * min(self.value, length)
        return replace(self, value=value, open=wide, rejections=self.rejections + 1, failures=self.failures + 1)

    def judged(
        self, step: Step, length: float, fall: float, slope: float, noise: float, *, moved: bool
    ) -> tuple[TrustRegion, bool]:
        """Compare what a step did with what was predicted; return the next region, and whether the step is good.

        Parameters
        ----------
        step : Step
        length : float
            Its ‖D p‖.
        fall : float
            Of the criterion.
        slope : float
            Half the derivative of the criterion along the step.
        noise : float
            Standard deviation of the criterion's noise.
        moved : bool
            Whether the step is long enough to change any parameter in double precision.
        """
        value = self.value
        # the noise of both values on both sides (Sun and Nocedal): below it, a step is as good as predicted
        gain = (fall + 2.0 * noise) / (step.predicted + 2.0 * noise) if step.predicted + 2.0 * noise > 0 else 0.0
        if gain <= REGION.poor_gain:
            bend = -fall - 2.0 * slope
            least = -slope / bend if bend > 0 else REGION.shrink_least  # of the parabola along the step
            value = min(max(least, REGION.shrink_most), REGION.shrink_least) * min(self.value, length)
        elif gain >= REGION.good_gain or step.damping == 0.0:
            value = REGION.grow * length
        if gain >= REGION.least_gain and moved:
            return TrustRegion(value, self.open, learnt_noise=self.learnt_noise), True
        miss = abs(fall - step.predicted)
        learnt, rejections = self._learnt(length, miss, noise), self.rejections + 1
        return TrustRegion(value, self.open, rejections, learnt_noise=learnt, missed=(length, miss)), False

    def _learnt(self, length: float, miss: float, noise: float) -> float:
        """Return what noise was not seen at the start, by steps that are refused at ever shorter lengths."""
        shorter, before = length <= self.missed[0] / 2.0, self.missed[1]
        noisy = shorter and REGION.noisy_miss * before < miss < REGION.noise_surprise * noise
        return max(self.learnt_noise, miss) if noisy else self.learnt_noise

    def reopened(self, *, fully: bool) -> TrustRegion:
        """Return what it was before the rejections: the step that was refused may be good with a better Jacobian."""
        value = math.inf if fully else self.value / REGION.shrink_most**self.rejections
        return replace(self, value=value, rejections=0)
