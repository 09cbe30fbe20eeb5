"""Autoregressive models of a residual: Burg's recursion over unbroken runs, the order chosen by BIC.

A model x(t) = Σ φ_j x(t − j) + w(t) is fitted to second moments: of the residual itself and of what the fit has taken
out of it (`fmuid.estimation.colour.sandwich`), columns that count by weights of either sign. Only pairs of samples with
all samples between them there count, so that gaps may be anywhere (de Waele and Broersen). Order 1 is the least from 25
samples on: chance hides a weak colour from any criterion, and leaving it out costs coverage. There Burg's estimate is
too small by 2 φ/n on average (Kendall, for a known mean), which is put right. Fewer samples tell nothing of a colour,
and are taken for white.

References
----------
J. P. Burg, "Maximum entropy spectral analysis", 37th meeting of the Society of Exploration Geophysicists, 1967;
S. de Waele, P. M. T. Broersen, "The Burg algorithm for segments", IEEE Trans. Signal Processing 48 (10), 2000;
M. G. Kendall, "Note on bias in the estimation of autocorrelation", Biometrika 41, 1954;
G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (2), 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from fmuid.arrays import Complexes, Floats

# Orders up to 10 log₁₀ n are tried, but not more than a quarter of the samples.
ORDERS_A_DECADE, ORDERS_SHARE = 10.0, 4
# An order needs pairs of samples: twice its number and so many more.
MORE_PAIRS = 4
# Of fewer samples no colour can be told.
ENOUGH = 25
# Kendall: E φ̂ = φ (1 − 2/n) of an autoregression of order 1 whose mean is known.
BIAS = 2.0
# An impulse response beyond this is rounding: poles too close to each other and to 1.
LOUDEST = 1e6
# The impulse response is followed until it stays below this share of its largest value ...
NEGLIGIBLE = 1e-4
# ... to this length, or so many times the length of the record.
LONGEST, RECORDS = 5000, 2
# Samples of the impulse response that are found at a time.
BLOCK = 64
# Where there is no variance at all.
LEAST_VARIANCE = 1e-300


@dataclass(frozen=True, eq=False)
class Autoregression:
    """An autoregressive process.

    Attributes
    ----------
    coefficients : (p,) array
        φ_1 to φ_p.
    variance : float
        Of the innovation w.
    samples : int
        That it was fitted to.
    memory : int
        After so many samples its impulse response is negligible.
    """

    coefficients: Floats
    variance: float
    samples: int
    memory: int = 1

    def transfer(self, length: int) -> Complexes:
        """Return 1/(1 − Σ φ_j e^(−iωj)) at the frequencies of a real transform of this length."""
        padded = np.zeros(length)
        padded[0] = 1.0
        padded[1 : self.coefficients.size + 1] = -self.coefficients
        return np.asarray(1.0 / fft.rfft(padded))

    @property
    def gain(self) -> float:
        """The variance of the process against that of its innovation, Σ h²."""
        return float(np.sum(impulse_response(self.coefficients, self.memory) ** 2))

    def scatter(self) -> Floats:
        """Return the covariance (1 + p, 1 + p) of log σ² and the coefficients, times the number of samples."""
        order = self.coefficients.size
        found = np.zeros((1 + order, 1 + order))
        found[0, 0] = 2.0
        if order:
            response = impulse_response(self.coefficients, self.memory)
            padded = np.concatenate([response, np.zeros(order)])
            correlation = [float(padded[: response.size] @ padded[k : k + response.size]) for k in range(order)]
            found[1:, 1:] = linalg.pinvh(linalg.toeplitz(correlation))
        return found


def most_orders(samples: int, length: int) -> int:
    """Return the highest order to try for so many samples on a grid of some length."""
    if samples < ENOUGH:
        return 0
    return max(0, min(int(ORDERS_A_DECADE * math.log10(samples)), samples // ORDERS_SHARE, length - 1))


def autoregression(values: Floats, there: NDArray[np.bool_]) -> Autoregression:
    """Fit an autoregressive model to a series on a grid (n,), with False in `there` (n,) where a sample is missing."""
    return fit(np.where(there, values, 0.0)[None], there, np.ones(1), most_orders(int(there.sum()), there.size))


def fit(columns: Floats, there: NDArray[np.bool_], weights: Floats, orders: int) -> Autoregression:
    """Fit an autoregressive model to the second moments Σ weight_i x_i x_iᵀ of columns x_i.

    Parameters
    ----------
    columns : (m, n) array
        The series on a grid, zero where a sample is missing.
    there : (n,) array of bool
        False where a sample is missing.
    weights : (m,) array
        Of either sign.
    orders : int
        The highest order.
    """
    samples = int(there.sum())
    variance = max(_moment(weights, columns, columns) / samples, LEAST_VARIANCE)
    longest = max(LONGEST, RECORDS * there.size)
    while True:
        model, left = _burg(columns, weights, there, orders, variance)
        if model.size == 1:
            most = max(1.0 - 1.0 / samples, abs(float(model[0])))
            model = np.clip(model * (1.0 + BIAS / samples), -most, most)
        response = impulse_response(model, longest)
        if model.size <= 1 or np.abs(response).max() < LOUDEST:
            return Autoregression(model, left, samples, response.size)
        orders = model.size - 1


def _moment(weights: Floats, left: Floats, right: Floats) -> float:
    return float(weights @ np.einsum("it,it->i", left, right))


def _burg(
    columns: Floats, weights: Floats, there: NDArray[np.bool_], orders: int, variance: float
) -> tuple[Floats, float]:
    """Return the coefficients that BIC chooses and the variance that they leave."""
    model, score = np.zeros(0), 0.0
    best, chosen = math.inf, (model, variance)
    ahead, behind, mask = columns[:, 1:], columns[:, :-1], there[1:] & there[:-1]
    for order in range(1, orders + 1):
        pairs = int(mask.sum())
        if pairs < 2 * order + MORE_PAIRS:
            break
        if pairs < mask.size:
            ahead, behind = ahead * mask, behind * mask
        power = _moment(weights, ahead, ahead) + _moment(weights, behind, behind)
        if not power > 0.0:  # what is added to the moments may make them improper
            break
        found, most = 2.0 * _moment(weights, ahead, behind) / power, 1.0 - 1.0 / pairs
        reflection = min(max(found, -most), most)
        model = np.concatenate([model - reflection * model[::-1], [reflection]])
        variance *= 1.0 - reflection**2
        score += pairs * math.log(1.0 - reflection**2) + math.log(pairs)
        if score < best:
            best, chosen = score, (model, variance)
        if abs(found) > most:
            break
        ahead, behind = (ahead - reflection * behind)[:, 1:], (behind - reflection * ahead)[:, :-1]
        mask = mask[1:] & mask[:-1]
    return chosen


def impulse_response(coefficients: Floats, longest: int) -> Floats:
    """Return h_0 = 1, h_t = Σ φ_j h_(t−j), to where it has become negligible, or the length given."""
    order = coefficients.size
    if not order:
        return np.ones(1)
    # a block of it follows from the p values before
    block = max(BLOCK, order)
    rows = np.vstack([np.eye(order), np.zeros((block, order))])  # what came before, oldest first, then the block
    for t in range(order, order + block):
        rows[t] = coefficients[::-1] @ rows[t - order : t]
    follow = rows[order:]
    parts, before, loudest = [np.ones(1)], np.concatenate([np.zeros(order - 1), [1.0]]), 1.0
    length = 1
    while length < longest and loudest < LOUDEST:
        part = follow @ before
        largest = float(np.abs(part).max())
        loudest = max(loudest, largest)
        parts.append(part)
        length += block
        if largest < NEGLIGIBLE * loudest:
            break
        before = part[block - order :]
    whole = np.concatenate(parts)[:longest]
    return whole[: int(np.flatnonzero(np.abs(whole) > NEGLIGIBLE * loudest)[-1]) + 1]
