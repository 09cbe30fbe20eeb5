"""Documents to files: ``document.json``, ``report.html``, figures for print."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import is_file, is_folder, replacing
from fmuid.formatting import listed
from fmuid.reports.document import Document, Section
from fmuid.reports.figure_files import REPORT_FILE, clear_figures
from fmuid.reports.render.document_json import DOCUMENT_FILE, read_documents, write_document


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
    documents = list(documents_of(folder).values())
    title = next((each.title for each in documents if each.title), "") or folder.absolute().parent.name
    path = folder / REPORT_FILE
    with replacing(path) as draft:
        draft.write_text(page(title, documents), encoding="utf-8")
    return path


def documents_of(folder: Path) -> dict[str, Document]:
    """Return the documents of a folder by their kind: those written there, else those of the results it has.

    Raises
    ------
    InputError
        If the folder has no results, or a file in it cannot be read.
    """
    if is_file(folder / DOCUMENT_FILE):
        return read_documents(folder)
    from fmuid import runs
    from fmuid.reports.documents import document

    readers: dict[str, Callable[[Path], object]] = {
        "result.json": runs.read_identification,
        "diagnosis.json": runs.read_diagnosis,
        "monitoring.json": runs.read_monitoring,
        "prediction.json": runs.read_prediction,
        "comparison.json": runs.read_comparison,
    }
    found = [document(read(folder)) for name, read in readers.items() if is_file(folder / name)]
    if not found:
        raise InputError(
            f"{folder} has no {listed([DOCUMENT_FILE, *readers])}: give the folder that a command has written into"
        )
    return {each.kind: each for each in found}


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
