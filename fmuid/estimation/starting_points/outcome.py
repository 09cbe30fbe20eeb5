"""What was tried where a search from the start that was given failed or fits badly, as values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from fmuid.estimation.search.loop import TerminationReason


class StartingPointSource(Enum):
    """Where a search set out from; the values are what ``result.json`` has."""

    GIVEN = "given"
    """The start that was given."""
    EQUATION_ERROR = "equation_error"
    """Where the model's equations hold best at the measured states (`fmuid.estimation.starting_points.weak_form`)."""
    CORRECTION = "correction"
    """Where simulations fit best whose states the measurements correct at each sample."""
    SOBOL = "sobol"
    """The best of a few points of the box."""


class SearchFailure(Enum):
    """What is wrong with a start or with where the search from it ended."""

    NONE = "none"
    FAR = "far"
    """The simulation at the start fails or is worse than the mean of an output, and was not searched from."""
    FAILED = "failed"
    """The start cannot be simulated."""
    NO_EFFECT = "no_effect"
    """A parameter acts on no output there, or something else cannot be searched."""
    UNFINISHED = "unfinished"
    """The search stalled, or ended at a limit."""
    LARGE_RESIDUAL = "large_residual"
    """The residual of an output is above `MAX_NOISE_RATIO` times the noise that its second differences show."""
    MODEL_ERROR = "model_error"
    """As `LARGE_RESIDUAL`, and other starts lead to the same optimum: the model does not explain the data."""


MAX_NOISE_RATIO = 3.0


@dataclass(frozen=True)
class RestartAttempt:
    """One start that was tried.

    Attributes
    ----------
    remedy : StartingPointSource
    trouble : SearchFailure
    noise_ratio : float
        Largest root mean square of an output's residual by its noise from second differences; NaN where unknown.
    simulations : int
    kept : bool
        Whether the result is of this one.
    """

    remedy: StartingPointSource
    trouble: SearchFailure
    noise_ratio: float = math.nan
    simulations: int = 0
    kept: bool = False


@dataclass(frozen=True)
class CombinationFit:
    """A combination of the values of parameters that take few, which was searched with.

    Attributes
    ----------
    values : mapping of str to float, int, bool or str
    outcome : TerminationReason or None
        How its search ended; None where it could not begin.
    behind : float
        By how much its −2 ln L, with the prior's part, is above that of the best one: 0 for that, infinite without end.
    estimates : mapping of str to float
        Of the other parameters.
    """

    values: Mapping[str, float | int | bool | str]
    outcome: TerminationReason | None
    behind: float
    estimates: Mapping[str, float]
