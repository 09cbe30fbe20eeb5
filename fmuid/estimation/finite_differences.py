"""Derivatives of whole simulations by finite differences, with steps from the simulation's own noise.

A simulator with an adaptive integrator inside is not a smooth function: between neighbouring parameter values its
steps and iterations change, and the outputs jump by something near its tolerance. A difference over a step that is
blind to this differentiates the jumps. So the noise is measured first
(`fmuid.estimation.simulation_noise`), and the steps balance it against the curvature of the simulation itself
(`FiniteDifferences`):

- forward: the error is at most 2 ε/h + |f″| h/2, least at h = 2 (ε/|f″|)^(1/2);
- central: the error is at most ε/h + |f‴| h²/6, least at h = (3 ε/|f‴|)^(1/3),

with ε the noise and f″, f‴ the derivatives, all as root mean squares over the samples.

References
----------
J. J. Moré, S. M. Wild, "Estimating derivatives of noisy simulations", ACM Trans. Math. Softw. 38 (3), 2012;
P. E. Gill, W. Murray, M. A. Saunders, M. H. Wright, "Computing forward-difference intervals for numerical
optimization", SIAM J. Sci. Stat. Comput. 4 (2), 1983 (the balance of the errors).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.errors import FmuidError
from fmuid.estimation.simulation_noise import Predict, usable

# Steps relative to a parameter's magnitude: a difference over more than a tenth says little about a derivative, and
# below the least one the parameter itself has too few digits left.
LARGEST_STEP = 0.1
SMALLEST_STEP = 1e-9
# A first difference below so many times the noise has no good digit: it is made again with the largest step.
RESOLVED_NOISES = 10.0
# A parameter acts on an output where some sample changes by more than so many times the noise of that output; the
# largest of 10⁴ normal differences is 5.5 times the noise, and integrators jump more coarsely than that.
INFLUENCE_NOISES = 10.0

# Where steps bend the function by this much of its slope they were too long (the first ones, chosen without knowledge
# of the curvature, for a strongly oscillating output, say), and the derivative is made again with the planned one.
LARGEST_BEND = 0.5

# Which points give a derivative, in steps from the point, in the order in which they are tried: away from a bound, and
# from simulations that fail, first to the other side and then closer.
CLOSER_STEPS = (1.0, 0.1, 1e-2, 1e-4, 1e-6)
FORWARD = tuple((side * h,) for h in CLOSER_STEPS for side in (1.0, -1.0))
CENTRAL = tuple((a * h, b * h) for h in CLOSER_STEPS for a, b in ((1.0, -1.0), (1.0, 2.0), (-1.0, -2.0)))


def parabola_slope(low: Floats, high: Floats, a: float | Floats, b: float | Floats) -> Floats:
    """Return the slope at 0 of the parabola through (a, low), (0, 0) and (b, high)."""
    return np.asarray((low * (b / a) - high * (a / b)) / (b - a), dtype=np.float64)


class SensitivityError(FmuidError):
    """No simulation near a point succeeds, so that there is no derivative.

    Attributes
    ----------
    index : int
        Which parameter.
    """

    def __init__(self, index: int) -> None:
        super().__init__(f"every simulation with parameter number {index} moved to either side fails")
        self.index = index


class FiniteDifferences:
    """Jacobians of a vector function by forward or central differences, all columns in one batch of simulations.

    The steps are kept relative to the parameters' magnitudes and planned anew from every central Jacobian, which
    sees the second derivatives too.

    Parameters
    ----------
    predict : callable
        Thetas (m, N) to vectors (m, n).
    lower, upper : (N,) arrays
        Bounds, which no point leaves: at a bound differences are one-sided (and still of second order where central).
    magnitudes : callable
        How large each parameter is at a theta.
    noise : (n,) array
        Standard deviation of the weighted function's noise.
    size : float
        Root mean square of the weighted function: without knowledge of the third derivatives, the first central steps
        take |f‴| = size / magnitude³.
    weights : float or (n,) array
        What the function is multiplied by.
    start : callable, optional
        As `predict`, for the first Jacobian; default: the same.
    alike : bool
        Whether the first steps are powers of two, for functions that differ in their weights to have the same ones.

    Attributes
    ----------
    forward_steps, central_steps : (N,) arrays
        Relative to the magnitudes.
    """

    def __init__(
        self,
        predict: Predict,
        lower: Floats,
        upper: Floats,
        magnitudes: Callable[[Floats], Floats],
        noise: Floats,
        size: float,
        weights: float | Floats = 1.0,
        *,
        start: Predict | None = None,
        alike: bool = False,
    ) -> None:
        self._start = start or predict
        self._predict, self._lower, self._upper, self._magnitudes = predict, lower, upper, magnitudes
        # a quarter of the distance of the bounds leaves room for two steps to one side wherever theta is
        self._longest = self._upper / 4.0 - self._lower / 4.0
        self._size, self._alike = size, alike
        self._set_weights(weights, noise)
        self._plan_first()

    def _plan_first(self) -> None:
        first = (3.0 * self._rms / self._size) ** (1.0 / 3.0) if self._size > 0 else LARGEST_STEP
        first = min(max(first, SMALLEST_STEP), LARGEST_STEP)
        first = 2.0 ** round(math.log2(first)) if self._alike else first
        self.central_steps = np.full(self._lower.shape, first)
        self.forward_steps = self.central_steps.copy()
        self._forward_error = self._central_error = np.zeros(self._lower.size)

    def _set_weights(self, weights: float | Floats, noise: Floats) -> None:
        self._weights, self._noise = weights, noise
        self._rms = float(np.sqrt(np.mean(noise**2)))

    def weighted(self, weights: float | Floats, noise: Floats) -> FiniteDifferences:
        """Return the same with other weights, and the steps planned so far."""
        other = copy.copy(self)
        other._set_weights(weights, noise)
        scale = other._rms / self._rms if self._rms > 0 else 1.0
        other._forward_error, other._central_error = scale * self._forward_error, scale * self._central_error
        return other

    def renoised(self, noise: Floats, size: float) -> FiniteDifferences:
        """Return the same for another noise (n,) and size, with steps that are planned from the beginning."""
        other = copy.copy(self)
        other._size = size
        other._set_weights(self._weights, noise)
        other._plan_first()
        return other

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives of the weighted function at theta, (N, n), one row a parameter.

        Parameters
        ----------
        theta : (N,) array
        base : (n,) array
            The function at theta, not weighted.
        central : bool
            Two simulations a parameter instead of one; also plans the steps anew.

        Raises
        ------
        SensitivityError
            If every simulation near theta fails for some parameter.
        """
        if central:
            steps, (slopes, _) = self._checked_central(theta, base, self._predict)
            return np.asarray(slopes / steps[:, None], dtype=np.float64)
        steps = self._absolute(theta, self.forward_steps)
        distances, values = self._differences(self._predict, theta, base, steps, FORWARD)
        derivatives = values[:, 0]
        derivatives /= distances
        derivatives *= self._weights
        return derivatives

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, Flags]:
        """Return the central Jacobian (N, n) at the start and which parameters act on anything (N,).

        Parameters whose first difference does not stand out from the noise are tried again with the largest step
        before they count as without influence.
        """
        steps, (slopes, bends) = self._checked_central(theta, base, self._start)
        floor = INFLUENCE_NOISES * np.maximum(self._noise, np.finfo(float).tiny)
        acting = (np.abs(slopes) > floor).any(axis=1) | (np.abs(bends) > floor).any(axis=1)
        return slopes / steps[:, None], acting

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error of each row of a Jacobian at theta, its norm over the samples (N,).

        The sums that the steps balance, with the derivatives of the last central Jacobian.
        """
        relative = self._central_error if central else self._forward_error
        return np.asarray(relative / self._magnitudes(theta), dtype=np.float64)

    def _checked_central(self, theta: Floats, base: Floats, predict: Predict) -> tuple[Floats, Floats]:
        """Return steps (N,) and, weighted, slopes f′h and bends f″h² (2, N, n); those with unfit steps made again."""
        steps = self._absolute(theta, self.central_steps)
        found = self._central(predict, theta, base, steps)
        slope, bend = _rms(found)
        weak = slope < RESOLVED_NOISES * self._rms
        curved = ~weak & (bend > LARGEST_BEND * slope)
        largest = np.full(theta.size, LARGEST_STEP)
        for which, better in ((weak, largest), (curved, self._plan(theta, steps, slope, bend)[1])):
            other = self._absolute(theta, better)
            which &= (other > 2.0 * steps) | (other < 0.5 * steps)
            if which.any():
                steps = np.where(which, other, steps)
                found[:, which] = self._central(predict, theta, base, steps, np.flatnonzero(which))
                slope, bend = _rms(found)
        self._adopt(theta, steps, slope, bend)
        return steps, found

    def _absolute(self, theta: Floats, relative: Floats) -> Floats:
        return np.minimum(relative * self._magnitudes(theta), self._longest)

    def _central(
        self, predict: Predict, theta: Floats, base: Floats, steps: Floats, which: Indices | None = None
    ) -> Floats:
        """Return, weighted, slopes f′h and bends f″h² (2, k, n) of the parabolas through three points at 0, a and b."""
        distances, values = self._differences(predict, theta, base, steps, CENTRAL, which)
        (a, b), h = distances.T, steps if which is None else steps[which]
        ratio, unit = b / a, h / a
        factors = np.array([[ratio, -1.0 / ratio], [-2.0 * unit, 2.0 * unit / ratio]]) * (unit / (ratio - 1.0))
        return np.asarray(np.einsum("spk,kpn->skn", factors, values) * self._weights, dtype=np.float64)

    def _differences(
        self,
        predict: Predict,
        theta: Floats,
        base: Floats,
        steps: Floats,
        patterns: Sequence[tuple[float, ...]],
        which: Indices | None = None,
    ) -> tuple[Floats, Floats]:
        """Simulate points beside theta; return distances (k, p) and differences from base (k, p, n) of k parameters."""
        which = np.arange(theta.size) if which is None else which
        points = len(patterns[0])
        distances, values = np.empty((which.size, points)), np.empty((which.size, points, base.size))
        tried = np.full(which.size, -1)
        waiting = np.arange(which.size)
        while waiting.size:
            thetas = np.tile(theta, (waiting.size, points, 1))
            for row, k in enumerate(waiting):
                i = which[k]
                tried[k], thetas[row, :, i] = self._next_pattern(
                    float(theta[i]), i, float(steps[i]), patterns, tried[k]
                )
                distances[k] = thetas[row, :, i] - theta[i]  # as the simulator saw them, after rounding theta + h
            found = predict(thetas.reshape(-1, theta.size)).reshape(waiting.size, points, base.size)
            good = usable(found).all(axis=1)
            if waiting.size == which.size:
                values = found
            else:
                values[waiting] = found
            waiting = waiting[~good]
        values -= base
        return distances, values

    def _next_pattern(
        self, value: float, i: int, step: float, patterns: Sequence[tuple[float, ...]], last: int
    ) -> tuple[int, list[float]]:
        """Return the next pattern after the last one tried whose points lie inside the bounds, and these points."""
        lower, upper = float(self._lower[i]), float(self._upper[i])
        for k in range(last + 1, len(patterns)):
            nodes = [value + step * distance for distance in patterns[k]]
            if all(lower <= node <= upper for node in nodes):
                return k, nodes
        raise SensitivityError(i)

    def _plan(self, theta: Floats, steps: Floats, slope: Floats, bend: Floats) -> tuple[Floats, Floats]:
        """Return the forward and central steps that balance noise against curvature, relative to the magnitudes.

        Where a step h gave f′h and f″h², the best ones are h (4 ε/f″h²)^(1/2) and h (3 ε/f‴h³)^(1/3). The third
        derivative is taken as |f″|²/|f′|, as if the derivatives went on in proportion; the central error is flat around
        its best step. Slope or curvature that is itself noise only lengthens the steps.
        """
        share = steps / self._magnitudes(theta)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            forward = share * 2.0 * np.sqrt(self._rms / bend)
            central = share * np.cbrt(3.0 * (self._rms / bend) * (np.maximum(slope, self._rms) / bend))
        # 0/0, without influence or noise, stands for any step
        forward, central = (np.nan_to_num(relative, nan=LARGEST_STEP) for relative in (forward, central))
        planned = np.clip([forward, central], SMALLEST_STEP, LARGEST_STEP)
        return planned[0], planned[1]

    def _adopt(self, theta: Floats, steps: Floats, slope: Floats, bend: Floats) -> None:
        """Take the steps that a central Jacobian with these ones suggests, and what errors to expect (N,).

        Norms over the samples, of derivatives by the parameters relative to their magnitudes.
        """
        self.forward_steps, self.central_steps = self._plan(theta, steps, slope, bend)
        norm = math.sqrt(self._noise.size)
        share = steps / self._magnitudes(theta)
        curvature = bend / share**2
        self._forward_error = norm * (2.0 * self._rms / self.forward_steps + 0.5 * curvature * self.forward_steps)
        # the third derivative is the one for which the planned step would be the best
        self._central_error = norm * self._rms * (1.0 / share + share**2 / (2.0 * self.central_steps**3))


def _rms(values: Floats) -> Floats:
    """Return root mean squares over the last axis."""
    return np.asarray(np.sqrt(np.einsum("...n,...n->...", values, values) / values.shape[-1]), dtype=np.float64)
