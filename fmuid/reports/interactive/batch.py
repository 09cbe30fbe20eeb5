"""A batch: estimates over the cases, how they are distributed, spread against stated std, over settings, failures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from fmuid.arrays import Floats
from fmuid.batches import INTERVAL_STDS, Columns
from fmuid.reports.interactive.rows import rows_of
from fmuid.reports.interactive.sketch import ColumnDataSource, FactorRange
from fmuid.reports.interactive.style import (
    AMBER,
    BLUE,
    GREY,
    INK,
    MAX_DOTS,
    MAX_PARAMETERS,
    RED,
    WHITE,
    Units,
    bare,
    hover,
    legend,
    level,
    named,
    panel,
    reach,
)
from fmuid.reports.thinning import evenly

# Up to so many cases each has its interval.
MAX_BARS = 60
# Bars of a histogram, from few cases to many.
MIN_BINS, MAX_BINS = 8, 60
# A normal curve is drawn so many standard deviations wide.
SHOWN_STDS = 3.2
# Outlines of different settings in one figure; more cannot be told apart.
LOOKS = ((BLUE, "solid"), (RED, "solid"), (AMBER, "solid"), (GREY, "dashed"))
MAX_FAILURES, LONGEST = 12, 70
"""Kinds of failures drawn, and how much of their messages."""


def parameters_of(frame: pd.DataFrame) -> list[str]:
    """Return the parameters that any case has an estimate of, `MAX_PARAMETERS` at most."""
    names = Columns.of(frame).parameters
    return [name for name in names if np.isfinite(frame[f"value.{name}"].to_numpy(np.float64)).any()][:MAX_PARAMETERS]


def over_cases(frame: pd.DataFrame, truth: Mapping[str, float], units: Units) -> list[Any]:
    """Draw each parameter over the cases that converged, with intervals of 95 % where there are few.

    Parameters
    ----------
    frame : DataFrame
        A row a case.
    truth : mapping of str to float
    units : mapping of str to str
    """
    good, plots = frame[frame["status"].astype(str) == "converged"], []
    some = good.iloc[evenly(len(good), MAX_DOTS)] if len(good) else good
    for name in parameters_of(good):
        plot = panel(x="case", y=named(name, units), height=210)
        value, std = (some[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        half = INTERVAL_STDS * std if len(some) <= MAX_BARS else np.full(len(some), np.nan)
        data = {"case": some["case"], "value": value, "low": value - half, "high": value + half, "std": std}
        source, entries = ColumnDataSource(data), []
        if np.isfinite(half).any():
            bars = plot.segment("case", "low", "case", "high", source=source, line_color=BLUE, line_alpha=0.5)
            entries.append(("interval of 95 %", [bars]))
        size = 6 if len(some) <= MAX_BARS else 3
        dots = plot.scatter("case", "value", source=source, size=size, fill_color=BLUE, line_color=None)
        hover(plot, dots, ("case", "@case"), ("value", "@value{0.000000}"), ("std", "@std{0.000000}"))
        legend(plot, [("estimate", [dots]), *entries])
        _truth(plot, name, truth)
        plots.append(plot)
    return plots


def _truth(plot: Any, name: str, truth: Mapping[str, float], *, vertical: bool = False) -> None:
    if name in truth:
        level(plot, float(truth[name]), color=AMBER, vertical=vertical)


def distributions(found: pd.DataFrame, truth: Mapping[str, float], units: Units, *, repeated: bool) -> list[Any]:
    """Draw how the estimates are distributed, and the normal curve that their stated std promises.

    Parameters
    ----------
    found : DataFrame
        One case a data set (`fmuid.batches.estimates`).
    truth : mapping of str to float
    units : mapping of str to str
    repeated : bool
        Whether the cases repeat one experiment: only then is there anything to hold the std against.
    """
    plots, groups = [], _groups(found)
    for name in parameters_of(found):
        value, std = (found[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        low, high = _limits(value, truth.get(name))
        plot, entries = panel(x=named(name, units), height=220), []
        for (text, rows), (color, dash) in zip(groups, LOOKS, strict=False):
            edges, density = _histogram(value[rows], low, high)
            if len(groups) == 1:
                shape = plot.quad(
                    edges[:-1], edges[1:], density, 0, fill_color=color, fill_alpha=0.45, line_color=WHITE
                )
            else:
                shape = plot.step(
                    edges, [*density, 0.0], mode="after", line_color=color, line_dash=dash, line_width=1.6
                )
            entries.append((text, [shape]))
        stated = math.sqrt(np.nanmean(std**2)) if np.isfinite(std).any() else 0.0
        if repeated and stated > 0:
            centre = float(truth.get(name, float(np.nanmean(value))))
            grid = np.linspace(low, high, 161)
            curve = np.exp(-0.5 * ((grid - centre) / stated) ** 2) / (stated * math.sqrt(2.0 * math.pi))
            entries.append(("as the stated std says", [plot.line(grid, curve, line_color=INK, line_width=1.4)]))
        _truth(plot, name, truth, vertical=True)
        bare(plot)
        legend(plot, entries)
        reach(plot, x=(low, high))
        plots.append(plot)
    return plots


def _groups(found: pd.DataFrame) -> list[tuple[str, Any]]:
    """Return text and rows of each combination of settings; all rows as one where these are too many."""
    names = [name for name in Columns.of(found).design if len(found[name].unique()) > 1]
    levels = list(found.groupby(names, sort=True).indices.items()) if names else []
    if not 1 < len(levels) <= len(LOOKS):
        return [("estimates", np.arange(len(found)))]
    texts = []
    for key, _ in levels:
        values: Any = key if isinstance(key, tuple) else (key,)
        pairs = zip(names, values, strict=True)
        texts.append(
            ", ".join(
                f"{name.removeprefix('set.')} = {value:.5g}" if isinstance(value, float) else f"{name} = {value}"
                for name, value in pairs
            )
        )
    return [(text, rows) for text, (_, rows) in zip(texts, levels, strict=True)]


def _limits(values: Floats, true: float | None) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, [0.001, 0.999]) if known.size else (0.0, 1.0)
    ends = [low, high, *([] if true is None else [true])]
    room = 0.08 * (max(ends) - min(ends)) or 0.05 * abs(low) or 1.0
    return float(min(ends) - room), float(max(ends) + room)


def _histogram(values: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    inside = values[(values >= low) & (values <= high)]
    count = min(MAX_BINS, max(MIN_BINS, round(2 * inside.size ** (1 / 3))))
    edges = np.linspace(low, high, count + 1)
    counts, _ = np.histogram(inside, bins=edges)
    return edges, counts / max(inside.size, 1) / (edges[1] - edges[0])


def spread(summary: pd.DataFrame) -> Any:
    """Draw the spread of each parameter against the std that the estimates state, and what chance makes of 1.

    Parameters
    ----------
    summary : DataFrame
        As in ``summary.csv``.
    """
    known = summary[np.isfinite(summary["ratio"].astype(float))].iloc[:MAX_PARAMETERS]
    names = [str(name) for name in known["parameter"]]
    plot, bar = rows_of(names, "spread over the cases / stated std")
    freedom = known["cases"].to_numpy(np.float64) - 1.0
    low, high = (np.sqrt(special.chdtri(freedom, beyond) / freedom) for beyond in (0.975, 0.025))
    ratio = known["ratio"].to_numpy(np.float64)
    source = ColumnDataSource({"name": names, "ratio": ratio, "low": low, "high": high})
    chance = plot.hbar("name", bar, "high", "low", source=source, fill_color=BLUE, fill_alpha=0.16, line_color=None)
    dots = plot.scatter("ratio", "name", source=source, size=9, fill_color=RED, line_color=None)
    hover(plot, dots, ("parameter", "@name"), ("spread / stated std", "@ratio{0.000}"))
    level(plot, 1.0, vertical=True)
    legend(plot, [("spread / stated std", [dots]), ("95 % of chance, where the std is right", [chance])])
    reach(plot, x=(0.0, 1.1 * float(max(ratio.max(initial=1.0), high.max(initial=1.0)))))
    return plot


def over_setting(found: pd.DataFrame, name: str, truth: Mapping[str, float], units: Units) -> list[Any]:
    """Draw the estimates of each parameter over what is set, and their mean at each value of it.

    Parameters
    ----------
    found : DataFrame
        One case a data set.
    name : str
        Column of the setting.
    truth : mapping of str to float
    units : mapping of str to str
    """
    variable, plots = name.removeprefix("set."), []
    number = found[name].dtype.kind in "fiu"
    factors = [] if number else sorted({str(each) for each in found[name]})
    for parameter in parameters_of(found):
        more: dict[str, Any] = {} if number else {"x_range": FactorRange(factors=factors)}
        text = named(variable, units) if number else variable
        plot = panel(x=text, y=named(parameter, units), height=220, **more)
        value = found[f"value.{parameter}"].to_numpy(np.float64)
        some, place = evenly(len(found), MAX_DOTS), found[name] if number else found[name].astype(str)
        source = ColumnDataSource({"x": place.to_numpy()[some], "y": value[some]})
        dots = plot.scatter("x", "y", source=source, size=4, fill_color=BLUE, fill_alpha=0.4, line_color=None)
        hover(plot, dots, ("setting", "@x"), ("estimate", "@y{0.000000}"))
        means = pd.Series(value).groupby(place.to_numpy()).mean()
        at = {"x": means.index.to_numpy(), "y": means.to_numpy()}
        drawn = [plot.scatter("x", "y", source=ColumnDataSource(at), size=8, fill_color=RED, line_color=None)]
        drawn += [plot.line("x", "y", source=ColumnDataSource(at), line_color=RED, line_width=1.4)] if number else []
        legend(plot, [("estimate", [dots]), ("mean", drawn)])
        _truth(plot, parameter, truth)
        plots.append(plot)
    return plots


def failures(table: pd.DataFrame) -> Any:
    """Draw how many cases have no estimate for which reason.

    Parameters
    ----------
    table : DataFrame
        As in ``failures.csv``, the most frequent first.
    """
    most = table.iloc[:MAX_FAILURES]
    texts = [f"{k + 1}. {str(each)[:LONGEST]}" for k, each in enumerate(most["message"])]
    plot, bar = rows_of(texts, "cases")
    for status, color in (("failed", RED), ("not converged", AMBER)):
        where = most["status"].astype(str).to_numpy() == status
        if where.any():
            data = {"text": np.array(texts)[where], "count": most["cases"].to_numpy()[where]}
            bars = plot.hbar("text", bar, "count", source=ColumnDataSource(data), fill_color=color, line_color=None)
            hover(plot, bars, ("cases", "@count"))
    plot.x_range.start = 0
    return plot
