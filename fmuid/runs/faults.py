"""Diagnosis, monitoring and the design of a test by a study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import codec, files
from fmuid.array_types import Floats
from fmuid.data import Experiment, Parameter, record_files
from fmuid.diagnosis import (
    Baseline,
    Design,
    DiagnosisSettings,
    Monitor,
    Rule,
    StoredBaseline,
    compute_stored_baseline,
    extend_stored_baseline,
)
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Result
from fmuid.events import Progress
from fmuid.identification import SensitivityFunctions, expected_accuracy, rank_excitations, sensitivity_functions
from fmuid.runs.findings import DiagnosisRun, MonitoringRun, Provenance
from fmuid.runs.folder import MONITORING_FILE, MONITORING_SCHEMA, write_diagnosis
from fmuid.runs.predict import records_like
from fmuid.runs.preprocessing import prepared
from fmuid.runs.provenance import made_from, with_earlier
from fmuid.simulation import simulator_of
from fmuid.studies import Study


def rule_of(study: Study) -> Rule:
    """Return the rule of a monitoring by ``[monitoring]`` and ``[diagnosis]``."""
    return study.monitoring.rule(study.experiments[0].warmup, study.fault_search.false_alarm_rate)


def build_monitor(study: Study, rule: Rule) -> Monitor:
    """Return the monitor of the faults of a study's ``[diagnosis]``."""
    settings = study.fault_search
    faults = settings.fault_models(study.system, study.model, study.data)
    with settings.place.located():
        return Monitor(_healthy(study), faults, study.system, rule, settings.causes, settings.fault_model_error)


def design_of(study: Study, fault: str) -> Design:
    """Return the design of a test for one fault of a study."""
    settings = study.fault_search
    if fault not in settings.faults:
        raise InputError(f"{settings.place}: unknown fault {fault!r}. Choose {', '.join(settings.faults)}.")
    model = settings.faults[fault].fault(study.system, study.model)
    how = DiagnosisSettings(causes=settings.causes, model_error=settings.fault_model_error)
    return Design({fault: model}, _healthy(study), study.system, how)


def shown_by(study: Study) -> Callable[[Result], StoredBaseline] | None:
    """Return a function of a result for its stored baseline; None without own faults."""
    settings = study.diagnosis
    if settings is None or settings.source is not None:
        return None
    for name, parameter in study.parameters.items():
        if parameter.per_experiment:
            raise InputError(f"{settings.place}: {name} is one per experiment. Diagnose each experiment alone.")
    faults = settings.fault_models(study.system, study.model, study.data)
    variance = study.noise.given_variance()

    def shown(result: Result) -> StoredBaseline:
        healthy = Baseline(
            result, settings.std_factor, noise_variance=variance, values=study.model.values, records=study.tables
        )
        return compute_stored_baseline(healthy, faults, study.system, settings.causes)

    return shown


def extended_baseline(study: Study, tables: Sequence[str | Path]) -> tuple[Path, StoredBaseline]:
    """Make or extend the baseline file of a study by healthy records; return its path and sums."""
    settings = study.fault_search
    faults, known = settings.fault_models(study.system, study.model, study.data), _healthy(study)
    path = settings.baseline_file
    records = list(records_like(study, [Path(table) for table in tables]))
    with settings.place.located():
        made = extend_stored_baseline(known, faults, study.system, settings.causes, records)
    return made.write(path), made


def _healthy(study: Study) -> Baseline:
    read = study.experiments[0].read_experiment
    return study.fault_search.healthy(study.model, study.parameters, study.noise, read)


def diagnosed(study: Study, folder: Path | None = None, *, progress: Progress | None = None) -> Iterator[DiagnosisRun]:
    """Diagnose the faults of a study: yield the findings once."""
    if folder is not None:
        files.make_folder(folder)
    diagnosis, system = study.diagnose(progress), study.system
    units = {name: each.units.get(name, system.unit(name)) for each in study.tables for name in each.output_names}
    found = DiagnosisRun(diagnosis, units)
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
    """Monitor records: yield the findings once; `append` resumes an earlier run."""
    if folder is None and append:
        raise InputError("resume needs the folder of the earlier run. Give it.")
    monitor = build_monitor(study, rule_of(study))
    paths, beside = [Path(table) for table in tables], dict[str, Any]()
    if folder is not None:
        beside = monitor.resume(folder) if append else {}
        files.make_folder(folder)
    try:
        for record in records_like(study, paths, known=monitor.records):
            monitor.add(record, progress)
    finally:  # what was found before a record that is wrong is kept, and can be appended to
        found = findings_of(monitor)
        if folder is not None and monitor.records:
            examined = (path for path in record_files(paths) if path.stem in monitor.records)
            origin = made_from(study, examined)
            origin = with_earlier(origin, folder / MONITORING_FILE) if append else origin
            found = write_monitoring(monitor, folder, origin, beside=beside)
    yield found


