"""Runs of studies, as the commands have them, without a report unless it is asked for."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, TypeVar

from fmuid import Document, Study
from fmuid.reports import published
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

Given = Study | str | Path
Found = TypeVar("Found", IdentificationRun, DiagnosisRun, MonitoringRun)


def run_study(study: Given, folder: str | Path | None = None, **words: Any) -> IdentificationRun:
    """Identify; return the last findings."""
    return _last(identified, _read(study), folder=folder, **words)


def run_diagnosis(study: Given, folder: str | Path | None = None, **words: Any) -> DiagnosisRun:
    """Diagnose; return the findings."""
    return _last(diagnosed, _read(study), folder=folder, **words)


def run_monitoring(
    study: Given, tables: Sequence[str | Path], folder: str | Path | None = None, **words: Any
) -> MonitoringRun:
    """Monitor; return the findings."""
    return _last(monitored, _read(study), tables, folder=folder, **words)


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


def _read(study: Given) -> Study:
    return study if isinstance(study, Study) else Study.read(study)


def _last(
    command: Callable[..., Iterable[Found]],
    *given: Any,
    folder: str | Path | None,
    report: bool = False,
    figures: str | None = None,
    **words: Any,
) -> Found:
    """Run a command, publish all findings into a folder, and return the last."""
    place, last = None if folder is None else Path(folder), None
    for found in command(*given, place, **words):
        shown = place and published(found, Document.of(found), place, report=report, figures=figures)
        last = shown or found
    assert last is not None
    return last
