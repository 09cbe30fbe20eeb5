"""An identification: the topics of its document, in their order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from fmuid.estimation import Result
from fmuid.formatting import unit_text
from fmuid.identification import SIGNIFICANCE_LEVEL, Deviation, PriorDataComparison, ResidualAnalysis
from fmuid.models import SolverConfiguration
from fmuid.reports.document import Document, Message, Remark, Section, Tone, capitalised, origin_of
from fmuid.reports.topics.estimates import correlation_sections, estimates_section, precision_remarks
from fmuid.reports.topics.fit import fit_remarks, fit_sections
from fmuid.reports.topics.optimization import optima_section, optimization_sections
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.reports.topics.prior_and_data import prior_sections, reading_words
from fmuid.reports.topics.residual_analysis import residual_section, residual_words
from fmuid.reports.topics.solver_check import run_words, sensitivity_words, solver_section
from fmuid.reports.topics.study_notes import dropout_words
from fmuid.reports.topics.termination import effort_words, ending, result_remarks
from fmuid.reports.topics.uncertainty import interval_section, posterior_words, uncertainty_words
from fmuid.reports.topics.uncertainty_charts import uncertainty_sections
from fmuid.runs import IdentificationRun
from fmuid.simulation import OutputFit

_ODD = (Deviation.LARGER, Deviation.SMALLER)


class RunMessage(Message):
    """How models were run, and what is left of the measurements."""

    POINT = ("{point}", "the best point of a search that was interrupted before a fit began from it")
    NOISE = ("Residual: {noise}", "the standard deviation of each output's residual, beside that given")
    RUN = (
        "{model} run as {run}",
        "how the FMU was simulated; in a new process for each simulation, where it keeps something outside its "
        "instances, such as a static variable, by which each simulation would change the next",
    )
    SENSITIVITIES = ("sensitivities by {how}", "how the derivatives by the parameters were found")
    POSTERIOR = ("Posterior: {words}", "the samples can be used")
    INTERRUPTED = ("Interrupted: this is what there is", "Ctrl-C ended what was asked for beside the estimates")


def identification_document(found: IdentificationRun) -> Document:
    """Return the document of an identification."""
    result, good = found.result, found.succeeded
    state = "converged" if result.converged else result.outcome.value.replace("_", " ")
    tone: Tone = "good" if good else "bad"
    origin = origin_of(found.origin, _effort(result))
    sections = identification_sections(found)
    return Document("identification", "Identification", state, tone, tuple(_remarks(found)), tuple(sections), **origin)


def _effort(result: Result) -> dict[str, str]:
    models = {
        f"FMU {name or model['name']}": f"SHA-256 {model.get('digest', '')}"
        for name, model in result.setup.models.items()
    }
    return {**models, "search": effort_words(result)}


def _remarks(found: IdentificationRun) -> list[Remark]:
    """Return the sentences on an identification, the verdict first."""
    result, names, checks = found.result, found.result.names, found.assessment
    reading, residuals = checks.prior_and_data, checks.residuals
    said = [Remark(capitalised(ending(result), names), "plain" if result.converged else "bad", "criterion")]
    if reading is None or residuals is None:  # interrupted before anything could be examined
        point = ", ".join(f"{name} = {result[name]:.6g}" for name in names)
        return [RunMessage.POINT.said("plain", "", names, point=point), *said]
    said += [*precision_remarks(result), *fit_remarks(found.fits)]
    said += [Remark(dropout_words(*each), "doubt", "fit") for each in found.dropouts.items()]
    said += [*result_remarks(result), *_examined(found, reading, residuals)]
    said.append(RunMessage.NOISE.said("plain", "residuals", noise=_noise(result, found.fits)))
    for component, model in result.setup.models.items():
        if "run" in model:
            run = run_words(SolverConfiguration(**model["run"]))
            said.append(RunMessage.RUN.said("plain", "", (), model=component or model["name"], run=run))
    if result.setup.sensitivity is not None:
        said.append(RunMessage.SENSITIVITIES.said(how=sensitivity_words(result.setup.sensitivity)))
    said += [Remark(capitalised(text, names), "doubt", "profiles") for text in uncertainty_words(checks)]
    if checks.posterior is not None and checks.posterior.converged:
        said.append(RunMessage.POSTERIOR.said("plain", "posterior", words=posterior_words(checks.posterior)))
    return said + ([RunMessage.INTERRUPTED.said("bad")] if checks.interrupted else [])


def _examined(found: IdentificationRun, reading: PriorDataComparison, residuals: ResidualAnalysis) -> list[Remark]:
    coloured: Tone = "doubt" if any(each.large for each in residuals.findings) else "plain"
    odd = reading.agreement is not None and reading.agreement.probability < SIGNIFICANCE_LEVEL
    odd |= any(each.deviation in _ODD for each in reading.variances)
    said = [Remark(text, "doubt" if odd else "plain", "belief") for text in reading_words(reading, found.output_units)]
    return said + [Remark(text, coloured, "residuals") for text in residual_words(residuals, found.output_units)]


def _noise(result: Result, fits: Sequence[OutputFit]) -> str:
    """Return the standard deviation of each output's residual."""
    units = {output: unit for fit in fits for output, unit in zip(fit.outputs, fit.units, strict=True)}
    words = []
    for output, variance in result.fit.noise_variance.items():
        given = result.fit.given_variance.get(output)
        of = f" (given: {math.sqrt(given):.4g})" if given is not None else ""
        words.append(f"{output} std {math.sqrt(variance):.4g} {unit_text(units.get(output))}".rstrip() + of)
    return ", ".join(words)


def identification_sections(found: IdentificationRun) -> list[Section]:
    """Return the sections of an identification."""
    result, fits, units, estimates = found.result, found.fits, found.unit_of, found.estimates
    checks = found.assessment
    reading, residuals = checks.prior_and_data, checks.residuals
    optima = found.optima if result.history.optima else pd.DataFrame()
    none = pd.DataFrame(columns=["experiment", "output", "with"])
    correlations = none if residuals is None else residuals.correlations
    sections = [
        *([optima_section(result)] if result.history.optima else []),
        estimates_section(result, checks.level),
        *([interval_section(checks, result)] if checks.is_explored else []),
        *fit_sections(fits),
        *preprocessing_sections(found.prepared, len(fits) > 1),
        *([residual_section(fits, correlations)] if fits else []),
        *optimization_sections(result, estimates, optima, found.output_units),
        *(prior_sections(reading, units) if reading is not None and found.has_prior else []),
        *correlation_sections(result, units, checks.level),
        *solver_section(estimates),
        *(uncertainty_sections(checks, result, units, optima) if checks.is_explored else []),
    ]
    return [each for each in sections if each.charts or each.table]
