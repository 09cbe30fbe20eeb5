"""The command ``fmuid``: parse, call, print. No maths, and nothing heavy is imported before a command needs it."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmuid import __version__
from fmuid.errors import FmuidError, InputError

if TYPE_CHECKING:
    from fmuid.apply import AppliedValue
    from fmuid.estimators.global_search import GlobalResult
    from fmuid.problem import Problem
    from fmuid.result import Result
    from fmuid.study import Study

DONE, NOT_SUCCEEDED, WRONG_INPUT = 0, 1, 2
"""Exit codes: done; it ran but did not succeed; something given is wrong."""

# What takes longer than this, s, says what it is doing.
QUICK = 2.0

app = typer.Typer(
    name="fmuid",
    help="Identify the physical parameters of models packaged as FMUs from tables of measurements.",
    epilog="Exit code: 0 done, 1 ran but did not succeed (such as not converged), 2 wrong input.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

FmuFile = Annotated[Path, typer.Argument(metavar="FMU", help="The FMU file.", show_default=False)]
StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="The study file (TOML).", show_default=False)]
Folder = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="DIR", help="Where the files go; default: results/ beside the study."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Replace a value of the study, as in parameters.Rs.start=9; repeatable."
    ),
]


def _version(asked: bool) -> None:
    if asked:
        print(f"fmuid {__version__}")
        raise typer.Exit


@app.callback()
def fmuid(
    version: Annotated[  # acts through its callback
        bool, typer.Option("--version", help="Print the version and end.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Identify the physical parameters of models packaged as FMUs from tables of measurements."""


@app.command()
def info(fmu: FmuFile) -> int:
    """Show what an FMU declares: capabilities, parameters, inputs, outputs, units; with a study to begin with."""
    from fmuid.console_fmu import show_facts
    from fmuid.fmi.archive import FMU
    from fmuid.fmu_facts import facts

    show_facts(facts(FMU(fmu)))
    return DONE


@app.command()
def validate(fmu: FmuFile) -> int:
    """Check an FMU: its description by FMPy, its binaries, and a short simulation of each interface."""
    from fmuid import console
    from fmuid.console_fmu import show_validation
    from fmuid.fmi.archive import FMU
    from fmuid.validation import TIME_LIMIT, validate

    model = FMU(fmu)
    console.show_notes([f"simulating each interface; one that does not end is stopped after {TIME_LIMIT:g} s"])
    found = validate(model)
    show_validation(found)
    return DONE if found.passed else NOT_SUCCEEDED


@app.command()
def init(
    fmu: FmuFile,
    table: Annotated[
        Path, typer.Argument(metavar="TABLE", help="The table: .csv, .parquet or .mat.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The study file to write.")] = Path(
        "study.toml"
    ),
) -> int:
    """Write a commented study file for an FMU and a table, to start from."""
    from fmuid import console
    from fmuid.study_init import write_draft

    console.show_draft(write_draft(fmu, table, output), output)
    return DONE


@app.command()
def simulate(study: StudyFile, output: Folder = None, set_: Overrides = None) -> int:
    """Simulate a study at the parameters' starts and compare with the measurements."""
    from fmuid import console, figures_fit, plots, report
    from fmuid.study import Study

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    report.make_folder(folder)
    console.warn_unfed(read.simulators())
    fits = read.fits()
    console.show_misfits(fits)
    table = report.stacked([fit.experiment for fit in fits], [fit.simulated_frame() for fit in fits])
    written = [report.write_table(folder / "simulated.csv", table)]
    plots.clear(folder / "figures")
    written += plots.save(figures_fit.fits(fits), folder / "figures")
    console.show_files(written)
    return DONE


