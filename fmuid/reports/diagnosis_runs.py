"""One path for a search for faults: a diagnosis or a monitoring, its files and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import files
from fmuid.data import Experiment, record_files
from fmuid.diagnosis import Diagnosis, Monitor
from fmuid.errors import InputError
from fmuid.progress import Event, Progress
from fmuid.reports.figure_files import check_format
from fmuid.reports.interactive.style import MAX_EXPERIMENTS
from fmuid.reports.messages.diagnosis import verdict
from fmuid.reports.messages.monitoring import monitoring_sentences
from fmuid.reports.page.contents import read_table
from fmuid.reports.page.faults import MONITORED_FILE, PREPARED_FILE
from fmuid.reports.page.saved import read_json
from fmuid.reports.page.write import show_results
from fmuid.reports.preprocessing import prepared, prepared_table, said_of, thinned_again, words_of, write_prepared
from fmuid.reports.provenance import made_from
from fmuid.runs import build_monitor, records_of, rule_of
from fmuid.studies import ExperimentSettings, Study

RESIDUALS_FILE = "diagnosis-residuals.csv"
"""Residuals of the first experiment, of the healthy machine and with what is named."""


@dataclass(frozen=True, eq=False)
class DiagnosisRun:
    """What a diagnosis has found, and the files that were written."""

    diagnosis: Diagnosis
    files: tuple[Path, ...] = ()

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong."""
        return self.diagnosis.kind == "healthy"


@dataclass(frozen=True, eq=False)
class MonitoringRun:
    """What monitoring has found, and the files that were written."""

    monitor: Monitor
    files: tuple[Path, ...] = ()

    @property
    def healthy(self) -> bool:
        """Whether there is no alarm, and no fault stays open."""
        return not self.monitor.alarms and not self.monitor.undetermined


@dataclass(frozen=True, kw_only=True)
class DiagnosisFinished(Event):
    """A search for faults has ended; figures come next."""

    task: str = "judged"
    findings: DiagnosisRun | MonitoringRun


def run_diagnosis(
    study: Study | str | Path,
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    progress: Progress | None = None,
) -> DiagnosisRun:
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
        Called before each fit, and with `DiagnosisFinished`.

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
    >>> known = {"baseline": "healthy/result.json", "faults": faults}
    >>> words = coil.study | {"experiments": test.study["experiments"], "parameters": {}, "diagnosis": known}
    >>> fmuid.run_diagnosis(fmuid.Study.of(words, "test.toml")).diagnosis
    Diagnosis(fault: turns)
    """
    check_format(figures)
    study, target = _prepared(study, folder, figures is not None or report)
    if target is not None:
        files.make_folder(target)
    found = DiagnosisRun(study.diagnose(progress))
    try:
        if target is not None:
            found = replace(found, files=tuple(_written(target, study, found.diagnosis)))
    finally:  # what was found is shown also where there is no room for it
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
) -> MonitoringRun:
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
        Called before each window, and with `DiagnosisFinished`.

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
    >>> known = {"baseline": "healthy/result.json", "faults": faults}
    >>> rule = {"false_alarm_rate": 0.01}
    >>> words = coil.study | {"parameters": {}, "diagnosis": known, "monitoring": rule}
    >>> fmuid.run_monitoring(fmuid.Study.of(words, "test.toml"), [test.path]).healthy
    False
    """
    check_format(figures)
    study, target = _prepared(study, folder, figures is not None or report or append)
    monitor = build_monitor(study, rule_of(study))
    paths, written = [Path(table) for table in tables], list[Path]()
    earlier, beside, kept = dict[str, Any](), dict[str, Any](), None
    if target is not None:
        if append:
            beside = monitor.resume(target)
            earlier = read_json(target / "monitoring.json")
        files.make_folder(target)
        kept = MonitoredTables(target, study.experiments[0], append=append)
    try:
        for record, raw in records_of(study, paths, monitor.records):
            monitor.add(record, progress)
            if kept is not None:
                kept.add(record, raw)
    finally:  # what was found before a record that is wrong is kept, and can be appended to
        if target is not None and kept is not None and monitor.records:
            examined = (path for path in record_files(paths) if path.stem in monitor.records)
            told = made_from(study, examined)
            told["files"] = earlier.get("files", {}) | told["files"]
            told["experiments"] = kept.said
            written += kept.write()
            written += monitor.write(target, told | {"words": monitoring_sentences(monitor)}, beside=beside)
    found = MonitoringRun(monitor, tuple(written))
    _tell(progress, found)
    there = [] if target is None or not written else show_results(target, report=report, figures=figures)
    return replace(found, files=(*found.files, *there))


