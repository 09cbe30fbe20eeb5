"""What was done with a table before it was an experiment: its columns as recorded and as they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, CrosshairTool, Range1d, Span
from fmuid.reports.interactive.style import BLUE, GREY, MAX_OUTPUTS, Panel, Units, below_each_other, named


def preparation(table: pd.DataFrame, units: Units | None = None) -> Any:
    """Draw the columns of an experiment that its preparation changed or made, before it (grey) and after, over time.

    Zoom and crosshair are linked. Of more than `MAX_OUTPUTS` columns the first are drawn.

    Parameters
    ----------
    table : DataFrame
        Its rows of ``preparation.csv``: ``column``, ``stage`` (before or after), ``time`` (s), ``value``.
    units : mapping of str to str, optional
        Of the columns.
    """
    names = list(dict.fromkeys(table["column"]))[:MAX_OUTPUTS]
    times = table["time"].to_numpy(np.float64)
    across = Range1d(float(times.min()), float(times.max()), bounds="auto")
    cross = Span(dimension="height", line_dash="dotted", line_color=GREY)
    plots = [_column(name, table[table["column"] == name], units, across) for name in names]
    for plot in plots:
        plot.add_tools(CrosshairTool(overlay=cross))
        plot.xaxis.visible = plot is plots[-1]
    plots[-1].xaxis.axis_label = "time (s)"
    return below_each_other(plots, dense=True)


def _column(name: str, rows: pd.DataFrame, units: Units | None, across: Any) -> Any:
    plot = Panel(x="time (s)", y=named(name, units), height=200, x_range=across, lod_threshold=None)
    entries = []
    for stage, text, color, width in (("before", "as recorded", GREY, 1.2), ("after", "as used", BLUE, 1.6)):
        part = rows[rows["stage"] == stage]
        if len(part):
            source = ColumnDataSource({"t": part["time"].to_numpy(np.float64), "v": part["value"].to_numpy(np.float32)})
            line = plot.line("t", "v", source=source, line_color=color, line_width=width)
            plot.hover(line, (text, "@v{0.00000}"), ("time", "@t{0.0000} s"), vertical=True)
            entries.append((text, [line]))
    plot.legend(entries)
    return plot
