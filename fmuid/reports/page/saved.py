"""JSON files that commands have left, with the types that pages and reports read checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from fmuid.errors import InputError
from fmuid.estimation import ResultContent, check_types
from fmuid.files import ContentError

Number = float | None
"""None stands for a number that is not finite."""


class StudyContent(TypedDict, total=False):
    """The study that a result is of."""

    file: str
    digest: str
    text: str


class OriginContent(TypedDict, total=False):
    """Where a result comes from."""

    version: str
    date: str
    title: str
    study: StudyContent | str | None
    files: dict[str, str | None] | None


class ExperimentContent(TypedDict, total=False):
    """One experiment of a result."""

    name: str
    outputs: dict[str, str | None]
    counted_from: Number
    columns: dict[str, str | None]
    dropouts: list[float]


class FindingContent(TypedDict, total=False):
    """One finding on the residuals."""

    large: bool


class DiagnosticsContent(TypedDict, total=False):
    """What the residuals show."""

    words: list[str]
    findings: list[FindingContent]


class AgreementContent(TypedDict, total=False):
    """The test of prior against data."""

    probability: float


class VarianceContent(TypedDict, total=False):
    """A stated noise variance beside that of the residual."""

    deviation: str | None


class ConsistencyContent(TypedDict, total=False):
    """Prior and data."""

    words: list[str]
    prior_against_data: AgreementContent | None
    variances: list[VarianceContent]


class UncertaintyContent(TypedDict, total=False):
    """The uncertainty beyond the local covariance."""

    words: list[str]
    succeeded: bool


class ProfileContent(TypedDict, total=False):
    """The profile of a parameter."""

    level: float
    lower: Number
    upper: Number
    threshold: Number


class IdentificationContent(ResultContent, OriginContent, total=False):
    """A ``result.json``."""

    words: list[str]
    level: float
    experiments: list[ExperimentContent]
    diagnostics: DiagnosticsContent | None
    consistency: ConsistencyContent | None
    uncertainty: UncertaintyContent | None
    profiles: dict[str, ProfileContent] | None


class OtherContent(OriginContent, total=False):
    """What the files of all other commands may have."""

    experiments: list[ExperimentContent]
    units: dict[str, str | None] | None


class BatchContent(TypedDict, total=False):
    """A ``batch.json``, whose study is the content of the study file."""

    fmuid: str
    study: dict[str, Any]
    files: dict[str, str | None]
    cases: int
    truth: dict[str, float] | None
    dashboard: str | None


class SummaryContent(TypedDict, total=False):
    """A ``summary.json``."""

    words: list[str]
    statuses: dict[str, int]
    truth: dict[str, float]
    units: dict[str, str | None]


_SCHEMAS = {"result.json": IdentificationContent, "batch.json": BatchContent, "summary.json": SummaryContent}


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file that a command has written.

    Parameters
    ----------
    path : Path
        Its name says what it has.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If it cannot be read, is not an object, or a value in it is of another type than fmuid writes.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} is not what fmuid writes: it is no JSON object")
    try:
        check_types(content, _SCHEMAS.get(path.name, OtherContent))
    except ContentError as error:
        raise InputError(f"{path}: {error}. Run the command again that has written it.") from None
    return content
