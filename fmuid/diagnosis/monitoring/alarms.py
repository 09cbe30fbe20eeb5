"""When windows that are significant make an alarm, and how often they do so where nothing is wrong.

One window in 1/level is significant without a fault. Where `needed` of the last `among` windows must be, chance alone
hardly does it; but all windows have one healthy record in common, and its errors make them alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.diagnosis.decision import FALSE_ALARM_LEVEL
from fmuid.errors import InputError
from fmuid.estimation import check_level

SOMETHING_ELSE = "something else"
"""What an alarm is called where no fault model explains a residual that is larger than the noise."""


@dataclass(frozen=True)
class Rule:
    """How a record is cut into windows, and what makes an alarm.

    Parameters
    ----------
    window : float or None
        Length of a window, s; None takes each record as one.
    transient : float
        What each window is simulated before it, and what is left out at the beginning of a record, s.
    level : float
        Probability that a window is significant where nothing is wrong, whatever the number of faults looked for.
    needed, among : int
        There is an alarm where so many of the last so many windows are significant.
    forgetting : float
        0: every window by itself; towards 1: what earlier windows said falls by this factor from window to window.

    Raises
    ------
    InputError
        If a window is not longer than the transient, or a number is out of its range.

    Examples
    --------
    >>> fmuid.Rule(window=1.0, transient=0.2, needed=3, among=4).window
    1.0
    """

    window: float | None = None
    transient: float = 0.0
    level: float = FALSE_ALARM_LEVEL
    needed: int = 3
    among: int = 4
    forgetting: float = 0.0

    def __post_init__(self) -> None:
        check_level(self.level, "a test")
        if not (math.isfinite(self.transient) and self.transient >= 0):
            raise InputError(f"the transient must be a duration in seconds, zero or more, not {self.transient!r}")
        if self.window is not None and not (math.isfinite(self.window) and self.window > 0):
            raise InputError(f"the window must be a duration in seconds above zero, not {self.window!r}")
        if self.window is not None and self.window <= self.transient:
            raise InputError(
                f"windows of {self.window:g} s are not longer than the transient of {self.transient:g} s: "
                "make the windows longer"
            )
        if not 1 <= self.needed <= self.among:
            raise InputError(
                f"an alarm cannot take {self.needed} of {self.among} windows: give a number from 1 to that"
            )
        if not 0 <= self.forgetting < 1:
            raise InputError(f"forgetting must be 0 or more and below 1, not {self.forgetting!r}")


@dataclass(frozen=True)
class Alarm:
    """Windows in which a fault stays.

    Attributes
    ----------
    fault : str
        The fault, several joined by "or" where they are not told apart, or "something else".
    record : str
        In which it began.
    time : float
        End of the window with which it began, s.
    first, last : int
        Rows of the table.
    """

    fault: str
    record: str
    time: float
    first: int
    last: int


def alarms(significant: Sequence[str], unexplained: Sequence[bool], rule: Rule) -> list[str]:
    """Return for each window the fault that stays: that of most of the last windows, "" without an alarm."""
    found = []
    for i in range(len(significant)):
        last = slice(max(0, i - rule.among + 1), i + 1)
        hits = [name for name in significant[last] if name]
        odd = sum(bool(each) for each in unexplained[last])
        if len(hits) >= rule.needed:
            found.append(max(reversed(hits), key=hits.count))
        else:
            found.append(SOMETHING_ELSE if odd >= rule.needed else "")
    return found


def alarm_rate(level: float, needed: int, among: int, *, share: float = 0.0, two_sided: bool = True) -> float:
    """Return how probable it is that at least `needed` of `among` windows of a healthy machine are significant.

    Parameters
    ----------
    level : float
        Of each window.
    share : float
        Of the variance, what all windows have in common; the rest is independent. Of one fault parameter.
    two_sided : bool
        Whether the parameter may take either sign.
    """
    bound = float(special.ndtri(1.0 - level / (2.0 if two_sided else 1.0)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(101)
    common, own = math.sqrt(share), math.sqrt(max(1.0 - share, 1e-12))
    single = special.ndtr((common * nodes - bound) / own)
    if two_sided:
        single += special.ndtr((-common * nodes - bound) / own)
    tail = special.bdtrc(needed - 1, among, np.clip(single, 0.0, 1.0))
    return float(weights @ tail / weights.sum())
