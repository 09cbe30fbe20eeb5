"""Figures redrawn within a frame: another simulation on Bokeh's overlay, or another time range."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from fmuid.apps.workbench.widgets import on_change
from fmuid.array_types import Floats, Indices
from fmuid.data import evenly, extremes
from fmuid.formatting import label
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Figure, Layer, short, stacked
from fmuid.reports.render.bokeh_models import live
from fmuid.reports.render.bokeh_renderer import drawing
from fmuid.reports.topics.fit import uncounted
from fmuid.simulation import OutputFit

ROWS, DOTS = 1600, 700  # Rows of lines and dots: painted within a frame without a graphics card
ROOM = 0.12  # free fraction above and below the lines, at a new range
Asked = TypeVar("Asked")
Later = Callable[[Callable[[], None]], object]  # Deferred call, as ``add_next_tick_callback`` of a document


def in_scheme(figures: Sequence[Figure], scheme: str) -> list[Any]:
    """Return Bokeh models of charts in the colors of a scheme."""
    return live(drawing(figures).figures, dark=scheme == "dark")


class LatestOnlyWorker(Generic[Asked]):
    """Worker thread that keeps only the latest pending request.

    `work` raises nothing; `interrupt` has it return early; `release` ends the thread.
    """

    def __init__(
        self,
        work: Callable[[Asked], object],
        interrupt: Callable[[], object] = lambda: None,
        release: Callable[[], object] = lambda: None,
    ) -> None:
        self._work, self._interrupt, self._release = work, interrupt, release
        self._waiting, self._is_working, self._closed = list[Asked](), False, False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, what: Asked) -> None:
        """Replace the pending request."""
        with self._changed:
            self._waiting[:] = [what]
            self._changed.notify()

    def close(self) -> None:
        """End the work and the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
            if self._is_working:
                self._interrupt()

    def _run(self) -> None:
        while (what := self._next()) is not None:
            self._work(what[0])
        self._release()

    def _next(self) -> tuple[Asked] | None:
        """Wait for a request; return None at the end."""
        with self._changed:
            self._is_working = False
            self._changed.wait_for(lambda: self._waiting or self._closed)
            self._is_working = not self._closed
            return None if self._closed else (self._waiting.pop(),)


class TimeRange:
    """Visible time range; `redraw` is called once per change of it."""

    def __init__(self, times: Floats, later: Later, redraw: Callable[[], None]) -> None:
        self._times, self._later, self._redraw, self._due = times, later, redraw, False
        self.across = Range1d(float(times[0]), float(times[-1]), bounds="auto")
        on_change(self._moved, self.across, name="start")
        on_change(self._moved, self.across, name="end")

    @property
    def rows(self) -> slice:
        """The visible rows, and one more at each end."""
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
    """Charts of a fit, thinned for each visible time range."""

    def __init__(self, later: Later, times: Floats, grid: ChartGrid, scheme: str) -> None:
        self._of, self.grid = grid.live, grid
        self.window = TimeRange(times, later, self._draw)
        self._drawing = drawing([grid], {"time": self.window.across}, ColumnDataSource)
        (self.figure,) = live(self._drawing.figures, dark=scheme == "dark")

    def _draw(self) -> None:
        assert self._of is not None, "charts of a fit can be thinned anew"
        new = self._of(self.window.across.start, self.window.across.end)
        self._drawing.refill([new], [self.grid])
        self.grid = new


