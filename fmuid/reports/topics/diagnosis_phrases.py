"""A diagnosis as messages: verdict, causes, notes."""

from __future__ import annotations

import math

from fmuid.diagnosis import BaselineDeviation, BaselineSource, Diagnosis, EstimatedChange, Explanation
from fmuid.formatting import has_unit, listed, rounded, with_std
from fmuid.reports.document import Message, Remark, doubt, plain
from fmuid.reports.topics.solver_check import solver_remarks


class DiagnosisMessage(Message, section="causes"):
    """Verdict of a diagnosis, and its notes."""

    FAULT = plain("FAULT: {causes} (p = {p}).", "p: probability of such a change without a fault")
    EQUAL_FAULTS = plain("FAULT, indistinguishable: {causes} (p = {p}).", remedy="Use another excitation.")
    EQUAL_CAUSES = plain("CHANGE, indistinguishable: {causes} (p = {p}).", remedy="Use another excitation.")
    CHANGE = plain("CHANGE without fault: {causes} (p = {p}).")
    UNEXPLAINED = plain(
        "UNEXPLAINED CHANGE: residual variance is {ratio:.3g} × baseline{even} (p = {p}).",
        "a fault without a model",
        "Add a fault model, or check sensors and inputs.",
    )
    UNEXPLAINED_INPUTS = plain(
        "UNEXPLAINED CHANGE: residual–input correlation differs from healthy data (p = {p}).",
        "a fault without a model, or another operating point than in the healthy data",
        "Add a fault model, or healthy data of this operating point.",
    )
    UNDECIDED = plain(
        "UNDECIDED: {sizes} indistinguishable from allowed changes of the healthy machine.",
        "allowed: by the baseline's uncertainty, times `std_factor`",
        "Reduce `std_factor`, or use another excitation.",
    )
    NO_FAULT = plain(
        "NO FAULT at {level:g} % false-alarm rate (p = {p}){likely}.",
        "smaller faults remain possible: `fmuid design` shows the minimum detectable size",
    )
    PARTLY = doubt("The causes explain {share:.0%} of the change; their sizes are approximate.")
    COMMON = plain("Healthy parameters: {values}.")
    RESIDUAL = plain(
        "Residual variance: {ratio:.3g} × baseline (p = {probability:.2g}).",
        "after the verdict's causes; a small p means an unexplained rest",
    )
    MODEL_ERROR = plain(
        "Fault-model error: {share:.2g} % along other signatures.",
        "difference between a fault's effect and that of its model",
    )
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
    FROM_FILE = plain("Healthy data taken from baseline.npz.", "`fmuid identify` of the healthy study has written it")
    FILE_UNUSED = doubt(
        "baseline.npz not used ({how}): healthy data evaluated again.",
        "the file beside the baseline result does not fit this study",
        "Identify the healthy study again with the same faults.",
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
    "parameter": "drift of parameter {}",
}


def verdict(found: Diagnosis) -> Remark:
    """Return the verdict."""
    evidence = found.evidence
    said = [explanation_words(each) for each in evidence.explanations]
    given: dict[str, object] = {"p": chance(evidence.probability)}
    if found.kind == "unexplained":
        given["p"] = chance(found.unexplained.probability)
        given |= {"ratio": found.unexplained.ratio, "even": f" even with {said[0]}" if said else ""}
        from_result = evidence.basis is BaselineSource.RESULT
        how = DiagnosisMessage.UNEXPLAINED if from_result else DiagnosisMessage.UNEXPLAINED_INPUTS
    elif found.kind == "ambiguous":
        given["causes"] = " or ".join(said)
        faults = all(each.faults for each in evidence.explanations)
        how = DiagnosisMessage.EQUAL_FAULTS if faults else DiagnosisMessage.EQUAL_CAUSES
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
        how = DiagnosisMessage.NO_FAULT
    return how.said(**given)


def diagnosis_notes(found: Diagnosis) -> list[Remark]:
    """Return the notes beside the verdict."""
    evidence = found.evidence
    notes = deviation_notes(found.deviation)
    notes += solver_remarks(found.fitted, found.accuracy)
    notes += [DiagnosisMessage.MISMATCHED.said("changes", name=name) for name in found.mismatched]
    if evidence.alarm and found.unexplained.larger and found.kind != "unexplained":
        notes.append(DiagnosisMessage.PARTLY.said("explained", share=evidence.explained))
    if evidence.basis is BaselineSource.RESULT:
        notes.append(DiagnosisMessage.NOT_TESTED.said())
    notes += basis_notes(evidence.basis)
    if evidence.alarm and not evidence.steady:
        notes.append(DiagnosisMessage.UNSTEADY.said())
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


def causes_columns(found: Diagnosis) -> dict[str, list[str]]:
    """Return the table of the causes looked at, the likeliest first."""
    heads = ("cause", "size", "interval (95 %)", "D", "probability", "nearest", "")
    named = {change.label for each in found.evidence.explanations for change in each.changes}
    rows = []
    for each in sorted(found.evidence.suspects, key=lambda each: each.probability):
        change = found[each.change.label]
        near = f"{each.rival}, {math.degrees(each.rival_angle):.0f}°" if each.rival else ""
        low, high = (100 * end if change.kind.is_share else end for end in change.interval())
        width = 0.5 * change.std * (100 if change.kind.is_share else 1)
        known = change.is_determined
        rows.append(
            (
                change_name(change),
                change_size(change) if known else "unknown",
                f"{rounded(low, width)} to {rounded(high, width)}" if known else "",
                f"{each.statistic:.4g}",
                chance(each.probability),
                near,
                "in the verdict" if change.label in named else "",
            )
        )
    return {head: [row[k] for row in rows] for k, head in enumerate(heads)}