class MonitoredTables:
    """What was done with the tables of the first records that are monitored, kept beside what is found in them.

    Parameters
    ----------
    folder : Path
    given : ExperimentSettings
        How records are read.
    append : bool
        Whether to go on with what the folder has.

    Attributes
    ----------
    said : list of dict
        What ``monitoring.json`` says of them.
    """

    def __init__(self, folder: Path, given: ExperimentSettings, *, append: bool) -> None:
        self.path, self.given, self._new = folder / MONITORED_FILE, given, not append
        earlier = read_json(folder / "monitoring.json") if append and files.is_file(folder / "monitoring.json") else {}
        self.said: list[dict[str, Any]] = list(earlier.get("experiments", []))
        table = read_table(self.path) if self.said and files.is_file(self.path) else pd.DataFrame()
        self._tables = {each["name"]: table[table["experiment"] == each["name"]] for each in self.said if len(table)}

    def add(self, record: Experiment, raw: pd.DataFrame) -> None:
        """Note what was done with a table, or with what is new of one that grows."""
        known = any(each["name"] == record.name for each in self.said)
        if not words_of(self.given) or not (known or len(self.said) < MAX_EXPERIMENTS):
            return
        done = prepared_table(self.given.model_copy(update={"name": record.name}), record, raw)
        if not known:
            self.said += said_of([done])
        before = self._tables.get(record.name, pd.DataFrame())
        new = done.table[done.table["time"] > before["time"].max()] if len(before) and len(done.table) else done.table
        if len(new):
            whole, self._new = pd.concat([before, new], ignore_index=True), True
            self._tables[record.name] = thinned_again(whole)

    def write(self) -> list[Path]:
        """Write the columns before and after, where there are new ones; return the file that there is."""
        if self._new:
            self._new = False
            return write_prepared(self.path, list(self._tables.values()))
        return [self.path] if self._tables else []


def _prepared(study: Study | str | Path, folder: str | Path | None, needed: bool) -> tuple[Study, Path | None]:
    """Return the study read, and the folder."""
    if folder is None and needed:
        raise InputError("figures, a report and an earlier run are in a folder: say in which one")
    return study if isinstance(study, Study) else Study.read(study), None if folder is None else Path(folder)


def _units(study: Study) -> dict[str, str | None]:
    """Return the unit of each output of the study's tables."""
    return {name: each.units.get(name, study.system.unit(name)) for each in study.tables for name in each.output_names}


def _written(folder: Path, study: Study, found: Diagnosis) -> list[Path]:
    """Write a diagnosis and, where something is named, the residuals without and with it."""
    done = prepared(study)
    content = {"verdict": verdict(found), **found.to_json_dict(), **made_from(study)}
    content |= {"units": _units(study), "experiments": said_of(done)}
    written = [files.write_json(folder / "diagnosis.json", content)]
    written.append(files.write_table(folder / "diagnosis.csv", found.table))
    written += write_prepared(folder / PREPARED_FILE, (each.table for each in done))
    path = folder / RESIDUALS_FILE
    if found.residuals is None or not found.evidence.explanations:
        path.unlink(missing_ok=True)
        return written
    return [*written, files.write_table(path, found.residuals)]


def _tell(progress: Progress | None, found: DiagnosisRun | MonitoringRun) -> None:
    if progress is not None:
        progress(DiagnosisFinished(findings=found))
