"""Where a result comes from: the study as it was run, and the digests of the files that it was made from."""

from __future__ import annotations

import hashlib
import math
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid import codec
from fmuid.runs.findings import Provenance, StudySource
from fmuid.version import __version__

if TYPE_CHECKING:
    from fmuid.studies import Study

# Of more files, as those of a batch, the first are named.
MOST_FILES = 40
# JSON has no infinite numbers, and a study may: they are an object with this key.
NUMBER = "number:"
PROVENANCE_SCHEMA = "fmuid/provenance/2"


def made_from(study: Study, also: Iterable[Path] = (), folder: Path | None = None) -> Provenance:
    """Return where what a study finds now comes from.

    Parameters
    ----------
    study : Study
    also : iterable of Path
        Files besides those that the study names: records, results.
    folder : Path, optional
        Where a result goes that keeps the study's content, to be used without it.
    """
    content = study.path.read_bytes() if study.path.is_file() else b""  # none of one that was put together in Python
    text = content.decode("utf-8", errors="replace")
    whole = None if folder is None else mapped(study.data, _as_json)
    file = study.path.name if folder is None else _way(study.path, folder)
    source = StudySource(file, hashlib.sha256(content).hexdigest(), text, _parsed(text) != study.data, whole)
    return made_now(study.title, source, digests([*study.files(), *also], study.path.parent))


def made_now(title: str = "", study: StudySource | None = None, files: Mapping[str, str] | None = None) -> Provenance:
    """Return a provenance of this version and moment."""
    return Provenance(__version__, datetime.now(UTC).isoformat(timespec="seconds"), title, study, files or {})


def write_origin(path: Path, study: Study, also: Iterable[Path] = ()) -> Path:
    """Write where a table beside it comes from, which has no other JSON file, and return the path.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    return codec.write(path, PROVENANCE_SCHEMA, made_from(study, also))


def digests(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return SHA-256 of files by their paths from a folder; of the first `MOST_FILES` that are there."""
    there = [path for path in dict.fromkeys(files) if path.is_file()]
    return {_from(path, folder): _digest(path) for path in there[:MOST_FILES]}


def _from(path: Path, folder: Path) -> str:
    """Return the end of the way from a folder to a file: pages are mailed, and say nothing of whose machine it was."""
    try:
        way = Path(os.path.relpath(path.resolve(), folder.resolve()))
    except ValueError:  # on another drive
        way = path
    return "/".join([part for part in way.parts if part != ".."][-3:])


def _way(file: Path, folder: Path) -> str:
    """Return the path of a study from a folder of results."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return file.resolve().as_posix()


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return nested tables and lists with each of their values changed."""
    if isinstance(value, Mapping):
        changed = change(value)
        return changed if changed is not value else {str(key): mapped(each, change) for key, each in value.items()}
    if isinstance(value, list):
        return [mapped(each, change) for each in value]
    return change(value)


def _as_json(value: Any) -> Any:
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite else {NUMBER: str(value)}


def of_json(value: Any) -> Any:
    """Return a value of a study's content, which may be a number that JSON does not have."""
    return float(value[NUMBER]) if isinstance(value, Mapping) and set(value) == {NUMBER} else value


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parsed(text: str) -> Any:
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError:
        return None
