"""Figures of the criterion: a map with optima and confidence ellipse; the parabolas of prior, data and both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogFormatterMathtext

from fmuid.arrays import Floats
from fmuid.assessment import both_known
from fmuid.assessment import parabolas as parabolas_of
from fmuid.errors import InputError
from fmuid.reports.figures.style import AMBER, BLUE, FAINT, GREY, INK, MAX_PARAMETERS, RED, WIDTH, style
from fmuid.text import label

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.assessment import CriterionMap


# Contours, in equal ratios.
CONTOURS = 24
# Below a hundredth of what the confidence region allows, the criterion is as good as at its minimum ...
FLOOR_SHARE = 0.01
# ... and what few points exceed, where simulations explode without failing, looks all the same; beyond the last value
# contours overflow.
TOP_PERCENTILE, LARGEST_EXCESS = 98.0, 1e50
# An ellipse smaller than this share of the map is hidden by the estimate.
VISIBLE_SHARE = 0.012
# Held parameters named below the figure; more would not fit on a line.
MAX_HELD = 6


def criterion_map(
    chart: CriterionMap,
    optima: pd.DataFrame | None = None,
    units: Mapping[str, str | None] | None = None,
    *,
    level: float = 0.95,
) -> Figure:
    """Draw by how much the criterion exceeds its minimum over two parameters, the estimate and its confidence ellipse.

    Simulations that failed are hatched. The dashed line is where the section itself has risen by as much as the border
    of the confidence region allows: where it leaves the ellipse, the local covariance (1.31) is not the whole truth.
    With more than two parameters it lies inside the ellipse, since the others do not follow.

    Parameters
    ----------
    chart : CriterionMap
    optima : DataFrame, optional
        Optima found, columns named as the parameters (`fmuid.estimation.optima_table`). Those beyond the map are left
        out; the other parameters have their own values there, so that the contours around them need not show a minimum.
    units : mapping of str to str, optional
        Of the parameters.
    level : float
        Of the ellipse.
    """
    first, second, values = chart.grid
    excess = np.minimum(values - np.nanmin(values, initial=chart.criterion), LARGEST_EXCESS)
    levels = _levels(excess, chart.rise(level))
    with style():
        figure = Figure(figsize=(0.78 * WIDTH, 0.66 * WIDTH), layout="constrained")
        axes = figure.subplots()
        axes.set_facecolor("white")
        axes.patch.set(hatch="////", edgecolor=FAINT)  # what no contour covers failed
        colors = BoundaryNorm(levels, 256, extend="max")
        shown = np.ma.masked_invalid(np.maximum(excess.T, levels[0]))
        axes.contourf(first, second, shown, levels, norm=colors, cmap="Blues_r", extend="max")
        axes.contour(first, second, shown, levels[1:-1], colors="white", linewidths=0.4, alpha=0.6)
        _bar(figure, axes, colors, levels)
        handles = _region(axes, chart, excess, level) + _points(axes, chart, optima)
        if np.isnan(values).any():
            handles.append(Patch(facecolor="white", edgecolor=FAINT, hatch="////", label="simulation failed"))
        _frame(axes, chart, (first, second), units or {})
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return figure


def _levels(excess: Floats, rise: float) -> Floats:
    """Return contour levels in equal ratios, from the lowest on the map that matters to nearly the highest."""
    found = excess[np.isfinite(excess)]
    low = max(FLOOR_SHARE * rise, float(found.min(initial=np.inf, where=found > 0)))
    low = low if np.isfinite(low) else FLOOR_SHARE * rise
    high = max(float(np.percentile(found, TOP_PERCENTILE)) if found.size else 0.0, 2.0 * low)
    return np.geomspace(low, high, CONTOURS)


def _bar(figure: Figure, axes: Axes, colors: BoundaryNorm, levels: Floats) -> None:
    decades = 10.0 ** np.arange(np.ceil(np.log10(levels[0])), np.floor(np.log10(levels[-1])) + 1)
    few = decades.size < 2
    bar = figure.colorbar(
        ScalarMappable(colors, "Blues_r"),
        ax=axes,
        ticks=levels[:: CONTOURS // 6] if few else decades,
        format="%.3g" if few else LogFormatterMathtext(),
        spacing="proportional",
    )
    bar.ax.set_yscale("log")
    bar.ax.minorticks_off()
    bar.set_label("criterion above its minimum")


def _region(axes: Axes, chart: CriterionMap, excess: Floats, level: float) -> list[Any]:
    """Draw the confidence ellipse and the section's own contour at the same level."""
    first, second, _ = chart.grid
    rise, ellipse = chart.rise(level), chart.ellipse(level)
    drawn: list[Any] = []
    extent = np.array([np.ptp(first), np.ptp(second)])
    if len(ellipse) and (np.ptp(ellipse, axis=0) > VISIBLE_SHARE * extent).any():
        drawn += axes.plot(*ellipse.T, color=RED, lw=1.5, label=f"{100 * level:g} % ellipse of both parameters")
    if np.nanmin(excess, initial=rise) < rise < np.nanmax(excess, initial=0.0):
        section = np.ma.masked_invalid(excess.T)
        axes.contour(first, second, section, [rise], colors=RED, linewidths=1.1, linestyles="dashed")
        text = f"criterion raised by {rise:.3g}" + (", others held" if chart.held else "")
        drawn.append(Line2D([], [], color=RED, lw=1.1, ls="dashed", label=text))
    return drawn


