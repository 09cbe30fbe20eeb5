"""What the commands have in common: arguments, options, exit codes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fmuid.files import noted

DONE, NOT_SUCCEEDED, WRONG_INPUT = 0, 1, 2
"""Exit codes: done; it ran but did not succeed; something given is wrong."""

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
InProcess = Annotated[
    bool,
    typer.Option("--in-process", help="Run FMUs inside this process: one that crashes takes it along."),
]


class FigureFormat(StrEnum):
    """Of figures for print."""

    PNG = "png"
    SVG = "svg"
    PDF = "pdf"


Figures = Annotated[
    FigureFormat | None, typer.Option("--figures", help="Also draw figures for print, into figures/ of the output.")
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Leave out report.html.")]


@contextmanager
def telling_files() -> Iterator[None]:
    """Say which files were written before something went wrong."""
    with noted() as written:
        try:
            yield
        except (Exception, KeyboardInterrupt):
            if written:
                from fmuid.reports.console.layout import show_files

                show_files(dict.fromkeys(written))
            raise


def folder_of(output: Path | None, study: Path) -> Path:
    """Return where the files of a study go."""
    return study.parent / "results" if output is None else output
