"""Charts as data: typed marks over two axes. Renderers draw them; nothing here knows Bokeh or matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, TypeAlias

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.formatting import label

Mark = Literal["line", "step", "points", "band", "bars", "cells", "segments", "patch", "text", "rule", "zone"]
Color = Literal["ink", "grey", "faint", "white", "blue", "red", "amber"]
Dash = Literal["solid", "dashed", "dotted"]
Data: TypeAlias = Mapping[str, Floats | tuple[str, ...] | float]
Units = Mapping[str, str | None]
WITH_ARRAYS = {"arbitrary_types_allowed": True}
"""For pydantic, which reads documents back."""

MAX_ROWS = 4000
"""Rows of a line: more cannot be seen."""
MAX_DOTS = 2500
"""Dots of a cloud: more cover each other."""
MAX_BARS = 60
"""Estimates in a row that each have their interval."""
MAX_OUTPUTS = 8
"""Outputs drawn: those that fit worst."""
MAX_EXPERIMENTS = 6
"""Experiments drawn: those that fit worst."""
MAX_PARAMETERS = 24
"""Parameters drawn, each in its chart."""
LEGEND_ROOM, CHARACTER, ENTRY, LEGEND_LINE = 230, 5.8, 33, 18
"""Pixels: of a legend on a telephone, of a letter, of what else belongs to an entry, of a line of it."""
LONGEST_LINE = 44
"""Letters of a line that a telephone has room for."""
LONGEST_BESIDE = 14
"""Letters of names that stand beside their rows; longer ones stand above them."""
ROW, ROW_BELOW, ROW_LINE = 28, 20, 28
"""Pixels: of a row with its name beside it, of one below its name, of each line of such a name."""


@dataclass(frozen=True, eq=False)
class Shades:
    """Colors of values: a palette between two limits; with a title, a bar shows it."""

    __pydantic_config__: ClassVar[Mapping[str, bool]] = WITH_ARRAYS

    palette: Literal["diverging", "blues"]
    low: float
    high: float
    log: bool = False
    title: str = ""


@dataclass(frozen=True, eq=False)
class Layer:
    """Marks of one kind and look.

    Attributes
    ----------
    mark : str
        ``line``, ``step``, ``points``, ``patch``, ``text`` have ``x`` and ``y``; ``band`` has ``x``, ``y0``, ``y1``;
        ``bars`` reach from ``x0`` to ``x`` in the row ``y``; ``cells`` have ``left``, ``right``, ``bottom``, ``top``
        or the names ``x`` and ``y``; ``segments`` have ``x0``, ``y0``, ``x1``, ``y1``; ``rule`` has ``x`` or ``y``;
        ``zone`` has some of ``left``, ``right``, ``bottom``, ``top``.
    data : mapping of str to array, tuple of str or float
        Columns of one length, and numbers that all marks share: coordinates, ``size``, ``alpha``, ``value`` of
        `shades`, ``text``, ``ink``, and what `hover` shows. Layers that share their first array share a source.
    color, width, dash, alpha, size, marker, edge
        The look. `edge` is the outline of points and cells.
    label : str
        In the legend, which has an entry per label; "" for none.
    hover : tuple of (str, str)
        Shown at the pointer: a word, and columns with their format, ``"@x{0.000}"``.
    shades : Shades, optional
    above : bool
        Whether it changes while somebody looks: it is painted above what stays.
    """

    __pydantic_config__: ClassVar[Mapping[str, bool]] = WITH_ARRAYS

    mark: Mark
    data: Data
    color: Color = "blue"
    width: float = 1.8
    dash: Dash = "solid"
    alpha: float = 1.0
    size: float = 6.0
    marker: Literal["circle", "x", "dash", "bar"] = "circle"
    edge: Color | None = None
    label: str = ""
    hover: tuple[tuple[str, str], ...] = ()
    shades: Shades | None = None
    above: bool = False


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes
    ----------
    label : str
        With the unit.
    kind : str
        ``linear`` or ``log``; ``names`` has the `names`, the first on the left or at the bottom.
    reach : (float or None, float or None)
        What is shown at first; None: what is drawn decides.
    linked : str
        Axes of one word share their range.
    shown : bool
        Whether ticks and label are there.
    ticks : int
        About how many, 0 for the default.
    whole : bool
        Whether ticks are whole numbers.
    turned : float
        Angle of the labels, rad.
    grid : bool, optional
        Whether lines go across from its ticks; default: from those of the ordinate.
    """

    label: str = ""
    kind: Literal["linear", "log", "names"] = "linear"
    names: tuple[str, ...] = ()
    reach: tuple[float | None, float | None] = (None, None)
    linked: str = ""
    shown: bool = True
    ticks: int = 0
    whole: bool = False
    turned: float = 0.0
    grid: bool | None = None


