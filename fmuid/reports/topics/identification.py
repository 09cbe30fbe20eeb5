"""An identification: the topics of its document, in their order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from fmuid.estimation import Grade, Reason, Result, Verdict
from fmuid.formatting import fit_text, unit_text
from fmuid.identification import ModelErrors, judge, quantile
from fmuid.models import SolverConfiguration
from fmuid.reports.chart import Units
from fmuid.reports.document import Document, Message, Remark, Section, bad, origin_of, plain
from fmuid.reports.topics.assumption_rows import assumption_rows
from fmuid.reports.topics.assumptions import (
    assumed_section,
    defect_remarks,
    hidden_remarks,
    hiding_section,
    model_error_remarks,
)
from fmuid.reports.topics.estimates import correlation_sections, estimates_section, forest_section, precision_remarks
from fmuid.reports.topics.fit import Band, fit_measure, fit_remarks, fit_sections, stretch_remarks
from fmuid.reports.topics.optimization import optima_remarks, optima_section, optimization_sections
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.reports.topics.prior_and_data import prior_sections, reading_remarks
from fmuid.reports.topics.residual_analysis import (
    is_ordered,
    residual_phrases,
    residual_remarks,
    residual_section,
    widening_words,
)
from fmuid.reports.topics.row_charts import bands, contribution_sections
from fmuid.reports.topics.solver_check import SolverMessage, run_words, sensitivity_words, solver_section
from fmuid.reports.topics.study_notes import change_line, gap_remark
from fmuid.reports.topics.termination import effort_remark, result_remarks, state_and_reason
from fmuid.reports.topics.uncertainty import interval_section, uncertainty_remarks
from fmuid.reports.topics.uncertainty_charts import uncertainty_sections
from fmuid.reports.topics.verdict import STATES, reason_words, remedy_words
from fmuid.runs import IdentificationRun
from fmuid.simulation import OutputFit

MAX_LINES = 4  # lines of a terminal between table and report


class RunMessage(Message):
    """Results of a run as a whole."""

    POINT = plain("Best point: {point}.")
    NOISE = plain("Residual: {noise}.")
    INFORMATION = plain(
        "Likelihood: χ² {chi}, {dof} degrees of freedom; −2 ln L {twice}; AIC {aic}; BIC {bic}.",
        "with the noise variance of the fit; estimated variances are parameters",
    )
    INTERRUPTED = bad("Interrupted: the checks of [uncertainty] are incomplete.", remedy="Continue with `--resume`.")


def identification_document(found: IdentificationRun) -> Document:
    """Return the document of an identification."""
    result, checks = found.result, found.assessment
    verdict = result.verdict or judge(result, checks)
    state, tone = STATES[verdict.grade]
    said = _remarks(found)
    return Document(
        "identification",
        "Identification",
        state,
        tone,
        tuple(said),
        tuple(identification_sections(found)),
        **origin_of(found.origin, _models(result)),
        reason=_reason(result, verdict),
        summary=_summary(found, said),
        remedy=_remedy(found, verdict),
    )


def _remedy(found: IdentificationRun, verdict: Verdict) -> str:
    """Return the best change, or the remedy of the gravest reason."""
    explained = Reason.CONVENTION in verdict.reasons
    if verdict.grade is Grade.NOT_USABLE and not explained:
        return ""
    return remedy_words(verdict) if explained or found.change is None else change_line(found.change)


def _reason(result: Result, verdict: Verdict) -> str:
    """Return what follows the verdict in its line."""
    ended, how = state_and_reason(result)
    if not result.converged and Reason.CONVENTION not in verdict.reasons:
        return f"{ended}: {how}"
    passed = "all other checks passed" if verdict.freed else f"converged {how}; all checks passed"
    return "; ".join(filter(None, (reason_words(verdict), "" if verdict.doubts else passed)))


def _models(result: Result) -> dict[str, str]:
    return {
        f"FMU {name or model['name']}": f"SHA-256 {model.get('digest', '')}"
        for name, model in result.setup.models.items()
    }


def _remarks(found: IdentificationRun) -> list[Remark]:
    """Return the remarks on an identification, the verdict first."""
    result, names, checks = found.result, found.result.names, found.assessment
    reading, residuals = checks.prior_and_data, checks.residuals
    first, *others = result_remarks(result)
    if reading is None or residuals is None:  # interrupted before any check
        point = ", ".join(f"{name} = {result[name]:.6g}" for name in names)
        return [RunMessage.POINT.said(point=point), first]
    said = [first, *precision_remarks(result), *fit_remarks(found.fits)]
    said += stretch_remarks(found.residual_stretches, len(found.fits))
    said += [gap_remark(*each) for each in found.dropouts.items()]
    said += [*others, *optima_remarks(result)]
    said += [*model_error_remarks(checks.model_errors), *defect_remarks(checks.data_defects)]
    said += [*reading_remarks(reading, found.output_units), *residual_remarks(residuals, found.output_units)]
    said.append(RunMessage.NOISE.said("residuals", noise=_noise(result, found.output_units)))
    for component, model in result.setup.models.items():
        if "run" in model:
            run = run_words(SolverConfiguration(**model["run"]))
            said.append(SolverMessage.RUN.said("", model=component or model["name"], run=run))
    if result.setup.sensitivity is not None:
        said.append(SolverMessage.SENSITIVITIES.said("", how=sensitivity_words(result.setup.sensitivity)))
    said += [effort_remark(result), *uncertainty_remarks(checks)]
    return said + ([RunMessage.INTERRUPTED.said()] if checks.interrupted else [])


def _summary(found: IdentificationRun, said: Sequence[Remark]) -> tuple[tuple[str, str], ...]:
    """Return at most `MAX_LINES` lines for a terminal, those with doubts first."""
    residuals = found.assessment.residuals
    if residuals is None:
        return ()
    kinds = {"Prior": "PriorMessage", "Optima": "OptimaMessage", "Solver": "SolverMessage"}
    own = (*kinds.values(), "ResidualMessage")
    others = [each for each in said[1:] if _is_doubt(each) and each.message.split(".")[0] not in own]
    if found.result.identifiability.non_identifiable:  # which the first line tells
        others = [each for each in others if each.tone != "bad"]
    factors, noise = widening_words(residuals), "colored" if is_ordered(residuals) else "uneven"
    lines = [
        ("Fit", _fits(found.fits), False),
        ("Residuals", residual_phrases(residuals), any(each.large for each in residuals.findings)),
        ("Intervals", f"widened {factors} for {noise} noise" if factors else "", bool(factors)),
        ("Doubts", _short("", others), True),
    ]
    for label, kind in kinds.items():
        mine = [each for each in said if each.message.split(".")[0] == kind and each.message not in _SETTINGS]
        doubts = [each for each in mine if _is_doubt(each)]
        lines.append((label, _short(f"{label} ", doubts or mine), bool(doubts)))
    shown = [each for each in lines if each[1]]
    verdict = found.result.verdict
    if verdict is not None and verdict.grade is Grade.PASSED:
        shown.append((*_untested(found.assessment.model_errors), True))
    kept = sorted(shown, key=lambda each: not each[2] and each[0] != "Fit")[:MAX_LINES]
    return tuple((label, text) for each in shown if each in kept for label, text in [each[:2]])


def _untested(found: ModelErrors | None) -> tuple[str, str]:
    """Return the line that stands beside PASSED: what the tests would not have shown."""
    for each in () if found is None else hidden_remarks(found):
        label, text = each.text.rstrip(".").split(": ", 1)
        return label, text
    return "Not tested", "model errors that the parameters absorb → fmuid predict RESULT NEW_DATA"


_SETTINGS = ("SolverMessage.CHECKED", "SolverMessage.RUN", "SolverMessage.SENSITIVITIES")


def _is_doubt(said: Remark) -> bool:
    return said.tone in ("doubt", "bad")


def _short(prefix: str, said: Sequence[Remark]) -> str:
    """Return the first two of these sentences, and the number of others."""
    texts = [each.text.rstrip(".").removeprefix(prefix).replace("error is below", "error below") for each in said]
    return "; ".join([*texts[:2], *([f"{len(texts) - 2} more (--verbose)"] if len(texts) > 2 else [])])


def _fits(fits: Sequence[OutputFit]) -> str:
    """Return the fit of each output, or the lowest of many, in %."""
    scores = [
        (score, f"{name} in {fit.experiment}" if len(fits) > 1 else name)
        for fit in fits
        for name, score, counted in zip(fit.outputs, fit.fit, fit.counted.T, strict=True)
        if counted.any()
    ]
    known = [each for each in scores if math.isfinite(each[0])]
    if len(scores) > MAX_LINES and known:
        return f"at least {fit_text(min(known)[0])} ({min(known)[1]}; {fit_measure(fits)})"
    words = [f"{name} {fit_text(score) if math.isfinite(score) else 'constant'}" for score, name in scores]
    return f"{', '.join(words)} ({fit_measure(fits)})" if words else ""


def _noise(result: Result, units: Units) -> str:
    """Return the standard deviation of each output's residual."""
    words = []
    for output, variance in result.fit.noise_variance.items():
        given = result.fit.given_variance.get(output)
        of = f" (given: {math.sqrt(given):.4g})" if given is not None else ""
        words.append(f"{output} std {math.sqrt(variance):.4g} {unit_text(units.get(output))}".rstrip() + of)
    return ", ".join(words)


