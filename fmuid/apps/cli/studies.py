"""The commands about one study."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from fmuid import estimation, events, files, processes, reports, runs, simulation, studies
from fmuid.apps.cli.options import (
    DONE,
    NOT_SUCCEEDED,
    FigureFormat,
    Figures,
    Folder,
    NoIsolation,
    NoReport,
    Overrides,
    StudyFile,
    folder_of,
    showing_findings,
)
from fmuid.apps.cli.signals import answering, stopping
from fmuid.errors import InputError
from fmuid.reports import render, topics

FMU_LOG = "fmu.log"  # output of FMUs, in the output folder


@showing_findings
def simulate(
    study: StudyFile,
    output: Folder = None,
    result: Annotated[Path | None, Option(metavar="RESULT", help="Simulate at the estimates of this result.")] = None,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
    sensitivities: Annotated[
        bool, Option("--sensitivities", help="Also write how outputs change with each parameter.")
    ] = False,
    figures: Annotated[FigureFormat, Option(help="Format of the figures.")] = FigureFormat.PNG,
) -> int:
    """Simulate a study at its initial guesses or a result; compare with data."""
    folder = folder_of(output, study)
    with opened(study, set_, no_isolation, folder) as read:
        from fmuid.reports.publish import publish, write_figures

        files.make_folder(folder)
        _warn(read)
        fits = read.fits() if result is None else _fits_at(read, result)
        table = runs.stacked([fit.experiment for fit in fits], [fit.simulated_frame() for fit in fits])
        written = [files.write_table(folder / "simulated.csv", table)]
        render.show(topics.simulation_document(fits))
        sections = topics.fit_sections(fits, caption="")
        if sensitivities:
            more, shown = _sensitivities(read, folder)
            written += [*more, *publish(folder, shown, report=False)]
            sections += shown.sections
        render.show_files([*written, *write_figures(folder, sections, figures)])
        return DONE


def _warn(study: studies.Study) -> None:
    """Show sources of priors, unconnected inputs and doubtful time units."""
    simulators = study.simulators()
    doubts = *topics.input_notes(simulators), *topics.time_notes(study, simulators)
    render.show_notes([*topics.source_notes(study), *doubts])


def _sensitivities(study: studies.Study, folder: Path) -> tuple[list[Path], reports.Document]:
    """Write the sensitivities of a study; return files and document."""
    found = runs.sensitivities_of(study)
    table = runs.stacked([each.experiment for each in found], [each.table for each in found])
    units = {name: each.units.get(name, study.system.unit(name)) for each in study.tables for name in each.output_names}
    shown = topics.sensitivity_document([(each.experiment, each.table) for each in found], units, runs.made_from(study))
    written = files.write_table(folder / "sensitivities.csv", table)
    return [written, runs.write_origin(folder / "sensitivities.json", study)], shown


def _fits_at(study: studies.Study, result: Path) -> tuple[simulation.OutputFit, ...]:
    path = runs.result_path(result)
    estimates = estimation.Result.from_json(path)
    runs.notes_of(study, path, estimates)
    return runs.fits_at(study, estimates)


@showing_findings
def identify(
    study: StudyFile,
    output: Folder = None,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
    resume: Annotated[
        bool, Option("--resume", help="Start at the output folder's result.json, without a global search.")
    ] = False,
    figures: Figures = None,
    no_report: NoReport = False,
) -> int:
    """Identify the parameters of a study; write result, tables and a report."""
    folder = folder_of(output, study)
    with opened(study, set_, no_isolation, folder) as read:
        _warn(read)
        found, left_out = None, read.uncertainty_settings.explores
        shown: reports.Document | None = None
        with answering("saving the results so far (Ctrl-C again: stop without)"), render.Display() as display:
            for each in runs.identified(read, folder, resume=resume, progress=partial(_show_event, display)):
                display.pause()
                before, shown = shown, topics.identification_document(each)
                render.show(shown, before)
                known = each.assessment.residuals is not None
                if left_out and known and not runs.at_minimum(each.result):
                    render.show_notes(["[uncertainty] was skipped: it needs a converged optimization."])
                found = reports.published(each, shown, folder, report=known and not no_report, figures=figures)
        assert found is not None, "a run yields, or raises an error"
        render.show_files(found.files)
        return DONE if found.succeeded else NOT_SUCCEEDED


def _show_event(display: render.Display, event: events.Event, /) -> None:
    """Show an event; raise KeyboardInterrupt after SIGTERM or SIGHUP."""
    match event:
        case events.DataOnlyStep():
            display.pause()
            render.show_notes(["Optimizing with the data alone, for comparison. Ctrl-C skips it."])
        case _ if stopping():
            raise KeyboardInterrupt
        case _:
            display(event)


@showing_findings
def diagnose(
    study: StudyFile,
    output: Folder = None,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
    figures: Figures = None,
    no_report: NoReport = False,
) -> int:
    """Diagnose the faults that a study names; exit code 1 for a change."""
    folder = folder_of(output, study)
    with opened(study, set_, no_isolation, folder) as read:
        if read.diagnosis is not None:
            render.show_notes([*topics.source_notes(read), *topics.input_notes(read.simulators())])
        run = partial(runs.diagnosed, read, folder)
        return _report(run, topics.diagnosis_document, folder, report=not no_report, figures=figures)


@showing_findings
def monitor(
    study: StudyFile,
    data: Annotated[
        list[Path], Argument(metavar="DATA", help="Recordings, or folders of recordings, in order.", show_default=False)
    ],
    output: Folder = None,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
    resume: Annotated[
        bool, Option("--resume", help="Continue the run in the output folder; skip its recordings.")
    ] = False,
    follow: Annotated[
        bool, Option("--follow", help="Wait for what a logger writes; the same command resumes.")
    ] = False,
    figures: Figures = None,
    no_report: NoReport = False,
) -> int:
    """Monitor recordings for the faults that a study names; exit code 1 for an alarm."""
    folder = folder_of(output, study)
    with opened(study, set_, no_isolation, folder) as read:
        if read.diagnosis is not None:
            render.show_notes(topics.source_notes(read))
        if follow:
            return _follow(read, data, folder, resume=resume, figures=figures, report=not no_report)
        saving = "saving the recordings evaluated so far; continue with --resume"
        with answering(saving):
            run = partial(runs.monitored, read, data, folder, append=resume)
            return _report(run, topics.monitoring_document, folder, report=not no_report, figures=figures)


def _report(
    run: Callable[..., Iterator[Any]],
    document: Callable[[Any], reports.Document],
    folder: Path,
    *,
    report: bool,
    figures: FigureFormat | None,
) -> int:
    """Run, show and publish a diagnosis or a monitoring run."""
    with render.Display() as display:
        for each in run(progress=display):
            display.pause()
            shown = document(each)
            render.show(shown)
            found = reports.published(each, shown, folder, report=report, figures=figures)
    render.show_files(found.files)
    return DONE if found.healthy else NOT_SUCCEEDED


def _follow(
    study: studies.Study, data: list[Path], folder: Path, *, resume: bool, figures: FigureFormat | None, report: bool
) -> int:
    from fmuid.reports.publish import publish

    for word, given in (("several folders", len(data) > 1), ("--resume", resume), ("--figures", bool(figures))):
        if given:
            raise InputError(f"--follow: excludes {word}. It follows one folder or file, and resumes by itself.")
    watching, looks = None, runs.followed(study, data[0], folder, topics.alarm_sentence)
    saving = answering("saving the state; the same command resumes")
    with saving, render.FollowingDisplay() as display, suppress(KeyboardInterrupt), closing(looks):
        for watching in looks:
            display(watching)
    if watching is None or not watching.files:
        return DONE
    monitor = watching.monitor
    written = publish(folder, topics.monitoring_document(runs.findings_of(monitor)), report=report)
    render.show_files([*watching.files, *written])
    return NOT_SUCCEEDED if monitor.alarms or monitor.undetermined else DONE


@showing_findings
def baseline(
    study: StudyFile,
    data: Annotated[
        list[Path], Argument(metavar="DATA", help="Healthy recordings, or folders of them.", show_default=False)
    ],
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
) -> int:
    """Make or extend the baseline file of a study by healthy recordings."""
    with opened(study, set_, no_isolation, folder_of(None, study)) as read:
        path, made = runs.extended_baseline(read, data)
        render.show(topics.baseline_document(made))
        render.show_files([path])
        return DONE


@showing_findings
def design(
    study: StudyFile,
    data: Annotated[
        list[Path], Argument(metavar="DATA", help="Excitations (inputs only), or folders of them.", show_default=False)
    ],
    output: Folder = None,
    criterion: Annotated[
        str, Option(metavar="NAME", help="Rank by 'determinant' or by the 'worst' relative σ.")
    ] = "determinant",
    fault: Annotated[
        str | None, Option(metavar="NAME", help="Rank by the minimum detectable size of this fault.")
    ] = None,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
    no_report: NoReport = False,
) -> int:
    """Compare excitations before measuring, by accuracy of estimates or detectable fault size."""
    folder = folder_of(output, study)
    with opened(study, set_, no_isolation, folder) as read:
        from fmuid.reports.publish import publish

        files.make_folder(folder)
        ranked = runs.ranked_excitations(read, data, by=criterion, fault=fault)
        written = [
            files.write_table(folder / "design.csv", ranked),
            runs.write_origin(folder / "design.json", read, data),
        ]
        best = str(ranked["excitation"].iloc[0])
        cost = None if fault is None else runs.healthy_record_cost(read, data, fault, best)
        shown = topics.design_document(ranked, cost, runs.made_from(read, data))
        render.show(shown)
        render.show_files([*written, *publish(folder, shown, report=not no_report)])
        return DONE


def workbench(
    target: Annotated[
        Path, Argument(metavar="[STUDY or FOLDER]", help="A study file, or a folder with studies.", show_default=False)
    ] = Path(),
    browser: Annotated[
        bool, Option("--browser/--no-browser", help="Start the browser, or print the address only.")
    ] = True,
    port: Annotated[int, Option(metavar="N", help="TCP port (default: any free one).", show_default=False)] = 0,
) -> int:
    """Open the workbench in the browser: studies, sliders, identification, results."""
    if processes.AVAILABLE:
        simulation.start_server()  # it loads in parallel with this process
    from fmuid.apps.workbench import Folder, Workbench, entry_file, start_browser

    study = None if files.is_folder(target) else target
    if study is not None and not study.is_file():
        raise InputError(f"{target}: no such study file or folder.")
    bench = Workbench(Folder(target if study is None else study.parent), study, port=port)

    def ready() -> None:
        print(bench.address, flush=True)
        if browser:
            start_browser(kept.enter_context(entry_file(bench)), refused)

    def refused() -> None:
        if bench.awaits_browser:
            render.show_notes(["No browser could be started. Open the address above."])

    print("Ctrl-C: stop the workbench; its running command is interrupted and saved.", flush=True)
    print("Address of the workbench:", flush=True)
    with ExitStack() as kept, suppress(KeyboardInterrupt):  # the regular end
        bench.run(ready)
    return DONE


@contextmanager
def opened(study: Path, set_: list[str] | None, no_isolation: bool, folder: Path) -> Iterator[studies.Study]:
    """Read a study with its FMUs in their own process."""
    with logged(folder, no_isolation) as isolated:
        yield studies.Study.read(study, set_ or (), isolated=isolated)


@contextmanager
def logged(folder: Path, no_isolation: bool) -> Iterator[bool]:
    """Provide whether FMUs are isolated, as by default; log their output."""
    if no_isolation or not processes.AVAILABLE:
        with telling_files():
            yield not no_isolation
        return

    simulation.start_server()  # it loads in parallel with this process
    simulation.printed()
    try:
        with telling_files():
            yield True
    finally:
        render.show_notes(_write_log(folder / FMU_LOG, simulation.printed()))


@contextmanager
def telling_files() -> Iterator[None]:
    """Show the written files if an error ends the command."""
    with files.noted() as written:
        try:
            yield
        except (Exception, KeyboardInterrupt):
            if written:
                render.show_files(dict.fromkeys(written))
            raise


def _write_log(log: Path, text: str) -> list[str]:
    """Write the FMUs' output to a log; return a note on it."""
    if not text:
        with suppress(OSError):  # mostly there is none
            log.unlink()  # of an earlier run
        return []
    try:
        with files.replacing(log) as draft:
            draft.write_text(text, encoding="utf-8")
    except InputError as error:
        return [f"The output of the FMUs is lost: {error}"]
    return [f"Output of the FMUs: {log}"]
