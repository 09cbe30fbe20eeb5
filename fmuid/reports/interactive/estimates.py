"""Estimates: prior, data and both; correlations and confidence ellipses; what a finer simulation moves them by."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import SHIFT_LIMIT
from fmuid.identification import parabolas as parabolas_of
from fmuid.identification import parameters_with_prior_and_data, region_rise
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, FactorRange, Field, HoverTool, LinearColorMapper
from fmuid.reports.interactive.rows import rows_of
from fmuid.reports.interactive.style import (
    AMBER,
    BLUE,
    FONT,
    GREY,
    INK,
    MAX_PARAMETERS,
    RED,
    Panel,
    Units,
    named,
    normal,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

    from fmuid.estimation import Result

# Densities are drawn so many standard deviations wide; a density wider than this many of the narrowest is cut.
DENSITY_STDS, WIDEST = 4.0, 12.0
# Of a figure of parabolas, in that of the sum.
HEIGHT = 1.05
# Pairs whose ellipses are drawn: the most correlated ones.
MAX_ELLIPSES = 6
# Text on cells of a strong colour, and on pale ones: the cells are the same on a dark page.
ON_STRONG, ON_PALE, STRONG = "#fefefe", "#1b1f24", 0.6
ELLIPSE_POINTS = 121
# RdBu of ColorBrewer.
BLUE_RED = (
    *("#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7"),
    *("#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f"),
)


def belief(reading: pd.DataFrame, units: Units | None = None) -> list[Any]:
    """Draw what the prior, the data alone and both say of each parameter, as normal densities.

    Parameters
    ----------
    reading : DataFrame
        As in ``reading.csv``.
    units : mapping of str to str, optional
        Of the parameters.
    """
    plots = []
    for row in reading.iloc[:MAX_PARAMETERS].to_dict("records"):
        plot = Panel(x=named(str(row["parameter"]), units), height=210)
        pairs = {
            "prior": (AMBER, row["prior"], row["prior_std"]),
            "data alone": (GREY, row["data"], row["data_std"]),
            "both": (BLUE, row["combined"], row["combined_std"]),
        }
        known = {
            text: each
            for text, each in pairs.items()
            if math.isfinite(each[1]) and math.isfinite(each[2]) and each[2] > 0
        }
        if not known:
            continue
        narrowest = min(std for _, _, std in known.values())
        entries = []
        for text, (color, mean, std) in known.items():
            width = min(DENSITY_STDS * std, WIDEST * narrowest)
            grid = np.linspace(mean - width, mean + width, 161)
            density = normal(grid, mean, std)
            area = plot.varea(grid, np.zeros(grid.size), density, fill_color=color, fill_alpha=0.14)
            line = plot.line(grid, density, line_color=color, line_width=2.0 if text == "both" else 1.4)
            entries.append((text, [area, line]))
        plot.bare()
        plot.legend(entries)
        plot.xaxis.ticker.desired_num_ticks = 4
        plots.append(plot)
    return plots


def parabolas(reading: pd.DataFrame, names: Sequence[str] = (), units: Units | None = None) -> list[Any]:
    """Draw the criterion of prior, data and both over parameters: the chapter's figure 1.1.

    Parameters
    ----------
    reading : DataFrame
        As in ``reading.csv``.
    names : sequence of str
        Default: all that prior and data both speak of.
    units : mapping of str to str, optional
        Of the parameters.

    Raises
    ------
    InputError
        If there is no such parameter, or it has no standard deviation.
    """
    plots = []
    for name in list(names or parameters_with_prior_and_data(reading))[:MAX_PARAMETERS]:
        curves = parabolas_of(reading, name)
        plot = Panel(x=named(name, units), y="criterion", height=230)
        entries = []
        for part, text, color in (("prior", "prior", AMBER), ("data", "data alone", GREY), ("both", "both", BLUE)):
            if curves[part].notna().all():
                width = 2.0 if part == "both" else 1.4
                line = plot.line(curves["value"], curves[part], line_color=color, line_width=width)
                entries.append((text, [line]))
        plot.reach(y=(0.0, HEIGHT * float(curves["both"].max())))
        plot.legend(entries)
        plots.append(plot)
    return plots


def correlation(matrix: pd.DataFrame) -> Any:
    """Draw the correlation matrix of the estimates.

    Parameters
    ----------
    matrix : DataFrame
        Named alike in rows and columns; NaN where a parameter is not determined. The first `MAX_PARAMETERS` are drawn.
    """
    shown = matrix.iloc[:MAX_PARAMETERS, :MAX_PARAMETERS]
    names, values = [str(name) for name in shown.columns], shown.to_numpy(np.float64)
    count = len(names)
    across, down = np.meshgrid(np.arange(count), np.arange(count))
    flat = values.ravel()
    texts = ["?" if math.isnan(v) else "1" if v > 0.9995 else f"{v:+.2f}".replace("-", "−") for v in flat]
    source = ColumnDataSource(
        {
            "x": [names[i] for i in across.ravel()],
            "y": [names[i] for i in down.ravel()],
            "v": flat,
            "text": texts if count <= 12 else [""] * flat.size,
            "ink": [ON_STRONG if abs(v) > STRONG else ON_PALE for v in flat],
        }
    )
    tool = HoverTool(tooltips=[("", "@x, @y"), ("correlation", "@v{0.0000}")])
    plot = Panel(
        height=max(240, 60 + 34 * count),
        x_range=FactorRange(factors=names),
        y_range=FactorRange(factors=names[::-1]),
        tools=[tool],
    )
    colors = LinearColorMapper(palette=BLUE_RED, low=-1.0, high=1.0, nan_color="#bbbbbb")
    plot.rect("x", "y", 0.96, 0.96, source=source, fill_color=Field("v", colors), line_color=None)
    plot.text(
        "x",
        "y",
        "text",
        source=source,
        text_align="center",
        text_baseline="middle",
        text_color=Field("ink"),
        text_font=FONT,
        text_font_size="12px",
    )
    plot.ygrid.grid_line_color = None
    for axis in (plot.xaxis, plot.yaxis):
        axis.major_label_text_color, axis.major_label_text_font_size = INK, "12px"
        axis.axis_line_color = axis.major_tick_line_color = None
    if count > 6:
        plot.xaxis.major_label_orientation = 0.8
    return plot


def ellipses(result: Result, units: Units | None = None, level_: float = 0.95) -> list[Any]:
    """Draw the confidence ellipses of the pairs of estimates that are most correlated.

    Dashed lines are the intervals of each parameter by itself. (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) = χ²(2) with P the block of the
    local covariance, 2 F(2, ν) where noise variances are estimated.

    Parameters
    ----------
    result : Result
    units : mapping of str to str, optional
        Of the parameters.
    level_ : float
        Of the ellipses.
    """
    matrix, intervals = result.correlation.to_numpy(), result.intervals(level_)
    known = [i for i in range(len(result.names)) if math.isfinite(result.std[i]) and result.std[i] > 0]
    pairs = sorted(combinations(known, 2), key=lambda pair: -abs(matrix[pair]))[:MAX_ELLIPSES]
    plots = []
    for i, j in sorted(pairs):
        freedom = result.test_freedom([result.names[i], result.names[j]])
        radius = math.sqrt(region_rise(level_, freedom))
        x, y = ellipse(result.values[[i, j]], result.covariance[np.ix_([i, j], [i, j])], radius)
        plot = Panel(x=named(result.names[i], units), y=named(result.names[j], units), height=260)
        drawn = plot.line(x, y, line_color=BLUE, line_width=2)
        area = plot.patch(x, y, fill_color=BLUE, fill_alpha=0.12, line_color=None)
        for k, vertical in ((i, True), (j, False)):
            for end in intervals.iloc[k].tolist():
                plot.level(float(end), color=GREY, vertical=vertical, dash="dashed")
        dot = plot.scatter(
            [result.values[i]], [result.values[j]], size=8, fill_color=AMBER, line_color=INK, line_width=0.8
        )
        plot.hover(dot, ("estimate", "@x{0.000000}, @y{0.000000}"))
        plot.legend([(f"{100 * level_:g} % region, correlation {matrix[i, j]:+.2f}", [drawn, area])])
        plot.xaxis.ticker.desired_num_ticks = 4
        plots.append(plot)
    return plots


def ellipse(centre: Floats, covariance: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return the points at a distance of so many standard deviations, closed, abscissas and ordinates."""
    values, directions = np.linalg.eigh(covariance)  # which may be singular
    angles = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    root = directions * np.sqrt(np.maximum(values, 0.0))
    points = centre[:, None] + radius * root @ np.array([np.cos(angles), np.sin(angles)])
    return points[0], points[1]


