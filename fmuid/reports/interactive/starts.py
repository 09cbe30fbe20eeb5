"""Where searches from several starts ended: how much worse than the best, and each end over its start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.data import evenly
from fmuid.reports.interactive.batch import outside
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource
from fmuid.reports.interactive.style import AMBER, BLUE, MAX_DOTS, RED, Panel, Units, named
from fmuid.runs import INTERVAL_STDS, BatchColumns, data_sets, fit_cost, optimum_numbers

# Optima of which all is inside the picture.
MAX_OPTIMA = 5
# Fits are drawn logarithmically from here on, in per cent or in units of the criterion: less is rounding.
LEAST_EXCESS = 0.01
# Starts that range over this ratio are shown logarithmically.
WIDE_RANGE = 100.0


def over_starts(
    frame: pd.DataFrame, truth: Mapping[str, float], units: Units, *, given_noise: bool = False
) -> list[Any]:
    """Draw where searches from several starts ended: how much worse they fit, in order, and each end over its start.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    truth : mapping of str to float
    units : mapping of str to str
    given_noise : bool
        See `fmuid.runs.batch.statistics.fit_cost`.
    """
    columns, number = BatchColumns.of(frame), optimum_numbers(frame, given_noise=given_noise)
    lost = (frame["status"] != "converged").to_numpy(bool)
    plots = [_waterfall(_excess(frame, columns, given_noise=given_noise), number, lost, given_noise=given_noise)]
    for name in (name for each in columns.starts if (name := each.removeprefix("start.")) in columns.parameters):
        begin, end = (frame[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("start", "value"))
        limits = _limits(end, INTERVAL_STDS * frame[f"std.{name}"].to_numpy(np.float64), number)
        wide = np.nanmax(begin) > WIDE_RANGE * np.nanmin(begin) > 0  # NaN where the parameter is not free
        text = named(name, units)
        plot = Panel(x=f"start of {text}", y=text, height=220, x_axis_type="log" if wide else "linear")
        entries = []
        for mine, color, words in _kinds(number):
            entries.append((words + outside(end[mine], limits), _points(plot, begin[mine], end[mine], color)))
        astray = lost & np.isfinite(end)
        clipped = np.clip(end[astray], *limits)
        entries.append(("not converged", _points(plot, begin[astray], clipped, AMBER, marker="x")))
        plot.legend(entries)
        if name in truth:
            plot.level(float(truth[name]), color=AMBER)
        plot.reach(y=limits)
        plots.append(plot)
    return plots


def _kinds(number: npt.NDArray[np.int64]) -> list[tuple[Flags, str, str]]:
    return [(number > 1, RED, "another optimum"), (number == 1, BLUE, "best optimum")]


def _points(plot: Any, x: Floats, y: Floats, color: str, marker: str = "circle") -> list[Any]:
    """Draw points, none of which leaves no word in the legend."""
    if not x.size:
        return []
    some = evenly(x.size, MAX_DOTS)
    look = {"line_color": color, "line_width": 1.6} if marker == "x" else {"fill_color": color, "line_color": None}
    source = ColumnDataSource({"x": x[some], "y": y[some]})
    dots = plot.scatter("x", "y", source=source, marker=marker, size=7 if marker == "x" else 5, **look)
    plot.hover(dots, ("start", "@x{0.000000}"), ("end", "@y{0.000000}"))
    return [dots]


def _limits(end: Floats, half: Floats, number: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Return limits around the intervals of the best optima, so that differences that mean nothing look small."""
    near = (number > 0) & (number <= MAX_OPTIMA) & np.isfinite(end)
    half = np.where(np.isfinite(half), half, 0.0)
    low, high = float((end - half)[near].min(initial=np.inf)), float((end + half)[near].max(initial=-np.inf))
    if low > high:
        return 0.0, 1.0
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def _excess(frame: pd.DataFrame, columns: BatchColumns, *, given_noise: bool) -> Floats:
    """Return how much worse each converged case fits than the best of its data, NaN for the others.

    By the criterion where the noise variances are given, else the share by which the residual is larger.
    """
    fits = np.where(frame["status"] == "converged", fit_cost(frame, given_noise=given_noise), np.nan)
    for rows in data_sets(frame, columns):
        known = rows[np.isfinite(fits[rows])]
        fits[rows] -= fits[known].min() if known.size else 0.0
    return fits if given_noise else np.expm1(0.5 * fits / max(1, len(columns.outputs)))


def _waterfall(excess: Floats, number: npt.NDArray[np.int64], lost: Flags, *, given_noise: bool) -> Any:
    order = np.argsort(np.where(lost, np.inf, excess), kind="stable")[: int((~lost).sum())]
    x, y = np.arange(1.0, order.size + 1), np.maximum(excess[order] * (1.0 if given_noise else 100.0), LEAST_EXCESS)
    text = "searches, the best first" + (f"; {lost.sum()} did not converge" if lost.any() else "")
    words = "criterion above the best" if given_noise else "residual above the best (%)"
    plot = Panel(x=text, y=words, height=220, y_axis_type="log")
    plot.legend([(words, _points(plot, x[mine], y[mine], color)) for mine, color, words in _kinds(number[order])])
    plot.reach(y=(0.7 * LEAST_EXCESS, max(100 * LEAST_EXCESS, 1.5 * float(y.max(initial=0.0)))))
    return plot
