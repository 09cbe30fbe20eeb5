"""The cases of a batch, drawn: estimates, their spread against the stated one, over settings, over starts, failures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special

from fmuid.array_types import Flags, Floats
from fmuid.data import evenly
from fmuid.reports.chart import (
    DENSITY,
    MAX_BARS,
    MAX_DOTS,
    MAX_PARAMETERS,
    Axis,
    Chart,
    Color,
    Dash,
    Data,
    Layer,
    Units,
    named,
    normal,
    picked,
    rows_of,
)
from fmuid.runs import INTERVAL_STDS, BatchColumns, data_sets, fit_cost, optimum_numbers

MIN_BINS, MAX_BINS = 8, 60
"""Bars of a histogram, from few cases to many."""
CELLS, PALEST = (90, 45), 0.12
"""Cells of a chart of many estimates, across and up, and how full the one with the fewest is painted."""
LEAST_COUNTED, LEAST_REPEATED = 30, 3
"""Fewer estimates than this make no histogram, they are drawn themselves; fewer at a setting have no spread."""
OUTSIDE_QUARTILES, RARE_SHARE = 6.0, 0.05
"""Values further than so many quartile distances from the middle half are outside the picture, which says so, if they
are less than such a share of all."""
MAX_NAMED, LONGEST_LABEL = 25, 24
"""Tables that are named at the axis, and letters of a name that it has room for."""
LOOKS: tuple[tuple[Color, Dash], ...] = (("blue", "solid"), ("red", "solid"), ("amber", "solid"), ("grey", "dashed"))
"""Outlines of different settings in one chart; more cannot be told apart."""
MAX_FAILURES, LONGEST = 12, 70
"""Kinds of failures drawn, and how much of their messages."""
MAX_OPTIMA = 5
"""Optima of which all is inside the picture."""
LEAST_EXCESS = 0.01
"""Fits are drawn logarithmically from here on, in per cent or in units of the cost: less is rounding."""
WIDE_RANGE = 100.0
"""Starts that range over this ratio are shown logarithmically."""


def parameters_of(frame: pd.DataFrame) -> list[str]:
    """Return the parameters that any case has an estimate of, `MAX_PARAMETERS` at most."""
    names = BatchColumns.of(frame).parameters
    return [name for name in names if np.isfinite(_column(frame, f"value.{name}")).any()][:MAX_PARAMETERS]


def _column(frame: pd.DataFrame, name: str) -> Floats:
    return frame[name].to_numpy(np.float64)


# --- over the cases


def over_cases(frame: pd.DataFrame, truth: Mapping[str, float], units: Units) -> list[Chart]:
    """Return each parameter over the cases that converged, with intervals of 95 % where there are few.

    Parameters
    ----------
    frame : DataFrame
        A row a case.
    truth : mapping of str to float
    units : mapping of str to str
    """
    good = frame[frame["status"].to_numpy(str) == "converged"]
    return [_over_cases(frame, good, name, truth.get(name), units) for name in parameters_of(good)]


def _over_cases(frame: pd.DataFrame, good: pd.DataFrame, name: str, true: float | None, units: Units) -> Chart:
    some = good.iloc[evenly(len(good), MAX_DOTS)] if len(good) else good
    places = _places(frame)
    value, std = _column(some, f"value.{name}"), _column(some, f"std.{name}")
    half = INTERVAL_STDS * std if len(some) <= MAX_BARS else np.full(len(some), np.nan)
    whole = _column(good, f"value.{name}")
    limits = limits_of(np.concatenate([whole, value - half, value + half]), true)
    estimate = f"estimate{outside(whole, limits)}"
    if len(good) > MAX_DOTS:
        layers = [_cells(_column(good, "case"), whole, limits, estimate)]
    else:
        hover = (("case", "@x"), ("value", "@y{0.000000}"), ("std", "@std{0.000000}"))
        data: Data = {"x": _at(some["case"], places), "y": value, "std": std}
        layers = [Layer("points", data, size=6 if len(some) <= MAX_BARS else 3, label=estimate, hover=hover)]
    missed = np.abs(value - (math.nan if true is None else true)) > half
    for text, color, mine in _two(("interval of 95 %", "blue", ~missed), ("misses the truth", "red", missed)):
        if np.isfinite(half[mine]).any():
            at = _at(some["case"].to_numpy()[mine], places)
            ends: Data = {"x0": at, "y0": (value - half)[mine], "x1": at, "y1": (value + half)[mine]}
            layers.append(Layer("segments", ends, color, width=1, alpha=0.5, label=text))
    status = frame["status"].to_numpy(str)
    for text, color, lost in _two(
        ("failed", "red", status == "failed"), ("not converged", "amber", status == "not converged")
    ):
        cases = frame["case"].to_numpy()[lost]
        cases = cases[evenly(len(cases), MAX_DOTS)] if len(cases) else cases
        if len(cases):
            marks: Data = {"x": _at(cases, places), "y": np.full(len(cases), limits[0])}
            layers.append(Layer("points", marks, color, marker="bar", size=12, width=1, label=text))
    x = Axis("case") if not places else Axis(kind="names", names=tuple(places.values()), turned=0.8)
    return Chart(x, Axis(named(name, units), reach=limits), (*layers, *_truth(true)), 210)


def _statuses(status: Any) -> tuple[tuple[str, Color, Flags], ...]:
    return _two(("failed", "red", status == "failed"), ("not converged", "amber", status == "not converged"))


def _two(*kinds: tuple[str, Color, Flags]) -> tuple[tuple[str, Color, Flags], ...]:
    return kinds


def _places(frame: pd.DataFrame) -> dict[Any, str]:
    """Return the tables' names by the cases, where each case has its own and there are few."""
    tables = list(frame["table"].astype(str)) if "table" in frame else []
    if not len(set(tables)) == len(frame) <= MAX_NAMED:
        return {}
    return {case: _short(text) for case, text in zip(frame["case"], tables, strict=True)}


