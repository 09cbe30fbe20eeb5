"""What makes an alarm, and what one says: since when, what, how large, where it leads."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.cause_results import Explanation
from fmuid.diagnosis.change_detection import FALSE_ALARM_LEVEL
from fmuid.diagnosis.onset import OnsetShape
from fmuid.errors import InputError
from fmuid.estimation import check_level

SOMETHING_ELSE = "something else"
"""What an alarm is called where no cause explains a residual that is larger than the noise."""

# A trend takes so many windows.
TREND_WINDOWS = 4


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
        Probability of a false alarm in a record, or in the time `horizon`, whatever the number of causes looked for.
    horizon : float or None
        In which the level holds, s; None for each record.
    limits : mapping of str to float
        Sizes that must not be reached, by the columns of the table: ``{"turns.dR": 0.5}``.

    Raises
    ------
    InputError
        If a window is not longer than the transient, or a number is out of its range.

    Examples
    --------
    >>> fmuid.Rule(window=1.0, transient=0.2, level=0.01, horizon=86_400.0).window
    1.0
    """

    window: float | None = None
    transient: float = 0.0
    level: float = FALSE_ALARM_LEVEL
    horizon: float | None = None
    limits: Mapping[str, float] = field(default_factory=dict)

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
        if self.horizon is not None and not (math.isfinite(self.horizon) and self.horizon > 0):
            raise InputError(f"the horizon must be a duration in seconds above zero, not {self.horizon!r}")

    def window_level(self, windows: int, length: float) -> float:
        """Return the probability of a false alarm that each window may have.

        Parameters
        ----------
        windows : int
            Of the record.
        length : float
            Of one of them, s.
        """
        return self.level / (windows if self.horizon is None else max(1.0, self.horizon / length))


@dataclass(frozen=True)
class RecordTime:
    """A time of a record.

    Attributes
    ----------
    record : str
    time : float
        s of the record.
    date : str
        Where the record's table has dates (ISO 8601), "" otherwise.
    """

    record: str
    time: float
    date: str = ""


@dataclass(frozen=True)
class Onset:
    """Since when.

    Attributes
    ----------
    likely, first, last : RecordTime
        The most likely one, and the set that holds the true one with 95 %.
    shape : OnsetShape
        Whether it came at once, or grows.
    """

    likely: RecordTime
    first: RecordTime
    last: RecordTime
    shape: OnsetShape


@dataclass(frozen=True)
class Trend:
    """How a size goes on, by the windows since the onset.

    Attributes
    ----------
    column : str
        Of the table.
    value, std : float
        At the end of the last window.
    rate, rate_std : float
        Its change in a second.
    limit : float
        That the user has set; NaN without.
    reached : (float, float, float)
        In how many seconds after the last window the limit is reached, most likely, and from to with 95 %: 0 where it
        is already, infinite where it never is at this rate, NaN without a limit.
    """

    column: str
    value: float
    std: float
    rate: float
    rate_std: float
    limit: float = math.nan
    reached: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    @property
    def grows(self) -> bool:
        """Whether the rate is significant at 5 %."""
        return abs(self.rate) > -float(special.ndtri(0.025)) * self.rate_std

    @classmethod
    def of(cls, column: str, clock: Floats, values: Floats, stds: Floats, limit: float = math.nan) -> Trend | None:
        """Return the line through sizes (n,) at times (n,) by weighted least squares; None of fewer than four."""
        known = np.isfinite(values) & np.isfinite(stds) & (stds > 0)
        if np.count_nonzero(known) < TREND_WINDOWS:
            return None
        late, weight = clock[known] - clock[-1], stds[known] ** -2.0
        lines = np.column_stack([np.ones(late.size), late])
        covariance = np.linalg.inv(lines.T @ (weight[:, None] * lines))
        value, rate = (covariance @ (lines.T @ (weight * values[known]))).tolist()
        std, rate_std = np.sqrt(np.diag(covariance)).tolist()
        reached = _reached(value, rate, rate_std, limit)
        return cls(column, value, std, rate, rate_std, limit, reached)


def _reached(value: float, rate: float, rate_std: float, limit: float) -> tuple[float, float, float]:
    """Return when a line crosses a limit: by its rate, and by the ends of the rate's interval of 95 %."""
    if math.isnan(limit):
        return math.nan, math.nan, math.nan
    left, sign = limit - value, math.copysign(1.0, limit)
    if left * sign <= 0.0:
        return 0.0, 0.0, 0.0
    half = -float(special.ndtri(0.025)) * rate_std
    said = [left / each if each * sign > 0 else math.inf for each in (rate, rate + sign * half, rate - sign * half)]
    return said[0], said[1], said[2]


@dataclass(frozen=True)
class Alarm:
    """Windows in a row in which something is new.

    Attributes
    ----------
    fault : str
        What: the names of the faults and other causes, several joined by "or" where they are not told apart, or
        "something else".
    record : str
        In which the alarm was raised.
    time : float
        End of the window with which it was raised, s.
    first, last : int
        Rows of the table.
    onset : Onset or None
        None of something else.
    explanations : tuple of Explanation
        The best one first, with the sizes after the onset, then all that the windows do not exclude beside it.
    trend : Trend or None
        Of the first size of the best explanation.
    """

    fault: str
    record: str
    time: float
    first: int
    last: int
    onset: Onset | None = None
    explanations: tuple[Explanation, ...] = ()
    trend: Trend | None = None


def label_of(explanations: tuple[Explanation, ...]) -> str:
    """Return what an alarm is called."""
    each = (" and ".join(dict.fromkeys(c.fault or c.label for c in one.changes)) for one in explanations)
    return " or ".join(dict.fromkeys(each))


def with_trend(alarm: Alarm, since: float, table: pd.DataFrame, limits: Mapping[str, float]) -> Alarm:
    """Return an alarm with the trend of its first size.

    Parameters
    ----------
    alarm : Alarm
    since : float
        When its onset was at the latest, s of all that was seen.
    table : DataFrame
        The rows that are held.
    limits : mapping of str to float
        As of the rule.
    """
    if not alarm.explanations:
        return alarm
    column = alarm.explanations[0].changes[0].label
    rows = table.loc[: alarm.last]
    begin = rows["clock"] - (rows["end"] - rows["start"])
    rows = rows[(begin >= since - 1e-6 * abs(since)).to_numpy(bool)]
    if rows.empty:
        return alarm
    values, stds, clock = (rows[name].to_numpy(np.float64) for name in (column, f"{column}.std", "clock"))
    return replace(alarm, trend=Trend.of(column, clock, values, stds, limits.get(column, math.nan)))
