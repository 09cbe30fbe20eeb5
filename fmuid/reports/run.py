"""Run a command on a study, and report it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from fmuid.errors import InputError
from fmuid.reports.document import Document
from fmuid.reports.publish import FORMATS, publish

if TYPE_CHECKING:
    from fmuid.events import Progress
    from fmuid.runs import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun
    from fmuid.studies import Study

AnyFindings: TypeAlias = "IdentificationRun | DiagnosisRun | MonitoringRun | PredictionRun | ComparisonRun"
Command = Literal["identify", "diagnose", "monitor", "predict", "compare"]
Found = TypeVar("Found", bound="AnyFindings")


def published(
    found: Found, document: Document, folder: Path, *, report: bool = True, figures: str | None = None
) -> Found:
    """Write the report of findings; return them with these files."""
    if not found.files:  # they are not written yet
        return found
    drawn = publish(folder, document, report=report, figures=figures)
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
        Called with every step (`fmuid.events`).

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
    ['diagnostics.csv', 'document.json']
    >>> fmuid.run("results", command="predict", tables=[fmuid.datasets.coil().path]).scores["output"].tolist()
    ['i']
    """
    if figures is not None and figures not in FORMATS:
        raise InputError(f"figures are drawn as {', '.join(FORMATS)}, not {figures!r}")
    folder = None if output is None else Path(output)
    if folder is None and figures:
        raise InputError("figures are in a folder: say in which one")
    found = None
    for each in _findings(study, folder, command, tables, progress):
        found = each if folder is None else published(each, Document.of(each), folder, report=report, figures=figures)
    assert found is not None, "a run yields, or raises an error"
    return found


def _findings(
    given: Study | str | Path | Sequence[str | Path],
    folder: Path | None,
    command: Command,
    tables: Sequence[str | Path],
    progress: Progress | None,
) -> Iterator[AnyFindings]:
    from fmuid.runs import compared, diagnosed, identified, monitored, predicted_by, write_findings
    from fmuid.studies import Study

    if command == "compare":
        if isinstance(given, Study | str | Path):
            raise InputError("results are compared: give a sequence of result.json files, or of their folders")
        comparison = compared(given, tables)
        yield comparison if folder is None else write_findings(folder, comparison)
        return
    if not isinstance(given, Study | str | Path):
        raise InputError(f"{command} takes one study, not several")
    if command == "predict":
        if isinstance(given, Study):
            raise InputError("a result predicts: give its result.json, or its folder")
        found = predicted_by(given, tables)
        yield found if folder is None else write_findings(folder, found)
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
