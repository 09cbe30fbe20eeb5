"""Names beside rows or above them, and legends in one line or in several: what a telephone has room for."""

from __future__ import annotations

import numpy as np
import pytest
from bokeh.models import LabelSet, Legend

from fmuid.reports.interactive import style
from fmuid.reports.interactive.bokeh_spec import live
from tests.support.live_figures import comparison

LONG = "the sensor of the coil's current has an offset that was not there before"


def test_short_names_stand_beside_their_rows() -> None:
    plot = comparison.bars(["a", "b"], np.array([0.5, 2.0]), "error")
    assert plot.yaxis.visible
    assert not [each for each in plot.center if isinstance(each, LabelSet)]


def test_long_names_stand_whole_above_their_bars() -> None:
    plot = comparison.bars(["a", LONG], np.array([0.5, 2.0]), "error")
    (labels,) = [each for each in plot.center if isinstance(each, LabelSet)]
    assert not plot.yaxis.visible
    first, second = labels.source.data["text"]
    assert (first, second.replace("\n", " ")) == ("a", LONG)
    assert max(map(len, second.split("\n"))) <= style.LONGEST_LINE
    assert list(labels.source.data["name"]) == plot.y_range.factors[::-1] == ["a", LONG]
    row = (plot.height - 80) / 2
    below, lines = plot.renderers[0].glyph.height * row / 2, 2
    assert labels.y_offset > below
    assert labels.y_offset + 14 * lines < row - below


@pytest.mark.parametrize(("texts", "kept"), [(["prior", "both"], "horizontal"), (["x" * 30, "y" * 30], "vertical")])
def test_a_legend_without_room_in_one_line_has_several(texts: list[str], kept: str) -> None:
    plot = style.Panel(height=200)
    plot.legend([(text, [plot.line([0.0, 1.0], [0.0, 1.0])]) for text in texts])
    (made,) = live([plot])
    (legend,) = [each for each in made.above if isinstance(each, Legend)]
    assert legend.orientation == kept
    assert made.height == 200 + (kept == "vertical") * style.LEGEND_LINE
