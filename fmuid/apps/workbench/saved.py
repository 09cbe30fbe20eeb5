"""JSON files that commands have left, as mappings: for who lists what a folder has."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmuid.codec import from_json
from fmuid.errors import InputError
from fmuid.files import ContentError
from fmuid.runs import IdentificationRun


@dataclass(frozen=True)
class BatchManifest:
    """A ``batch.json``, whose study is the content of the study file."""

    fmuid: str = ""
    study: Mapping[str, Any] | None = None
    files: Mapping[str, str | None] | None = None
    cases: int = 0
    truth: Mapping[str, float] | None = None
    dashboard: str | None = None


_KINDS: dict[str, type] = {"result.json": IdentificationRun, "batch.json": BatchManifest}


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file that a command has written.

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
        if path.name in _KINDS:
            from_json(_KINDS[path.name], content)
    except ContentError as error:
        raise InputError(f"{path}: {error}. Run the command again that has written it.") from None
    return content


def study_of_content(content: Mapping[str, Any]) -> Any:
    """Return what a file says of its study: the study itself of a batch, else where it is; None where nothing."""
    origin = content.get("origin")
    return origin.get("study") if isinstance(origin, dict) else content.get("study")
