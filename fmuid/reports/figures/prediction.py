"""Figures of predictions: measured against simulated with the band in which measurements are expected."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmuid.files import file_name
from fmuid.reports.figures.fit import zoom
from fmuid.reports.figures.style import (
    AMBER,
    BLUE,
    GREY,
    INK,
    MAX_EXPERIMENTS,
    MAX_OUTPUTS,
    RED,
    WIDTH,
    style,
    thin,
)
from fmuid.text import label

if TYPE_CHECKING:
    from fmuid.model_problem import Prediction


def predictions(found: Sequence[Prediction]) -> dict[str, Figure]:
    """Draw each record: measured against predicted and the residual, each with the band.

    Parameters
    ----------
    found : sequence of Prediction
        Of more than `MAX_EXPERIMENTS` those with the greatest misfit are drawn, of more than `MAX_OUTPUTS` outputs
        likewise.

    Returns
    -------
    dict of str to Figure
        ``prediction``, followed by ``-name`` of the record where there are several.
    """
    worst = sorted(found, key=lambda each: -max([0.0, *(s.misfit for s in each.scores)]))[:MAX_EXPERIMENTS]
    several = len(found) > 1
    return {
        f"prediction-{file_name(each.fit.experiment)}" if several else "prediction": _record(each)
        for each in found
        if each in worst
    }


def _record(found: Prediction) -> Figure:
    scores = sorted(sorted(found.scores, key=lambda s: -s.misfit)[:MAX_OUTPUTS], key=lambda s: s.output)
    start, stop = zoom(found.fit.simulated, np.asarray(found.fit.counted.any(axis=1)))
    rows = max(1, len(scores))
    with style():
        figure = Figure(figsize=(WIDTH, 0.5 + 2.35 * rows), layout="constrained")
        grid = figure.add_gridspec(2 * rows, 2, width_ratios=(5, 4), height_ratios=(3, 1.4) * rows)
        for place, score in enumerate(scores):
            column = found.fit.outputs.index(score.output)
            for side, samples in enumerate((slice(None), slice(start, stop))):
                upper = figure.add_subplot(grid[2 * place, side])
                lower = figure.add_subplot(grid[2 * place + 1, side], sharex=upper)
                _panels(upper, lower, found, column, samples)
                if side == 0:
                    upper.axvspan(*found.fit.times[[start, stop - 1]], color=AMBER, alpha=0.18, lw=0)
                    upper.set_title(f"{score.output}, fit {score.fit:.4g} %")
                    upper.set_ylabel(label(score.output, score.unit))
                    lower.set_ylabel("residual\n" + label("", score.unit).strip())
                elif place == 0:
                    upper.set_title("zoom", color=AMBER)
                if place == rows - 1:
                    lower.set_xlabel("time (s)")
        figure.suptitle(found.fit.experiment, x=0.01, ha="left", fontsize=10.5)
        if scores:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _panels(upper: Axes, lower: Axes, found: Prediction, column: int, samples: slice) -> None:
    times, simulated = found.fit.times[samples], found.fit.simulated[samples, column]
    measured, half = found.fit.measured[samples, column], found.half_width[samples, column]
    band = f"{100 * found.level:.4g} % band"
    if np.isfinite(half).all():
        at, low = thin(times, simulated - half)
        upper.fill_between(at, low, np.interp(at, times, simulated + half), color=BLUE, alpha=0.18, lw=0, label=band)
        at, width = thin(times, half)
        lower.fill_between(at, -width, width, color=BLUE, alpha=0.18, lw=0)
    upper.plot(*thin(times, measured), color=GREY, lw=0.8, label="measured")
    upper.plot(*thin(times, simulated), color=BLUE, lw=1.0, label="predicted")
    upper.tick_params(labelbottom=False)
    lower.plot(*thin(times, measured - simulated), color=RED, lw=0.6)
    lower.axhline(0, color=INK, lw=0.6)
    upper.margins(x=0.01)
