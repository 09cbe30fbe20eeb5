"""Measured against simulated outputs, the residual below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.data import evenly, extremes
from fmuid.formatting import fit_text, label
from fmuid.identification import CONFIDENCE_LEVEL
from fmuid.reports.interactive.bokeh_spec import BasicTicker, BokehSpec, ColumnDataSource, CrosshairTool, Range1d, Span
from fmuid.reports.interactive.style import (
    BLUE,
    GREY,
    MAX_DOTS,
    MAX_EXPERIMENTS,
    MAX_OUTPUTS,
    MAX_ROWS,
    RED,
    Panel,
    below_each_other,
)

if TYPE_CHECKING:
    from fmuid.simulation import OutputFit

# A zoom for print is this share of the record, and at least this many samples.
ZOOM_SHARE, ZOOM_SAMPLES = 0.06, 120


def worst(records: Sequence[OutputFit]) -> tuple[OutputFit, ...]:
    """Return the experiments to draw, in their order: of more than `MAX_EXPERIMENTS` those of least fit."""
    kept = sorted(records, key=lambda record: np.nanmin([100.0, *record.fit]))[:MAX_EXPERIMENTS]
    return tuple(record for record in records if record in kept)


def zoom(record: OutputFit) -> slice:
    """Return the rows of the stretch where the simulated outputs vary most, for print, where nobody can drag.

    The total variation of each output, relative to its own over the record, is summed over the outputs: being
    simulated they carry no noise. Samples that do not count do not attract the zoom.
    """
    samples = len(record.times)
    width = min(samples, max(ZOOM_SAMPLES, round(ZOOM_SHARE * samples)))
    moves = np.abs(np.diff(record.simulated[:, drawn_outputs(record)], axis=0, prepend=0.0))
    moves[0] = 0.0
    moves[~record.counted.any(axis=1)] = 0.0
    total = moves.sum(axis=0)
    activity = (moves / np.where(total > 0, total, 1.0)).sum(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(activity)])
    start = int(np.argmax(summed[width:] - summed[:-width])) if samples > width else 0
    return slice(start, start + width)


def drawn_outputs(record: OutputFit) -> list[int]:
    """Return the outputs to draw, in their order: of more than `MAX_OUTPUTS` those of least fit."""
    order = np.argsort(np.nan_to_num(np.asarray(record.fit), nan=100.0), kind="stable")
    return sorted(int(output) for output in order[:MAX_OUTPUTS])


def fit(
    record: OutputFit,
    half_width: Floats | None = None,
    degree: float = CONFIDENCE_LEVEL,
    *,
    rows: slice = slice(None),
    given: tuple[Any, Any, Any] | None = None,
) -> Any:
    """Draw the outputs of an experiment: measured dots, the simulated line, the residual below.

    Zoom, hover and crosshair are linked over all outputs. Of more than `MAX_OUTPUTS` those of least fit are
    drawn. What does not count lies in the grey part.

    Parameters
    ----------
    record : OutputFit
    half_width : (K, n_outputs) array, optional
        Of the band around the simulated line in which a measurement is expected, and around zero in the residual; NaN
        where there is none.
    degree : float
        Of the band.
    rows : slice
        What of the record is drawn.
    given : tuple of Bokeh's source of lines, source of dots and range, optional
        That are drawn in place of new ones.
    """
    outputs, fits = drawn_outputs(record), record.fit
    lines, dots, across = given or (*sources(record, outputs, half_width, rows), None)
    band = "" if half_width is None else f"{100 * degree:.4g} % band"
    record = _cut(record, rows)
    across = across or Range1d(float(record.times[0]), float(record.times[-1]), bounds="auto")
    cross = Span(dimension="height", line_dash="dotted", line_color=GREY)
    plots: list[Any] = []
    for j in outputs:
        last = j == outputs[-1]
        plots.append(_upper(record, j, (lines, dots), across, (_simulated(fits[j]), band)))
        plots.append(_lower(record, j, lines, across, last=last))
    for plot in plots:
        plot.add_tools(CrosshairTool(overlay=cross))
        shade_uncounted(plot, record)
    return below_each_other(plots, dense=True)


def _simulated(fit: float) -> str:
    return "simulated" if math.isnan(fit) else f"simulated, fit {fit_text(fit)}"


def _cut(record: OutputFit, rows: slice) -> OutputFit:
    cut = {name: getattr(record, name)[rows] for name in ("times", "measured", "simulated", "counted")}
    return replace(record, **cut)


def sources(
    record: OutputFit, outputs: Sequence[int], half_width: Floats | None = None, rows: slice = slice(None)
) -> tuple[BokehSpec, BokehSpec]:
    """Return the rows that draw the lines, by least and greatest, and those that are drawn as dots, evenly.

    Columns are ``t``, and of output number j ``m``, ``s`` and ``r`` with the number: measured, simulated, residual;
    with a band its borders ``a`` and ``b``, and those around zero, ``n`` and ``w``.
    """
    record, half_width = _cut(record, rows), None if half_width is None else half_width[rows]
    simulated, measured = record.simulated[:, outputs], record.measured[:, outputs]
    kept = extremes(np.hstack([simulated, measured - simulated]), MAX_ROWS)
    lines = _columns(record, outputs, kept)
    if half_width is not None:
        for j in outputs:
            half, middle = half_width[kept, j], record.simulated[kept, j]
            pairs = (("n", -half), ("w", half), ("a", middle - half), ("b", middle + half))
            lines |= {f"{key}{j}": _short(values) for key, values in pairs}
    if len(kept) == len(record.times) <= MAX_DOTS:
        shared = ColumnDataSource(lines)
        return shared, shared
    some = evenly(len(record.times), MAX_DOTS)
    dots = {"t": record.times[some]}
    dots |= {f"m{j}": _short(record.measured[some, j]) for j in outputs}
    return ColumnDataSource(lines), ColumnDataSource(dots)


def _columns(record: OutputFit, outputs: Sequence[int], rows: Indices) -> dict[str, Any]:
    found: dict[str, Any] = {"t": record.times[rows]}
    for j in outputs:
        measured, simulated = record.measured[rows, j], record.simulated[rows, j]
        pairs = (("m", measured), ("s", simulated), ("r", measured - simulated))
        found |= {f"{key}{j}": _short(values) for key, values in pairs}
    return found


def _short(values: Floats) -> Any:
    """Return numbers in half the space; a screen shows no more of them."""
    with np.errstate(over="ignore"):  # of an unstable simulation
        return values.astype(np.float32)


def _upper(
    record: OutputFit, j: int, given: tuple[BokehSpec, BokehSpec], across: BokehSpec, texts: tuple[str, str]
) -> Any:
    (lines, dots), (said, band) = given, texts
    plot = Panel(y=label(record.outputs[j], record.units[j]), height=220, x_range=across, lod_threshold=None)
    size = 3 if len(dots.data["t"]) > 600 else 5
    area = [plot.varea("t", f"a{j}", f"b{j}", source=lines, fill_color=BLUE, fill_alpha=0.18)] if band else []
    seen = plot.scatter("t", f"m{j}", source=dots, size=size, fill_color=GREY, fill_alpha=0.6, line_color=None)
    line = plot.line("t", f"s{j}", source=lines, line_color=BLUE, line_width=1.8)
    numbers = [("measured", f"@m{j}{{0.00000}}"), ("simulated", f"@s{j}{{0.00000}}"), ("residual", f"@r{j}{{0.00000}}")]
    plot.hover(line, ("time", "@t{0.0000} s"), *numbers, vertical=True)
    plot.legend([("measured", [seen]), (said, [line]), (band, area)])
    plot.xaxis.visible = False
    return plot


def _lower(record: OutputFit, j: int, lines: BokehSpec, across: BokehSpec, *, last: bool) -> Any:
    text = label("residual", record.units[j])
    plot = Panel(x="time (s)" if last else "", y=text, height=140 if last else 110, x_range=across, lod_threshold=None)
    if f"w{j}" in lines.data:
        plot.varea("t", f"n{j}", f"w{j}", source=lines, fill_color=BLUE, fill_alpha=0.18)
    plot.line("t", f"r{j}", source=lines, line_color=RED, line_width=0.9)
    plot.level(0.0)
    plot.xaxis.visible = last
    plot.yaxis.ticker = BasicTicker(desired_num_ticks=3)
    return plot


def shade_uncounted(plot: Any, record: OutputFit) -> None:
    """Have what does not count at the beginning of a record lie in a grey part."""
    counted = np.asarray(record.counted.any(axis=1))
    if counted.any() and not counted[0]:
        end = float(record.times[int(counted.argmax())])
        plot.shade(GREY, right=end)
