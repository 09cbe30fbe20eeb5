"""Slow noise beneath what an autoregression leaves: a pole and a zero close to each other, by Whittle's likelihood.

White noise with a little slow noise in it has a spectrum that only a long autoregression follows, and no criterion
allows its many coefficients for so weak a rise. The innovations' spectrum then rises towards low frequencies by

    1 + c (1 − φ)²/|1 − φ e^(−iω)|² = κ |1 − θ e^(−iω)|²/|1 − φ e^(−iω)|²,

that of an autoregression of order 1 beneath white noise. The two numbers c and φ are those of the greatest likelihood
of the innovations' periodogram (Whittle), and taken where they make twice its logarithm greater by more than
0.75 log n: Schwarz asks log n for each of them, but c is never negative, and φ means nothing where c is 0. Of records
of white noise one in a hundred passes for slow noise then (0.7 % of 900 draws at n = 200, 1.3 % at 1000, 0.4 % of 450
at 4500).

References
----------
P. Whittle, "Estimation and information in stationary time series", Arkiv för Matematik 2, 1953.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from fmuid.array_types import Flags, Floats, Indices


@dataclass(frozen=True)
class LowFrequencySettings:
    """Numbers of the search for slow noise."""

    shortest: float = 4.0
    """Memories of slow noise, from so many samples ..."""
    longest_share: float = 0.25
    """... to this share of the record, are looked at in doublings."""
    noticed: float = 1.5
    """They are fitted where the power is larger there than by chance, by so many standard deviations."""
    asked: float = 0.75
    """Of log n, by which twice the log-likelihood must rise: 0.5 takes 2 to 3 % of white records for slow."""
    least: float = 1e-3
    """Bounds of c: below, the rise is nothing, ..."""
    most: float = 1e6
    """... beyond, all is slow."""
    alone: int = 64
    """So many of the lowest frequencies stand alone, ..."""
    wider: float = 1.05
    """... those above in bins each wider than the one before by this."""
    close: float = 0.03
    """The search ends at this step in the logarithms of c and of the memory."""


SETTINGS = LowFrequencySettings()
# The search in the logarithms of c and of the memory steps to the best of these neighbours, and halves its step where
# none is better, from a factor e to this.
NEIGHBOURS = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [-1, 1], [1, -1], [1, 1]], dtype=np.float64)


@dataclass(frozen=True)
class SlowNoise:
    """A factor (1 − θ e^(−iω))/(1 − φ e^(−iω)) of a noise model.

    Attributes
    ----------
    pole, zero : float
        φ and θ.
    variance : float
        Of the innovations that it leaves.
    gain : float
        By how much it makes twice the log-likelihood greater, beyond what is asked.
    """

    pole: float
    zero: float
    variance: float
    gain: float


@dataclass(frozen=True, eq=False)
class Bins:
    """Frequencies of the transform of a record of some length, taken together.

    Attributes
    ----------
    edges : (b,) array of int
        The first of each bin.
    counts : (b,) array
        How many each has; those at both ends of all, whose power has twice the variance, are half ones.
    cosines : (b,) array
        cos ω.
    memories : (m,) array
        Of slow noise, in samples.
    rises : (m, b) array
        The spectra of these less their means, times `counts`, so that white noise gives each the variance 1.
    slopes : (m,) array
        What slow noise of c = 1 gives each, relative to white noise.
    """

    edges: Indices
    counts: Floats
    cosines: Floats
    memories: Floats
    rises: Floats
    slopes: Floats

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, length: int) -> Bins:
        """Return those of a length."""
        size = length // 2 + 1
        wider = math.ceil(math.log(max(size / SETTINGS.alone, 1.0)) / math.log(SETTINGS.wider))
        edges = np.concatenate([np.arange(SETTINGS.alone), SETTINGS.alone * SETTINGS.wider ** np.arange(wider)])
        edges = np.unique(edges[edges < size].astype(np.intp))
        each = np.ones(size)
        each[0] = 0.5
        if length % 2 == 0:
            each[-1] = 0.5
        counts = np.add.reduceat(each, edges)
        cosines = np.cos(2.0 * np.pi / length * np.add.reduceat(np.arange(size) * each, edges) / counts)
        memories = SETTINGS.shortest * 2.0 ** np.arange(
            max(math.log2(max(SETTINGS.longest_share * length / SETTINGS.shortest, 0.5)) + 1.0, 0.0)
        )
        shapes = rises(memories, cosines)
        centred = counts * (shapes - (shapes @ counts / counts.sum())[:, None])
        slopes = np.sqrt(np.sum(centred * shapes, axis=1))
        return cls(edges, counts, cosines, memories, centred / slopes[:, None], slopes)


def rises(memories: Floats, cosines: Floats) -> Floats:
    """Return (1 − φ)²/|1 − φ e^(−iω)|², φ = e^(−1/memory), of each memory at each frequency (m, b)."""
    poles = np.exp(-1.0 / memories)[:, None]
    return np.asarray((1.0 - poles) ** 2 / (1.0 - 2.0 * poles * cosines + poles**2))


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The periodogram of innovations.

    Attributes
    ----------
    bins : Bins
    power : (b,) array
        Means over the bins. White innovations have their variance everywhere.
    samples : int
        Innovations that it is made of.
    length : int
        Of the grid, where some may be missing.
    """

    bins: Bins
    power: Floats
    samples: int
    length: int

    @classmethod
    def of(cls, columns: Floats, weights: Floats, there: Flags, coefficients: Floats) -> Spectrum:
        """Return that of the innovations of an autoregression (p,); the rest as of `autoregression.fit`."""
        length = fft.prev_fast_len(there.size - coefficients.size, real=True)
        first = there.size - length
        left, known = columns[:, first:].copy(), there[first:].copy()
        for lag, coefficient in enumerate(coefficients.tolist(), 1):
            left -= coefficient * columns[:, first - lag : -lag]
            known &= there[first - lag : -lag]
        samples = int(np.count_nonzero(known))
        spectra = fft.rfft(left if samples == length else left * known, axis=1)
        power = weights @ (spectra.real**2 + spectra.imag**2) / max(samples, 1)
        power[0] *= 0.5
        if length % 2 == 0:
            power[-1] *= 0.5
        bins = Bins.of(length)
        return cls(bins, np.add.reduceat(power, bins.edges) / bins.counts, samples, length)

    @property
    def level(self) -> float:
        """The variance of the innovations."""
        return float(self.bins.counts @ self.power) / float(self.bins.counts.sum())

    def start(self) -> Floats | None:
        """Return log c and log memory where the power stands out most from chance, if it does."""
        bins, level = self.bins, self.level
        if not (level > 0.0 and bins.memories.size):
            return None
        found = bins.rises @ self.power / level
        best = int(np.argmax(found))
        if not found[best] * math.sqrt(self.samples / self.length) > SETTINGS.noticed:
            return None
        return np.log([found[best] / bins.slopes[best], bins.memories[best]])

    def fitted(self, logs: Floats) -> tuple[Floats, Floats]:
        """Return the variances and −2 log likelihoods of each log c and log memory (g, 2)."""
        counts = self.bins.counts
        shapes = 1.0 + np.exp(logs[:, :1]) * rises(np.exp(logs[:, 1]), self.bins.cosines)
        levels = (self.power / shapes) @ counts / counts.sum()
        # what is added to the moments may make them improper
        heights = np.log(np.where(levels > 0.0, levels, np.inf))
        return levels, 2.0 * self.samples / self.length * (counts.sum() * heights + np.log(shapes) @ counts)


