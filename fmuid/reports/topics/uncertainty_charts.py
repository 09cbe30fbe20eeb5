"""Charts of uncertainty: profiles, cost maps, samples of the posterior."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import evenly
from fmuid.estimation import Result
from fmuid.identification import CONFIDENCE_LEVEL, Assessment, CostMap, Posterior, Profile, ellipse
from fmuid.reports.chart import DENSITY, LIMITS, Axis, Chart, ChartGrid, Data, Layer, Shades, Units, named, normal
from fmuid.reports.document import Section

PROFILES = "Where the curve leaves the dashed parabola, ± σ is not enough: use the interval, the band."
MAPS = "The darker, the better the fit. Where the dashed line leaves the ellipse, the local covariance is not enough."
POSTERIOR = "Contours contain 68 % and 95 % of the samples; red is the local approximation."
WALKERS = (
    "One line per walker; the grey part, burn-in, is left out. Paths that drift together, or walkers that do not move, "
    "mean no convergence."
)
HEIGHT = 1.8  # profiles are drawn up to so many times the rise at which the interval ends
SHARES = (0.95, 0.68)
"""Shares of the samples inside the contours, those of two and one standard deviations in one dimension."""
BINS = 32  # bins of a histogram of samples


def uncertainty_sections(found: Assessment, result: Result, units: Units, optima: pd.DataFrame) -> list[Section]:
    """Return profiles, maps and samples."""
    known = [each for each in found.profiles if not math.isnan(each.threshold) and len(each.table)][: LIMITS.parameters]
    profiles = tuple(_profile(each, result, units) for each in known)
    maps = tuple(_map(chart, units, optima) for chart in found.maps)
    sections = [
        Section("profiles", "Profiles", PROFILES, charts=profiles, beside=2),
        Section("maps", "Cost over two parameters", MAPS, charts=maps, beside=2),
    ]
    if found.posterior is not None:
        corner, paths = _corner(found.posterior.table, result, units), tuple(_walkers(found.posterior, units))
        sections.append(Section("posterior", "Posterior samples", POSTERIOR, charts=(corner,), beside=1))
        sections.append(Section("walkers", "Paths of the walkers", WALKERS, charts=paths, beside=1))
    return sections


def _profile(found: Profile, result: Result, units: Units) -> Chart:
    i = result.names.index(found.name)
    value, std, threshold = float(result.values[i]), float(result.std[i]), found.threshold
    places, cost = found.table[found.name].to_numpy(np.float64), found.table["cost"].to_numpy(np.float64)
    low, high = _window(places, (found.lower, found.upper), value)
    x, y = _curve(places, cost - cost.min(), value)
    hover = (("value", "@x{0.000000}"), ("rise", "@y{0.000}"))
    ends: Data = {"left": max(found.lower, low), "right": min(found.upper, high)}
    layers = [] if math.isnan(found.lower) or math.isnan(found.upper) else [Layer("zone", ends, alpha=0.12)]
    layers.append(Layer("line", {"x": x, "y": y}, label="profile"))
    layers.append(Layer("points", {"x": places, "y": cost - cost.min()}, size=5, label="profile", hover=hover))
    if math.isfinite(std) and std > 0:
        grid = np.linspace(low, high, 161)
        parabola: Data = {"x": grid, "y": ((grid - value) / std) ** 2}
        layers.append(Layer("line", parabola, "grey", width=1, dash="dashed", label="local parabola"))
    reached = f"{100 * found.level:.4g} % level: cost + {threshold:.3g}"
    border: Data = {"x": np.array([low, high]), "y": np.full(2, threshold)}
    layers.append(Layer("line", border, "red", width=1, label=reached))
    y_axis = Axis("cost above its minimum", reach=(-0.04 * HEIGHT * threshold, HEIGHT * threshold))
    return Chart(Axis(named(found.name, units), reach=(low, high)), y_axis, tuple(layers), 240)


def _window(places: Floats, ends: tuple[float, float], value: float) -> tuple[float, float]:
    known = [abs(end - value) for end in ends if math.isfinite(end) and end != value]
    room = 0.35 * max(known) if known else 0.0
    low = ends[0] - room if math.isfinite(ends[0]) else float(places[0])
    high = ends[1] + room if math.isfinite(ends[1]) else float(places[-1])
    return (low, high) if low < high else (value - 1.0, value + 1.0)


def _curve(values: Floats, rise: Floats, centre: float) -> tuple[Floats, Floats]:
    """Return a smooth line: the signed root of the rise is nearly straight."""
    if values.size < 2:
        return values, rise
    from scipy.interpolate import PchipInterpolator  # slow to import

    root = np.sign(values - centre) * np.sqrt(np.maximum(rise, 0.0))
    grid = np.unique(np.concatenate([np.linspace(values[0], values[-1], 161), values]))
    return grid, np.asarray(PchipInterpolator(values, root)(grid) ** 2)


def _corner(samples: pd.DataFrame, result: Result, units: Units) -> ChartGrid:
    """Return histograms and pairs of the samples; ellipses are those of the covariance."""
    names = [str(name) for name in samples.columns][:6]
    values, last = samples[names].to_numpy(np.float64), len(names) - 1
    ranges = [_range(values[:, i]) for i in range(len(names))]

    def axis(i: int, **look: Any) -> Axis:
        return Axis(named(names[i], units), reach=ranges[i], linked=f"posterior {i}", **look)

    def chart(i: int, j: int) -> Chart:
        x, height = axis(j, shown=i == last, ticks=3, turned=0.6), 190 if i == last else 160
        if i == j:
            return Chart(x, DENSITY, tuple(_single(values[:, i], result, names[i], ranges[i])), height)
        layers = _pair(values[:, [j, i]], result, (names[j], names[i]), (ranges[j], ranges[i]))
        return Chart(x, axis(i, shown=j == 0, ticks=4, grid=True), tuple(layers), height)

    every = range(len(names))
    return ChartGrid(tuple(tuple(chart(i, j) if j <= i else None for j in every) for i in every))


def _range(samples: Floats) -> tuple[float, float]:
    low, high = np.quantile(samples, (0.0005, 0.9995))
    room = 0.04 * (high - low) or 0.05 * abs(low) or 1.0
    return float(low - room), float(high + room)


def _single(samples: Floats, result: Result, name: str, across: tuple[float, float]) -> list[Layer]:
    edges = np.linspace(*across, BINS + 1)
    density, _ = np.histogram(samples, bins=edges, density=True)
    boxes: Data = {"left": edges[:-1], "right": edges[1:], "bottom": 0.0, "top": density}
    layers = [
        Layer("cells", boxes, alpha=0.4),
        Layer("rule", {"x": np.quantile(samples, [0.025, 0.975])}, dash="dashed"),
    ]
    if name in result.names:
        mean, std = float(result[name]), float(result.std[result.names.index(name)])
        if math.isfinite(std) and std > 0:
            grid = np.linspace(edges[0], edges[-1], 121)
            layers.append(Layer("line", {"x": grid, "y": normal(grid, mean, std)}, "red", width=1.3))
    return layers


def _pair(
    samples: Floats, result: Result, names: tuple[str, str], sides: tuple[tuple[float, float], tuple[float, float]]
) -> list[Layer]:
    from scipy.ndimage import gaussian_filter  # slow to import

    some = samples[evenly(len(samples), 800)]
    layers = [Layer("points", {"x": some[:, 0], "y": some[:, 1]}, size=2, alpha=0.35)]
    counts, first, second = np.histogram2d(samples[:, 0], samples[:, 1], bins=BINS, range=sides)
    smooth = gaussian_filter(counts.T, 1.2)  # width in bins
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (first, second)]
    heights = share_levels(smooth)
    if len(heights) > 1:
        layers += [Layer("line", each, width=1.3) for each in _contours(middles, smooth, heights)]
    if not set(names) <= set(result.names):
        return layers
    where = [result.names.index(name) for name in names]
    block = result.covariance[np.ix_(where, where)]
    if np.isfinite(block).all():
        for share in SHARES:
            x, y = ellipse(result.values[where], block, math.sqrt(-2.0 * math.log(1.0 - share))).T
            layers.append(Layer("line", {"x": x, "y": y}, "red", dash="dashed", width=1))
    return layers


def _contours(sides: Sequence[Floats], heights: Floats, levels: Sequence[float]) -> list[dict[str, Floats]]:
    from contourpy import LineType, contour_generator  # slow to import

    found = contour_generator(sides[0], sides[1], np.ma.masked_invalid(heights), line_type=LineType.ChunkCombinedNan)
    parts: list[Any] = [found.lines(height)[0][0] for height in levels]
    return [{"x": points[:, 0].copy(), "y": points[:, 1].copy()} for points in parts if points is not None]


def share_levels(counts: Floats) -> list[float]:
    """Return the heights that contain `SHARES` of all counts."""
    ordered = np.sort(counts.ravel())[::-1]
    total = np.cumsum(ordered)
    heights = [float(ordered[np.searchsorted(total, share * total[-1])]) for share in SHARES]
    return [height for k, height in enumerate(heights) if k == 0 or height > heights[k - 1]]


def _walkers(posterior: Posterior, units: Units) -> Iterator[Chart]:
    steps = evenly(len(posterior.chain), 200)
    paths = posterior.chain[steps, :24]  # (steps, walkers, parameters)
    gap = np.full((1, paths.shape[1]), np.nan)  # between the lines
    across = np.vstack([np.repeat((steps + 1.0)[:, None], paths.shape[1], axis=1), gap]).T.ravel()
    early = steps[steps + 1 <= posterior.burn] + 1
    grey = [Layer("zone", {"right": float(early.max())}, "grey", alpha=0.18)] if early.size else []
    for k, name in enumerate(posterior.names[: LIMITS.parameters]):
        values = np.vstack([paths[:, :, k], gap]).T.ravel()
        line = Layer("line", {"x": across, "y": values}, width=0.7, alpha=0.35)
        yield Chart(Axis("step"), Axis(named(name, units)), (line, *grey), 150)


def _map(chart: CostMap, units: Units, optima: pd.DataFrame) -> Chart:
    """Return the cost over two parameters, and the local ellipse."""
    first, second, values = chart.grid
    excess, rise = values - np.nanmin(values, initial=chart.cost), chart.rise(CONFIDENCE_LEVEL)
    known = excess[np.isfinite(excess) & (excess > 0)]
    low = max(0.01 * rise, float(known.min(initial=0.01 * rise)))
    high = max(float(np.percentile(known, 98.0)) if known.size else 0.0, 2.0 * low)
    shades = Shades("blues", low, high, log=True, title="cost above its minimum")
    hover = (("point", "@x{0.000000}, @y{0.000000}"), ("above the minimum", "@value{0.000}"))
    edges = [_edges(each, logarithmic=log) for each, log in zip((first, second), chart.logarithmic, strict=True)]
    layers = [Layer("cells", _cells(first, second, edges, excess), shades=shades, hover=hover)]
    border = chart.ellipse(CONFIDENCE_LEVEL)
    if len(border):
        text = f"{100 * CONFIDENCE_LEVEL:g} % ellipse"
        layers.append(Layer("line", {"x": border[:, 0], "y": border[:, 1]}, "red", label=text))
    if np.nanmin(excess, initial=rise) < rise < np.nanmax(excess, initial=0.0):
        held = "".join(f", {name} = {value:.4g}" for name, value in list(chart.held.items())[:4])
        look: dict[str, Any] = {"dash": "dashed", "width": 1.6, "label": f"cost + {rise:.3g}{held}"}
        layers += [Layer("line", each, "red", **look) for each in _contours((first, second), excess.T, [rise])]
    estimate: Data = {"x": chart.estimate[:1], "y": chart.estimate[1:]}
    layers.append(Layer("points", estimate, "amber", size=9, edge="ink", label="estimate"))
    if len(places := _others(chart, optima)):
        more: Data = {"x": places[:, 0], "y": places[:, 1]}
        layers.append(Layer("points", more, "white", size=9, edge="ink", label="other optima"))
    x, y = (
        Axis(named(name, units), "log" if log else "linear", reach=(float(ends[0]), float(ends[-1])))
        for name, log, ends in zip(chart.names, chart.logarithmic, edges, strict=True)
    )
    return Chart(x, y, tuple(layers), 420)


def _others(chart: CostMap, optima: pd.DataFrame) -> Floats:
    if not len(optima):
        return np.empty((0, 2))
    (low, *_, high), (bottom, *_, top), _ = chart.grid
    places = optima[list(chart.names)].to_numpy(np.float64)
    inside = ((places >= (low, bottom)) & (places <= (high, top))).all(axis=1)
    apart = (np.abs(places - chart.estimate) > 0.01 * np.array([high - low, top - bottom])).any(axis=1)
    return np.asarray(places[inside & apart])


def _cells(first: Floats, second: Floats, edges: Sequence[Floats], excess: Floats) -> Data:
    count, rows = excess.shape
    columns: Data = {
        "left": np.repeat(edges[0][:-1], rows),
        "right": np.repeat(edges[0][1:], rows),
        "bottom": np.tile(edges[1][:-1], count),
        "top": np.tile(edges[1][1:], count),
        "x": np.repeat(first, rows),
        "y": np.tile(second, count),
    }
    floor = np.where(np.isnan(excess), np.nan, np.maximum(excess, 1e-300))
    return {**columns, "value": floor.ravel()}


def _edges(middles: Floats, *, logarithmic: bool) -> Floats:
    at = np.log(middles) if logarithmic else middles
    inner = 0.5 * (at[1:] + at[:-1])
    edges = np.concatenate([[1.5 * at[0] - 0.5 * at[1]], inner, [1.5 * at[-1] - 0.5 * at[-2]]])
    return np.exp(edges) if logarithmic else edges
