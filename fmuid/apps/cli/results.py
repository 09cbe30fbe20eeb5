"""The commands about results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from fmuid import errors, files, formatting, reports, runs, studies
from fmuid.apps.cli.options import (
    DONE,
    FigureFormat,
    Figures,
    FmuFile,
    NoIsolation,
    NoReport,
    Overrides,
    Refit,
    ResultFile,
    showing_findings,
)
from fmuid.apps.cli.studies import logged
from fmuid.reports import render, topics


@showing_findings
def predict(
    result: ResultFile,
    data: Annotated[
        list[Path] | None,
        Argument(metavar="DATA", help="Validation data files, or folders of them.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="DIR", help="Results folder (default: prediction/ beside RESULT)."),
    ] = None,
    study: Annotated[
        Path | None, Option(metavar="STUDY", help="Study with model and columns (default: that of the result).")
    ] = None,
    refit: Refit = None,
    experiment: Annotated[
        str | None, Option(metavar="NAME", help="Experiment whose settings the data files are read with.")
    ] = None,
    folds: Annotated[
        int | None, Option(metavar="K", help="Cross-validate the study's experiments in K parts, without DATA.")
    ] = None,
    confidence: Annotated[float, Option(metavar="P", help="Confidence level of the bands.")] = 0.95,
    figures: Figures = None,
    no_report: NoReport = False,
    set_: Overrides = None,
    no_isolation: NoIsolation = False,
) -> int:
    """Predict validation data with a result: errors, fit, tests, bands."""
    path = runs.result_path(result)
    folder = path.parent / "prediction" if output is None else output
    with logged(folder, no_isolation) as isolated:
        records = data or []
        if records and folds is not None:
            raise errors.InputError("--folds: predicts the experiments of the study. Remove DATA.")
        read = _study(path, study, set_, records, isolated=isolated)
        with render.Display() as display:
            shared: dict[str, Any] = {"study": read, "free": refit or (), "level": confidence}
            if folds is None:
                found = runs.predicted_by(path, records, like=experiment, **shared)
            else:
                found = runs.cross_predicted(path, folds, progress=display, **shared)
        _write(found, topics.prediction_document(found), folder, report=not no_report, figures=figures)
        return DONE


@showing_findings
def compare(
    results: Annotated[
        list[Path], Argument(metavar="RESULT", help="result.json files, or their folders.", show_default=False)
    ],
    data: Annotated[
        list[Path] | None, Option(metavar="DATA", help="A data file or folder that all results predict; repeatable.")
    ] = None,
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="DIR", help="Results folder (default: comparison/ beside the first)."),
    ] = None,
    refit: Refit = None,
    no_isolation: NoIsolation = False,
    no_report: NoReport = False,
) -> int:
    """Compare results by information criteria, likelihood ratios and errors on common data."""
    folder = runs.result_path(results[0]).resolve().parents[1] / "comparison" if output is None else output
    with logged(folder, no_isolation) as isolated:
        found = runs.compared(results, data or (), free=refit or (), isolated=isolated)
        _write(found, topics.comparison_document(found), folder, report=not no_report)
        return DONE


def _write(
    found: Any, shown: reports.Document, folder: Path, *, report: bool, figures: FigureFormat | None = None
) -> None:
    """Write, show and publish findings; they are shown also on a full disk."""
    files.make_folder(folder)
    try:
        found = runs.write_findings(folder, found)
    finally:
        render.show(shown)
    render.show_files(reports.published(found, shown, folder, report=report, figures=figures).files)


def report(
    results: Annotated[Path, Argument(metavar="RESULTS", help="Results folder of a command.", show_default=False)],
) -> int:
    """Write report.html of a results folder, one page that loads nothing."""
    render.show_files([reports.write_report(results)])
    return DONE


def apply(
    result: Annotated[
        Path, Argument(metavar="RESULT", help="result.json, its folder, or an .ssv file.", show_default=False)
    ],
    fmu: FmuFile,
    output: Annotated[Path, Option("--output", "-o", metavar="NEW.fmu", help="FMU to write.")],
    component: Annotated[str | None, Option(metavar="NAME", help="Component of the system that the FMU is.")] = None,
    force: Annotated[bool, Option("--force", help="Apply a result that is not usable.")] = False,
) -> int:
    """Write estimates as start values into a copy of an FMU."""
    _show_applied(runs.apply_result(result, fmu, output, component, force=force))
    render.show_files([output])
    return DONE


def _show_applied(applied: Sequence[runs.AppliedValue]) -> None:
    from fmuid.reports.document import Section, table_of_rows

    rows = []
    for each in applied:
        old, known = each.old, math.isfinite(each.std)
        new = formatting.rounded(each.new, each.std) if isinstance(each.new, float) else str(each.new)
        cells = ["" if old is None else f"{old:.6g}" if isinstance(old, float) else str(old), new]
        cells += [formatting.rounded(each.std, each.std) if known else "", formatting.unit_text(each.unit)]
        rows.append((each.variable, *cells))
    heads = ("variable", "old start", "new start", "σ", "unit")
    render.show_section(Section("starts", "Start values", table=table_of_rows(heads, rows, ("unit",))))


def _study(
    result: Path, study: Path | None, set_: list[str] | None, data: list[Path], *, isolated: bool
) -> studies.Study:
    """Return the given study, or that of a result."""
    if study is not None:
        return studies.Study.read(study, set_ or (), isolated=isolated)
    return runs.study_of(result, set_ or (), isolated=isolated, in_place=data[0] if data else None)
