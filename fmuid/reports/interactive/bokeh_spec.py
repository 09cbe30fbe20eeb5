"""Figures as data: what Bokeh's library in a browser is told, without Bokeh's own models.

Those check, default and observe every property, as a server needs it; a page that is only written would pay seconds
for that. Here a model is its name and what is set of it: `written` turns figures into the JSON that the library reads,
`live` into Bokeh's models, which know and check all names. What a server changes while somebody looks, such as a
source or a range, may be Bokeh's own model from the beginning: `live` leaves it as it is.
"""

from __future__ import annotations

import base64
import gzip
import itertools
import math
from collections.abc import Sequence
from functools import partial, partialmethod
from typing import Any

import numpy as np
import pandas as pd

from fmuid.reports.render.bokeh_models import BokehSpec as BokehSpec
from fmuid.reports.render.bokeh_models import Field as Field
from fmuid.reports.render.bokeh_models import Value as Value

_NUMBERS = itertools.count(1)
# Glyphs that are one shape: their looks are plain values; those of others may be columns.
_ONE_SHAPE = ("Line", "Step", "VArea", "Patch")
# What is said of where a glyph is drawn, not of its looks.
_OF_RENDERER = ("level", "name", "visible")
_AXES = {"linear": "LinearAxis", "log": "LogAxis", "categorical": "CategoricalAxis"}
_TICKERS = {"linear": "BasicTicker", "log": "LogTicker", "categorical": "CategoricalTicker"}
_SCALES = {"linear": "LinearScale", "log": "LogScale", "categorical": "CategoricalScale"}
# Of these tools one stands for all plots of a grid; of others, one switch for all of theirs.
_SINGLE_TOOLS = ("SaveTool",)
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))


BasicTicker = partial(BokehSpec, "BasicTicker")
BoxAnnotation = partial(BokehSpec, "BoxAnnotation")
BoxZoomTool = partial(BokehSpec, "BoxZoomTool")
ColorBar = partial(BokehSpec, "ColorBar")
CrosshairTool = partial(BokehSpec, "CrosshairTool")
FactorRange = partial(BokehSpec, "FactorRange")
HoverTool = partial(BokehSpec, "HoverTool")
LabelSet = partial(BokehSpec, "LabelSet")
Legend = partial(BokehSpec, "Legend")
LegendItem = partial(BokehSpec, "LegendItem")
LinearColorMapper = partial(BokehSpec, "LinearColorMapper")
LogColorMapper = partial(BokehSpec, "LogColorMapper")
LogTicker = partial(BokehSpec, "LogTicker")
PlainText = partial(BokehSpec, "PlainText")
ResetTool = partial(BokehSpec, "ResetTool")
SaveTool = partial(BokehSpec, "SaveTool")
Span = partial(BokehSpec, "Span")


def ColumnDataSource(data: dict[str, Any]) -> BokehSpec:  # as Bokeh calls it
    """Return a source of columns: arrays, or lists of texts, all of one length."""
    return BokehSpec("ColumnDataSource", data=data)


def Range1d(start: float, end: float, **more: Any) -> BokehSpec:
    """Return a range."""
    return BokehSpec("Range1d", start=start, end=end, **more)


class Plot(BokehSpec):
    """A plot with two axes and their grids.

    Parameters
    ----------
    x_range, y_range : Sketch or model of Bokeh, optional
        Default: what is drawn decides.
    x_axis_type, y_axis_type : str
        ``"linear"`` or ``"log"``; of a range of names the axis has names.
    tools : sequence of BokehSpec
    **more
        Further properties.
    """

    def __init__(
        self,
        *,
        x_range: Any = None,
        y_range: Any = None,
        x_axis_type: str = "linear",
        y_axis_type: str = "linear",
        tools: Sequence[BokehSpec] = (),
        **more: Any,
    ) -> None:
        super().__init__("Plot", **more)
        self.x_range, self.y_range = x_range or BokehSpec("DataRange1d"), y_range or BokehSpec("DataRange1d")
        kinds = [
            "categorical" if getattr(across, "kind", type(across).__name__) == "FactorRange" else kind
            for across, kind in ((self.x_range, x_axis_type), (self.y_range, y_axis_type))
        ]
        self.x_scale, self.y_scale = (BokehSpec(_SCALES[kind]) for kind in kinds)
        below, left = (BokehSpec(_AXES[kind], ticker=BokehSpec(_TICKERS[kind])) for kind in kinds)
        sides: dict[str, list[BokehSpec]] = {"below": [below], "left": [left], "above": [], "right": []}
        vars(self).update(sides)
        self.center = [BokehSpec("Grid", axis=below), BokehSpec("Grid", axis=left, dimension=1)]
        self.renderers: list[BokehSpec] = []
        self.toolbar = BokehSpec("Toolbar", tools=list(tools))

    @property
    def xaxis(self) -> BokehSpec:
        """The axis below."""
        axis: BokehSpec = self.below[0]
        return axis

    @property
    def yaxis(self) -> BokehSpec:
        """The axis on the left."""
        axis: BokehSpec = self.left[0]
        return axis

    @property
    def xgrid(self) -> BokehSpec:
        """The vertical lines."""
        return self.center[0]

    @property
    def ygrid(self) -> BokehSpec:
        """The horizontal lines."""
        return self.center[1]

    def add_layout(self, model: BokehSpec, place: str = "center") -> None:
        """Put something over a plot, or beside it."""
        vars(self)[place].append(model)

    def add_tools(self, *tools: BokehSpec) -> None:
        """Add tools."""
        self.toolbar.tools.extend(tools)

    def _glyph(self, kind: str, names: str, /, *places: Any, source: Any = None, **looks: Any) -> BokehSpec:
        """Draw a glyph: its coordinates are columns by their keys, arrays, or a number for all."""
        given = source or ColumnDataSource({})
        told: dict[str, Any] = {}
        for name, place in zip(names.split(), places, strict=True):
            if np.ndim(place):
                given.data[name] = np.asarray(place)
                told[name] = Field(name)
            else:
                told[name] = Field(place) if isinstance(place, str) else Value(place)
        more = {name: looks.pop(name) for name in _OF_RENDERER if name in looks}
        for name, look in looks.items():
            told[name] = look if kind in _ONE_SHAPE or isinstance(look, Field) else Value(look)
        renderer = BokehSpec("GlyphRenderer", data_source=given, glyph=BokehSpec(kind, **told), **more)
        self.renderers.append(renderer)
        return renderer

    line = partialmethod(_glyph, "Line", "x y")
    step = partialmethod(_glyph, "Step", "x y")
    patch = partialmethod(_glyph, "Patch", "x y")
    scatter = partialmethod(_glyph, "Scatter", "x y")
    text = partialmethod(_glyph, "Text", "x y text")
    varea = partialmethod(_glyph, "VArea", "x y1 y2")
    segment = partialmethod(_glyph, "Segment", "x0 y0 x1 y1")
    quad = partialmethod(_glyph, "Quad", "left right top bottom")
    rect = partialmethod(_glyph, "Rect", "x y width height")
    hbar = partialmethod(_glyph, "HBar", "y height right left")


