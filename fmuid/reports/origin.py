"""Where a result comes from: the study as it was run, and the digests of the files that it names."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmuid.version import __version__

if TYPE_CHECKING:
    from fmuid.studies import Study


@dataclass(frozen=True)
class Origin:
    """Where a result comes from.

    Attributes
    ----------
    title : str
        Of the study.
    study : dict
        What ``result.json`` has of the file besides its name and content (`fmuid.studies.origin_of`): ``digest``,
        SHA-256; ``text``; and ``changed``, whether values of it were replaced, as by ``--set``.
    tables : dict of str to str
        SHA-256 of each file of measurements, by its name.
    date : str
        When the study was run, ISO 8601 in UTC.
    """

    title: str
    study: dict[str, Any]
    tables: dict[str, str]
    date: str

    @classmethod
    def of(cls, study: Study) -> Origin:
        """Return where what a study finds now comes from; of files that are gone by now nothing is said."""
        content = _content(study.path)
        text = content.decode("utf-8", errors="replace")
        told = {
            "digest": hashlib.sha256(content).hexdigest(),
            "text": text,
            "changed": _parsed(text) != study.data,
        }
        tables = {path.name: path for path in (each.table for each in study.experiments)}
        digests = {name: _digest(path) for name, path in tables.items() if path.is_file()}
        return cls(study.title, told, digests, made_now()["date"])

    def to_json_dict(self) -> dict[str, Any]:
        """Return what a JSON file of results has besides the study."""
        return {"title": self.title, "date": self.date, "tables": self.tables}

    def with_study(self, study: Study) -> dict[str, Any]:
        """Return the same, and the study by the name of its file."""
        return self.to_json_dict() | {"study": {"file": study.path.name, **self.study}}


def made_now() -> dict[str, str]:
    """Return by which version and when something is made, ISO 8601 in UTC."""
    return {"version": __version__, "date": datetime.now(UTC).isoformat(timespec="seconds")}


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # a study that was put together in Python
        return b""


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parsed(text: str) -> Any:
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError:
        return None
