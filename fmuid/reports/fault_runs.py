"""One path for a search for faults: a diagnosis or a monitoring, its files and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import files
from fmuid.data import record_files
from fmuid.diagnosis import Diagnosis, Monitor
from fmuid.errors import InputError
from fmuid.progress import Event, Progress
from fmuid.reports.drawn import check_format
from fmuid.reports.interactive.style import MAX_EXPERIMENTS
from fmuid.reports.origin import made_from
from fmuid.reports.page.contents import read_json, read_table
from fmuid.reports.page.faults import MONITORED_FILE, PREPARED_FILE
from fmuid.reports.page.write import show_results
from fmuid.reports.preparations import Prepared, prepared, prepared_each
from fmuid.reports.words.diagnosis import verdict
from fmuid.reports.words.monitoring import monitoring_sentences
from fmuid.studies import Study, monitor_of, records_of, rule_of

RESIDUALS_FILE = "diagnosis-residuals.csv"
"""Residuals of the first experiment, of the healthy model and with the fault."""


@dataclass(frozen=True, eq=False)
class DiagnosisFindings:
    """What a diagnosis has found, and the files that were written."""

    diagnosis: Diagnosis
    files: tuple[Path, ...] = ()

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong."""
        return self.diagnosis.kind == "healthy"


@dataclass(frozen=True, eq=False)
class MonitoringFindings:
    """What monitoring has found, and the files that were written."""

    monitor: Monitor
    files: tuple[Path, ...] = ()

    @property
    def healthy(self) -> bool:
        """Whether there is no alarm, and no fault stays open."""
        return not self.monitor.alarms and not self.monitor.undetermined


@dataclass(frozen=True, kw_only=True)
class Judged(Event):
    """A search for faults has ended; figures come next."""

    task: str = "judged"
    findings: DiagnosisFindings | MonitoringFindings


def run_diagnosis(
    study: Study | str | Path,
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    progress: Progress | None = None,
) -> DiagnosisFindings:
    """Look for the faults that the ``[diagnosis]`` of a study names, and write what is found.

    ``fmuid diagnose`` is this, with a folder and a report.

    Parameters
    ----------
    study : Study or path
    folder : path, optional
        Where ``diagnosis.json`` and ``diagnosis.csv`` go, made where needed. Nothing is written without one.
    figures : str, optional
        ``png``, ``svg`` or ``pdf``: draw figures for print, into ``figures/`` of the folder.
    report : bool
        Whether to write ``report.html`` into the folder.
    progress : callable, optional
        Called before each fit, and with `Judged`.

    Raises
    ------
    InputError
        As `Study.diagnose`, or if there are figures without a folder, or nothing can be written there.
    SimulationError
        If the simulation fails at the healthy estimate.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> _ = fmuid.run_study(fmuid.Study.of(coil.study, "coil.toml"), "healthy")
    >>> faults = {"turns": {"fmu": str(test.fmu), "parameters": {"dR": {"nominal": 1.0}}}}
    >>> known = {"healthy": "healthy/result.json", "faults": faults}
    >>> words = coil.study | {"experiments": test.study["experiments"], "parameters": {}, "diagnosis": known}
    >>> fmuid.run_diagnosis(fmuid.Study.of(words, "test.toml")).diagnosis
    Diagnosis(fault: turns)
    """
    check_format(figures)
    study, target = _prepared(study, folder, figures is not None or report)
    if target is not None:
        files.make_folder(target)
    found = DiagnosisFindings(study.diagnose(progress))
    if target is not None:
        found = replace(found, files=tuple(_written(target, study, found.diagnosis)))
    _tell(progress, found)
    there = [] if target is None else show_results(target, report=report, figures=figures)
    return replace(found, files=(*found.files, *there))


