"""Verdict on a result from all its checks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from fmuid.estimation import AccuracyOutcome, Doubt, Reason, Result, SearchFailure, TerminationReason, Verdict
from fmuid.identification.assessment import Assessment, better_point
from fmuid.identification.contributions import PRIOR
from fmuid.identification.data_defects import DefectKind
from fmuid.identification.model_errors import ModelError, ModelErrors
from fmuid.identification.prior_and_data import PriorDataComparison
from fmuid.identification.prior_data_tests import Deviation
from fmuid.identification.residual_analysis import SETTINGS as RESIDUALS
from fmuid.identification.residual_analysis import ResidualAnalysis, ResidualDefect
from fmuid.identification.residual_series import InputCorrelation, ResidualSeries
from fmuid.identification.solver_check import EQUAL_COST

MIN_FIT = 50.0  # NRMSE fit of each output, %; MATLAB's `compare` gives 0 for the mean

_UNCHECKED = frozenset(AccuracyOutcome) - {AccuracyOutcome.PASSED, AccuracyOutcome.SHIFTED}
_DEFECTS = {
    ResidualDefect.COLORED: Reason.COLORED_RESIDUAL,
    ResidualDefect.OFFSET: Reason.OFFSET,
    ResidualDefect.INPUT: Reason.INPUT_CORRELATION,
    ResidualDefect.SHAPE: Reason.DISTRIBUTION,
}


def judge(
    result: Result,
    assessment: Assessment | None = None,
    fits: Mapping[tuple[str, ...], float] | None = None,
    gaps: Mapping[str, Sequence[float]] | None = None,
) -> Verdict:
    """Return the verdict on a result.

    Parameters
    ----------
    result : Result
    assessment : Assessment, optional
        Its checks; without them, the reasons that the result itself gives.
    fits : mapping of tuple of str to float
        NRMSE fit of each output, %, by output, or output and experiment.
    gaps : mapping of str to sequence of float
        Times before missing rows of each experiment, s.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> fmuid.identification.judge(result, fmuid.assess(problem, result)).grade.value
    'passed'
    """
    errors = None if assessment is None else assessment.model_errors
    tested = errors is not None and errors.covers_dynamics
    doubts = [*_of_search(result, tested=tested), *_of_identifiability(result), *_of_solver(result)]
    freed = list(_of_delay(result))
    doubts += [Doubt(Reason.POOR_FIT, key, {"fit": fit}) for key, fit in (fits or {}).items() if fit < MIN_FIT]
    doubts += [Doubt(Reason.MISSING_ROWS, (name,), {"first": float(times[0])}) for name, times in (gaps or {}).items()]
    if assessment is not None:
        doubts += _of_uncertainty(assessment)
        for each in assessment.data_defects:
            subject = (each.kind.value, each.output, each.experiment)
            reason = Reason.CONVENTION if each.kind.explains_misfit else Reason.DATA_DEFECT
            told = Doubt(reason, subject, each.values)
            doubts += [told] if each.kind.is_doubt else []
            freed += [told] if each.kind is DefectKind.EXCLUDED else []
        for own in () if assessment.contributions is None else assessment.contributions.contradictions:
            if own.experiment != PRIOR:  # tested by itself
                doubts.append(Doubt(Reason.EXPERIMENTS_CONFLICT, (own.experiment,), {"probability": own.probability}))
        if errors is not None:
            unexplained = tuple(each for each in errors.freed if not each.is_explained)
            doubts += _of_model_errors(errors, (*errors.errors, *unexplained))
            doubts += _of_feedback(errors)
            freed += _of_model_errors(errors, errors.freed)
        if assessment.residuals is not None:
            doubts += _of_residuals(assessment.residuals, tested=tested)
        doubts += [] if assessment.prior_and_data is None else _of_prior(assessment.prior_and_data)
    return Verdict.of(doubts, freed)


def _of_search(result: Result, *, tested: bool) -> Iterator[Doubt]:
    """Yield doubts about the search; colored noise makes a residual large, too: none where the model was tested."""
    history = result.history
    if result.outcome is TerminationReason.INTERRUPTED:
        yield Doubt(Reason.INTERRUPTED)
    elif not result.converged and result.outcome is not TerminationReason.UNDETERMINED:
        yield Doubt(Reason.NOT_CONVERGED, (result.outcome.value,))
    kept = next((each for each in history.restarts if each.kept), None)
    if not tested and kept is not None and kept.trouble in (SearchFailure.LARGE_RESIDUAL, SearchFailure.MODEL_ERROR):
        yield Doubt(Reason.LARGE_RESIDUAL, (), {"ratio": kept.noise_ratio, "starts": float(len(history.restarts))})
    for other in history.optima[1:]:
        behind = other.criterion - history.optima[0].criterion
        if behind < EQUAL_COST:
            yield Doubt(Reason.SECOND_OPTIMUM, (), dict(zip(result.names, other.theta.tolist(), strict=True)))
    if len(history.combinations) > 1 and history.combinations[1].behind < EQUAL_COST:
        yield Doubt(Reason.SECOND_OPTIMUM, tuple(history.combinations[1].values))
    if result.setup.observer is not None:
        yield Doubt(Reason.OBSERVER, (), {"samples": result.setup.observer})


def _of_identifiability(result: Result) -> Iterator[Doubt]:
    found = result.identifiability
    lost = tuple(name for name, std in zip(result.names, result.std.tolist(), strict=True) if math.isinf(std))
    if lost and not found.non_identifiable:
        yield Doubt(Reason.NON_IDENTIFIABLE, lost)
    for reason, directions in (
        (Reason.NON_IDENTIFIABLE, found.non_identifiable),
        (Reason.WEAKLY_IDENTIFIABLE, found.weakly_identifiable),
        (Reason.PRIOR_DOMINATED, found.prior_dominated),
    ):
        yield from (Doubt(reason, each.names, {"std": each.std}) for each in directions)
    yield from (Doubt(Reason.AT_BOUND, (each.name,), {"bound": each.value}) for each in result.estimates.at_bounds)


def _of_solver(result: Result) -> Iterator[Doubt]:
    check = result.accuracy
    if check is None:
        return
    if check.outcome in _UNCHECKED:
        bound = {"bound": check.largest} if math.isfinite(check.largest) else {}
        yield Doubt(Reason.SOLVER_UNCHECKED, (check.outcome.value,), bound)
    elif check.doubtful:
        i = int(np.argmax(np.abs(np.nan_to_num(check.shift))))
        kept = () if check.kept is None else (check.kept.value,)
        yield Doubt(Reason.SOLVER_ERROR, (result.names[i], *kept), {"shift": float(abs(check.shift[i]))})


def _of_delay(result: Result) -> Iterator[Doubt]:
    """Yield an included delay that brings more variance than the noise."""
    delay = result.fit.delay
    if delay is not None and delay.widening.max() > math.sqrt(2.0):
        name, factor = result.names[int(np.argmax(delay.widening))], float(delay.widening.max())
        yield Doubt(Reason.ACQUISITION_DELAY, (name,), {"widening": factor})


def _of_model_errors(found: ModelErrors, errors: Sequence[ModelError]) -> Iterator[Doubt]:
    """Yield model errors, each with its size and what it moves most."""
    for each in errors:
        test, direction = each.test, each.test.direction
        i, shift = test.most
        values = {"size": test.size, "std": test.std, "shift": shift * abs(test.size)}
        subject = (direction.kind.value, found.names[i], direction.unit, *direction.subject)
        others = tuple((other.kind.value, *other.subject) for other in each.alternatives)
        yield Doubt(Reason.MODEL_ERROR, subject, values, others)


def _of_feedback(found: ModelErrors) -> Iterator[Doubt]:
    if (own := found.feedback) is not None:
        yield Doubt(Reason.FEEDBACK, (own.input, own.experiment), {"probability": own.probability})


def _of_residuals(found: ResidualAnalysis, *, tested: bool) -> Iterator[Doubt]:
    """Yield doubts about residuals; color alone is none where directed tests of the model found nothing in it."""
    if tested and found.noise_ratio > RESIDUALS.noise_ratio:
        yield Doubt(Reason.LARGE_RESIDUAL, (), {"ratio": found.noise_ratio})
    for each in (finding for finding in found.findings if finding.large):
        if tested and each.trait is ResidualDefect.COLORED:
            continue
        subject = (each.output, each.experiment, *([each.input_name] if each.input_name else []))
        yield Doubt(_DEFECTS[each.trait], subject, _size(each.trait, each.series, each.input))
    for periodic in found.returning:
        values = {"period": periodic.period, "fraction": periodic.share}
        yield Doubt(Reason.PERIODIC_ERROR, (periodic.output, periodic.experiment), values)
    for slow in () if tested else found.slow:
        values = {"time_constant": slow.time_constant, "fraction": slow.share}
        yield Doubt(Reason.LOW_FREQUENCY_NOISE, (slow.output, *slow.experiments), values)
    for long in found.long_memory:
        values = {"time_constant": long.time_constant, "length": long.record}
        yield Doubt(Reason.LONG_MEMORY, (long.output, *long.experiments), values)


def _size(trait: ResidualDefect, series: ResidualSeries, at: InputCorrelation | None) -> dict[str, float]:
    match trait:
        case ResidualDefect.COLORED:
            lag, largest = series.whiteness.strongest
            return {"correlation": largest, "lag": float(lag)}
        case ResidualDefect.OFFSET:
            return {"mean": series.mean, "std": series.std}
        case ResidualDefect.INPUT if at is not None:
            return {"correlation": at.correlation, "lag_s": at.lag, "limit": at.band}
        case _:
            shape = series.normality
            return {"skewness": shape.skewness, "kurtosis": shape.kurtosis, "outliers": float(series.outliers)}


def _of_prior(found: PriorDataComparison) -> Iterator[Doubt]:
    test = found.agreement
    if test is not None and not test.holds:
        distances = np.abs(np.nan_to_num(found.conflict))
        i = int(np.argmax(distances))
        values = {"probability": test.probability, "distance": float(distances[i])}
        yield Doubt(Reason.PRIOR_DATA_CONFLICT, (found.names[i],) if distances[i] else (), values)
    for each in found.variances:
        if each.output and each.deviation is not Deviation.NONE:
            values = {"residual": math.sqrt(each.estimated), "given": math.sqrt(each.known)}
            yield Doubt(Reason.NOISE_LEVEL, (each.output,), values)
    for influence in found.influences:
        if influence.rests:
            yield Doubt(Reason.PRIOR_DOMINATED, (influence.name,), {})
    if found.bent:
        i = found.names.index(found.bent)
        yield Doubt(Reason.NONLINEAR, (found.bent,), {"distance": float(abs(found.nonlinearity[i]))})


def _of_uncertainty(found: Assessment) -> Iterator[Doubt]:
    if found.interrupted:
        yield Doubt(Reason.INTERRUPTED)
    for each in found.profiles:
        if math.isnan(each.lower) or math.isnan(each.upper):
            yield Doubt(Reason.BETTER_OPTIMUM, (each.name,))
    for chart in found.maps:
        if (better := better_point(chart)) is not None:
            yield Doubt(Reason.BETTER_OPTIMUM, chart.names, {"x": better[0], "y": better[1], "lower_by": better[2]})
    if found.posterior is not None and not found.posterior.converged:
        yield Doubt(Reason.SAMPLING, (found.posterior.doubtful,) if found.posterior.doubtful else ())
