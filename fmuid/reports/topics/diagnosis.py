"""A diagnosis: the verdict, the faults looked for, the causes, and what is to be known of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fmuid.formatting import with_std
from fmuid.reports.document import PAGE, Document, Message, Remark, Section, Tone, table_of
from fmuid.reports.topics.cause_charts import (
    cause_evidence,
    change_charts,
    explained_charts,
)
from fmuid.reports.topics.diagnosis_phrases import (
    causes_columns,
    change_name,
    diagnosis_notes,
    explanation_words,
    verdict,
)
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.reports.topics.provenance import origin_of

if TYPE_CHECKING:
    from fmuid.diagnosis import Diagnosis
    from fmuid.runs import DiagnosisRun

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
    said = [Remark(verdict(result), "plain", "causes")]
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in result.nominal.items())
    said.append(DiagnosisMessage.COMMON.said(values=values))
    left = result.unexplained
    noisy = {"size": "larger than" if left.larger else "as large as", "ratio": left.ratio}
    said.append(DiagnosisMessage.RESIDUAL.said("plain", "explained", (), **noisy, probability=left.probability))
    said.append(DiagnosisMessage.MODEL_ERROR.said(share=100 * result.evidence.model_error))
    said += [Remark(text, "doubt", "changes") for text in diagnosis_notes(result)]
    sections = diagnosis_sections(result)
    if result.residuals is not None:
        best = " and ".join(change_name(each) for each in result.evidence.explanations[0].changes)
        drawn = explained_charts(result.residuals, best, found.units)
        sections.append(Section("explained", "What the fault explains", RESIDUAL, charts=(drawn,), beside=1))
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
        "odds against the best": [f"{each.odds:.2g}" for each in evidence.explanations],
    }
    words = [head for head in columns if head not in ("D", "probability")]
    sections = [
        Section("looked-at", "What may be new", table=table_of(columns, words, ("interval (95 %)",))),
        Section("causes", "What may be new", CAUSES, table_of(odds), (cause_evidence(evidence),), 1, shown=PAGE),
        Section("changes", "How large it is", CHANGES, charts=tuple(change_charts(evidence)), beside=2),
    ]
    return [each for each in sections if each.charts or each.table]
