"""Uncertainty beyond the local covariance: profiles, samples of the posterior, maps of the criterion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from contourpy import LineType, contour_generator

from fmuid.array_types import Floats
from fmuid.data import evenly
from fmuid.identification import CONFIDENCE_LEVEL
from fmuid.reports.interactive.bokeh_spec import (
    BokehSpec,
    ColorBar,
    ColumnDataSource,
    Field,
    LogColorMapper,
    LogTicker,
    Range1d,
    grid,
)
from fmuid.reports.interactive.estimates import ellipse
from fmuid.reports.interactive.style import (
    AMBER,
    BLUE,
    FONT,
    GREY,
    INK,
    MAX_PARAMETERS,
    RED,
    WHITE,
    Panel,
    Units,
    named,
    normal,
)

if TYPE_CHECKING:
    from fmuid.estimation import Result
    from fmuid.identification import CostMap, Posterior

# Profiles are drawn up to so many times the rise at which the interval ends.
HEIGHT = 1.8
# More parameters than these make panels that nobody can read.
MAX_CORNER = 6
# Shares of the samples inside the contours, those of one and two standard deviations in one dimension.
SHARES = (0.68, 0.95)
BINS, SMOOTHING = 32, 1.2
"""Bins of a histogram of samples, and the width in bins of the Gaussian that smooths those of a pair."""
SHOWN_QUANTILES = (0.0005, 0.9995)
MAX_SAMPLES = 800
"""Samples drawn as dots behind the contours."""
# Below a hundredth of what the confidence region allows, the criterion is as good as at its minimum ...
FLOOR_SHARE = 0.01
# ... and what few points exceed looks all the same.
TOP_PERCENTILE = 98.0
# Optima closer to the estimate than this share of the map are the same; so many parameters that are held are named.
APART, MAX_HELD = 0.01, 4
PATHS = ("walker", "step", "counted")
"""Columns of ``walkers.csv`` besides the parameters."""
# Blues of ColorBrewer, red, green and blue, and so many colours between them.
BLUES = ((8, 48, 107), (8, 81, 156), (33, 113, 181), (66, 146, 198), (107, 174, 214), (158, 202, 225), (198, 219, 239), (222, 235, 247), (247, 251, 255))  # fmt: skip  # noqa: E501
SHADES = 129


# --- profiles


def profile(
    points: pd.DataFrame, ends: Mapping[str, float], estimate: tuple[float, float], text: str, degree: float
) -> Any:
    """Draw a profile: the rise of the criterion over a parameter, the others following; the local parabola beside it.

    The interval is the band, where the profile lies below the level's line.

    Parameters
    ----------
    points : DataFrame
        Columns ``value`` and ``criterion``, in the order of the values.
    ends : mapping
        ``lower`` and ``upper``, infinite or NaN where there is none, and ``threshold``, the rise at which it ends.
    estimate : (float, float)
        The estimate and its local standard deviation.
    text : str
        Label of the parameter.
    degree : float
        The level of the interval.
    """
    value, std = estimate
    places = points["value"].to_numpy(np.float64)
    rise = points["criterion"].to_numpy(np.float64) - float(points["criterion"].min())
    low, high = _window(places, (ends["lower"], ends["upper"]), value)
    threshold = ends["threshold"]
    plot = Panel(x=text, y="rise of the criterion", height=240)
    if not (math.isnan(ends["lower"]) or math.isnan(ends["upper"])):
        shade = {"left": max(ends["lower"], low), "right": min(ends["upper"], high)}
        plot.shade(BLUE, 0.12, **shade)
    border = [plot.line(np.array([low, high]), np.full(2, threshold), line_color=RED, line_width=1)]
    parabola = []
    if math.isfinite(std) and std > 0:
        grid = np.linspace(low, high, 161)
        parabola.append(plot.line(grid, ((grid - value) / std) ** 2, line_color=GREY, line_dash="dashed"))
    line = plot.line(*_curve(places, rise, value), line_color=BLUE, line_width=1.8)
    source = ColumnDataSource({"x": places, "y": rise})
    dots = plot.scatter("x", "y", source=source, size=5, fill_color=BLUE, line_color=None)
    plot.hover(dots, ("value", "@x{0.000000}"), ("rise", "@y{0.000}"))
    reached = f"{100 * degree:.4g} % level: a rise of {threshold:.3g}"
    plot.legend([("profile", [line, dots]), ("local parabola", parabola), (reached, border)])
    plot.reach(x=(low, high), y=(-0.04 * HEIGHT * threshold, HEIGHT * threshold))
    return plot


def _window(places: Floats, ends: tuple[float, float], value: float) -> tuple[float, float]:
    """Return the interval and some room; on a side without an end what was computed."""
    known = [abs(end - value) for end in ends if math.isfinite(end) and end != value]
    room = 0.35 * max(known) if known else 0.0
    low = ends[0] - room if math.isfinite(ends[0]) else float(places[0])
    high = ends[1] + room if math.isfinite(ends[1]) else float(places[-1])
    return (low, high) if low < high else (value - 1.0, value + 1.0)


def _curve(values: Floats, rise: Floats, centre: float) -> tuple[Floats, Floats]:
    """Return a smooth line through the points: the signed root of the rise is nearly straight."""
    if values.size < 2:
        return values, rise
    from scipy.interpolate import PchipInterpolator  # slow to import

    root = np.sign(values - centre) * np.sqrt(np.maximum(rise, 0.0))
    grid = np.unique(np.concatenate([np.linspace(values[0], values[-1], 161), values]))
    return grid, np.asarray(PchipInterpolator(values, root)(grid) ** 2)


# --- samples of the posterior


def corner(samples: pd.DataFrame, result: Result | None = None, units: Units | None = None) -> Any:
    """Draw the samples of every parameter and of every pair of them.

    Contours hold 68 % and 95 % of the samples; the dashed ellipses, at the same shares, and the curves on the diagonal
    are those of the local covariance. Ranges are linked.

    Parameters
    ----------
    samples : DataFrame
        A column a parameter, as in ``posterior.csv``; the first `MAX_CORNER` are drawn.
    result : Result, optional
        Whose local approximation is drawn.
    units : mapping of str to str, optional
    """
    names = [str(name) for name in samples.columns][:MAX_CORNER]
    values = samples[names].to_numpy(np.float64)
    ranges = [Range1d(*_range(values[:, i])) for i in range(len(names))]
    rows: list[list[Any]] = []
    for i, name in enumerate(names):
        row: list[Any] = [None] * len(names)
        for j in range(i + 1):
            bottom, left = i == len(names) - 1, j == 0 and i > 0
            x, y = (named(names[j], units) if bottom else ""), (named(name, units) if left else "")
            more: dict[str, Any] = {} if i == j else {"y_range": ranges[i]}
            plot = Panel(x=x, y=y, height=190 if bottom else 160, x_range=ranges[j], **more)
            plot.min_border_left = 52 if j == 0 else 12
            if i == j:
                _single(plot, values[:, i], result, name, ranges[i])
            else:
                _pair(plot, values[:, [j, i]], result, (names[j], name))
            plot.xaxis.visible = bottom
            plot.yaxis.visible = left
            plot.xaxis.ticker.desired_num_ticks, plot.yaxis.ticker.desired_num_ticks = 3, 4
            plot.xaxis.major_label_orientation = 0.6
            row[j] = plot
        rows.append(row)
    return grid(rows)


def _range(samples: Floats) -> tuple[float, float]:
    low, high = np.quantile(samples, SHOWN_QUANTILES)
    room = 0.04 * (high - low) or 0.05 * abs(low) or 1.0
    return float(low - room), float(high + room)


def _single(plot: Any, samples: Floats, result: Result | None, name: str, across: BokehSpec) -> None:
    edges = np.linspace(float(across.start), float(across.end), BINS + 1)
    density, _ = np.histogram(samples, bins=edges, density=True)
    plot.quad(edges[:-1], edges[1:], density, 0, fill_color=BLUE, fill_alpha=0.4, line_color=None)
    for end in np.quantile(samples, [0.025, 0.975]):
        plot.level(float(end), color=BLUE, vertical=True, dash="dashed")
    if result is not None and name in result.names:
        mean, std = result[name], float(result.std[result.names.index(name)])
        if math.isfinite(std) and std > 0:
            grid = np.linspace(edges[0], edges[-1], 121)
            plot.line(grid, normal(grid, mean, std), line_color=RED, line_width=1.3)
    plot.bare()


def _pair(plot: Any, samples: Floats, result: Result | None, names: tuple[str, str]) -> None:
    from scipy.ndimage import gaussian_filter  # slow to import

    some = samples[evenly(len(samples), MAX_SAMPLES)]
    plot.scatter(some[:, 0], some[:, 1], size=2, fill_color=BLUE, fill_alpha=0.35, line_color=None)
    sides = [(float(each.start), float(each.end)) for each in (plot.x_range, plot.y_range)]
    counts, first, second = np.histogram2d(samples[:, 0], samples[:, 1], bins=BINS, range=sides)
    smooth = gaussian_filter(counts.T, SMOOTHING)
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (first, second)]
    heights = share_levels(smooth)
    if len(heights) > 1:
        _contours(plot, middles, smooth, heights, line_color=BLUE, line_width=1.3)
    if result is None or not set(names) <= set(result.names):
        return
    where = [result.names.index(name) for name in names]
    block = result.covariance[np.ix_(where, where)]
    if np.isfinite(block).all():
        for share in SHARES:
            x, y = ellipse(result.values[where], block, math.sqrt(-2.0 * math.log(1.0 - share)))
            plot.line(x, y, line_color=RED, line_dash="dashed", line_width=1)


def _contours(plot: Any, sides: Sequence[Floats], heights: Floats, levels: Sequence[float], **look: Any) -> list[Any]:
    """Draw lines of equal height, one a level; where a height is NaN there is none."""
    found = contour_generator(sides[0], sides[1], np.ma.masked_invalid(heights), line_type=LineType.ChunkCombinedNan)
    parts: list[Any] = [found.lines(height)[0][0] for height in levels]
    return [plot.line(points[:, 0], points[:, 1], **look) for points in parts if points is not None]


def share_levels(counts: Floats) -> list[float]:
    """Return the heights above which the shares `SHARES` of all counts lie, the largest share first."""
    ordered = np.sort(counts.ravel())[::-1]
    total = np.cumsum(ordered)
    heights = [float(ordered[np.searchsorted(total, share * total[-1])]) for share in sorted(SHARES, reverse=True)]
    return [height for k, height in enumerate(heights) if k == 0 or height > heights[k - 1]]


# Of the paths of a sampling: more cannot be told apart.
MOST_WALKERS, MOST_STEPS = 24, 200


def paths(posterior: Posterior) -> pd.DataFrame:
    """Return the steps of some walkers, thinned: more cannot be told apart."""
    steps = evenly(len(posterior.chain), MOST_STEPS)
    some = posterior.chain[steps, :MOST_WALKERS].transpose(1, 0, 2)
    walker, step = np.meshgrid(np.arange(1, len(some) + 1), steps + 1, indexing="ij")
    first = {"walker": walker.ravel(), "step": step.ravel(), "counted": step.ravel() > posterior.burn}
    return pd.DataFrame(first | dict(zip(posterior.names, some.reshape(-1, some.shape[2]).T, strict=True)))


def walkers(paths: pd.DataFrame, units: Units | None = None) -> list[Any]:
    """Draw every walker's path, a figure a parameter; what lies in the grey part takes no part in the samples.

    Parameters
    ----------
    paths : DataFrame
        As `paths` returns them: ``walker``, ``step``, ``counted``, and a column a parameter.
    units : mapping of str to str, optional
        Of the parameters.
    """
    begins = np.flatnonzero(np.diff(paths["walker"].to_numpy(np.float64), prepend=-1.0))[1:]
    steps, early = paths["step"].to_numpy(np.float64), paths.loc[~paths["counted"], "step"]
    plots = []
    for name in paths.columns[len(PATHS) :][:MAX_PARAMETERS]:
        plot = Panel(x="step", y=named(str(name), units), height=150)
        values = np.insert(paths[name].to_numpy(np.float64), begins, np.nan)  # a gap between the lines
        plot.line(np.insert(steps, begins, np.nan), values, line_color=BLUE, line_width=0.7, line_alpha=0.35)
        if len(early):
            plot.shade(GREY, right=float(early.max()))
        plots.append(plot)
    return plots


# --- maps of the criterion


def criterion_map(chart: CostMap, units: Units | None = None, optima: pd.DataFrame | None = None) -> Any:
    """Draw by how much the criterion exceeds its minimum over two parameters, the estimate and its ellipse.

    The dashed line is where the section itself has risen by as much as the border of the confidence region allows:
    where it leaves the ellipse, the local covariance is not the whole truth. Without colour: the simulation
    failed.

    Parameters
    ----------
    chart : CostMap
    units : mapping of str to str, optional
        Of the parameters.
    optima : DataFrame, optional
        As in ``optima.csv``: those on the map are drawn; the other parameters have their own values there, so that the
        colours around them need not show a minimum.
    """
    first, second, values = chart.grid
    excess = values - np.nanmin(values, initial=chart.criterion)
    rise = chart.rise(CONFIDENCE_LEVEL)
    kinds: list[Any] = ["log" if each else "linear" for each in chart.logarithmic]
    plot = Panel(
        x=named(chart.names[0], units),
        y=named(chart.names[1], units),
        height=420,
        x_axis_type=kinds[0],
        y_axis_type=kinds[1],
    )
    known = excess[np.isfinite(excess) & (excess > 0)]
    low = max(FLOOR_SHARE * rise, float(known.min(initial=FLOOR_SHARE * rise)))
    high = max(float(np.percentile(known, TOP_PERCENTILE)) if known.size else 0.0, 2.0 * low)
    colors = LogColorMapper(palette=_blues(), low=low, high=high, nan_color=WHITE)
    shade = Field("v", colors)
    sides = ("left", "right", "top", "bottom")
    cells = plot.quad(*sides, source=_cells(chart, excess), fill_color=shade, line_color=shade)
    plot.hover(cells, ("point", "@x{0.000000}, @y{0.000000}"), ("above the minimum", "@v{0.000}"))
    section = []
    if np.nanmin(excess, initial=rise) < rise < np.nanmax(excess, initial=0.0):
        look: dict[str, Any] = {"line_color": RED, "line_dash": "dashed", "line_width": 1.6}
        section += _contours(plot, (first, second), excess.T, [rise], **look)
    border = chart.ellipse(CONFIDENCE_LEVEL)
    line = [plot.line(border[:, 0], border[:, 1], line_color=RED, line_width=1.8)] if len(border) else []
    dot = plot.scatter(*([each] for each in chart.estimate), size=9, fill_color=AMBER, line_color=INK)
    places = _others(chart, optima)
    more = [plot.scatter(*places.T, size=9, fill_color=WHITE, line_color=INK)] if len(places) else []
    held = "".join(f", {name} = {value:.4g}" for name, value in list(chart.held.items())[:MAX_HELD])
    texts = (
        f"{100 * CONFIDENCE_LEVEL:g} % ellipse",
        f"criterion raised by {rise:.3g}{held}",
        "estimate",
        "other optima found",
    )
    plot.legend(list(zip(texts, (line, section, [dot], more), strict=True)))
    bar = ColorBar(
        color_mapper=colors, ticker=LogTicker(desired_num_ticks=6), width=12, title="criterion above its minimum"
    )
    bar.background_fill_color, bar.major_label_text_color, bar.title_text_color = WHITE, GREY, INK
    bar.major_label_text_font = bar.title_text_font = FONT
    bar.title_text_font_style = "normal"
    plot.add_layout(bar, "right")
    plot.reach(x=_ends(first, logarithmic=chart.logarithmic[0]), y=_ends(second, logarithmic=chart.logarithmic[1]))
    return plot


def _others(chart: CostMap, optima: pd.DataFrame | None) -> Floats:
    """Return the optima on the map (n, 2) that are not the estimate."""
    if optima is None:
        return np.empty((0, 2))
    (low, *_, high), (bottom, *_, top), _ = chart.grid
    places = optima[list(chart.names)].to_numpy(np.float64)
    inside = ((places >= (low, bottom)) & (places <= (high, top))).all(axis=1)
    apart = (np.abs(places - chart.estimate) > APART * np.array([high - low, top - bottom])).any(axis=1)
    return np.asarray(places[inside & apart])


def _blues() -> list[str]:
    """Return colours from dark to light."""
    places = np.linspace(0, len(BLUES) - 1, SHADES)
    channels = [np.interp(places, range(len(BLUES)), each).round().astype(int) for each in zip(*BLUES, strict=True)]
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in zip(*channels, strict=True)]


def _cells(chart: CostMap, excess: Floats) -> BokehSpec:
    first, second, _ = chart.grid
    x, y = (_edges(each, logarithmic=log) for each, log in zip((first, second), chart.logarithmic, strict=True))
    shape = excess.shape
    columns = {
        "left": np.broadcast_to(x[:-1, None], shape),
        "right": np.broadcast_to(x[1:, None], shape),
        "bottom": np.broadcast_to(y[None, :-1], shape),
        "top": np.broadcast_to(y[None, 1:], shape),
        "x": np.broadcast_to(first[:, None], shape),
        "y": np.broadcast_to(second[None, :], shape),
    }
    floor = np.where(np.isnan(excess), np.nan, np.maximum(excess, 1e-300))
    return ColumnDataSource({key: values.ravel() for key, values in columns.items()} | {"v": floor.ravel()})


def _edges(middles: Floats, *, logarithmic: bool) -> Floats:
    at = np.log(middles) if logarithmic else middles
    inner = 0.5 * (at[1:] + at[:-1])
    edges = np.concatenate([[1.5 * at[0] - 0.5 * at[1]], inner, [1.5 * at[-1] - 0.5 * at[-2]]])
    return np.exp(edges) if logarithmic else edges


def _ends(middles: Floats, *, logarithmic: bool) -> tuple[float, float]:
    edges = _edges(middles, logarithmic=logarithmic)
    return float(edges[0]), float(edges[-1])
