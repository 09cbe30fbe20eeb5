"""A search: parameters, criterion and Marquardt's λ against iteration, noise variances against repetition, optima."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.formatting import has_unit, label
from fmuid.reports.interactive.bokeh_spec import BokehSpec, ColumnDataSource, Field, Range1d
from fmuid.reports.interactive.style import AMBER, BLUE, GREY, INK, MAX_PARAMETERS, RED, WHITE, Panel, Units, named

if TYPE_CHECKING:
    import pandas as pd

# Variances and criteria are drawn logarithmically where they range over this ratio.
WIDE_RANGE = 5.0
# Diameters of the points of optima, from few fits to many, in pixels.
LEAST_POINT, MOST_POINT = 6.0, 16.0


def parameters(trace: pd.DataFrame, estimates: pd.DataFrame) -> list[Any]:
    """Draw each parameter against the iterations of the search, with its interval and its prior as bands.

    Parameters
    ----------
    trace : DataFrame
        As in ``trace.csv``. Rejected trials are left out: a parameter stays where it is during them.
    estimates : DataFrame
        As in ``estimates.csv``.
    """
    accepted = trace[trace["accepted"].astype(bool)]
    iterations, shared = accepted["iteration"].to_numpy(np.float64), _iterations(trace)
    plots = []
    for row in estimates.iloc[:MAX_PARAMETERS].to_dict("records"):
        values = accepted[str(row["parameter"])].to_numpy(np.float64)
        plot = Panel(x="iteration", y=label(str(row["parameter"]), row["unit"]), height=220, x_range=shared)
        half = 2.0 * float(row["prior_std"])
        if math.isfinite(half):
            plot.shade(AMBER, bottom=row["prior_mean"] - half, top=row["prior_mean"] + half)
        if math.isfinite(row["lower"]) and math.isfinite(row["upper"]):
            plot.shade(BLUE, bottom=row["lower"], top=row["upper"])
        plot.level(float(row["value"]), color=BLUE, dash="dashed")
        source = ColumnDataSource({"k": iterations, "v": values, "c": accepted["criterion"]})
        plot.line("k", "v", source=source, line_color=BLUE, line_width=1.8)
        dots = plot.scatter("k", "v", source=source, size=6, fill_color=BLUE, line_color=None)
        plot.hover(dots, ("iteration", "@k"), ("value", "@v{0.000000}"), ("criterion", "@c{0.000}"))
        plot.scatter(iterations[:1], values[:1], size=8, fill_color=WHITE, line_color=INK, line_width=1.2)
        plot.reach(y=_room([*values, row["value"], row["prior_mean"]], row["std"]))
        plot.whole()
        plots.append(plot)
    return plots


def _iterations(trace: pd.DataFrame) -> BokehSpec:
    last = float(trace["iteration"].max())
    return Range1d(-0.03 * last - 0.15, 1.03 * last + 0.15)


def _room(values: list[float], std: float) -> tuple[float, float]:
    """Return limits around values; of a parameter that did not move, around its standard deviation."""
    known = [value for value in values if math.isfinite(value)]
    low, high = min(known), max(known)
    still = 2.5 * std if math.isfinite(std) and std > 0 else 0.05 * abs(low) or 1.0
    room = 0.12 * (high - low) or still
    return low - room, high + room


def criterion(trace: pd.DataFrame) -> list[Any]:
    """Draw the criterion against the iteration, and Marquardt's λ where the search needed any; crosses are rejected.

    Parameters
    ----------
    trace : DataFrame
        As in ``trace.csv``. Its rounds use different noise variances, so that their criteria cannot be compared: each
        has its own line.
    """
    shared = _iterations(trace)
    found = [_curve(trace, "criterion", "criterion", shared)]
    damped = trace[trace["lambda"] > 0]
    if len(damped):
        found.append(_curve(damped, "lambda", "Marquardt's λ, where it is not 0", shared))
    return found


def _curve(trace: pd.DataFrame, column: str, text: str, shared: BokehSpec) -> Any:
    plot = Panel(x="iteration", y=text, height=220, x_range=shared, y_axis_type="log")
    lines, dots, crosses = [], [], []
    for number, (_, part) in enumerate(trace.groupby("round")):
        taken = part["accepted"].to_numpy(bool)
        data = {"k": part["iteration"], "v": part[column]}
        source = ColumnDataSource({key: values[taken] for key, values in data.items()})
        lines.append(plot.line("k", "v", source=source, line_color=BLUE, line_width=1.8))
        dots.append(plot.scatter("k", "v", source=source, size=6, fill_color=BLUE, line_color=None))
        plot.hover(dots[-1], ("iteration", "@k"), (column, "@v{0.0000}"))
        refused = ~taken & np.isfinite(part[column].to_numpy(np.float64))
        if refused.any():
            away = ColumnDataSource({key: values[refused] for key, values in data.items()})
            crosses.append(plot.scatter("k", "v", source=away, marker="x", size=8, line_color=RED, line_width=1.6))
        if number and column == "criterion":
            plot.level(float(part["iteration"].iloc[0]), color=AMBER, vertical=True, dash="dashed")
    plot.legend([("accepted", [*lines, *dots]), ("rejected trial", crosses)])
    plot.whole()
    return plot


def rounds(found: pd.DataFrame, units: Units | None = None) -> list[Any]:
    """Draw each output's noise variance against the repetition of the search.

    The first value, at 0, is the one that the search began with; after each round stands what its residual gave.

    Parameters
    ----------
    found : DataFrame
        As in ``rounds.csv``.
    units : mapping of str to str, optional
        Of the outputs.
    """
    outputs = [str(name).removeprefix("used.") for name in found.columns if str(name).startswith("used.")]
    plots = []
    for output in outputs[:MAX_PARAMETERS]:
        used, estimated = (found[f"{kind}.{output}"].to_numpy(np.float64) for kind in ("used", "estimated"))
        values = np.array([used[0], *estimated])
        unit = (units or {}).get(output)
        text = label(f"noise variance of {output}", f"{unit}²" if has_unit(unit) else None)
        wide = values.max() > WIDE_RANGE * values.min() > 0
        plot = Panel(x="round of the search", y=text, height=220, y_axis_type="log" if wide else "linear")
        source = ColumnDataSource({"k": np.arange(values.size), "v": values})
        plot.line("k", "v", source=source, line_color=BLUE, line_width=1.8)
        dots = plot.scatter("k", "v", source=source, size=6, fill_color=BLUE, line_color=None)
        plot.hover(dots, ("round", "@k"), ("variance", "@v{0.00000000}"))
        plot.whole()
        plots.append(plot)
    return plots


def optima(table: pd.DataFrame, units: Units | None = None) -> list[Any]:
    """Draw the criterion of the optima found over each parameter; the larger a point, the more fits ended there.

    Parameters
    ----------
    table : DataFrame
        As in ``optima.csv``, the best first.
    units : mapping of str to str, optional
        Of the parameters.
    """
    names = [str(name) for name in table.columns.drop(["criterion", "hits", "converged"])][:MAX_PARAMETERS]
    sure, values = table["converged"].to_numpy(bool), table["criterion"].to_numpy(np.float64)
    hits = table["hits"].to_numpy(np.float64)
    sizes = LEAST_POINT + (MOST_POINT - LEAST_POINT) * hits / hits.max()
    kind = "log" if values.max() > WIDE_RANGE * values.min() > 0 else "linear"
    plots = []
    for name in names:
        plot = Panel(x=named(name, units), y="criterion", height=220, y_axis_type=kind)
        columns = {"x": table[name].to_numpy(np.float64), "c": values, "s": sizes, "n": hits}
        best = np.arange(len(table)) == 0
        shown = [_points(plot, columns, sure & ~best, BLUE), _points(plot, columns, ~sure, RED, marker="x")]
        shown.append(_points(plot, columns, best, AMBER))
        texts = ("optimum", "not converged", "best")
        plot.legend([(text, [one] if one else []) for text, one in zip(texts, shown, strict=True)])
        plots.append(plot)
    return plots


def _points(plot: Any, columns: dict[str, Floats], rows: Any, color: str, marker: str = "circle") -> Any:
    if not rows.any():
        return None
    source = ColumnDataSource({key: values[rows] for key, values in columns.items()})
    line = GREY if marker == "circle" else color
    found = plot.scatter("x", "c", size=Field("s"), source=source, marker=marker, fill_color=color, line_color=line)
    plot.hover(found, ("value", "@x{0.000000}"), ("criterion", "@c{0.000}"), ("searches", "@n"))
    return found
