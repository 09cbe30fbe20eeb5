"""The criterion at many points: sums of squares in batches, and its map over two parameters.

A map is a section: the other parameters stay at the estimate. The confidence ellipse on it is that of the two
parameters together whatever the others are, from their block of the local covariance (1.31); with two parameters in
all it is the line where the criterion has risen by χ²(2), or 2 F(2, K − N) where noise variances are estimated. With
more, the section rises faster, and its own line at that level lies inside the ellipse.

References
----------
D. M. Bates, D. G. Watts, "Nonlinear Regression Analysis and Its Applications", chapter 6 (contours, sections), 1988;
G. A. F. Seber, C. J. Wild, "Nonlinear Regression", sections 2.2.3 (concentrated likelihood) and 5.4, 1989.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from fmuid.errors import InputError
from fmuid.estimators.box import spans_decades
from fmuid.problem import Problem
from fmuid.result import Result, check_level

Floats = NDArray[np.float64]
Ranges = Mapping[str, tuple[float, float]] | Literal["bounds"]

# Residuals below a millionth of the measurements are as good as none: comparing them would compare rounding.
LEAST_RESIDUAL = 1e-6
# Simulated samples held at a time, 8 MB; but never fewer simulations than keep all processors busy.
CHUNK, LEAST_BATCH = 1_000_000, 64
# Points along each side of a map: an odd number puts the estimate on the grid.
POINTS = 41
# How far a map reaches from the estimate, in standard deviations.
REACH = 4.0
# Points of an ellipse, two degrees apart, the last one the first again.
ELLIPSE_POINTS = 181


@dataclass(frozen=True, eq=False)
class Misfits:
    """The parts of the criterion at several thetas.

    Attributes
    ----------
    squares : (m, n_outputs) array
        Σ ε² of each output, NaN where the simulation failed.
    prior : (m,) array
        ‖W(θ₀ − θ)‖², the prior's part of (1.36).
    """

    squares: Floats
    prior: Floats

    def compound(self, variance: Floats) -> Floats:
        """Return J_C (1.36) with noise variances (n_outputs,), (m,)."""
        with np.errstate(over="ignore"):  # where simulations explode without failing
            return np.asarray((self.squares / variance).sum(axis=1) + self.prior, dtype=np.float64)

    def concentrated(self, problem: Problem) -> Floats:
        """Return J_C with the variances that each theta implies where none is given, (m,)."""
        least = least_variance(problem)
        implied = np.maximum(self.squares / problem.counts, least)
        estimated = np.isnan(problem.variance)
        given = self.squares / np.where(estimated, 1.0, problem.variance)
        parts = np.where(estimated, problem.counts * np.log(implied), given)
        return np.asarray(parts.sum(axis=1) + self.prior, dtype=np.float64)


def misfits(problem: Problem, thetas: Floats) -> Misfits:
    """Simulate thetas (m, N), as many at a time as memory allows, and sum up the squares of their residuals.

    The criterion itself needs no residual afterwards, so that maps and generations of any size fit into memory.
    """
    members = np.eye(problem.counts.size)[problem.groups]
    at_a_time = max(LEAST_BATCH, CHUNK // problem.measured.size)
    squares = np.empty((len(thetas), problem.counts.size))
    for first in range(0, len(thetas), at_a_time):
        rows = problem.predict(thetas[first : first + at_a_time])
        with np.errstate(over="ignore", invalid="ignore"):  # too large to be squared is as bad as failed
            squares[first : first + at_a_time] = (rows - problem.measured) ** 2 @ members
    return Misfits(squares, np.sum(problem.parameters.prior_residual(thetas) ** 2, axis=1))


def least_variance(problem: Problem) -> Floats:
    """Return the variance of each output (n_outputs,) below which a residual is as good as none."""
    least = LEAST_RESIDUAL**2 * problem.output_variances(problem.measured)
    return np.where(least > 0, least, 1.0)


def variances(problem: Problem, result: Result) -> Floats:
    """Return the noise variance of each output (n_outputs,): the given one, or the one that the result estimates."""
    estimated = np.array([result.noise_variance[name] for name in problem.output_names])
    return np.where(np.isnan(problem.variance), np.maximum(estimated, least_variance(problem)), problem.variance)


@dataclass(frozen=True, eq=False)
class CriterionMap:
    """The criterion over two parameters, the others held at the estimate.

    Attributes
    ----------
    names : tuple of two str
    table : DataFrame
        One row a point: the two parameters and ``criterion``, J_C (1.36), NaN where the simulation failed. The second
        parameter changes first.
    shape : tuple of two int
        Points along the first and the second parameter.
    logarithmic : tuple of two bool
        Whether the points divide a parameter's range logarithmically.
    estimate : (2,) array
    criterion : float
        At the estimate.
    covariance : (2, 2) array
        The two parameters' block of the local covariance.
    degrees_of_freedom : float
        As in `Result`.
    held : dict of str to float
        The other parameters.
    """

    names: tuple[str, str]
    table: pd.DataFrame
    shape: tuple[int, int]
    logarithmic: tuple[bool, bool]
    estimate: Floats
    criterion: float
    covariance: Floats
    degrees_of_freedom: float
    held: Mapping[str, float]

    @property
    def grid(self) -> tuple[Floats, Floats, Floats]:
        """The first parameter (n_1,), the second (n_2,), and the criterion (n_1, n_2)."""
        first, second, values = (self.table[name].to_numpy().reshape(self.shape) for name in (*self.names, "criterion"))
        return first[:, 0], second[0], values

    def rise(self, level: float = 0.95) -> float:
        """Return by how much the criterion rises on the border of the two parameters' confidence region.

        χ²(2) where all noise variances are given, 2 F(2, degrees of freedom) where they are estimated.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level, "a confidence ellipse")
        if math.isinf(self.degrees_of_freedom):
            return float(stats.chi2.ppf(level, 2))
        return float(2.0 * stats.f.ppf(level, 2, self.degrees_of_freedom))

    def ellipse(self, level: float = 0.95) -> Floats:
        """Return the border of the confidence ellipse, closed, (n, 2); (0, 2) where a parameter is not determined.

        The points θ̂ + √rise L (cos φ, sin φ) with L Lᵀ the covariance have all the same (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) = rise.
        """
        radius = math.sqrt(self.rise(level))
        if not np.isfinite(self.covariance).all():
            return np.empty((0, 2))
        angles = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        values, directions = np.linalg.eigh(self.covariance)  # which may be singular
        root = directions * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(self.estimate + radius * circle @ root.T, dtype=np.float64)


