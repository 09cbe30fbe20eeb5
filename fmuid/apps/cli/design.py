"""The command ``fmuid design``: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fmuid.apps.cli.options import DONE, Folder, InProcess, NoReport, Overrides, StudyFile, folder_of
from fmuid.apps.cli.studies import opened


def design(
    study: StudyFile,
    tables: Annotated[
        list[Path],
        typer.Argument(
            metavar="TABLE", help="Excitations, or folders of them: tables that need no outputs.", show_default=False
        ),
    ],
    output: Folder = None,
    by: Annotated[
        str, typer.Option("--by", metavar="WORD", help="Accuracy by 'determinant', or by the 'worst' relative std.")
    ] = "determinant",
    fault: Annotated[
        str | None,
        typer.Option("--fault", metavar="NAME", help="Instead: by the smallest size of this fault that is found."),
    ] = None,
    set_: Overrides = None,
    in_process: InProcess = False,
    no_report: NoReport = False,
) -> int:
    """Compare excitations before anything is measured: how accurate estimates will be, or which fault they show."""
    folder = folder_of(output, study)
    with opened(study, set_, in_process, folder) as read:
        from fmuid import files
        from fmuid.reports import healthy_record_words, write_origin
        from fmuid.reports.console import layout as console
        from fmuid.reports.page.write import show_results
        from fmuid.runs import healthy_record_cost, ranked_excitations

        files.make_folder(folder)
        ranked = ranked_excitations(read, tables, by=by, fault=fault)
        written = [files.write_table(folder / "design.csv", ranked), write_origin(folder / "design.json", read, tables)]
        console.show_frame("Excitations, the best first", ranked)
        if fault is not None:
            best = str(ranked["excitation"].iloc[0])
            cost = healthy_record_cost(read, tables, fault, best)
            console.show_frame(f"Healthy records, in lengths of {best}: the smallest size found", cost)
            console.show_remarks(healthy_record_words(cost))
        console.show_files([*written, *show_results(folder, report=not no_report)])
        return DONE
