"""Runs of studies, as the commands have them, without a report unless it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, TypeVar

from fmuid.events import Progress
from fmuid.reports import Document, published
from fmuid.reports.topics.monitoring import alarm_sentence
from fmuid.runs import (
    DiagnosisRun,
    FollowStatus,
    IdentificationRun,
    MonitoringRun,
    PredictionRun,
    diagnosed,
    findings_of,
    followed,
    identified,
    monitored,
    predicted_by,
    read_monitoring,
)
from fmuid.studies import Study

Given = Study | str | Path
Found = TypeVar("Found", IdentificationRun, DiagnosisRun, MonitoringRun)


def run_study(
    study: Given,
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
) -> IdentificationRun:
    """Identify; return the last findings."""
    place, found = _place(folder), None
    for each in identified(_read(study), place, resume=resume, progress=progress):
        found = _reported(each, place, report=report, figures=figures)
    assert found is not None
    return found


def run_diagnosis(
    study: Given,
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    report: bool = False,
    progress: Progress | None = None,
) -> DiagnosisRun:
    """Diagnose; return the findings."""
    place = _place(folder)
    (found,) = diagnosed(_read(study), place, progress=progress)
    return _reported(found, place, report=report, figures=figures)


def run_monitoring(
    study: Given,
    tables: Sequence[str | Path],
    folder: str | Path | None = None,
    *,
    figures: str | None = None,
    append: bool = False,
) -> MonitoringRun:
    """Monitor; return the findings."""
    place = _place(folder)
    (found,) = monitored(_read(study), tables, place, append=append)
    return _reported(found, place, report=False, figures=figures)


def run_following(
    study: Given,
    place: str | Path,
    folder: str | Path,
    *,
    until: Callable[[FollowStatus], bool],
    show: Callable[[FollowStatus], Any] = lambda _: None,
) -> MonitoringRun:
    """Monitor what a logger writes until there is enough; return the findings."""
    watching = None
    with (
        suppress(KeyboardInterrupt),
        closing(followed(_read(study), Path(place), Path(folder), alarm_sentence)) as looks,
    ):
        for watching in looks:
            show(watching)
            if watching.idle and until(watching):
                break
    return read_monitoring(Path(folder)) if watching is None else findings_of(watching.monitor)


def run_prediction(result: str | Path, tables: Sequence[str | Path] = (), **words: Any) -> PredictionRun:
    """Predict; return the findings."""
    return predicted_by(result, tables, **words)


def _place(folder: str | Path | None) -> Path | None:
    return None if folder is None else Path(folder)


def _read(study: Given) -> Study:
    return study if isinstance(study, Study) else Study.read(study)


def _reported(found: Found, place: Path | None, *, report: bool, figures: str | None) -> Found:
    return found if place is None else published(found, Document.of(found), place, report=report, figures=figures)
