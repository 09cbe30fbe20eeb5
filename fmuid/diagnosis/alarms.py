"""Alarms: their causes, onset and trend."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.cause_ranking import rank_with_model_error
from fmuid.diagnosis.cause_results import Explanation, explanations
from fmuid.diagnosis.causes import Cause, ChangeParameterSet
from fmuid.diagnosis.onset import OnsetEstimate, OnsetShape, estimate_onset
from fmuid.diagnosis.onset_tracker import OnsetTracker

SOMETHING_ELSE = "something else"
"""What an alarm is called where no cause explains a residual that is larger than the noise."""


@dataclass(frozen=True)
class RecordTime:
    """A time of a record.

    Attributes
    ----------
    time : float
        s of the record.
    date : str
        ISO 8601, "" where the data file has no dates.
    """

    record: str
    time: float
    date: str = ""


@dataclass(frozen=True)
class Onset:
    """Begin of a change.

    Attributes
    ----------
    likely, first, last : RecordTime
        The most likely time, and the 95 % confidence set.
    """

    likely: RecordTime
    first: RecordTime
    last: RecordTime
    shape: OnsetShape


@dataclass(frozen=True)
class Trend:
    """Trend of a size since the onset.

    Attributes
    ----------
    column : str
        Of the table.
    value, std : float
        At the end of the last window.
    rate, rate_std : float
        Change in a second.
    limit : float
        From the rule; NaN without.
    reached : (float, float, float)
        Time to the limit, s: likeliest, and 95 % interval; 0 if past, infinite if never, NaN without a limit.
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
        """True if the rate is significant at 5 %."""
        return abs(self.rate) > -float(special.ndtri(0.025)) * self.rate_std

    @classmethod
    def of(cls, column: str, clock: Floats, values: Floats, stds: Floats, limit: float = math.nan) -> Trend | None:
        """Return the weighted least-squares line of sizes (n,) at times (n,); None of fewer than four."""
        known = np.isfinite(values) & np.isfinite(stds) & (stds > 0)
        if np.count_nonzero(known) < 4:
            return None
        late, weight = clock[known] - clock[-1], stds[known] ** -2.0
        lines = np.column_stack([np.ones(late.size), late])
        covariance = np.linalg.inv(lines.T @ (weight[:, None] * lines))
        value, rate = (covariance @ (lines.T @ (weight * values[known]))).tolist()
        std, rate_std = np.sqrt(np.diag(covariance)).tolist()
        return cls(column, value, std, rate, rate_std, limit, _reached(value, rate, rate_std, limit))


def _reached(value: float, rate: float, rate_std: float, limit: float) -> tuple[float, float, float]:
    """Return the times to a limit: likeliest, and 95 % interval."""
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
    """Successive windows with a change.

    Attributes
    ----------
    fault : str
        Causes, joined by "or" where they are indistinguishable, or "something else".
    record : str
        In which the alarm was raised.
    time : float
        End of the first window, s.
    first, last : int
        Rows of the table.
    onset : Onset or None
        None of something else.
    explanations : tuple of Explanation
        Best first, with the sizes after the onset.
    trend : Trend or None
        Of the first size of the best explanation.
    ended : RecordTime or None
        Begin of the windows without the cause; None while it lasts.
    """

    fault: str
    record: str
    time: float
    first: int
    last: int
    onset: Onset | None = None
    explanations: tuple[Explanation, ...] = ()
    trend: Trend | None = None
    ended: RecordTime | None = None


def label_of(explanations: tuple[Explanation, ...]) -> str:
    """Return the name of an alarm."""
    each = (" and ".join(dict.fromkeys(c.fault or c.label for c in one.changes)) for one in explanations)
    return " or ".join(dict.fromkeys(each))


def with_trend(alarm: Alarm, since: float, table: pd.DataFrame, limits: Mapping[str, float]) -> Alarm:
    """Return an alarm with its trend since a time, s."""
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


@dataclass(frozen=True, eq=False)
class AlarmDecision:
    """Causes and onset of an alarm."""

    explanations: tuple[Explanation, ...]  # the best one first
    causes: tuple[Cause, ...]  # of the best one
    sizes: Floats  # (k,) of their coordinates
    when: OnsetEstimate  # of its first cause
    since: float  # begin of the first whole window with it, s of all data; infinite without one

    @property
    def columns(self) -> tuple[int, ...]:
        """Coordinates of the causes."""
        return tuple(i for cause in self.causes for i in cause.columns)


def decide_alarm(
    watch: OnsetTracker, coordinates: ChangeParameterSet, level: float, model_error: float
) -> AlarmDecision:
    """Return causes and onset of an alarm; level and model error as for `name`."""
    causes = coordinates.causes
    every = zip(*(watch.onsets(causes, shape) for shape in OnsetShape), strict=True)
    dates = [estimate_onset(each, watch.end) for each in every]
    when = max(dates, key=lambda each: each.log_evidence + math.log(each.cause.probability))
    for _ in range(2):  # the name may be another one than that by which it was dated
        apart = watch.apart(*when.between)
        news, since = (watch.news(when.clock), math.inf) if apart is None else apart
        _, likely = rank_with_model_error(news, causes, level, model_error)
        if when.cause in likely[0].causes:
            break
        when = next(each for each in dates if each.cause is likely[0].causes[0])
    return AlarmDecision(explanations(likely, coordinates), likely[0].causes, likely[0].fit.sizes, when, since)
