"""Simulation noise: irregularity of outputs over parameters (docs/method/sensitivities.md).

Reference: Moré and Wild, "Estimating computational noise", SIAM J. Sci. Comput. 33 (3), 2011.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Flags, Floats, Indices

Predict = Callable[[Floats], Floats]  # simulates thetas (m, N); returns stacked outputs (m, n), NaN rows if failed


@dataclass(frozen=True)
class SimulationNoiseSettings:
    """Numbers of a difference table (Moré and Wild 2011, section 5)."""

    points: int = 7  # of the table, with the point itself
    spacing: float = 3e-4  # relative; integrators decide anew, but sixth differences of the smooth part vanish
    falling: float = 0.5  # sixth against fifth differences; if they fall faster, the smooth part hides the noise, ...
    negligible: float = 1e-13  # ... unless it is below this share of the output; ...
    closer: float = 1.0 / 30.0  # ... the next table is closer by this
    most_tables: int = 3  # each closer than the last
    largest_value: float = 1e100  # norm; larger ones count as failed: squares of their derivatives may overflow
    rounding: float = 2.0**-53  # of a stored output in double precision


NOISE = SimulationNoiseSettings()


def noise_level(predict: Predict, theta: Floats, steps: Floats, shares: Floats) -> tuple[Floats, Floats]:
    """Return the simulation (n,) at theta and each output's noise; NaN and infinite if it fails.

    All parameters change at once, by `steps` (N,). The least of γ_k mean (Δᵏf)², γ_k = (k!)²/(2k)!, over k is ε².
    """
    level = np.full(shares.shape[1], np.inf)
    base = predict(theta[None])[0]  # by itself: where it fails, the others are not worth a simulation
    if not usable(base):
        return np.full_like(base, np.nan), level
    rounding = NOISE.rounding * np.sqrt(base**2 @ shares)
    for _ in range(NOISE.most_tables):
        table = np.vstack([base, predict(theta + np.arange(1, NOISE.points)[:, None] * steps)])
        if usable(table).all():
            deviations = _difference_table(table, shares)
            level = np.maximum(np.minimum(level, deviations.min(axis=0)), rounding)
            falling = deviations[-1] < NOISE.falling * deviations[-2]
            hidden = falling & (level > NOISE.negligible / NOISE.rounding * rounding)
            if not hidden.any():
                break
        steps = steps * NOISE.closer
    else:
        # every table met a failing simulation: with nothing known, the rounding of single precision
        level = np.where(np.isfinite(level), level, np.sqrt(NOISE.rounding) * np.sqrt(base**2 @ shares))
    return base, level


def noise_steps(magnitudes: Floats, below: Floats, above: Floats) -> Floats:
    """Return the steps (N,) of a difference table, towards the farther bound."""
    steps = np.minimum(NOISE.spacing * magnitudes, np.maximum(above, below) / (NOISE.points - 1))
    return np.asarray(steps * np.where(above >= below, 1.0, -1.0))


def noise_along(predict: Predict, theta: Floats, base: Floats, steps: Floats, room: Floats) -> Floats | None:
    """Simulate a difference table centered at theta, (NOISE.points, n); None if a simulation fails."""
    half = NOISE.points // 2
    places = np.delete(np.arange(-half, half + 1.0), half)
    found = predict(theta + places[:, None] * np.clip(steps, -room / half, room / half))
    return np.insert(found, half, base, axis=0) if usable(found).all() else None


def table_noise(table: Floats, shares: Floats) -> Floats:
    """Return each output's noise in a difference table, zero if hidden."""
    deviations = _difference_table(table, shares)
    return np.where(deviations[-1] < NOISE.falling * deviations[-2], 0.0, deviations.min(axis=0))


def shares_of(groups: Indices, count: int) -> Floats:
    """Return the matrix (n, count) of means over each output's samples."""
    shares = np.zeros((groups.size, count))
    shares[np.arange(groups.size), groups] = 1.0 / np.bincount(groups, minlength=count)[groups]
    return shares


def _difference_table(table: Floats, shares: Floats) -> Floats:
    """Return sqrt(γ_k mean (Δᵏf)²) by order and output."""
    deviations = []
    table, squares = table.copy(), np.empty_like(table)  # in place: fresh memory costs more than the differences
    for order in range(1, len(table)):
        left = len(table) - order
        for i in range(left):
            np.subtract(table[i + 1], table[i], out=table[i])
        np.square(table[:left], out=squares[:left])
        gamma = math.factorial(order) ** 2 / math.factorial(2 * order)
        deviations.append(np.sqrt(gamma * np.mean(squares[:left] @ shares, axis=0)))
    return np.array(deviations)


def usable(values: Floats) -> Flags:
    """Return True for values (..., n) whose squares are finite."""
    return np.asarray(np.einsum("...n,...n->...", values, values) < NOISE.largest_value**2)
