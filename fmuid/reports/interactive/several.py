"""Several results side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fmuid.estimation import Result
from fmuid.reports.interactive.sketch import ColumnDataSource, FactorRange
from fmuid.reports.interactive.style import BLUE, INK, MAX_PARAMETERS, Units, hover, named, panel


def side_by_side(results: Mapping[str, Result], units: Units | None = None) -> list[Any]:
    """Draw the estimates of each parameter with their 95 % intervals, a line a result.

    Parameters
    ----------
    results : mapping of str to Result
        By what they are called.
    units : mapping of str to str, optional
        Of the parameters.
    """
    names = list(dict.fromkeys(name for each in results.values() for name in each.names))[:MAX_PARAMETERS]
    plots = []
    for name in names:
        rows = []
        for text, result in results.items():
            if name in result.names:
                i = result.names.index(name)
                low, high = (float(end) for end in result.intervals(0.95).iloc[i])
                rows.append((text, float(result.values[i]), float(result.std[i]), low, high))
        texts, *numbers = zip(*rows, strict=True)
        keys = ("value", "std", "low", "high")
        columns = {key: np.array(each) for key, each in zip(keys, numbers, strict=True)}
        known = np.isfinite(columns["std"])
        columns |= {key: np.where(known, columns[key], np.nan) for key in ("low", "high")}
        height = 80 + 28 * len(texts)
        plot = panel(x=named(name, units), height=height, y_range=FactorRange(factors=list(texts)[::-1]))
        source = ColumnDataSource({"result": list(texts), **columns})
        plot.segment("low", "result", "high", "result", source=source, line_color=BLUE, line_width=2)
        dots = plot.scatter("value", "result", source=source, size=8, fill_color=BLUE, line_color=None)
        hover(plot, dots, ("result", "@result"), ("value", "@value{0.000000}"), ("std", "@std{0.000000}"))
        plot.yaxis.major_label_text_color = INK
        plots.append(plot)
    return plots
