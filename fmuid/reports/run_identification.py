"""One path for a run of a study: search, residuals, prior and data, uncertainty, files, figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid import files
from fmuid.array_types import Floats
from fmuid.data import dropouts
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Result
from fmuid.files import WriteError
from fmuid.identification import AssessmentSettings, Problem, assess
from fmuid.progress import DataOnlyStep, Event, Progress
from fmuid.reports.apply import write_estimates
from fmuid.reports.figure_files import check_format
from fmuid.reports.identification_run import IdentificationRun, at_minimum, result_fits, resumed_start, write_point
from fmuid.reports.page.write import show_results
from fmuid.reports.preprocessing import PreprocessedTable, prepared
from fmuid.reports.provenance import made_from
from fmuid.runs import origin_of
from fmuid.studies import BASELINE_FILE, Study

if TYPE_CHECKING:
    from fmuid.diagnosis import StoredBaseline

# A search that took longer than this, s, is not repeated with the data alone without a word.
QUICK_SECONDS = 2.0


@dataclass(frozen=True, kw_only=True)
class SearchFinished(Event):
    """The search has ended, and its result is examined and written; what ``[uncertainty]`` asks for comes next."""

    task: str = "identified"
    findings: IdentificationRun


class SearchInterruptedError(FmuidError):
    """The keyboard ended a search of which no more is known than a point, or nothing.

    Attributes
    ----------
    result : Result or None
        The best point, with nothing but its values; None where nothing better than the start was found.
    files : tuple of Path
        Those that were written.
    """

    def __init__(self, result: Result | None, files: tuple[Path, ...]) -> None:
        self.result, self.files = result, files
        super().__init__(
            "interrupted before anything better than the start was found: nothing is written"
            if result is None
            else "interrupted before a fit began from the best point found"
        )


def run_study(
    study: Study | str | Path,
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
) -> IdentificationRun:
    """Do all that a study asks for: search, look at residuals, prior and data, and at the uncertainty; write it.

    ``fmuid identify`` is this, with a folder and a report.

    Parameters
    ----------
    study : Study or path
    folder : path, optional
        Where ``result.json`` and the tables go, made where needed; files and figures of an earlier run are replaced or
        removed. Nothing is written without one.
    figures : str, optional
        ``png``, ``svg`` or ``pdf``: draw figures for print, into ``figures/`` of the folder.
    report : bool
        Whether to write ``report.html`` into the folder: all of it on one page with interactive figures.
    resume : bool
        Whether to start from the values in the folder's ``result.json``, without a search of the whole box.
    progress : callable, optional
        Called with every step of the search, with `SearchFinished`, and with what goes on then (`fmuid.progress`).

    Returns
    -------
    Findings
        Without what ``[uncertainty]`` asks for where the search has not ended at a minimum. Interrupted from the
        keyboard: what was found until then, as its outcome says.

    Raises
    ------
    InputError
        If model, tables and parameters do not fit together, there are figures, a report or a start to be found without
        a folder, or nothing can be written there.
    SimulationError
        If the simulation at the start fails.
    SearchInterruptedError
        If the keyboard ends it when no more is known than a point.

    Examples
    --------
    >>> study = fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml")
    >>> found = fmuid.run_study(study, "results")
    >>> sorted(path.name for path in found.files)[:2]
    ['correlations.csv', 'diagnostics.csv']
    """
    study = study if isinstance(study, Study) else Study.read(study)
    if folder is None and (figures or report or resume):
        raise InputError("figures, a report and an earlier result are in a folder: say in which one")
    check_format(figures)
    target = None if folder is None else Path(folder)
    return _Run(study, target, progress, figures=figures, report=report).run(resume=resume)


class _Run:
    """One run and what it has written."""

    def __init__(
        self, study: Study, folder: Path | None, progress: Progress | None, *, figures: str | None, report: bool
    ) -> None:
        self.study, self.folder, self.progress, self.figures, self.report = study, folder, progress, figures, report
        self.files: list[Path] = []
        self.prepared: tuple[PreprocessedTable, ...] = ()

    def run(self, *, resume: bool) -> IdentificationRun:
        problem, shown = self.study.problem(), self._shown()
        if self.folder is None:
            return self._found(problem, None, shown)
        start = resumed_start(self.folder / "result.json", problem.parameters) if resume else None
        with files.locked(self.folder, "identification"):
            self.prepared = prepared(self.study)
            return self._found(problem, start, shown)

    def _found(
        self, problem: Problem, start: Floats | None, shown: Callable[[Result], StoredBaseline] | None
    ) -> IdentificationRun:
        """Return what is found by a search from a start, after writing it."""
        try:
            result = self.study.search(problem, self.progress, start)
        except KeyboardInterrupt:
            raise SearchInterruptedError(None, ()) from None
        if result.local is None:
            self._save_point(result)
            raise SearchInterruptedError(result, tuple(self.files))
        found = self._examined(problem, result)
        try:
            self._write(found)
        except FmuidError:  # what was found is shown all the same
            self._tell(SearchFinished(findings=found))
            raise
        if self.folder is not None:
            (self.folder / BASELINE_FILE).unlink(missing_ok=True)
            if shown is not None and result.converged:
                self.files.append(shown(result).write(self.folder / BASELINE_FILE))
        self._tell(SearchFinished(findings=replace(found, files=tuple(self.files))))
        self._draw()
        asked = self.study.uncertainty_settings
        if asked.explores and at_minimum(result):
            found = replace(found, assessment=assess(problem, result, asked, self.progress, found.assessment))
            self._write(found)
            self._draw()
        return replace(found, files=tuple(dict.fromkeys(self.files)))

    def _shown(self) -> Callable[[Result], StoredBaseline] | None:
        """Return what says what a healthy study shows of faults, None of another."""
        if self.study.diagnosis is None:
            return None
        from fmuid.runs import shown_by  # and all that decides

        return shown_by(self.study)

    def _examined(self, problem: Problem, result: Result) -> IdentificationRun:
        """Look at residuals, and at what prior and data say."""
        if problem.parameters.prior_whitening.size and result.elapsed_s > QUICK_SECONDS:
            self._tell(DataOnlyStep())
        study = self.study
        asked = AssessmentSettings(
            study.uncertainty_settings.level,
            search_data=at_minimum(result),
            known_variance=study.known_variance | dict(result.given_variance),
        )
        return IdentificationRun(
            result,
            result_fits(study.system, study.tables, result),
            assess(problem, result, asked),
            study=None if self.folder is None else origin_of(study, self.folder),
            origin=None if self.folder is None else made_from(study),
            prepared=self.prepared,
            dropouts={each.name: lost for each in study.tables if each.input_names and (lost := dropouts(each.times))},
        )

    def _tell(self, event: Event) -> None:
        if self.progress is not None:
            self.progress(event)

    # --- files

    def _write(self, found: IdentificationRun) -> None:
        if self.folder is not None:
            with _kept(self.folder / "result.json", found.to_json_dict):
                self.files += found.write(self.folder)
            if not found.assessment.is_explored:
                self.files += write_estimates(self.folder, self.study.system, found.result)

    def _save_point(self, result: Result) -> None:
        """Write the best point of a search that was interrupted before a fit began from it."""
        if self.folder is not None:
            with _kept(self.folder / "result.json", result.to_json_dict):
                self.files += write_point(self.folder, result)
            self.files += write_estimates(self.folder, self.study.system, result)
            show_results(self.folder, report=False)

    def _draw(self) -> None:
        """Draw figures for print and write the report, where they are asked for; those of an earlier run go."""
        if self.folder is not None:
            self.files += show_results(self.folder, report=self.report, figures=self.figures)


@contextmanager
def _kept(path: Path, content: Callable[[], Mapping[str, Any]]) -> Iterator[None]:
    """Keep a file elsewhere if there is no room for it, so that no search is in vain."""
    try:
        yield
    except WriteError as error:
        place = files.rescued(path.name, content()) if error.path == path else None
        if place is None:
            raise
        raise FmuidError(f"{error}; the result is kept in {place}") from None
