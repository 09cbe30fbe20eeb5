"""Charts of a batch: cases, distributions, spread, settings, starting points, failures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special

from fmuid.array_types import Flags, Floats
from fmuid.data import evenly
from fmuid.reports.chart import LIMITS, Axis, Chart, Color, Data, Layer, Units, kinds, named, normal, rows_of
from fmuid.runs import INTERVAL_STDS, BatchColumns, data_sets, fit_cost, optimum_numbers

CELLS = (90, 45)  # cells of a chart of many estimates, across and up
MAX_LABEL = 24  # letters of a name at an axis
LOOKS: tuple[tuple[Color, Any], ...] = (("blue", "solid"), ("red", "solid"), ("amber", "solid"), ("grey", "dashed"))
"""Outlines of the settings in one chart."""
MIN_EXCESS = 0.01  # lower end of the logarithmic cost axis, in % or units of the cost: below is rounding
LOST: tuple[tuple[str, Color], ...] = (("failed", "red"), ("not converged", "amber"))  # states without an estimate


def parameters_of(frame: pd.DataFrame) -> list[str]:
    """Return the parameters with an estimate in any case."""
    known = [name for name in BatchColumns.of(frame).parameters if np.isfinite(_of(frame, "value", name)).any()]
    return known[: LIMITS.parameters]


def _of(frame: pd.DataFrame, kind: str, name: str) -> Floats:
    return frame[f"{kind}.{name}"].to_numpy(np.float64)


def over_cases(frame: pd.DataFrame, truth: Mapping[str, float], units: Units) -> list[Chart]:
    """Return a chart per parameter over the converged cases."""
    good = frame[frame["status"].to_numpy(str) == "converged"]
    some = good.iloc[evenly(len(good), LIMITS.dots)]
    files = tuple(_short(each) for each in frame["table"].astype(str)) if "table" in frame else ()
    labels = dict(zip(frame["case"], files, strict=True)) if len(set(files)) == len(frame) <= 25 else {}
    across = Axis(kind="names", names=files, turned=0.8) if labels else Axis("case")
    places, few = _places(some["case"].to_numpy(), labels), len(some) <= LIMITS.bars
    hover = (("case", "@x"), ("value", "@y{0.000000}"), ("std", "@std{0.000000}"))
    charts = []
    for name in parameters_of(good):
        whole, value, std = _of(good, "value", name), _of(some, "value", name), _of(some, "std", name)
        half = INTERVAL_STDS * std if few else np.full(len(some), np.nan)
        limits = limits_of(np.concatenate([whole, value - half, value + half]), truth.get(name))
        missed = np.abs(value - truth.get(name, math.nan)) > half
        bars: Data = {"x0": places, "y0": value - half, "x1": places, "y1": value + half}
        held = np.isfinite(half).any() & ~missed
        layers = kinds("segments", bars, [("95 % interval", "blue", held), (MISSED, "red", missed)], alpha=0.5)
        if len(good) > LIMITS.dots:
            dots = _cells(good["case"].to_numpy(np.float64), whole, limits)
        else:
            dots = Layer("points", {"x": places, "y": value, "std": std}, size=6 if few else 3, hover=hover)
        layers.append(replace(dots, label=f"estimate{outside(whole, limits)}"))
        layers += [*_lost(frame, labels, limits[0]), *_truth(name, truth)]
        charts.append(Chart(across, Axis(named(name, units), reach=limits), tuple(layers), 210))
    return charts


MISSED = "misses the true value"


def _places(cases: npt.NDArray[Any], labels: Mapping[Any, str]) -> Floats | tuple[str, ...]:
    return tuple(labels[case] for case in cases) if labels else cases.astype(np.float64)


def _lost(frame: pd.DataFrame, labels: Mapping[Any, str], edge: float) -> list[Layer]:
    """Return marks at the lower edge for cases without an estimate."""
    layers = []
    for text, color in LOST:
        cases = frame.loc[frame["status"].to_numpy(str) == text, "case"].to_numpy()
        if len(cases):
            cases = cases[evenly(len(cases), LIMITS.dots)]
            data: Data = {"x": _places(cases, labels), "y": np.full(len(cases), edge)}
            layers.append(Layer("points", data, color, size=12, marker="bar", label=text))
    return layers


def _cells(x: Floats, y: Floats, limits: tuple[float, float]) -> Layer:
    """Return many estimates as cells shaded by their number."""
    inside = (y >= limits[0]) & (y <= limits[1])
    counts, across, up = np.histogram2d(x[inside], y[inside], bins=CELLS, range=[(x.min(), x.max()), limits])
    i, j = np.nonzero(counts)
    count = counts[i, j]
    data: Data = {"left": across[i], "right": across[i + 1], "top": up[j + 1], "bottom": up[j], "count": count}
    hover = (("estimates", "@count"), ("around", "@bottom{0.000000} to @top{0.000000}"))
    return Layer("cells", {**data, "alpha": 0.12 + 0.88 * count / count.max()}, hover=hover)


def _short(text: str) -> str:
    return text if len(text) <= MAX_LABEL else f"…{text[1 - MAX_LABEL :]}"


def limits_of(values: Floats, true: float | None = None) -> tuple[float, float]:
    """Return the range to draw, with the true value and without outliers."""
    values = values[np.isfinite(values)]
    if values.size:
        first, third = np.quantile(values, [0.25, 0.75])
        far = 6.0 * (third - first)  # rare values farther away are outside the chart
        near = (values >= first - far) & (values <= third + far)
        values = values[near] if far > 0 and np.mean(~near) < 0.05 else values
    if true is not None:
        values = np.append(values, true)
    return _with_room(float(values.min()), float(values.max())) if values.size else (0.0, 1.0)


def _with_room(low: float, high: float) -> tuple[float, float]:
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def outside(values: Floats, limits: tuple[float, float]) -> str:
    """Return the number of values outside a chart, for its legend."""
    count = int(((values < limits[0]) | (values > limits[1])).sum())
    return f", {count} outside" if count else ""


def _truth(name: str, truth: Mapping[str, float], side: str = "y", dash: Any = "solid") -> list[Layer]:
    return [Layer("rule", {side: float(truth[name])}, "amber", dash=dash)] if name in truth else []


def distributions(found: pd.DataFrame, truth: Mapping[str, float], units: Units, *, repeated: bool) -> list[Chart]:
    """Return histograms of the estimates with the normal curve of σ."""
    charts, groups = [], _groups(found)
    for name in parameters_of(found):
        value, std = _of(found, "value", name), _of(found, "std", name)
        low, high = limits_of(value, truth.get(name))
        layers = []
        for (text, rows), (color, dash) in zip(groups, LOOKS, strict=False):
            few, label = value[rows], f"{text}{outside(value[rows], (low, high))}"
            edges, density = _histogram(few, low, high)
            if len(rows) < 30:
                lines: Data = {"x0": few, "y0": 0.0, "x1": few, "y1": np.full(len(few), density.max())}
                layers.append(Layer("segments", lines, color, label=label))
            elif len(groups) == 1:
                boxes: Data = {"left": edges[:-1], "right": edges[1:], "top": density, "bottom": 0.0}
                layers.append(Layer("cells", boxes, color, alpha=0.45, edge="white", label=label))
            else:
                steps: Data = {"x": edges, "y": np.append(density, 0.0)}
                layers.append(Layer("step", steps, color, width=1.6, dash=dash, label=label))
        stated = math.sqrt(np.nanmean(std**2)) if np.isfinite(std).any() else 0.0
        if repeated and stated > 0:
            grid, center = np.linspace(low, high, 161), float(truth.get(name, float(np.nanmean(value))))
            curve: Data = {"x": grid, "y": normal(grid, center, stated)}
            layers.append(Layer("line", curve, "ink", width=1.4, label="normal distribution of the stated σ"))
        layers += _truth(name, truth, "x")
        charts.append(Chart(Axis(named(name, units), reach=(low, high)), Axis(shown=False), tuple(layers)))
    return charts


def _groups(found: pd.DataFrame) -> list[tuple[str, Any]]:
    """Return text and rows of each combination of settings."""
    names = [name for name in BatchColumns.of(found).design if len(found[name].unique()) > 1]
    levels = list(found.groupby(names, sort=True).indices.items()) if names else []
    if not 1 < len(levels) <= len(LOOKS):
        return [("estimates", np.arange(len(found)))]
    groups = []
    for key, rows in levels:
        values: Any = key if isinstance(key, tuple) else (key,)
        told = [f"{value:.5g}" if isinstance(value, float) else str(value) for value in values]
        pairs = zip((name.removeprefix("set.") for name in names), told, strict=True)
        groups.append((", ".join(f"{name} = {value}" for name, value in pairs), rows))
    return groups


def _histogram(values: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    inside = values[(values >= low) & (values <= high)]
    edges = np.linspace(low, high, min(60, max(8, round(2 * inside.size ** (1 / 3)))) + 1)
    counts, _ = np.histogram(inside, bins=edges)
    return edges, counts / max(inside.size, 1) / (edges[1] - edges[0])


def spread(statistics: pd.DataFrame) -> Chart:
    """Return the spread of each parameter over its stated σ."""
    known = statistics[np.isfinite(statistics["ratio"].astype(float))].iloc[: LIMITS.parameters]
    names, ratio = tuple(map(str, known["parameter"])), known["ratio"].to_numpy(np.float64)
    freedom = known["cases"].to_numpy(np.float64) - 1.0
    low, high = (np.sqrt(special.chdtri(freedom, beyond) / freedom) for beyond in (0.975, 0.025))
    reach = (0.0, 1.1 * float(max(ratio.max(initial=1.0), high.max(initial=1.0))))
    hover = (("parameter", "@y"), ("spread / stated σ", "@x{0.000}"))
    layers = (
        Layer("bars", {"y": names, "x0": low, "x": high}, alpha=0.16, label="95 % range if σ is right"),
        Layer("points", {"x": ratio, "y": names}, "red", size=9, label="spread / stated σ", hover=hover),
        Layer("rule", {"x": 1.0}, "ink", dash="dashed"),
    )
    return rows_of(names, Axis("spread of the cases / stated σ", reach=reach), layers)


def over_setting(found: pd.DataFrame, name: str, truth: Mapping[str, float], units: Units) -> list[Chart]:
    """Return the estimates of each parameter over a setting."""
    variable, number, charts = name.removeprefix("set."), found[name].dtype.kind in "fiu", []
    place = found[name].to_numpy(np.float64) if number else found[name].astype(str).map(_short).to_numpy()
    names = () if number else tuple(sorted(set(place)))
    across = Axis(named(variable, units)) if number else Axis(variable, "names", names, turned=0.8)
    some, hover = evenly(len(found), LIMITS.dots), (("setting", "@x"), ("estimate", "@y{0.000000}"))
    for parameter in parameters_of(found):
        value, std = _of(found, "value", parameter), _of(found, "std", parameter)
        limits = limits_of(value, truth.get(parameter))
        if number and len(found) > LIMITS.dots:
            dots = _cells(place, value, limits)
        else:
            x = place[some] if number else tuple(place[some])
            dots = Layer("points", {"x": x, "y": value[some]}, size=4, alpha=0.4, hover=hover)
        layers = [replace(dots, label=f"estimate{outside(value, limits)}"), *_means(place, value, std, number=number)]
        layers += _truth(parameter, truth) + (_truth(variable, truth, "x", "dotted") if number else [])
        charts.append(Chart(across, Axis(named(parameter, units), reach=limits), tuple(layers)))
    return charts


def _means(place: npt.NDArray[Any], value: Floats, std: Floats, *, number: bool) -> list[Layer]:
    """Return mean, spread and stated σ at each setting."""
    groups = pd.DataFrame({"value": value, "variance": std**2}).groupby(place)
    mean, counts = groups["value"].mean(), groups["value"].count()
    if counts.max() < 2:
        return []
    x, y = mean.index.to_numpy(np.float64) if number else tuple(map(str, mean.index)), mean.to_numpy(np.float64)
    layers = [Layer("points", {"x": x, "y": y}, "red", size=8, label="mean")]
    layers += [Layer("line", {"x": x, "y": y}, "red", width=1.4, label="mean")] if number else []
    if counts.min() < 3:
        return layers
    half = (INTERVAL_STDS * groups["value"].std(ddof=1)).to_numpy(np.float64)
    promised = INTERVAL_STDS * np.sqrt(groups["variance"].mean().to_numpy(np.float64))
    bars: Data = {"x0": x, "y0": y - half, "x1": x, "y1": y + half}
    layers.append(Layer("segments", bars, "red", width=6, alpha=0.3, label="± 1.96 spread"))
    look: dict[str, Any] = {"width": 1.6, "size": 14, "marker": "dash", "label": "± 1.96 stated σ"}
    return layers + [Layer("points", {"x": x, "y": y + side * promised}, "ink", **look) for side in (-1.0, 1.0)]


def over_starts(
    frame: pd.DataFrame, truth: Mapping[str, float], units: Units, *, given_noise: bool = False
) -> list[Chart]:
    """Return cost and estimates of searches from several starting points."""
    columns, number = BatchColumns.of(frame), optimum_numbers(frame, given_noise=given_noise)
    lost = (frame["status"] != "converged").to_numpy(bool)
    charts = [_waterfall(frame, columns, number, given_noise=given_noise)]
    for name in (name for each in columns.starts if (name := each.removeprefix("start.")) in columns.parameters):
        begin, end, text = _of(frame, "start", name), _of(frame, "value", name), named(name, units)
        limits = _optimum_limits(end, INTERVAL_STDS * _of(frame, "std", name), number)
        wide = np.nanmax(begin) > 100.0 * np.nanmin(begin) > 0  # NaN where the parameter is not free
        layers = []
        for mine, color, words in _optima(number):
            layers += _points(begin[mine], end[mine], color, words + outside(end[mine], limits))
        astray = lost & np.isfinite(end)
        layers += _points(begin[astray], np.clip(end[astray], *limits), "amber", "not converged", marker="x", size=7)
        layers += _truth(name, truth)
        across = Axis(f"initial guess of {text}", "log" if wide else "linear")
        charts.append(Chart(across, Axis(text, reach=limits), tuple(layers)))
    return charts


def _optima(number: npt.NDArray[np.int64]) -> list[tuple[Flags, Color, str]]:
    return [(number > 1, "red", "another optimum"), (number == 1, "blue", "best optimum")]


def _points(x: Floats, y: Floats, color: Color, label: str, size: float = 5, **look: Any) -> list[Layer]:
    some, hover = evenly(x.size, LIMITS.dots), (("start", "@x{0.000000}"), ("end", "@y{0.000000}"))
    dots = Layer("points", {"x": x[some], "y": y[some]}, color, 1.6, size=size, label=label, hover=hover, **look)
    return [dots] if x.size else []


def _optimum_limits(end: Floats, half: Floats, number: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Return limits around the intervals of the best optima."""
    near = (number > 0) & (number <= 5) & np.isfinite(end)
    half = np.where(np.isfinite(half), half, 0.0)
    low, high = float((end - half)[near].min(initial=np.inf)), float((end + half)[near].max(initial=-np.inf))
    return _with_room(low, high) if low <= high else (0.0, 1.0)


