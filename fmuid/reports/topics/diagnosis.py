"""A diagnosis: verdict, causes, charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import extremes
from fmuid.diagnosis import ChangeEvidence, Diagnosis
from fmuid.formatting import label, with_std
from fmuid.reports.chart import (
    LIMITS,
    Axis,
    Chart,
    ChartGrid,
    Color,
    Data,
    Layer,
    Units,
    intervals,
    rows_of,
    short,
    stacked,
)
from fmuid.reports.document import PAGE, Document, Section, Tone, origin_of, table_of
from fmuid.reports.topics.diagnosis_phrases import (
    DiagnosisMessage,
    causes_columns,
    change_name,
    change_size,
    diagnosis_notes,
    explanation_words,
    verdict,
)
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.runs import DiagnosisRun

RESIDUAL = "Residual of the healthy model, and with the cause. With the right cause only noise remains."
CAUSES = (
    "Decrease of the cost by each cause alone. Red causes explain the data; the table contains other explanations "
    "and their odds. The pointer shows the most similar cause: signatures at a small angle are indistinguishable."
)
CHANGES = "Sizes of the causes in the verdict, with 95 % intervals."
TONES: dict[str, Tone] = {"healthy": "good", "undecided": "doubt"}


def diagnosis_document(found: DiagnosisRun) -> Document:
    """Return the document of a diagnosis."""
    result = found.diagnosis
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in result.nominal.items())
    left = {"ratio": result.unexplained.ratio, "probability": result.unexplained.probability}
    said = [
        verdict(result),
        DiagnosisMessage.COMMON.said("", values=values),
        DiagnosisMessage.RESIDUAL.said("explained", **left),
        DiagnosisMessage.MODEL_ERROR.said("", share=100 * result.evidence.model_error),
        *diagnosis_notes(result),
    ]
    sections = diagnosis_sections(result)
    if result.residuals is not None and result.evidence.explanations:
        best = " and ".join(change_name(each) for each in result.evidence.explanations[0].changes)
        drawn = explained_charts(result.residuals, best, found.units)
        sections.append(Section("explained", "Residual with the cause", RESIDUAL, charts=(drawn,), beside=1))
    sections += preprocessing_sections(found.prepared, len(found.prepared) > 1, "prepared")
    tone = TONES.get(result.kind, "bad")
    return Document(
        "diagnosis", "Diagnosis", result.kind, tone, tuple(said), tuple(sections), **origin_of(found.origin)
    )


def diagnosis_sections(found: Diagnosis) -> list[Section]:
    """Return the sections of a diagnosis."""
    evidence, columns = found.evidence, causes_columns(found)
    odds: dict[str, Any] = {
        "explanation": [explanation_words(each) for each in evidence.explanations],
        "odds": [f"{each.odds:.2g}" for each in evidence.explanations],
    }
    words = [head for head in columns if head not in ("D", "probability")]
    sections = [
        Section("looked-at", "Causes", table=table_of(columns, words, ("interval (95 %)",))),
        Section("causes", "Causes", CAUSES, table_of(odds), (cause_evidence(evidence),), 1, shown=PAGE),
        Section("changes", "Sizes", CHANGES, charts=tuple(change_charts(evidence)), beside=2),
    ]
    return [each for each in sections if each.charts or each.table]


MAX_CAUSES = 12
"""Bars of the chart: the most significant causes."""
MIN_STATISTIC = 0.1
"""Lower end of the logarithmic axis of D."""


def cause_evidence(found: ChangeEvidence) -> Chart:
    """Return the decrease of the cost by each cause alone."""
    kept = sorted(found.suspects, key=lambda each: each.probability)[:MAX_CAUSES]
    names = [change_name(each.change) for each in kept]
    named = {change_name(change) for each in found.explanations for change in each.changes}
    numbers = (("D", "@told{0.000}"), ("p", "@p{0.0e}"))
    hover = (*numbers, ("size", "@size"), ("nearest signature", "@near"))
    layers = []
    kinds: tuple[tuple[str, Color, bool], ...] = (("in the verdict", "red", True), ("other causes", "grey", False))
    for text, color, mine in kinds:
        here = [(name, each) for name, each in zip(names, kept, strict=True) if (name in named) is mine]
        if here:
            told = _array([each.statistic for _, each in here])
            near = [f"{e.rival}, {math.degrees(e.rival_angle):.0f}°" if e.rival else "" for _, e in here]
            sizes = tuple(change_size(each.change) for _, each in here)
            chance = _array([each.probability for _, each in here])
            bars: Data = {"y": tuple(name for name, _ in here), "x": np.maximum(told, MIN_STATISTIC)}
            more: Data = {"x0": MIN_STATISTIC, "told": told, "p": chance, "size": sizes, "near": tuple(near)}
            layers.append(Layer("bars", {**bars, **more}, color, label=text, hover=hover))
    most = max((each.statistic for each in kept), default=1.0)
    reach = (MIN_STATISTIC, 2.0 * max(most, 1.0))
    return rows_of(names, Axis("D: decrease of the cost by the cause alone", "log", reach=reach), layers, 110)


def _array(values: Sequence[float]) -> Floats:
    return np.array(values, dtype=np.float64)


def change_charts(found: ChangeEvidence) -> list[Chart]:
    """Return the size of each change with its 95 % interval."""
    charts = {}
    for each in (change for one in found.explanations for change in one.changes):
        name = change_name(each)
        if name not in charts and math.isfinite(each.std):
            scale, unit = (100.0, "%") if each.kind.is_share else (1.0, each.unit)
            text = label("size, with 95 % interval", unit)
            value, low, high = (scale * _array([number]) for number in (each.value, *each.interval()))
            layers = (*intervals((name,), value, low, high, "red", "size"), Layer("rule", {"x": 0.0}, "ink"))
            least, most = min(0.0, float(low[0])), max(0.0, float(high[0]))
            room = 0.05 * (most - least)
            charts[name] = rows_of([name], Axis(text, reach=(least - room, most + room)), layers)
    return list(charts.values())


def explained_charts(table: pd.DataFrame, fault: str, units: Units) -> ChartGrid:
    """Return each output's residual without the fault and with it."""
    outputs = [str(name).removeprefix("healthy.") for name in table.columns if str(name).startswith("healthy.")]
    drawn = outputs[: LIMITS.outputs]
    columns = table[[f"{kind}.{name}" for name in drawn for kind in ("healthy", "fault")]].to_numpy(np.float64)
    kept = extremes(columns, LIMITS.rows)
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
