"""A batch: estimates over the cases, how they are distributed, spread against stated std, over settings, failures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.data import evenly
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource, FactorRange, Field
from fmuid.reports.interactive.rows import rows_of
from fmuid.reports.interactive.style import (
    AMBER,
    BLUE,
    GREY,
    INK,
    MAX_BARS,
    MAX_DOTS,
    MAX_PARAMETERS,
    RED,
    WHITE,
    Panel,
    Units,
    named,
    normal,
)
from fmuid.runs import INTERVAL_STDS, BatchColumns

# Bars of a histogram, from few cases to many.
MIN_BINS, MAX_BINS = 8, 60
# Cells of a figure of many estimates, across and up, and how full the one with the fewest is painted.
CELLS, PALEST = (90, 45), 0.12
# A normal curve is drawn so many standard deviations wide.
SHOWN_STDS = 3.2
# Fewer estimates than this make no histogram, they are drawn themselves; fewer at a setting have no spread.
LEAST_COUNTED, LEAST_REPEATED = 30, 3
# Values further than so many quartile distances from the middle half are outside the picture, which says so, if they
# are less than such a share of all.
OUTSIDE_QUARTILES, RARE_SHARE = 6.0, 0.05
# Tables that are named at the axis, and letters of a name that it has room for.
MAX_NAMED, LONGEST_LABEL = 25, 24
# Outlines of different settings in one figure; more cannot be told apart.
LOOKS = ((BLUE, "solid"), (RED, "solid"), (AMBER, "solid"), (GREY, "dashed"))
MAX_FAILURES, LONGEST = 12, 70
"""Kinds of failures drawn, and how much of their messages."""


def parameters_of(frame: pd.DataFrame) -> list[str]:
    """Return the parameters that any case has an estimate of, `MAX_PARAMETERS` at most."""
    names = BatchColumns.of(frame).parameters
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
    status, plots = frame["status"].to_numpy(str), []
    good = frame[status == "converged"]
    some = good.iloc[evenly(len(good), MAX_DOTS)] if len(good) else good
    tables = list(frame["table"].astype(str)) if "table" in frame else []
    if len(set(tables)) == len(frame) <= MAX_NAMED:
        places = {case: _short(text) for case, text in zip(frame["case"], tables, strict=True)}
    else:
        places = {}
    for name in parameters_of(good):
        across: dict[str, Any] = {"x_range": FactorRange(factors=list(places.values()))} if places else {}
        plot = Panel(x="" if places else "case", y=named(name, units), height=210, **across)
        value, std = (some[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        half = INTERVAL_STDS * std if len(some) <= MAX_BARS else np.full(len(some), np.nan)
        whole = good[f"value.{name}"].to_numpy(np.float64)
        ends = np.concatenate([whole, value - half, value + half])
        limits = limits_of(ends, truth.get(name))
        data = {
            "case": [places.get(case, case) for case in some["case"]],
            "value": value,
            "low": value - half,
            "high": value + half,
            "std": std,
        }
        source, entries = ColumnDataSource(data), []
        missed = np.abs(value - truth.get(name, math.nan)) > half
        for text, color, mine in (("interval of 95 %", BLUE, ~missed), ("misses the truth", RED, missed)):
            if np.isfinite(half[mine]).any():
                some_of = {key: np.array(data[key], dtype=object if key == "case" else None)[mine] for key in data}
                bars = ColumnDataSource(some_of)
                drawn = plot.segment("case", "low", "case", "high", source=bars, line_color=color, line_alpha=0.5)
                entries.append((text, [drawn]))
        size = 6 if len(some) <= MAX_BARS else 3
        if len(good) > MAX_DOTS:
            dots = _cells(plot, good["case"].to_numpy(np.float64), whole, limits)
        else:
            dots = plot.scatter("case", "value", source=source, size=size, fill_color=BLUE, line_color=None)
            plot.hover(dots, ("case", "@case"), ("value", "@value{0.000000}"), ("std", "@std{0.000000}"))
        for text, color, lost in (("failed", RED, "failed"), ("not converged", AMBER, "not converged")):
            cases = frame.loc[status == lost, "case"].to_numpy()
            cases = cases[evenly(len(cases), MAX_DOTS)] if len(cases) else cases
            at = {"case": [places.get(case, case) for case in cases], "y": np.full(len(cases), limits[0])}
            if len(cases):
                marks = {"marker": "dash", "angle": math.pi / 2, "size": 12, "line_color": color}
                entries.append((text, [plot.scatter("case", "y", source=ColumnDataSource(at), **marks)]))
        plot.legend([(f"estimate{outside(whole, limits)}", [dots]), *entries])
        _truth(plot, name, truth)
        plot.reach(y=limits)
        if places:
            plot.xaxis.major_label_orientation = 0.8
        plots.append(plot)
    return plots


def _cells(plot: Any, x: Floats, y: Floats, limits: tuple[float, float]) -> Any:
    """Draw so many estimates that dots would cover each other as cells: the fuller, the more lie there."""
    inside = (y >= limits[0]) & (y <= limits[1])
    counts, across, up = np.histogram2d(x[inside], y[inside], bins=CELLS, range=[(x.min(), x.max()), limits])
    i, j = np.nonzero(counts)
    count = counts[i, j]
    columns = {"left": across[i], "right": across[i + 1], "top": up[j + 1], "bottom": up[j], "count": count}
    source = ColumnDataSource(columns | {"full": PALEST + (1.0 - PALEST) * count / count.max()})
    look: dict[str, Any] = {"fill_color": BLUE, "fill_alpha": Field("full"), "line_color": None}
    cells = plot.quad("left", "right", "top", "bottom", source=source, **look)
    plot.hover(cells, ("estimates", "@count"), ("around", "@bottom{0.000000} to @top{0.000000}"))
    return cells


def _short(text: str) -> str:
    """Return the end of a long name, where the names of files differ."""
    return text if len(text) <= LONGEST_LABEL else f"…{text[1 - LONGEST_LABEL :]}"


def limits_of(values: Floats, true: float | None = None) -> tuple[float, float]:
    """Return the range of values to draw, with the truth and without the few that are far from all others."""
    values = values[np.isfinite(values)]
    if values.size:
        first, third = np.quantile(values, [0.25, 0.75])
        far = OUTSIDE_QUARTILES * (third - first)
        near = (values >= first - far) & (values <= third + far)
        values = values[near] if far > 0 and np.mean(~near) < RARE_SHARE else values
    if true is not None:
        values = np.append(values, true)
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def outside(values: Floats, limits: tuple[float, float]) -> str:
    """Return how many values a figure leaves out, for its legend; "" where it leaves out none."""
    count = int(((values < limits[0]) | (values > limits[1])).sum())
    return f", {count} outside" if count else ""


def _truth(plot: Any, name: str, truth: Mapping[str, float], *, vertical: bool = False) -> None:
    if name in truth:
        plot.level(float(truth[name]), color=AMBER, vertical=vertical)


def distributions(found: pd.DataFrame, truth: Mapping[str, float], units: Units, *, repeated: bool) -> list[Any]:
    """Draw how the estimates are distributed, and the normal curve that their stated std promises.

    Parameters
    ----------
    found : DataFrame
        One case a data set (`fmuid.runs.estimates`).
    truth : mapping of str to float
    units : mapping of str to str
    repeated : bool
        Whether the cases repeat one experiment: only then is there anything to hold the std against.
    """
    plots, groups = [], _groups(found)
    for name in parameters_of(found):
        value, std = (found[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        low, high = limits_of(value, truth.get(name))
        plot, entries = Panel(x=named(name, units), height=220), []
        for (text, rows), (color, dash) in zip(groups, LOOKS, strict=False):
            edges, density = _histogram(value[rows], low, high)
            if len(rows) < LEAST_COUNTED:
                few = value[rows]
                shape = plot.segment(few, np.zeros(len(rows)), few, np.full(len(rows), density.max()), line_color=color)
            elif len(groups) == 1:
                shape = plot.quad(
                    edges[:-1], edges[1:], density, 0, fill_color=color, fill_alpha=0.45, line_color=WHITE
                )
            else:
                shape = plot.step(
                    edges, [*density, 0.0], mode="after", line_color=color, line_dash=dash, line_width=1.6
                )
            entries.append((f"{text}{outside(value[rows], (low, high))}", [shape]))
        stated = math.sqrt(np.nanmean(std**2)) if np.isfinite(std).any() else 0.0
        if repeated and stated > 0:
            centre = float(truth.get(name, float(np.nanmean(value))))
            grid = np.linspace(low, high, 161)
            curve = normal(grid, centre, stated)
            entries.append(("as the stated std says", [plot.line(grid, curve, line_color=INK, line_width=1.4)]))
        _truth(plot, name, truth, vertical=True)
        plot.bare()
        plot.legend(entries)
        plot.reach(x=(low, high))
        plots.append(plot)
    return plots


def _groups(found: pd.DataFrame) -> list[tuple[str, Any]]:
    """Return text and rows of each combination of settings; all rows as one where these are too many."""
    names = [name for name in BatchColumns.of(found).design if len(found[name].unique()) > 1]
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
    plot.hover(dots, ("parameter", "@name"), ("spread / stated std", "@ratio{0.000}"))
    plot.level(1.0, vertical=True)
    plot.legend([("spread / stated std", [dots]), ("95 % of chance, where the std is right", [chance])])
    plot.reach(x=(0.0, 1.1 * float(max(ratio.max(initial=1.0), high.max(initial=1.0)))))
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
    place = found[name] if number else found[name].astype(str)
    more: dict[str, Any] = {} if number else {"x_range": FactorRange(factors=sorted(set(place)))}
    some = evenly(len(found), MAX_DOTS)
    for parameter in parameters_of(found):
        text = named(variable, units) if number else variable
        plot = Panel(x=text, y=named(parameter, units), height=220, **more)
        value, std = (found[f"{kind}.{parameter}"].to_numpy(np.float64) for kind in ("value", "std"))
        limits = limits_of(value, truth.get(parameter))
        if number and len(found) > MAX_DOTS:
            dots = _cells(plot, place.to_numpy(np.float64), value, limits)
        else:
            source = ColumnDataSource({"x": place.to_numpy()[some], "y": value[some]})
            dots = plot.scatter("x", "y", source=source, size=4, fill_color=BLUE, fill_alpha=0.4, line_color=None)
            plot.hover(dots, ("setting", "@x"), ("estimate", "@y{0.000000}"))
        plot.legend([(f"estimate{outside(value, limits)}", [dots]), *_means(plot, place, value, std, number=number)])
        _truth(plot, parameter, truth)
        if number and variable in truth:
            plot.level(float(truth[variable]), color=AMBER, vertical=True, dash="dotted")
        plot.reach(y=limits)
        plots.append(plot)
    return plots


def _means(
    plot: Any, place: pd.Series[Any], value: Floats, std: Floats, *, number: bool
) -> list[tuple[str, list[Any]]]:
    """Draw the mean at each setting, how far the cases spread around it, and how far they should by their std."""
    groups = pd.DataFrame({"value": value, "variance": std**2}).groupby(place.to_numpy())
    mean, counts = groups["value"].mean(), groups["value"].count()
    spread, stated = INTERVAL_STDS * groups["value"].std(ddof=1), INTERVAL_STDS * np.sqrt(groups["variance"].mean())
    sides = {"s": spread, "p": stated} if counts.min() >= LEAST_REPEATED else {}
    data = {"x": mean.index.to_numpy(), "y": mean.to_numpy()}
    for key, half in sides.items():
        data |= {f"{key}0": (mean - half).to_numpy(), f"{key}1": (mean + half).to_numpy()}
    source, entries = ColumnDataSource(data), []
    drawn = [plot.scatter("x", "y", source=source, size=8, fill_color=RED, line_color=None)]
    drawn += [plot.line("x", "y", source=source, line_color=RED, line_width=1.4)] if number else []
    if sides:
        bars = plot.segment("x", "s0", "x", "s1", source=source, line_color=RED, line_width=6, line_alpha=0.3)
        ends = [
            plot.scatter("x", end, source=source, marker="dash", size=14, line_color=INK, line_width=1.6)
            for end in ("p0", "p1")
        ]
        entries = [("± 1.96 spread", [bars]), ("± 1.96 stated std", ends)]
    return [("mean", drawn), *entries]


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
            bars = plot.hbar(
                "text", bar, "count", 0.0, source=ColumnDataSource(data), fill_color=color, line_color=None
            )
            plot.hover(bars, ("cases", "@count"))
    plot.x_range.start = 0
    return plot
