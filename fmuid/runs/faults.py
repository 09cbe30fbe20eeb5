"""Diagnosis, monitoring and the design of a test as a study describes them: findings with their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import codec, files
from fmuid.data import Experiment, record_files
from fmuid.diagnosis import (
    FALSE_ALARM_LEVEL,
    MISS_PROBABILITY,
    Baseline,
    Design,
    Monitor,
    Rule,
    StoredBaseline,
    compute_stored_baseline,
)
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Result
from fmuid.progress import Progress
from fmuid.runs.findings import DiagnosisRun, MonitoringRun, PreprocessedTable, Provenance
from fmuid.runs.folder import MONITORED_FILE, MONITORING_FILE, MONITORING_SCHEMA, read_monitoring, write_diagnosis
from fmuid.runs.preprocessing import prepared, prepared_table, thinned_again, words_of, write_prepared
from fmuid.runs.provenance import made_from
from fmuid.studies import ExperimentSettings, Study

# Of the first records that are monitored what was done with their tables is kept, as many as a page shows.
MOST_PREPARED = 6


def rule_of(study: Study) -> Rule:
    """Return the rule of a monitoring that a study's ``[monitoring]`` and ``[diagnosis]`` give.

    Raises
    ------
    InputError
        If the study has no ``[diagnosis]``, a record is to be cut and nothing says how long the transient is, or the
        rule is wrong.
    """
    return study.monitoring.rule(study.experiments[0].warmup, study.fault_search.level)


def build_monitor(study: Study, rule: Rule) -> Monitor:
    """Return the monitor of the faults that the ``[diagnosis]`` of a study names; its level is the rule's.

    Raises
    ------
    InputError
        If the study has none, or models and healthy result do not fit together.
    """
    settings = study.fault_search
    faults = settings.fault_models(study.system, study.model, study.data)
    try:
        return Monitor(
            _healthy(study),
            faults,
            study.system,
            rule,
            settings.causes,
            settings.model_error,
        )
    except InputError as error:
        raise InputError(f"{settings.where}: {error}") from None


def design_of(
    study: Study, fault: str, *, false_alarm: float = FALSE_ALARM_LEVEL, miss: float = MISS_PROBABILITY
) -> Design:
    """Return the design of a test for one of the faults that the ``[diagnosis]`` of a study names.

    Raises
    ------
    InputError
        If the study has no such fault, or models and healthy result do not fit together.
    """
    settings = study.fault_search
    if fault not in settings.faults:
        raise InputError(f"{settings.where} has no fault {fault!r}, only {', '.join(settings.faults)}")
    model = settings.faults[fault].fault(study.system, study.model)
    return Design(
        {fault: model},
        _healthy(study),
        study.system,
        settings.causes,
        false_alarm=false_alarm,
        miss=miss,
        model_error=settings.model_error,
    )


def shown_by(study: Study) -> Callable[[Result], StoredBaseline] | None:
    """Return what says what a healthy study's tables show of faults, by its result; None of a study of another kind.

    Raises
    ------
    InputError
        If models, faults and noise do not go together.
    """
    settings = study.diagnosis
    if settings is None or settings.source is not None:
        return None
    for name, parameter in study.parameters.items():
        if parameter.per_experiment:
            raise InputError(f"{settings.where}: {name} is one per experiment, which does not go with a diagnosis")
    faults = settings.fault_models(study.system, study.model, study.data)
    variance = study.noise.given_variance()

    def shown(result: Result) -> StoredBaseline:
        healthy = Baseline(
            result, settings.inflate, noise_variance=variance, values=study.model.values, records=study.tables
        )
        return compute_stored_baseline(healthy, faults, study.system, settings.causes)

    return shown


def records_of(
    study: Study, paths: Sequence[Path], known: Sequence[str] = ()
) -> Iterator[tuple[Experiment, pd.DataFrame]]:
    """Read records one after the other, each with its table as it was before it was prepared.

    They are read with the words of the study's first experiment.

    Parameters
    ----------
    study : Study
    paths : sequence of Path
        Tables, and folders whose tables are taken in the order of their names.
    known : sequence of str
        Names of records that are left out.

    Raises
    ------
    InputError
        If a table cannot be read or has other columns than the study says, or a folder has none.
    """
    given = study.experiments[0]
    for path in record_files(paths):
        if path.stem in known:
            continue
        try:
            raw = given.read_frame(path)
            record = given.model_copy(update={"name": path.stem}).experiment(raw, str(path))
        except InputError as error:
            raise InputError(f"{error} (inputs and outputs are those of {study.path})") from None
        yield record, raw


def _healthy(study: Study) -> Baseline:
    """Return the healthy machine of a study, with its records."""
    read = study.experiments[0].read_experiment
    return study.fault_search.baseline(study.model, study.parameters, study.noise, read)


# --- runs


def diagnosed(study: Study, folder: Path | None = None, *, progress: Progress | None = None) -> Iterator[DiagnosisRun]:
    """Look for the faults that the ``[diagnosis]`` of a study names: yield what is found, once.

    Parameters
    ----------
    study : Study
    folder : Path, optional
        Where ``diagnosis.json`` and ``diagnosis.csv`` go, made where needed.
    progress : callable, optional
        Called before each fit.

    Raises
    ------
    InputError
        As `Study.diagnose`, or if nothing can be written; what was found is yielded first.
    SimulationError
        If the simulation fails at the healthy estimate.
    """
    if folder is not None:
        files.make_folder(folder)
    diagnosis = study.diagnose(progress)
    found = DiagnosisRun(diagnosis, _units(study))
    try:
        if folder is not None:
            found = replace(found, prepared=prepared(study), origin=made_from(study))
            found = replace(found, files=tuple(write_diagnosis(folder, found)))
    except FmuidError:
        yield found
        raise
    yield found


def monitored(
    study: Study,
    tables: Sequence[str | Path],
    folder: Path | None = None,
    *,
    append: bool = False,
    progress: Progress | None = None,
) -> Iterator[MonitoringRun]:
    """Look for the faults that a study names in records, window by window: yield what is found, once.

    Parameters
    ----------
    study : Study
    tables : sequence of path
        Records, and folders of records, in their order.
    folder : Path, optional
        Where ``monitoring.csv`` and ``monitoring.json`` go, made where needed.
    append : bool
        Whether to go on with the run in the folder, whose records are left out.
    progress : callable, optional
        Called before each window.

    Raises
    ------
    InputError
        If study, models and records do not fit together, there is a run to go on with without a folder, or nothing can
        be written there. What was found before a record that is wrong is written.
    """
    if folder is None and append:
        raise InputError("an earlier run is in a folder: say in which one")
    monitor = build_monitor(study, rule_of(study))
    paths, beside, kept = [Path(table) for table in tables], dict[str, Any](), None
    if folder is not None:
        beside = monitor.resume(folder) if append else {}
        files.make_folder(folder)
        kept = MonitoredTables(folder, study.experiments[0], append=append)
    found = None
    try:
        for record, raw in records_of(study, paths, monitor.records):
            monitor.add(record, progress)
            if kept is not None:
                kept.add(record, raw)
    finally:  # what was found before a record that is wrong is kept, and can be appended to
        found = findings_of(monitor)
        if folder is not None and kept is not None and monitor.records:
            examined = (path for path in record_files(paths) if path.stem in monitor.records)
            found = kept.write(found, monitor, made_from(study, examined), beside=beside)
    yield found


def findings_of(monitor: Monitor) -> MonitoringRun:
    """Return what a monitoring has found so far."""
    sizes = {name: tuple(f"{name}.{size}" for size in fault.sizes) for name, fault in monitor.faults.items()}
    return MonitoringRun(
        monitor.table, monitor.alarms, monitor.rule, monitor.undetermined, sizes, tuple(monitor.baseline.common),
        monitor.units, monitor.basis, tuple(monitor.gaps),
    )  # fmt: skip


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
    prepared : list of PreprocessedTable
    """

    def __init__(self, folder: Path, given: ExperimentSettings, *, append: bool) -> None:
        self.folder, self.given, self._new = folder, given, not append
        there = append and files.is_file(folder / MONITORING_FILE)
        earlier = read_monitoring(folder) if there else None
        self.prepared: list[PreprocessedTable] = [] if earlier is None else list(earlier.prepared)
        self._files = {} if earlier is None or earlier.origin is None else dict(earlier.origin.files)

    def add(self, record: Experiment, raw: pd.DataFrame) -> None:
        """Note what was done with a table, or with what is new of one that grows."""
        at = next((k for k, each in enumerate(self.prepared) if each.experiment == record.name), None)
        if not words_of(self.given) or (at is None and len(self.prepared) >= MOST_PREPARED):
            return
        done = prepared_table(self.given.model_copy(update={"name": record.name}), record, raw)
        self._new = self._new or len(done.table) > 0
        if at is None:
            self.prepared.append(done)
            return
        before = self.prepared[at].table
        new = done.table[done.table["time"] > before["time"].max()] if len(before) and len(done.table) else done.table
        if len(new):
            whole = thinned_again(pd.concat([before, new], ignore_index=True))
            self.prepared[at] = replace(self.prepared[at], table=whole)

    def write(
        self,
        found: MonitoringRun,
        monitor: Monitor,
        origin: Provenance,
        lines: Sequence[str] = (),
        beside: Mapping[str, Any] | None = None,
    ) -> MonitoringRun:
        """Write what was found, and the columns before and after where there are new ones; return it with its files."""
        origin = replace(origin, files=self._files | dict(origin.files))
        found = replace(found, prepared=tuple(self.prepared), origin=origin)
        written = [self.folder / MONITORED_FILE] if any(len(each.table) for each in self.prepared) else []
        if self._new:
            self._new = False
            written = write_prepared(self.folder / MONITORED_FILE, (each.table for each in self.prepared))
        content = {"schema": MONITORING_SCHEMA, **codec.as_json(found)}
        return replace(found, files=(*written, *monitor.write(self.folder, content, lines, beside)))


def _units(study: Study) -> dict[str, str | None]:
    """Return the unit of each output of the study's tables."""
    return {name: each.units.get(name, study.system.unit(name)) for each in study.tables for name in each.output_names}
