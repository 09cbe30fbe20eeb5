"""A criterion with many optima: the frequency of a sinusoid."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from fmuid import GlobalSearch, Noise, Parameter, Result
from fmuid.array_types import Floats
from fmuid.data import ParameterSet
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.estimation.global_search import Strategy
from fmuid.estimation.starting_points import Box
from fmuid.events import Event, GlobalStep, Progress

METHODS: tuple[Strategy, ...] = ("differential-evolution", "multi-start")
TIMES = np.linspace(0.0, 1.0, 120)
FREQUENCY = 37.0
RANGE = (2.0, 80.0)


def sinusoid(start: float = 12.0, noise: Noise | None = None) -> LeastSquares:
    """Return the estimation of one angular frequency: its criterion has a secondary optimum every few rad/s."""
    measured = np.sin(FREQUENCY * TIMES) + 0.2 * np.random.default_rng(4).normal(size=TIMES.size)
    parameter = Parameter(start, min=RANGE[0], max=RANGE[1])
    return LeastSquares.from_function(lambda theta: np.sin(theta[0] * TIMES), measured, {"w": parameter}, noise=noise)


@cache
def dense_minima() -> tuple[Floats, Floats]:
    """Return where the sum of squares of `sinusoid` has its minima, by a grid of 1e-3 rad/s, and its values there."""
    grid = np.arange(RANGE[0], RANGE[1], 1e-3)
    squares = np.sum((sinusoid().measured - np.sin(grid[:, None] * TIMES)) ** 2, axis=1)
    lows = 1 + np.flatnonzero((squares[1:-1] < squares[:-2]) & (squares[1:-1] < squares[2:]))
    return grid[lows], squares[lows]


def of_search(events: Sequence[Event]) -> list[GlobalStep]:
    """Return the events of a global search, which are all."""
    steps = [event for event in events if isinstance(event, GlobalStep)]
    assert len(steps) == len(events)
    return steps


def searched(problem: LeastSquares, settings: GlobalSearch | None = None, progress: Progress | None = None) -> Result:
    return (settings or GlobalSearch()).search(Evaluator(problem), progress)


# --- the box ----------------------------------------------------------------------------


def box(**parameters: Parameter) -> Box:
    return Box(ParameterSet(parameters))
