"""Levels of tests and windows of recordings, as a study sets them; a study without faults imports no more."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Lt

from fmuid.errors import InputError
from fmuid.estimation import check_level

# Of calling a fault where there is none, unless said otherwise: one check in a hundred, the habit of the field.
FALSE_ALARM_LEVEL = 0.01
# Of no alarm with a fault of the detectable size.
MISS_PROBABILITY = 0.05
# How much of its effect a fault model has wrong along any other cause's signature, where no trials tell.
MODEL_ERROR = 0.05


@dataclass(frozen=True)
class Rule:
    """Windows of a recording, and false alarms.

    Raises
    ------
    InputError
        If a window is not longer than the warm-up, or a number is out of its range.

    Examples
    --------
    >>> fmuid.Rule(window=1.0, transient=0.2, level=0.01, horizon=86_400.0).window
    1.0
    """

    window: Annotated[float, Gt(0)] | None = None
    """window length, s; default: each record is one"""
    transient: Annotated[float, Ge(0)] = 0.0
    """simulated before each window, and left out at the beginning of a record, s"""
    level: Annotated[float, Gt(0), Lt(1)] = FALSE_ALARM_LEVEL
    """probability of a false alarm of any cause in a record, or in the horizon"""
    horizon: Annotated[float, Gt(0)] | None = None
    """time of the level, s; default: each record"""
    limits: Mapping[str, float] = field(default_factory=dict)
    """largest allowed sizes by columns of the table: ``{"turns.dR": 0.5}``"""

    def __post_init__(self) -> None:
        check_level(self.level, "a test")
        if not (math.isfinite(self.transient) and self.transient >= 0):
            raise InputError(f"the warm-up must be a finite time of 0 s or more, not {self.transient!r}")
        for name, value in (("window", self.window), ("horizon", self.horizon)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"the {name} must be a finite time above 0 s, not {value!r}")
        if self.window is not None and self.window <= self.transient:
            said = f"windows of {self.window:g} s are not longer than the warm-up of {self.transient:g} s"
            raise InputError(f"{said}. Give longer windows.")

    def window_level(self, windows: int, length: float) -> float:
        """Return the false-alarm probability of one window (length in s)."""
        return self.level / (windows if self.horizon is None else max(1.0, self.horizon / length))
