"""The command ``fmuid``: parse, call, print. No maths, and nothing heavy is imported before a command needs it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fmuid import __version__
from fmuid.errors import FmuidError, InputError

DONE, NOT_SUCCEEDED, WRONG_INPUT = 0, 1, 2
"""Exit codes: done; it ran but did not succeed; something given is wrong."""

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
    """Show what an FMU declares: capabilities, platforms, parameters, inputs, outputs."""
    from fmuid import console
    from fmuid.fmi.archive import FMU

    console.show_fmu(FMU(fmu))
    return DONE


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
    from fmuid import console, plots, report
    from fmuid.study import Study

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    report.make_folder(folder)
    console.warn_unfed(read.simulators())
    fits = read.fits()
    console.show_misfits(fits)
    table = report.stacked([fit.experiment for fit in fits], [fit.simulated_frame() for fit in fits])
    written = [report.write_table(folder / "simulated.csv", table)]
    written += plots.save(plots.fits(fits, residuals=False), folder / "figures")
    console.show_files(written)
    return DONE


@app.command()
def identify(
    study: StudyFile,
    output: Folder = None,
    set_: Overrides = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Start from the values in the output folder's result.json.")
    ] = False,
) -> int:
    """Identify the parameters of a study and write result, tables and figures."""
    from fmuid import console, plots, report
    from fmuid.identification import identify as identify_problem
    from fmuid.progress import Progress
    from fmuid.study import Study

    folder = _folder(output, study)
    read = Study.read(study, set_ or ())
    problem = read.problem()
    start = report.resumed_start(folder / "result.json", problem.parameters) if resume else problem.parameters.start
    report.make_folder(folder)
    console.warn_unfed(read.simulators())
    with Progress(problem.parameters.names, start) as progress:
        result = identify_problem(problem, read.estimator, progress, start)
    units = report.parameter_units(read.system, result.names)
    fits = report.result_fits(read.system, read.tables, result)
    written = report.write_result(folder, result, units, [fit.experiment for fit in fits])
    console.show_result(result, units, fits)
    estimates = report.estimates_frame(result, units)
    written += plots.save(plots.search(result.trace, estimates) | plots.fits(fits, residuals=True), folder / "figures")
    console.show_files(written)
    return DONE if result.converged else NOT_SUCCEEDED


@app.command()
def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL.mo", help="The Modelica file.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The FMU to write; default: beside the model.")
    ] = None,
) -> int:
    """Export a Modelica model as an FMU 2.0 (needs the extra 'export' of the package)."""
    from fmuid import console
    from fmuid.export import export_fmu

    console.show_files([export_fmu(model, output)])
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
