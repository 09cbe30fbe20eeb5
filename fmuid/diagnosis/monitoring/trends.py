"""How the size of an alarm goes on, by the windows since its onset."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from fmuid.diagnosis.monitoring.alarms import Alarm, Trend
from fmuid.diagnosis.monitoring.window_evaluation import MonitorState


def with_trend(alarm: Alarm, now: MonitorState, table: pd.DataFrame, limits: Mapping[str, float]) -> Alarm:
    """Return an alarm with the trend of its first size, by the rows that are held; limits as of `Rule`."""
    if not alarm.explanations or alarm.onset is None:
        return alarm
    column = alarm.explanations[0].changes[0].label
    rows = table.loc[: alarm.last]
    since = now.clock(alarm.onset.last)
    begin = rows["clock"] - (rows["end"] - rows["start"])
    rows = rows[(begin >= since - 1e-6 * abs(since)).to_numpy(bool)]
    if rows.empty:
        return alarm
    values, stds, clock = (rows[name].to_numpy(np.float64) for name in (column, f"{column}.std", "clock"))
    return replace(alarm, trend=Trend.of(column, clock, values, stds, limits.get(column, math.nan)))
