"""Noise whose variance follows the signal, its slope or the time: e = D ε with a diagonal D, ε of constant variance.

Koenker's test (J. Econometrics 17, 1981) of squared innovations; D² = 1 + b (s − 1) is most likely for the strongest
signal s of mean 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.estimation.noise.model import NoiseModel


@dataclass(frozen=True)
class UnevenNoiseSettings:
    """Numbers of the test."""

    level: float = 0.01  # false alarms of all outputs together
    least_variance: float = 1e-4  # of the mean variance
    least_samples: int = 50
    least_signal: float = 1e-3  # of the largest: a reading near zero has the noise of its zero


SETTINGS = UnevenNoiseSettings()


def uneven_levels(
    models: Sequence[NoiseModel], residual: Floats, simulated: Floats, left: Floats | None = None
) -> Floats | None:
    """Return the relative std (n,) of rows by experiment and output; None if constant.

    Few rows without order tell little: their variance is the mean of constant and relative noise, by likelihood.
    `left` (n,) is the share of each row's variance that the fit leaves; None: the form of the noise is stated.
    """
    found, any_uneven = np.ones(len(residual)), False
    for each in models:
        rows = each.series.rows
        if not np.isfinite(simulated[rows]).all():
            continue
        if len(rows) < SETTINGS.least_samples:
            if left is not None and not each.series.ordered:
                variance = _either(residual[rows] ** 2, simulated[rows], left[rows])
                if variance is not None:
                    found[rows], any_uneven = np.sqrt(variance), True
            continue
        variance = _variance(each, residual[rows], simulated[rows], SETTINGS.level / len(models))
        if variance is not None:
            found[rows], any_uneven = np.sqrt(variance), True
    return found if any_uneven else None


def _variance(model: NoiseModel, residual: Floats, signal: Floats, level: float) -> Floats | None:
    """Return the relative variance of each sample (n,), None if constant; rows without order have no slope."""
    squares, ordered = model.whiten(residual) ** 2, model.series.ordered
    signal = signal / max(float(np.abs(signal).max()), 1e-300)  # squares of any unit
    signals = [signal**2]
    signals += [np.gradient(signal) ** 2, np.arange(len(signal), dtype=np.float64)] if ordered else []
    signals = [each for each in signals if np.ptp(each) > 0.0]
    columns = [each - each.mean() for each in signals]
    centered = squares - squares.mean()
    if not columns or not centered.any():
        return None
    unit = np.stack([each / np.linalg.norm(each) for each in columns], axis=1)
    products = unit.T @ centered
    i = int(np.argmax(np.abs(products)))
    with np.errstate(over="ignore"):  # far from a fit, of which nothing is said then
        score = abs(float(products[i])) / math.sqrt(float(np.mean(centered**2)))
    if 2.0 * special.ndtr(-score) * len(columns) > level:
        return None
    return _most_likely(model, residual, signals[i])


def _either(squares: Floats, signal: Floats, left: Floats) -> Floats | None:
    """Return the relative variance (n,), the mean of both forms."""
    signal = np.maximum(np.abs(signal), SETTINGS.least_signal * np.abs(signal).max(initial=0.0))
    count = float(left.sum())
    if not squares.any() or count < 1.0 or np.ptp(signal) == 0.0:
        return None
    forms = np.stack([np.ones_like(signal), signal**2])
    variances = (squares / forms).sum(axis=1) / count
    cost = 0.5 * (np.log(forms) @ left + count * np.log(variances))
    likely = special.softmax(-cost)
    found = (likely * variances) @ forms
    return np.asarray(found / found.mean())


def _most_likely(model: NoiseModel, residual: Floats, signal: Floats) -> Floats:
    """Return the most likely variance (n,) of e = D ε, relative."""
    from scipy.optimize import minimize_scalar  # slow to import

    change = signal / signal.mean() - 1.0

    def cost(slope: float) -> float:
        variance = 1.0 + slope * change
        squares = model.whiten(residual / np.sqrt(variance)) ** 2
        return math.log(np.mean(squares)) + float(np.mean(np.log(variance)))

    reach = 1.0 - SETTINGS.least_variance
    bounds = -reach / float(change.max()), -reach / float(change.min())
    return np.asarray(1.0 + minimize_scalar(cost, bounds=bounds, method="bounded").x * change)
