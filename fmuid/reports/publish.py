"""Documents to files: ``document.json``, ``report.html``, figures for print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import is_folder, replacing
from fmuid.reports.document import Document, Section
from fmuid.reports.figure_files import REPORT_FILE, clear_figures
from fmuid.reports.render.document_json import read_documents, write_document


def publish(folder: Path, document: Document, *, report: bool, figures: str | None = None) -> list[Path]:
    """Write a document into a folder, with a report and figures for print where they are wanted.

    Those of an earlier run go.

    Parameters
    ----------
    folder : Path
    document : Document
    report : bool
        Whether to write ``report.html``: this document and those of other commands in the folder.
    figures : str, optional
        ``png``, ``svg`` or ``pdf``.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    written = [write_document(folder, document)]
    (folder / REPORT_FILE).unlink(missing_ok=True)
    written += [] if figures is None else write_figures(folder, document.sections, figures)
    if figures is None:
        clear_figures(folder / "figures")
    return [*written, *([write_report(folder)] if report else [])]


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` into a folder of results and return its path.

    The page shows the documents of all commands that have written into the folder, needs no other file and asks no
    host.

    Raises
    ------
    InputError
        If the folder has no documents, they cannot be read, or nothing can be written there.
    """
    from fmuid.reports.render.html import page

    folder = Path(folder)
    if not is_folder(folder):
        raise InputError(f"{folder} is no folder of results")
    documents = list(read_documents(folder).values())
    title = next((each.title for each in documents if each.title), "") or folder.absolute().parent.name
    path = folder / REPORT_FILE
    with replacing(path) as draft:
        draft.write_text(page(title, documents), encoding="utf-8")
    return path


def write_figures(folder: Path, sections: Sequence[Section], kind: str) -> list[Path]:
    """Draw a figure for print of each section that has charts, into ``figures/`` of a folder; those of before go.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    from fmuid.reports.render.matplotlib_renderer import printed, save

    clear_figures(folder / "figures")
    drawn = {}
    for each in (section for section in sections if section.charts):
        beside = [*each.charts, *([] if each.zoom is None else [each.zoom])]
        drawn[each.key] = printed(beside, max(each.beside, 1 + (each.zoom is not None)), each.heading)
    return save(drawn, folder / "figures", kind)
