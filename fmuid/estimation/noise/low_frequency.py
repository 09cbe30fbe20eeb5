"""Low-frequency noise beneath an autoregression, by Whittle's likelihood (docs/method/covariance.md).

The innovations' spectrum rises by 1 + c (1 − φ)²/|1 − φ e^(−iω)|² = κ |1 − θ e^(−iω)|²/|1 − φ e^(−iω)|². It is taken
if twice the log-likelihood gains 0.75 log n: 1 % of white records pass (measured for n = 200 to 4500).
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
    """Numbers of the search for low-frequency noise."""

    shortest: float = 4.0  # memories from this many samples ...
    longest_share: float = 0.25  # ... to this share of the record are tried, in doublings
    noticed: float = 1.5  # excess power that starts a fit, standard deviations
    asked: float = 0.75  # gain of twice the log-likelihood, times log n; 0.5 takes 2 to 3 % of white records
    least: float = 1e-3  # bounds of c: below, the rise is nothing; ...
    most: float = 1e6  # ... beyond, all is slow
    alone: int = 64  # lowest frequencies with a bin each; ...
    wider: float = 1.05  # ... later bins widen by this factor
    close: float = 0.03  # last step in log c and log memory


SETTINGS = LowFrequencySettings()
# Steps of the search in log c and log memory; halved if none is better.
NEIGHBOURS = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [-1, 1], [1, -1], [1, 1]], dtype=np.float64)


@dataclass(frozen=True)
class SlowNoise:
    """Factor (1 − θ e^(−iω))/(1 − φ e^(−iω)) of a noise model."""

    pole: float  # φ
    zero: float  # θ
    variance: float  # of the innovations left
    gain: float  # of twice the log-likelihood, beyond the threshold


def line_counts(length: int) -> Floats:
    """Return the multiplicity (f,) of lines of a real transform."""
    found = np.full(length // 2 + 1, 2.0)
    found[0] = 1.0
    if length % 2 == 0:
        found[-1] = 1.0
    return found


@dataclass(frozen=True, eq=False)
class Bins:
    """Bins of the frequencies of a real transform."""

    edges: Indices  # (b,), first frequency of each bin
    counts: Floats  # (b,), frequencies of each bin; those at both ends count half
    cosines: Floats  # (b,), cos ω
    memories: Floats  # (m,), of slow noise, samples
    rises: Floats  # (m, b), centered spectra times counts, of variance 1 under white noise
    slopes: Floats  # (m,), their response to slow noise of c = 1

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, length: int) -> Bins:
        """Return the bins of a record length."""
        size = length // 2 + 1
        wider = math.ceil(math.log(max(size / SETTINGS.alone, 1.0)) / math.log(SETTINGS.wider))
        edges = np.concatenate([np.arange(SETTINGS.alone), SETTINGS.alone * SETTINGS.wider ** np.arange(wider)])
        edges = np.unique(edges[edges < size].astype(np.intp))
        each = line_counts(length) / 2.0
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
    """Return (1 − φ)²/|1 − φ e^(−iω)|², φ = e^(−1/memory), (m, b)."""
    poles = np.exp(-1.0 / memories)[:, None]
    return np.asarray((1.0 - poles) ** 2 / (1.0 - 2.0 * poles * cosines + poles**2))


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Periodogram of innovations."""

    bins: Bins
    power: Floats  # (b,), means over the bins
    samples: int  # innovations without gaps
    length: int  # of the grid

    @classmethod
    def of(cls, columns: Floats, weights: Floats, there: Flags, coefficients: Floats) -> Spectrum:
        """Return the periodogram of an autoregression's innovations; arguments as `autoregression.fit`."""
        length = fft.prev_fast_len(there.size - coefficients.size, real=True)
        first = there.size - length
        left, known = columns[:, first:].copy(), there[first:].copy()
        for lag, coefficient in enumerate(coefficients.tolist(), 1):
            left -= coefficient * columns[:, first - lag : -lag]
            known &= there[first - lag : -lag]
        samples = int(np.count_nonzero(known))
        spectra = fft.rfft(left if samples == length else left * known, axis=1)
        power = weights @ (spectra.real**2 + spectra.imag**2) / max(samples, 1)
        power *= line_counts(length) / 2.0
        bins = Bins.of(length)
        return cls(bins, np.add.reduceat(power, bins.edges) / bins.counts, samples, length)

    @property
    def level(self) -> float:
        """Variance of the innovations."""
        return float(self.bins.counts @ self.power) / float(self.bins.counts.sum())

    def start(self) -> Floats | None:
        """Return log c and log memory of significant excess power."""
        bins, level = self.bins, self.level
        if not (level > 0.0 and bins.memories.size):
            return None
        found = bins.rises @ self.power / level
        best = int(np.argmax(found))
        if not found[best] * math.sqrt(self.samples / self.length) > SETTINGS.noticed:
            return None
        return np.log([found[best] / bins.slopes[best], bins.memories[best]])

    def fitted(self, logs: Floats) -> tuple[Floats, Floats]:
        """Return variances and −2 log likelihoods of logs (g, 2)."""
        counts = self.bins.counts
        shapes = 1.0 + np.exp(logs[:, :1]) * rises(np.exp(logs[:, 1]), self.bins.cosines)
        levels = (self.power / shapes) @ counts / counts.sum()
        # what is added to the moments may make them improper
        heights = np.log(np.where(levels > 0.0, levels, np.inf))
        return levels, 2.0 * self.samples / self.length * (counts.sum() * heights + np.log(shapes) @ counts)


def slow_noise(columns: Floats, weights: Floats, there: Flags, coefficients: Floats) -> SlowNoise | None:
    """Return the low-frequency noise beneath an autoregression, if any."""
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
        # strictly lower than all before: at a bound a point is its own neighbor, lower by rounding
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
