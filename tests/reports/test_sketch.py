"""Figures as data: Bokeh reads back what is written, and has the same models made of it as of the figures."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bokeh.core.property.vectorization import Field, Value
from bokeh.document import Document
from bokeh.model import Model

from fmuid.reports.interactive import bokeh_spec as sketch
from fmuid.reports.interactive import estimates, fit, style
from tests.support import records


def plain(value: Any, numbers: dict[str, int]) -> Any:
    """Return a model with every property that it has, defaults too, models numbered as they come."""
    match value:
        case Model():
            if value.id in numbers:
                return numbers[value.id]
            numbers[value.id] = len(numbers)
            told = {name: plain(each, numbers) for name, each in sorted(value.properties_with_values().items())}
            return [type(value).__name__, told]
        case Field(field=field, transform=transform):
            return [field, plain(transform, numbers)] if isinstance(transform, Model) else field
        case Value(value=inner):
            return inner
        case dict():
            return {key: plain(each, numbers) for key, each in value.items()}
        case list() | tuple() | np.ndarray() | pd.Series():
            return [plain(each, numbers) for each in value]
    return repr(float(value)) if isinstance(value, (int, float, np.number)) else value


def every_glyph() -> Any:
    plot = style.Panel("x", "y", x_axis_type="log")
    source = sketch.ColumnDataSource(
        {"a": np.arange(3.0), "b": np.array([1.0, math.nan, math.inf]), "n": ["u", "v", "w"]}
    )
    looks = {"line_color": style.BLUE, "fill_color": style.RED}
    plot.patch("a", "b", source=source, **looks)
    plot.step("a", "b", source=source, line_dash="dashed", mode="after")
    plot.varea("a", "b", "b", source=source, fill_alpha=0.5)
    plot.quad("a", 2.0, np.float64(3.0), 0, source=source, **looks)
    plot.rect("a", "b", 0.9, 0.9, source=source, **looks)
    plot.segment("a", "b", "a", 1.0, source=source, line_width=2)
    plot.scatter([1.0, 2.0], pd.Series([2.0, 3.0]), size=4, marker="x", angle=1.0)
    plot.text("a", "b", "n", source=source, text_font=style.FONT, text_color=sketch.Field("n"))
    plot.hover(plot.line("a", "b", source=source, line_color=style.BLUE), ("x", "@a"), vertical=True)
    return plot


def figures() -> list[sketch.BokehSpec]:
    names = style.Panel(y_range=sketch.FactorRange(factors=["u", "v"]))
    names.hbar(["u", "v"], 0.5, [1.0, 2.0], 0.0, fill_color=style.GREY)
    matrix = pd.DataFrame([[1.0, math.nan], [math.nan, 1.0]], ["R", "L"], ["R", "L"])
    return [
        every_glyph(),
        names,
        estimates.correlation(matrix),
        fit.fit(records.record(outputs=1)),
    ]


def test_bokeh_reads_what_is_written() -> None:
    """Its own models, made of the JSON and made of the figures, are alike in every property."""
    drawn = figures()
    roots, ids = sketch.written(drawn)
    made = Document()
    empty = made.to_json(deferred=False)
    read = Document.from_json(json.loads(json.dumps({**empty, "roots": roots}, allow_nan=False)))
    for each in sketch.live(drawn):
        made.add_root(each)
    assert [root.id for root in read.roots] == ids
    for one, other in zip(read.roots, made.roots, strict=True):
        assert plain(one, {}) == plain(other, {})


def test_two_pages_never_share_a_number() -> None:
    """In a notebook they are in one document."""
    drawn = figures()
    assert not set(sketch.written(drawn)[1]) & set(sketch.written(drawn)[1])


def test_a_misspelt_property_is_found() -> None:
    plot = style.Panel()
    plot.xaxis.axis_labl = "x"
    with pytest.raises(AttributeError, match="axis_labl"):
        sketch.live([plot])


def test_a_grid_has_one_toolbar_that_switches_all_its_plots() -> None:
    plots = [style.Panel(), style.Panel()]
    hovered = [plot.line([1.0], [2.0]) for plot in plots]
    for plot, line in zip(plots, hovered, strict=True):
        plot.hover(line, ("x", "@x"))
    (grid,) = sketch.live([sketch.grid([[plots[0]], [plots[1]]])])
    names: list[Any] = [type(tool).__name__ for tool in grid.toolbar.tools]
    assert names == ["ToolProxy", "ToolProxy", "SaveTool", "ToolProxy"]
    assert grid.toolbar.active_drag is grid.toolbar.tools[0]
    assert all(plot.toolbar_location is None for plot, *_ in grid.children)
