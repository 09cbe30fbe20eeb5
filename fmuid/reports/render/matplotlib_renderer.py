"""Charts for print, with matplotlib's objects: no window, no global state."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure as Print
from matplotlib.legend_handler import HandlerTuple
from matplotlib.ticker import MaxNLocator

from fmuid.array_types import Floats
from fmuid.files import replacing
from fmuid.reports.chart import Axis, Chart, ChartGrid, Figure, Layer, Shades, beside, row_below, wrapped
from fmuid.reports.render.style import BAR, BAR_BELOW, COLORS, MISSING, palette

# Wide enough to be read at the width of a README, about 1000 pixels.
WIDTH, DPI = 9.2, 110
# Inches of a pixel of a figure's height, and points of one of its lines.
INCH, POINT = 1 / 92, 0.72
DASHES = {"solid": "-", "dashed": (0, (4, 3)), "dotted": (0, (1, 2))}
MARKERS = {"circle": "o", "x": "x", "dash": "_", "bar": "|"}
# Letters on an inch of an axis.
LETTERS = 11
# Of what is painted, as a share of it, where no range says more: beside it, and above and below.
ROOM = (0.01, 0.06)
STYLE: Any = {
    "font.size": 9,
    "axes.edgecolor": COLORS["grey"],
    "axes.labelcolor": COLORS["ink"],
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.formatter.useoffset": False,
    "axes.axisbelow": True,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "grid.color": COLORS["faint"],
    "grid.linewidth": 0.6,
    "xtick.color": COLORS["grey"],
    "ytick.color": COLORS["grey"],
    "xtick.labelcolor": COLORS["ink"],
    "ytick.labelcolor": COLORS["ink"],
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "text.color": COLORS["ink"],
    "svg.hashsalt": "fmuid",
}
# The same figure is the same file.
_UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None, "ModDate": None}}


def style() -> Any:
    """Return the context for drawing."""
    return matplotlib.rc_context(STYLE)


def printed(figures: Sequence[Figure], columns: int, title: str = "") -> Print:
    """Return figures beside and below each other as one for print."""
    columns = min(columns, len(figures))
    rows = [list(figures[k : k + columns]) for k in range(0, len(figures), columns)]
    heights = [max(sum(_heights(each)) for each in row) * INCH for row in rows]
    with style():
        whole = Print(figsize=(WIDTH, sum(heights) + 0.3 * bool(title)), layout="constrained")
        if title:
            whole.suptitle(_words(title), x=0.01, ha="left", fontsize=10.5)
        parts = whole.subfigures(len(rows), columns, squeeze=False, height_ratios=heights)
        for row, places in zip(rows, parts, strict=True):
            for figure, place in zip(row, places, strict=False):
                _arranged(place, figure)
    return whole


def _heights(figure: Figure) -> list[float]:
    grid = figure.rows if isinstance(figure, ChartGrid) else ((figure,),)
    return [max(float(chart.whole_height) for chart in row if chart is not None) for row in grid]


def _arranged(place: Any, figure: Figure) -> None:
    if isinstance(figure, Chart):
        paint(place.subplots(), figure)
        return
    across = max(map(len, figure.rows))
    cells = place.add_gridspec(len(figure.rows), across, height_ratios=_heights(figure))
    for i, row in enumerate(figure.rows):
        for j, chart in enumerate(row):
            if chart is not None:
                paint(place.add_subplot(cells[i, j]), chart)


def paint(axes: Axes, chart: Chart) -> None:
    """Paint a chart into axes."""
    for setting, axis in ((axes.set_xscale, chart.x), (axes.set_yscale, chart.y)):
        if axis.kind == "log":
            setting("log")
    entries: dict[str, dict[type, Any]] = {}
    for layer in chart.layers:
        if layer.mark not in ("rule", "zone"):
            artist = _Marks(axes, chart, layer).artist()
            if layer.label and artist is not None:
                entries.setdefault(layer.label, {})[type(artist)] = artist
    axes.margins(*ROOM)
    _frame(axes, "x", chart.x)
    _frame(axes, "y", chart.y)
    limits = axes.get_xlim(), axes.get_ylim()
    for layer in chart.layers:
        if layer.mark in ("rule", "zone"):
            _across(axes, layer)
    if entries:
        _legend(axes, {text: tuple(found.values()) for text, found in entries.items()})
    if chart.y.kind == "names" and not beside(chart.y.names):
        _names(axes, chart.y.names)
    axes.set(xlim=limits[0], ylim=limits[1])


class _Marks:
    """A layer in matplotlib's terms."""

    def __init__(self, axes: Axes, chart: Chart, layer: Layer) -> None:
        self.axes, self.chart, self.layer = axes, chart, layer
        self.color = to_rgba(COLORS[layer.color], layer.alpha)

    def artist(self) -> Any:
        """Paint the layer and return its legend entry."""
        layer, look = self.layer, self._line()
        match layer.mark:
            case "line":
                return self.axes.plot(self.at("x"), self.at("y"), **look, solid_joinstyle="round")[0]
            case "step":
                return self.axes.step(self.at("x"), self.at("y"), where="post", **look)[0]
            case "points":
                return self._points(self.at("x"), self.at("y"))
            case "segments":
                starts, ends = (np.column_stack([self.at(f"x{k}"), self.at(f"y{k}")]) for k in (0, 1))
                both = np.stack([starts, ends], axis=1)
                known = both[np.isfinite(both).all(axis=(1, 2))]
                return self._collected(LineCollection(list(known), colors=look["color"], linewidths=look["lw"]))
            case "band":
                return self.axes.fill_between(self.at("x"), self.at("y0"), self.at("y1"), color=self.color, lw=0)
            case "patch":
                return self.axes.fill(self.at("x"), self.at("y"), color=self.color, lw=0)[0]
            case "text":
                return self._written()
        return self._boxes()

    def _line(self) -> dict[str, Any]:
        return {"color": self.color, "lw": POINT * self.layer.width, "ls": DASHES[self.layer.dash]}

    def _points(self, x: Floats, y: Floats) -> Any:
        layer = self.layer
        size = np.asarray(layer.data.get("size", layer.size), dtype=np.float64)
        area, marker, color = (POINT * size) ** 2, MARKERS[layer.marker], COLORS[layer.color]
        if marker != "o":
            return self.axes.scatter(x, y, area, c=color, marker=marker, linewidths=POINT * layer.width)
        edge = {"linewidths": 0.8 * POINT, "edgecolors": COLORS[layer.edge]} if layer.edge else {"linewidths": 0}
        return self.axes.scatter(x, y, area, c=[color], alpha=layer.alpha, **edge)

    def _written(self) -> None:
        data, x, y = self.layer.data, self.at("x"), self.at("y")
        texts = data["text"]
        colors = data.get("ink", (COLORS["ink"],) * len(x))
        assert isinstance(texts, tuple)
        assert isinstance(colors, tuple)
        for place, text, color in zip(np.column_stack([x, y]), texts, colors, strict=True):
            self.axes.text(place[0], place[1], text, color=color, ha="center", va="center", fontsize=7.5)

    def _boxes(self) -> Any:
        """Paint rectangles, by their sides or by their middles."""
        layer = self.layer
        if layer.mark == "bars":
            half = 0.5 * (BAR if beside(self.chart.y.names) else BAR_BELOW)
            left, y = self.at("x0") if "x0" in layer.data else np.zeros(1), self.at("y")
            sides = left, self.at("x"), y - half, y + half
        elif "left" in layer.data:
            sides = self.at("left"), self.at("right"), self.at("bottom"), self.at("top")
        else:
            x, y = self.at("x"), self.at("y")
            sides = x - 0.48, x + 0.48, y - 0.48, y + 0.48
        left, right, bottom, top = np.broadcast_arrays(*sides)
        corners = np.stack([(left, bottom), (right, bottom), (right, top), (left, top)]).transpose(2, 0, 1)
        color: Any = self.color
        edge: Any = COLORS[layer.edge] if layer.edge else "none"
        if layer.shades is not None:
            shades = _shades(layer.shades)
            color = shades.to_rgba(np.asarray(layer.data["value"], np.float64))
            if layer.shades.title:
                edge = color
                bar = self.axes.figure.colorbar(shades, ax=self.axes)
                bar.set_label(layer.shades.title)
        elif "alpha" in layer.data:
            color = [to_rgba(COLORS[layer.color], each) for each in np.asarray(layer.data["alpha"], np.float64)]
        return self._collected(PolyCollection(list(corners), facecolors=color, edgecolors=edge, lw=0.5))

    def _collected(self, found: Any) -> Any:
        self.axes.add_collection(found)
        self.axes.autoscale_view()
        return found

    def at(self, key: str) -> Floats:
        """Return coordinates; names as their places on the axis."""
        values = self.layer.data[key]
        axis = self.chart.y if key[0] == "y" or key in ("top", "bottom") else self.chart.x
        if isinstance(values, tuple):
            order = {name: float(k) for k, name in enumerate(axis.names)}
            return np.array([order[each] for each in values])
        found = np.asarray(values, dtype=np.float64)
        if found.ndim:
            return found
        count = next((len(each) for each in self.layer.data.values() if not isinstance(each, float | int)), 1)
        return np.full(count, float(found))


