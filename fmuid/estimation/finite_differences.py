"""Derivatives by the model or by finite differences (docs/method/sensitivities.md).

Steps of differences balance the simulation noise ε against curvature; all terms are RMS values over the samples:

- forward: error 2 ε/h + |f″| h/2, least at h = 2 (ε/|f″|)^(1/2);
- central: error ε/h + |f‴| h²/6, least at h = (3 ε/|f‴|)^(1/3).

References: Moré and Wild, ACM Trans. Math. Softw. 38 (3), 2012; Gill et al., SIAM J. Sci. Stat. Comput. 4 (2), 1983.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.errors import FmuidError
from fmuid.estimation.simulation_noise import Predict, usable


@dataclass(frozen=True)
class DifferenceSettings:
    """Limits of steps and effects."""

    largest_step: float = 0.1  # relative to the magnitude; a wider difference is no derivative
    smallest_step: float = 1e-9  # relative; below, the parameter has too few digits left
    resolved: float = 10.0  # σ of noise; a smaller first difference is repeated with the largest step
    effect: float = 10.0  # σ of noise that an effect exceeds; 10⁴ normal differences reach 5.5, integrators more
    largest_bend: float = 0.5  # of the slope; a stronger bend needs another step
    model_error: float = 1e-6  # relative, of a derivative by the model: an integrator with default tolerance


DIFFERENCES = DifferenceSettings()
SENSITIVITIES = ("finite-difference", "forward", "fmu")
"""Methods: differences of simulations, sensitivity equations (1.26), outputs of the FMU."""
# Points of a derivative in steps, as tried near bounds and failures: other side first, then closer.
CLOSER_STEPS = (1.0, 0.1, 1e-2, 1e-4, 1e-6)
FORWARD = tuple((side * h,) for h in CLOSER_STEPS for side in (1.0, -1.0))
CENTRAL = tuple((a * h, b * h) for h in CLOSER_STEPS for a, b in ((1.0, -1.0), (1.0, 2.0), (-1.0, -2.0)))


@dataclass(frozen=True)
class SensitivityMethod:
    """Method of the derivatives.

    Attributes
    ----------
    method : str
        One of `SENSITIVITIES`, as requested.
    by_differences : bool
        "forward" only: True if the right-hand side is differentiated by differences.
    refusal : str
        The model's reason to refuse; finite differences were used afterwards.
    """

    method: str
    by_differences: bool = False
    refusal: str = ""


def parabola_slope(low: Floats, high: Floats, a: float | Floats, b: float | Floats) -> Floats:
    """Return the slope at 0 of a parabola through the origin.

    It passes (a, low) and (b, high), too.
    """
    return np.asarray((low * (b / a) - high * (a / b)) / (b - a), dtype=np.float64)


class SensitivityError(FmuidError):
    """All simulations near a point fail; `index` is that of the parameter."""

    def __init__(self, index: int) -> None:
        super().__init__(f"every simulation with parameter number {index} moved to either side fails")
        self.index = index


def _no_model(_theta: Floats) -> None:
    """Return no derivatives."""


@dataclass(frozen=True)
class BoundedFunction:
    """Vector function (n,) of theta (N,) within strict bounds."""

    predict: Predict
    lower: Floats
    upper: Floats
    magnitudes: Callable[[Floats], Floats]  # of the parameters, at theta
    start: Predict  # as `predict`, for the first Jacobian
    derivatives: Callable[[Floats], Floats | None] = _no_model  # (N, n) at theta by the model, None without


class Derivatives:
    """Jacobians of a weighted vector function, by its model or by differences.

    Steps are relative to the magnitudes. Each central Jacobian plans them anew; `alike`: the first ones are powers of
    two. `noise` (n,) and `size` are the standard deviation of the weighted function's noise and its RMS.
    """

    def __init__(
        self,
        function: BoundedFunction,
        noise: Floats,
        size: float,
        weights: float | Floats = 1.0,
        *,
        alike: bool = False,
    ) -> None:
        self.function, self._size, self._alike = function, size, alike
        self._longest = function.upper / 4.0 - function.lower / 4.0  # room for two steps to one side
        self._model_error: Floats | None = None
        self._set_weights(weights, noise)
        self._plan_first()

    def _plan_first(self) -> None:
        first = (3.0 * self._rms / self._size) ** (1.0 / 3.0) if self._size > 0 else DIFFERENCES.largest_step
        first = min(max(first, DIFFERENCES.smallest_step), DIFFERENCES.largest_step)
        first = 2.0 ** round(math.log2(first)) if self._alike else first
        self.central_steps = np.full(self.function.lower.shape, first)
        self.forward_steps = self.central_steps.copy()
        self._forward_error = self._central_error = np.zeros(self.function.lower.size)

    def _set_weights(self, weights: float | Floats, noise: Floats) -> None:
        self._weights, self._noise = weights, noise
        self._rms = float(np.sqrt(np.mean(noise**2)))

    def weighted(self, weights: float | Floats, noise: Floats) -> Derivatives:
        """Return a copy with other weights and the same steps."""
        other = copy.copy(self)
        other._set_weights(weights, noise)
        scale = other._rms / self._rms if self._rms > 0 else 1.0
        other._forward_error, other._central_error = scale * self._forward_error, scale * self._central_error
        other._model_error = None if self._model_error is None else scale * self._model_error
        return other

    def renoised(self, noise: Floats, size: float) -> Derivatives:
        """Return a copy for other noise (n,) and size, with first steps."""
        other = copy.copy(self)
        other._size = size
        other._set_weights(self._weights, noise)
        other._plan_first()
        return other

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives (N, n) of the weighted function; `base` (n,) is the plain one at theta."""
        derivatives = self._by_model(theta)
        if derivatives is not None:
            return derivatives
        if central:
            steps, (slopes, _) = self._checked_central(theta, base, self.function.predict)
            return np.asarray(slopes / steps[:, None], dtype=np.float64)
        steps = self._absolute(theta, self.forward_steps)
        distances, values = self._differences(self.function.predict, theta, base, steps, FORWARD)
        derivatives = values[:, 0]
        derivatives /= distances
        derivatives *= self._weights
        return derivatives

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, Flags]:
        """Return the central Jacobian (N, n) and flags (N,) of acting parameters."""
        floor = DIFFERENCES.effect * np.maximum(self._noise, np.finfo(float).tiny)
        derivatives = self._by_model(theta)
        if derivatives is not None:
            change = np.abs(derivatives) * (DIFFERENCES.largest_step * self.function.magnitudes(theta))[:, None]
            return derivatives, np.asarray((change > floor).any(axis=1), dtype=np.bool_)
        steps, (slopes, bends) = self._checked_central(theta, base, self.function.start)
        acting = (np.abs(slopes) > floor).any(axis=1) | (np.abs(bends) > floor).any(axis=1)
        return slopes / steps[:, None], acting

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error norm (N,) of each Jacobian row at theta."""
        if self._model_error is not None:
            return self._model_error
        relative = self._central_error if central else self._forward_error
        return np.asarray(relative / self.function.magnitudes(theta), dtype=np.float64)

    def _by_model(self, theta: Floats) -> Floats | None:
        found = self.function.derivatives(theta)
        if found is not None:
            found *= self._weights
        self._model_error = None if found is None else DIFFERENCES.model_error * np.linalg.norm(found, axis=1)
        return found

    def _checked_central(self, theta: Floats, base: Floats, predict: Predict) -> tuple[Floats, Floats]:
        """Return steps (N,), and weighted f′h and f″h² (2, N, n); repeat unfit steps."""
        steps = self._absolute(theta, self.central_steps)
        found = self._central(predict, theta, base, steps)
        slope, bend = _rms(found)
        weak = slope < DIFFERENCES.resolved * self._rms
        curved = ~weak & (bend > DIFFERENCES.largest_bend * slope)
        largest = np.full(theta.size, DIFFERENCES.largest_step)
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
        return np.minimum(relative * self.function.magnitudes(theta), self._longest)

    def _central(
        self, predict: Predict, theta: Floats, base: Floats, steps: Floats, which: Indices | None = None
    ) -> Floats:
        """Return weighted f′h and f″h² (2, k, n) of parabolas."""
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
        """Return distances (k, p) and differences from base (k, p, n)."""
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
        """Return index and points of the next pattern within the bounds."""
        lower, upper = float(self.function.lower[i]), float(self.function.upper[i])
        for k in range(last + 1, len(patterns)):
            nodes = [value + step * distance for distance in patterns[k]]
            if all(lower <= node <= upper for node in nodes):
                return k, nodes
        raise SensitivityError(i)

    def _plan(self, theta: Floats, steps: Floats, slope: Floats, bend: Floats) -> tuple[Floats, Floats]:
        """Return the best forward and central steps, relative to the magnitudes; f‴ ≈ |f″|²/|f′|."""
        share = steps / self.function.magnitudes(theta)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            forward = share * 2.0 * np.sqrt(self._rms / bend)
            central = share * np.cbrt(3.0 * (self._rms / bend) * (np.maximum(slope, self._rms) / bend))
        # 0/0, without effect or noise: any step
        forward, central = (np.nan_to_num(relative, nan=DIFFERENCES.largest_step) for relative in (forward, central))
        planned = np.clip([forward, central], DIFFERENCES.smallest_step, DIFFERENCES.largest_step)
        return planned[0], planned[1]

    def _adopt(self, theta: Floats, steps: Floats, slope: Floats, bend: Floats) -> None:
        """Plan the next steps and their errors (N,) from a central Jacobian."""
        self.forward_steps, self.central_steps = self._plan(theta, steps, slope, bend)
        norm = math.sqrt(self._noise.size)
        share = steps / self.function.magnitudes(theta)
        curvature = bend / share**2
        self._forward_error = norm * (2.0 * self._rms / self.forward_steps + 0.5 * curvature * self.forward_steps)
        # the third derivative is the one for which the planned step would be the best
        self._central_error = norm * self._rms * (1.0 / share + share**2 / (2.0 * self.central_steps**3))


def _rms(values: Floats) -> Floats:
    """Return root mean squares over the last axis."""
    return np.asarray(np.sqrt(np.einsum("...n,...n->...", values, values) / values.shape[-1]), dtype=np.float64)
