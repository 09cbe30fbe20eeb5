"""Arguments, options and exit codes of commands; renamed options."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

DONE, NOT_SUCCEEDED, WRONG_INPUT = 0, 1, 2  # exit codes

FmuFile = Annotated[Path, Argument(metavar="FMU", help="FMU file.", show_default=False)]
StudyFile = Annotated[Path, Argument(metavar="STUDY", help="Study file (TOML).", show_default=False)]
ResultFile = Annotated[
    Path, Argument(metavar="RESULT", help="result.json, or the folder that has it.", show_default=False)
]
Folder = Annotated[
    Path | None, Option("--output", "-o", metavar="DIR", help="Results folder (default: results/ beside the study).")
]
Overrides = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="Replace a study value, e.g. parameters.Rs.start=9; repeatable."),
]
NoIsolation = Annotated[
    bool, Option("--no-isolation", help="Run FMUs inside this process; an FMU that crashes ends it.")
]
Refit = Annotated[
    list[str] | None, Option("--refit", metavar="NAME", help="Estimate this again on each data file; repeatable.")
]


class FigureFormat(StrEnum):
    """Format of figures for print."""

    PNG = "png"
    SVG = "svg"
    PDF = "pdf"


Figures = Annotated[
    FigureFormat | None, Option("--figures", help="Draw figures for print into figures/ of the output.")
]
NoReport = Annotated[bool, Option("--no-report", help="Leave out report.html.")]

_LOCAL_ONLY = "was removed: the workbench serves this machine only; from another one use ssh -L"
_CHANGED = {
    "open": "is now workbench",
    "--in-process": "is now --no-isolation",
    "--append": "is now --resume",
    "--like": "is now --experiment",
    "--free": "is now --refit",
    "--level": "is now --confidence",
    "--prepare": "is now --preprocess KEY=VALUE",
    "--by": "is now --criterion",
    "--table": "is now --data",
    **dict.fromkeys(("--listen", "--certificate", "--key"), _LOCAL_ONLY),
}


def changed_option(given: Sequence[str]) -> str | None:
    """Return the change of the first renamed command or option."""
    for word in [*given[:1], *(each for each in given[1:] if each.startswith("--"))]:
        name = word.partition("=")[0]
        if name in _CHANGED:
            return f"{name} {_CHANGED[name]}"
    return None


SCREEN_OPTIONS = {
    "verbose": Annotated[bool, Option("--verbose", help="Also print details, all remedies, files and progress lines.")],
    "quiet": Annotated[bool, Option("--quiet", help="Print errors only.")],
    "json": Annotated[bool, Option("--json", help="Print the findings as JSON, without charts.")],
    "strict": Annotated[bool, Option("--strict", help="Exit with code 1 if the findings contain a doubt.")],
}


def showing_findings(command: Callable[..., int]) -> Callable[..., int]:
    """Add the output options to a command that shows a document."""

    @functools.wraps(command)
    def shown(*, verbose: bool, quiet: bool, json: bool, strict: bool, **given: Any) -> int:
        from fmuid.reports.render.console import Screen, showing

        with showing(Screen(verbose=verbose, quiet=quiet, json=json)) as screen:
            code = command(**given)
            return NOT_SUCCEEDED if strict and code == DONE and screen.doubtful else code

    signature = inspect.signature(command, eval_str=True)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in SCREEN_OPTIONS.items()
    ]
    shown.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *added])  # type: ignore[attr-defined]
    shown.__annotations__ = {**command.__annotations__, **SCREEN_OPTIONS}
    return shown


def folder_of(output: Path | None, study: Path) -> Path:
    """Return the results folder of a study."""
    return study.parent / "results" if output is None else output
