"""Provenance of findings, and the study of a result."""

from __future__ import annotations

import hashlib
import math
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid import codec
from fmuid.errors import InputError
from fmuid.estimation import RESULT_SCHEMA
from fmuid.files import is_file, is_folder, relative
from fmuid.models import file_digest
from fmuid.runs.findings import Provenance, StudySource
from fmuid.runs.folder import MONITORING_SCHEMA, RESULT_FILE
from fmuid.version import __version__

if TYPE_CHECKING:
    from fmuid.studies import Study

# Key of an object that stands for an infinite number, which JSON lacks.
NUMBER = "number:"
PROVENANCE_SCHEMA = "fmuid/provenance/2"
_GIVE_STUDY = "name the study file with --study"


def made_from(study: Study, also: Iterable[Path] = (), folder: Path | None = None) -> Provenance:
    """Return the provenance of findings, with the study for a `folder`."""
    content = study.path.read_bytes() if study.path.is_file() else b""  # none of a study made in Python
    text = content.decode("utf-8", errors="replace")
    try:
        changed = tomllib.loads(text.removeprefix("\ufeff")) != study.data
    except tomllib.TOMLDecodeError:
        changed = True
    whole = None if folder is None else mapped(study.data, _as_json)
    file = study.path.name if folder is None else relative(study.path, folder)
    source = StudySource(file, hashlib.sha256(content).hexdigest(), text, changed, whole)
    return made_now(study.title, source, digests([*study.files(), *also], study.path.parent))


def made_now(title: str = "", study: StudySource | None = None, files: Mapping[str, str] | None = None) -> Provenance:
    """Return a provenance of this version and moment."""
    return Provenance(__version__, datetime.now(UTC).isoformat(timespec="seconds"), title, study, files or {})


def write_origin(path: Path, study: Study, also: Iterable[Path] = ()) -> Path:
    """Write the provenance of a table without another JSON file; return the path."""
    return codec.write(path, PROVENANCE_SCHEMA, made_from(study, also))


def digests(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return SHA-256 of existing files by the ends of their paths; whole ones could disclose their owner."""
    there = [path for path in dict.fromkeys(files) if path.is_file()][:40]
    ends = ([part for part in Path(relative(path, folder)).parts if part != ".."][-3:] for path in there)
    return {"/".join(end): file_digest(path) for end, path in zip(ends, there, strict=True)}


def mapped(value: Any, change: Callable[[Any, str], Any], key: str = "") -> Any:
    """Return nested tables and lists of a study with values changed; `change` takes a value and its key."""
    changed = change(value, key)
    if isinstance(changed, Mapping) and changed is value:
        # [batch.data] has files by the names of their records
        return {str(name): mapped(each, change, key if key == "data" else str(name)) for name, each in value.items()}
    return [mapped(each, change, key) for each in value] if isinstance(changed, list) else changed


def _as_json(value: Any, _: str) -> Any:
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite else {NUMBER: str(value)}


def _of_json(value: Any, _: str) -> Any:
    return float(value[NUMBER]) if isinstance(value, Mapping) and set(value) == {NUMBER} else value


def with_earlier(origin: Provenance, path: Path) -> Provenance:
    """Return a provenance with the files of an earlier monitoring, if any."""
    if not is_file(path):
        return origin
    there = codec.read_part(path, MONITORING_SCHEMA, "origin", Provenance, "run fmuid monitor again")
    return origin if there is None else replace(origin, files={**there.files, **origin.files})


def study_of(
    result: Path, overrides: Sequence[str] = (), *, isolated: bool = False, in_place: Path | None = None
) -> Study:
    """Return the study of a result; `in_place` replaces missing tables."""
    from fmuid.studies import Study, override

    path = result_path(result)
    origin = codec.read_part(path, RESULT_SCHEMA, "origin", Provenance, _GIVE_STUDY)
    if origin is None or origin.study is None or origin.study.content is None:
        raise InputError(f"{path}: no study recorded; {_GIVE_STUDY}")
    data = mapped(dict(origin.study.content), _of_json)
    file = Path(os.path.normpath(path.parent / origin.study.file))
    for setting in overrides:
        override(data, setting, str(file))
    if in_place is not None:
        given = data.get("experiments")
        for experiment in given if isinstance(given, list) else ():  # `Study.of` refuses another type
            if isinstance(experiment, dict) and not is_file(file.parent / str(experiment.get("data", ""))):
                experiment["data"] = str(in_place.resolve())
    return Study.of(data, file, isolated=isolated)


def result_path(given: Path) -> Path:
    """Return the ``result.json`` of a path or folder."""
    path = given / RESULT_FILE if is_folder(given) else given
    if not is_file(path):
        raise InputError(f"{path}: no such result. Give a result.json or its folder.")
    return path