def grid(rows: Sequence[Sequence[Plot | None]]) -> BokehSpec:
    """Return plots in rows and columns, with one toolbar for all of them."""
    children = [(plot, i, j) for i, row in enumerate(rows) for j, plot in enumerate(row) if plot is not None]
    kinds: dict[str, list[BokehSpec]] = {}
    for plot, _, _ in children:
        plot.toolbar_location = None
        for tool in plot.toolbar.tools:
            kinds.setdefault(_key(tool), []).append(tool)
    tools = [
        BokehSpec(each[0].kind) if each[0].kind in _SINGLE_TOOLS else BokehSpec("ToolProxy", tools=each)
        for each in kinds.values()
    ]
    first = next((tool for tool in tools if tool.kind == "ToolProxy" and tool.tools[0].kind == "BoxZoomTool"), None)
    bar = BokehSpec("Toolbar", tools=tools, logo=None, autohide=True, active_drag=first)
    return BokehSpec("GridPlot", children=children, toolbar=bar, toolbar_location="right", sizing_mode="stretch_width")


def _key(tool: BokehSpec) -> str:
    """Return what tools have alike that one switch stands for: the kind, and what is shown where the pointer is."""
    return f"{tool.kind} {vars(tool).get('tooltips')}"


# --- to Bokeh's models, and to JSON


def live(figures: Sequence[BokehSpec]) -> list[Any]:
    """Return figures as Bokeh's own models, for a server; what several share is shared.

    Raises
    ------
    AttributeError, ValueError
        If Bokeh has no such model, property or value.
    """
    from bokeh import models as library

    made: dict[int, Any] = {}

    def of(value: Any) -> Any:
        match value:
            case BokehSpec():
                if id(value) not in made:
                    made[id(value)] = getattr(library, value.kind)(
                        **{name: of(each) for name, each in vars(value).items()}
                    )
                return made[id(value)]
            case list() | tuple():
                return type(value)(map(of, value))
            case Field(field, transform):
                return field if transform is None else {"field": field, "transform": of(transform)}
            case Value(inner):
                return {"value": inner} if isinstance(inner, str) else inner
        return value

    return [of(figure) for figure in figures]


def written(figures: Sequence[BokehSpec]) -> tuple[list[Any], list[str]]:
    """Return figures as JSON that Bokeh's library in a browser reads, and the id of each."""
    ids: dict[int, str] = {}
    roots = [_json(figure, ids) for figure in figures]
    return roots, [root["id"] for root in roots]


def _json(value: Any, ids: dict[int, str]) -> Any:
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else {"type": "number", "value": _beyond(value)}
        case np.generic():
            return _json(value.item(), ids)
        case BokehSpec():
            if id(value) in ids:
                return {"id": ids[id(value)]}
            ids[id(value)] = name = f"sketch-{next(_NUMBERS)}"
            told = {key: _json(each, ids) for key, each in vars(value).items()}
            return {"type": "object", "name": value.kind, "id": name, "attributes": told}
        case Field(field, transform):
            told = {"type": "field", "field": field}
            return told if transform is None else told | {"transform": _json(transform, ids)}
        case Value(inner):
            return {"type": "value", "value": _json(inner, ids)}
        case dict():
            return {"type": "map", "entries": [[key, _json(each, ids)] for key, each in value.items()]}
        case np.ndarray() | pd.Series() | pd.Index():
            return _array(np.asarray(value), ids)
    return [_json(each, ids) for each in value]


def _beyond(value: float) -> str:
    return "nan" if math.isnan(value) else "+inf" if value > 0 else "-inf"


def _array(values: np.ndarray[Any, Any], ids: dict[int, str]) -> Any:
    if values.dtype.kind not in "fiu":
        return [_json(each, ids) for each in values.tolist()]
    if values.dtype not in _FLOATS:
        values = values.astype(np.float64)
    packed = gzip.compress(values.astype(values.dtype.newbyteorder("<")).tobytes(), compresslevel=6, mtime=1)
    told = {"type": "bytes", "data": base64.b64encode(packed).decode()}
    return {
        "type": "ndarray",
        "array": told,
        "shape": list(values.shape),
        "dtype": values.dtype.name,
        "order": "little",
    }
