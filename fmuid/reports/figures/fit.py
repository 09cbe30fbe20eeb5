"""Figures of measured against simulated outputs, the residual below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fmuid.arrays import Floats
from fmuid.files import file_name
from fmuid.reports.figures.style import (
    AMBER,
    BLUE,
    GREY,
    INK,
    MAX_EXPERIMENTS,
    MAX_OUTPUTS,
    MAX_POINTS,
    RED,
    WIDTH,
    style,
    thin,
)
from fmuid.text import label

if TYPE_CHECKING:
    from fmuid.simulation import Fit


ZOOM_SHARE, ZOOM_SAMPLES = 0.06, 120
"""The zoom is this share of the record, and at least this many samples."""


def fits(records: Sequence[Fit]) -> dict[str, Figure]:
    """Draw measured against simulated for each experiment.

    Parameters
    ----------
    records
        One per experiment. Of more than `MAX_EXPERIMENTS` those with the greatest misfit are drawn, and of more than
        `MAX_OUTPUTS` outputs likewise.

    Returns
    -------
    dict of str to Figure
        ``fit``, followed by ``-name`` of the experiment where there are several.
    """
    worst = sorted(records, key=lambda record: -np.nanmax([0.0, *record.misfit]))[:MAX_EXPERIMENTS]
    found = {}
    for record in (record for record in records if record in worst):
        name = record.experiment if len(records) > 1 else ""
        found[f"fit-{file_name(name)}" if name else "fit"] = fit(record, name)
    return found


# --- measured against simulated ---------------------------------------------------------


def fit(record: Fit, name: str = "") -> Figure:
    """Draw measured against simulated, the residual below: the whole record, and where the outputs move most.

    `name` is the experiment's, where it needs one.
    """
    outputs = _worst_outputs(record)
    counted = np.asarray(record.counted.any(axis=1))
    start, stop = zoom(record.simulated[:, outputs], counted)
    with style():
        figure = Figure(figsize=(WIDTH, 0.5 + 2.35 * len(outputs)), layout="constrained")
        grid = figure.add_gridspec(2 * len(outputs), 2, width_ratios=(5, 4), height_ratios=(3, 1) * len(outputs))
        shared: list[Axes | None] = [None, None]
        for place, output in enumerate(outputs):
            for side, samples in enumerate((slice(None), slice(start, stop))):
                upper = figure.add_subplot(grid[2 * place, side], sharex=shared[side])
                lower = figure.add_subplot(grid[2 * place + 1, side], sharex=upper)
                shared[side] = shared[side] or upper
                _fit_panels(upper, lower, record, output, samples)
                if side == 0:
                    span = record.times[[start, stop - 1]]
                    upper.axvspan(span[0], span[1], color=AMBER, alpha=0.18, lw=0)
                    upper.set_title(f"{record.outputs[output]}, misfit {100 * record.misfit[output]:.3g} %")
                    upper.set_ylabel(label(record.outputs[output], record.units[output]))
                    lower.set_ylabel("residual\n" + label("", record.units[output]).strip())
                    _shade_uncounted(upper, record, counted)
                elif place == 0:
                    upper.set_title("zoom", color=AMBER)
                last = place == len(outputs) - 1
                lower.tick_params(labelbottom=last)
                if last:
                    lower.set_xlabel("time (s)")
        if name:
            figure.suptitle(name, x=0.01, ha="left", fontsize=10.5)
        figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=1.6)
    return figure


def _fit_panels(upper: Axes, lower: Axes, record: Fit, output: int, samples: slice) -> None:
    times, measured = record.times[samples], record.measured[samples, output]
    simulated = record.simulated[samples, output]
    if len(times) > MAX_POINTS:
        upper.plot(*thin(times, measured), color=GREY, lw=0.7, alpha=0.7, label="measured")
    else:
        size = 1.6 if len(times) > 4 * ZOOM_SAMPLES else 3.4
        upper.plot(times, measured, "o", color=GREY, ms=size, mew=0, alpha=0.75, label="measured")
    upper.plot(*thin(times, simulated), color=BLUE, label="simulated")
    upper.tick_params(labelbottom=False)
    lower.plot(*thin(times, measured - simulated), color=RED, lw=0.6)
    lower.axhline(0, color=INK, lw=0.6)
    lower.yaxis.set_major_locator(MaxNLocator(nbins=3, symmetric=True))
    upper.margins(x=0.01)


def _shade_uncounted(axes: Axes, record: Fit, counted: npt.NDArray[np.bool_]) -> None:
    """Grey over the transient that is simulated but not counted."""
    if counted.any() and not counted[0]:
        axes.axvspan(record.times[0], record.times[int(counted.argmax())], color=GREY, alpha=0.18, lw=0)


def zoom(simulated: Floats, counted: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first sample and the one past the last of the stretch where the simulated outputs vary most.

    The total variation of each output, relative to its own over the record, is summed over the outputs: being
    simulated they carry no noise. Samples that do not count do not attract the zoom.
    """
    samples = len(simulated)
    width = min(samples, max(ZOOM_SAMPLES, round(ZOOM_SHARE * samples)))
    moves = np.abs(np.diff(simulated, axis=0, prepend=simulated[:1]))
    moves[~counted] = 0.0
    total = moves.sum(axis=0)
    activity = (moves / np.where(total > 0, total, 1.0)).sum(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(activity)])
    start = int(np.argmax(summed[width:] - summed[:-width])) if samples > width else 0
    return start, start + width


def _worst_outputs(record: Fit) -> list[int]:
    """Return the outputs to draw, in their own order: all, or the `MAX_OUTPUTS` of greatest misfit."""
    order = np.argsort(-np.nan_to_num(np.asarray(record.misfit)), kind="stable")
    return sorted(int(output) for output in order[:MAX_OUTPUTS])