def _waterfall(
    frame: pd.DataFrame, columns: BatchColumns, number: npt.NDArray[np.int64], *, given_noise: bool
) -> Chart:
    """Return cost above the best of the same data, in order."""
    lost = (frame["status"] != "converged").to_numpy(bool)
    fits = np.where(lost, np.nan, fit_cost(frame, given_noise=given_noise))
    for rows in data_sets(frame, columns):
        known = rows[np.isfinite(fits[rows])]
        fits[rows] -= fits[known].min() if known.size else 0.0
    excess = fits if given_noise else 100.0 * np.expm1(0.5 * fits / max(1, len(columns.outputs)))
    order = np.argsort(np.where(lost, np.inf, excess), kind="stable")[: int((~lost).sum())]
    x, y = np.arange(1.0, order.size + 1), np.maximum(excess[order], MIN_EXCESS)
    text = "cases, best first" + (f"; {lost.sum()} not converged" if lost.any() else "")
    words = "cost above the best" if given_noise else "residual above the best (%)"
    reach = (0.7 * MIN_EXCESS, max(100 * MIN_EXCESS, 1.5 * float(y.max(initial=0.0))))
    layers = [each for mine, color, label in _optima(number[order]) for each in _points(x[mine], y[mine], color, label)]
    return Chart(Axis(text), Axis(words, "log", reach=reach), tuple(layers))


def failures(found: pd.DataFrame, messages: list[str]) -> Chart:
    """Return the number of cases without an estimate by reason."""
    most = found.iloc[:12]
    texts = tuple(f"{k + 1}. {each[:70]}" for k, each in enumerate(messages[:12]))
    data: Data = {"y": texts, "x": most["cases"].to_numpy(np.float64)}
    status = most["status"].to_numpy(str)
    layers = kinds("bars", data, [("", color, status == text) for text, color in LOST], hover=(("cases", "@x"),))
    return rows_of(texts, Axis("cases", reach=(0.0, None)), layers)
