"""Monitoring and the design of a test as a study describes them: its faults, healthy machine and words for tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pandas as pd

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
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.studies import Study


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