def slow_noise(columns: Floats, weights: Floats, there: Flags, coefficients: Floats) -> SlowNoise | None:
    """Return the slow noise that an autoregression (p,) leaves, if it does; the rest as of `autoregression.fit`."""
    spectrum = Spectrum.of(columns, weights, there, coefficients)
    at = spectrum.start()
    if at is None:
        return None
    least = np.log([SETTINGS.least, SETTINGS.shortest / 2.0])
    most = np.log([SETTINGS.most, SETTINGS.longest_share * spectrum.length])
    step, level, height = 1.0, math.nan, math.inf
    while step > SETTINGS.close:
        near = np.clip(at + step * NEIGHBOURS, least, most)
        levels, heights = spectrum.fitted(near)
        best = int(np.argmin(heights))
        # lower than all before: by rounding alone a point may be lower than itself, as its own neighbour at a bound
        if heights[best] < height:
            at, level, height = near[best], float(levels[best]), float(heights[best])
        else:
            step /= 2.0
    flat = 2.0 * float(spectrum.bins.counts.sum()) * spectrum.samples / spectrum.length * math.log(spectrum.level)
    gain = flat - height - SETTINGS.asked * math.log(spectrum.samples)
    if not gain > 0.0:
        return None
    rise, memory = np.exp(at).tolist()
    pole = math.exp(-1.0 / memory)
    half = (1.0 + pole**2 + rise * (1.0 - pole) ** 2) / (2.0 * pole)
    zero = 1.0 / (half + math.sqrt(half**2 - 1.0))
    return SlowNoise(pole, zero, level * pole / zero, gain)