def run_monitoring(
    study: Study | str | Path,
    tables: Sequence[str | Path],
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    append: bool = False,
    progress: Progress | None = None,
) -> MonitoringFindings:
    """Look for the faults that a study names in records, window by window, and write what is found.

    ``fmuid monitor`` is this, with a folder and a report.

    Parameters
    ----------
    study : Study or path
    tables : sequence of path
        Records, and folders of records, in their order.
    folder : path, optional
        Where ``monitoring.csv`` and ``monitoring.json`` go, made where needed. Nothing is written without one.
    figures : str, optional
        ``png``, ``svg`` or ``pdf``: draw figures for print, into ``figures/`` of the folder.
    report : bool
        Whether to write ``report.html`` into the folder.
    append : bool
        Whether to go on with the run in the folder, whose records are left out.
    progress : callable, optional
        Called before each window, and with `Judged`.

    Raises
    ------
    InputError
        If study, models and records do not fit together, there are figures or a run to go on with without a folder, or
        nothing can be written there. What was found before a record that is wrong is written.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> _ = fmuid.run_study(fmuid.Study.of(coil.study, "coil.toml"), "healthy")
    >>> faults = {"turns": {"fmu": str(test.fmu), "parameters": {"dR": {"nominal": 1.0}}}}
    >>> known = {"healthy": "healthy/result.json", "faults": faults}
    >>> rule = {"level": 0.01}
    >>> words = coil.study | {"parameters": {}, "diagnosis": known, "monitoring": rule}
    >>> fmuid.run_monitoring(fmuid.Study.of(words, "test.toml"), [test.path]).healthy
    False
    """
    check_format(figures)
    study, target = _prepared(study, folder, figures is not None or report or append)
    monitor = monitor_of(study, rule_of(study))
    paths, written = [Path(table) for table in tables], list[Path]()
    earlier, done = dict[str, Any](), list[Prepared]()
    if target is not None:
        if append:
            monitor.resume(target)
            earlier = read_json(target / "monitoring.json")
        files.make_folder(target)
    try:
        for record in records_of(study, paths, monitor.records):
            monitor.add(record, progress)
            if target is not None and len(done) < MAX_EXPERIMENTS:
                given = study.experiments[0].model_copy(update={"name": record.name, "table": Path(record.source)})
                done += prepared_each([(given, record)])
    finally:  # what was found before a record that is wrong is kept, and can be appended to
        if target is not None and monitor.records:
            examined = (path for path in record_files(paths) if path.stem in monitor.records)
            told = made_from(study, examined)
            told["files"] = earlier.get("files", {}) | told["files"]
            told["experiments"] = [*earlier.get("experiments", []), *_said(done)]
            written += _write_prepared(target / MONITORED_FILE, done, append=append)
            written += monitor.write(target, told | {"words": monitoring_sentences(monitor)})
    found = MonitoringFindings(monitor, tuple(written))
    _tell(progress, found)
    there = [] if target is None or not written else show_results(target, report=report, figures=figures)
    return replace(found, files=(*found.files, *there))


def _prepared(study: Study | str | Path, folder: str | Path | None, needed: bool) -> tuple[Study, Path | None]:
    """Return the study read, and the folder."""
    if folder is None and needed:
        raise InputError("figures, a report and an earlier run are in a folder: say in which one")
    return study if isinstance(study, Study) else Study.read(study), None if folder is None else Path(folder)


def _units(study: Study) -> dict[str, str | None]:
    """Return the unit of each output of the study's tables."""
    return {name: each.units.get(name, study.system.unit(name)) for each in study.tables for name in each.output_names}


def _written(folder: Path, study: Study, found: Diagnosis) -> list[Path]:
    """Write a diagnosis and, where it has them, the residuals without and with the fault that explains most."""
    done = prepared(study)
    content = {"verdict": verdict(found), **found.to_json_dict(), **made_from(study)}
    content |= {"units": _units(study), "experiments": _said(done)}
    written = [files.write_json(folder / "diagnosis.json", content)]
    written.append(files.write_table(folder / "diagnosis.csv", found.table))
    written += _write_prepared(folder / PREPARED_FILE, done)
    path = folder / RESIDUALS_FILE
    best = found[found.named[0]] if found.named else min(found.hypotheses, key=lambda each: each.probability)
    if found.result is None or best.result is None:
        path.unlink(missing_ok=True)
        return written
    columns = {"time": found.result.fit[0]["time"]}
    for kind, frame in (("healthy", found.result.fit[0]), ("fault", best.result.fit[0])):
        for output, unlike in zip(study.tables[0].output_names, residuals_of(frame), strict=True):
            columns[f"{kind}.{output}"] = unlike
    return [*written, files.write_table(path, pd.DataFrame(columns))]


def _said(done: Sequence[Prepared]) -> list[dict[str, Any]]:
    """Return what a JSON file says of what was done with tables."""
    return [{"name": each.experiment, "preparation": each.words, "columns": each.units} for each in done]


def _write_prepared(path: Path, done: Sequence[Prepared], *, append: bool = False) -> list[Path]:
    """Write the columns of tables before and after, to those of earlier ones where they are to be added."""
    tables = [read_table(path)] if append and files.is_file(path) else []
    tables += [each.table for each in done if len(each.table)]
    path.unlink(missing_ok=True)
    return [files.write_table(path, pd.concat(tables, ignore_index=True))] if tables else []


def residuals_of(frame: pd.DataFrame) -> list[pd.Series[float]]:
    """Return measured − simulated of each output of a result's fit, whatever its name in this model."""
    kinds = (
        [str(name) for name in frame.columns if str(name).startswith(each)] for each in ("measured.", "simulated.")
    )
    return [frame[measured] - frame[simulated] for measured, simulated in zip(*kinds, strict=True)]


def _tell(progress: Progress | None, found: DiagnosisFindings | MonitoringFindings) -> None:
    if progress is not None:
        progress(Judged(findings=found))
