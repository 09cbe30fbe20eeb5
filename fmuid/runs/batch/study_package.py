"""A study with its files by content, to be run elsewhere."""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmuid.errors import InputError
from fmuid.models import file_digest
from fmuid.runs.provenance import mapped
from fmuid.studies import Study
from fmuid.version import __version__

# Keys of a study file that name a file.
FILE_KEYS = ("fmu", "data", "result")
# Keys of a study that no row of a batch depends on.
NOT_IN_ROWS = ("title", "uncertainty", "diagnosis")
_MISSING = object()


@dataclass(eq=False)
class StudyPackage:
    """A study as it travels to workers, with all files but records."""

    token: str
    path: str  # the user's study file
    data: dict[str, Any]  # the study with the names of `files`
    files: dict[str, bytes]
    originals: dict[str, str]  # the user's names of files and records
    isolated: bool
    versions: dict[str, str | None]  # of the sender
    opened: dict[int, Any] = field(default_factory=dict)  # by thread of a worker; does not travel

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"opened": {}}

    def __sizeof__(self) -> int:  # what a scheduler weighs the way of an object by
        return sum(map(len, self.files.values()))

    def unpack(self, folder: Path) -> Study:
        """Write the files below a folder; return the study there, without records."""
        put(folder, self.files)
        data = _renamed(self.data, lambda name: str(folder / name) if name in self.originals else name)
        return Study.of(data, self.path, isolated=self.isolated)


def put(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


class BatchStudy:
    """A study of a batch, with the digests of its files."""

    def __init__(self, study: Study, *, isolated: bool, versions: Mapping[str, str | None]) -> None:
        self.study, self._base = study, study.path.parent
        found = study.batch.records() if study.batch is not None else {}
        self._records = {path: f"records/{k:06d}/{path.name}" for k, path in enumerate(found.values())}
        self._names: dict[Path, str] = {}
        self._known = set(study.files())
        data = _renamed({key: value for key, value in study.data.items() if key not in NOT_IN_ROWS}, self._name_of)
        if found:
            data["batch"]["data"] = {name: self._records[path] for name, path in found.items()}
        self.digests = {path: _digest(path) for path in (*self._names, *self._records)}
        files = {name: content for path, name in self._names.items() if (content := self._content(path)) is not None}
        originals = {name: str(path) for path, name in (*self._names.items(), *self._records.items())}
        token = uuid.uuid4().hex
        self.parcel = StudyPackage(token, str(study.path), data, files, originals, isolated, dict(versions))

    def record(self, path: Path | None) -> dict[str, bytes]:
        """Return name and unchanged content of a record, nothing if absent."""
        content = self._content(path) if path is not None and path in self._records else None
        return {} if path is None or content is None else {self._records[path]: content}

    def manifest(self) -> dict[str, Any]:
        """Return all that the rows of the batch depend on, as JSON."""
        told = {key: value for key, value in self.study.data.items() if key not in NOT_IN_ROWS}
        files = {_relative(path, self._base): digest for path, digest in self.digests.items()}
        return {"fmuid": __version__, "study": told, "files": files}

    def _name_of(self, name: str) -> str:
        """Return the parcel's name of a file of the study."""
        path = self._base / name
        if path not in self._known:
            return name
        return self._names.setdefault(path, f"files/{len(self._names):03d}/{path.name}")

    def _content(self, path: Path) -> bytes | None:
        try:
            content = path.read_bytes()
        except OSError:
            content = None
        if (hashlib.sha256(content).hexdigest() if content is not None else None) != self.digests[path]:
            remedy = "Restore it, or start again with --no-resume."
            raise InputError(f"{path}: changed while the batch ran. {remedy}")
        return content


def changes(earlier: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the differences between the manifests of two batches as texts."""
    found = []
    if earlier.get("fmuid") != now["fmuid"]:
        found.append(f"made by fmuid {earlier.get('fmuid')}, this is {now['fmuid']}")
    old, new = dict(_leaves(earlier.get("study"))), dict(_leaves(json.loads(json.dumps(now["study"]))))
    for key in dict.fromkeys([*new, *old]):
        was, is_ = old.get(key, _MISSING), new.get(key, _MISSING)
        if was != is_:
            found.append(
                f"{key} was not given" if was is _MISSING else f"{key} was {json.dumps(was, ensure_ascii=False)}"
            )
    written = earlier.get("files")
    files: Mapping[str, str | None] = written if isinstance(written, dict) else {}
    for name in dict.fromkeys([*now["files"], *files]):
        if name not in files:
            found.append(f"{name} is new")
        elif name not in now["files"]:
            found.append(f"{name} was removed")
        elif files[name] != now["files"][name]:
            found.append(f"{name} has changed")
    return found if len(found) <= 4 else [*found[:4], f"{len(found) - 4} more differences"]


def _renamed(study: Mapping[str, Any], rename: Callable[[str], str]) -> dict[str, Any]:
    def change(value: Any, key: str) -> Any:
        return rename(value) if isinstance(value, str) and key in FILE_KEYS else value

    found: dict[str, Any] = mapped(study, change)
    return found


def _leaves(node: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by their dotted names."""
    if isinstance(node, Mapping) and node:
        for key, value in node.items():
            yield from _leaves(value, f"{above}.{key}" if above else str(key))
    elif isinstance(node, list) and any(isinstance(item, Mapping) for item in node):
        for k, value in enumerate(node):
            yield from _leaves(value, f"{above}.{k}")
    else:
        yield above, node


def _digest(path: Path) -> str | None:
    try:
        return file_digest(path)
    except OSError:  # gone: it differs from any that is there
        return None


def _relative(path: Path, base: Path) -> str:
    try:
        return Path(os.path.relpath(path, base)).as_posix()
    except ValueError:  # on another drive
        return path.as_posix()
