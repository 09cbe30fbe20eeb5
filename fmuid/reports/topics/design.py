"""Design of experiments: ranked excitations and sensitivities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from fmuid.data import extremes
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Color, Dash, Layer, Units, named, short, stacked
from fmuid.reports.document import Document, Message, Remark, Section, Table, origin_of, table_of
from fmuid.reports.topics.model_comparison import ranked_bars
from fmuid.runs import Provenance

ENOUGH = 1.1
"""A healthy record is long enough where a longer one lowers the smallest size found by no more than this."""
WORST = "The shorter, the better: the largest of the parameters' relative standard deviations, the best excitation red."
FOUND = "The shorter, the better: the smallest size of the fault that is found, over its magnitude; the best is red."
SENSITIVITIES = (
    "What a relative change of a parameter does to each output, θ ∂y/∂θ. A parameter whose line is small is hardly "
    "determined by this excitation; two whose lines look alike are hardly told apart."
)
HEADS = {"duration": "duration (s)", "log_determinant": "log-determinant"}
_COLORS: tuple[Color, ...] = ("blue", "red", "amber", "grey")
_DASHES: tuple[Dash, ...] = ("solid", "dashed")
LOOKS = [(color, dash) for dash in _DASHES for color in _COLORS]
"""Lines of a chart: those that are largest. More cannot be told apart."""


class DesignMessage(Message):
    """Which excitation is the best, and how long the healthy record should be."""

    ACCURATE = ("{excitation} leaves no relative std above {worst:.3g} %", "smaller is better")
    SHOWS = ("{excitation} shows faults from this share of their magnitude on: {worst:.3g} %", "smaller is better")
    BLIND = (
        "{size}: this excitation does not show it, however long the healthy record is",
        "the fault does not act on the outputs, or just as something else that may change",
        "another excitation",
    )
    LENGTH = (
        "{size}: with a healthy record as long as the test the smallest size found is {times:.3g} times that with an "
        "endless one; with one {length:g} times as long, {longer:.3g} times",
        "errors of the healthy machine look like a fault; from the second length on a longer one gains 10 % at most",
    )
    SENSITIVITIES = (
        "What relative changes of the parameters do to the outputs at their starts",
        "small: hardly determined; alike: hardly told apart",
    )


def design_document(
    ranked: pd.DataFrame, cost: pd.DataFrame | None = None, origin: Provenance | None = None
) -> Document:
    """Return the document of excitations."""
    names, accuracy = [str(name) for name in ranked["excitation"]], "log_determinant" in ranked
    text, caption = ("largest relative std", WORST) if accuracy else ("smallest fault found / its magnitude", FOUND)
    worst = 100.0 * ranked["worst"].to_numpy(np.float64)
    one = f"{names[0]} is the best of {len(names)} excitations: it" if len(names) > 1 else names[0]
    how = DesignMessage.ACCURATE if accuracy else DesignMessage.SHOWS
    said = [how.said("plain", "excitations", names, excitation=one, worst=worst[0])]
    chart = ranked_bars(names, worst, f"{text} (%)")
    heading = "Excitations, the best first"
    sections = [Section("excitations", heading, caption, _numbers(ranked), (chart,), 1)]
    if cost is not None:
        title = f"Healthy records, in lengths of {names[0]}: the smallest size found"
        sections.append(Section("lengths", title, table=_numbers(cost)))
        said += healthy_record_remarks(cost)
    return Document("design", "Design", f"best: {names[0]}", "good", tuple(said), tuple(sections), **origin_of(origin))


def healthy_record_remarks(cost: pd.DataFrame) -> list[Remark]:
    """Return the effect of the healthy record's length on each fault size."""
    said, lengths = [], cost["healthy"]
    for column in [str(each) for each in cost if str(each).endswith(".times")]:
        name, times = column.removesuffix(".times"), cost[column]
        if not times.notna().all():
            said.append(DesignMessage.BLIND.said("doubt", "lengths", (name,), size=name))
            continue
        enough = next((k for k in range(1, len(times)) if times.iloc[k] <= ENOUGH), len(times) - 1)
        values = {"times": times.iloc[0], "length": lengths.iloc[enough], "longer": times.iloc[enough]}
        said.append(DesignMessage.LENGTH.said("doubt", "lengths", (name,), size=name, **values))
    return said


def _numbers(frame: pd.DataFrame) -> Table:
    columns = {HEADS.get(str(name), str(name)): [_cell(each) for each in frame[name].tolist()] for name in frame}
    return table_of(columns)


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4g}" if math.isfinite(value) else ""


def sensitivity_document(
    tables: Sequence[tuple[str, pd.DataFrame]], units: Units, origin: Provenance | None = None
) -> Document:
    """Return the document of sensitivities."""
    sections = []
    for k, (name, rows) in enumerate(tables[: LIMITS.experiments]):
        heading = f"Sensitivities: {name}" if len(tables) > 1 else "Sensitivities"
        key, caption = ("sensitivities", SENSITIVITIES) if k == 0 else (f"sensitivities-{k + 1}", "")
        sections.append(Section(key, heading, caption, charts=(sensitivity_charts(rows, units),), beside=1))
    state = f"{len(tables)} experiment{'s' * (len(tables) > 1)}"
    said = (DesignMessage.SENSITIVITIES.said("plain", "sensitivities"),)
    return Document("sensitivities", "Sensitivities", state, "good", said, tuple(sections), **origin_of(origin))


def sensitivity_charts(table: pd.DataFrame, units: Units) -> ChartGrid:
    """Return θ ∂ŷ/∂θ (1.33) of each output over time."""
    pairs = [str(name) for name in table.columns if "/" in str(name)]
    times = table["time"].to_numpy(np.float64)
    across = Axis("time (s)", reach=(float(times[0]), float(times[-1])), linked="time")
    charts = []
    for output in list(dict.fromkeys(name.rpartition("/")[0] for name in pairs))[: LIMITS.outputs]:
        mine = [name for name in pairs if name.rpartition("/")[0] == output]
        values = table[mine].to_numpy(np.float64)
        largest = sorted(np.argsort(-np.nansum(values**2, axis=0), kind="stable")[: len(LOOKS)].tolist())
        kept = extremes(values[:, largest], LIMITS.rows)
        thin, layers = times[kept], []
        for k, (color, dash) in zip(largest, LOOKS, strict=False):
            data = {"x": thin, "y": short(values[kept, k])}
            layers.append(Layer("line", data, color, dash=dash, width=1.4, label=mine[k].rpartition("/")[2]))
        layers.append(Layer("rule", {"y": 0.0}, "ink"))
        charts.append(Chart(across, Axis(named(output, units)), tuple(layers), 210))
    return stacked(charts)
