"""Causes and faults, drawn: what decides, sizes with intervals, what a fault explains of the residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import extremes
from fmuid.formatting import label
from fmuid.reports.chart import (
    MAX_OUTPUTS,
    MAX_ROWS,
    Axis,
    Chart,
    ChartGrid,
    Color,
    Data,
    Layer,
    Units,
    rows_of,
    short,
    stacked,
)
from fmuid.reports.topics.diagnosis_phrases import change_name, change_size

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.diagnosis import ChangeEvidence

MAX_FAULTS = 12
"""More hypotheses make a chart nobody reads: the most significant are kept."""
LEAST_STATISTIC = 0.1
"""D is drawn logarithmically from here on; less is as good as nothing."""


def cause_evidence(found: ChangeEvidence) -> Chart:
    """Return what each cause alone lowers the cost by, the likeliest first; what explains the record is red.

    The pointer shows the size, and which other cause has the nearest signature, at which angle.
    """
    kept = sorted(found.suspects, key=lambda each: each.probability)[:MAX_FAULTS]
    names = [change_name(each.change) for each in kept]
    named = {change_name(change) for each in found.explanations for change in each.changes}
    numbers = (("D", "@told{0.000}"), ("probability by chance", "@p{0.0e}"))
    hover = (*numbers, ("size", "@size"), ("nearest signature", "@near"))
    layers = []
    kinds: tuple[tuple[str, Color, bool], ...] = (("explains the record", "red", True), ("other causes", "grey", False))
    for text, color, mine in kinds:
        here = [(name, each) for name, each in zip(names, kept, strict=True) if (name in named) is mine]
        if here:
            data = _bars([name for name, _ in here], [each.statistic for _, each in here])
            near = [f"{e.rival}, {math.degrees(e.rival_angle):.0f}°" if e.rival else "" for _, e in here]
            sizes = tuple(change_size(each.change) for _, each in here)
            more: Data = {"p": _array([each.probability for _, each in here]), "size": sizes, "near": tuple(near)}
            layers.append(Layer("bars", {**data, **more}, color, label=text, hover=hover))
    most = max((each.statistic for each in kept), default=1.0)
    return rows_of(names, _strengths("D, by how much the cause alone lowers the criterion", most), layers, 110)


def _bars(names: Sequence[str], statistics: Sequence[float]) -> Data:
    told = _array(statistics)
    return {"y": tuple(names), "x": np.maximum(told, LEAST_STATISTIC), "x0": LEAST_STATISTIC, "told": told}


def _array(values: Sequence[float]) -> Floats:
    return np.array(values, dtype=np.float64)


def _strengths(text: str, most: float) -> Axis:
    return Axis(text, "log", reach=(LEAST_STATISTIC, 2.0 * max(most, 1.0)))


def change_charts(found: ChangeEvidence) -> list[Chart]:
    """Return the size of each change that explains the record, with its interval of 95 %; shares in percent."""
    charts = {}
    for each in (change for one in found.explanations for change in one.changes):
        name = change_name(each)
        if name not in charts and math.isfinite(each.std):
            scale, unit = (100.0, "%") if each.kind.is_share else (1.0, each.unit)
            low, high = each.interval()
            text = label("size, with its interval of 95 %", unit)
            charts[name] = _intervals(text, [name], [scale * each.value], [(scale * low, scale * high)], "red")
    return list(charts.values())


def _intervals(
    text: str, names: Sequence[str], values: Sequence[float], ends: Sequence[tuple[float, float]], color: Color
) -> Chart:
    """Return values with their intervals beside zero, a row a name."""
    low, high = (_array([each[k] for each in ends]) for k in (0, 1))
    hover = (("size", "@x{0.000000}"), ("interval", "@x0{0.000000} to @x1{0.000000}"))
    rows = tuple(names)
    layers = (
        Layer("segments", {"x0": low, "y0": rows, "x1": high, "y1": rows}, color, width=3),
        Layer("points", {"x": _array(values), "y": rows, "x0": low, "x1": high}, color, size=9, hover=hover),
        Layer("rule", {"x": 0.0}, "ink"),
    )
    least, most = min(0.0, float(low.min())), max(0.0, float(high.max()))
    room = 0.05 * (most - least)
    return rows_of(list(dict.fromkeys(names)), Axis(text, reach=(least - room, most + room)), layers)


def explained_charts(table: pd.DataFrame, fault: str, units: Units) -> ChartGrid:
    """Return each output's residual without the fault and with it.

    Parameters
    ----------
    table : DataFrame
        Columns ``time``, and ``healthy.`` and ``fault.`` before the name of each output: the residuals of both models.
    fault : str
        What it is called.
    units : mapping of str to str
        Of the outputs.
    """
    outputs = [str(name).removeprefix("healthy.") for name in table.columns if str(name).startswith("healthy.")]
    drawn = outputs[:MAX_OUTPUTS]
    columns = table[[f"{kind}.{name}" for name in drawn for kind in ("healthy", "fault")]].to_numpy(np.float64)
    kept = extremes(columns, MAX_ROWS)
    times, charts = table["time"].to_numpy(np.float64)[kept], []
    for k, name in enumerate(drawn):
        both = columns[:, 2 * k : 2 * k + 2]
        stds, unit = np.sqrt(np.nanmean(both**2, axis=0)), units.get(name) or ""
        texts = (f"healthy model, std {stds[0]:.3g} {unit}", f"with {fault}, std {stds[1]:.3g} {unit}")
        layers = (
            Layer("line", {"x": times, "y": short(both[kept, 0])}, "grey", width=1, label=texts[0]),
            Layer("line", {"x": times, "y": short(both[kept, 1])}, "red", width=1, label=texts[1]),
            Layer("rule", {"y": 0.0}, "ink"),
        )
        y = Axis(label(f"residual of {name}", units.get(name)))
        charts.append(Chart(Axis("time (s)", linked="time"), y, layers, 190))
    return stacked(charts)
