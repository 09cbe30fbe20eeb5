"""Charts as data: typed marks over two axes, independent of any renderer."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.formatting import label

Mark = Literal["line", "step", "points", "band", "bars", "cells", "segments", "patch", "text", "rule", "zone"]
Color = Literal["ink", "grey", "faint", "white", "blue", "red", "amber"]
Dash = Literal["solid", "dashed", "dotted"]
Data: TypeAlias = Mapping[str, Floats | tuple[str, ...] | float]
Units = Mapping[str, str | None]


@dataclass(frozen=True)
class ChartLimits:
    """How much a chart shows at most: of experiments and outputs those that fit worst."""

    rows: int = 4000  # of a line: more cannot be seen
    dots: int = 2500  # of a cloud: more cover each other
    bars: int = 60  # estimates in a row that each have their interval
    outputs: int = 8
    experiments: int = 6
    parameters: int = 24  # each in its chart
    stretches: int = 20  # of a record, with their shares of the squared residual
    files: int = 6  # in the head of a page; its end has all


LIMITS = ChartLimits()
LEGEND_ROOM, CHARACTER, ENTRY, LEGEND_LINE = 230, 5.8, 33, 18
"""Pixels: of a legend on a telephone, of a letter, of what else belongs to an entry, of a line of it."""
LONGEST_LINE = 44  # letters of a line that a telephone has room for
LONGEST_BESIDE = 14  # letters of names that stand beside their rows; longer ones stand above them
ROW, ROW_BELOW, ROW_LINE = 28, 20, 28
"""Pixels: of a row with its name beside it, of one below its name, of each line of such a name."""


@dataclass(frozen=True, eq=False)
class Shades:
    """Color scale of values; a color bar is drawn with a title."""

    palette: Literal["diverging", "blues"]
    low: float
    high: float
    log: bool = False
    title: str = ""


@dataclass(frozen=True, eq=False)
class Layer:
    """Marks of one kind and look. Layers that share their first array share a source.

    ``line``, ``step``, ``points``, ``patch``, ``text`` have x and y; ``band`` has x, y0, y1; ``segments`` have x0, y0,
    x1, y1; ``bars`` from x0 to x in row y; ``cells`` have left, right, bottom, top or the names x and y; ``rule`` has
    x or y; ``zone`` has some of the sides.
    """

    mark: Mark
    data: Data  # columns of one length and common numbers: coordinates, size, alpha, value, text, ink, hover columns
    color: Color = "blue"
    width: float = 1.8
    dash: Dash = "solid"
    alpha: float = 1.0
    size: float = 6.0
    marker: Literal["circle", "x", "dash", "bar"] = "circle"
    edge: Color | None = None  # outline of points and cells
    label: str = ""  # in the legend, which has one entry per label
    hover: tuple[tuple[str, str], ...] = ()  # title, and columns with their format: "@x{0.000}"
    shades: Shades | None = None
    above: bool = False  # it changes while somebody looks, and is painted above the others


@dataclass(frozen=True)
class Axis:
    """An axis."""

    label: str = ""  # with the unit
    kind: Literal["linear", "log", "names"] = "linear"
    names: tuple[str, ...] = ()  # from the left or the bottom
    reach: tuple[float | None, float | None] = (None, None)  # initial range; None: as drawn
    linked: str = ""  # axes of one word share their range
    shown: bool = True
    ticks: int = 0  # about how many; 0: default
    whole: bool = False  # ticks are integers
    turned: float = 0.0  # angle of the labels, rad
    grid: bool | None = None  # default: the ordinate has grid lines


DENSITY = Axis(reach=(0.0, None), shown=False)  # the ordinate of a density


@dataclass(frozen=True, eq=False)
class Chart:
    """Layers over two axes, painted in their order."""

    x: Axis
    y: Axis
    layers: tuple[Layer, ...]
    height: int = 220  # pixels; the width is that of the page
    crosshair: bool = False  # over time, read at one instant with the charts below

    @property
    def legend_lines(self) -> int:
        """Number of lines of the legend on a telephone."""
        entries = list(dict.fromkeys(layer.label for layer in self.layers if layer.label))
        width = sum(CHARACTER * len(entry) + ENTRY for entry in entries)
        return min(len(entries), 1) if width <= LEGEND_ROOM else len(entries)

    @property
    def whole_height(self) -> int:
        """Pixels with a legend of several lines."""
        return self.height + LEGEND_LINE * max(0, self.legend_lines - 1)


@dataclass(frozen=True, eq=False)
class ChartGrid:
    """Charts in rows and columns that are read together."""

    rows: tuple[tuple[Chart | None, ...], ...]
    # returns the same grid with the data of an interval of the abscissa
    live: Callable[[float, float], ChartGrid] | None = field(default=None, repr=False)

    @property
    def charts(self) -> tuple[Chart, ...]:
        """All charts, row by row."""
        return tuple(chart for row in self.rows for chart in row if chart is not None)


Figure = Chart | ChartGrid


def stacked(charts: Sequence[Chart]) -> ChartGrid:
    """Return charts below each other; of linked ones the last has the axis."""
    shown = [replace(each, x=replace(each.x, shown=each is charts[-1])) if each.x.linked else each for each in charts]
    return ChartGrid(tuple((each,) for each in shown))


def named(name: str, units: Units | None) -> str:
    """Return the label of a parameter or an output."""
    return label(name, (units or {}).get(name))


def wrapped(text: str) -> str:
    """Return a text in lines that a telephone has room for."""
    return "\n".join(textwrap.wrap(text, LONGEST_LINE))


def beside(names: Sequence[str]) -> bool:
    """Tell if the names fit beside their rows."""
    return max(map(len, names), default=0) <= LONGEST_BESIDE


def rows_of(names: Sequence[str], x: Axis, layers: Sequence[Layer], head: int = 80) -> Chart:
    """Return a chart with one row per name, the first on top."""
    row = ROW if beside(names) else row_below(names)
    return Chart(x, Axis(kind="names", names=tuple(names)[::-1]), tuple(layers), head + row * len(names))


def intervals(
    names: tuple[str, ...], value: Floats, low: Floats, high: Floats, color: Color = "blue", word: str = "value"
) -> tuple[Layer, Layer]:
    """Return values with their intervals, a row a name."""
    hover = ((word, "@x{0.000000}"), ("interval", "@x0{0.000000} to @x1{0.000000}"))
    ends: Data = {"x0": low, "y0": names, "x1": high, "y1": names}
    points: Data = {"x": value, "y": names, "x0": low, "x1": high}
    return Layer("segments", ends, color, width=3), Layer("points", points, color, size=9, hover=hover)


def row_below(names: Sequence[str]) -> int:
    """Return the pixels of a row below its name."""
    return ROW_BELOW + ROW_LINE * max(wrapped(name).count("\n") + 1 for name in names)


def kinds(mark: Mark, data: Data, parts: Iterable[tuple[str, Color, Flags]], **look: Any) -> list[Layer]:
    """Return a layer per kind of rows: its label, color and rows; kinds without rows are left out."""
    return [Layer(mark, picked(data, mine), color, label=text, **look) for text, color, mine in parts if mine.any()]


def short(values: Floats) -> Floats:
    """Return numbers in single precision."""
    with np.errstate(over="ignore"):  # of an unstable simulation
        return values.astype(np.float32)


def picked(data: Data, rows: Flags | Indices) -> dict[str, Floats | tuple[str, ...] | float]:
    """Return some rows of columns, by a mask or by their numbers."""
    texts = {name: tuple(np.array(each, dtype=object)[rows]) for name, each in data.items() if isinstance(each, tuple)}
    return {name: each[rows] if isinstance(each, np.ndarray) else texts.get(name, each) for name, each in data.items()}


def normal(places: Floats, mean: float, std: float) -> Floats:
    """Return the density of a normal distribution."""
    return np.asarray(np.exp(-0.5 * ((places - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi)))
