"""What all interactive figures share: their look, units on axes, linked ranges, legends, grids.

Colours are those of the figures for print. Each has a twin for a dark page, which the page's own script puts in its
place (`DARK`); a figure knows nothing of where it is shown. Names from studies and FMUs are never part of a format, of
a column's name or of HTML.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.formatting import label
from fmuid.reports.interactive.bokeh_spec import (
    BasicTicker,
    BokehSpec,
    BoxAnnotation,
    BoxZoomTool,
    HoverTool,
    Legend,
    LegendItem,
    PlainText,
    Plot,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    Value,
    grid,
)

INK, GREY, FAINT, WHITE = "#24292f", "#6e7781", "#e1e5ea", "#ffffff"
BLUE, RED, AMBER = "#0b61d0", "#c4432b", "#d99a1c"
LINE = "#c9d1d9"
"""Of axes."""
DARK = {
    INK: "#e6edf3",
    GREY: "#9aa4af",
    FAINT: "#2b323b",
    LINE: "#4b5563",
    WHITE: "#151b23",
    BLUE: "#5aa2ff",
    RED: "#ff7b5e",
    AMBER: "#e8b84a",
}
"""Each colour's twin on a dark page."""
FONT = "Inter, system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif"
# Lines are thinned to about so many rows, dots to so many.
MAX_ROWS, MAX_DOTS = 4000, 2500
MAX_BARS = 60
"""Up to so many estimates in a row each has its interval."""
# More than these make a page nobody reads: the outputs and experiments that fit worst are kept.
MAX_OUTPUTS, MAX_EXPERIMENTS, MAX_PARAMETERS = 8, 6, 24
# Cells of a grid are at least so wide, pixels: on a telephone one stands below the other.
NARROW, WIDE = 260, 420
# What begins mathematics in a text of Bokeh, for which it would ask a host.
_TEX = ("$$", "\\(", "\\[")
# So many characters of a text fit into a figure on a telephone; so many pixels has its legend there.
LONGEST_LINE, LEGEND_ROOM = 44, 230
# Pixels of a character, of what else belongs to an entry of a legend, and of a line of it.
CHARACTER, ENTRY, LEGEND_LINE = 5.8, 33, 18
NAME_SIZE = "11px"

Units = Mapping[str, str | None]