def _at(cases: Any, places: Mapping[Any, str]) -> Floats | tuple[str, ...]:
    return tuple(places[case] for case in cases) if places else np.asarray(cases, dtype=np.float64)


def _short(text: str) -> str:
    """Return the end of a long name, where the names of files differ."""
    return text if len(text) <= LONGEST_LABEL else f"…{text[1 - LONGEST_LABEL :]}"


def _cells(x: Floats, y: Floats, limits: tuple[float, float], label: str) -> Layer:
    """Return so many estimates that dots would cover each other as cells: the fuller, the more lie there."""
    inside = (y >= limits[0]) & (y <= limits[1])
    counts, across, up = np.histogram2d(x[inside], y[inside], bins=CELLS, range=[(x.min(), x.max()), limits])
    i, j = np.nonzero(counts)
    count = counts[i, j]
    sides = {"left": across[i], "right": across[i + 1], "top": up[j + 1], "bottom": up[j], "count": count}
    data: Data = sides | {"alpha": PALEST + (1.0 - PALEST) * count / count.max()}
    hover = (("estimates", "@count"), ("around", "@bottom{0.000000} to @top{0.000000}"))
    return Layer("cells", data, label=label, hover=hover)


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
    """Return how many values a chart leaves out, for its legend; "" where it leaves out none."""
    count = int(((values < limits[0]) | (values > limits[1])).sum())
    return f", {count} outside" if count else ""


def _truth(true: float | None, side: str = "y", dash: Dash = "solid") -> list[Layer]:
    return [] if true is None else [Layer("rule", {side: float(true)}, "amber", dash=dash)]


# --- distributions


def distributions(found: pd.DataFrame, truth: Mapping[str, float], units: Units, *, repeated: bool) -> Iterator[Chart]:
    """Yield how the estimates are distributed, and the normal curve that their stated std promises.

    Parameters
    ----------
    found : DataFrame
        One case a data set (`fmuid.runs.estimates`).
    truth : mapping of str to float
    units : mapping of str to str
    repeated : bool
        Whether the cases repeat one experiment: only then is there anything to hold the std against.
    """
    groups = _groups(found)
    for name in parameters_of(found):
        value, std = _column(found, f"value.{name}"), _column(found, f"std.{name}")
        low, high = limits_of(value, truth.get(name))
        layers = []
        for (text, rows), (color, dash) in zip(groups, LOOKS, strict=False):
            edges, density = _histogram(value[rows], low, high)
            label = f"{text}{outside(value[rows], (low, high))}"
            if len(rows) < LEAST_COUNTED:
                few = value[rows]
                lines: Data = {"x0": few, "y0": 0.0, "x1": few, "y1": np.full(len(rows), density.max())}
                layers.append(Layer("segments", lines, color, width=1, label=label))
            elif len(groups) == 1:
                boxes: Data = {"left": edges[:-1], "right": edges[1:], "bottom": 0.0, "top": density}
                layers.append(Layer("cells", boxes, color, alpha=0.45, edge="white", label=label))
            else:
                steps: Data = {"x": edges, "y": np.append(density, 0.0)}
                layers.append(Layer("step", steps, color, width=1.6, dash=dash, label=label))
        stated = math.sqrt(np.nanmean(std**2)) if np.isfinite(std).any() else 0.0
        if repeated and stated > 0:
            grid = np.linspace(low, high, 161)
            curve = normal(grid, float(truth.get(name, float(np.nanmean(value)))), stated)
            layers.append(Layer("line", {"x": grid, "y": curve}, "ink", width=1.4, label="as the stated std says"))
        x = Axis(named(name, units), reach=(low, high))
        yield Chart(x, DENSITY, (*layers, *_truth(truth.get(name), "x")))


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


