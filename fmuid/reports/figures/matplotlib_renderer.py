"""The same figures for print: a sketch is painted with matplotlib as Bokeh's library paints it in a browser."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.ticker import MaxNLocator

from fmuid.array_types import Floats
from fmuid.reports.figures.style import WIDTH, style
from fmuid.reports.interactive.bokeh_spec import BokehSpec, Field, Value

# Inches of a pixel of a figure's height, and points of one of its lines.
INCH, POINT = 1 / 92, 0.72
DASHES = {"dashed": (0, (4, 3)), "dotted": (0, (1, 2))}
MARKERS = {"circle": "o", "x": "x", "dash": "_"}
# Letters on an inch of an axis.
LETTERS = 11
# Of what is painted, as a share of it, where no range says more: beside it, and above and below.
ROOM = (0.01, 0.06)


def printed(figures: Sequence[BokehSpec], columns: int, title: str = "") -> Figure:
    """Return figures beside and below each other as one for print.

    Parameters
    ----------
    figures : sequence of BokehSpec
        Plots, and grids of them.
    columns : int
        So many stand beside each other.
    title : str
        Above all of them.
    """
    columns = min(columns, len(figures))
    rows = [list(figures[k : k + columns]) for k in range(0, len(figures), columns)]
    heights = [max(map(_height, row)) * INCH for row in rows]
    with style():
        whole = Figure(figsize=(WIDTH, sum(heights) + 0.3 * bool(title)), layout="constrained")
        if title:
            whole.suptitle(_words(title), x=0.01, ha="left", fontsize=10.5)
        parts = whole.subfigures(len(rows), columns, squeeze=False, height_ratios=heights)
        for row, places in zip(rows, parts, strict=True):
            for figure, place in zip(row, places, strict=False):
                _arranged(place, figure)
    return whole


def _height(figure: BokehSpec) -> float:
    return float(sum(_rows(figure))) if figure.kind == "GridPlot" else float(figure.height)


def _rows(grid: BokehSpec) -> list[float]:
    count = 1 + max(i for _, i, _ in grid.children)
    return [max(plot.height for plot, i, _ in grid.children if i == row) for row in range(count)]


def _arranged(place: Any, figure: BokehSpec) -> None:
    if figure.kind != "GridPlot":
        paint(place.subplots(), figure)
        return
    across = 1 + max(j for _, _, j in figure.children)
    cells = place.add_gridspec(len(_rows(figure)), across, height_ratios=_rows(figure))
    for plot, i, j in figure.children:
        paint(place.add_subplot(cells[i, j]), plot)


def paint(axes: Axes, plot: BokehSpec) -> None:
    """Paint a plot into axes."""
    for setting, scale in ((axes.set_xscale, plot.x_scale), (axes.set_yscale, plot.y_scale)):
        if scale.kind == "LogScale":
            setting("log")
    drawn = {id(each): _Glyph(axes, plot, each).artist() for each in plot.renderers}
    _frame(axes, plot)
    limits = axes.get_xlim(), axes.get_ylim()
    for each in (*plot.center, *plot.above, *plot.right):
        match each.kind:
            case "Span":
                line = axes.axvline if each.dimension == "height" else axes.axhline
                line(each.location, color=each.line_color, lw=POINT, ls=DASHES.get(each.line_dash, "-"))
            case "BoxAnnotation":
                _box(axes, each)
            case "Legend":
                _legend(axes, each, drawn)
            case "ColorBar":
                axes.figure.colorbar(shades(each.color_mapper), ax=axes).set_label(each.title)
            case "LabelSet":
                _labels(axes, each, list(plot.y_range.factors))
    axes.set(xlim=limits[0], ylim=limits[1])


# --- glyphs


class _Glyph:
    """A glyph with its columns and looks, in matplotlib's terms."""

    def __init__(self, axes: Axes, plot: BokehSpec, renderer: BokehSpec) -> None:
        self.axes, self.plot, self.kind = axes, plot, renderer.glyph.kind
        self._told, self._data = vars(renderer.glyph), renderer.data_source.data

    def artist(self) -> Any:
        """Paint it, and return what stands for it in a legend."""
        at = {name: self._place(name) for name in _PLACES if name in self._told}
        match self.kind:
            case "Line":
                (line,) = self.axes.plot(at["x"], at["y"], **self._line(), solid_joinstyle="round")
                return line
            case "Step":
                return self.axes.step(at["x"], at["y"], where="post", **self._line())[0]
            case "Scatter":
                return self._points(at["x"], at["y"])
            case "Segment":
                ends = np.stack([np.column_stack([at["x0"], at["y0"]]), np.column_stack([at["x1"], at["y1"]])], axis=1)
                known = ends[np.isfinite(ends).all(axis=(1, 2))]
                look = self._line()
                return self._collected(LineCollection(list(known), colors=look["color"], linewidths=look["lw"]))
            case "VArea":
                return self.axes.fill_between(at["x"], at["y1"], at["y2"], **self._filled(), lw=0)
            case "Patch":
                return self.axes.fill(at["x"], at["y"], **self._filled(), lw=0)[0]
            case "Text":
                return self._written(at["x"], at["y"])
        return self._boxes(at)

    def _boxes(self, at: dict[str, Floats]) -> Any:
        """Paint rectangles, by their sides or by their middles."""
        if self.kind == "Rect":
            x, y, width, height = (at[name] for name in ("x", "y", "width", "height"))
            sides = x - width / 2, x + width / 2, y - height / 2, y + height / 2
        elif self.kind == "HBar":
            sides = at["left"], at["right"], at["y"] - at["height"] / 2, at["y"] + at["height"] / 2
        else:
            sides = at["left"], at["right"], at["bottom"], at["top"]
        left, right, bottom, top = np.broadcast_arrays(*sides)
        corners = np.stack([(left, bottom), (right, bottom), (right, top), (left, top)]).transpose(2, 0, 1)
        look = self._filled()
        shaded = isinstance(self._told.get("line_color"), Field)
        edge = look["color"] if shaded else self._plain("line_color") or "none"
        return self._collected(PolyCollection(list(corners), facecolors=look["color"], edgecolors=edge, lw=0.5))

    def _collected(self, found: Any) -> Any:
        self.axes.add_collection(found)
        self.axes.autoscale_view()
        return found

    def _points(self, x: Floats, y: Floats) -> Any:
        size, marker = self._looks("size", 4.0), MARKERS[self._plain("marker") or "circle"]
        if marker == "_" and self._plain("angle"):
            marker = "|"
        stroke, alpha = self._plain("line_color"), self._plain("fill_alpha")
        width = POINT * float(self._plain("line_width") or 1.0)
        area = (POINT * np.asarray(size, dtype=np.float64)) ** 2
        if marker != "o":
            return self.axes.scatter(x, y, area, c=stroke, marker=marker, linewidths=width)
        fill = self._plain("fill_color")
        edge = {"linewidths": width, "edgecolors": stroke} if stroke else {"linewidths": 0}
        return self.axes.scatter(x, y, area, c=[fill], alpha=alpha, **edge)

    def _written(self, x: Floats, y: Floats) -> None:
        colors, texts = self._looks("text_color", "black"), self._looks("text", "")
        for place, text, color in zip(np.column_stack([x, y]), texts, colors, strict=True):
            self.axes.text(place[0], place[1], text, color=color, ha="center", va="center", fontsize=7.5)

    def _line(self) -> dict[str, Any]:
        color = to_rgba(self._plain("line_color"), self._plain("line_alpha"))
        dash = DASHES.get(str(self._plain("line_dash")), "-")
        return {"color": color, "lw": POINT * float(self._plain("line_width") or 1.0), "ls": dash}

    def _filled(self) -> dict[str, Any]:
        color = self._looks("fill_color", "none")
        alpha = self._looks("fill_alpha", None)
        if np.ndim(alpha):
            return {"color": [to_rgba(color, each) for each in alpha]}
        return {"color": to_rgba(color, alpha) if isinstance(color, str) else color}

    def _plain(self, name: str) -> Any:
        told = self._told.get(name)
        return told.value if isinstance(told, Value) else None if isinstance(told, Field) else told

    def _looks(self, name: str, default: Any) -> Any:
        """Return a look: one for all, or one for each by its column."""
        told = self._told.get(name)
        if not isinstance(told, Field):
            plain = self._plain(name)
            return default if plain is None else plain
        values = self._data[told.field]
        return values if told.transform is None else shades(told.transform).to_rgba(np.asarray(values, np.float64))

    def _place(self, name: str) -> Floats:
        told = self._told[name]
        values = self._data[told.field] if isinstance(told, Field) else told.value
        across = self.plot.y_range if name in _UP else self.plot.x_range
        if across.kind == "FactorRange" and isinstance(told, Field) and name not in ("width", "height"):
            order = {str(each): float(k) for k, each in enumerate(across.factors)}
            return np.array([order[str(each)] for each in values])
        return np.asarray(values, dtype=np.float64)


