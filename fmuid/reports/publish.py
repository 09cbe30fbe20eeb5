"""A study run and reported: findings, their documents, ``report.html``, figures for print."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from fmuid.errors import InputError
from fmuid.files import is_folder, replacing
from fmuid.reports.document import Document, Section
from fmuid.reports.figure_files import REPORT_FILE, check_format, clear_figures
from fmuid.reports.render.document_json import read_documents, write_document

if TYPE_CHECKING:
    from fmuid.progress import Progress
    from fmuid.runs import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun
    from fmuid.studies import Study


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


# --- runs

AnyFindings: TypeAlias = "IdentificationRun | DiagnosisRun | MonitoringRun | PredictionRun | ComparisonRun"
Command = Literal["identify", "diagnose", "monitor", "predict", "compare"]
Found = TypeVar("Found", bound="AnyFindings")


def published(found: Found, folder: Path | None, *, report: bool = True, figures: str | None = None) -> Found:
    """Write the report of a folder and its figures for print; return the findings with these files, too.

    Nothing is done where the findings were not written.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    from fmuid.reports.documents import document

    if folder is None or not found.files:
        return found
    drawn = publish(folder, document(found), report=report, figures=figures)
    return replace(found, files=tuple(dict.fromkeys((*found.files, *drawn))))


def run(
    study: Study | str | Path | Sequence[str | Path],
    output: str | Path | None = None,
    *,
    command: Command = "identify",
    tables: Sequence[str | Path] = (),
    report: bool = True,
    figures: str | None = None,
    progress: Progress | None = None,
) -> Any:
    """Do what a command does with a study: identify, diagnose, monitor, predict or compare; write and report it.

    Parameters
    ----------
    study : Study or path
        For ``predict`` a result, a ``result.json`` or its folder; for ``compare`` a sequence of them.
    output : path, optional
        Folder of the files, made where needed; files of an earlier run are replaced. Nothing is written without one.
    command : str
    tables : sequence of path
        Records, and folders of records: those to monitor or predict, or on which results are compared.
    report : bool
        Whether to write ``report.html`` into the folder.
    figures : str, optional
        ``png``, ``svg`` or ``pdf``: draw figures for print, into ``figures/`` of the folder.
    progress : callable, optional
        Called with every step (`fmuid.progress`).

    Returns
    -------
    Findings, DiagnosisRun, MonitoringRun, PredictionRun or ComparisonRun
        The last ones. Interrupted from the keyboard: what was found until then.

    Raises
    ------
    InputError
        If study, models and tables do not fit together, there are figures without a folder, or nothing can be written.
    SimulationError
        If a simulation fails where it must not.

    Examples
    --------
    >>> study = fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml")
    >>> found = fmuid.run(study, "results")
    >>> sorted(path.name for path in found.files)[:2]
    ['diagnostics.csv', 'estimates.csv']
    >>> fmuid.run("results", command="predict", tables=[fmuid.datasets.coil().path]).scores["output"].tolist()
    ['i']
    """
    check_format(figures)
    folder = None if output is None else Path(output)
    if folder is None and figures:
        raise InputError("figures are in a folder: say in which one")
    found = None
    for each in _findings(study, folder, command, tables, progress):
        found = published(each, folder, report=report, figures=figures)
    assert found is not None, "a run yields, or raises an error"
    return found


def _findings(
    given: Study | str | Path | Sequence[str | Path],
    folder: Path | None,
    command: Command,
    tables: Sequence[str | Path],
    progress: Progress | None,
) -> Iterator[AnyFindings]:
    """Yield the findings of a command."""
    from fmuid.runs import (
        compared,
        diagnosed,
        identified,
        monitored,
        predicted_by,
        write_comparison,
        write_prediction,
    )
    from fmuid.studies import Study

    if command == "compare":
        if isinstance(given, Study | str | Path):
            raise InputError("results are compared: give a sequence of result.json files, or of their folders")
        compared_ = compared(given, tables)
        yield compared_ if folder is None else write_comparison(folder, compared_)
        return
    if not isinstance(given, Study | str | Path):
        raise InputError(f"{command} takes one study, not several")
    if command == "predict":
        if isinstance(given, Study):
            raise InputError("a result predicts: give its result.json, or its folder")
        found = predicted_by(given, tables, progress=progress)
        yield found if folder is None else write_prediction(folder, found)
        return
    study = given if isinstance(given, Study) else Study.read(given)
    if command == "identify":
        yield from identified(study, folder, progress=progress)
    elif command == "diagnose":
        yield from diagnosed(study, folder, progress=progress)
    elif command == "monitor":
        yield from monitored(study, tables, folder, progress=progress)
    else:
        raise InputError(f"there is no command {command!r}; choose identify, diagnose, monitor, predict or compare")
