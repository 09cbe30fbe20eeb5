"""One Levenberg–Marquardt step within bounds, and its trust region (docs/method/optimization.md).

References: Moré, Lecture Notes in Mathematics 630, 1978; Sun and Nocedal, Math. Program. 202, 2023.
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
    """Numbers of a step and its length; those on success are MINPACK's."""

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
    """Step p (N,), λ, predicted reduction of ‖r‖², parameters at bounds."""

    step: Floats
    damping: float
    predicted: float
    held: Flags


def triangle(jacobian: Floats, residual: Floats) -> Floats:
    """Return [R q] (N+1, N+1) with ‖R p + q‖ = ‖J p + r‖."""
    rows, count = jacobian.shape
    both = np.empty((rows, count + 1), order="F")
    both[:, :count], both[:, count] = jacobian, residual
    reduced = scipy.linalg.lapack.dgeqrf(both, overwrite_a=True)[0]
    return np.where(_upper(*reduced[: count + 1].shape), reduced[: count + 1], 0.0)


@cache
def _upper(rows: int, columns: int) -> Flags:
    return np.triu(np.ones((rows, columns), dtype=np.bool_))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Residual near a point, ‖R p + q‖ for a step p."""

    reduced: Floats  # (k, N+1), [R q] of `triangle`
    lengths: Floats  # (N,), diagonal of D
    least: float = 0.0  # singular values of R D⁻¹ up to this one count as zero
    decomposed: Decomposed | None = None  # SVD of R D⁻¹

    def length(self, step: Floats) -> float:
        """Return ‖D p‖ of a step p (N,)."""
        scaled = self.lengths * step
        return math.sqrt(float(scaled @ scaled))

    def step(self, lower: Floats, upper: Floats, radius: float = math.inf) -> Step:
        """Minimize ‖R p + q‖² for lower ≤ p ≤ upper and ‖D p‖ ≤ radius.

        The distances to the bounds (N,) are ≤ 0 and ≥ 0. An infinite radius gives the Gauss–Newton step.
        """
        matrix, vector, lengths = self.reduced[:, :-1], self.reduced[:, -1], self.lengths
        scaled, slope = matrix / lengths, matrix.T @ vector
        step = np.zeros(lengths.size)
        held = ((lower >= 0) & (slope > 0)) | ((upper <= 0) & (slope < 0))
        damping = 0.0
        while not held.all():
            free = ~held
            target = vector + matrix[:, held] @ step[held]
            known = self.decomposed if self.decomposed is not None and free.all() else _svd(scaled[:, free])
            inner, damping = _damped(known, target, radius, self.least)
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
    """Minimize ‖A p + b‖² + λ‖p‖² with ‖p‖ ≤ radius; Newton's method on 1/‖p‖ − 1/Δ finds λ (Hebden, Moré)."""
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
    """Maximum ‖D p‖ of the next step."""

    value: float
    open: float  # before simulations began to fail
    rejections: int = 0  # in a row
    failures: int = 0  # last rejections by failed simulations
    learnt_noise: float = 0.0  # of the cost, not visible at the start
    missed: tuple[float, float] = (0.0, math.inf)  # length and prediction error of the last rejection

    @classmethod
    def of(cls, value: float) -> TrustRegion:
        """Return the first region."""
        return cls(value, value)

    def failed(self, length: float) -> TrustRegion:
        """Return a smaller region after a failed simulation."""
        wide = self.open if self.failures else self.value
        value = REGION.poor_gain * min(self.value, length)
        return replace(self, value=value, open=wide, rejections=self.rejections + 1, failures=self.failures + 1)

    def judged(
        self, step: Step, length: float, fall: float, slope: float, noise: float, *, moved: bool
    ) -> tuple[TrustRegion, bool]:
        """Compare a step of length ‖D p‖ with its prediction; return the next region and acceptance.

        `slope`: half the cost's derivative along the step; `moved`: False if rounding undoes the step.
        """
        value = self.value
        # noise of both values on both sides (Sun and Nocedal): below it, a step is as good as predicted
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
        """Return noise that refused steps at ever shorter lengths reveal."""
        shorter, before = length <= self.missed[0] / 2.0, self.missed[1]
        noisy = shorter and REGION.noisy_miss * before < miss < REGION.noise_surprise * noise
        return max(self.learnt_noise, miss) if noisy else self.learnt_noise

    def reopened(self, *, fully: bool) -> TrustRegion:
        """Return the region before the rejections, for a better Jacobian."""
        value = math.inf if fully else self.value / REGION.shrink_most**self.rejections
        return replace(self, value=value, rejections=0)
