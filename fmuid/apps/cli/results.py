"""The commands about results: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmuid.apps.cli.options import DONE, Figures, InProcess, NoReport, Overrides
from fmuid.apps.cli.studies import logged

if TYPE_CHECKING:
    from fmuid.studies import Study

ResultFile = Annotated[
    Path,
    typer.Argument(metavar="RESULT", help="A result.json, or the folder that has it.", show_default=False),
]
StudyOption = Annotated[
    Path | None,
    typer.Option(
        "--study",
        metavar="STUDY",
        help="Whose model and words for tables serve; default: the study of the result.",
    ),
]


def predict(
    result: ResultFile,
    tables: Annotated[
        list[Path] | None,
        typer.Argument(metavar="TABLE", help="Records, or folders of records.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Where the files go; default: prediction/ beside RESULT."),
    ] = None,
    study: StudyOption = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free", metavar="NAME", help="Estimate this again on each record, such as an initial state; repeatable."
        ),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option("--like", metavar="NAME", help="The experiment whose words the tables are read with."),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(
            "--folds",
            metavar="K",
            help="Instead of tables: predict each K-th of the study's experiments from the rest.",
        ),
    ] = None,
    level: Annotated[float, typer.Option("--level", metavar="P", help="Of the bands.")] = 0.95,
    figures: Figures = None,
    no_report: NoReport = False,
    set_: Overrides = None,
    in_process: InProcess = False,
) -> int:
    """Simulate a result over records that it was not made from: errors, fits, tests, bands."""
    from fmuid.runs import result_path

    path = result_path(result)
    folder = path.parent / "prediction" if output is None else output
    with logged(folder, in_process) as isolated:
        from fmuid import files
        from fmuid.reports import run_prediction
        from fmuid.reports.console import layout as console
        from fmuid.reports.console.prediction import show_predictions
        from fmuid.reports.console.progress import Display
        from fmuid.reports.page.write import show_results

        records = tables or []
        read = _study(path, study, set_, records, isolated=isolated)
        with Display() as display:
            how: dict[str, Any] = {"like": like, "folds": folds, "level": level, "progress": display}
            found = run_prediction(path, records, study=read, free=free or (), **how)
        files.make_folder(folder)
        try:
            written = found.write(folder)
        finally:  # what was found is shown also where there is no room for it
            show_predictions(found)
        console.show_files([*written, *show_results(folder, report=not no_report, figures=figures)])
        return DONE


def compare(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULT", help="result.json files, or the folders that have them.", show_default=False),
    ],
    tables: Annotated[
        list[Path] | None,
        typer.Option("--table", metavar="TABLE", help="A record, or a folder, that all results predict; repeatable."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Where the files go; default: comparison/ beside the first.",
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free", metavar="NAME", help="Estimate this again on each record, such as an initial state; repeatable."
        ),
    ] = None,
    in_process: InProcess = False,
    no_report: NoReport = False,
) -> int:
    """Compare results: information criteria and likelihood ratios on the same data, errors on common tables."""
    from fmuid.runs import result_path

    folder = result_path(results[0]).resolve().parents[1] / "comparison" if output is None else output
    with logged(folder, in_process) as isolated:
        from fmuid import files
        from fmuid.reports import run_comparison
        from fmuid.reports.console import layout as console
        from fmuid.reports.console.comparison import show_comparison
        from fmuid.reports.page.write import show_results

        found = run_comparison(results, tables or (), free=free or (), isolated=isolated)
        files.make_folder(folder)
        try:
            written = found.write(folder)
        finally:
            show_comparison(found)
        console.show_files([*written, *show_results(folder, report=not no_report)])
        return DONE


def _study(result: Path, study: Path | None, set_: list[str] | None, tables: list[Path], *, isolated: bool) -> Study:
    """Return the study that is asked for, or that of a result."""
    from fmuid.runs import study_of
    from fmuid.studies import Study

    if study is not None:
        return Study.read(study, set_ or (), isolated=isolated)
    return study_of(result, set_ or (), isolated=isolated, in_place=tables[0] if tables else None)
