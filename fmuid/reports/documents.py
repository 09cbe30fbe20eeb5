"""Which topics make the document of which findings, and the sentences on each kind of result."""

from __future__ import annotations

from functools import singledispatch

from fmuid.diagnosis import Diagnosis, Monitor
from fmuid.errors import InputError
from fmuid.estimation import Estimator, LinearEstimate, Result
from fmuid.formatting import with_std
from fmuid.identification import Assessment, Posterior, PriorDataComparison, ResidualAnalysis
from fmuid.reports.document import Document, Message, capitalised
from fmuid.reports.topics.diagnosis import diagnosis_document
from fmuid.reports.topics.diagnosis_phrases import basis_notes, diagnosis_notes, verdict
from fmuid.reports.topics.identification import identification_document
from fmuid.reports.topics.model_comparison import comparison_document
from fmuid.reports.topics.monitoring import monitoring_document, monitoring_words
from fmuid.reports.topics.prediction import prediction_document
from fmuid.reports.topics.prior_and_data import reading_words
from fmuid.reports.topics.residual_analysis import residual_words
from fmuid.reports.topics.termination import result_words
from fmuid.reports.topics.uncertainty import posterior_words, uncertainty_words
from fmuid.runs import (
    ComparisonRun,
    DiagnosisRun,
    IdentificationRun,
    MonitoringRun,
    PredictionRun,
    findings_of,
)


@singledispatch
def document(found: object) -> Document:
    """Return the document of findings.

    Raises
    ------
    InputError
        If they are of no kind that has one.
    """
    raise InputError(f"a {type(found).__name__} has no document")


document.register(IdentificationRun, identification_document)
document.register(DiagnosisRun, diagnosis_document)
document.register(MonitoringRun, monitoring_document)
document.register(PredictionRun, prediction_document)
document.register(ComparisonRun, comparison_document)


class LinearMessage(Message):
    """What is to be thought of estimates of models that are linear in their parameters."""

    LEAST_SQUARES = (
        "unbiased where the regressors are free of noise and the residual is white",
        "of estimates by `fmuid.linear_least_squares`",
    )
    EQUATION_ERROR = (
        "noise in measured terms biases these values, which their standard deviations do not show: a start for "
        "identify, not a result",
        "of estimates by `fmuid.equation_error`",
    )
    INSTRUMENTAL_VARIABLES = (
        "free of the bias by noise in measured terms, as far as the model is right",
        "of estimates by `fmuid.instrumental_variables`",
    )
    UNSETTLED = (
        "the instruments had not settled after {rounds} rounds: give a start nearer by",
        "of estimates by `fmuid.instrumental_variables`",
    )


_THOUGHTS = {
    Estimator.LEAST_SQUARES: LinearMessage.LEAST_SQUARES,
    Estimator.EQUATION_ERROR: LinearMessage.EQUATION_ERROR,
    Estimator.INSTRUMENTAL_VARIABLES: LinearMessage.INSTRUMENTAL_VARIABLES,
}
Found = Result | LinearEstimate | Assessment | ResidualAnalysis | PriorDataComparison | Posterior | Diagnosis | Monitor


def describe(found: Found) -> str:
    """Say in words what was found, a sentence a line.

    Parameters
    ----------
    found : Result, LinearEstimate, Assessment, ResidualAnalysis, PriorDataComparison, Posterior, Diagnosis or Monitor
        Of `fmuid.identify`, `fmuid.equation_error` and its like, `fmuid.assess`, `fmuid.analyze_residuals`,
        `fmuid.compare_prior_and_data`, `fmuid.sample_posterior`, `fmuid.diagnose`, or a `fmuid.Monitor`.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> print(fmuid.describe(fmuid.identify(problem)))
    Converged
    """
    names: tuple[str, ...]
    match found:
        case Assessment():
            said = () if found.prior_and_data is None else reading_words(found.prior_and_data)
            said += () if found.residuals is None else residual_words(found.residuals)
            said += uncertainty_words(found)
            sampled = () if found.posterior is None else found.posterior.names
            names = (*(each.name for each in found.profiles), *sampled)
        case Diagnosis():
            said = (verdict(found), *diagnosis_notes(found))
            names = (*found.mismatched, *found.nominal)
        case Monitor():
            said, names = (monitoring_words(findings_of(found)), *basis_notes(found.basis)), ()
        case Result():
            said, names = result_words(found), found.names
        case LinearEstimate():
            said, names = _linear_words(found), found.names
        case ResidualAnalysis():
            said, names = residual_words(found), ()
        case PriorDataComparison():
            said, names = reading_words(found), found.names
        case Posterior():
            said, names = (posterior_words(found),), found.names
    return "\n".join(capitalised(words, names) for words in said)


def _linear_words(estimate: LinearEstimate) -> tuple[str, ...]:
    """Return the values with their standard deviations, then what is to be thought of them."""
    triples = zip(estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True)
    values = ", ".join(f"{name} = {with_std(value, std)}" for name, value, std in triples)
    said = (values, _THOUGHTS[estimate.estimator].text)
    return said if estimate.converged else (*said, LinearMessage.UNSETTLED.text.format(rounds=estimate.rounds))