def spread_chart(summary: pd.DataFrame) -> Chart:
    """Return the spread of each parameter against the std that the estimates state, and what chance makes of 1."""
    known = summary[np.isfinite(summary["ratio"].astype(float))].iloc[:MAX_PARAMETERS]
    names, ratio = tuple(map(str, known["parameter"])), _column(known, "ratio")
    freedom = _column(known, "cases") - 1.0
    low, high = (np.sqrt(special.chdtri(freedom, beyond) / freedom) for beyond in (0.975, 0.025))
    hover = (("parameter", "@y"), ("spread / stated std", "@x{0.000}"))
    chance: Data = {"y": names, "x0": low, "x": high}
    layers = (
        Layer("bars", chance, alpha=0.16, label="95 % of chance, where the std is right"),
        Layer("points", {"x": ratio, "y": names}, "red", size=9, label="spread / stated std", hover=hover),
        Layer("rule", {"x": 1.0}, "ink"),
    )
    most = 1.1 * float(max(ratio.max(initial=1.0), high.max(initial=1.0)))
    return rows_of(names, Axis("spread over the cases / stated std", reach=(0.0, most)), layers)


# --- over settings


def over_setting(found: pd.DataFrame, name: str, truth: Mapping[str, float], units: Units) -> list[Chart]:
    """Return the estimates of each parameter over what is set, and their mean at each value of it.

    Parameters
    ----------
    found : DataFrame
        One case a data set.
    name : str
        Column of the setting.
    truth : mapping of str to float
    units : mapping of str to str
    """
    variable, number = name.removeprefix("set."), found[name].dtype.kind in "fiu"
    place = found[name] if number else found[name].astype(str)
    levels = () if number else tuple(sorted(set(place)))
    x = Axis(named(variable, units)) if number else Axis(variable, "names", levels)
    some, charts = evenly(len(found), MAX_DOTS), []
    hover = (("setting", "@x"), ("estimate", "@y{0.000000}"))
    for parameter in parameters_of(found):
        value, std = _column(found, f"value.{parameter}"), _column(found, f"std.{parameter}")
        limits = limits_of(value, truth.get(parameter))
        text = f"estimate{outside(value, limits)}"
        if number and len(found) > MAX_DOTS:
            layers = [_cells(place.to_numpy(np.float64), value, limits, text)]
        else:
            data: Data = {"x": _levels(place.to_numpy()[some], number=number), "y": value[some]}
            layers = [Layer("points", data, size=4, alpha=0.4, label=text, hover=hover)]
        layers += [*_means(place, value, std, number=number), *_truth(truth.get(parameter))]
        layers += _truth(truth.get(variable), "x", "dotted") if number else []
        charts.append(Chart(x, Axis(named(parameter, units), reach=limits), tuple(layers)))
    return charts


def _levels(values: Any, *, number: bool) -> Floats | tuple[str, ...]:
    return np.asarray(values, dtype=np.float64) if number else tuple(map(str, values))


def _means(place: pd.Series[Any], value: Floats, std: Floats, *, number: bool) -> list[Layer]:
    """Return the mean at each setting, how far the cases spread around it, and how far they should by their std."""
    groups = pd.DataFrame({"value": value, "variance": std**2}).groupby(place.to_numpy())
    means, counts = groups["value"].mean(), groups["value"].count()
    mean, x = means.to_numpy(), _levels(means.index.to_numpy(), number=number)
    data: Data = {"x": x, "y": mean}
    layers = [Layer("points", data, "red", size=8, label="mean")]
    layers += [Layer("line", data, "red", width=1.4, label="mean")] if number else []
    if counts.min() >= LEAST_REPEATED:
        spread = INTERVAL_STDS * groups["value"].std(ddof=1).to_numpy()
        stated = INTERVAL_STDS * np.sqrt(groups["variance"].mean().to_numpy())
        ends: Data = {"x0": x, "y0": mean - spread, "x1": x, "y1": mean + spread}
        layers.append(Layer("segments", ends, "red", width=6, alpha=0.3, label="± 1.96 spread"))
        for end in (mean - stated, mean + stated):
            text = "± 1.96 stated std"
            layers.append(Layer("points", {"x": x, "y": end}, "ink", marker="dash", size=14, width=1.6, label=text))
    return layers


