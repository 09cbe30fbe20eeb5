"""Parameters without effect at the initial guess: friction at rest, dead zones, limits.

A few points of the box are tried: each parameter alone, then all at random.
"""

from __future__ import annotations

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.errors import InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.finite_differences import DIFFERENCES
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.simulation_noise import NOISE, usable

# Trial values of a bounded parameter (shares of its range) and of another one (multiples of value or scale).
RANGE_SHARES = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
VALUE_MULTIPLES = (0.01, 0.1, 0.3, 3.0, 10.0, -0.1, -1.0, -10.0)
RANDOM_POINTS, SEED = 16, 0  # with all parameters changed
BEST_POINTS = 8  # at which effects are examined


def find_active_point(
    evaluator: Evaluator[LeastSquares], theta: Floats, idle: Indices, noise: Floats, weights: Floats
) -> Floats:
    """Return the best near point with an effect of idle parameters; `noise` and `weights` are of samples (n,)."""
    problem = evaluator.problem
    points = _points(problem, theta, idle)
    values = evaluator.predict(np.vstack([theta, points]))
    base, values = values[0], values[1:]
    floor = DIFFERENCES.effect * np.maximum(noise, NOISE.rounding * np.abs(base))
    with np.errstate(invalid="ignore", over="ignore"):  # what failed is NaN, and not different
        different = usable(np.nan_to_num(values, nan=np.inf)) & (np.abs(values - base) > floor).any(axis=1)
        squares = np.where(different, np.sum(((values - problem.measured) * weights) ** 2, axis=1), np.inf)
    chosen = np.argsort(squares, kind="stable")[: min(BEST_POINTS, int(different.sum()))]
    acts = _acting(evaluator, points[chosen], values[chosen], idle, noise)
    moved = points[different] != theta
    alone = moved[moved.sum(axis=1) == 1].any(axis=0)[idle] if len(moved) else np.zeros(idle.size, dtype=np.bool_)
    lost = idle[~(acts.any(axis=0) | alone)]
    if lost.size:
        raise _refusal(problem, theta, lost, len(points))
    best = int(np.argmax(acts.sum(axis=1))) if len(chosen) else 0  # the first of equals fits best
    return np.asarray(points[chosen[best]])


def _refusal(problem: LeastSquares, theta: Floats, idle: Indices, tried: int) -> InputError:
    """Return the error for parameters without effect."""
    names = ", ".join(f"{problem.parameters.names[i]!r} (start {theta[i]:g})" for i in idle)
    said, their, them = f"parameter {names} changes", "its", "it"
    if idle.size > 1:
        said, their, them = f"parameters {names} change", "their", "them"
    return InputError(
        f"{said} no measured output at the start, nor at {tried} other points of {their} box. "
        f"Fix {them}, give a prior, or measure an output that depends on {them}."
    )


def _points(problem: LeastSquares, theta: Floats, idle: Indices) -> Floats:
    """Return points (m, N): one idle parameter changed, then all of them."""
    places = [_places(problem, theta, i) for i in idle]
    alone = [(i, value) for i, values in zip(idle, places, strict=True) for value in values]
    points = np.tile(theta, (len(alone) + (RANDOM_POINTS if idle.size > 1 else 0), 1))
    for row, (i, value) in zip(points, alone, strict=False):
        row[i] = value
    rng = np.random.default_rng(SEED)
    for row in points[len(alone) :]:
        row[idle] = [rng.choice(values) for values in places]
    return points


def _places(problem: LeastSquares, theta: Floats, i: int) -> Floats:
    """Return trial values of one parameter."""
    parameters = problem.parameters
    lower, upper = parameters.lower[i], parameters.upper[i]
    if np.isfinite(upper - lower):
        return np.asarray(lower + np.array(RANGE_SHARES) * (upper - lower))
    size = theta[i] if theta[i] else parameters.scale[i]
    values = np.unique(np.clip(size * np.array(VALUE_MULTIPLES), lower, upper))
    return np.asarray(values[values != theta[i]])


def _acting(evaluator: Evaluator[LeastSquares], points: Floats, values: Floats, idle: Indices, noise: Floats) -> Flags:
    """Return flags (m, k) of idle parameters with an effect."""
    parameters = evaluator.problem.parameters
    if not len(points):
        return np.zeros((0, idle.size), dtype=np.bool_)
    moved, own = np.repeat(points[:, None], idle.size, axis=1), points[:, idle]
    step = DIFFERENCES.largest_step * parameters.reach(points)[:, idle]
    back = np.maximum(own - step, parameters.lower[idle])
    moved[:, np.arange(idle.size), idle] = np.where(own + step <= parameters.upper[idle], own + step, back)
    found = evaluator.predict(moved.reshape(-1, points.shape[1])).reshape(len(points), idle.size, -1)
    floor = DIFFERENCES.effect * np.maximum(noise, NOISE.rounding * np.abs(values))[:, None]
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(found - values[:, None]) > floor).any(axis=2))
