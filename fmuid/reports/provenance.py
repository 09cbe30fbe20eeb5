"""Where a result comes from: the study as it was run, and the digests of the files that it was made from."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid.files import write_json
from fmuid.version import __version__

if TYPE_CHECKING:
    from fmuid.studies import Study

# Of more files, as those of a batch, the first are named.
MOST_FILES = 40


def made_from(study: Study, also: Iterable[Path] = ()) -> dict[str, Any]:
    """Return where what a study finds now comes from, as a JSON file of results says it.

    Parameters
    ----------
    study : Study
    also : iterable of Path
        Files besides those that the study names: records, results.

    Returns
    -------
    dict
        As `made_now`; ``title`` of the study; ``study``, with ``file`` (its name), ``digest``, ``text``, and
        ``changed``, whether values of it were replaced, as by ``--set``; ``files``, SHA-256 of each model, table and
        result by its path from the study. Of files that are gone by now nothing is said.
    """
    content = study.path.read_bytes() if study.path.is_file() else b""  # none of one that was put together in Python
    text = content.decode("utf-8", errors="replace")
    changed = _parsed(text) != study.data
    told = {"file": study.path.name, "digest": hashlib.sha256(content).hexdigest(), "text": text, "changed": changed}
    files = digests([*study.files(), *also], study.path.parent)
    return {"title": study.title, **made_now(), "study": told, "files": files}


def write_origin(path: Path, study: Study, also: Iterable[Path] = ()) -> Path:
    """Write where a table beside it comes from, which has no other JSON file, and return the path.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    return write_json(path, made_from(study, also))


def made_now() -> dict[str, str]:
    """Return by which version and when something is made, ISO 8601 in UTC."""
    return {"version": __version__, "date": datetime.now(UTC).isoformat(timespec="seconds")}


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


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parsed(text: str) -> Any:
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError:
        return None
