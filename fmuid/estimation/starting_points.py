"""Starting points: noise level by second differences, box, Sobol points, weak form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from fmuid.array_types import Flags, Floats
from fmuid.data import ParameterSet
from fmuid.errors import InputError


@dataclass(frozen=True)
class StartingPointSettings:
    """Numbers of noise levels, Sobol points, boxes and windows."""

    robust: float = 1.4826  # σ by median |e| of normal noise
    noise_samples: int = 5  # least for a noise level
    window: int = 10  # intervals of a window of the weak form; windows overlap by half
    window_samples: int = 3  # least of each state in a window: interpolation over a gap is no information
    prior_stds: float = 5.0  # of the prior, in place of a bound
    decade: float = 10.0  # ratio of the bounds for a logarithmic range


SETTINGS = StartingPointSettings()
MAX_NOISE_RATIO = 3.0  # of a residual by its noise level; a larger one starts a restart


def second_difference_noise(times: Floats, values: Floats) -> float:
    """Return the noise level of an output, NaN with too few samples.

    Compares each sample with the line through its neighbors, by the median: an upper bound.
    """
    there = np.flatnonzero(~np.isnan(values))
    if there.size < SETTINGS.noise_samples:
        return float("nan")
    t, y = times[there], values[there]
    whole = t[2:] - t[:-2]
    moved = whole > 0
    share = (t[1:-1] - t[:-2])[moved] / whole[moved]
    line = (1.0 - share) * y[:-2][moved] + share * y[2:][moved]
    error = (y[1:-1][moved] - line) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    return SETTINGS.robust * float(np.median(np.abs(error))) if error.size else float("nan")


def smoothness_noise(order: Floats, values: Floats, scale: Floats) -> float:
    """Return the relative noise level of a curve, NaN with few samples.

    Compares each sample with the cubic through two neighbors on each side, by the median: an upper bound. The noise of
    each sample is in proportion to `scale`.
    """
    there = np.flatnonzero(~np.isnan(values))
    if there.size < SETTINGS.noise_samples:
        return float("nan")
    x, y, own = order[there], values[there], scale[there]
    places = np.arange(2, x.size - 2)
    near = x[places[:, None] + np.array([-2, -1, 1, 2])] - x[places, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = near[:, None, :] / (near[:, None, :] - near[:, :, None])
        weights = np.where(np.eye(4, dtype=np.bool_), 1.0, ratios).prod(axis=2)
        error = y[places] - (weights * y[places[:, None] + np.array([-2, -1, 1, 2])]).sum(axis=1)
        error /= np.sqrt(1.0 + (weights**2).sum(axis=1)) * own[places]
    known = np.abs(error[np.isfinite(error)])
    return SETTINGS.robust * float(np.median(known)) if known.size else float("nan")


def spans_decades(lower: float, upper: float) -> bool:
    """Return True if a positive range spans a decade: to be divided logarithmically."""
    return lower > 0 and upper >= SETTINGS.decade * lower


class Box:
    """Box of the parameters as the unit cube, decades logarithmic; a prior replaces missing bounds."""

    def __init__(self, parameters: ParameterSet) -> None:
        reach = SETTINGS.prior_stds * parameters.prior_std
        self.lower = np.where(np.isfinite(parameters.lower), parameters.lower, parameters.prior_mean - reach)
        self.upper = np.where(np.isfinite(parameters.upper), parameters.upper, parameters.prior_mean + reach)
        for word, side in (("min", self.lower), ("max", self.upper)):
            for i in np.flatnonzero(np.isnan(side)):
                raise InputError(
                    f"parameter {parameters.names[i]!r} has no {word}, which a global search needs. "
                    "Give min and max, or a prior."
                )
        pairs = zip(self.lower, self.upper, strict=True)
        self.logarithmic = np.array([spans_decades(low, high) for low, high in pairs])
        self._low, self._high = self._scaled(self.lower), self._scaled(self.upper)

    def thetas(self, units: Floats) -> Floats:
        """Return parameters (m, N) of points of the unit cube (m, N)."""
        scaled = self._low + units * (self._high - self._low)
        scaled[:, self.logarithmic] = np.exp(scaled[:, self.logarithmic])
        return np.clip(scaled, self.lower, self.upper)  # exp(log(x)) is not always x

    def units(self, thetas: Floats) -> Floats:
        """Return clipped unit-cube points (m, N) of parameters (m, N)."""
        scaled = self._scaled(np.clip(thetas, self.lower, self.upper))
        return np.asarray((scaled - self._low) / (self._high - self._low), dtype=np.float64)

    def _scaled(self, values: Floats) -> Floats:
        scaled = np.array(values, dtype=np.float64)
        scaled[..., self.logarithmic] = np.log(scaled[..., self.logarithmic])
        return scaled


def sobol_points(dimensions: int, count: int, seed: int | np.random.Generator) -> Floats:
    """Return the first points (count, dimensions) of a scrambled Sobol sequence."""
    from scipy.stats import qmc  # slow to import

    points = qmc.Sobol(dimensions, seed=seed).random_base2((count - 1).bit_length())
    return np.asarray(points[:count], dtype=np.float64)


class WeakForm:
    """Weak form of ẋ = f(x, u, θ) over windows of one recording; `shape` counts windows and states.

    ∫ w f dt + ∫ w′ x dt = 0 for w = 4 z (1 − z), z from 0 to 1 along a window (Shinbrot, NACA TN 3288, 1954). States
    were measured where `there` (K, n_x). `InputError`: no window has enough samples.
    """

    def __init__(self, times: Floats, there: Flags) -> None:
        last = len(times) - 1
        firsts = np.arange(0, max(last - SETTINGS.window, 0) + 1, SETTINGS.window // 2)
        lasts = np.minimum(firsts + SETTINGS.window, last)
        counts = np.pad(there.cumsum(axis=0), ((1, 0), (0, 0)))  # samples before each time
        known = (counts[lasts + 1] - counts[firsts] >= SETTINGS.window_samples).all(axis=1)
        known &= times[lasts] > times[firsts]
        firsts = firsts[known] if last >= SETTINGS.window else firsts[:0]
        if not firsts.size:
            raise InputError("no window has enough samples for the weak form")
        self.shape = firsts.size, there.shape[1]
        inside = firsts[:, None] + np.arange(SETTINGS.window + 1)
        z = (times[inside] - times[firsts][:, None]) / (times[firsts + SETTINGS.window] - times[firsts])[:, None]
        weight = 4.0 * z * (1.0 - z)
        half = 0.5 * np.diff(times[inside], axis=1)
        rows = np.repeat(np.arange(firsts.size), SETTINGS.window)
        left, right = inside[:, :-1].ravel(), inside[:, 1:].ravel()
        slope = 0.5 * np.diff(weight, axis=1).ravel()
        of_samples, of_intervals = (firsts.size, last + 1), (firsts.size, last)
        self._states = scipy.sparse.csr_array((slope, (rows, left)), of_samples)
        self._states = self._states + scipy.sparse.csr_array((slope, (rows, right)), of_samples)
        self._begins = scipy.sparse.csr_array(((half * weight[:, :-1]).ravel(), (rows, left)), of_intervals)
        self._ends = scipy.sparse.csr_array(((half * weight[:, 1:]).ravel(), (rows, left)), of_intervals)
        self.noise = np.sqrt(np.asarray((self._states**2).sum(axis=1))).reshape(-1, 1)
        """Standard deviation of each window's residual per unit noise of the states (windows, 1)."""

    def residual(self, states: Floats, begins: Floats, ends: Floats) -> Floats:
        """Return ∫ w′ x + ∫ w f (windows, n_x); of states (K, n_x), and f at both ends of intervals (K − 1, n_x)."""
        return np.asarray(self._states @ states + self._begins @ begins + self._ends @ ends, dtype=np.float64)
