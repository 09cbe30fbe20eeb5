"""One study, run: a generator of findings, as often as more is known, each with its files written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid import codec, files
from fmuid.array_types import Floats
from fmuid.data import ParameterSet, dropouts
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import RESULT_SCHEMA, Result
from fmuid.files import WriteError
from fmuid.identification import Assessment, AssessmentSettings, Problem, assess
from fmuid.progress import DataOnlyStep, Progress
from fmuid.runs.apply import write_estimates
from fmuid.runs.findings import IdentificationRun, at_minimum
from fmuid.runs.folder import RESULT_FILE, write_identification
from fmuid.runs.preprocessing import prepared
from fmuid.runs.provenance import made_from
from fmuid.simulation import OutputFit, fit_of
from fmuid.studies import BASELINE_FILE, Study

if TYPE_CHECKING:
    from fmuid.diagnosis import StoredBaseline

# A search that took longer than this, s, is not repeated with the data alone without a word.
QUICK_SECONDS = 2.0


class SearchInterruptedError(FmuidError):
    """The keyboard ended a search before anything better than the start was found."""

    def __init__(self) -> None:
        super().__init__("interrupted before anything better than the start was found: nothing is written")


def identified(
    study: Study, folder: Path | None = None, *, resume: bool = False, progress: Progress | None = None
) -> Iterator[IdentificationRun]:
    """Identify the parameters of a study: yield the result once it is examined, and with all ``[uncertainty]`` asks.

    Interrupted from the keyboard, it ends with what was found until then: of a search in which no fit has begun yet
    the best point, with nothing but its values.

    Parameters
    ----------
    study : Study
    folder : Path, optional
        Where ``result.json`` and the tables go, made where needed; files of an earlier run are replaced or removed.
    resume : bool
        Whether to start from the values in the folder's ``result.json``, without a search of the whole box.
    progress : callable, optional
        Called with every step of the search, and with what goes on then (`fmuid.progress`).

    Raises
    ------
    InputError
        If model, tables and parameters do not fit together, or nothing can be written; what was found is yielded first.
    SimulationError
        If the simulation at the start fails.
    SearchInterruptedError
        If the keyboard ends it when nothing is known.
    """
    if folder is None and resume:
        raise InputError("an earlier result is in a folder: say in which one")
    problem, shown = study.problem(), _shown(study)
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
        if result.local is not None:
            found = _examined(study, problem, found, progress)
        try:
            found = _written(study, folder, found)
            found = _with_baseline(folder, found, shown)
        except FmuidError:
            yield found
            raise
        yield found
        if asked.explores and result.local is not None and at_minimum(result):
            explored = assess(problem, result, asked, progress, found.assessment)
            yield _written(study, folder, replace(found, assessment=explored))


def resumed_start(path: Path, parameters: ParameterSet) -> Floats:
    """Return the estimates of an earlier ``result.json`` as a start (N,); parameters new since then keep their own.

    Raises
    ------
    InputError
        If the file is no result or has none of the parameters.
    """
    earlier = Result.from_json(path)
    shared = [name for name in parameters.names if name in earlier.names]
    if not shared:
        raise InputError(
            f"{path} is of another study: its parameters are {', '.join(earlier.names)}, "
            f"not {', '.join(parameters.names)}"
        )
    start = parameters.start.copy()
    for name in shared:
        start[parameters.index(name)] = earlier[name]
    return start


def _shown(study: Study) -> Callable[[Result], StoredBaseline] | None:
    """Return what says what a healthy study shows of faults, None of another."""
    if study.diagnosis is None:
        return None
    from fmuid.runs.faults import shown_by  # and all that decides

    return shown_by(study)


def _examined(study: Study, problem: Problem, found: IdentificationRun, progress: Progress | None) -> IdentificationRun:
    """Look at residuals, and at what prior and data say."""
    result = found.result
    if progress is not None and problem.parameters.prior_whitening.size and result.elapsed_s > QUICK_SECONDS:
        progress(DataOnlyStep())
    asked = AssessmentSettings(
        study.uncertainty_settings.level,
        search_data=at_minimum(result),
        known_variance=study.known_variance | dict(result.given_variance),
    )
    lost = {each.name: rows for each in study.tables if each.input_names and (rows := dropouts(each.times))}
    return replace(found, fits=_fits(study, result), assessment=assess(problem, result, asked), dropouts=lost)


def _fits(study: Study, result: Result) -> tuple[OutputFit, ...]:
    """Return the fits at the estimate, one an experiment."""
    simulated = () if result.history is None else result.history.simulated
    return tuple(fit_of(study.system, *each) for each in zip(study.tables, simulated, strict=True))


def _written(study: Study, folder: Path | None, found: IdentificationRun) -> IdentificationRun:
    """Write findings; return them with their files."""
    if folder is None:
        return found
    with _kept(folder / RESULT_FILE, found):
        written = write_identification(folder, found)
    if not found.assessment.is_explored:
        written += write_estimates(folder, study.system, found.result)
    return replace(found, files=tuple(dict.fromkeys((*found.files, *written))))


def _with_baseline(
    folder: Path | None, found: IdentificationRun, shown: Callable[[Result], StoredBaseline] | None
) -> IdentificationRun:
    """Write what a healthy study shows of faults; that of an earlier run goes."""
    if folder is None:
        return found
    (folder / BASELINE_FILE).unlink(missing_ok=True)
    if shown is None or not found.result.converged:
        return found
    return replace(found, files=(*found.files, shown(found.result).write(folder / BASELINE_FILE)))


@contextmanager
def _kept(path: Path, found: IdentificationRun) -> Iterator[None]:
    """Keep a file elsewhere if there is no room for it, so that no search is in vain."""

    def keep(there: Path) -> Path:
        return codec.write(there, RESULT_SCHEMA, found)

    try:
        yield
    except WriteError as error:
        place = files.rescued(path.name, keep) if error.path == path else None
        if place is None:
            raise
        raise FmuidError(f"{error}; the result is kept in {place}") from None