def _shades(shades: Shades) -> ScalarMappable:
    scale: type[Normalize] = LogNorm if shades.log else Normalize
    missing = COLORS["white"] if shades.title else MISSING
    return ScalarMappable(scale(shades.low, shades.high), ListedColormap(palette(shades.palette), bad=missing))


def _frame(axes: Axes, side: str, axis: Axis) -> None:
    """Set range, label, ticks and grid of an axis."""
    mine = axes.xaxis if side == "x" else axes.yaxis
    low, high = axes.get_xlim() if side == "x" else axes.get_ylim()
    if axis.kind == "names":
        mine.set_ticks(range(len(axis.names)), [_words(name) for name in axis.names])
        axes.set(**{f"{side}lim": (-0.6, len(axis.names) - 0.4)})
    elif axis.reach != (None, None):
        axes.set(**{f"{side}lim": tuple(b if a is None else a for a, b in zip(axis.reach, (low, high), strict=True))})
    mine.grid(visible=axis.grid if axis.grid is not None else side == "y" and axis.shown)
    wanted = axis.ticks or (6 if axis.whole else 5 if side == "x" else 0)
    if wanted and axis.kind == "linear":
        mine.set_major_locator(MaxNLocator(nbins=wanted, integer=axis.whole))
    if axis.turned:
        axes.tick_params(axis=side, labelrotation=math.degrees(axis.turned))  # type: ignore[arg-type]
    if not axis.shown or (axis.kind == "names" and side == "y" and not beside(axis.names)):
        axes.tick_params(axis=side, which="both", labelbottom=False, labelleft=False, length=0)  # type: ignore[arg-type]
        if side == "y":
            axes.spines["left"].set_visible(False)
        return
    text = textwrap.fill(axis.label, int(LETTERS * _width(axes))) if side == "x" else axis.label
    mine.set_label_text(_words(text))


