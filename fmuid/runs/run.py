"""One study run: a generator of findings, each with its files written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from fmuid import codec, files
from fmuid.array_types import Floats
from fmuid.data import ParameterSet, dropouts
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import RESULT_SCHEMA, Result
from fmuid.events import DataOnlyStep, Progress
from fmuid.files import WriteError
from fmuid.identification import (
    Assessment,
    AssessmentSettings,
    DataDefect,
    Problem,
    Refit,
    assess,
    find_model_errors,
    judge,
    refit,
    without_clipped,
    without_sizes,
)
from fmuid.runs.apply import write_estimates
from fmuid.runs.findings import IdentificationRun, at_minimum
from fmuid.runs.folder import RESULT_FILE, write_identification
from fmuid.runs.preprocessing import prepared
from fmuid.runs.provenance import made_from
from fmuid.runs.study_changes import best_change
from fmuid.simulation import fit_of
from fmuid.studies import BASELINE_FILE, Study

# A search that took longer, s, is not repeated with the data alone without an event.
QUICK_SECONDS = 2.0
CLIPPED_FITS = 2  # the first model, biased by clipped samples, does not tell them all


class SearchInterruptedError(FmuidError):
    """Interruption before the optimizer improved the initial guess."""

    def __init__(self) -> None:
        super().__init__("interrupted before any improvement: nothing is written")


def identified(
    study: Study, folder: Path | None = None, *, resume: bool = False, progress: Progress | None = None
) -> Iterator[IdentificationRun]:
    """Identify the parameters of a study: yield the result, then its uncertainty.

    Files of an earlier run in `folder` are replaced or removed; `resume` starts from its ``result.json``. Ctrl-C ends
    it with the findings so far. If nothing can be written, findings are yielded before the error.
    """
    if folder is None and resume:
        raise InputError("resume needs the folder of the earlier result. Give it.")
    problem, shown = study.problem(), None
    if study.diagnosis is not None:
        from fmuid.runs.faults import shown_by  # and all of diagnosis

        shown = shown_by(study)
    start = resumed_start(folder / RESULT_FILE, problem.parameters) if resume and folder is not None else None
    with nullcontext() if folder is None else files.locked(folder, "identification"):
        done = () if folder is None else prepared(study)
        try:
            result = study.search(problem, progress, start)
        except KeyboardInterrupt:
            raise SearchInterruptedError from None
        origin = None if folder is None else made_from(study, folder=folder)
        asked = study.uncertainty_settings
        found = IdentificationRun(result, assessment=Assessment(asked.level), origin=origin, prepared=done)
        fitted = Refit(problem, result, None)
        if result.fit.linearization is not None:
            fitted = _freed(study, problem, result, progress)
            found = _examined(study, fitted, found, progress)
        found = _judged(found)
        if folder is not None:
            try:
                found = _written(study, folder, found)
                baseline = folder / BASELINE_FILE
                baseline.unlink(missing_ok=True)  # of an earlier run
                if shown is not None and result.converged:
                    found = replace(found, files=(*found.files, shown(result).write(baseline)))
            except FmuidError:
                yield found
                raise
        yield found
        if asked.explores and result.fit.linearization is not None and at_minimum(result):
            checks = assess(fitted.problem, fitted.result, asked, progress, found.assessment)
            found = _judged(replace(found, assessment=checks))
            yield found if folder is None else _written(study, folder, found)


def resumed_start(path: Path, parameters: ParameterSet) -> Floats:
    """Return the estimates of a ``result.json`` as a start (N,)."""
    earlier = Result.from_json(path)
    shared = [name for name in parameters.names if name in earlier.names]
    if not shared:
        theirs, ours = ", ".join(earlier.names), ", ".join(parameters.names)
        raise InputError(f"{path}: result of another study, with parameters {theirs}, not {ours}.")
    start = parameters.start.copy()
    for name in shared:
        start[parameters.index(name)] = earlier[name]
    return start


def _freed(study: Study, problem: Problem, result: Result, progress: Progress | None) -> Refit:
    """Test the model; identify again with the errors found, where the study does not only want a report."""
    mode, whole, excluded = study.estimation.model_error, problem, tuple[DataDefect, ...]()
    if mode == "refit" and result.converged and study.diagnosis is None:
        for _ in range(CLIPPED_FITS):
            cut = without_clipped(whole, result)
            if cut is None:
                break
            problem, excluded = cut
            result = study.search(problem, progress, result.values)
    tested = problem.as_in(result)
    found = None if mode == "off" or not at_minimum(result) else find_model_errors(tested, result)
    again = None
    # profiles, samples and diagnosis are of the model without freed errors
    free = mode == "refit" and result.converged and study.diagnosis is None
    free = free and not study.uncertainty_settings.explores
    # where inputs and states were not tested, an error may bear the name of another
    free = free and found is not None and found.covers_dynamics
    if free and found is not None and found.errors:
        again = refit(tested, result, found, progress)
    return replace(again or Refit(problem, result, found), excluded=excluded)


def _examined(study: Study, fitted: Refit, found: IdentificationRun, progress: Progress | None) -> IdentificationRun:
    """Assess residuals, prior and data."""
    problem, result = fitted.problem, fitted.result
    if progress is not None and problem.parameters.prior_whitening.size and result.history.elapsed_s > QUICK_SECONDS:
        progress(DataOnlyStep())
    asked = AssessmentSettings(
        study.uncertainty_settings.level,
        search_data=at_minimum(result),
        known_variance=study.known_variance | dict(result.fit.given_variance),
    )
    fits = tuple(fit_of(study.system, *each) for each in zip(study.tables, result.fit.simulated, strict=True))
    lost = {each.name: rows for each in study.tables if each.input_names and (rows := dropouts(each.times))}
    checks = assess(problem, result, asked, earlier=Assessment(asked.level, model_errors=fitted.found))
    checks = replace(checks, data_defects=(*fitted.excluded, *checks.data_defects))
    own = without_sizes(result, len(found.result.names))
    found = replace(found, result=own, fits=fits, assessment=checks, dropouts=lost)
    return replace(found, change=best_change(study, checks, found.residual_stretches))


def _judged(found: IdentificationRun) -> IdentificationRun:
    fits: dict[tuple[str, ...], float] = {}
    for each in found.fits:
        fits |= {(output, each.experiment): fit for output, fit in zip(each.outputs, each.fit, strict=True)}
    verdict = judge(found.result, found.assessment, fits, found.dropouts)
    return replace(found, result=replace(found.result, verdict=verdict))


def _written(study: Study, folder: Path, found: IdentificationRun) -> IdentificationRun:
    """Write findings; return them with their files. Without room, the result is kept elsewhere."""
    path = folder / RESULT_FILE
    try:
        written = write_identification(folder, found)
    except WriteError as error:
        place = None
        if error.path == path:
            place = files.rescued(path.name, lambda there: codec.write(there, RESULT_SCHEMA, found))
        if place is None:
            raise
        raise FmuidError(f"{error} The result is kept in {place}.") from None
    if not found.assessment.is_explored:
        errors = found.assessment.model_errors
        written += write_estimates(folder, study.system, found.result, {} if errors is None else errors.corrected)
    return replace(found, files=tuple(dict.fromkeys((*found.files, *written))))
