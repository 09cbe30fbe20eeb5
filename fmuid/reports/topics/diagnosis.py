"""A diagnosis: verdict, causes, notes, charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import extremes
from fmuid.diagnosis import (
    BaselineDeviation,
    BaselineSource,
    CauseScore,
    ChangeEvidence,
    Diagnosis,
    EstimatedChange,
    Explanation,
)
from fmuid.formatting import has_unit, label, listed, rounded, with_std
from fmuid.reports.chart import (
    LIMITS,
    Axis,
    Chart,
    ChartGrid,
    Data,
    Layer,
    Units,
    intervals,
    kinds,
    rows_of,
    short,
    stacked,
)
from fmuid.reports.document import (
    PAGE,
    Document,
    Message,
    Remark,
    Section,
    Tone,
    doubt,
    origin_of,
    plain,
    table_of_rows,
)
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.reports.topics.solver_check import solver_remarks
from fmuid.runs import DiagnosisRun

RESIDUAL = "Residual of the healthy model, and with the cause. With the right cause only noise remains."
CAUSES = (
    "Decrease of the cost by each cause alone. Red causes explain the data; the table contains other explanations "
    "and their odds. The pointer shows the most similar cause: signatures at a small angle are indistinguishable."
)
CHANGES_CAPTION = "Sizes of the causes in the verdict, with 95 % intervals."
TONES: dict[str, Tone] = {"healthy": "good", "undecided": "doubt"}
MAX_CAUSES = 12  # bars of the chart: the most significant causes
MIN_STATISTIC = 0.1  # lower end of the logarithmic axis of D


class DiagnosisMessage(Message, section="causes"):
    """Verdict of a diagnosis, and its notes."""

    FAULT = plain("FAULT: {causes} (p = {p}).", "p: probability of such a change without a fault")
    EQUAL = plain("{kind}, indistinguishable: {causes} (p = {p}).", remedy="Use another excitation.")
    CHANGE = plain("CHANGE WITHOUT FAULT: {causes} (p = {p}).")
    UNEXPLAINED = plain(
        "UNEXPLAINED CHANGE: residual variance is {ratio:.3g} × baseline{even} (p = {p}).",
        "a fault without a model",
        "Add a fault model, or check sensors and inputs.",
    )
    UNEXPLAINED_INPUTS = plain(
        "UNEXPLAINED CHANGE{closest}: residual differs from healthy data (p = {p}).",
        "a fault without a model, or another operating point",
        "Add a fault model, or healthy data of this operating point.",
    )
    UNDECIDED = plain(
        "UNDECIDED: {sizes} indistinguishable from allowed changes of the healthy machine.",
        "allowed: by the baseline's uncertainty, times `std_factor`",
        "Reduce `std_factor`, or use another excitation.",
    )
    HEALTHY = plain(
        "HEALTHY at {level:g} % false-alarm rate (p = {p}){likely}.",
        "smaller faults remain possible: see `fmuid design`",
    )
    PARTLY = doubt("The causes explain {share:.0%} of the change; their sizes are approximate.")
    SHOWS = plain(
        "A fault would show from {sizes} (95 % of such records).",
        "a smaller one may be there: record longer, or with more excitation",
    )
    CHECK = plain("Check first: {what}.")
    COVERED = plain("Healthy records: {count}; {ranges}.", "mean and rms values of the inputs")
    OUTSIDE = doubt(
        "Outside the baseline: {name} = {value:.3g}, healthy {low:.3g} to {high:.3g}.",
        remedy="Add healthy data of this operating point.",
    )
    COMMON = plain("Healthy parameters: {values}.")
    RESIDUAL = plain(
        "Residual variance: {ratio:.3g} × baseline (p = {probability:.2g}).", "a small p means an unexplained rest"
    )
    STRUCTURE = plain(
        "Residual variance: {ratio:.3g} × baseline; unexplained structure: p = {probability:.2g}.",
        "beside healthy data; more variance without structure is noise of a sensor",
    )
    MODEL_ERROR = plain("Fault-model error: {share:.2g} % along other signatures.")
    DEVIATION = doubt(
        "{name} is {distance:.2g} σ from its baseline.",
        remedy="Raise `std_factor`, or look for a change of the machine.",
    )
    MISMATCHED = doubt(
        "{name}: the fault model without fault differs from the healthy model.",
        remedy="Check its `variable_map` and `fixed` values.",
    )
    NOT_TESTED = doubt(
        "Sensor and supply errors were not tested; they can mimic faults.",
        remedy="List healthy data in `diagnosis.healthy_data`.",
    )
    UNSTEADY = doubt("The cause depends on the linearization point: it is one of several.")
    FROM_FILE = plain("Healthy data taken from baseline.npz.")
    FILE_UNUSED = doubt(
        "baseline.npz not used ({how}): healthy data evaluated again.",
        remedy="Identify the healthy study again with the same faults.",
    )


UNLIKE = {
    BaselineSource.DAMAGED: "damaged",
    BaselineSource.OTHER_MODELS: "other models or values",
    BaselineSource.OTHER_CAUSES: "other faults or causes",
    BaselineSource.OTHER_NOISE: "other noise variance",
    BaselineSource.OTHER_RECORDS: "other data files",
}
CHANGES = {
    "gain": "gain of sensor {}",
    "offset": "offset of sensor {}",
    "delay": "delay of sensor {}",
    "input gain": "gain of input {}",
    "joint": "joint in line {}",
    "dead time": "dead time of the inverter{}",
    "parameter": "drift of parameter {}",
    "noise": "noise of sensor {}",
}


def verdict(found: Diagnosis) -> Remark:
    """Return the verdict."""
    evidence = found.evidence
    said = [explanation_words(each) for each in evidence.explanations]
    outside = ", outside the baseline" if found.coverage is not None and found.coverage.outside else ""
    given: dict[str, object] = {"p": chance(evidence.probability) + outside}
    if found.kind == "unexplained":
        given["p"] = chance(found.unexplained.probability) + outside
        given["closest"] = f", closest: {said[0]}" if said else ""
        given |= {"ratio": found.unexplained.ratio, "even": f" even with {said[0]}" if said else ""}
        from_result = evidence.basis.alone
        how = DiagnosisMessage.UNEXPLAINED if from_result else DiagnosisMessage.UNEXPLAINED_INPUTS
    elif found.kind == "ambiguous":
        given["causes"] = alternatives(evidence.explanations)
        given["kind"] = "FAULT" if all(each.faults for each in evidence.explanations) else "CHANGE"
        how = DiagnosisMessage.EQUAL
    elif evidence.alarm:
        given["causes"] = said[0]
        how = DiagnosisMessage.FAULT if found.kind == "fault" else DiagnosisMessage.CHANGE
    elif found.kind == "undecided":
        given["sizes"] = listed(list(found.undetermined))
        how = DiagnosisMessage.UNDECIDED
    else:
        likely = min(evidence.suspects, key=lambda each: each.probability, default=None)
        given["likely"] = "" if likely is None else f"; most likely: {change_name(likely.change)}"
        given["level"] = 100 * found.level
        how = DiagnosisMessage.HEALTHY
    return how.said(**given)


def diagnosis_notes(found: Diagnosis) -> list[Remark]:
    """Return the notes beside the verdict."""
    evidence = found.evidence
    notes = [*exposure_notes(found), *check_first(found), *coverage_notes(found), *deviation_notes(found.deviation)]
    notes += solver_remarks(found.fitted, found.accuracy)
    notes += [DiagnosisMessage.MISMATCHED.said("changes", name=name) for name in found.mismatched]
    if evidence.alarm and found.is_partial and found.kind != "unexplained":
        notes.append(DiagnosisMessage.PARTLY.said("explained", share=evidence.explained))
    if evidence.basis.alone:
        notes.append(DiagnosisMessage.NOT_TESTED.said())
    notes += basis_notes(evidence.basis)
    if evidence.alarm and not evidence.steady:
        notes.append(DiagnosisMessage.UNSTEADY.said())
    return notes


def exposure_notes(found: Diagnosis) -> list[Remark]:
    """Return the sizes from which faults would show, where none does."""
    if found.kind not in ("healthy", "undecided") or not found.detectable:
        return []
    each = [(found[name], size) for name, size in found.detectable.items()]
    sizes = [f"{change_name(one)} {size:.2g} {one.unit if has_unit(one.unit) else ''}".strip() for one, size in each]
    return [DiagnosisMessage.SHOWS.said("changes", sizes=listed(sizes))]


CHECKS = {
    "gain": "scaling and range of sensor {}",
    "offset": "zero of sensor {}",
    "delay": "filter and sampling time of sensor {}",
    "input gain": "supply and measurement of {}",
    "parameter": "temperature, and value of {}",
    "joint": "terminals and joints of line {}",
    "dead time": "dead time of the inverter{}",
    "noise": "cable, shield and connector of sensor {}",
}


def check_first(found: Diagnosis) -> list[Remark]:
    """Return what to check first: the causes of the verdict; an unexplained change has none."""
    if found.kind == "unexplained":
        return []
    each = [change for one in found.evidence.explanations for change in one.changes]
    said = [f"the part with fault {e.fault}" if e.fault else CHECKS[e.kind.value].format(e.variable) for e in each]
    return [DiagnosisMessage.CHECK.said(what="; ".join(dict.fromkeys(said)))] if said else []


def coverage_notes(found: Diagnosis) -> list[Remark]:
    """Return the operating points of the baseline."""
    if found.coverage is None:
        return []
    ranges = ", ".join(f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in found.coverage.ranges.items())
    notes = [DiagnosisMessage.COVERED.said(count=found.coverage.records, ranges=ranges)]
    for each in found.coverage.outside:
        given = {"name": each.name, "value": each.value, "low": each.low, "high": each.high}
        notes.append(DiagnosisMessage.OUTSIDE.said(**given))
    return notes


def basis_notes(basis: BaselineSource) -> list[Remark]:
    """Return the origin of the baseline, if it is a file."""
    if basis is BaselineSource.FILE:
        return [DiagnosisMessage.FROM_FILE.said("")]
    return [DiagnosisMessage.FILE_UNUSED.said("", how=UNLIKE[basis])] if basis in UNLIKE else []


def deviation_notes(deviation: BaselineDeviation | None) -> list[Remark]:
    """Return the healthy parameter far from its prior, if any."""
    if deviation is None:
        return []
    given = {"name": deviation.name, "distance": deviation.distance}
    return [DiagnosisMessage.DEVIATION.said("changes", **given)]


def alternatives(explanations: Sequence[Explanation]) -> str:
    """Return explanations; what all of them have stands once, behind."""
    both = tuple(change for change in explanations[0].changes if all(change in one.changes for one in explanations))
    if len(explanations) == 1 or any(set(one.changes) <= set(both) for one in explanations):
        return " or ".join(map(explanation_words, explanations))
    alone = (replace(one, changes=tuple(each for each in one.changes if each not in both)) for one in explanations)
    behind = f"; with each {explanation_words(Explanation(both, 1.0))}" if both else ""
    return " or ".join(map(explanation_words, alone)) + behind


def explanation_words(each: Explanation) -> str:
    """Return the changes that explain data together, with their sizes."""
    said = [f"{e.fault}, {e.variable} =" if e.fault else f"{change_name(e)}," for e in each.changes]
    return " together with ".join(f"{name} {change_size(e)}" for name, e in zip(said, each.changes, strict=True))


def change_size(change: EstimatedChange) -> str:
    """Return the size of a change ± σ; gains in percent."""
    if change.kind.is_share:
        return f"{with_std(100 * change.value, 100 * change.std)} %"
    at = f" at {change.angle} = {change.angle_value:.3g}" if change.angle else ""
    unit = f" {change.unit}" if has_unit(change.unit) else ""
    return f"{with_std(change.value, change.std)}{unit}{at}"


def change_name(change: EstimatedChange) -> str:
    """Return the name of a change."""
    if change.fault:
        return f"{change.fault} ({change.variable})"
    return CHANGES[change.kind.value].format(change.variable)


def chance(probability: float) -> str:
    """Return a probability to two digits."""
    return f"{probability:.2g}" if probability > 1e-300 else "below 1e-300"


def diagnosis_document(found: DiagnosisRun) -> Document:
    """Return the document of a diagnosis."""
    result = found.diagnosis
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in result.nominal.items())
    left = {"ratio": result.unexplained.ratio, "probability": result.unexplained.probability}
    said = [
        verdict(result),
        DiagnosisMessage.COMMON.said("", values=values),
        (DiagnosisMessage.RESIDUAL if result.evidence.basis.alone else DiagnosisMessage.STRUCTURE).said(
            "explained", **left
        ),
        DiagnosisMessage.MODEL_ERROR.said("", share=100 * result.evidence.model_error),
        *diagnosis_notes(result),
    ]
    sections = diagnosis_sections(result)
    if result.residuals is not None and result.evidence.explanations:
        best = " and ".join(change_name(each) for each in result.evidence.explanations[0].changes)
        drawn = explained_charts(result.residuals, best, found.units)
        sections.append(Section("explained", "Residual with the cause", RESIDUAL, charts=(drawn,), beside=1))
    sections += preprocessing_sections(found.prepared, len(found.prepared) > 1, "prepared")
    tone, origin = TONES.get(result.kind, "bad"), origin_of(found.origin)
    return Document("diagnosis", "Diagnosis", result.kind, tone, tuple(said), tuple(sections), **origin)


def diagnosis_sections(found: Diagnosis) -> list[Section]:
    """Return the sections of a diagnosis."""
    evidence, heads = found.evidence, ("cause", "size", "interval (95 %)", "D", "probability", "nearest", "")
    suspects = sorted(evidence.suspects, key=lambda each: each.probability)
    in_verdict = {change.label for each in evidence.explanations for change in each.changes}
    rows = [_cause(each, found[each.change.label], in_verdict) for each in suspects]
    words = [head for head in heads if head not in ("D", "probability")]
    odds = [(explanation_words(each), f"{each.odds:.2g}") for each in evidence.explanations]
    table, drawn = table_of_rows(("explanation", "odds"), odds), cause_evidence(evidence)
    sections = [
        Section("looked-at", "Causes", table=table_of_rows(heads, rows, words, ("interval (95 %)",))),
        Section("causes", "Causes", CAUSES, table, (drawn,), 1, shown=PAGE),
        Section("changes", "Sizes", CHANGES_CAPTION, charts=tuple(change_charts(evidence)), beside=2),
    ]
    return [each for each in sections if each.charts or each.table]


def _cause(score: CauseScore, change: EstimatedChange, in_verdict: set[str]) -> tuple[str, ...]:
    scale, known = 100 if change.kind.is_share else 1, change.is_determined
    low, high = (rounded(scale * end, 0.5 * scale * change.std) for end in change.interval())
    size, interval = (change_size(change), f"{low} to {high}") if known else ("unknown", "")
    numbers = (f"{score.statistic:.4g}", chance(score.probability), _nearest(score))
    return change_name(change), size, interval, *numbers, "in the verdict" if change.label in in_verdict else ""


def _nearest(score: CauseScore) -> str:
    return f"{score.rival}, {math.degrees(score.rival_angle):.0f}°" if score.rival else ""


def cause_evidence(found: ChangeEvidence) -> Chart:
    """Return the decrease of the cost by each cause alone."""
    kept = sorted(found.suspects, key=lambda each: each.probability)[:MAX_CAUSES]
    names, told = tuple(change_name(each.change) for each in kept), _array([each.statistic for each in kept])
    in_verdict = {change_name(change) for each in found.explanations for change in each.changes}
    bars: Data = {"y": names, "x": np.maximum(told, MIN_STATISTIC), "x0": MIN_STATISTIC, "told": told}
    sizes = {"size": tuple(change_size(each.change) for each in kept), "near": tuple(map(_nearest, kept))}
    data: Data = {**bars, "p": _array([each.probability for each in kept]), **sizes}
    hover = (("D", "@told{0.000}"), ("p", "@p{0.0e}"), ("size", "@size"), ("nearest signature", "@near"))
    mine = np.array([name in in_verdict for name in names], dtype=bool)
    layers = kinds("bars", data, [("in the verdict", "red", mine), ("other causes", "grey", ~mine)], hover=hover)
    reach = (MIN_STATISTIC, 2.0 * float(told.max(initial=1.0)))
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
