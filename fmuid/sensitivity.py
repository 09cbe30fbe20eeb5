"""Derivatives of whole simulations by finite differences, with steps from the simulation's own noise.

A simulator with an adaptive integrator inside is not a smooth function: between neighbouring parameter values its
steps and iterations change, and the outputs jump by something near its tolerance. A difference over a step that is
blind to this differentiates the jumps. So the noise is measured first (`noise_level`), and the steps balance it
against the curvature of the simulation itself (`FiniteDifferences`):

- forward: the error is at most 2 ε/h + |f″| h/2, least at h = 2 (ε/|f″|)^(1/2);
- central: the error is at most ε/h + |f‴| h²/6, least at h = (3 ε/|f‴|)^(1/3),

with ε the noise and f″, f‴ the derivatives, all as root mean squares over the samples.

References
----------
J. J. Moré, S. M. Wild, "Estimating computational noise", SIAM J. Sci. Comput. 33 (3), 2011 (the difference table);
J. J. Moré, S. M. Wild, "Estimating derivatives of noisy simulations", ACM Trans. Math. Softw. 38 (3), 2012;
P. E. Gill, W. Murray, M. A. Saunders, M. H. Wright, "Computing forward-difference intervals for numerical
optimization", SIAM J. Sci. Stat. Comput. 4 (2), 1983 (the balance of the errors).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmuid.errors import FmuidError

Floats = NDArray[np.float64]
Predict = Callable[[Floats], Floats]
"""Simulates thetas (m, N) and gives stacked outputs (m, n); the rows of failed simulations hold NaN."""

# Points of the difference table, the first being the point itself: seven suffice (Moré and Wild 2011, section 5).
NOISE_POINTS = 7
# Distance of these points, relative to the parameters: wide enough that an adaptive integrator takes other decisions
# from point to point, narrow enough that sixth differences of the smooth part (its sixth power) drown in rounding.
NOISE_SPACING = 3e-4
# Where sixth differences still fall this fast against fifth ones, the smooth part hides the noise ...
STILL_FALLING = 0.5
# ... which matters unless what is left is this small against the output; the table is then laid closer ...
NEGLIGIBLE_NOISE = 1e-13
CLOSER = 1.0 / 30.0
# ... at most this often.
NOISE_TABLES = 3
# A value whose derivatives' squares would overflow counts as a simulation that failed.
HUGE = 1e100
# Rounding of a stored output, half a unit in the last place of double precision.
ROUNDING = 2.0**-53

# Steps relative to a parameter's magnitude: a difference over more than a tenth says little about a derivative, and
# below the least one the parameter itself has too few digits left.
LARGEST_STEP = 0.1
SMALLEST_STEP = 1e-9
# A first difference below so many times the noise has no good digit: it is made again with the largest step.
RESOLVED = 10.0
# A parameter acts on an output where some sample changes by more than so many times the noise of that output; the
# largest of 10⁴ normal differences is 5.5 times the noise, and integrators jump more coarsely than that.
INFLUENCE = 10.0

# Where steps bend the function by this much of its slope they were too long (the first ones, chosen without knowledge
# of the curvature, for a strongly oscillating output, say), and the derivative is made again with the planned one.
TOO_CURVED = 0.5

# Which points give a derivative, in steps from the point, in the order in which they are tried: away from a bound, and
# from simulations that fail, first to the other side and then closer.
CLOSER_STEPS = (1.0, 0.1, 1e-2, 1e-4, 1e-6)
FORWARD = tuple((side * h,) for h in CLOSER_STEPS for side in (1.0, -1.0))
CENTRAL = tuple((a * h, b * h) for h in CLOSER_STEPS for a, b in ((1.0, -1.0), (1.0, 2.0), (-1.0, -2.0)))


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


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """The noise of the simulation itself.

    Attributes
    ----------
    outputs : (G,) array
        Standard deviation of each output's noise, in the output's unit.
    simulations : int
        How many thetas were simulated to find it.
    """

    outputs: Floats
    simulations: int


def noise_level(
    predict: Predict,
    theta: Floats,
    magnitudes: Floats,
    lower: Floats,
    upper: Floats,
    groups: NDArray[np.intp],
    count: int,
) -> tuple[Floats, NoiseLevel]:
    """Measure the noise of a simulation near theta by a table of differences (ECnoise of Moré and Wild 2011).

    All parameters move together along one direction in equal steps. The kth differences of a smooth function fall
    with the kth power of the step, those of noise do not: γ_k mean (Δᵏf)² with γ_k = (k!)²/(2k)! estimates ε² plus
    what is smooth, so the least of them over k is taken, with the mean over an output's samples.

    Parameters
    ----------
    predict : callable
    theta : (N,) array
        A point that can be simulated.
    magnitudes : (N,) array
        How large each parameter is.
    lower, upper : (N,) arrays
        Bounds, which no point leaves.
    groups : (n,) array of int
        To which of the `count` outputs each sample belongs.

    Returns
    -------
    base : (n,) array
        The simulation at theta, NaN if it failed (the level is then meaningless).
    level : NoiseLevel
    """
    direction = np.where(upper - theta >= theta - lower, 1.0, -1.0)
    room = np.where(direction > 0, upper - theta, theta - lower)
    steps = np.minimum(NOISE_SPACING * magnitudes, room / (NOISE_POINTS - 1))
    base = np.empty(0)
    level = np.full(count, np.inf)
    simulated = 0
    for _ in range(NOISE_TABLES):
        points = theta + np.arange(NOISE_POINTS)[:, None] * (steps * direction)
        table = predict(points[1:] if base.size else points)
        simulated += len(table)
        table = np.vstack([base, table]) if base.size else table
        base = table[0].copy()
        if not (np.abs(base) < HUGE).all():
            base[:] = np.nan
            break
        rounding = ROUNDING * np.sqrt(_group_means(base**2, groups, count))
        if (np.abs(table) < HUGE).all():
            deviations = _difference_table(table, groups, count)
            level = np.maximum(np.minimum(level, deviations.min(axis=0)), rounding)
            falling = deviations[-1] < STILL_FALLING * deviations[-2]
            hidden = falling & (level > NEGLIGIBLE_NOISE / ROUNDING * rounding)
            if not hidden.any():
                break
        steps = steps * CLOSER
    else:
        # every table met a failing simulation: with nothing known, the rounding of single precision
        level = np.where(np.isfinite(level), level, np.sqrt(ROUNDING) * np.sqrt(_group_means(base**2, groups, count)))
    return base, NoiseLevel(level, simulated)


def _difference_table(table: Floats, groups: NDArray[np.intp], count: int) -> Floats:
    """Return the deviations sqrt(γ_k mean (Δᵏf)²) of every order k and output, (NOISE_POINTS − 1, count)."""
    deviations = []
    for order in range(1, len(table)):
        table = np.diff(table, axis=0)
        gamma = math.factorial(order) ** 2 / math.factorial(2 * order)
        deviations.append(np.sqrt(gamma * _group_means(np.mean(table**2, axis=0), groups, count)))
    return np.array(deviations)


def _group_means(values: Floats, groups: NDArray[np.intp], count: int) -> Floats:
    sizes = np.bincount(groups, minlength=count)
    return np.asarray(np.bincount(groups, weights=values, minlength=count) / np.maximum(sizes, 1), dtype=np.float64)


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
        Standard deviation of the function's noise.
    size : float
        Root mean square of the part of the function that depends on theta: without knowledge of the third
        derivatives, the first central steps take |f‴| = size / magnitude³.

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
    ) -> None:
        self._predict, self._lower, self._upper, self._magnitudes = predict, lower, upper, magnitudes
        self.noise, self._rms = noise, float(np.sqrt(np.mean(noise**2)))
        self._norm = self._rms * math.sqrt(noise.size)
        first = (3.0 * self._rms / size) ** (1.0 / 3.0) if size > 0 else LARGEST_STEP
        self.central_steps = np.full(lower.shape, min(max(first, SMALLEST_STEP), LARGEST_STEP))
        self.forward_steps = self.central_steps.copy()
        self._forward_error = self._central_error = np.zeros(lower.size)

    def with_noise(self, predict: Predict, noise: Floats) -> FiniteDifferences:
        """Return the same for a function that is scaled otherwise, with the steps planned so far."""
        other = FiniteDifferences(predict, self._lower, self._upper, self._magnitudes, noise, 0.0)
        other.forward_steps, other.central_steps = self.forward_steps, self.central_steps
        scale = other._rms / self._rms if self._rms > 0 else 1.0
        other._forward_error, other._central_error = scale * self._forward_error, scale * self._central_error
        return other

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives at theta, (N, n), one row a parameter.

        Parameters
        ----------
        theta : (N,) array
        base : (n,) array
            The function at theta.
        central : bool
            Two simulations a parameter instead of one; also plans the steps anew.

        Raises
        ------
        SensitivityError
            If every simulation near theta fails for some parameter.
        """
        if central:
            return self._checked_central(theta, base)[0]
        steps = self._absolute(theta, self.forward_steps)
        derivatives = np.empty((theta.size, base.size))
        for i, (step,), (values,) in self._differences(theta, base, steps, FORWARD):
            np.multiply(values, 1.0 / step, out=derivatives[i])
        self._forward_error = 4.0 * self._norm * self._magnitudes(theta) / steps
        return derivatives

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the central Jacobian (N, n) at the start and which parameters act on anything (N,).

        Parameters whose first difference does not stand out from the noise are tried again with the largest step
        before they count as without influence.
        """
        first, change = self._checked_central(theta, base)
        return first, change > INFLUENCE

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error of each row of a Jacobian at theta, its norm over the samples (N,).

        That of the last Jacobian of its kind, relative to the magnitudes: the sums that the steps balance, with the
        steps that were taken (at the best ones 4 ε/h and 1.5 ε/h).
        """
        relative = self._central_error if central else self._forward_error
        return np.asarray(relative / self._magnitudes(theta), dtype=np.float64)

    def _checked_central(self, theta: Floats, base: Floats) -> tuple[Floats, Floats]:
        """Return central derivatives, those with unfit steps made again, and the largest change over the noise (N,)."""
        steps = self._absolute(theta, self.central_steps)
        first, second, change = self._central(theta, base, steps)
        slope, curvature = (np.sqrt(np.mean(d**2, axis=1)) for d in (first, second))
        weak = slope * steps < RESOLVED * self._rms
        curved = ~weak & (curvature * steps > TOO_CURVED * slope)
        for which, better in ((weak, np.full(theta.size, LARGEST_STEP)), (curved, self._plan(theta, first, second)[1])):
            other = self._absolute(theta, better)
            which &= (other > 2.0 * steps) | (other < 0.5 * steps)
            if which.any():
                again = self._central(theta, base, other, np.flatnonzero(which))
                for kept, found in zip((first, second, change), again, strict=True):
                    kept[which] = found[which]
                steps = np.where(which, other, steps)
        self.forward_steps, self.central_steps = self._plan(theta, first, second)
        best = self._absolute(theta, self.central_steps)
        self._central_error = self._norm * self._magnitudes(theta) * (1.0 / steps + steps**2 / (2.0 * best**3))
        return first, change

    def _absolute(self, theta: Floats, relative: Floats) -> Floats:
        # a quarter of the distance of the bounds leaves room for two steps to one side wherever theta is
        return np.minimum(relative * self._magnitudes(theta), (self._upper - self._lower) / 4.0)

    def _central(
        self, theta: Floats, base: Floats, steps: Floats, which: NDArray[np.intp] | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Return first and second derivatives (N, n) and the largest change of any sample over its noise (N,)."""
        first, second = np.zeros((2, theta.size, base.size))
        change = np.zeros(theta.size)
        floor = np.maximum(self.noise, np.finfo(float).tiny)
        for i, (a, b), (at_a, at_b) in self._differences(theta, base, steps, CENTRAL, which):
            change[i] = max(np.max(np.abs(at_a) / floor), np.max(np.abs(at_b) / floor))
            slope_a, slope_b = at_a / a, at_b / b
            # the parabola through three points, at distances 0, a and b
            first[i] = (b * slope_a - a * slope_b) / (b - a)
            second[i] = 2.0 * (slope_b - slope_a) / (b - a)
        return first, second, change

    def _differences(
        self,
        theta: Floats,
        base: Floats,
        steps: Floats,
        patterns: Sequence[tuple[float, ...]],
        which: NDArray[np.intp] | None = None,
    ) -> list[tuple[int, Floats, Floats]]:
        """Simulate each parameter's points; return (index, distances (p,), differences from base (p, n)) of each."""
        found = []
        waiting = [int(i) for i in (np.arange(theta.size) if which is None else which)]
        tried = dict.fromkeys(waiting, -1)
        while waiting:
            points = []
            for i in waiting:
                tried[i], nodes = self._next_pattern(theta[i], i, steps[i], patterns, tried[i])
                block = np.tile(theta, (len(nodes), 1))
                block[:, i] = nodes
                points.append(block)
            results = self._predict(np.concatenate(points)).reshape(len(waiting), -1, base.size)
            for i, block, values in zip(waiting, points, results, strict=True):
                if (np.abs(values) < HUGE).all():
                    # the distance as the simulator saw it, after rounding theta + h
                    found.append((i, block[:, i] - theta[i], np.subtract(values, base, out=values)))
            waiting = [i for i in waiting if not any(i == done for done, _, _ in found)]
        return found

    def _next_pattern(
        self, value: float, i: int, step: float, patterns: Sequence[tuple[float, ...]], last: int
    ) -> tuple[int, Floats]:
        for k in range(last + 1, len(patterns)):
            nodes = value + step * np.array(patterns[k])
            if (nodes >= self._lower[i]).all() and (nodes <= self._upper[i]).all():
                return k, nodes
        raise SensitivityError(i)

    def _plan(self, theta: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats]:
        """Return the forward and central steps that balance noise against curvature, relative to the magnitudes.

        The third derivative is taken as |f″|²/|f′|, as if the derivatives went on in proportion; the central error
        is flat around its best step. Curvature that is itself noise only lengthens the steps.
        """
        magnitudes = self._magnitudes(theta)
        slope = np.sqrt(np.mean(first**2, axis=1)) * magnitudes
        curvature = np.sqrt(np.mean(second**2, axis=1)) * magnitudes**2
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            forward = 2.0 * np.sqrt(self._rms / curvature)
            central = np.cbrt(3.0 * self._rms * slope / curvature**2)
        # 0/0, without influence or noise, stands for any step
        steps = (np.nan_to_num(steps, nan=LARGEST_STEP, posinf=LARGEST_STEP) for steps in (forward, central))
        bounded = [np.clip(relative, SMALLEST_STEP, LARGEST_STEP) for relative in steps]
        return bounded[0], bounded[1]