@app.command()
def identify(
    study: StudyFile,
    output: Folder = None,
    set_: Overrides = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Start from the values in the output folder's result.json, without a global search."
        ),
    ] = False,
) -> int:
    """Identify the parameters of a study and write result, tables and figures."""
    from dataclasses import replace

    from fmuid import console, console_result, figures_run, plots, report
    from fmuid.apply import write_estimates
    from fmuid.progress import Work
    from fmuid.reading import read_result
    from fmuid.residuals import examine_residuals
    from fmuid.study import Study
    from fmuid.uncertainty import explore

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    problem = read.problem()
    start = report.resumed_start(folder / "result.json", problem.parameters) if resume else None
    report.make_folder(folder)
    console.show_notes(read.notes)
    console.warn_unfed(read.simulators())
    result, search = _search(read, problem, start)
    if problem.parameters.prior_whitening.size and result.elapsed_s > QUICK:
        console.show_notes(["searching the optimum of the data alone, for comparison; Ctrl-C leaves it out"])
    ended, diagnostics = report.at_minimum(result, search), examine_residuals(problem, result)
    found = report.Findings(
        result,
        report.parameter_units(read.system, result.names),
        report.result_fits(read.system, read.tables, result),
        diagnostics,
        read_result(problem, result, search_data=ended, healthy=read.known_variance, diagnostics=diagnostics),
        read.uncertainty_settings.level,
        search,
    )
    written = [*found.write(folder), *write_estimates(folder, read.system, result)]
    console_result.show_result(found)
    plots.clear(folder / "figures")
    written += plots.save(figures_run.draw(found), folder / "figures")
    if read.uncertainty_settings.any:
        if not ended:
            console.show_notes(["[uncertainty] is left out: it needs a search that has ended at a minimum"])
        else:
            with Work(result.names) as work:
                box = search is not None
                there = explore(problem, result, read.uncertainty_settings, work, box=box)
            found = replace(found, uncertainty=there)
            written += found.write(folder)
            console_result.show_uncertainty(found)
            written += plots.save(figures_run.draw_uncertainty(found), folder / "figures")
    console.show_files(dict.fromkeys(written))
    return DONE if found.succeeded else NOT_SUCCEEDED


def _search(read: Study, problem: Problem, start: Any) -> tuple[Result, GlobalResult | None]:
    """Search as the study says, and show how far it is; an earlier result as the start saves the global search."""
    from fmuid.estimators.marquardt import Marquardt
    from fmuid.identification import identify
    from fmuid.progress import Progress, Work

    if isinstance(read.estimator, Marquardt) or start is not None:
        with Progress(problem.parameters.names, problem.parameters.start if start is None else start) as progress:
            return identify(problem, read.marquardt, progress, start), None
    from fmuid.estimators.global_search import search_globally

    with Work(problem.parameters.names) as work:
        found = search_globally(problem, read.estimator, work.searched)
    return found.result, found


@app.command()
def diagnose(study: StudyFile, output: Folder = None, set_: Overrides = None) -> int:
    """Look for the faults that a study names, and write verdict, table and figures; exit code 1 for a fault."""
    from fmuid import console, figures_diagnosis, plots, report
    from fmuid.console_diagnosis import show_diagnosis
    from fmuid.study import Study

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    if read.diagnosis is not None:
        console.show_notes(read.notes)
        console.warn_unfed(read.simulators())
    report.make_folder(folder)
    with console.console().status("fitting the healthy machine") as status:
        found = read.diagnose(lambda name: status.update(f"fitting {name}"))
    show_diagnosis(found)
    written = [found.to_json(folder / "diagnosis.json"), report.write_table(folder / "diagnosis.csv", found.table)]
    written += plots.save(figures_diagnosis.draw(found), folder / "figures")
    console.show_files(written)
    return DONE if found.kind == "healthy" else NOT_SUCCEEDED


@app.command()
def monitor(
    study: StudyFile,
    tables: Annotated[
        list[Path],
        typer.Argument(metavar="TABLE", help="Records, or folders of records, in their order.", show_default=False),
    ],
    output: Folder = None,
    set_: Overrides = None,
    window: Annotated[
        float | None, typer.Option(metavar="S", help="Length of a window, s; default: each record is one.")
    ] = None,
    transient: Annotated[
        float | None,
        typer.Option(metavar="S", help="Simulated before each window, s; default: what the study discards."),
    ] = None,
    level: Annotated[
        float | None,
        typer.Option(metavar="P", help="Probability that a healthy window is significant; default: the study's."),
    ] = None,
    needed: Annotated[int, typer.Option(metavar="M", help="An alarm takes so many significant windows ...")] = 3,
    among: Annotated[int, typer.Option(metavar="N", help="... of the last so many.")] = 4,
    forgetting: Annotated[
        float, typer.Option(metavar="F", help="0: windows by themselves; towards 1: earlier ones count by F, F², ...")
    ] = 0.0,
    append: Annotated[
        bool, typer.Option("--append", help="Go on with the run in the output folder; records of it are left out.")
    ] = False,
) -> int:
    """Look for the faults that a study names in records, window by window; exit code 1 for an alarm."""
    from fmuid import console, figures_monitoring, plots, report
    from fmuid.console_monitoring import show_monitoring
    from fmuid.study import Study
    from fmuid.study_monitoring import monitor_of, records_of, rule_of

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    rule = rule_of(read, window, transient, level, needed=needed, among=among, forgetting=forgetting)
    found = monitor_of(read, rule)
    if append:
        found.resume(folder)
    console.show_notes(read.notes)
    report.make_folder(folder)
    with console.console().status("reading") as status:
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