DENSITY = Axis(reach=(0.0, None), shown=False)
"""The ordinate of a density."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Layers over two axes.

    Attributes
    ----------
    x, y : Axis
    layers : tuple of Layer
        Painted in this order.
    height : int
        Pixels; the width is that of the page.
    crosshair : bool
        Whether it is over time, and read at one instant with the charts below it.
    """

    __pydantic_config__: ClassVar[Mapping[str, bool]] = WITH_ARRAYS

    x: Axis
    y: Axis
    layers: tuple[Layer, ...]
    height: int = 220
    crosshair: bool = False

    @property
    def legend_lines(self) -> int:
        """Lines of the legend: one, where a telephone has room for all entries beside each other."""
        entries = list(dict.fromkeys(layer.label for layer in self.layers if layer.label))
        width = sum(CHARACTER * len(entry) + ENTRY for entry in entries)
        return min(len(entries), 1) if width <= LEGEND_ROOM else len(entries)

    @property
    def whole_height(self) -> int:
        """Pixels with a legend of several lines."""
        return self.height + LEGEND_LINE * max(0, self.legend_lines - 1)


@dataclass(frozen=True, eq=False)
class ChartGrid:
    """Charts in rows and columns that are read together.

    Attributes
    ----------
    rows : tuple of tuple of Chart or None
    live : callable, optional
        Returns the same grid with the data of a stretch of the abscissa, for who zooms.
    """

    __pydantic_config__: ClassVar[Mapping[str, bool]] = WITH_ARRAYS

    rows: tuple[tuple[Chart | None, ...], ...]
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
    """Return whether names stand beside their rows, and not above them."""
    return max(map(len, names), default=0) <= LONGEST_BESIDE


def rows_of(names: Sequence[str], x: Axis, layers: Sequence[Layer], head: int = 80) -> Chart:
    """Return a chart with a row for each name, the first on top; `head` pixels are above and below the rows."""
    row = ROW if beside(names) else row_below(names)
    return Chart(x, Axis(kind="names", names=tuple(names)[::-1]), tuple(layers), head + row * len(names))


def row_below(names: Sequence[str]) -> int:
    """Return the pixels of a row below its name."""
    return ROW_BELOW + ROW_LINE * max(wrapped(name).count("\n") + 1 for name in names)


def short(values: Floats) -> Floats:
    """Return numbers in half the space; a screen shows no more of them."""
    with np.errstate(over="ignore"):  # of an unstable simulation
        return values.astype(np.float32)


def picked(data: Data, rows: Flags | Indices) -> dict[str, Floats | tuple[str, ...] | float]:
    """Return some rows of columns, by a mask or by their numbers."""
    found: dict[str, Floats | tuple[str, ...] | float] = {}
    for name, each in data.items():
        if isinstance(each, tuple):
            found[name] = tuple(np.array(each, dtype=object)[rows])
        else:
            found[name] = each[rows] if isinstance(each, np.ndarray) else each
    return found


def normal(places: Floats, mean: float, std: float) -> Floats:
    """Return the density of a normal distribution."""
    return np.asarray(np.exp(-0.5 * ((places - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi)))