def refuse_loss(problem: Problem, what: str) -> None:
    """Refuse what sums plain squares for a problem that has another loss.

    Raises
    ------
    InputError
        If the problem's loss is not the plain square.
    """
    if problem.loss is not None:
        raise InputError(f"{what} knows plain squares only: give the problem no loss, or leave {what} out")


def map_criterion(
    problem: Problem,
    result: Result,
    first: str,
    second: str,
    *,
    points: int = POINTS,
    ranges: Ranges | None = None,
) -> CriterionMap:
    """Compute the criterion on a grid over two parameters around the estimate.

    Parameters
    ----------
    problem : Problem
    result : Result
        Of this problem; where noise variances are estimated, the criterion is that with its estimates.
    first, second : str
        The two parameters.
    points : int
        Along each of them.
    ranges : "bounds", or mapping of str to (low, high), optional
        How far the map reaches. Default: 4 standard deviations to both sides, but not beyond the bounds; for a
        parameter that is not determined the bounds, or its magnitude to both sides where there are none. Ranges that
        are positive and span a decade or more are divided logarithmically.

    Returns
    -------
    CriterionMap

    Raises
    ------
    InputError
        If a parameter is unknown or has no bounds where they are asked for, a range is empty or leaves the bounds, or
        the result is not of this problem.
    """
    refuse_loss(problem, "a map of the criterion")
    parameters = problem.parameters
    for what, theirs, ours in (
        ("parameters", result.names, parameters.names),
        ("outputs", tuple(result.noise_variance), problem.output_names),
    ):
        if theirs != ours:
            raise InputError(
                f"the map needs a result of its own problem: the {what} of the result are {', '.join(theirs)}, "
                f"those of the problem {', '.join(ours)}"
            )
    where = [parameters.index(first), parameters.index(second)]
    if first == second:
        raise InputError(f"a map needs two different parameters, not {first!r} twice")
    if isinstance(points, bool) or not isinstance(points, int) or points < 2:
        raise InputError(f"the points of a map along each parameter must be a whole number from 2 on, not {points!r}")
    if isinstance(ranges, Mapping):
        for name in ranges:
            parameters.index(name)
    spans = [_span(problem, result, i, ranges) for i in where]
    sides = [np.geomspace(*s, points) if spans_decades(*s) else np.linspace(*s, points) for s in spans]
    thetas = np.tile(result.values, (points * points + 1, 1))  # the last one is the estimate
    thetas[:-1, where] = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    values = misfits(problem, thetas).compound(variances(problem, result))
    return CriterionMap(
        names=(first, second),
        table=pd.DataFrame({first: thetas[:-1, where[0]], second: thetas[:-1, where[1]], "criterion": values[:-1]}),
        shape=(points, points),
        logarithmic=(spans_decades(*spans[0]), spans_decades(*spans[1])),
        estimate=result.values[where],
        criterion=float(values[-1]),
        covariance=result.covariance[np.ix_(where, where)],
        degrees_of_freedom=result.degrees_of_freedom,
        held={name: result[name] for name in parameters.names if name not in (first, second)},
    )


def _span(problem: Problem, result: Result, i: int, ranges: Ranges | None) -> tuple[float, float]:
    """Return the lowest and the highest value of one parameter on the map."""
    name = problem.parameters.names[i]
    low, high = float(problem.parameters.lower[i]), float(problem.parameters.upper[i])
    if isinstance(ranges, Mapping) and name in ranges:
        least, most = map(float, ranges[name])
        if not (low <= least < most <= high and math.isfinite(most - least)):
            raise InputError(
                f"the range {least:g} to {most:g} of {name!r} on the map must rise and lie within its bounds, "
                f"{low:g} to {high:g}"
            )
        return least, most
    bounded = math.isfinite(high - low)
    if ranges == "bounds" and not bounded:
        raise InputError(f"a map over the bounds needs min and max of {name!r}; give them, or its range on the map")
    value, std = float(result.values[i]), float(result.std[i])
    usable = 0.0 < std < math.inf
    if ranges == "bounds" or (bounded and not usable):
        return low, high
    reach = REACH * std if usable else float(problem.parameters.magnitudes(result.values)[i])
    return max(low, value - reach), min(high, value + reach)
