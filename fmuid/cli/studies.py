"""The commands about one study: parse, call, print."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmuid.cli.interruption import answering, stopping
from fmuid.cli.options import DONE, NOT_SUCCEEDED, Folder, InProcess, Overrides, StudyFile, folder_of, telling_files
from fmuid.errors import FmuidError, InputError
from fmuid.files import replacing

if TYPE_CHECKING:
    from fmuid.estimation import GlobalResult, Result
    from fmuid.model_problem import Problem
    from fmuid.reports import Findings
    from fmuid.studies import Study

FMU_LOG = "fmu.log"
"""What FMUs printed, in the output folder."""

# What takes longer than this, s, says what it is doing.
QUICK = 2.0


def simulate(study: StudyFile, output: Folder = None, set_: Overrides = None, in_process: InProcess = False) -> int:
    """Simulate a study at the parameters' starts and compare with the measurements."""
    folder = folder_of(output, study)
    with _opened(study, set_, in_process, folder) as read:
        from fmuid import files
        from fmuid.reports import findings as report
        from fmuid.reports.console import layout as console
        from fmuid.reports.figures import fit as figures_fit
        from fmuid.reports.figures import style as plots

        files.make_folder(folder)
        console.warn_unfed(read.simulators())
        fits = read.fits()
        console.show_misfits(fits)
        table = report.stacked([fit.experiment for fit in fits], [fit.simulated_frame() for fit in fits])
        written = [files.write_table(folder / "simulated.csv", table)]
        plots.clear(folder / "figures")
        written += plots.save(figures_fit.fits(fits), folder / "figures")
        console.show_files(written)
        return DONE


def identify(
    study: StudyFile,
    output: Folder = None,
    set_: Overrides = None,
    in_process: InProcess = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Start from the values in the output folder's result.json, without a global search."
        ),
    ] = False,
) -> int:
    """Identify the parameters of a study and write result, tables and figures."""
    folder = folder_of(output, study)
    with _opened(study, set_, in_process, folder) as read:
        from fmuid import files
        from fmuid.reports import findings as report
        from fmuid.reports.console import layout as console
        from fmuid.reports.console import result as console_result
        from fmuid.reports.figures import run as figures_run
        from fmuid.reports.figures import style as plots

        problem = read.problem()
        start = report.resumed_start(folder / "result.json", problem.parameters) if resume else None
        files.make_folder(folder)
        console.show_notes(read.notes)
        console.warn_unfed(read.simulators())
        with answering("saving what has been found (Ctrl-C again ends it without)"):
            result, search = _search(read, problem, start)
            if search is not None and result.local is None:
                return _save_point(read, search, folder)
            found, written = _found(read, problem, result, search, folder)
            console_result.show_result(found)
            plots.clear(folder / "figures")
            written += plots.save(figures_run.draw(found), folder / "figures")
            if read.uncertainty_settings.any:
                found, more = _explored(read, problem, found, folder)
                written += more
        console.show_files(dict.fromkeys(written))
        return DONE if found.succeeded else NOT_SUCCEEDED


def _found(
    read: Study, problem: Problem, result: Result, search: GlobalResult | None, folder: Path
) -> tuple[Findings, list[Path]]:
    """Examine a result, and write what is found."""
    from fmuid.assessment import examine_residuals, read_result
    from fmuid.reports import findings as report
    from fmuid.reports import write_estimates
    from fmuid.reports.console import layout as console
    from fmuid.simulation import fit

    if problem.parameters.prior_whitening.size and result.elapsed_s > QUICK:
        console.show_notes(["searching the optimum of the data alone, for comparison; Ctrl-C leaves it out"])
    ended, diagnostics = report.at_minimum(result, search), examine_residuals(problem, result)
    found = report.Findings(
        result,
        fit.parameter_units(read.system, result.names),
        report.result_fits(read.system, read.tables, result),
        diagnostics,
        read_result(problem, result, search_data=ended, healthy=read.known_variance, diagnostics=diagnostics),
        read.uncertainty_settings.level,
        search,
    )
    return found, [*found.write(folder), *write_estimates(folder, read.system, result)]


def _explored(read: Study, problem: Problem, found: Findings, folder: Path) -> tuple[Findings, list[Path]]:
    """Find out what the study asks for beyond the local covariance, and show and write it."""
    from dataclasses import replace

    from fmuid.assessment import Uncertainty, explore
    from fmuid.reports import findings as report
    from fmuid.reports.console import layout as console
    from fmuid.reports.console import result as console_result
    from fmuid.reports.console.progress import Work
    from fmuid.reports.figures import run as figures_run
    from fmuid.reports.figures import style as plots

    settings = read.uncertainty_settings
    if not report.at_minimum(found.result, found.search):
        console.show_notes(["[uncertainty] is left out: it needs a search that has ended at a minimum"])
        return found, []
    there = Uncertainty(settings.level, (), (), (), None, interrupted=True)
    if not stopping():
        with Work(found.result.names) as work:
            there = explore(problem, found.result, settings, work, box=found.search is not None)
    found = replace(found, uncertainty=there)
    written = found.write(folder)
    console_result.show_uncertainty(found)
    return found, written + plots.save(figures_run.draw_uncertainty(found), folder / "figures")