_PLACES = ("x", "y", "x0", "y0", "x1", "y1", "y2", "left", "right", "top", "bottom", "width", "height")
_UP = ("y", "y0", "y1", "y2", "top", "bottom", "height")


def shades(mapper: BokehSpec) -> ScalarMappable:
    """Return the colours of a scale."""
    scale: type[Normalize] = LogNorm if mapper.kind == "LogColorMapper" else Normalize
    colors = ListedColormap(list(mapper.palette), bad=mapper.nan_color)
    return ScalarMappable(scale(mapper.low, mapper.high), colors)


# --- axes


def _frame(axes: Axes, plot: BokehSpec) -> None:
    """Set ranges, labels, ticks and grids."""
    axes.margins(*ROOM)
    for side, across, axis, grid in (
        ("x", plot.x_range, plot.xaxis, plot.xgrid),
        ("y", plot.y_range, plot.yaxis, plot.ygrid),
    ):
        mine = axes.xaxis if side == "x" else axes.yaxis
        given = vars(across)
        if across.kind == "FactorRange":
            mine.set_ticks(range(len(across.factors)), [_words(str(each)) for each in across.factors])
            axes.set(**{f"{side}lim": (-0.6, len(across.factors) - 0.4)})
        elif "end" in given or "start" in given:
            low, high = axes.get_xlim() if side == "x" else axes.get_ylim()
            axes.set(**{f"{side}lim": (given.get("start", low), given.get("end", high))})
        mine.grid(visible=vars(grid).get("grid_line_color", "") is not None)
        _ticks(axes, side, axis)
        text = vars(axis).get("axis_label") or ""
        if vars(axis).get("visible", True):
            said = text if isinstance(text, str) else text.text
            mine.set_label_text(_words(textwrap.fill(said, int(LETTERS * _width(axes))) if side == "x" else said))


