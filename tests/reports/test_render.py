"""Charts on screen and in print: what Bokeh's library reads and what matplotlib paints is what the layers say."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bokeh.core.property.vectorization import Field, Value
from bokeh.document import Document
from bokeh.model import Model
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from fmuid.reports.chart import Axis, Chart, Layer, Shades, rows_of
from fmuid.reports.publish import FORMATS, KINDS, clear_figures
from fmuid.reports.render import matplotlib_renderer as paint
from fmuid.reports.render.bokeh_models import BokehSpec, live, written
from fmuid.reports.render.bokeh_renderer import drawing
from fmuid.reports.render.style import BLUE_RED, COLORS
from fmuid.reports.topics import fit
from fmuid.reports.topics.estimates import _matrix
from fmuid.simulation import OutputFit
from tests.support.charts import every_mark
from tests.support.records import record

T = np.array([1.0, 2.0, 4.0])


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
    return repr(float(value)) if isinstance(value, int | float | np.number) else value


def figure(grid: Any, **more: Any) -> Any:
    """Return Bokeh's model of a chart."""
    (found,) = live(drawing([grid]).figures, **more)
    return found


def test_bokeh_reads_what_is_written() -> None:
    """Its own models, made of the JSON and made of the charts, are alike in every property."""
    given = drawing([every_mark(), fit.fit_charts(record(outputs=1))]).figures
    roots, ids = written(given)
    made = Document()
    empty = made.to_json(deferred=False)
    read = Document.from_json(json.loads(json.dumps({**empty, "roots": roots}, allow_nan=False)))
    for each in live(given):
        made.add_root(each)
    assert [root.id for root in read.roots] == ids
    for one, other in zip(read.roots, made.roots, strict=True):
        assert plain(one, {}) == plain(other, {})
    assert not set(written(given)[1]) & set(ids)  # in a notebook two drawings are in one document
    with pytest.raises(AttributeError, match="axis_labl"):
        live([BokehSpec("LinearAxis", axis_labl="x")])


def test_names_never_become_columns_formats_or_mathematics() -> None:
    name = "@{t}$$x$${{safe}}<b>"
    data: dict[str, Any] = {"y": (name,), "x": T[:1]}
    plot = figure(rows_of((name,), Axis(name), [Layer("bars", data, label=name, hover=(("", "@y"), ("v", "@x{0.0}")))]))
    assert plot.below[0].axis_label.text == name
    assert name not in str([getattr(tool, "tooltips", "") for tool in plot.toolbar.tools])
    assert all(name not in renderer.data_source.data for renderer in plot.renderers)


def test_dark_page_has_the_twins_of_the_colors() -> None:
    chart = Chart(Axis("x"), Axis("y"), (Layer("line", {"x": T, "y": T}, label="a"),))
    light, dark = (figure(chart, dark=each).renderers[0].glyph.line_color for each in (False, True))
    assert light == COLORS["blue"] != dark


def axes_of(figure: Figure) -> list[Any]:
    """Return all axes of a figure, those of its parts too."""
    return [axes for part in figure.subfigs for axes in part.axes]


def painted(chart: Chart) -> Any:
    """Return the axes of one chart in print."""
    (axes,) = axes_of(paint.printed([chart], 1))
    return axes


def test_printed_marks_are_where_their_columns_say() -> None:
    y = np.array([3.0, np.nan, 5.0])
    layers = (
        Layer("line", {"x": T, "y": y}, width=2.0, dash="dashed"),
        Layer("points", {"x": T, "y": y}, "red", size=4),
        Layer("segments", {"x0": T, "y0": T, "x1": y, "y1": y}, "grey"),
        Layer("band", {"x": T, "y0": T - 1, "y1": T + 1}, alpha=0.2),
        Layer("cells", {"left": T, "right": T + 1, "bottom": 0.0, "top": y}, "red", alpha=0.5),
    )
    axes = painted(Chart(Axis("t (s)"), Axis("y (A)"), layers))
    (line,) = axes.get_lines()
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([T, y]))
    assert to_hex(line.get_color()) == COLORS["blue"]
    dots, segments, area, boxes = axes.collections
    np.testing.assert_array_equal(np.ma.getdata(dots.get_offsets())[[0, 2]], [[1, 3], [4, 5]])
    assert [each.tolist() for each in segments.get_segments()] == [[[1, 1], [3, 3]], [[4, 4], [5, 5]]]
    assert area.get_datalim(axes.transData).bounds == (1, 0, 3, 5)
    np.testing.assert_array_equal(boxes.get_paths()[0].vertices[:4], [[1, 0], [2, 0], [2, 3], [1, 3]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("t (s)", "y (A)")


def test_printed_shades_are_those_of_the_page() -> None:
    matrix = pd.DataFrame([[1.0, np.nan], [np.nan, 1.0]], index=["a", "b"], columns=["a", "b"])
    (cells,) = painted(_matrix(matrix)).collections
    assert {to_hex(color) for color in cells.get_facecolor()} == {BLUE_RED[-1], "#bbbbbb"}
    shades = Shades("blues", 1.0, 100.0, log=True, title="rise")
    value = np.array([1.0, math.nan, 100.0])
    data = {"left": T, "right": T + 1, "bottom": T, "top": T + 1, "value": value}
    axes, bar = axes_of(paint.printed([Chart(Axis(), Axis(), (Layer("cells", data, shades=shades),))], 1))
    assert [to_hex(color) for color in axes.collections[0].get_facecolor()] == ["#08306b", "#ffffff", "#f7fbff"]
    assert bar.get_ylabel() == "rise"


def made(simulated: Any, counted: Any = None) -> OutputFit:
    simulated = np.asarray(simulated, float)[:, None]
    counted = np.ones(simulated.shape, bool) if counted is None else counted
    return OutputFit("run", np.arange(float(len(simulated))), ("y",), (None,), simulated, simulated, counted)


def test_figures_replace_those_of_an_earlier_run(tmp_path: Path) -> None:
    for kind in KINDS:
        for form in FORMATS:
            (tmp_path / f"{kind}-2.{form}").write_text("old")
    (tmp_path / "mine.png").write_text("the user's")
    clear_figures(tmp_path)
    (path,) = paint.save({"fit": paint.printed([fit.fit_charts(record())], 1)}, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.png", "mine.png"]
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_figures_for_print_are_the_same_file_each_time(tmp_path: Path) -> None:
    chart = Chart(Axis("x"), Axis("y"), (Layer("line", {"x": T, "y": T}),))
    for kind, head in (("svg", b"<?xml"), ("pdf", b"%PDF")):
        once, again = (paint.save({"fit": paint.printed([chart], 1)}, tmp_path / n, kind)[0] for n in "ab")
        assert once.name == f"fit.{kind}" and once.read_bytes().startswith(head)
        assert once.read_bytes() == again.read_bytes()
