"""A diagnosis: what decides, sizes with intervals, and what the fault explains of the residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import evenly, extremes
from fmuid.formatting import label
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, Range1d
from fmuid.reports.interactive.rows import rows_of
from fmuid.reports.interactive.style import (
    BLUE,
    GREY,
    MAX_BARS,
    MAX_DOTS,
    MAX_OUTPUTS,
    MAX_ROWS,
    RED,
    Panel,
    Units,
    below_each_other,
)
from fmuid.reports.messages.diagnosis import change_name, change_size

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.diagnosis import Alarm, ChangeEvidence
    from fmuid.runs import MonitoringRun

# More causes than these make a figure nobody reads: the most significant are kept.
MAX_FAULTS = 12
# D is drawn logarithmically from here on; less is as good as nothing.
LEAST_STATISTIC = 0.1


def _intervals(text: str, names: list[str], values: list[float], ends: list[tuple[float, float]], color: str) -> Any:
    """Draw values with their intervals beside zero, a row a name."""
    plot, _ = rows_of(list(dict.fromkeys(names)), text)
    columns = {"low": [low for low, _ in ends], "high": [high for _, high in ends]}
    source = ColumnDataSource({"name": names, "value": values, **columns})
    plot.segment("low", "name", "high", "name", source=source, line_color=color, line_width=3)
    dots = plot.scatter("value", "name", source=source, size=9, fill_color=color, line_color=None)
    plot.hover(dots, ("size", "@value{0.000000}"), ("interval", "@low{0.000000} to @high{0.000000}"))
    plot.level(0.0, vertical=True)
    low, high = min(0.0, *columns["low"]), max(0.0, *columns["high"])
    plot.reach(x=(low - 0.05 * (high - low), high + 0.05 * (high - low)))
    return plot


def causes(found: ChangeEvidence) -> Any:
    """Draw what each cause alone lowers the criterion by, the likeliest first; what explains the record is red.

    The pointer shows the size, and which other cause has the nearest signature, at which angle.
    """
    kept = sorted(found.suspects, key=lambda each: each.probability)[:MAX_FAULTS]
    names = [change_name(each.change) for each in kept]
    named = {change_name(change) for each in found.explanations for change in each.changes}
    plot, bar = rows_of(names, "D, by how much the cause alone lowers the criterion", head=110, x_axis_type="log")
    entries = []
    for text, color, mine in (("explains the record", RED, True), ("other causes", GREY, False)):
        here = [(name, each) for name, each in zip(names, kept, strict=True) if (name in named) is mine]
        columns = {
            "name": [name for name, _ in here],
            "d": [max(each.statistic, LEAST_STATISTIC) for _, each in here],
            "told": [each.statistic for _, each in here],
            "p": [each.probability for _, each in here],
            "size": [change_size(each.change) for _, each in here],
            "near": [f"{each.rival}, {math.degrees(each.rival_angle):.0f}°" if each.rival else "" for _, each in here],
        }
        if here:
            source = ColumnDataSource(columns)
            bars = plot.hbar("name", bar, "d", LEAST_STATISTIC, source=source, fill_color=color, line_color=None)
            numbers = (("D", "@told{0.000}"), ("probability by chance", "@p{0.0e}"))
            plot.hover(bars, *numbers, ("size", "@size"), ("nearest signature", "@near"))
            entries.append((text, [bars]))
    plot.legend(entries)
    most = max((each.statistic for each in kept), default=1.0)
    plot.reach(x=(LEAST_STATISTIC, 2.0 * max(most, 1.0)))
    return plot


def changes(found: ChangeEvidence) -> list[Any]:
    """Draw the size of each change that explains the record, with its interval of 95 %; shares in percent."""
    plots, drawn = [], set()
    for each in (change for one in found.explanations for change in one.changes):
        name = change_name(each)
        if name in drawn or not math.isfinite(each.std):
            continue
        drawn.add(name)
        scale, unit = (100.0, "%") if each.kind.is_share else (1.0, each.unit)
        low, high = each.interval()
        text = label("size, with its interval of 95 %", unit)
        plots.append(_intervals(text, [name], [scale * each.value], [(scale * low, scale * high)], RED))
    return plots


def residuals(table: pd.DataFrame, fault: str, units: Units | None = None) -> Any:
    """Draw each output's residual without the fault and with it.

    Parameters
    ----------
    table : DataFrame
        Columns ``time``, and ``healthy.`` and ``fault.`` before the name of each output: the residuals of both models.
    fault : str
        What it is called.
    units : mapping of str to str, optional
        Of the outputs.
    """
    outputs = [str(name).removeprefix("healthy.") for name in table.columns if str(name).startswith("healthy.")]
    drawn = outputs[:MAX_OUTPUTS]
    columns = table[[f"{kind}.{name}" for name in drawn for kind in ("healthy", "fault")]].to_numpy(np.float64)
    kept = extremes(columns, MAX_ROWS)
    data: dict[str, Any] = {"t": table["time"].to_numpy(np.float64)[kept]}
    data |= {f"c{k}": columns[kept, k].astype(np.float32) for k in range(columns.shape[1])}
    source = ColumnDataSource(data)
    plots: list[Any] = []
    for k, name in enumerate(drawn):
        last = k == len(drawn) - 1
        text = label(f"residual of {name}", (units or {}).get(name))
        plot = Panel(x="time (s)" if last else "", y=text, height=190)
        without = plot.line("t", f"c{2 * k}", source=source, line_color=GREY, line_width=1)
        with_ = plot.line("t", f"c{2 * k + 1}", source=source, line_color=RED, line_width=1)
        plot.level(0.0)
        stds = np.sqrt(np.nanmean(columns[:, 2 * k : 2 * k + 2] ** 2, axis=0))
        unit = (units or {}).get(name) or ""
        texts = (f"healthy model, std {stds[0]:.3g} {unit}", f"with {fault}, std {stds[1]:.3g} {unit}")
        plot.legend(list(zip(texts, ([without], [with_]), strict=True)))
        if plots:
            plot.x_range = plots[0].x_range
        plots.append(plot)
    return below_each_other(plots)


# --- monitoring


def timeline(found: MonitoringRun, fault: str) -> Any:
    """Draw the sizes of a fault, the common mode and the residual over the time of all records, with alarms.

    Parameters
    ----------
    found : MonitoringRun
    fault : str
        Of the model.
    """
    table = found.table
    clock, borders, axis = clock_of(table)
    sized = found.sizes[fault]
    ordered = [*sized, *found.common][:MAX_OUTPUTS]
    half = 0.5 * float((table["end"] - table["start"]).median())
    columns = {"t": clock, **_estimates(table, ordered)}
    kept = extremes(np.column_stack([columns[key] for key in columns if key not in ("t", "record")]), MAX_ROWS)
    source = ColumnDataSource({key: np.asarray(values)[kept] for key, values in columns.items()})
    across = Range1d(float(clock[0]) - half, float(clock[-1]) + half, bounds="auto")
    plots, few = [], len(clock) <= MAX_BARS
    for k, name in enumerate(ordered):
        plot = Panel(y=label(name.removeprefix(f"{fault}."), found.units.get(name)), height=170, x_range=across)
        if few:
            area = plot.segment("t", f"low{k}", "t", f"high{k}", source=source, line_color=BLUE, line_alpha=0.5)
            line = plot.scatter("t", f"v{k}", source=source, size=5, fill_color=BLUE, line_color=None)
        else:
            area = plot.varea("t", f"low{k}", f"high{k}", source=source, fill_color=BLUE, fill_alpha=0.18)
            line = plot.line("t", f"v{k}", source=source, line_color=BLUE, line_width=1.4)
        plot.hover(line, ("time", "@t{0.000}"), ("estimate", f"@v{k}{{0.000000}}"), ("record", "@record"))
        hit = []
        if name in sized:
            plot.level(0.0)
            called = (table["significant"] == fault).to_numpy(bool)
            some = np.flatnonzero(called)[evenly(int(called.sum()), MAX_DOTS)]
            dots = ColumnDataSource({"t": clock[some], "v": columns[f"v{k}"][some]})
            hit.append(plot.scatter("t", "v", source=dots, size=5, fill_color=RED, line_color=None))
        plot.legend([("estimate, with its interval of 95 %", [line, area]), ("significant", hit)])
        plots.append(plot)
    noise = Panel(x=axis, y="variance / noise", height=170, x_range=across)
    noise.line("t", "ratio", source=source, line_color=GREY, line_width=1.4)
    if few:
        noise.scatter("t", "ratio", source=source, size=4, fill_color=GREY, line_color=None)
    noise.level(1.0)
    plots.append(noise)
    for plot in plots:
        plot.xaxis.visible = plot is noise
        _alarms(plot, clock, half, found.alarms)
        for border in borders:
            plot.level(border, color=GREY, vertical=True, dash="dotted")
    return below_each_other(plots)


def clock_of(table: pd.DataFrame) -> tuple[Floats, list[float], str]:
    """Return the middles of the windows over the time of all records, where records begin, and what the axis is.

    Where the time begins anew in a record, it goes on from the end of the one before.
    """
    start, end = table["start"].to_numpy(np.float64), table["end"].to_numpy(np.float64)
    middle = 0.5 * (start + end)
    if (np.diff(start) > 0).all():
        return middle, [], "time (s)"
    changes = np.flatnonzero(table["record"].to_numpy(str)[1:] != table["record"].to_numpy(str)[:-1]) + 1
    shift, borders = np.zeros(len(table)), []
    for k in changes:
        border = float(end[k - 1] + shift[k - 1])
        shift[k:] = border - min(0.0, start[k])
        borders.append(border)
    return middle + shift, borders, "time over all records (s)"


def _estimates(table: pd.DataFrame, names: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "ratio": table["variance_ratio"].to_numpy(np.float64),
        "record": table["record"].astype(str),
    }
    for k, name in enumerate(names):
        value, std = (table[f"{name}{end}"].to_numpy(np.float64) for end in ("", ".std"))
        known = np.isfinite(std)
        half = np.where(known, 1.96 * std, np.nan)
        found |= {f"v{k}": np.where(known, value, np.nan), f"low{k}": value - half, f"high{k}": value + half}
    return found


def _alarms(plot: Any, clock: Floats, half: float, alarms: Sequence[Alarm]) -> None:
    for alarm in alarms:
        begin, end = float(clock[alarm.first] + half), float(clock[alarm.last] + half)
        plot.shade(RED, 0.1, left=begin - 2 * half, right=end)
        plot.level(begin, color=RED, vertical=True, dash="dashed")