def _save_point(read: Study, search: GlobalResult, folder: Path) -> int:
    """Write the best point of a search that was interrupted before a fit began from it, of which no more is known."""
    from fmuid.reports import findings as report
    from fmuid.reports import write_estimates
    from fmuid.reports.console import layout as console
    from fmuid.reports.figures import style as plots
    from fmuid.simulation import fit

    result = search.result
    written = report.write_point(folder, result, fit.parameter_units(read.system, result.names))
    written += write_estimates(folder, read.system, result)
    plots.clear(folder / "figures")
    console.show_point(result, search)
    console.show_files(written)
    return NOT_SUCCEEDED


def _search(read: Study, problem: Problem, start: Any) -> tuple[Result, GlobalResult | None]:
    """Search as the study says, and show how far it is; an earlier result as the start saves the global search."""
    from fmuid.estimation import Marquardt, identify
    from fmuid.reports.console.progress import Progress, Work

    try:
        if isinstance(read.estimator, Marquardt) or start is not None:
            with Progress(problem.parameters.names, problem.parameters.start if start is None else start) as progress:
                return identify(problem, read.marquardt, progress, start), None
        from fmuid.estimation import search_globally

        with Work(problem.parameters.names) as work:
            found = search_globally(problem, read.estimator, work.searched)
        return found.result, found
    except KeyboardInterrupt:
        raise FmuidError("interrupted before anything better than the start was found: nothing is written") from None


def diagnose(study: StudyFile, output: Folder = None, set_: Overrides = None, in_process: InProcess = False) -> int:
    """Look for the faults that a study names, and write verdict, table and figures; exit code 1 for a fault."""
    folder = folder_of(output, study)
    with _opened(study, set_, in_process, folder) as read:
        from fmuid import files
        from fmuid.reports.console import layout as console
        from fmuid.reports.console.diagnosis import show_diagnosis
        from fmuid.reports.figures import diagnosis as figures_diagnosis
        from fmuid.reports.figures import style as plots

        if read.diagnosis is not None:
            console.show_notes(read.notes)
            console.warn_unfed(read.simulators())
        files.make_folder(folder)
        with console.console().status("fitting the healthy machine") as status:
            found = read.diagnose(lambda name: status.update(f"fitting {name}"))
        show_diagnosis(found)
        written = [found.to_json(folder / "diagnosis.json"), files.write_table(folder / "diagnosis.csv", found.table)]
        written += plots.save(figures_diagnosis.draw(found), folder / "figures")
        console.show_files(written)
        return DONE if found.kind == "healthy" else NOT_SUCCEEDED


def monitor(
    study: StudyFile,
    tables: Annotated[
        list[Path],
        typer.Argument(metavar="TABLE", help="Records, or folders of records, in their order.", show_default=False),
    ],
    output: Folder = None,
    set_: Overrides = None,
    in_process: InProcess = False,
    append: Annotated[
        bool, typer.Option("--append", help="Go on with the run in the output folder; records of it are left out.")
    ] = False,
) -> int:
    """Look for the faults that a study names in records, window by window; exit code 1 for an alarm."""
    folder = folder_of(output, study)
    with _opened(study, set_, in_process, folder) as read:
        from fmuid import files
        from fmuid.reports.console import layout as console
        from fmuid.reports.console.monitoring import show_monitoring
        from fmuid.reports.figures import monitoring as figures_monitoring
        from fmuid.reports.figures import style as plots
        from fmuid.studies import monitor_of, records_of, rule_of

        found = monitor_of(read, rule_of(read))
        if append:
            found.resume(folder)
        console.show_notes(read.notes)
        files.make_folder(folder)
        saving = "saving the records examined so far, with which --append goes on"
        with answering(saving), console.console().status("reading") as status:
            try:
                for record in records_of(read, tables, found.records):
                    status.update(record.name)
                    found.add(record)
            finally:  # what was found before a record that is wrong is kept, and can be appended to
                written = found.write(folder) if found.records else []
        show_monitoring(found)
        written += plots.save(figures_monitoring.draw(found), folder / "figures")
        console.show_files(written)
        return NOT_SUCCEEDED if found.alarms or found.undetermined else DONE


@contextmanager
def _opened(study: Path, set_: list[str] | None, in_process: bool, folder: Path) -> Iterator[Study]:
    """Read a study whose FMUs run in a process of their own; what they print goes into the output folder."""
    from fmuid.simulation import AVAILABLE

    if in_process or not AVAILABLE:
        from fmuid.studies import Study

        with telling_files():
            yield Study.read(study, set_ or (), isolated=not in_process)
        return
    from fmuid.reports.console.layout import show_notes
    from fmuid.simulation import SERVER

    SERVER.start()  # it loads its code while this process loads its own
    from fmuid.simulation import printed
    from fmuid.studies import Study

    printed()
    try:
        with telling_files():
            yield Study.read(study, set_ or (), isolated=True)
    finally:
        show_notes(_write_log(folder / FMU_LOG, printed()))


def _write_log(log: Path, text: str) -> list[str]:
    """Write what FMUs printed, and return what is to be said of it; nothing that goes wrong here ends a command."""
    if not text:
        with suppress(OSError):
            log.unlink()  # of an earlier run
        return []
    try:
        with replacing(log) as draft:
            draft.write_text(text, encoding="utf-8")
    except InputError as error:
        return [f"what the FMUs printed is lost: {error}"]
    return [f"what the FMUs printed is in {log}"]