def _points(axes: Axes, chart: CriterionMap, optima: pd.DataFrame | None) -> list[Any]:
    """Draw the estimate and the other optima on the map."""
    x, y = chart.estimate
    drawn = axes.plot([x], [y], "o", ms=6, mfc=AMBER, mec=INK, mew=0.9, ls="", clip_on=False, label="estimate")
    if optima is None:
        return drawn
    (low, *_, high), (bottom, *_, top), _ = chart.grid
    places = optima[list(chart.names)].to_numpy(float)
    inside = ((places >= (low, bottom)) & (places <= (high, top))).all(axis=1)
    apart = (np.abs(places - chart.estimate) > 0.01 * np.array([high - low, top - bottom])).any(axis=1)
    others = places[inside & apart]
    if len(others):
        drawn += axes.plot(
            *others.T, "o", ms=6, mfc="white", mec=INK, mew=1.1, ls="", clip_on=False, label="other optima found"
        )
    return drawn


def _frame(axes: Axes, chart: CriterionMap, sides: tuple[Floats, Floats], units: Mapping[str, str | None]) -> None:
    first, second = chart.names
    if chart.logarithmic[0]:
        axes.set_xscale("log")
    if chart.logarithmic[1]:
        axes.set_yscale("log")
    axes.set_xlim(sides[0][0], sides[0][-1])
    axes.set_ylim(sides[1][0], sides[1][-1])
    axes.set_xlabel(label(first, units.get(first)))
    axes.set_ylabel(label(second, units.get(second)))
    axes.grid(visible=False)
    held = [f"{name} = {value:.4g}" for name, value in list(chart.held.items())[:MAX_HELD]]
    more = ", ..." if len(chart.held) > MAX_HELD else ""
    axes.set_title(f"criterion over {first} and {second}")
    if held:
        axes.set_title(f"at {', '.join(held)}{more}", loc="right", fontweight="normal", color=GREY)


# --- prior, data and both: figure 1.1 of the chapter

PARTS = (("prior", "prior", AMBER, "--"), ("data", "data alone", GREY, "-."), ("both", "both", BLUE, "-"))
PARABOLA_HEIGHT = 1.05
"""Of a panel, in the greatest value of the sum."""


def parabolas(
    reading: pd.DataFrame, names: Sequence[str] = (), units: Mapping[str, str | None] | None = None
) -> Figure:
    """Draw the parabolas of prior, data and both, a panel each parameter.

    Parameters
    ----------
    reading : DataFrame
        `fmuid.assessment.Reading.table`, or ``reading.csv``.
    names : sequence of str
        Default: all that prior and data both speak of.
    units : mapping of str to str, optional
        Of the parameters.

    Raises
    ------
    InputError
        If there is no such parameter, it has no standard deviation, or none has both prior and data.
    """
    shown = list(names or both_known(reading))[:MAX_PARAMETERS]
    if not shown:
        raise InputError("there are no parabolas to draw: prior and data both speak of no parameter")
    columns = min(len(shown), 2)
    rows = math.ceil(len(shown) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 2.2 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, name in zip(panels, shown, strict=False):
            curves = parabolas_of(reading, name)
            for part, text, color, dashes in PARTS:
                axes.plot(curves["value"], curves[part], color=color, ls=dashes, label=text)
            axes.set_xlim(curves["value"].iloc[0], curves["value"].iloc[-1])
            axes.set_ylim(0.0, PARABOLA_HEIGHT * float(curves["both"].max()))
            axes.set_xlabel(label(name, (units or {}).get(name)))
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[: len(shown) : columns]:
            axes.set_ylabel("criterion")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
