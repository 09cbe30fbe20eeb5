"""Whether parameters act on what is measured, if not where the search begins then elsewhere in their box.

Friction at rest, a dead zone or a limit that is not reached change nothing at the start, and no derivative there tells
where they would. So a few points are tried: of each such parameter alone, then of all of them at random.
"""

from __future__ import annotations

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.errors import InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.finite_differences import INFLUENCE_NOISES, LARGEST_STEP
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.simulation_noise import ROUNDING_SHARE, usable

# Where in its range a bounded parameter is tried, and at how many times its value or magnitude one that is not.
RANGE_SHARES = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
VALUE_MULTIPLES = (0.01, 0.1, 0.3, 3.0, 10.0, -0.1, -1.0, -10.0)
# Points at random, the seed of the random numbers, and at how many of the best points influence is looked for.
RANDOM_POINTS, SEED, BEST_POINTS = 16, 0, 8


def inactive_parameters(problem: LeastSquares, acting: Flags) -> Indices:
    """Return the parameters that act on nothing and have no prior."""
    known = (problem.parameters.prior_whitening != 0).any(axis=0)
    return np.flatnonzero(~acting & ~known)


def find_active_point(
    evaluator: Evaluator[LeastSquares], theta: Floats, idle: Indices, noise: Floats, weights: Floats
) -> Floats:
    """Return the best point near theta at which parameters act that do not at theta.

    Parameters
    ----------
    evaluator : Evaluator
    theta : (N,) array
        A point that can be simulated.
    idle : (k,) array of int
        The parameters that act on nothing there; only they are moved.
    noise, weights : (n,) arrays
        Standard deviation of the simulation's noise in each sample, and of what a residual is worth there.

    Raises
    ------
    InputError
        If one of them acts nowhere.
    """
    problem = evaluator.problem
    points = _points(problem, theta, idle)
    values = evaluator.predict(np.vstack([theta, points]))
    base, values = values[0], values[1:]
    floor = INFLUENCE_NOISES * np.maximum(noise, ROUNDING_SHARE * np.abs(base))
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
    """Return the error on parameters that change no output, with how many points were tried besides the start."""
    names = ", ".join(f"{problem.parameters.names[i]!r} (start {theta[i]:g})" for i in idle)
    said, their, them = f"parameter {names} changes", "its", "it"
    if idle.size > 1:
        said, their, them = f"parameters {names} change", "their", "them"
    return InputError(
        f"{said} no measured output at the start, nor at {tried} other points of {their} box; check that the "
        f"model uses what is set, start elsewhere, measure an output that depends on {them}, give a prior, or hold "
        f"{them} at a value"
    )


def _points(problem: LeastSquares, theta: Floats, idle: Indices) -> Floats:
    """Return points (m, N) that differ from theta in one idle parameter, then some that differ in all."""
    places = [_places(problem, theta, i) for i in idle]
    rows = []
    for i, values in zip(idle, places, strict=True):
        for value in values:
            rows.append(theta.copy())
            rows[-1][i] = value
    rng = np.random.default_rng(SEED)
    for _ in range(RANDOM_POINTS if idle.size > 1 else 0):
        rows.append(theta.copy())
        rows[-1][idle] = [rng.choice(values) for values in places]
    return np.array(rows).reshape(-1, theta.size)


def _places(problem: LeastSquares, theta: Floats, i: int) -> Floats:
    """Return the values of one parameter to try."""
    parameters = problem.parameters
    lower, upper = parameters.lower[i], parameters.upper[i]
    if np.isfinite(upper - lower):
        shares = np.array(RANGE_SHARES)
        return np.asarray(lower + shares * (upper - lower))
    size = theta[i] if theta[i] else parameters.scale[i]
    values = np.unique(np.clip(size * np.array(VALUE_MULTIPLES), lower, upper))
    return np.asarray(values[values != theta[i]])


def _acting(evaluator: Evaluator[LeastSquares], points: Floats, values: Floats, idle: Indices, noise: Floats) -> Flags:
    """Return which of the idle parameters act at each point (m, k), by moving them by a tenth."""
    parameters = evaluator.problem.parameters
    if not len(points):
        return np.zeros((0, idle.size), dtype=np.bool_)
    moved = np.repeat(points[:, None], idle.size, axis=1)
    for k, i in enumerate(idle):
        step = LARGEST_STEP * parameters.reach(points)[:, i]
        there = points[:, i] + step
        moved[:, k, i] = np.where(
            there <= parameters.upper[i], there, np.maximum(points[:, i] - step, parameters.lower[i])
        )
    found = evaluator.predict(moved.reshape(-1, points.shape[1])).reshape(len(points), idle.size, -1)
    floor = INFLUENCE_NOISES * np.maximum(noise, ROUNDING_SHARE * np.abs(values))[:, None]
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(found - values[:, None]) > floor).any(axis=2))
