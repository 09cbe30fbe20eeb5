"""Autoregressions by Burg's method, order by BIC (docs/method/covariance.md).

x(t) = Σ φ_j x(t − j) + w(t), fitted to weighted second moments of columns; gaps may be anywhere (de Waele and
Broersen). From 25 samples on the order is at least 1, without Kendall's bias 2 φ/n; fewer samples count as white.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from scipy import fft

from fmuid.array_types import Complexes, Flags, Floats
from fmuid.estimation.noise.low_frequency import slow_noise


@dataclass(frozen=True)
class AutoregressionSettings:
    """Numbers of the fit."""

    orders_a_decade: float = 10.0  # orders up to this times log₁₀ n are tried ...
    samples_an_order: int = 4  # ... with at least this many samples each
    more_pairs: int = 4  # an order needs twice its number of pairs, and these
    enough: int = 25  # fewer samples show no color
    bias: float = 2.0  # Kendall: E φ̂ = φ (1 − 2/n), order 1, known mean
    loudest: float = 1e6  # an impulse response beyond this is rounding
    negligible: float = 1e-4  # share of the largest value at which the impulse response ends ...
    longest: int = 5000  # ... or at this length ...
    records: int = 2  # ... or at this multiple of the record, if longer
    block: int = 64  # samples of the impulse response computed at a time
    least_variance: float = 1e-300  # in place of zero


SETTINGS = AutoregressionSettings()


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Autoregressive process, optionally with weak low-frequency noise.

    Attributes
    ----------
    coefficients : (p,) array
        φ_1 to φ_p.
    variance : float
        Variance of the innovation w.
    samples : int
        Samples of the fit.
    memory : int
        Length of the impulse response, samples.
    pole, zero : float
        φ and θ of the low-frequency noise, 0 without it.
    """

    coefficients: Floats
    variance: float
    samples: int
    memory: int = 1
    pole: float = 0.0
    zero: float = 0.0

    def transfer(self, length: int) -> Complexes:
        """Return the transfer function at the frequencies of a real transform.

        (1 − θ e^(−iω))/((1 − φ e^(−iω)) (1 − Σ φ_j e^(−iωj))).
        """
        found = 1.0 / _spectrum(self.coefficients, length)
        if self.pole:
            found *= _spectrum([self.zero], length) / _spectrum([self.pole], length)
        return found

    def along(self, spectra: Complexes, transfer: Complexes, length: int) -> Floats:
        """Return 2 Σ_t of spectra (..., f) times ∂log `transfer`/∂(φ_j, φ, θ)."""
        order = self.coefficients.size
        if not self.pole:
            return np.asarray(2.0 * fft.irfft(spectra * np.conj(transfer), length)[..., 1 : order + 1])
        found = []
        for sign, own, lags in ((1.0, self.coefficients, order), (1.0, [self.pole], 1), (-1.0, [self.zero], 1)):
            every = fft.irfft(spectra / np.conj(_spectrum(own, length)), length)
            found.append(2.0 * sign * every[..., 1 : lags + 1])
        return np.concatenate(found, axis=-1)

    @cached_property
    def _of_coefficients(self) -> Floats:
        return impulse_response(self.coefficients, self.memory)

    @property
    def gain(self) -> float:
        """Variance of the process by that of its innovation, Σ h²."""
        response = self._of_coefficients
        if self.pole:
            # not by scipy.signal: slow to import
            count = response.size + self.memory
            slow = np.append(1.0, (self.pole - self.zero) * self.pole ** np.arange(count - 1))
            size = fft.next_fast_len(2 * count, real=True)
            response = fft.irfft(fft.rfft(response, size) * fft.rfft(slow, size), size)[:count]
        return float(response @ response)

    @property
    def std(self) -> float:
        """Standard deviation of the process."""
        return float((self.variance * self.gain) ** 0.5)

    def of_variance(self, variance: float) -> Autoregression:
        """Return the process with the same correlation and another variance."""
        return replace(self, variance=variance / self.gain)

    @cached_property
    def correlation(self) -> Floats:
        """Autocorrelation (memory + 1,), from lag 0 on."""
        size = fft.next_fast_len(2 * self.memory + 1, real=True)
        power = fft.irfft(np.abs(self.transfer(size)) ** 2, size)[: self.memory + 1]
        return np.asarray(power / power[0])

    @property
    def slow_share(self) -> float:
        """Share of the low-frequency noise in the variance."""
        if not self.pole:
            return 0.0
        # the innovations without it have variance · θ/φ (`fmuid.estimation.noise.low_frequency`)
        return 1.0 - self.zero / self.pole * float(self._of_coefficients @ self._of_coefficients) / self.gain

    @property
    def time_constant(self) -> float:
        """Time constant of the slowest non-oscillating part, samples."""
        roots = np.roots(np.concatenate([[1.0], -self.coefficients]))
        slowest = max([self.pole, *roots[(roots.imag == 0.0) & (roots.real > 0.0)].real.tolist()])
        return -1.0 / math.log(min(slowest, math.nextafter(1.0, 0.0))) if slowest > 0.0 else 0.0

    def scatter(self) -> Floats:
        """Return the covariance of log σ², φ_j, φ, θ, times samples."""
        order = self.coefficients.size
        response = self._of_coefficients
        padded = np.concatenate([response, np.zeros(order)])
        correlation = np.array([response @ padded[k : k + response.size] for k in range(order)])
        lags = np.arange(order)
        information = np.zeros((order, order)) if not order else correlation[np.abs(lags[:, None] - lags)]
        if self.pole:
            roots, signs = np.array([self.pole, self.zero]), np.array([1.0, -1.0])
            inverse = 1.0 - self.coefficients @ roots[None] ** (lags[:, None] + 1.0)
            cross = signs * roots ** lags[:, None] / inverse
            own = np.outer(signs, signs) / (1.0 - np.outer(roots, roots))
            information = np.block([[information, cross], [cross.T, own]])
        found = np.zeros((1 + len(information), 1 + len(information)))
        found[0, 0] = 2.0
        if len(information):
            values, vectors = np.linalg.eigh(information)
            good = values > order * np.finfo(float).eps * values[-1]
            found[1:, 1:] = (vectors[:, good] / values[good]) @ vectors[:, good].T
        return found


