"""A diagnosis as text: verdict, causes, notes."""

from __future__ import annotations

import math

from fmuid.diagnosis import BaselineDeviation, BaselineSource, Diagnosis, EstimatedChange, Explanation
from fmuid.formatting import has_unit, listed, rounded, with_std
from fmuid.reports.topics.solver_check import accuracy_words


def diagnosis_notes(found: Diagnosis) -> tuple[str, ...]:
    """Return the notes beside the verdict."""
    notes = [*deviation_words(found.deviation), *accuracy_words(found.fitted, found.accuracy)]
    notes += [
        f"{name}: without its fault this model is not the healthy machine: check its names and values"
        for name in found.mismatched
    ]
    return *notes, *scope_notes(found)


def verdict(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    evidence = found.evidence
    said = [explanation_words(each) for each in evidence.explanations]
    likely = f"probability if nothing is new {chance(evidence.probability)}"
    if found.kind == "unexplained" and evidence.basis is BaselineSource.RESULT:
        head = (
            f"Something else is wrong: the residual's variance is {found.unexplained.ratio:.3g} times the noise "
            f"of the healthy machine (probability {chance(found.unexplained.probability)})"
        )
        return f"{head} even with {said[0]}" if said else f"{head}, and no fault that was looked for explains it"
    if found.kind == "unexplained":
        return (
            "Something else has changed: the residual goes with the inputs otherwise than in the healthy records "
            f"(probability {chance(found.unexplained.probability)}), and no cause explains most of it"
        )
    if found.kind == "ambiguous":
        head = "Fault found" if all(each.faults for each in evidence.explanations) else "Something has changed"
        return f"{head}, but the record cannot tell what: {'; or '.join(said)} ({likely}){_rest(found)}"
    if evidence.alarm:
        head = "Fault found" if found.kind == "fault" else "No fault, but something else has changed"
        return f"{head}: {said[0]} ({likely}){_rest(found)}"
    if found.kind == "undecided":
        which = listed(list(found.undetermined))
        return (
            f"Whether there is a fault stays open: this record cannot tell {which} from what may change in a sound "
            "machine"
        )
    return (
        f"Nothing new found at a false-alarm level of {100 * found.level:g} %, of {len(evidence.suspects)} "
        f"causes looked at (probability of as much by chance {chance(evidence.probability)})"
    )


def explanation_words(each: Explanation) -> str:
    """Return the changes that explain a record together, with their sizes."""
    said = [f"{e.fault}, {e.variable} =" if e.fault else f"{change_name(e)}," for e in each.changes]
    return " together with ".join(f"{name} {change_size(e)}" for name, e in zip(said, each.changes, strict=True))


# What a change is called; {} is its variable.
CHANGES = {
    "gain": "the gain of the sensor of {}",
    "offset": "an offset of the sensor of {}",
    "delay": "a delay of the sensor of {}",
    "input gain": "the gain of the input {}",
    "parameter": "the parameter {} beyond what was foreseen",
}


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


def _rest(found: Diagnosis) -> str:
    if not found.unexplained.larger:
        return ""
    return (
        f"; its model explains {found.evidence.explained:.0%} of what exceeds the noise, not all of it: "
        "the size is that of a model that is nearly right"
    )


def scope_notes(found: Diagnosis) -> list[str]:
    """Return the limits of a diagnosis."""
    said = basis_notes(found.evidence.basis)
    if found.evidence.basis is BaselineSource.RESULT:
        said = [
            "errors of sensors and of the supply were not looked at, and may look like a fault: name the tables of the "
            "healthy machine as [diagnosis] records"
        ]
    if found.evidence.alarm and not found.evidence.steady:
        said.append("the name changes with the point where the models are linearised: take it for one of several")
    return said


# What the file of the healthy study is of, where it does not serve.
UNLIKE = {
    BaselineSource.DAMAGED: "damaged",
    BaselineSource.OTHER_MODELS: "of other models or values",
    BaselineSource.OTHER_CAUSES: "of other faults or causes",
    BaselineSource.OTHER_NOISE: "of another noise variance",
    BaselineSource.OTHER_RECORDS: "of other records",
}


def basis_notes(basis: BaselineSource) -> list[str]:
    """Return the origin of the baseline, if it is a file."""
    if basis in (BaselineSource.RECORDS, BaselineSource.RESULT):
        return []
    if basis is BaselineSource.FILE:
        return ["what the healthy records show is from the baseline.npz beside the healthy result"]
    return [
        f"the baseline.npz beside the healthy result is {UNLIKE[basis]} and was not used: "
        "the healthy records were examined again"
    ]


def deviation_words(deviation: BaselineDeviation | None) -> list[str]:
    """Return the healthy parameter far from its prior, if any."""
    if deviation is None:
        return []
    return [
        f"{deviation.name} lies {deviation.distance:.2g} standard deviations from what the healthy record and inflate "
        "foresee: it has changed more than was expected, or something else has"
    ]


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
                change_size(change) if known else "not determined",
                f"{rounded(low, width)} to {rounded(high, width)}" if known else "",
                f"{each.statistic:.4g}",
                chance(each.probability),
                near,
                "named" if change.label in named else "",
            )
        )
    return {head: [row[k] for row in rows] for k, head in enumerate(heads)}