@app.command()
def apply(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT", help="A result.json, the folder that has it, or an .ssv file.", show_default=False
        ),
    ],
    fmu: FmuFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="NEW.fmu", help="The FMU to write.")],
    component: Annotated[
        str | None, typer.Option("--component", metavar="NAME", help="Which component of a system the FMU is.")
    ] = None,
) -> int:
    """Write identified values as the start values of a copy of an FMU."""
    from fmuid import console
    from fmuid.apply import apply_result

    _show_applied(apply_result(result, fmu, output, component))
    console.show_files([output])
    return DONE


def _show_applied(applied: Sequence[AppliedValue]) -> None:
    from rich.markup import escape

    from fmuid import console
    from fmuid.report import rounded

    numbers = ("old start", "new start", "std")
    table = console.table_of("Start values", ["variable", *numbers, "unit"], right=numbers)
    for each in applied:
        old, known = each.old, math.isfinite(each.std)
        new = rounded(each.new, each.std) if isinstance(each.new, float) else str(each.new)
        cells = ["" if old is None else f"{old:.6g}" if isinstance(old, float) else str(old), new]
        cells += [rounded(each.std, each.std) if known else "", console.unit_text(each.unit)]
        table.add_row(*(escape(cell) for cell in (each.variable, *cells)))
    console.console().print(table)


@app.command()
def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL.mo", help="The Modelica file.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The FMU to write; default: beside the model.")
    ] = None,
    fmi: Annotated[str, typer.Option("--fmi", metavar="VERSION", help="The version of FMI, 2.0 or 3.0.")] = "2.0",
    sensitivities: Annotated[
        str,
        typer.Option(
            "--sensitivities", metavar="P,...", help="Also output the derivatives to these parameters, or to 'all'."
        ),
    ] = "",
) -> int:
    """Export a Modelica model as an FMU (needs the extra 'export' of the package)."""
    from fmuid import console
    from fmuid.export import export_fmu

    names = [name.strip() for name in sensitivities.split(",")] if sensitivities else []
    console.show_files([export_fmu(model, output, fmi=fmi, sensitivities="all" if names == ["all"] else names)])
    return DONE


def _folder(output: Path | None, study: Path) -> Path:
    return study.parent / "results" if output is None else output


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code; whatever is wrong with the input is one sentence on stderr."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments
        As typed after ``fmuid``; default: those of the process.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        code: Any = app(given or ["--help"], standalone_mode=False, prog_name="fmuid")
    except InputError as error:
        return _refuse(str(error), WRONG_INPUT)
    except FmuidError as error:
        return _refuse(str(error), NOT_SUCCEEDED)
    except _USAGE_ERROR as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "fmuid"
        return _refuse(
            f"{command}: {error.format_message().rstrip('.?').replace('. ', '; ')} (see {command} --help)", WRONG_INPUT
        )
    except (KeyboardInterrupt, typer.Abort):
        return _refuse("interrupted", NOT_SUCCEEDED)
    except BrokenPipeError:  # as in `fmuid info model.fmu | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return NOT_SUCCEEDED
    if code == _TYPER_INTERRUPTED:
        return _refuse("interrupted", NOT_SUCCEEDED)
    return code if isinstance(code, int) else DONE


# What typer returns for Ctrl-C where it does not raise Abort.
_TYPER_INTERRUPTED = 130
# Click's exception of wrong usage, wherever this version of typer keeps click.
_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]


def _refuse(sentence: str, code: int) -> int:
    print("error: " + " ".join(sentence.split()), file=sys.stderr)
    return code
