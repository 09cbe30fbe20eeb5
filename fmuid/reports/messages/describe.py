"""Any finding in words, by its kind."""

from __future__ import annotations

from fmuid.diagnosis import Diagnosis, Monitor
from fmuid.estimation import Estimator, LinearEstimate, Result
from fmuid.formatting import with_std
from fmuid.identification import Assessment, Posterior, PriorDataComparison, ResidualAnalysis
from fmuid.reports.messages.diagnosis import diagnosis_words
from fmuid.reports.messages.monitoring import monitoring_sentences
from fmuid.reports.messages.prior_and_data import reading_words
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import capitalised, result_words
from fmuid.reports.messages.uncertainty import posterior_words, uncertainty_words

Found = Result | LinearEstimate | Assessment | ResidualAnalysis | PriorDataComparison | Posterior | Diagnosis | Monitor

THOUGHTS = {
    Estimator.LEAST_SQUARES: "unbiased where the regressors are free of noise and the residual is white",
    Estimator.EQUATION_ERROR: (
        "noise in measured terms biases these values, which their standard deviations do not show: "
        "a start for identify, not a result"
    ),
    Estimator.INSTRUMENTAL_VARIABLES: "free of the bias by noise in measured terms, as far as the model is right",
}
"""What is to be thought of an estimator."""


def describe(found: Found) -> str:
    """Say in words what was found, a sentence a line.

    Parameters
    ----------
    found : Result, LinearEstimate, Assessment, Diagnostics, Reading, Posterior, Diagnosis or Monitor
        Of `fmuid.identify`, `fmuid.equation_error` and its like, `fmuid.assess`, `fmuid.analyze_residuals`,
        `fmuid.compare_prior_and_data`, `fmuid.sample_posterior`, `fmuid.diagnose`, or a `fmuid.Monitor`.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> print(fmuid.describe(fmuid.identify(problem)))
    Converged
    """
    return "\n".join(capitalised(words, _names(found)) for words in _sentences(found))


def _names(found: Found) -> tuple[str, ...]:
    """Return the names with which a sentence on it may begin."""
    match found:
        case Assessment():
            sampled = () if found.posterior is None else found.posterior.names
            return *(each.name for each in found.profiles), *sampled
        case Diagnosis():
            return *found.mismatched, *found.nominal
    return tuple(getattr(found, "names", ()))


def _sentences(found: Found) -> tuple[str, ...]:
    match found:
        case Result():
            return result_words(found)
        case LinearEstimate():
            return _linear_words(found)
        case ResidualAnalysis():
            return residual_words(found)
        case PriorDataComparison():
            return reading_words(found)
        case Assessment():
            said = () if found.prior_and_data is None else reading_words(found.prior_and_data)
            said += () if found.residuals is None else residual_words(found.residuals)
            return *said, *uncertainty_words(found)
        case Posterior():
            return (posterior_words(found),)
        case Diagnosis():
            return diagnosis_words(found)
        case Monitor():
            from fmuid.runs import findings_of

            return tuple(monitoring_sentences(findings_of(found)))


def _linear_words(estimate: LinearEstimate) -> tuple[str, ...]:
    """Return the values with their standard deviations, then what is to be thought of them."""
    values = ", ".join(
        f"{name} = {with_std(value, std)}"
        for name, value, std in zip(estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True)
    )
    words = (values, THOUGHTS[estimate.estimator])
    if estimate.converged:
        return words
    return *words, f"the instruments had not settled after {estimate.rounds} rounds: give a start nearer by"