def _spectrum(coefficients: Floats | Sequence[float], length: int) -> Complexes:
    """Return 1 − Σ φ_j e^(−iωj) at the frequencies of a real transform."""
    padded = np.zeros(length)
    padded[0] = 1.0
    padded[1 : len(coefficients) + 1] = -np.asarray(coefficients)
    return np.asarray(fft.rfft(padded))


def most_orders(samples: int, length: int) -> int:
    """Return the highest order to try."""
    if samples < SETTINGS.enough:
        return 0
    return max(
        0, min(int(SETTINGS.orders_a_decade * math.log10(samples)), samples // SETTINGS.samples_an_order, length - 1)
    )


def autoregression(values: Floats, there: Flags) -> Autoregression:
    """Fit a series (n,) on a grid; `there` flags samples."""
    return fit(np.where(there, values, 0.0)[None], there, np.ones(1), most_orders(int(there.sum()), there.size))


def fit(columns: Floats, there: Flags, weights: Floats, orders: int) -> Autoregression:
    """Fit Σ weight_i x_i x_iᵀ of columns (m, n); zero where `there` (n,) is False."""
    samples = int(there.sum())
    variance = max(float(weights @ np.einsum("it,it->i", columns, columns)) / samples, SETTINGS.least_variance)
    longest = max(SETTINGS.longest, SETTINGS.records * there.size)
    reflections, scores = _burg(columns, weights, there, orders)
    order, model, response = len(scores), np.zeros(0), np.ones(1)
    while order > 0:
        order = 1 + int(np.argmin(scores[:order]))
        model = _model(reflections[:order], samples)
        response = impulse_response(model, longest)
        if order == 1 or np.abs(response).max() < SETTINGS.loudest:
            break
        order -= 1
    left = variance * math.prod(1.0 - each**2 for each in reflections[:order])
    found = Autoregression(model, left, samples, response.size)
    if not order:
        return found
    scores = [0.0, *scores]
    best = scores[order]
    # a long autoregression imitates slow noise; a short one leaves it to the better factor
    for own in {order, 1, 0} if order > 1 else {order}:
        model = _model(reflections[:own], samples)
        beneath = slow_noise(columns, weights, there, model)
        if beneath is not None and scores[own] - beneath.gain < best:
            best = scores[own] - beneath.gain
            memory = min(longest, math.ceil(math.log(SETTINGS.negligible) / math.log(beneath.pole)))
            memory += impulse_response(model, longest).size
            found = Autoregression(model, beneath.variance, samples, memory, beneath.pole, beneath.zero)
    return found


def _burg(columns: Floats, weights: Floats, there: Flags, orders: int) -> tuple[list[float], list[float]]:
    """Return reflection coefficients and BIC (Schwarz) of each order."""
    reflections: list[float] = []
    scores: list[float] = []
    score, length, gaps, mask = 0.0, there.size, not there.all(), there
    signs = np.sign(weights)
    ahead = np.multiply(columns, np.sqrt(np.abs(weights))[:, None], order="C")  # `ravel` below makes no copies
    behind, changes = ahead.copy(), np.empty(columns.size)
    for order in range(1, orders + 1):
        x, y = ahead[:, order:], behind[:, :-order]
        mask = mask[1:] & there[: length - order] if gaps else mask[1:]
        pairs = int(np.count_nonzero(mask)) if gaps else mask.size
        if pairs < 2 * order + SETTINGS.more_pairs:
            break
        if gaps:
            x *= mask
            y *= mask
        power = _sum_of_products(signs, x, x) + _sum_of_products(signs, y, y)
        cross = _sum_of_products(signs, x, y)
        if not power > 0.0:  # what is added to the moments may make them improper
            break
        found, most = 2.0 * cross / power, 1.0 - 1.0 / pairs
        reflection = min(max(found, -most), most)
        reflections.append(reflection)
        score += pairs * math.log(1.0 - reflection**2) + math.log(pairs)
        scores.append(score)
        if abs(found) > most:
            break
        # as one row, in a third of the time; pairs across columns are outside all later x and y
        flat_x, flat_y = ahead.ravel()[order:], behind.ravel()[:-order]
        change = np.multiply(flat_x, reflection, out=changes[order:])
        flat_x -= reflection * flat_y
        flat_y -= change
    return reflections, scores


def _sum_of_products(signs: Floats, x: Floats, y: Floats) -> float:
    """Return Σ_i sign_i Σ_t x_it y_it."""
    return float(signs @ (x[:, None, :] @ y[:, :, None])[:, 0, 0])


def _model(reflections: Sequence[float], samples: int) -> Floats:
    """Return coefficients by Levinson's recursion; order 1 without bias."""
    if len(reflections) == 1:
        most = max(1.0 - 1.0 / samples, abs(reflections[0]))
        return np.clip(np.array(reflections) * (1.0 + SETTINGS.bias / samples), -most, most)
    model = np.zeros(0)
    for reflection in reflections:
        model = np.concatenate([model - reflection * model[::-1], [reflection]])
    return model


def impulse_response(coefficients: Floats, longest: int) -> Floats:
    """Return h_0 = 1, h_t = Σ φ_j h_(t−j), as far as it matters."""
    order = coefficients.size
    if order < 2:
        pole = abs(float(coefficients.sum()))
        length = (
            min(longest, math.ceil(math.log(SETTINGS.negligible) / math.log(pole))) if 0.0 < pole < 1.0 else longest
        )
        return coefficients[0] ** np.arange(max(length, 1)) if pole else np.ones(1)
    # each block follows from the p values before, oldest first
    block = max(SETTINGS.block, order)
    first = np.zeros((block, order), order="F")
    for t in range(order):
        first[t, t:] = coefficients[t:][::-1]
    band = np.tile(np.concatenate([[1.0], -coefficients])[:, None], block)
    follow = scipy.linalg.lapack.dtbtrs(band, first, uplo="L", diag="U")[0]
    parts, before, loudest = [np.ones(1)], np.concatenate([np.zeros(order - 1), [1.0]]), 1.0
    length = 1
    while length < longest and loudest < SETTINGS.loudest:
        part = follow @ before
        largest = float(np.abs(part).max())
        loudest = max(loudest, largest)
        parts.append(part)
        length += block
        if largest < SETTINGS.negligible * loudest:
            break
        before = part[block - order :]
    whole = np.concatenate(parts)[:longest]
    return whole[: int(np.flatnonzero(np.abs(whole) > SETTINGS.negligible * loudest)[-1]) + 1]