class Panel(Plot):
    """An empty figure in the house's look.

    Parameters
    ----------
    x, y : str
        Labels of the axes, with their units.
    height : int
        In pixels; the width is that of the page.
    tools : sequence of Tool
        Instead of box zoom, reset and save: each tool takes time in the making of a page.
    **more
        Of `Plot`.
    """

    def __init__(self, x: str = "", y: str = "", *, height: int = 240, tools: Sequence[Any] = (), **more: Any) -> None:
        zoom = BoxZoomTool()
        kept = list(tools) or [zoom, ResetTool(), SaveTool()]
        look: dict[str, Any] = {"sizing_mode": "stretch_width", "toolbar_location": "right", "min_border_left": 58}
        super().__init__(height=height, tools=kept, min_border_right=10, **look, **more)
        self.toolbar.logo, self.toolbar.autohide = None, True
        self.toolbar.active_drag = zoom if zoom in kept else None
        self.outline_line_color = self.background_fill_color = self.border_fill_color = None  # that of the page
        self.ygrid.grid_line_color, self.xgrid.grid_line_color = FAINT, None
        for axis, text in ((self.xaxis, wrapped(x)), (self.yaxis, y)):
            axis.axis_label = plain(text)
            axis.axis_line_color = axis.major_tick_line_color = LINE
            axis.minor_tick_line_color = None
            axis.major_tick_in, axis.major_tick_out = 0, 4
            axis.major_label_text_font = axis.axis_label_text_font = FONT
            axis.major_label_text_font_size, axis.axis_label_text_font_size = "11px", "12px"
            axis.major_label_text_color, axis.axis_label_text_color = GREY, INK
            axis.axis_label_text_font_style = "normal"
        if self.xaxis.kind != "CategoricalAxis":  # names are all written
            self.xaxis.ticker.desired_num_ticks = 5

    def legend(self, entries: Sequence[tuple[str, Sequence[Any]]]) -> None:
        """Put a legend above, in lines where one has no room: a click hides what an entry stands for."""
        items = [LegendItem(label=Value(text), renderers=list(drawn)) for text, drawn in entries if drawn]
        if not items:
            return
        long = sum(CHARACTER * len(item.label.value) + ENTRY for item in items) > LEGEND_ROOM
        self.height += LEGEND_LINE * (len(items) - 1) * long
        found = Legend(
            items=items,
            orientation="vertical" if long else "horizontal",
            label_text_font=FONT,
            label_text_font_size="11px",
            label_text_color=INK,
            background_fill_color=None,
            border_line_color=None,
            click_policy="hide",
            padding=0,
            margin=2,
            spacing=2 if long else 12,
            glyph_width=16,
            glyph_height=12,
            inactive_fill_color=WHITE,
        )
        self.add_layout(found, "above")

    def hover(self, renderer: Any, *lines: tuple[str, str], vertical: bool = False) -> None:
        """Show numbers where the pointer is: words of ours, and columns by their keys."""
        mode = {"mode": "vline", "line_policy": "nearest", "point_policy": "snap_to_data"} if vertical else {}
        self.add_tools(HoverTool(renderers=[renderer], tooltips=list(lines), **mode))

    def level(self, place: float, *, color: str = INK, vertical: bool = False, dash: str = "solid") -> None:
        """Draw a line across."""
        dimension = "height" if vertical else "width"
        self.add_layout(Span(dimension=dimension, location=place, line_color=color, line_width=1, line_dash=dash))

    def shade(self, color: str, alpha: float = 0.18, **sides: float) -> None:
        """Shade a part, by its ``left``, ``right``, ``bottom`` and ``top``."""
        self.add_layout(BoxAnnotation(**sides, fill_color=color, fill_alpha=alpha, line_color=None))

    def reach(self, *, x: tuple[float, float] | None = None, y: tuple[float, float] | None = None) -> None:
        """Fix what is shown at first."""
        if x is not None:
            self.x_range = Range1d(*x)
        if y is not None:
            self.y_range = Range1d(*y)

    def whole(self, axis: str = "x") -> None:
        """Have an axis of counted things carry whole numbers only."""
        found = self.xaxis if axis == "x" else self.yaxis
        found.ticker = BasicTicker(min_interval=1, desired_num_ticks=6)

    def bare(self) -> None:
        """Leave out the ordinate of a density, which says nothing."""
        self.yaxis.visible, self.ygrid.grid_line_color = False, None
        self.y_range.start = 0


def plain(text: str) -> str | BokehSpec:
    """Return a text that is drawn as it is written, also where a name looks like mathematics."""
    return PlainText(text=text) if any(mark in text for mark in _TEX) else text


def wrapped(text: str) -> str:
    """Return a text in lines that a telephone has room for."""
    return "\n".join(textwrap.wrap(text, LONGEST_LINE))


def normal(places: Floats, mean: float, std: float) -> Floats:
    """Return the density of a normal distribution."""
    return np.asarray(np.exp(-0.5 * ((places - mean) / std) ** 2) / (std * math.sqrt(2.0 * math.pi)))


def named(name: str, units: Units | None) -> str:
    """Return the label of a parameter or an output."""
    return label(name, (units or {}).get(name))


def below_each_other(plots: Sequence[Any], *, dense: bool = False) -> Any:
    """Return figures below each other with one toolbar; ``dense`` ones stand close to each other."""
    for plot in plots if dense else ():
        plot.min_border_top = plot.min_border_bottom = 4
        plot.xaxis.ticker.desired_num_ticks = 8
    return grid([[plot] for plot in plots])
