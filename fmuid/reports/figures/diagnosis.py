"""Figures of a diagnosis: sizes with intervals, what decides, and what the fault explains of the residual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmuid.arrays import Floats
from fmuid.diagnosis import Diagnosis, Hypothesis
from fmuid.reports.figures.style import BLUE, GREY, INK, MAX_OUTPUTS, RED, WIDTH, style, thin
from fmuid.text import label

# More hypotheses than these make a figure nobody reads: the most significant are kept.
MAX_FAULTS = 12


def draw(found: Diagnosis, units: Mapping[str, str | None] | None = None) -> dict[str, Figure]:
    """Draw a diagnosis; the residuals only where it has its fits."""
    shown = sorted(found.hypotheses, key=lambda each: each.probability)[:MAX_FAULTS]
    kept = [each for each in found.hypotheses if each in shown]
    figures = {"diagnosis-sizes": sizes(found, kept), "diagnosis-decision": decision(found, kept)}
    best = found[found.named[0]] if found.named else shown[0]
    if found.result is not None and best.result is not None:
        figures["diagnosis-residual"] = residuals(found, best, units or {})
    return figures


def sizes(found: Diagnosis, shown: Sequence[Hypothesis]) -> Figure:
    """Draw the sizes of each fault with their intervals of 95 %, a panel a fault."""
    rows = [len(each.sizes) for each in shown]
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 0.5 * len(rows) + 0.3 * sum(rows)), layout="constrained")
        panels = figure.subplots(len(shown), 1, squeeze=False, height_ratios=[1 + row for row in rows])[:, 0]
        for axes, each in zip(panels, shown, strict=True):
            color = RED if each.name in found.named else GREY
            for place, size in enumerate(each.sizes):
                if not math.isfinite(size.std):
                    continue
                low, high = size.interval()
                axes.plot([low, high], [place, place], color=color, lw=2.2, solid_capstyle="butt")
                axes.plot([size.value], [place], "o", color=color, ms=5)
            axes.axvline(0.0, color=INK, lw=0.8)
            axes.set_yticks(range(len(each.sizes)), [label(size.name, size.unit) for size in each.sizes])
            axes.set_ylim(len(each.sizes) - 0.4, -0.6)
            axes.set_title(each.name + (", named" if each.name in found.named else ""))
            axes.grid(visible=False, axis="y")
        panels[-1].set_xlabel("size, with its interval of 95 %")
    return figure


def decision(found: Diagnosis, shown: Sequence[Hypothesis]) -> Figure:
    """Draw D of each fault against its threshold."""
    with style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.42 * len(shown)), layout="constrained")
        axes = figure.subplots()
        for place, each in enumerate(shown):
            color = RED if each.name in found.named else BLUE if each.name in found.called else GREY
            axes.barh(place, each.statistic, height=0.55, color=color)
            axes.plot([each.threshold] * 2, [place - 0.4, place + 0.4], color=INK, lw=1.6)
        axes.plot([], [], color=INK, lw=1.6, label=f"threshold at a false-alarm level of {100 * found.level:g} %")
        axes.set_xscale("symlog", linthresh=10.0)
        axes.set_xlim(0.0, 2.0 * max(max(each.statistic, each.threshold) for each in shown))
        axes.set_yticks(range(len(shown)), [each.name for each in shown])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("D, by how much the fault lowers the criterion (linear below 10)")
        figure.legend(loc="outside lower right")
    return figure


def residuals(found: Diagnosis, best: Hypothesis, units: Mapping[str, str | None]) -> Figure:
    """Draw each output's residual without the fault and with it, and what the fault adds; the first experiment."""
    assert found.result is not None and best.result is not None
    without, with_ = found.result.fit[0], best.result.fit[0]
    outputs = [name.partition(".")[2] for name in without.columns if name.startswith("measured.")][:MAX_OUTPUTS]
    with style():
        figure = Figure(figsize=(WIDTH, 0.7 + 1.9 * len(outputs)), layout="constrained")
        panels = figure.subplots(len(outputs), 2, squeeze=False, sharex=True, sharey="row")
        for k, output in enumerate(outputs):
            before, after = _residual(without, k), _residual(with_, k)
            times = without["time"].to_numpy(np.float64)
            _panel(panels[k, 0], times, before)
            added = before - after
            panels[k, 0].plot(*thin(times, added), color=RED, lw=1.1, label=f"what {best.name} adds")
            _panel(panels[k, 1], times, after)
            panels[k, 0].set_ylabel("residual of\n" + label(output, units.get(output)))
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
        panels[0, 0].set_title("healthy model")
        panels[0, 1].set_title(f"with {best.name}")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _residual(frame: pd.DataFrame, output: int) -> Floats:
    """Return measured − simulated of output number `output`, whatever its name in this model."""
    measured, simulated = (
        frame[[name for name in frame.columns if name.startswith(f"{kind}.")][output]].to_numpy(np.float64)
        for kind in ("measured", "simulated")
    )
    return np.asarray(measured - simulated, dtype=np.float64)


def _panel(axes: Axes, times: Floats, residual: Floats) -> None:
    std = math.sqrt(float(np.nanmean(residual**2)))
    axes.plot(*thin(times, residual), color=GREY, lw=0.6, label="residual")
    axes.axhline(0.0, color=INK, lw=0.6)
    axes.text(0.99, 0.97, f"std {std:.4g}", transform=axes.transAxes, ha="right", va="top", color=INK)
    axes.margins(x=0.01)