def _ticks(axes: Axes, side: str, axis: BokehSpec) -> None:
    told, turned = vars(axis.ticker), vars(axis).get("major_label_orientation")
    mine = axes.xaxis if side == "x" else axes.yaxis
    wanted = told.get("desired_num_ticks")
    if wanted and axis.kind == "LinearAxis":
        mine.set_major_locator(MaxNLocator(nbins=wanted, integer="min_interval" in told))
    if turned:
        axes.tick_params(axis=side, labelrotation=math.degrees(turned))  # type: ignore[arg-type]
    if not vars(axis).get("visible", True):
        axes.tick_params(axis=side, which="both", labelbottom=False, labelleft=False, length=0)  # type: ignore[arg-type]
        if side == "y":
            axes.spines["left"].set_visible(False)


def _words(text: str) -> str:
    """Return a text of which nothing is taken for mathematics."""
    return text.replace("$", r"\$")


# --- what lies over a plot, or beside it


def _box(axes: Axes, each: BokehSpec) -> None:
    told, color = vars(each), to_rgba(each.fill_color, each.fill_alpha)
    for fill, (low, high), ends in (
        (axes.axvspan, axes.get_xlim(), ("left", "right")),
        (axes.axhspan, axes.get_ylim(), ("bottom", "top")),
    ):
        if any(end in told for end in ends):
            fill(told.get(ends[0], low), told.get(ends[1], high), color=color, lw=0)


def _width(axes: Axes) -> float:
    """Return the inches that a plot has across, with its labels."""
    return float(axes.figure.bbox.width / axes.figure.dpi)


def _legend(axes: Axes, each: BokehSpec, drawn: dict[int, Any]) -> None:
    handles, texts = [], []
    for item in each.items:
        mine = {type(found): found for renderer in item.renderers if (found := drawn[id(renderer)]) is not None}
        if mine:
            handles.append(tuple(mine.values()))
            texts.append(_words(str(item.label.value)))
    room = 1.2 * LETTERS * (_width(axes) - 0.6)
    axes.legend(
        handles,
        texts,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=len(texts) if sum(len(text) + 5 for text in texts) < room else 1,
        handler_map={tuple: HandlerTuple(ndivide=1)},
        borderaxespad=0.1,
        handlelength=1.3,
        columnspacing=1.1,
        labelspacing=0.2,
        fontsize=8,
    )


def _labels(axes: Axes, each: BokehSpec, order: list[str]) -> None:
    """Write the names of rows above them."""
    for name, text in zip(each.source.data["name"], each.source.data["text"], strict=True):
        axes.annotate(
            _words(text),
            (0.0, order.index(name)),
            xytext=(0.0, POINT * each.y_offset.value),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="bottom",
            fontsize=8,
        )