class LiveFit:
    """Charts of one experiment whose simulation changes."""

    def __init__(self, record: OutputFit, later: Later, scheme: str) -> None:
        self.record, self._ghost = record, np.full_like(record.simulated, np.nan)
        self.outputs = range(min(len(record.outputs), LIMITS.outputs))
        self._x, self._order, self._across = _axis(record)
        self.stretch = TimeRange(self._x, later, lambda: self.draw(self.record.simulated))
        self.across = self.stretch.across
        self._shown: tuple[float, float] | None = None
        self._still: tuple[Floats, Floats, Floats, Floats] | None = None
        self.uppers = [Range1d(0.0, 1.0) for _ in self.outputs]
        self.lowers = [Range1d(-1.0, 1.0) for _ in self.outputs]
        self.grid = self._grid()
        ranges = {"time": self.across}
        for j in self.outputs:
            ranges |= {f"upper {j}": self.uppers[j], f"lower {j}": self.lowers[j]}
        self._drawing = drawing([self.grid], ranges, ColumnDataSource)
        (self.figure,) = live(self._drawing.figures, dark=scheme == "dark")
        self.draw(record.simulated)

    def draw(self, simulated: Floats) -> None:
        """Show another simulation, (K, n_outputs)."""
        self.record = replace(self.record, simulated=simulated)
        new = self._grid()
        self._drawing.refill([new], [self.grid])
        self.grid = new
        rows = self.stretch.rows
        shown, measured = self._rows_of(simulated, rows), self._rows_of(self.record.measured, rows)
        with np.errstate(invalid="ignore", over="ignore"):
            for j in self.outputs:
                self._reach(j, shown[:, j], measured[:, j], measured[:, j] - shown[:, j])

    def haunt(self, simulated: Floats | None) -> None:
        """Show the simulation (K, n_outputs) of the last optimum, or none."""
        self._ghost = np.full_like(self.record.simulated, np.nan) if simulated is None else simulated
        self._shown = None
        self.draw(self.record.simulated)

    def _kept(self, rows: slice) -> tuple[Floats, Floats, Floats, Floats]:
        """Return times and measured dots, times and last optimum; a drag of a parameter keeps them."""
        if self._still is None or (rows.start, rows.stop) != self._shown:
            times, count = self._x[rows], len(self.outputs)
            some, ghost = evenly(len(times), DOTS), self._rows_of(self._ghost, rows)[:, :count]
            kept = extremes(ghost, ROWS)
            dots = short(np.ascontiguousarray(self._rows_of(self.record.measured, rows)[some, :count].T))
            self._still = times[some], dots, times[kept], short(np.ascontiguousarray(ghost[kept].T))
            self._columns = [list(dots), list(self._still[3])]
            self._shown = rows.start, rows.stop
        return self._still

    def _rows_of(self, table: Floats, rows: slice) -> Floats:
        """Return visible rows of a table (K, m), along the abscissa."""
        return np.asarray(table[self._order][rows])

    def _grid(self) -> ChartGrid:
        rows, count = self.stretch.rows, len(self.outputs)
        t_dots, _, t_ghost, _ = self._kept(rows)
        tables = self.record.simulated, self.record.measured
        shown, measured = (self._rows_of(each, rows)[:, :count] for each in tables)
        with np.errstate(invalid="ignore", over="ignore"):
            residual = measured - shown
            some = extremes(np.hstack([shown, residual]), ROWS)
        thin, grey, across = self._x[rows][some], uncounted(self.record), self._across
        size, charts = 3 if len(self._x) > DOTS else 5, []
        at = ("time", "@x{0.0000} s") if self.record.kind == "time" else (across.label, "@x")
        hover = (at, ("simulated", "@y{0.00000}"), ("residual", "@r{0.00000}"))
        for j in self.outputs:
            line, rest = short(shown[some, j]), short(residual[some, j])
            last = j == self.outputs[-1]
            dots, ghost = (columns[j] for columns in self._columns)
            upper = (
                *grey,
                Layer("points", {"x": t_dots, "y": dots}, "grey", alpha=0.6, size=size, label="measured"),
                Layer("line", {"x": thin, "y": line, "r": rest}, label="simulated", hover=hover, above=True),
                Layer("line", {"x": t_ghost, "y": ghost}, "amber", width=1.6, dash="dashed", label="last optimum"),
            )
            error = Layer("line", {"x": thin, "y": rest, "s": line}, "red", width=0.9, above=True)
            text, unit = self.record.outputs[j], self.record.units[j]
            charts.append(Chart(across, Axis(label(text, unit), linked=f"upper {j}"), upper, 230, crosshair=True))
            y = Axis(label("residual", unit), ticks=3, linked=f"lower {j}")
            lower = (*grey, error, Layer("rule", {"y": 0.0}, "ink"))
            charts.append(Chart(across, y, lower, 140 if last else 110, crosshair=True))
        return stacked(charts)

    def _reach(self, j: int, simulated: Floats, measured: Floats, residual: Floats) -> None:
        """Fit the ranges of an output to its lines."""
        known = np.concatenate([simulated, measured])
        known = known[np.isfinite(known)]
        if not known.size:
            return
        low, high = float(known.min()), float(known.max())
        upper, span = self.uppers[j], (high - low) or abs(high) or 1.0
        if low < upper.start or high > upper.end or span < 0.35 * (upper.end - upper.start):
            upper.update(start=low - ROOM * span, end=high + ROOM * span)
        left = residual[np.isfinite(residual)]
        most = float(np.abs(left).max()) if left.size else 0.0
        lower = self.lowers[j]
        if most and math.isfinite(most) and not 0.25 * lower.end < most < lower.end:
            end = _round_up(1.05 * most)
            lower.update(start=-end, end=end)


def _axis(record: OutputFit) -> tuple[Floats, Indices | slice, Axis]:
    """Return the abscissa (K,), the order of rows, and the axis."""
    if record.kind != "frequency":
        return record.times, slice(None), Axis("time (s)" if record.kind == "time" else "row", linked="time", ticks=8)
    order = np.argsort(record.axis["frequency"], kind="stable")
    return record.axis["frequency"][order], order, Axis(label("frequency", "Hz"), "log", linked="time")


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= value)
