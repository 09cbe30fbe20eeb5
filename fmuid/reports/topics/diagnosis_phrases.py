"""What a diagnosis found, in words: the verdict in one sentence, changes and sizes, notes on each fault model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fmuid.diagnosis import BaselineSource
from fmuid.formatting import has_unit, listed, rounded, unit_text, with_std
from fmuid.identification import LEAST_STD_FACTOR
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.solver_check import accuracy_words

if TYPE_CHECKING:
    from fmuid.diagnosis import (
        BaselineDeviation,
        ChangeEvidence,
        Diagnosis,
        EstimatedChange,
        Explanation,
        FaultHypothesis,
        FaultSize,
    )


def diagnosis_notes(found: Diagnosis) -> list[str]:
    """Return what is to be known of a diagnosis beside its verdict."""
    own = [f"{each.name}: {note}" for each in found.hypotheses for note in hypothesis_notes(each)]
    return [*strain_words(found.strain), *own, *simulation_notes(found), *scope_notes(found)]


def verdict(found: Diagnosis) -> str:
    """Return what it is, in one sentence."""
    if found.evidence is not None and found.evidence.alarm and found.kind != "unexplained":
        return _evidence_words(found, found.evidence)
    named = [found[name] for name in found.named]
    if found.kind == "unexplained" and found.evidence is not None:
        return (
            "Something else has changed: the residual goes with the inputs otherwise than in the healthy records "
            f"(probability {chance(found.unexplained.probability)}), and no cause explains most of it"
        )
    if found.kind == "unexplained":
        said = (
            f"Something else is wrong: the residual's variance is {found.unexplained.ratio:.3g} times the noise "
            f"of the healthy machine (probability {chance(found.unexplained.probability)})"
        )
        if not named:
            return f"{said}, and no fault that was looked for explains it"
        return f"{said} even with the most likely fault, {hypothesis_words(named[0], found.level)}"
    if found.kind == "fault":
        likely = f"probability without a fault {chance(named[0].adjusted)}"
        return f"Fault found: {hypothesis_words(named[0], found.level)} ({likely}){_rest(found)}"
    if found.kind == "ambiguous":
        which = listed([each.name for each in named])
        each_one = "; or ".join(hypothesis_words(each, found.level) for each in named)
        return f"Fault found, but the data cannot tell {which} apart: {each_one}{_rest(found)}"
    if found.kind == "undecided":
        return f"Whether there is a fault stays open: {_obstacle(found)}"
    if found.evidence is not None:
        return (
            f"Nothing new found at a false-alarm level of {100 * found.level:g} %, of {len(found.evidence.suspects)} "
            f"causes looked at (probability of as much by chance {chance(found.evidence.probability)})"
        )
    nearest = min(found.hypotheses, key=lambda each: each.probability)
    return (
        f"No fault found at a false-alarm level of {100 * found.level:g} %; the most likely one is "
        f"{hypothesis_words(nearest, found.level)} (probability without a fault {chance(nearest.adjusted)})"
    )


def _evidence_words(found: Diagnosis, evidence: ChangeEvidence) -> str:
    """Return what is new beside the healthy records, in one sentence."""
    likely = f"probability if nothing is new {chance(evidence.probability)}"
    said = [explanation_words(each) for each in evidence.explanations]
    if found.kind == "ambiguous":
        head = "Fault found" if all(each.faults for each in evidence.explanations) else "Something has changed"
        return f"{head}, but the record cannot tell what: {'; or '.join(said)} ({likely}){_rest(found)}"
    head = "Fault found" if found.kind == "fault" else "No fault, but something else has changed"
    return f"{head}: {said[0]} ({likely}){_rest(found)}"


def explanation_words(each: Explanation) -> str:
    """Return the changes that explain a record together, with their sizes."""
    return " together with ".join(change_words(change) for change in each.changes)


# What a change is called; {} is its variable.
CHANGES = {
    "gain": "the gain of the sensor of {}",
    "offset": "an offset of the sensor of {}",
    "delay": "a delay of the sensor of {}",
    "input gain": "the gain of the input {}",
    "parameter": "the parameter {} beyond what was foreseen",
}


def change_words(change: EstimatedChange) -> str:
    """Return a change with its size."""
    if change.fault:
        return f"{change.fault}, {change.variable} = {change_size(change)}"
    return f"{change_name(change)}, {change_size(change)}"


def change_size(change: EstimatedChange) -> str:
    """Return the size of a change with its standard deviation; shares in percent."""
    if change.kind.is_share:
        return f"{with_std(100 * change.value, 100 * change.std)} %"
    at = f" at {change.angle} = {change.angle_value:.3g}" if change.angle else ""
    unit = f" {change.unit}" if has_unit(change.unit) else ""
    return f"{with_std(change.value, change.std)}{unit}{at}"


def change_name(change: EstimatedChange) -> str:
    """Return what has changed, without its size."""
    if change.fault:
        return f"{change.fault} ({change.variable})"
    return CHANGES[change.kind.value].format(change.variable)


def _rest(found: Diagnosis) -> str:
    """Say what the fault leaves unexplained, "" for nothing."""
    if not found.unexplained.larger:
        return ""
    return (
        f"; its model explains {found.unexplained.explained:.0%} of what exceeds the noise, not all of it: "
        "the size is that of a model that is nearly right"
    )


def _obstacle(found: Diagnosis) -> str:
    if not found.ended:
        return "the search for the healthy model did not end at a minimum"
    each = next(each for each in found.hypotheses if not each.ended or each.undetermined)
    if each.undetermined:
        return "; ".join(map(direction_words, each.undetermined))
    return f"the search for the fault {each.name} did not end at a minimum"


def hypothesis_words(each: FaultHypothesis, level: float) -> str:
    """Return the name and the sizes that matter."""
    sizes = [size_words(size, located=each.located(size, level)) for size in each.significant(level)]
    return f"{each.name}, " + listed(sizes)


def size_words(size: FaultSize, *, located: bool) -> str:
    """Return name, value and standard deviation; with the angle where that is asked for."""
    unit = f" {size.unit}" if has_unit(size.unit) else ""
    if math.isinf(size.std):
        return f"{size.name} not determined"
    at = f" at {size.angle} = {with_std(size.angle_value, size.angle_std)}" if located and size.angle else ""
    return f"{size.name} = {with_std(size.value, size.std)}{unit}{at}"


def hypothesis_notes(each: FaultHypothesis) -> list[str]:
    """Return what is to be known of one fault model."""
    notes = [direction_words(direction) for direction in each.undetermined]
    notes += [f"without the healthy record, {direction_words(direction)}" for direction in each.prior_determined]
    if not each.healthy_at_zero:
        notes.append(
            f"without its fault this model is not the healthy machine: its criterion differs by {each.mismatch:.3g}; "
            "check its names and values"
        )
    if each.colour >= LEAST_STD_FACTOR:
        notes.append(
            f"the residual is not white: D is divided by {each.colour**2:.3g}, and the standard deviations are larger "
            f"by {each.colour:.3g}"
        )
    return notes


def simulation_notes(found: Diagnosis) -> list[str]:
    """Return what is to be said of the error of the simulation, of each fit what was not said of one before it."""
    said: dict[str, str] = {}
    for name, checked in [("", found.checked), *((each.name, each.checked) for each in found.hypotheses)]:
        for words in accuracy_words(checked.names, checked.accuracy):
            said.setdefault(words, name)
    return [f"{name}: {words}" if name else words for words, name in said.items()]


def scope_notes(found: Diagnosis) -> list[str]:
    """Return what was not looked at, or did not settle."""
    if found.evidence is None:
        return [
            "errors of sensors and of the supply were not looked at, and may look like a fault: name the tables of the "
            "healthy machine as [diagnosis] records"
        ]
    said = basis_notes(found.evidence.basis)
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
    """Say where the healthy machine is from, nothing where only records can be."""
    if basis is BaselineSource.RECORDS:
        return []
    if basis is BaselineSource.FILE:
        return ["what the healthy records show is from the baseline.npz beside the healthy result"]
    return [
        f"the baseline.npz beside the healthy result is {UNLIKE[basis]} and was not used: "
        "the healthy records were examined again"
    ]


def strain_words(strain: BaselineDeviation | None) -> list[str]:
    """Say which nominal parameter has left what was foreseen, nothing where none has."""
    if strain is None:
        return []
    return [
        f"{strain.name} lies {strain.distance:.2g} standard deviations from what the healthy record and inflate "
        "foresee: it has changed more than was expected, or something else has"
    ]


def chance(probability: float) -> str:
    """Return a probability to two digits."""
    return f"{probability:.2g}" if probability > 1e-300 else "below 1e-300"


def faults_columns(found: Diagnosis) -> dict[str, list[str]]:
    """Return the table of the faults looked for; what concerns one as a whole stands in its first row."""
    heads = ("fault", "size", "value", "interval (95 %)", "unit", "at", "D", "threshold", "probability", "")
    rows = []
    for each in found.hypotheses:
        for k, size in enumerate(each.sizes):
            (low, high), known, width = size.interval(), math.isfinite(size.std), 0.5 * size.std
            at = size.angle and each.located(size, found.level)
            found_to_be = "named" if each.name in found.named else "less likely" if each.name in found.called else ""
            rows.append(
                (
                    "" if k else each.name,
                    size.name,
                    with_std(size.value, size.std) if known else "not determined",
                    f"{rounded(low, width)} to {rounded(high, width)}" if known else "",
                    unit_text(size.unit),
                    f"{size.angle} = {with_std(size.angle_value, size.angle_std)}" if at else "",
                    "" if k else f"{each.statistic:.4g}",
                    "" if k else f"{each.threshold:.4g}",
                    chance(size.probability if k else each.adjusted),
                    "" if k else found_to_be,
                )
            )
    return {head: [row[k] for row in rows] for k, head in enumerate(heads)}
