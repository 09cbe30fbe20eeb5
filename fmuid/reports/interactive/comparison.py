"""What stands beside each other: results by their criteria and estimates, excitations, what parameters do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import extremes
from fmuid.formatting import label
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, Range1d
from fmuid.reports.interactive.rows import rows_of
from fmuid.reports.interactive.style import (
    AMBER,
    BLUE,
    GREY,
    MAX_OUTPUTS,
    MAX_PARAMETERS,
    MAX_ROWS,
    RED,
    Panel,
    Units,
    below_each_other,
    named,
)

# Bars of a figure; more make one that nobody reads.
MAX_BARS = 24
# Lines of a figure: those that are largest. More cannot be told apart.
LOOKS = tuple((color, dash) for dash in ("solid", "dashed") for color in (BLUE, RED, AMBER, GREY))


def bars(names: list[str], values: Floats, text: str) -> Any:
    """Draw a bar for each name, in their order, the first of which is red: the least is the best.

    Parameters
    ----------
    names : list of str
        Of results or excitations, the best first.
    values : (n,) array
        NaN where there is none.
    text : str
        What they are.
    """
    names, values = names[:MAX_BARS], values[:MAX_BARS]
    plot, bar = rows_of(names, text)
    best = np.arange(len(names)) == 0
    for mine, color in ((best, RED), (~best, BLUE)):
        if mine.any():
            source = ColumnDataSource({"name": list(np.array(names)[mine]), "v": values[mine]})
            drawn = plot.hbar("name", bar, "v", 0.0, source=source, fill_color=color, line_color=None)
            plot.hover(drawn, ("", "@name"), ("value", "@v{0.0000}"))
    plot.x_range.start = 0
    return plot


def estimates(table: pd.DataFrame) -> list[Any]:
    """Draw the estimates that several results have of a parameter in the same unit, with their intervals.

    Parameters
    ----------
    table : DataFrame
        ``result``, ``parameter``, ``unit``, ``value``, ``lower`` and ``upper``; without a unit it is as the first one
        that has one says.
    """
    plots = []
    known = table["unit"].fillna("").replace("", None)
    units = known.fillna(known.groupby(table["parameter"]).transform("first")).fillna("")
    for (name, unit), rows in list(table.groupby([table["parameter"], units], sort=False))[:MAX_PARAMETERS]:
        if len(rows) < 2:
            continue
        factors = [str(each) for each in rows["result"]]
        plot, _ = rows_of(factors, label(str(name), str(unit)), head=90)
        data = {key: rows[key].to_numpy(np.float64) for key in ("value", "lower", "upper")}
        data = {key: np.where(np.isfinite(each), each, np.nan) for key, each in data.items()}
        source = ColumnDataSource({"name": factors, **data})
        plot.segment("lower", "name", "upper", "name", source=source, line_color=BLUE, line_width=3)
        dots = plot.scatter("value", "name", source=source, size=9, fill_color=BLUE, line_color=None)
        plot.hover(dots, ("value", "@value{0.000000}"), ("interval", "@lower{0.000000} to @upper{0.000000}"))
        plots.append(plot)
    return plots


def sensitivities(table: pd.DataFrame, units: Units | None = None) -> Any:
    """Draw θ ∂ŷ/∂θ (1.33) of each output over time, a line for each of the parameters that do most.

    Parameters
    ----------
    table : DataFrame
        ``time``, and ``output/parameter`` for each pair, as in ``sensitivities.csv``, of one experiment.
    units : mapping of str to str, optional
        Of the outputs.
    """
    pairs = [str(name) for name in table.columns if "/" in str(name)]
    outputs = list(dict.fromkeys(name.rpartition("/")[0] for name in pairs))[:MAX_OUTPUTS]
    plots: list[Any] = []
    for output in outputs:
        mine = [name for name in pairs if name.rpartition("/")[0] == output]
        values = table[mine].to_numpy(np.float64)
        largest = set(np.argsort(-np.nansum(values**2, axis=0), kind="stable")[: len(LOOKS)].tolist())
        values, mine = values[:, sorted(largest)], [mine[k] for k in sorted(largest)]
        kept = extremes(values, MAX_ROWS)
        data = {"t": table["time"].to_numpy(np.float64)[kept]}
        source = ColumnDataSource(data | {f"v{k}": values[kept, k].astype(np.float32) for k in range(len(mine))})
        last = output == outputs[-1]
        across = plots[0].x_range if plots else Range1d(*table["time"].iloc[[0, -1]].tolist())
        plot = Panel(x="time (s)" if last else "", y=named(output, units), height=210, x_range=across)
        entries = []
        for k, (name, (color, dash)) in enumerate(zip(mine, LOOKS, strict=False)):
            line = plot.line("t", f"v{k}", source=source, line_color=color, line_dash=dash, line_width=1.4)
            entries.append((name.rpartition("/")[2], [line]))
        plot.level(0.0)
        plot.legend(entries)
        plots.append(plot)
    return below_each_other(plots)