def findings_of(monitor: Monitor) -> MonitoringRun:
    """Return the findings of a monitor so far."""
    sizes = {name: tuple(f"{name}.{size}" for size in fault.sizes) for name, fault in monitor.faults.items()}
    return MonitoringRun(
        monitor.table, monitor.alarms, monitor.rule, monitor.undetermined, sizes, tuple(monitor.baseline.common),
        monitor.units, monitor.basis, tuple(monitor.gaps),
    )  # fmt: skip


def write_monitoring(
    monitor: Monitor,
    folder: Path,
    origin: Provenance,
    lines: Sequence[str] = (),
    beside: Mapping[str, Any] | None = None,
) -> MonitoringRun:
    """Write the findings of a monitor so far; return them with their files."""
    found = replace(findings_of(monitor), origin=origin)
    content = {"schema": MONITORING_SCHEMA, **codec.as_json(found)}
    return replace(found, files=tuple(monitor.write(folder, content, lines, beside)))


def ranked_excitations(
    study: Study, tables: Sequence[Path], *, by: str = "determinant", fault: str | None = None
) -> pd.DataFrame:
    """Compare excitations, best first, by expected accuracy or fault size."""
    candidates = {path.stem: _excitation(study, path) for path in record_files(tables)}
    if fault is not None:
        return design_of(study, fault).rank(candidates)
    study.check_parameters()
    parameters, values = _shared(study), study.model.values
    found = [
        expected_accuracy(
            study.system, each, parameters, _variance(study, each), values, study.noise.delay_in(each.name)
        )
        for each in candidates.values()
    ]
    return rank_excitations(found, by=by)


def _variance(study: Study, excitation: Experiment) -> dict[str, float | Floats]:
    """Return the noise variance of each output; in proportion to simulated readings an array (K,)."""
    known = study.known_variance
    levels = {name: study.noise.form(name) for name in excitation.output_names if name not in known}
    for name, (word, level) in levels.items():
        if word != "reading_std" or isinstance(level, str):
            raise InputError(f"{study.path}: noise: no level of {name!r}. Give its variance, std or reading_std.")
    if not levels:
        return {**known}
    start = {key: each.start for key, each in _shared(study).items()}
    outputs = simulator_of(study.system, excitation, tuple(start), study.model.values)(list(start.values()))
    columns = [excitation.columns[each] for each in excitation.output_names]
    simulated = replace(excitation.with_columns(dict(zip(columns, outputs.T, strict=True))), measured=True)
    return known | {name: (level * simulated.readings(name)) ** 2 for name, (_, level) in levels.items()}


def healthy_record_cost(study: Study, tables: Sequence[Path], fault: str, excitation: str) -> pd.DataFrame:
    """Return the cost of healthy records for a test by their length."""
    (path,) = (each for each in record_files(tables) if each.stem == excitation)
    return design_of(study, fault).cost(_excitation(study, path))


def _excitation(study: Study, path: Path) -> Experiment:
    """Read a table of inputs with the settings of the first experiment."""
    words = study.experiments[0].model_copy(update={"name": path.stem})
    return words.read_experiment(path, measured=False)


def sensitivities_of(study: Study) -> tuple[SensitivityFunctions, ...]:
    """Return the normalized sensitivities (1.33) over every experiment, at the parameters' starts."""
    study.check_parameters()
    shared, values = _shared(study), study.model.values
    return tuple(sensitivity_functions(study.system, each, shared, values) for each in study.tables)


def _shared(study: Study) -> dict[str, Parameter]:
    """Return the parameters with one value for all experiments."""
    return {name: replace(each, per_experiment=False) for name, each in study.parameters.items()}
