"""A diagnosis: the verdict, the faults looked for, the causes, and what is to be known of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from fmuid.formatting import with_std
from fmuid.reports.document import CONSOLE, Document, Message, Remark, Section, Tone, table_of
from fmuid.reports.topics.cause_charts import (
    cause_evidence,
    change_charts,
    explained_charts,
    fault_evidence,
    size_charts,
)
from fmuid.reports.topics.diagnosis_phrases import (
    chance,
    change_name,
    change_size,
    diagnosis_notes,
    explanation_words,
    faults_columns,
    verdict,
)
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.reports.topics.provenance import origin_of

if TYPE_CHECKING:
    from fmuid.diagnosis import ChangeEvidence, Diagnosis
    from fmuid.runs import DiagnosisRun

EVIDENCE = (
    "Each bar is how much better a fault explains the data than the healthy machine does. Beyond its threshold it is "
    "significant: without a fault that happens with the false-alarm level."
)
SIZES = "Each fault's sizes with their intervals of 95 %. Where one holds zero there is no fault; the one named is red."
RESIDUAL = (
    "What the healthy model leaves unexplained, and what is left with the fault. With the right fault only noise stays."
)
CAUSES = (
    "Every cause by itself: faults, sensors, the supply, parameters. Red is what explains the record; the table has "
    "what else the record does not exclude, with its odds. The pointer shows which other cause looks most alike: at a "
    "small angle the two can hardly be told apart."
)
CHANGES = "The sizes of what explains the record, with their intervals of 95 %."
TONES: dict[str, Tone] = {"healthy": "good", "undecided": "doubt"}


class DiagnosisMessage(Message):
    """Numbers beside the verdict."""

    COMMON = ("Common mode: {values}", "the parameters of the healthy machine that may differ from record to record")
    RESIDUAL = (
        "Residual: {size} the noise of the healthy machine (variance {ratio:.3g} times it, probability "
        "{probability:.2g})",
        "larger: something is left that the verdict does not explain",
    )
    MODEL_ERROR = (
        "Error of the fault models along other signatures: {share:.2g} % of their effect",
        "how far a fault's effect may differ from that of its model",
    )


def diagnosis_document(found: DiagnosisRun) -> Document:
    """Return the document of a diagnosis."""
    result = found.diagnosis
    proof = "evidence" if result.evidence is None else "causes"
    said = [Remark(verdict(result), "plain", proof)]
    common = result[result.named[0]].common if result.named else result.nominal
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in dict(common).items())
    said.append(DiagnosisMessage.COMMON.said(values=values))
    left = result.unexplained
    noisy = {"size": "larger than" if left.larger else "as large as", "ratio": left.ratio}
    said.append(DiagnosisMessage.RESIDUAL.said("plain", "explained", (), **noisy, probability=left.probability))
    if result.evidence is not None:
        said.append(DiagnosisMessage.MODEL_ERROR.said(share=100 * result.evidence.model_error))
    said += [Remark(text, "doubt", "sizes") for text in diagnosis_notes(result)]
    sections = diagnosis_sections(result)
    if found.residuals is not None:
        best = result.named[0] if result.named else min(result.hypotheses, key=lambda each: each.probability).name
        drawn = explained_charts(found.residuals, best, found.units)
        sections.append(Section("explained", "What the fault explains", RESIDUAL, charts=(drawn,), beside=1))
    sections += preprocessing_sections(found.prepared, len(found.prepared) > 1, "prepared")
    tone = TONES.get(result.kind, "bad")
    return Document(
        "diagnosis", "Diagnosis", result.kind, tone, tuple(said), tuple(sections), **origin_of(found.origin)
    )


def diagnosis_sections(found: Diagnosis) -> list[Section]:
    """Return the sections of a diagnosis."""
    columns = faults_columns(found)
    words = [head for head in columns if head not in ("value", "interval (95 %)", "D", "threshold", "probability")]
    sections = [
        Section("faults", "Faults looked for", table=table_of(columns, words)),
        *([] if found.evidence is None else _causes(found.evidence)),
        Section("evidence", "What decides", EVIDENCE, charts=(fault_evidence(found),), beside=1),
        Section("sizes", "Sizes of the faults", SIZES, charts=tuple(size_charts(found)), beside=2),
    ]
    return [each for each in sections if each.charts or each.table]


def _causes(found: ChangeEvidence) -> list[Section]:
    named = {change_name(change) for each in found.explanations for change in each.changes}
    likely = sorted(found.suspects, key=lambda each: each.probability)
    columns: dict[str, list[str]] = {
        "cause": [change_name(each.change) for each in likely],
        "size": [change_size(each.change) for each in likely],
        "D": [f"{each.statistic:.4g}" for each in likely],
        "probability": [chance(each.probability) for each in likely],
        "nearest": [f"{each.rival}, {math.degrees(each.rival_angle):.0f}°" if each.rival else "" for each in likely],
        "": ["named" if change_name(each.change) in named else "" for each in likely],
    }
    odds: dict[str, Any] = {
        "explanation": [explanation_words(each) for each in found.explanations],
        "odds against the best": [f"{each.odds:.2g}" for each in found.explanations],
    }
    heading = "What may be new beside the healthy records"
    return [
        Section("suspects", heading, table=table_of(columns, ("size", "nearest", "")), shown=CONSOLE),
        Section("causes", "What may be new", CAUSES, table_of(odds), (cause_evidence(found),), 1),
        Section("changes", "How large it is", CHANGES, charts=tuple(change_charts(found)), beside=2),
    ]
