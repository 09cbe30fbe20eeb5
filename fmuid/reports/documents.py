"""The document of each kind of findings and of single results."""

from __future__ import annotations

from collections.abc import Iterable

from fmuid.diagnosis import Diagnosis, Monitor
from fmuid.errors import InputError
from fmuid.estimation import LinearEstimate, Result
from fmuid.formatting import with_std
from fmuid.identification import CONFIDENCE_LEVEL, Assessment, Posterior, PriorDataComparison, ResidualAnalysis
from fmuid.reports.document import Document, Message, Remark, Section, Tone, plain
from fmuid.reports.topics.diagnosis import diagnosis_document, diagnosis_notes, diagnosis_sections, verdict
from fmuid.reports.topics.estimates import estimates_section
from fmuid.reports.topics.identification import identification_document
from fmuid.reports.topics.model_comparison import comparison_document
from fmuid.reports.topics.monitoring import monitoring_document
from fmuid.reports.topics.prediction import prediction_document
from fmuid.reports.topics.prior_and_data import reading_remarks
from fmuid.reports.topics.residual_analysis import residual_remarks
from fmuid.reports.topics.termination import result_remarks, state_and_reason
from fmuid.reports.topics.uncertainty import posterior_remarks, uncertainty_remarks
from fmuid.runs import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun, findings_of


class LinearMessage(Message):
    """Bias of estimates of linear models."""

    LEAST_SQUARES = plain(
        "unbiased if the regressors are free of noise and the residual is white",
        "of estimates by `fmuid.estimation.linear_least_squares`",
    )
    EQUATION_ERROR = plain(
        "biased by noise in the measured terms; σ does not include this bias",
        "of estimates by `fmuid.estimation.equation_error`",
        "Use them as initial guesses of `identify`.",
    )
    INSTRUMENTAL_VARIABLES = plain(
        "free of the bias by noise in the measured terms if the model is right",
        "of estimates by `fmuid.estimation.instrumental_variables`",
    )
    UNSETTLED = plain(
        "not converged: instruments still change after {rounds} rounds", remedy="Improve the initial guess."
    )


def document(found: object) -> Document:
    """Return the document of findings or of a single result; `InputError` if there is none of this type."""
    match found:
        case IdentificationRun():
            return identification_document(found)
        case DiagnosisRun():
            return diagnosis_document(found)
        case MonitoringRun():
            return monitoring_document(found)
        case PredictionRun():
            return prediction_document(found)
        case ComparisonRun():
            return comparison_document(found)
        case Result():
            return result_document(found)
        case Diagnosis():
            tone: Tone = "good" if found.kind == "healthy" else "bad"
            notes = (verdict(found), *diagnosis_notes(found))
            return Document("diagnosis", "Diagnosis", found.kind, tone, notes, tuple(diagnosis_sections(found)))
        case Monitor():
            return monitoring_document(findings_of(found))
        case Assessment():
            said = [] if found.prior_and_data is None else reading_remarks(found.prior_and_data)
            said += [] if found.residuals is None else residual_remarks(found.residuals)
            return _described("Assessment", [*said, *uncertainty_remarks(found)])
        case LinearEstimate():
            return _described("Linear estimate", _linear_remarks(found), "", found.converged)
        case ResidualAnalysis():
            return _described("Residuals", residual_remarks(found))
        case PriorDataComparison():
            return _described("Prior and data", reading_remarks(found))
        case Posterior():
            return _described("Posterior", posterior_remarks(found), "", found.converged)
    raise InputError(f"a {type(found).__name__} has no document")


def result_document(result: Result, level: float = CONFIDENCE_LEVEL) -> Document:
    """Return the document of a result, with intervals of a level."""
    state, _ = state_and_reason(result)
    return _described("Result", result_remarks(result), state, result.converged, [estimates_section(result, level)])


def _described(
    heading: str, said: Iterable[Remark], state: str = "", good: bool = True, sections: Iterable[Section] = ()
) -> Document:
    kind = heading.lower().replace(" ", "-")
    return Document(kind, heading, state, "good" if good else "bad", tuple(said), tuple(sections))


def _linear_remarks(estimate: LinearEstimate) -> list[Remark]:
    triples = zip(estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True)
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, value, std in triples)
    said = [Remark(values), LinearMessage[estimate.estimator.name].said()]
    return said if estimate.converged else [*said, LinearMessage.UNSETTLED.said(rounds=estimate.rounds)]
