"""Fits that are drawn anew while somebody looks: of another simulation, within a frame, or another stretch of time.

Only what changes is painted: the simulated line and its residual lie on Bokeh's overlay, above the measured dots, the
axes and the line of the last optimum, which are painted anew when the ranges change. Ranges are those of the server,
which moves them when a line leaves them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from fmuid.array_types import Floats, Indices
from fmuid.data import evenly, extremes
from fmuid.formatting import label
from fmuid.identification import CONFIDENCE_LEVEL
from fmuid.reports.interactive.bokeh_spec import BasicTicker, BokehSpec, live
from fmuid.reports.interactive.fit import drawn_outputs, fit, shade_uncounted, sources
from fmuid.reports.interactive.style import AMBER, BLUE, DARK, GREY, MAX_OUTPUTS, RED, Panel, below_each_other
from fmuid.simulation import OutputFit

# Rows of lines and dots: so many are painted within a frame on a machine without a graphics card.
ROWS, DOTS = 1600, 700
# An upper figure whose lines fill less than this of its height is drawn anew, with so much room around.
LEAST_FILLED, ROOM = 0.35, 0.12
Later = Callable[[Callable[[], None]], object]
"""What has a callable called in a moment, as ``add_next_tick_callback`` of a document."""


class TimeRange:
    """The stretch of time that is looked at.

    Parameters
    ----------
    times : (K,) array
        Of the record, s.
    later : Later
    redraw : callable
        Called when another stretch is looked at, once for both of its ends.

    Attributes
    ----------
    across : Range1d
    """

    def __init__(self, times: Floats, later: Later, redraw: Callable[[], None]) -> None:
        self._times, self._later, self._redraw, self._due = times, later, redraw, False
        self.across = Range1d(float(times[0]), float(times[-1]), bounds="auto")
        for end in ("start", "end"):
            self.across.on_change(end, lambda _attr, _old, _new: self._moved())

    @property
    def rows(self) -> slice:
        """The rows of it, and one more at each end."""
        first, last = np.searchsorted(self._times, [self.across.start, self.across.end])
        return slice(max(0, int(first) - 1), min(len(self._times), int(last) + 1))

    def _moved(self) -> None:
        if not self._due:
            self._due = True
            self._later(self._draw)

    def _draw(self) -> None:
        self._due = False
        self._redraw()


class ZoomedFit:
    """The figure of a fit, thinned anew for each stretch of time that is looked at.

    Parameters
    ----------
    later : Later
    record, half_width, degree
        As for `fmuid.reports.interactive.fit.fit`.

    Attributes
    ----------
    figure : BokehSpec
        Its sources and range of time are Bokeh's own models.
    """

    def __init__(
        self,
        later: Later,
        record: OutputFit,
        half_width: Floats | None = None,
        degree: float = CONFIDENCE_LEVEL,
    ) -> None:
        self._shown = record, drawn_outputs(record), half_width
        self.stretch = TimeRange(record.times, later, self._draw)
        self.lines, self.dots = ColumnDataSource(), ColumnDataSource()
        self._draw()
        self.figure = fit(record, half_width, degree, given=(self.lines, self.dots, self.stretch.across))

    def _draw(self) -> None:
        lines, dots = sources(*self._shown, self.stretch.rows)
        self.lines.data, self.dots.data = lines.data, dots.data


class LiveFit:
    """Figures of one experiment, and what to put into them.

    Parameters
    ----------
    record : OutputFit
        What is shown at first.
    later : Later

    Attributes
    ----------
    figure : BokehSpec
        Its sources and ranges are Bokeh's own models.
    """

    def __init__(self, record: OutputFit, later: Later) -> None:
        self.record, self._ghost = record, np.full_like(record.simulated, np.nan)
        self.outputs = range(min(len(record.outputs), MAX_OUTPUTS))
        self.stretch = TimeRange(record.times, later, lambda: self.draw(self.record.simulated))
        self.across = self.stretch.across
        self.lines, self.dots, self.ghosts = (ColumnDataSource(name=name) for name in ("lines", "dots", "ghosts"))
        self._shown: tuple[float, float] | None = None
        self.uppers = [Range1d(0.0, 1.0) for _ in self.outputs]
        self.lowers = [Range1d(-1.0, 1.0) for _ in self.outputs]
        self.draw(record.simulated)
        plots = [plot for j in self.outputs for plot in (self._upper(j), self._lower(j))]
        for plot in plots:
            shade_uncounted(plot, record)
            plot.toolbar.active_drag.dimensions = "width"  # the heights follow what is in it
        self.figure = below_each_other(plots, dense=True)

    # --- what is shown

    def draw(self, simulated: Floats) -> None:
        """Show another simulation (K, n_outputs)."""
        self.record = replace(self.record, simulated=simulated)
        rows = self.stretch.rows
        if (rows.start, rows.stop) != self._shown:
            self._shown = rows.start, rows.stop
            self._still(rows)
        kept = list(self.outputs)
        shown, measured = simulated[rows, : len(kept)], self.record.measured[rows, : len(kept)]
        with np.errstate(invalid="ignore", over="ignore"):
            residual = measured - shown
            some = extremes(np.hstack([shown, residual]), ROWS)
            columns = {f"s{j}": shown[some, j].astype(np.float32) for j in kept}
            columns |= {f"r{j}": residual[some, j].astype(np.float32) for j in kept}
        self.lines.data = {"t": self.record.times[rows][some], **columns}
        for j in kept:
            self._reach(j, shown[:, j], measured[:, j], residual[:, j])

    def haunt(self, simulated: Floats | None) -> None:
        """Show the simulation (K, n_outputs) of the last optimum behind, or nothing."""
        self._ghost = np.full_like(self.record.simulated, np.nan) if simulated is None else simulated
        self._still(self.stretch.rows)

    def _still(self, rows: slice) -> None:
        """Show what stays while a parameter is dragged."""
        times = self.record.times[rows]
        some = evenly(len(times), DOTS)
        measured = self.record.measured[rows]
        self.dots.data = {"t": times[some], **{f"m{j}": measured[some, j].astype(np.float32) for j in self.outputs}}
        ghost = self._ghost[rows, : len(self.outputs)]
        kept: Indices = extremes(ghost, ROWS)
        self.ghosts.data = {"t": times[kept], **{f"g{j}": ghost[kept, j].astype(np.float32) for j in self.outputs}}

    def _reach(self, j: int, simulated: Floats, measured: Floats, residual: Floats) -> None:
        """Move the ranges of an output where lines leave them, or hardly fill them."""
        known = np.concatenate([simulated, measured])
        known = known[np.isfinite(known)]
        if not known.size:
            return
        low, high = float(known.min()), float(known.max())
        upper, span = self.uppers[j], (high - low) or abs(high) or 1.0
        if low < upper.start or high > upper.end or span < LEAST_FILLED * (upper.end - upper.start):
            upper.update(start=low - ROOM * span, end=high + ROOM * span)
        left = residual[np.isfinite(residual)]
        most = float(np.abs(left).max()) if left.size else 0.0
        lower = self.lowers[j]
        if most and math.isfinite(most) and not 0.25 * lower.end < most < lower.end:
            end = _round_up(1.05 * most)
            lower.update(start=-end, end=end)

    # --- figures

    def _upper(self, j: int) -> Any:
        text = label(self.record.outputs[j], self.record.units[j])
        plot = Panel(y=text, height=230, x_range=self.across, y_range=self.uppers[j], lod_threshold=None)
        size = 3 if len(self.record.times) > 600 else 5
        seen = plot.scatter("t", f"m{j}", source=self.dots, size=size, fill_color=GREY, fill_alpha=0.6, line_color=None)
        ghost = plot.line("t", f"g{j}", source=self.ghosts, line_color=AMBER, line_width=1.6, line_dash="dashed")
        look: dict[str, Any] = {"line_color": BLUE, "line_width": 1.8}
        line = plot.line("t", f"s{j}", source=self.lines, level="overlay", **look)
        # Bokeh empties the legend of what has new data, and fills it with what is painted below the overlay
        key = plot.line([np.nan], [np.nan], **look)
        plot.hover(
            line, ("time", "@t{0.0000} s"), ("simulated", f"@s{j}{{0.00000}}"), ("residual", f"@r{j}{{0.00000}}")
        )
        plot.legend([("measured", [seen]), ("simulated", [key]), ("last optimum", [ghost])])
        plot.xaxis.visible = False
        return plot

    def _lower(self, j: int) -> Any:
        last = j == len(self.outputs) - 1
        text, height = label("residual", self.record.units[j]), 140 if last else 110
        time = "time (s)" if last else ""
        plot = Panel(x=time, y=text, height=height, x_range=self.across, y_range=self.lowers[j], lod_threshold=None)
        plot.line("t", f"r{j}", source=self.lines, line_color=RED, line_width=0.9, level="overlay")
        plot.level(0.0)
        plot.xaxis.visible = last
        plot.yaxis.ticker = BasicTicker(desired_num_ticks=3)
        return plot


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= value)


def in_scheme(figure: BokehSpec, scheme: str) -> Any:
    """Return Bokeh's own models of a figure, in the colours of a page of this scheme, "light" or "dark".

    Pages without a server exchange them by a script of their own.
    """
    (model,) = live([figure])
    if scheme == "dark":
        for each in model.references():
            for name in each.properties():
                if name.endswith("color"):
                    value = getattr(each, name)
                    if isinstance(value, str) and value in DARK:
                        setattr(each, name, DARK[value])
    return model
