"""The timeline of a monitoring: sizes with intervals, the common mode, the residual, and when there was an alarm."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmuid.arrays import Floats
from fmuid.diagnosis import Monitor
from fmuid.files import file_name
from fmuid.reports.figures.style import AMBER, BLUE, GREY, INK, MAX_OUTPUTS, RED, WIDTH, style
from fmuid.text import label

# Half the width of an interval of 95 % in standard deviations.
INTERVAL_STDS = 1.96


def draw(monitor: Monitor) -> dict[str, Figure]:
    """Draw a monitoring: one figure a fault."""
    table = monitor.table
    if table.empty:
        return {}
    return {f"monitoring-{file_name(name)}": timeline(monitor, name, table) for name in monitor.faults}


def timeline(monitor: Monitor, fault: str, table: pd.DataFrame) -> Figure:
    """Draw the sizes of a fault, the common mode beside it and the residual against time."""
    clock, axis = _clock(table)
    sizes = [f"{fault}.{size}" for size in monitor.faults[fault].sizes][:MAX_OUTPUTS]
    common = list(monitor.baseline.common)[:MAX_OUTPUTS]
    with style():
        rows = len(sizes) + len(common) + 1
        figure = Figure(figsize=(WIDTH, 1.0 + 1.5 * rows), layout="constrained")
        panels = figure.subplots(rows, 1, squeeze=False, sharex=True)[:, 0]
        for axes, name in zip(panels, [*sizes, *common], strict=False):
            is_size = name in sizes
            _estimates(axes, clock, table, name, color=INK if is_size else BLUE)
            axes.set_ylabel(label(name.removeprefix(f"{fault}."), monitor.units.get(name, "")))
            if is_size:
                axes.axhline(0.0, color=INK, lw=0.8)
                _called(axes, clock, table, fault, name)
        panels[0].set_title(f"{fault}: windows significant by themselves, and alarms")
        panels[len(sizes)].set_title("common mode" if common else "residual")
        panels[-1].plot(clock, table["variance_ratio"].to_numpy(np.float64), color=GREY, lw=0.9)
        panels[-1].axhline(1.0, color=INK, lw=0.8)
        panels[-1].set_ylabel("variance of the\nresidual / noise")
        panels[-1].set_xlabel(axis)
        for axes in panels:
            _alarms(axes, monitor, clock)
            axes.margins(x=0.01)
        handles, words = panels[0].get_legend_handles_labels()
        kept = dict(zip(words, handles, strict=True))
        figure.legend(list(kept.values()), list(kept), loc="outside lower center", ncols=4)
    return figure


def _clock(table: pd.DataFrame) -> tuple[Floats, str]:
    """Return the middles of the windows, or their numbers where the time begins anew in each record."""
    start, end = table["start"].to_numpy(np.float64), table["end"].to_numpy(np.float64)
    if (np.diff(start) > 0).all():
        return np.asarray(0.5 * (start + end)), "time (s)"
    return np.arange(len(table), dtype=np.float64), "window"


def _estimates(axes: Axes, clock: Floats, table: pd.DataFrame, name: str, color: str) -> None:
    value = table[name].to_numpy(np.float64)
    half = INTERVAL_STDS * table[f"{name}.std"].to_numpy(np.float64)
    known = np.isfinite(half)
    low, high = value - half, value + half
    axes.fill_between(clock, low, high, where=known.tolist(), color=color, alpha=0.18, lw=0.0, label="interval of 95 %")
    axes.plot(clock, np.where(known, value, np.nan), color=color, lw=0.9, label="estimate")


def _called(axes: Axes, clock: Floats, table: pd.DataFrame, fault: str, name: str) -> None:
    """Mark the windows in which a fault is significant."""
    called = (table["significant"] == fault).to_numpy(bool) & np.isfinite(table[f"{name}.std"].to_numpy(np.float64))
    value = table[name].to_numpy(np.float64)
    axes.plot(clock[called], value[called], "o", color=RED, ms=3, lw=0, label="significant")


def _alarms(axes: Axes, monitor: Monitor, clock: Floats) -> None:
    half = 0.5 * float(np.median(np.diff(clock))) if clock.size > 1 else 0.5
    for alarm in monitor.alarms:
        axes.axvspan(clock[alarm.first] - half, clock[alarm.last] + half, color=AMBER, alpha=0.15, lw=0.0)
        axes.axvline(clock[alarm.first] + half, color=AMBER, lw=1.4, ls=(0, (4, 2)), label="alarm")
