"""Charts as Bokeh models. Names from studies never enter formats, columns or HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmuid.reports.chart import Axis, Chart, ChartGrid, Figure, Layer, Shades, beside, row_below, wrapped
from fmuid.reports.render.bokeh_models import BokehSpec, Field, Value
from fmuid.reports.render.style import BAR, BAR_BELOW, COLORS, FONT, LINE, MISSING, NAME_SIZE, palette

# Glyphs that are one shape: their looks are plain values; those of others may be columns.
_ONE_SHAPE = ("Line", "Step", "VArea", "Patch")
# What begins mathematics in a text of Bokeh, for which it would ask a host.
_TEX = ("$$", "\\(", "\\[")
_KINDS = {"linear": "Linear", "log": "Log", "names": "Categorical"}
_GLYPHS = {
    "line": ("Line", "x y"),
    "step": ("Step", "x y"),
    "patch": ("Patch", "x y"),
    "points": ("Scatter", "x y size angle"),
    "text": ("Text", "x y text"),
    "band": ("VArea", "x y0>y1 y1>y2"),
    "segments": ("Segment", "x0 y0 x1 y1"),
    "cells": ("Quad", "left right top bottom"),
    "bars": ("HBar", "y x>right x0>left"),
}


@dataclass(frozen=True, eq=False)
class DrawnCharts:
    """Figures and their data sources."""

    figures: tuple[BokehSpec, ...]
    sources: tuple[tuple[Any, Mapping[str, tuple[int, str]]], ...]

    def refill(self, figures: Sequence[Figure], before: Sequence[Figure]) -> None:
        """Replace the data of the figures `before` by that of figures alike."""
        new, old = list(_layers(figures)), list(_layers(before))
        for source, columns in self.sources:
            if any(new[k].data[key] is not old[k].data[key] for k, key in columns.values()):
                source.data = {name: _column(new[k].data[key]) for name, (k, key) in columns.items()}


def drawing(
    figures: Sequence[Figure],
    ranges: Mapping[str, Any] | None = None,
    source: Callable[[dict[str, Any]], Any] = lambda data: BokehSpec("ColumnDataSource", data=data),
) -> DrawnCharts:
    """Return figures as sketches."""
    layers = list(_layers(figures))
    pools: dict[int, dict[str, tuple[int, str]]] = {}
    places: dict[int, tuple[int, dict[str, str]]] = {}
    for k, layer in enumerate(layers):
        arrays = {key: each for key, each in layer.data.items() if not isinstance(each, float | int)}
        if not arrays:
            continue
        group = id(next(iter(arrays.values())))
        pool = pools.setdefault(group, {})
        known = {id(layers[n].data[key]): name for name, (n, key) in pool.items()}
        names = {}
        for key, each in arrays.items():
            names[key] = known.setdefault(id(each), f"c{len(pool)}")
            pool.setdefault(names[key], (k, key))
        places[id(layer)] = group, names
    sources = {
        group: source({name: _column(layers[k].data[key]) for name, (k, key) in pool.items()})
        for group, pool in pools.items()
    }
    linked: dict[str, Any] = dict(ranges or {})
    drawn = tuple(_figure(each, linked, places, sources) for each in figures)
    return DrawnCharts(drawn, tuple((sources[group], pools[group]) for group in pools))


def _layers(figures: Sequence[Figure]) -> Iterator[Layer]:
    for figure in figures:
        for chart in figure.charts if isinstance(figure, ChartGrid) else (figure,):
            yield from chart.layers


def _column(values: Any) -> Any:
    return list(values) if isinstance(values, tuple) else values


def _figure(figure: Figure, linked: dict[str, Any], places: Mapping[int, Any], sources: Mapping[int, Any]) -> BokehSpec:
    if isinstance(figure, Chart):
        return _Plot(figure, linked, places, sources).sketch
    crosses: dict[str, BokehSpec] = {}
    children = []
    for i, row in enumerate(figure.rows):
        for j, chart in enumerate(row):
            if chart is not None:
                plot = _Plot(chart, linked, places, sources)
                plot.compact(crosses)
                children.append((plot.sketch, i, j))
    return _grid(children)


def _grid(children: list[tuple[BokehSpec, int, int]]) -> BokehSpec:
    """Return plots in rows and columns with one toolbar."""
    kinds: dict[str, list[BokehSpec]] = {}
    for plot, _, _ in children:
        plot.toolbar_location = None
        for tool in plot.toolbar.tools:
            kinds.setdefault(f"{tool.kind} {vars(tool).get('tooltips')}", []).append(tool)
    # one disk saves all plots; of other tools, one switch stands for all of theirs
    tools = [
        BokehSpec("SaveTool") if each[0].kind == "SaveTool" else BokehSpec("ToolProxy", tools=each)
        for each in kinds.values()
    ]
    first = next((tool for tool in tools if tool.kind == "ToolProxy" and tool.tools[0].kind == "BoxZoomTool"), None)
    bar = BokehSpec("Toolbar", tools=tools, logo=None, autohide=True, active_drag=first)
    return BokehSpec("GridPlot", children=children, toolbar=bar, toolbar_location="right", sizing_mode="stretch_width")


class _Plot:
    """A chart as a plot with two axes and their grids."""

    def __init__(
        self, chart: Chart, linked: dict[str, Any], places: Mapping[int, Any], sources: Mapping[int, Any]
    ) -> None:
        self.chart, self._places, self._sources = chart, places, sources
        ranges = [self._range(axis, linked) for axis in (chart.x, chart.y)]
        kinds = [_KINDS[axis.kind] for axis in (chart.x, chart.y)]
        self.xaxis, self.yaxis = (
            self._axis(axis, kind, vertical=k == 1)
            for k, (axis, kind) in enumerate(zip((chart.x, chart.y), kinds, strict=True))
        )
        lines = (chart.x.grid is True, chart.y.grid is not False and chart.y.shown)
        grids = [
            BokehSpec("Grid", axis=axis, dimension=k, grid_line_color=COLORS["faint"] if line else None)
            for k, (axis, line) in enumerate(zip((self.xaxis, self.yaxis), lines, strict=True))
        ]
        zoom = BokehSpec("BoxZoomTool", **({"dimensions": "width"} if any(each.above for each in chart.layers) else {}))
        self.tools = [zoom, BokehSpec("ResetTool"), BokehSpec("SaveTool")]
        self.renderers: list[BokehSpec] = []
        self.center, self.above, self.right = grids, list[BokehSpec](), list[BokehSpec]()
        entries: dict[str, list[BokehSpec]] = {}
        for layer in chart.layers:
            drawn = self._layer(layer)
            if layer.label and drawn is not None:
                entries.setdefault(layer.label, []).append(drawn)
        self._legend(entries)
        names_above = chart.y.kind == "names" and not beside(chart.y.names)
        if names_above:
            self.yaxis.visible = False
            self.center.append(self._names(chart.y.names))
        self.sketch = BokehSpec(
            "Plot",
            height=chart.whole_height,
            x_range=ranges[0],
            y_range=ranges[1],
            x_scale=BokehSpec(f"{kinds[0]}Scale"),
            y_scale=BokehSpec(f"{kinds[1]}Scale"),
            below=[self.xaxis],
            left=[self.yaxis],
            center=self.center,
            above=self.above,
            right=self.right,
            renderers=self.renderers,
            sizing_mode="stretch_width",
            toolbar_location="right",
            toolbar=BokehSpec("Toolbar", tools=self.tools, logo=None, autohide=True, active_drag=zoom),
            min_border_left=12 if names_above else 58,
            min_border_right=10,
            outline_line_color=None,  # that of the page, as the colors behind
            background_fill_color=None,
            border_fill_color=None,
            **({"lod_threshold": None} if chart.crosshair else {}),
        )

    def compact(self, crosses: dict[str, BokehSpec]) -> None:
        """Reduce margins in a grid, and share the crosshair."""
        if self.chart.crosshair:
            vars(self.sketch).update(min_border_top=4, min_border_bottom=4)
            self.xaxis.ticker.desired_num_ticks = 8
            look = {"dimension": "height", "line_dash": "dotted", "line_color": COLORS["grey"]}
            cross = crosses.setdefault(self.chart.x.linked, BokehSpec("Span", **look))
            self.tools.append(BokehSpec("CrosshairTool", overlay=cross))
        elif not self.chart.y.shown:
            vars(self.sketch)["min_border_left"] = 12

    # --- axes

    def _range(self, axis: Axis, linked: dict[str, Any]) -> Any:
        if axis.linked and axis.linked in linked:
            return linked[axis.linked]
        low, high = axis.reach
        more = {} if not self.chart.crosshair or axis is self.chart.y else {"bounds": "auto"}
        if axis.kind == "names":
            found = BokehSpec("FactorRange", factors=list(axis.names))
        elif low is not None and high is not None:
            found = BokehSpec("Range1d", start=float(low), end=float(high), **more)
        else:
            found = BokehSpec("DataRange1d", **({} if low is None else {"start": low}))
        if axis.linked:
            linked[axis.linked] = found
        return found

    def _axis(self, axis: Axis, kind: str, *, vertical: bool) -> BokehSpec:
        ticker = BokehSpec(f"{kind.replace('Linear', 'Basic')}Ticker")
        ticks = axis.ticks or (6 if axis.whole else 0 if vertical else 5)
        if axis.kind != "names":
            vars(ticker).update({"desired_num_ticks": ticks} if ticks else {})
            vars(ticker).update({"min_interval": 1} if axis.whole else {})
        text = axis.label if vertical else wrapped(axis.label)
        found = BokehSpec(
            f"{kind}Axis",
            ticker=ticker,
            axis_label=BokehSpec("PlainText", text=text) if any(mark in text for mark in _TEX) else text,
            axis_line_color=LINE if axis.grid is not False else None,
            major_tick_line_color=LINE if axis.grid is not False else None,
            minor_tick_line_color=None,
            major_tick_in=0,
            major_tick_out=4,
            major_label_text_font=FONT,
            axis_label_text_font=FONT,
            major_label_text_font_size=NAME_SIZE if axis.grid is not False else "12px",
            axis_label_text_font_size="12px",
            major_label_text_color=COLORS["ink" if axis.kind == "names" else "grey"],
            axis_label_text_color=COLORS["ink"],
            axis_label_text_font_style="normal",
        )
        vars(found).update({} if axis.shown else {"visible": False})
        vars(found).update({"major_label_orientation": axis.turned} if axis.turned else {})
        return found

    def _names(self, names: Sequence[str]) -> BokehSpec:
        """Return the names of rows above them."""
        data = {"name": list(names), "text": [wrapped(name) for name in names]}
        return BokehSpec(
            "LabelSet",
            source=BokehSpec("ColumnDataSource", data=data),
            x=Value(0),
            x_units="screen",
            y=Field("name"),
            y_offset=Value(0.5 * BAR_BELOW * row_below(names) + 2),
            text=Field("text"),
            text_baseline=Value("bottom"),
            text_color=Value(COLORS["ink"]),
            text_font=Value(FONT),
            text_font_size=Value(NAME_SIZE),
        )

    def _legend(self, entries: Mapping[str, list[BokehSpec]]) -> None:
        items = [BokehSpec("LegendItem", label=Value(text), renderers=drawn) for text, drawn in entries.items()]
        if not items:
            return
        long = self.chart.legend_lines > 1
        self.above.append(
            BokehSpec(
                "Legend",
                items=items,
                orientation="vertical" if long else "horizontal",
                label_text_font=FONT,
                label_text_font_size="11px",
                label_text_color=COLORS["ink"],
                background_fill_color=None,
                border_line_color=None,
                click_policy="hide",
                padding=0,
                margin=2,
                spacing=2 if long else 12,
                glyph_width=16,
                glyph_height=12,
                inactive_fill_color=COLORS["white"],
            )
        )

    # --- layers

    def _layer(self, layer: Layer) -> BokehSpec | None:
        if layer.mark in ("rule", "zone"):
            self.center += _annotations(layer)
            return None
        group, names = self._places[id(layer)]
        kind, coordinates = _GLYPHS[layer.mark]
        if layer.mark == "cells" and "left" not in layer.data:
            kind, coordinates = "Rect", "x y"
        told: dict[str, Any] = {"width": Value(0.96), "height": Value(0.96)} if kind == "Rect" else {}
        for pair in coordinates.split():
            key, _, name = pair.partition(">")
            if key in names:
                told[name or key] = Field(names[key])
            elif key in layer.data:
                told[name or key] = Value(layer.data[key])
        if layer.mark == "bars":
            told.setdefault("left", Value(0.0))
            told["height"] = Value(BAR if beside(self.chart.y.names) else BAR_BELOW)
        for name, look in self._looks(layer, names).items():
            told[name] = look if kind in _ONE_SHAPE or isinstance(look, Field) else Value(look)
        above = {"level": "overlay"} if layer.above else {}
        drawn = BokehSpec("GlyphRenderer", data_source=self._sources[group], glyph=BokehSpec(kind, **told), **above)
        self.renderers.append(drawn)
        if layer.hover:
            lines = [(word, re.sub(r"@(\w+)", lambda found: f"@{names[found[1]]}", text)) for word, text in layer.hover]
            mode = {"mode": "vline", "line_policy": "nearest", "point_policy": "snap_to_data"}
            across = mode if self.chart.crosshair else {}
            self.tools.append(BokehSpec("HoverTool", renderers=[drawn], tooltips=lines, **across))
        if layer.above and layer.label:  # Bokeh empties the legend of what is painted on the overlay
            nothing = BokehSpec("ColumnDataSource", data={"x": np.array([np.nan]), "y": np.array([np.nan])})
            own = BokehSpec(kind, **(told | {"x": Field("x"), "y": Field("y")}))
            drawn = BokehSpec("GlyphRenderer", data_source=nothing, glyph=own)
            self.renderers.append(drawn)
        return drawn

    def _looks(self, layer: Layer, names: Mapping[str, str]) -> dict[str, Any]:
        color = COLORS[layer.color]
        edge = None if layer.edge is None else COLORS[layer.edge]
        alpha = Field(names["alpha"]) if "alpha" in names else layer.alpha
        match layer.mark:
            case "line" | "step" | "segments":
                found = {"line_color": color, "line_width": layer.width}
                found |= {"line_dash": layer.dash} if layer.dash != "solid" else {}
                found |= {"line_alpha": alpha} if layer.alpha != 1 else {}
                return found | ({"mode": "after"} if layer.mark == "step" else {})
            case "points" if layer.marker != "circle":
                size = {} if "size" in layer.data else {"size": layer.size}
                turned = {"angle": math.pi / 2} if layer.marker == "bar" else {}
                marker = "dash" if layer.marker == "bar" else layer.marker
                return size | turned | {"marker": marker, "line_color": color, "line_width": layer.width}
            case "points":
                size = {} if "size" in layer.data else {"size": layer.size}
                return size | {"fill_color": color, "fill_alpha": alpha, "line_color": edge, "line_width": 0.8}
            case "text":
                ink = Field(names["ink"]) if "ink" in names else color
                font = {"text_font": FONT, "text_font_size": "12px", "text_color": ink}
                return font | {"text_align": "center", "text_baseline": "middle"}
            case _ if layer.shades is not None:
                shade = Field(names["value"], self._shades(layer.shades))
                return {"fill_color": shade, "line_color": shade if layer.shades.title else None}
        return {"fill_color": color, "fill_alpha": alpha, **({} if layer.mark == "band" else {"line_color": edge})}

    def _shades(self, shades: Shades) -> BokehSpec:
        kind = "LogColorMapper" if shades.log else "LinearColorMapper"
        missing = COLORS["white"] if shades.title else MISSING
        found = BokehSpec(kind, palette=palette(shades.palette), low=shades.low, high=shades.high, nan_color=missing)
        if shades.title:
            bar = BokehSpec(
                "ColorBar",
                color_mapper=found,
                ticker=BokehSpec("LogTicker", desired_num_ticks=6),
                width=12,
                title=shades.title,
                background_fill_color=COLORS["white"],
                major_label_text_color=COLORS["grey"],
                title_text_color=COLORS["ink"],
                major_label_text_font=FONT,
                title_text_font=FONT,
                title_text_font_style="normal",
            )
            self.right.append(bar)
        return found


def _annotations(layer: Layer) -> list[BokehSpec]:
    color = COLORS[layer.color]
    columns = {side: np.atleast_1d(np.asarray(each, np.float64)).tolist() for side, each in layer.data.items()}
    if layer.mark == "zone":
        look = {"fill_color": color, "fill_alpha": layer.alpha, "line_color": None}
        rows = zip(*columns.values(), strict=True)
        return [BokehSpec("BoxAnnotation", **dict(zip(columns, row, strict=True)), **look) for row in rows]
    look = {"line_color": color, "line_width": 1, "line_dash": layer.dash}
    return [
        BokehSpec("Span", dimension="height" if side == "x" else "width", location=place, **look)
        for side, places in columns.items()
        for place in places
    ]
