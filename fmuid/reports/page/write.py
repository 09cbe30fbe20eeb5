"""Write ``report.html`` from what a folder has of results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid.errors import InputError
from fmuid.files import is_file, is_folder, replacing
from fmuid.formatting import listed
from fmuid.reports.figure_files import REPORT_FILE, clear_figures
from fmuid.reports.render.document_json import DOCUMENT_FILE

if TYPE_CHECKING:
    from fmuid.reports.page.document import Part, Section
    from fmuid.simulation import OutputFit

FILES = (
    *("result.json", "diagnosis.json", "monitoring.json", "prediction.json"),
    *("design.csv", "sensitivities.csv"),
)
"""What a folder of results has at least one of."""


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` into a folder of results and return its path.

    The page shows what the folder's files say, of all commands that have left some there, needs no other file and asks
    no host.

    Parameters
    ----------
    folder : path
        As a command has left it, with one of `FILES` at least.

    Raises
    ------
    InputError
        If the folder has no results, a file in it cannot be read, or nothing can be written there.
    """
    from fmuid.reports import publish
    from fmuid.reports.page.document import page

    folder = Path(folder)
    if is_file(folder / DOCUMENT_FILE):
        return publish.write_report(folder)
    text = page(*contents(folder))
    path = folder / REPORT_FILE
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path


def contents(folder: Path, files: Sequence[str] = FILES) -> tuple[str, list[Part]]:
    """Return the title of a report on a folder of results, and its parts: of those of these files that are there.

    Raises
    ------
    InputError
        If the folder has no results, or a file in it cannot be read.
    """
    if not is_folder(folder):
        raise InputError(f"{folder} is no folder of results")
    there = [name for name in files if is_file(folder / name)]
    if not there and is_file(folder / DOCUMENT_FILE):
        return folder.absolute().parent.name, []
    if not there:
        raise InputError(f"{folder} has no {listed(FILES)}: give the folder that a command has written into")
    from fmuid.reports.page.saved import read_json

    beside = (folder / there[0]).with_suffix(".json")
    first = read_json(beside) if is_file(beside) else {}
    origin = first.get("origin", first)
    title = str(origin.get("title", "")) if isinstance(origin, dict) else ""
    return title or folder.absolute().parent.name, [_part(folder, name) for name in there]


def show_results(folder: Path, *, report: bool, figures: str | None = None) -> list[Path]:
    """Write the report of a folder and its figures for print where they are wanted; those of an earlier run go.

    Raises
    ------
    InputError
        As `write_report` does.
    """
    clear_figures(folder / "figures")
    (folder / REPORT_FILE).unlink(missing_ok=True)
    sections = [] if figures is None else [each for part in contents(folder)[1] for each in part.sections]
    drawn = [] if figures is None else _printed(sections, folder / "figures", figures)
    return [*drawn, *([write_report(folder)] if report else [])]


def draw_simulation(folder: Path, fits: Sequence[OutputFit], figures: str, *, sensitivities: bool) -> list[Path]:
    """Draw measured and simulated outputs for print, and the sensitivities in the folder; those of an earlier run go.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    from fmuid.reports.page.fits import fit_sections
    from fmuid.reports.page.validation import part_of_sensitivities

    clear_figures(folder / "figures")
    sections = fit_sections("fit", "Measured and simulated", "", fits)
    sections += part_of_sensitivities(folder).sections if sensitivities else []
    return _printed(sections, folder / "figures", figures)


def _printed(sections: Sequence[Section], folder: Path, kind: str) -> list[Path]:
    """Draw a figure for print of each section."""
    from fmuid.reports.figures.matplotlib_renderer import printed
    from fmuid.reports.figures.style import save

    drawn = {}
    for each in sections:
        beside = [*each.figures, *([] if each.zoom is None else [each.zoom])]
        drawn[each.name] = printed(beside, max(each.columns, 1 + (each.zoom is not None)), each.heading)
    return save(drawn, folder, kind)


def _part(folder: Path, name: str) -> Part:
    from fmuid.reports.page import faults, identification, validation

    made = {
        "result.json": identification.part,
        "diagnosis.json": faults.part_of_diagnosis,
        "monitoring.json": faults.part_of_monitoring,
        "prediction.json": validation.part_of_prediction,
        "design.csv": validation.part_of_design,
        "sensitivities.csv": validation.part_of_sensitivities,
    }
    return made[name](folder)