def information_remarks(result: Result) -> list[Remark]:
    """Return χ², likelihood and information criteria in one line."""
    fit = result.fit
    if not fit.experiments or not math.isfinite(fit.log_likelihood):
        return []
    samples = sum(int(each.counted.sum()) for each in fit.experiments)
    count = len(result.names) + sum(name not in fit.given_variance for name in fit.noise_variance)
    squares = 0.0
    for experiment, simulated in zip(fit.experiments, fit.simulated, strict=True):
        scale = np.sqrt([fit.variance[name] for name in experiment.output_names])
        squares += float((((experiment.output_values - simulated) / scale)[experiment.counted] ** 2).sum())
    twice = -2.0 * fit.log_likelihood
    values = {"chi": f"{squares:.5g}", "dof": samples - len(result.names), "twice": f"{twice:.6g}"}
    values |= {"aic": f"{twice + 2 * count:.6g}", "bic": f"{twice + count * math.log(samples):.6g}"}
    return [RunMessage.INFORMATION.said("forest", **values)]


def _bands(found: IdentificationRun) -> dict[str, Band]:
    """Return the bands of experiments without a time."""
    level = found.assessment.level
    factor = quantile(found.result.fit.degrees_of_freedom, level)
    made = bands(found.assessment.contributions, found.fits, factor)
    return {name: (half, level) for name, half in made.items()}


