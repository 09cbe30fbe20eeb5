"""Figures for print: what was painted is read back from matplotlib's axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from fmuid.reports.figure_files import FORMATS, KINDS, clear_figures
from fmuid.reports.figures import matplotlib_renderer as paint
from fmuid.reports.figures import style
from fmuid.reports.interactive import bokeh_spec as sketch
from fmuid.reports.interactive import comparison, estimates, fit, residuals, search
from fmuid.reports.interactive.style import BLUE, GREY, RED, Panel
from fmuid.simulation.output_fit import OutputFit
from tests.support.records import record
from tests.support.records import search as searched


def axes_of(figure: Figure) -> list[Any]:
    """Return all axes of a figure, those of its parts too."""
    return [axes for part in figure.subfigs for axes in part.axes]


def painted(plot: Any) -> Any:
    """Return the axes of one plot."""
    (axes,) = axes_of(paint.printed([plot], 1))
    return axes


def test_every_glyph_is_where_its_columns_say() -> None:
    plot = Panel(x="t (s)", y="y (A)")
    x, y = np.array([1.0, 2.0, 4.0]), np.array([3.0, np.nan, 5.0])
    plot.line(x, y, line_color=BLUE, line_width=2.0, line_dash="dashed")
    plot.scatter(x, y, size=4, fill_color=RED, line_color=None)
    plot.segment(x, x, y, y, line_color=GREY)
    plot.varea(x, x - 1, x + 1, fill_color=BLUE, fill_alpha=0.2)
    plot.quad(x, x + 1, y, 0, fill_color=RED, fill_alpha=0.5, line_color=None)
    axes = painted(plot)
    (line,) = axes.get_lines()
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([x, y]))
    assert to_hex(line.get_color()) == BLUE
    dots, segments, area, boxes = axes.collections
    np.testing.assert_array_equal(np.ma.getdata(dots.get_offsets())[[0, 2]], [[1, 3], [4, 5]])
    assert [each.tolist() for each in segments.get_segments()] == [[[1, 1], [3, 3]], [[4, 4], [5, 5]]]
    assert area.get_datalim(axes.transData).bounds == (1, 0, 3, 5)
    np.testing.assert_array_equal(boxes.get_paths()[0].vertices[:4], [[1, 0], [2, 0], [2, 3], [1, 3]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("t (s)", "y (A)")


def test_rows_of_names_with_bars() -> None:
    axes = painted(comparison.bars(["a", "b"], np.array([1.0, 3.0]), "error"))
    assert [text.get_text() for text in axes.get_yticklabels()] == ["b", "a"]  # from below
    best, other = (each.get_paths()[0].get_extents() for each in axes.collections)
    assert [best.x1, other.x1] == [1.0, 3.0]
    assert best.y0 > other.y1
    long = painted(comparison.bars(["a name too long for a telephone", "b"], np.array([1.0, 3.0]), "error"))
    assert [text.get_text() for text in long.texts] == ["a name too long for a telephone", "b"]


def test_ranges_scales_spans_and_legends() -> None:
    trace, table = searched()
    first, *_ = (painted(plot) for plot in search.parameters(trace, table))
    path = first.get_lines()[0].get_xydata()
    np.testing.assert_array_equal(path, [[0, 5], [1, 4.5], [3, 4.1], [4, 4]])
    band = first.patches[-1].get_extents().transformed(first.transData.inverted())
    assert (band.y0, band.y1) == pytest.approx((3.8, 4.2))
    criterion, damping = (painted(plot) for plot in search.criterion(trace))
    assert [axes.get_yscale() for axes in (criterion, damping)] == ["log", "log"]
    assert [text.get_text() for text in criterion.get_legend().get_texts()] == ["accepted", "rejected trial"]
    assert [float(line.get_xdata()[0]) for line in criterion.get_lines() if line.get_linestyle() == "--"] == [4.0]


def test_a_line_beyond_what_is_drawn_does_not_move_it() -> None:
    plot = Panel()
    line = plot.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), line_color=BLUE)
    plot.level(100.0)
    plot.legend([("a $name$", [line])])
    axes = painted(plot)
    assert axes.get_ylim()[1] < 1.2
    assert axes.get_legend().get_texts()[0].get_text() == r"a \$name\$"  # no mathematics


def test_shades_are_those_of_the_page() -> None:
    """The diagonal of the correlation is the last colour, what is not known is grey."""
    matrix = pd.DataFrame([[1.0, np.nan], [np.nan, 1.0]], index=["a", "b"], columns=["a", "b"])
    (cells,) = painted(estimates.correlation(matrix)).collections
    assert {to_hex(color) for color in cells.get_facecolor()} == {estimates.BLUE_RED[-1], "#bbbbbb"}
    scale = sketch.LogColorMapper(palette=["#000000", "#ffffff"], low=1.0, high=100.0, nan_color="#ff0000")
    assert [to_hex(each) for each in paint.shades(scale).to_rgba(np.array([2.0, 50.0, np.nan]))] == [
        "#000000",
        "#ffffff",
        "#ff0000",
    ]


def test_a_fit_and_its_zoom() -> None:
    """Beside each other, the residual below each output; the zoom has the rows of the stretch alone."""
    given = record(samples=2000)
    rows = fit.zoom(given)
    figure = paint.printed([fit.fit(given), fit.fit(given, rows=rows)], 2, "run")
    axes = axes_of(figure)
    assert len(axes) == 2 * 4
    assert axes[4].get_xlim() == (given.times[rows.start], given.times[rows.stop - 1])
    np.testing.assert_array_equal(axes[4].collections[0].get_offsets()[:, 0], given.times[rows])
    assert figure.get_suptitle() == "run"


def test_zoom_finds_the_step() -> None:
    times = np.arange(2000.0)
    simulated = np.where(times > 1200, 1 - np.exp(-(times - 1200) / 20), 0.0)[:, None]
    given = OutputFit("run", times, ("y",), (None,), simulated, simulated, np.ones((2000, 1), bool))
    found = fit.zoom(given)
    assert found.start <= 1201 < found.stop
    assert found.stop - found.start == fit.ZOOM_SAMPLES
    short = OutputFit("run", times[:50], ("y",), (None,), simulated[:50], simulated[:50], np.ones((50, 1), bool))
    assert fit.zoom(short) == slice(0, 50)


def test_zoom_ignores_what_does_not_count() -> None:
    simulated, counted = np.zeros((2000, 1)), np.ones((2000, 1), bool)
    simulated[10], simulated[1500], counted[:100] = 100.0, 1.0, False
    found = fit.zoom(OutputFit("run", np.arange(2000.0), ("y",), (None,), simulated, simulated, counted))
    assert found.start <= 1500 < found.stop


def test_save_replaces_the_figures_of_an_earlier_run(tmp_path: Path) -> None:
    for kind in KINDS:
        for form in FORMATS:
            (tmp_path / f"{kind}-2.{form}").write_text("old")
    (tmp_path / "mine.png").write_text("the user's")
    clear_figures(tmp_path)
    paths = style.save({"fit": paint.printed([fit.fit(record())], 1)}, tmp_path)
    assert [path.name for path in paths] == ["fit.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.png", "mine.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "head"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_figures_for_print_are_the_same_file_each_time(tmp_path: Path, kind: str, head: bytes) -> None:
    once, again = (style.save({"fit": paint.printed([fit.fit(record())], 1)}, tmp_path / n, kind)[0] for n in "ab")
    assert once.name == f"fit.{kind}"
    assert once.read_bytes().startswith(head)
    assert once.read_bytes() == again.read_bytes()


def test_the_least_that_an_experiment_can_have(tmp_path: Path) -> None:
    """Two samples are drawn without warnings."""
    values = np.ones((2, 1))
    tiny = OutputFit("tiny", np.array([0.0, 1.0]), ("y",), (None,), values, 0 * values, np.ones((2, 1), bool))
    drawn = paint.printed([fit.fit(tiny), residuals.histogram(np.array([0.1, -0.2]), "y")], 2)
    assert len(style.save({"fit": drawn}, tmp_path)) == 1