def failure_chart(messages: Sequence[str], statuses: Sequence[str], counts: Floats) -> Chart:
    """Return how many cases have no estimate for which reason, the most frequent first."""
    texts = tuple(f"{k + 1}. {each[:LONGEST]}" for k, each in enumerate(messages[:MAX_FAILURES]))
    layers, status = [], np.array(statuses[:MAX_FAILURES])
    for kind, color, mine in _statuses(status):
        if mine.any():
            data = picked({"y": texts, "x": counts[:MAX_FAILURES]}, mine)
            layers.append(Layer("bars", data, color, label=kind, hover=(("cases", "@x"),)))
    return rows_of(texts, Axis("cases", reach=(0.0, None)), layers)


# --- over starts


def over_starts(frame: pd.DataFrame, truth: Mapping[str, float], units: Units, *, given_noise: bool) -> list[Chart]:
    """Return where searches from several starts ended: how much worse they fit, in order, and each end over its start.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    truth : mapping of str to float
    units : mapping of str to str
    given_noise : bool
        See `fmuid.runs.batch.statistics.fit_cost`.
    """
    columns, number = BatchColumns.of(frame), optimum_numbers(frame, given_noise=given_noise)
    lost = (frame["status"] != "converged").to_numpy(bool)
    charts = [_waterfall(_excess(frame, columns, given_noise=given_noise), number, lost, given_noise=given_noise)]
    for name in (name for each in columns.starts if (name := each.removeprefix("start.")) in columns.parameters):
        begin, end = _column(frame, f"start.{name}"), _column(frame, f"value.{name}")
        limits = _limits(end, INTERVAL_STDS * _column(frame, f"std.{name}"), number)
        wide = np.nanmax(begin) > WIDE_RANGE * np.nanmin(begin) > 0  # NaN where the parameter is not free
        layers = []
        for words, color, mine in _kinds(number):
            layers += _ends(begin[mine], end[mine], color, words + outside(end[mine], limits))
        astray = lost & np.isfinite(end)
        layers += _ends(begin[astray], np.clip(end[astray], *limits), "amber", "not converged", cross=True)
        text = named(name, units)
        x = Axis(f"start of {text}", "log" if wide else "linear")
        charts.append(Chart(x, Axis(text, reach=limits), (*layers, *_truth(truth.get(name)))))
    return charts


def _kinds(number: npt.NDArray[np.int64]) -> tuple[tuple[str, Color, Flags], ...]:
    return _two(("another optimum", "red", number > 1), ("best optimum", "blue", number == 1))


def _ends(x: Floats, y: Floats, color: Color, label: str, *, cross: bool = False) -> list[Layer]:
    """Return points; none leave no word in the legend."""
    if not x.size:
        return []
    some = evenly(x.size, MAX_DOTS)
    data, hover = {"x": x[some], "y": y[some]}, (("start", "@x{0.000000}"), ("end", "@y{0.000000}"))
    if cross:
        return [Layer("points", data, color, marker="x", size=7, width=1.6, label=label, hover=hover)]
    return [Layer("points", data, color, size=5, label=label, hover=hover)]


def _limits(end: Floats, half: Floats, number: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Return limits around the intervals of the best optima, so that differences that mean nothing look small."""
    near = (number > 0) & (number <= MAX_OPTIMA) & np.isfinite(end)
    half = np.where(np.isfinite(half), half, 0.0)
    low, high = float((end - half)[near].min(initial=np.inf)), float((end + half)[near].max(initial=-np.inf))
    if low > high:
        return 0.0, 1.0
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def _excess(frame: pd.DataFrame, columns: BatchColumns, *, given_noise: bool) -> Floats:
    """Return how much worse each converged case fits than the best of its data, NaN for the others.

    By the cost where the noise variances are given, else the share by which the residual is larger.
    """
    fits = np.where(frame["status"] == "converged", fit_cost(frame, given_noise=given_noise), np.nan)
    for rows in data_sets(frame, columns):
        known = rows[np.isfinite(fits[rows])]
        fits[rows] -= fits[known].min() if known.size else 0.0
    return fits if given_noise else np.expm1(0.5 * fits / max(1, len(columns.outputs)))


def _waterfall(excess: Floats, number: npt.NDArray[np.int64], lost: Flags, *, given_noise: bool) -> Chart:
    order = np.argsort(np.where(lost, np.inf, excess), kind="stable")[: int((~lost).sum())]
    x, y = np.arange(1.0, order.size + 1), np.maximum(excess[order] * (1.0 if given_noise else 100.0), LEAST_EXCESS)
    text = "searches, the best first" + (f"; {lost.sum()} did not converge" if lost.any() else "")
    layers = [each for words, color, mine in _kinds(number[order]) for each in _ends(x[mine], y[mine], color, words)]
    reach = (0.7 * LEAST_EXCESS, max(100 * LEAST_EXCESS, 1.5 * float(y.max(initial=0.0))))
    words = "criterion above the best" if given_noise else "residual above the best (%)"
    return Chart(Axis(text), Axis(words, "log", reach=reach), tuple(layers))