def identification_sections(found: IdentificationRun) -> list[Section]:
    """Return the sections of an identification."""
    result, fits, units, estimates = found.result, found.fits, found.unit_of, found.estimates
    checks, timed = found.assessment, [fit for fit in fits if fit.kind == "time"]
    reading, residuals = checks.prior_and_data, checks.residuals
    optima = found.optima if result.history.optima else pd.DataFrame()
    none = pd.DataFrame(columns=["experiment", "output", "with"])
    correlations = none if residuals is None else residuals.correlations
    sections = [
        *([optima_section(result)] if result.history.optima else []),
        estimates_section(result, checks.level),
        forest_section(result, checks.level, information_remarks(result)),
        *([interval_section(checks, result)] if checks.is_explored else []),
        *assumed_section(checks.model_errors, assumption_rows(found)),
        *hiding_section(checks.model_errors),
        *fit_sections(fits, bands=_bands(found)),
        *contribution_sections(checks.contributions, result.names, fits),
        *preprocessing_sections(found.prepared, len(fits) > 1),
        *([residual_section(timed, correlations)] if timed else []),
        *optimization_sections(result, estimates, optima, found.output_units),
        *(prior_sections(reading, units) if reading is not None and found.has_prior else []),
        *correlation_sections(result, units, checks.level),
        *solver_section(estimates),
        *(uncertainty_sections(checks, result, units, optima) if checks.is_explored else []),
    ]
    return [each for each in sections if each.charts or each.table]
