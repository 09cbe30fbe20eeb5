"""A figure with a row for each of several names: beside the rows where all are short, else above them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, FactorRange, Field, LabelSet, Value
from fmuid.reports.interactive.style import FONT, INK, NAME_SIZE, Panel, wrapped

# Names of more characters leave the bars no room on a telephone.
LONGEST_BESIDE = 14
# Thickness of a bar, in rows.
BAR, BAR_BELOW = 0.55, 0.24
# Pixels of a row with its name beside it; of one below its name, and of each line of the name.
ROW, ROW_BELOW, ROW_LINE = 28, 20, 28


def rows_of(names: Sequence[str], x: str, *, head: int = 80, **more: Any) -> tuple[Any, float]:
    """Return an empty figure with a row for each name, the first on top, and how thick a bar is, in rows.

    Parameters
    ----------
    names : sequence of str
        Each once.
    x : str
        Label of the abscissa.
    head : int
        Pixels of what is above and below the rows.
    **more
        Of `Panel`.
    """
    across = FactorRange(factors=list(names)[::-1])
    if max(map(len, names), default=0) <= LONGEST_BESIDE:
        plot = Panel(x=x, height=head + ROW * len(names), y_range=across, **more)
        plot.yaxis.major_label_text_color = INK
        return plot, BAR
    texts = [wrapped(name) for name in names]
    row = ROW_BELOW + ROW_LINE * max(text.count("\n") + 1 for text in texts)
    plot = Panel(x=x, height=head + row * len(names), y_range=across, **more)
    plot.yaxis.visible, plot.min_border_left = False, 12
    labels = LabelSet(
        source=ColumnDataSource({"name": np.array(names, dtype=object), "text": texts}),
        x=Value(0),
        x_units="screen",
        y=Field("name"),
        y_offset=Value(0.5 * BAR_BELOW * row + 2),
        text=Field("text"),
        text_baseline=Value("bottom"),
        text_color=Value(INK),
        text_font=Value(FONT),
        text_font_size=Value(NAME_SIZE),
    )
    plot.add_layout(labels)
    return plot, BAR_BELOW
