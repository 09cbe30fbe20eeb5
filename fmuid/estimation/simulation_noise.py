"""The noise of a simulation: how much neighbouring parameter values differ by nothing but numerics.

A simulator with an adaptive integrator inside is not a smooth function: between neighbouring parameter values its
steps and iterations change, and the outputs jump by something near its tolerance.

References
----------
J. J. Moré, S. M. Wild, "Estimating computational noise", SIAM J. Sci. Comput. 33 (3), 2011 (the difference table).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Flags, Floats, Indices

Predict = Callable[[Floats], Floats]
"""Simulates thetas (m, N) and gives stacked outputs (m, n); the rows of failed simulations hold NaN."""

# Points of the difference table, the first being the point itself: seven suffice (Moré and Wild 2011, section 5).
NOISE_POINTS = 7
# Distance of these points, relative to the parameters: wide enough that an adaptive integrator takes other decisions
# from point to point, narrow enough that sixth differences of the smooth part (its sixth power) drown in rounding.
NOISE_SPACING = 3e-4
# Where sixth differences still fall this fast against fifth ones, the smooth part hides the noise ...
FALLING_RATIO = 0.5
# ... which matters unless what is left is this small against the output; the table is then laid closer ...
NEGLIGIBLE_NOISE = 1e-13
CLOSER_FACTOR = 1.0 / 30.0
# ... at most this often.
MOST_NOISE_TABLES = 3
# Values so large together that squares of their derivatives would overflow count as a simulation that failed.
LARGEST_VALUE = 1e100
# Rounding of a stored output, half a unit in the last place of double precision.
ROUNDING_SHARE = 2.0**-53


@dataclass(frozen=True, eq=False)
class SimulationNoise:
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
    groups: Indices,
    count: int,
) -> tuple[Floats, SimulationNoise]:
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
    level : SimulationNoise
    """
    above, below = upper - theta, theta - lower
    direction, room = np.where(above >= below, 1.0, -1.0), np.maximum(above, below)
    steps = np.minimum(NOISE_SPACING * magnitudes, room / (NOISE_POINTS - 1))
    shares = shares_of(groups, count)
    level = np.full(count, np.inf)
    base = predict(theta[None])[0]  # by itself: where it fails, the others are not worth a simulation
    simulated = 1
    if not usable(base):
        return np.full_like(base, np.nan), SimulationNoise(level, simulated)
    rounding = ROUNDING_SHARE * np.sqrt(base**2 @ shares)
    for _ in range(MOST_NOISE_TABLES):
        points = theta + np.arange(1, NOISE_POINTS)[:, None] * (steps * direction)
        table = np.vstack([base, predict(points)])
        simulated += len(points)
        if usable(table).all():
            deviations = _difference_table(table, shares)
            level = np.maximum(np.minimum(level, deviations.min(axis=0)), rounding)
            falling = deviations[-1] < FALLING_RATIO * deviations[-2]
            hidden = falling & (level > NEGLIGIBLE_NOISE / ROUNDING_SHARE * rounding)
            if not hidden.any():
                break
        steps = steps * CLOSER_FACTOR
    else:
        # every table met a failing simulation: with nothing known, the rounding of single precision
        level = np.where(np.isfinite(level), level, np.sqrt(ROUNDING_SHARE) * np.sqrt(base**2 @ shares))
    return base, SimulationNoise(level, simulated)


def noise_along(predict: Predict, theta: Floats, base: Floats, steps: Floats, room: Floats) -> Floats | None:
    """Simulate a table of differences centred at a point that has been simulated, for `table_noise`.

    Parameters
    ----------
    predict : callable
    theta, base : (N,) and (n,) arrays
        The point and the simulation there.
    steps : (N,) array
        From point to point.
    room : (N,) array
        How far each parameter may go to either side.

    Returns
    -------
    (NOISE_POINTS, n) array, or None where a simulation fails.
    """
    half = NOISE_POINTS // 2
    places = np.delete(np.arange(-half, half + 1.0), half)
    found = predict(theta + places[:, None] * np.clip(steps, -room / half, room / half))
    return np.insert(found, half, base, axis=0) if usable(found).all() else None


def table_noise(table: Floats, shares: Floats) -> Floats:
    """Return the noise (count,) of outputs in a table of differences, zero where their smooth part hides it."""
    deviations = _difference_table(table, shares)
    return np.where(deviations[-1] < FALLING_RATIO * deviations[-2], 0.0, deviations.min(axis=0))


def shares_of(groups: Indices, count: int) -> Floats:
    """Return the matrix (n, count) that takes the mean over each output's samples."""
    shares = np.zeros((groups.size, count))
    shares[np.arange(groups.size), groups] = 1.0 / np.bincount(groups, minlength=count)[groups]
    return shares


def _difference_table(table: Floats, shares: Floats) -> Floats:
    """Return the deviations sqrt(γ_k mean (Δᵏf)²) of every order k and output, (NOISE_POINTS − 1, count).

    `shares` (n, count) takes the mean over each output's samples.
    """
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
    """Return whether all values (..., n) are finite, and small enough that their squares are (...)."""
    return np.asarray(np.einsum("...n,...n->...", values, values) < LARGEST_VALUE**2)