def accuracy(estimates: pd.DataFrame) -> Any:
    """Draw what a finer simulation moves each estimate by, in its standard deviations.

    In the band no interval is spoilt: the shift is at most a tenth of a standard deviation.

    Parameters
    ----------
    estimates : DataFrame
        As in ``estimates.csv``; parameters whose shift is not known are left out.
    """
    known = estimates[np.isfinite(estimates["numerical_shift"].astype(float))].iloc[:MAX_PARAMETERS]
    names, shifts = [str(name) for name in known["parameter"]], known["numerical_shift"].to_numpy(np.float64)
    plot, _ = rows_of(names, "shift under the finer simulation (std of the estimate)", head=90)
    plot.shade(BLUE, 0.14, left=-SHIFT_LIMIT, right=SHIFT_LIMIT)
    plot.level(0.0, vertical=True)
    large, entries = np.abs(shifts) > SHIFT_LIMIT, []
    columns = {"name": np.array(names), "shift": shifts, "zero": np.zeros(len(names))}
    for mine, color, text in ((~large, BLUE, "harmless"), (large, RED, "larger than a tenth")):
        if not mine.any():
            continue
        part = ColumnDataSource({key: values[mine] for key, values in columns.items()})
        plot.segment("zero", "name", "shift", "name", source=part, line_color=color, line_width=2)
        dots = plot.scatter("shift", "name", source=part, size=8, fill_color=color, line_color=None)
        plot.hover(dots, ("parameter", "@name"), ("shift", "@shift{0.000000} std"))
        entries.append((text, [dots]))
    plot.legend(entries)
    most = max(1.5 * SHIFT_LIMIT, 1.15 * float(np.abs(shifts).max(initial=0.0)))
    plot.reach(x=(-most, most))
    return plot
