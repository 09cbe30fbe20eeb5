"""The document of each kind of findings."""

from __future__ import annotations

from fmuid.reports.document import Document
from fmuid.runs import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun


def document(found: object) -> Document:
    """Return the document of findings or of a single result.

    Raises
    ------
    InputError
        If there is none of this type.
    """
    match found:
        case IdentificationRun():
            from fmuid.reports.topics.identification import identification_document

            return identification_document(found)
        case DiagnosisRun():
            from fmuid.reports.topics.diagnosis import diagnosis_document

            return diagnosis_document(found)
        case MonitoringRun():
            from fmuid.reports.topics.monitoring import monitoring_document

            return monitoring_document(found)
        case PredictionRun():
            from fmuid.reports.topics.prediction import prediction_document

            return prediction_document(found)
        case ComparisonRun():
            from fmuid.reports.topics.model_comparison import comparison_document

            return comparison_document(found)
    from fmuid.reports.descriptions import description

    return description(found)
