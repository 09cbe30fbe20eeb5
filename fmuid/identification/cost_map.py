"""Maps of the cost over two parameters, the others at the estimate.

The confidence ellipse is that of the two parameters whatever the others are, from their block of the covariance (1.31).
With more than two parameters the section rises faster: its own contour lies inside the ellipse (Bates and Watts, 1988).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import LeastSquares, Result, check_level, misfits, refuse_loss, spans_decades, variances
from fmuid.identification.acquisition_delay import delayed


@dataclass(frozen=True)
class CostMapSettings:
    """Numbers of a map."""

    points: int = 41  # along each side; an odd number puts the estimate on the grid
    span_stds: float = 4.0  # reach of a map from the estimate, in σ
    ellipse_points: int = 181  # points of an ellipse, two degrees apart, the last one the first again


SETTINGS = CostMapSettings()


@dataclass(frozen=True, eq=False)
class CostMap:
    """Cost over two parameters, the others at the estimate.

    Attributes
    ----------
    names : tuple of two str
    table : DataFrame
        The parameters and ``cost``, J_C (1.37), NaN where failed; the second parameter changes first.
    shape : tuple of two int
        Points along the first and the second parameter.
    logarithmic : tuple of two bool
        Logarithmic division of each range.
    estimate : (2,) array
    cost : float
        At the estimate.
    covariance : (2, 2) array
        Of the two parameters, for white noise.
    scale, degrees_of_freedom : float
        Factor of the region for colored noise (`Result.test_scale`), and degrees of freedom of both.
    held : dict of str to float
        The other parameters.
    """

    names: tuple[str, str]
    table: pd.DataFrame
    shape: tuple[int, int]
    logarithmic: tuple[bool, bool]
    estimate: Floats
    cost: float
    covariance: Floats
    scale: float
    degrees_of_freedom: float
    held: Mapping[str, float]

    json_layout: ClassVar = Layout(omitted={"table"})

    @property
    def grid(self) -> tuple[Floats, Floats, Floats]:
        """The first parameter (n_1,), the second (n_2,), and the cost (n_1, n_2)."""
        first, second, values = (self.table[name].to_numpy().reshape(self.shape) for name in (*self.names, "cost"))
        return first[:, 0], second[0], values

    def rise(self, level: float = 0.95) -> float:
        """Return the rise of the cost at the confidence region.

        χ²(2) for known noise variances, else 2 F(2, degrees of freedom), times `scale`.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level, "a confidence ellipse")
        return self.scale * region_rise(level, self.degrees_of_freedom)

    def ellipse(self, level: float = 0.95) -> Floats:
        """Return the closed border of the confidence ellipse (n, 2).

        It is empty where a parameter is not identifiable.
        """
        radius = math.sqrt(self.rise(level))
        if not np.isfinite(self.covariance).all():
            return np.empty((0, 2))
        return ellipse(self.estimate, self.covariance, radius)


def ellipse(center: Floats, covariance: Floats, radius: float) -> Floats:
    """Return the closed line (n, 2) at `radius` standard deviations."""
    angles = np.linspace(0.0, 2.0 * np.pi, SETTINGS.ellipse_points)
    values, directions = np.linalg.eigh(covariance)  # which may be singular
    root = directions * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1) @ root.T)


def region_rise(level: float, freedom: float) -> float:
    """Return the quantile of χ²(2); with ν degrees of freedom that of 2 F(2, ν): the rise of the cost at a region."""
    beyond = math.log1p(-level)
    return -2.0 * beyond if math.isinf(freedom) else freedom * math.expm1(-2.0 * beyond / freedom)


@single_threaded
def map_cost(
    problem: LeastSquares,
    result: Result,
    first: str,
    second: str,
    *,
    points: int = SETTINGS.points,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> CostMap:
    """Compute the cost on a grid over two parameters around the estimate.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of this problem; its noise variances serve.
    first, second : str
        The two parameters.
    points : int
        Along each of them.
    ranges : mapping of str to (low, high), optional
        Default: ±4 σ within the bounds; if not identifiable, the bounds or ± the magnitude. A decade or more is divided
        logarithmically.

    Raises
    ------
    InputError
        If a parameter is unknown, a range is empty or leaves the bounds, or the result is of another problem.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> fmuid.map_cost(problem, result, "R", "L", points=3).names
    ('R', 'L')
    """
    refuse_loss(problem, "a map of the cost")
    evaluator, result = delayed(problem, result)
    problem, parameters = evaluator.problem, evaluator.problem.parameters
    where = [parameters.index(first), parameters.index(second)]
    if first == second:
        raise InputError(f"a map needs two different parameters, not {first!r} twice.")
    if isinstance(points, bool) or not isinstance(points, int) or points < 2:
        raise InputError(f"points of a map: must be a whole number from 2 on, not {points!r}.")
    for name in ranges or {}:
        parameters.index(name)
    spans = [_span(problem, result, i, ranges or {}) for i in where]
    sides = [np.geomspace(*s, points) if spans_decades(*s) else np.linspace(*s, points) for s in spans]
    thetas = np.tile(result.values, (points * points + 1, 1))  # the last one is the estimate
    thetas[:-1, where] = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    values = misfits(evaluator, thetas).compound(variances(problem, result))
    return CostMap(
        names=(first, second),
        table=pd.DataFrame({first: thetas[:-1, where[0]], second: thetas[:-1, where[1]], "cost": values[:-1]}),
        shape=(points, points),
        logarithmic=(spans_decades(*spans[0]), spans_decades(*spans[1])),
        estimate=result.values[where],
        cost=float(values[-1]),
        covariance=result.estimates.covariance_white_noise[np.ix_(where, where)],
        scale=result.estimates.test_scale([first, second]),
        degrees_of_freedom=result.estimates.test_dof([first, second]),
        held={name: result[name] for name in parameters.names if name not in (first, second)},
    )


def _span(
    problem: LeastSquares, result: Result, i: int, ranges: Mapping[str, tuple[float, float]]
) -> tuple[float, float]:
    name = problem.parameters.names[i]
    low, high = float(problem.parameters.lower[i]), float(problem.parameters.upper[i])
    if name in ranges:
        least, most = map(float, ranges[name])
        if not (low <= least < most <= high and math.isfinite(most - least)):
            raise InputError(
                f"range of {name!r} on the map: {least:g} to {most:g} must rise within the bounds [{low:g}, {high:g}]."
            )
        return least, most
    value, std = float(result.values[i]), float(result.std[i])
    usable = 0.0 < std < math.inf
    if math.isfinite(high - low) and not usable:
        return low, high
    reach = SETTINGS.span_stds * std if usable else float(problem.parameters.magnitudes(result.values)[i])
    return max(low, value - reach), min(high, value + reach)