def _words(text: str) -> str:
    """Return a text without mathematics markup."""
    return text.replace("$", r"\$")


def _across(axes: Axes, layer: Layer) -> None:
    columns = {side: np.atleast_1d(np.asarray(each, np.float64)) for side, each in layer.data.items()}
    color = to_rgba(COLORS[layer.color], layer.alpha)
    if layer.mark == "rule":
        for side, places in columns.items():
            line = axes.axvline if side == "x" else axes.axhline
            for place in places:
                line(float(place), color=color, lw=POINT, ls=DASHES[layer.dash])
        return
    for fill, limits, ends in (
        (axes.axvspan, axes.get_xlim(), ("left", "right")),
        (axes.axhspan, axes.get_ylim(), ("bottom", "top")),
    ):
        if any(end in columns for end in ends):
            count = max(columns[end].size for end in ends if end in columns)
            sides = [columns.get(end, np.full(count, limit)) for end, limit in zip(ends, limits, strict=True)]
            for low, high in zip(*sides, strict=True):
                fill(low, high, color=color, lw=0)


def _width(axes: Axes) -> float:
    """Return the inches that a plot has across, with its labels."""
    return float(axes.figure.bbox.width / axes.figure.dpi)


def _legend(axes: Axes, entries: Mapping[str, tuple[Any, ...]]) -> None:
    texts = list(map(_words, entries))
    room = 1.2 * LETTERS * (_width(axes) - 0.6)
    axes.legend(
        list(entries.values()),
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


def _names(axes: Axes, names: Sequence[str]) -> None:
    """Write the names of rows above them."""
    for k, name in enumerate(names):
        axes.annotate(
            _words(wrapped(name)),
            (0.0, k),
            xytext=(0.0, POINT * (0.5 * BAR_BELOW * row_below(names) + 2)),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="bottom",
            fontsize=8,
        )


def save(figures: Mapping[str, Print], folder: Path, kind: str = "png") -> list[Path]:
    """Write figures into `folder` and return their paths."""
    paths = [folder / f"{name}.{kind}" for name in figures]
    with style():  # ticks take theirs when they are drawn
        for path, figure in zip(paths, figures.values(), strict=True):
            with replacing(path) as draft:
                figure.savefig(draft, format=kind, dpi=DPI, metadata=_UNDATED.get(kind))
    return paths
