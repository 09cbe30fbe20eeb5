"""Documents to files: ``document.json``, ``report.html``, figures for print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import is_file, is_folder, replacing
from fmuid.reports.document import Document, Section
from fmuid.reports.render.document_json import DOCUMENT_FILE, kept_documents, read_documents, write_documents

FORMATS = ("png", "svg", "pdf")  # of figures for print
REPORT_FILE = "report.html"
# What the figures of a run are called, before a hyphen where there are several of a kind.
KINDS = """
forest fit preparation prepared residuals parameters cost optima belief parabolas correlation accuracy hiding
profiles maps posterior walkers causes changes explained timeline cases distributions spread over starts failures
leverage prediction likelihood errors estimates excitations sensitivities
""".split()  # noqa: SIM905  # as a list a line each


def publish(folder: Path, document: Document, *, report: bool, figures: str | None = None) -> list[Path]:
    """Write a document, its report and its figures; remove those of earlier runs."""
    documents = {**kept_documents(folder), document.kind: document}
    written = [write_documents(folder, documents)]
    (folder / REPORT_FILE).unlink(missing_ok=True)
    written += [] if figures is None else write_figures(folder, document.sections, figures)
    if figures is None:
        clear_figures(folder / "figures")
    return [*written, *([_write_page(folder, documents.values())] if report else [])]


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` of a results folder and return its path."""
    folder = Path(folder)
    if not is_folder(folder):
        raise InputError(f"{folder} is no folder of results")
    return _write_page(folder, documents_of(folder).values())


def _write_page(folder: Path, documents: Iterable[Document]) -> Path:
    from fmuid.reports.render.html import page

    shown = list(documents)
    title = next((each.title for each in shown if each.title), "") or folder.absolute().parent.name
    path = folder / REPORT_FILE
    with replacing(path) as draft:
        draft.write_text(page(title, shown), encoding="utf-8")
    return path


def documents_of(folder: Path) -> dict[str, Document]:
    """Return the documents of a folder by their kind; a monitoring that still runs has none yet."""
    from fmuid import runs
    from fmuid.reports.documents import document

    if is_file(folder / DOCUMENT_FILE) or not is_file(folder / runs.MONITORING_FILE):
        return read_documents(folder)
    return {"monitoring": document(runs.read_monitoring(folder))}


def write_figures(folder: Path, sections: Sequence[Section], kind: str) -> list[Path]:
    """Draw each section with charts for print, into ``figures/``."""
    from fmuid.reports.render.matplotlib_renderer import printed, save

    clear_figures(folder / "figures")
    drawn = {}
    for each in (section for section in sections if section.charts):
        beside = [*each.charts, *([] if each.zoom is None else [each.zoom])]
        drawn[each.key] = printed(beside, max(each.beside, 1 + (each.zoom is not None)), each.heading)
    return save(drawn, folder / "figures", kind)


def clear_figures(folder: Path) -> None:
    """Remove the figures of an earlier run; other files stay."""
    for old in folder.glob("*.*"):
        if old.suffix.lstrip(".") in FORMATS and old.stem.split("-")[0] in KINDS:
            old.unlink()
