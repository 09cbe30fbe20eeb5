"""The figures of residuals: over time, distribution, autocorrelation, cross-correlation with the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fmuid.arrays import Floats
from fmuid.files import file_name
from fmuid.reports.figures.style import AMBER, BLUE, GREY, INK, MAX_EXPERIMENTS, MAX_OUTPUTS, RED, WIDTH, style, thin
from fmuid.text import label

if TYPE_CHECKING:
    from fmuid.assessment import Diagnostics, ResidualSeries


# The histogram reaches so many standard deviations to both sides; what lies beyond is in its last bars.
SHOWN_STDS = 4.0
# Samples enough for narrow bars.
MANY_SAMPLES = 300
# Inputs whose correlation is drawn: those that are least likely to be chance. Lines beyond these cannot be told apart.
INPUT_COLORS = (RED, BLUE, AMBER, GREY)
# Correlations are drawn to a scale of at least so many half-widths of the band, so that white noise looks harmless.
BANDS = 3.0


def residuals(diagnostics: Diagnostics, units: Mapping[str, str | None] | None = None) -> dict[str, Figure]:
    """Draw the residuals of each experiment.

    Parameters
    ----------
    diagnostics : Diagnostics
        Of more than `MAX_EXPERIMENTS` experiments those whose residuals are correlated longest are drawn, of more than
        `MAX_OUTPUTS` outputs likewise.
    units : mapping of str to str, optional
        Of the outputs.

    Returns
    -------
    dict of str to Figure
        ``residuals``, followed by ``-name`` of the experiment where there are several.
    """
    by_name: dict[str, list[ResidualSeries]] = {}
    for each in diagnostics.series:
        by_name.setdefault(each.experiment, []).append(each)
    order = sorted(by_name, key=lambda name: -max(each.correlation_samples for each in by_name[name]))
    drawn = [name for name in by_name if name in order[:MAX_EXPERIMENTS]]
    several = len(by_name) > 1
    return {
        f"residuals-{file_name(name)}" if several else "residuals": _experiment(
            by_name[name], units or {}, name if several else ""
        )
        for name in drawn
    }


def _experiment(series: Sequence[ResidualSeries], units: Mapping[str, str | None], name: str) -> Figure:
    worst = sorted(series, key=lambda each: -each.correlation_samples)[:MAX_OUTPUTS]
    shown = [each for each in series if each in worst]
    crossed = any(each.inputs for each in shown)
    headings = ["residual", "distribution", "autocorrelation", "cross-correlation"][: 4 if crossed else 3]
    below = ["time (s)", "residual / its std", "lag (samples)", "input's lead (samples)"]
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 1.9 * len(shown)), layout="constrained")
        widths = (4.0, 2.0, 2.6, 2.6) if crossed else (5.0, 2.2, 3.0)
        panels = figure.subplots(len(shown), len(widths), squeeze=False, width_ratios=widths)
        for row, each in zip(panels, shown, strict=True):
            _over_time(row[0], each)
            row[0].set_ylabel(label(each.output, units.get(each.output)))
            if each.examined:
                _histogram(row[1], each)
                _autocorrelation(row[2], each)
            if crossed and each.inputs:
                _with_inputs(row[3], each)
            for axes in (axes for axes in row[1:] if not axes.has_data()):
                axes.set_axis_off()
        for axes, text in zip(panels[0], headings, strict=True):
            axes.set_title(text)
        for axes, text in zip(panels[-1], below, strict=False):
            axes.set_xlabel(text)
        if name:
            figure.suptitle(name, x=0.01, ha="left", fontsize=10.5)
    return figure


def _over_time(axes: Axes, series: ResidualSeries) -> None:
    axes.plot(*thin(series.times, series.residual), color=RED, lw=0.5)
    axes.axhline(0, color=INK, lw=0.6)
    axes.margins(x=0.01)


def _histogram(axes: Axes, series: ResidualSeries) -> None:
    scaled = (series.residual[np.isfinite(series.residual)] - series.mean) / series.std
    edges = np.linspace(-SHOWN_STDS, SHOWN_STDS, 33 if series.samples > MANY_SAMPLES else 17)
    axes.hist(np.clip(scaled, -SHOWN_STDS, SHOWN_STDS), bins=list(edges), density=True, color=RED, alpha=0.45)
    normal = np.exp(-(edges**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(edges, normal, color=INK, lw=1, label="normal")
    axes.legend(loc="upper right", handlelength=1.0, borderaxespad=0.0)
    axes.set_xlim(-1.1 * SHOWN_STDS, 1.1 * SHOWN_STDS)
    axes.set_ylim(top=1.25 * axes.get_ylim()[1])  # room for the legend
    axes.set_xticks([-4, -2, 0, 2, 4])
    axes.set_yticks([])
    axes.grid(visible=False)


def _autocorrelation(axes: Axes, series: ResidualSeries) -> None:
    values = series.autocorrelation[1:]
    axes.axhspan(-series.band, series.band, color=BLUE, alpha=0.16, lw=0, label="95 % if white")
    axes.vlines(np.arange(1, values.size + 1), 0, values, color=RED, lw=1.4)
    axes.axhline(0, color=INK, lw=0.6)
    _scale(axes, values, series.band)
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.0)


def _with_inputs(axes: Axes, series: ResidualSeries) -> None:
    likely = sorted(series.inputs, key=lambda one: one.probability)[: len(INPUT_COLORS)]
    shown = [one for one in series.inputs if one in likely]
    band = max(one.band for one in shown)
    axes.axhspan(-band, band, color=BLUE, alpha=0.16, lw=0)
    for one, color in zip(shown, INPUT_COLORS, strict=False):
        axes.plot(one.lags / series.step, one.values, color=color, lw=1.1, label=one.input)
    axes.axhline(0, color=INK, lw=0.6)
    axes.margins(x=0.02)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, steps=[1, 2, 5, 10]))
    _scale(axes, np.concatenate([one.values for one in shown]), band)
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.0, ncols=2, columnspacing=1.0)


def _scale(axes: Axes, values: Floats, band: float) -> None:
    reach = min(1.4 * max(BANDS * band, float(np.nanmax(np.abs(values), initial=0.0))), 1.05)
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5))
