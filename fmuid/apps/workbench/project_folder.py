"""Studies, results and batches of a folder; the workbench stores nothing else."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from fmuid.codec import from_json, object_of
from fmuid.errors import InputError
from fmuid.files import ContentError, full, is_file, is_folder, relative
from fmuid.runs import IdentificationRun
from fmuid.studies import read_toml

RESULTS = {
    "result.json": "identification",
    "diagnosis.json": "diagnosis",
    "monitoring.json": "monitoring",
    "prediction.json": "prediction",
    "batch.json": "batch",
}
"""Kinds of results by their files."""
MAX_DEPTH, MAX_ENTRIES = 6, 20_000  # depth and entries of the folder that are examined; a home directory has more


@dataclass(frozen=True)
class BatchManifest:
    """Content of ``batch.json``; `study` is the content of the study file."""

    fmuid: str = ""
    study: Mapping[str, Any] | None = None
    files: Mapping[str, str | None] | None = None
    cases: int = 0
    truth: Mapping[str, float] | None = None
    dashboard: str | None = None


_KINDS: dict[str, type] = {"result.json": IdentificationRun, "batch.json": BatchManifest}


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file of a command, checked."""
    content = object_of(path, "run its command again")
    try:
        if path.name in _KINDS:
            from_json(_KINDS[path.name], content)
    except ContentError as error:
        raise InputError(f"{path}: {error}. Run its command again.") from None
    return content


@dataclass(frozen=True)
class FoundStudy:
    """Study file, with its sections beyond identification; `error` tells why it cannot be read."""

    path: Path
    title: str
    error: str = ""
    tables: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()

    @property
    def results(self) -> Path:
        """Output folder of its commands."""
        return self.path.parent / "results"

    def has_run(self, result: FoundResult) -> bool:
        """Whether a result is of this study; a batch stores its study."""
        if result.kind != "batch":
            return result.study == self.path.resolve()
        if "batch" not in self.asks:
            return False
        from fmuid.runs import NOT_IN_ROWS

        asked = {key: value for key, value in read_toml(self.path).items() if key not in NOT_IN_ROWS}
        return bool(result.content.get("study") == asked)


@dataclass(frozen=True)
class FoundResult:
    """Result of a command, from a file of `RESULTS`; `error` tells why it cannot be read."""

    path: Path
    kind: str
    study: Path | None
    content: Mapping[str, Any]
    error: str = ""

    @classmethod
    def of(cls, path: Path) -> FoundResult:
        """Return the result of a file of `RESULTS`."""
        try:
            content, error = read_json(path), ""
        except InputError as wrong:
            content, error = {}, str(wrong)
        origin = content.get("origin")
        given = origin.get("study") if isinstance(origin, dict) else content.get("study")
        file = given.get("file") if isinstance(given, dict) else given
        # files of a diagnosis have only the study's name: they may be moved
        near = [each / file for each in path.parents[:MAX_DEPTH]] if isinstance(file, str) and file else []
        study = next((each.resolve() for each in near if is_file(each)), None)
        return cls(path, RESULTS[path.name], study, content, error)

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        return self.path.parent


class Folder:
    """The opened folder; nothing outside of it is read."""

    def __init__(self, root: Path) -> None:
        if not is_folder(root):
            raise InputError(f"{root}: folder not found. Give a study file, or a folder with studies.")
        self.root = root.resolve()

    def path(self, name: str) -> Path:
        """Return the path of a name relative to this folder; refuse what is missing or outside, also by a link."""
        try:
            found = (self.root / name).resolve(strict=True)
        except (OSError, ValueError, RuntimeError):
            raise InputError(f"{name[:200]!r} is not in {full(self.root)}") from None
        if not found.is_relative_to(self.root):
            raise InputError(f"{name[:200]!r} is not in {full(self.root)}")
        return found

    def name(self, path: Path) -> str:
        """Return the name of a path relative to this folder."""
        return relative(path, self.root)

    def has(self, path: Path) -> bool:
        """Whether a path lies in this folder."""
        return path.resolve().is_relative_to(self.root)

    def look(self) -> tuple[list[FoundStudy], list[FoundResult]]:
        """Return studies and results, sorted by name."""
        studies, results = [], []
        for path in self.files((".toml", ".json")):
            if path.suffix == ".toml":
                found = read_study(path)
                studies += [found] if found is not None else []
            elif path.name in RESULTS:
                results += [FoundResult.of(path)]
        return studies, results

    def files(self, kinds: tuple[str, ...]) -> Iterator[Path]:
        """Yield the files with these name endings, sorted by name."""
        seen, depth = 0, len(self.root.parts)
        for place, folders, files in os.walk(self.root):
            here = Path(place)
            deep = len(here.parts) - depth >= MAX_DEPTH
            folders[:] = sorted(f for f in folders if not deep and not f.startswith(".") and f not in _NOT_OURS)
            seen += len(files) + len(folders)
            if seen > MAX_ENTRIES:
                return
            yield from (here / name for name in sorted(files) if name.lower().endswith(kinds))


TABLES = (".csv", ".parquet", ".mat", ".xlsx", ".ods", ".h5", ".tdms", ".mf4")
"""Endings of data files that can be chosen."""


def tables(folder: Folder) -> list[Path]:
    """Return the data files of the folder, without results."""
    return [path for path in choices(folder, TABLES) if not any((path.parent / mark).exists() for mark in _MARKS)]


def choices(folder: Folder, kinds: tuple[str, ...]) -> list[Path]:
    """Return the files with these endings, at most 200."""
    return list(islice((path for path in folder.files(kinds) if folder.has(path)), 200))


_MARKS = (*RESULTS, "simulated.csv", "design.csv", "report.html")
_NOT_OURS = ("cases", "logs", "figures", "node_modules", "__pycache__")


def read_study(path: Path) -> FoundStudy | None:
    """Return the study of a TOML file, None if it is none."""
    try:
        if path.stat().st_size > 2**20:  # no study is as large
            return None
        data = read_toml(path)
    except (OSError, InputError) as error:
        return FoundStudy(path, path.name, str(error))
    if not isinstance(data.get("model"), dict) or not isinstance(data.get("experiments"), list):
        return None
    given, names = data["experiments"], data.get("parameters")
    tables = tuple(str(each.get("data", "")) for each in given if isinstance(each, dict))
    asks = tuple(word for word in ("diagnosis", "batch") if isinstance(data.get(word), dict))
    title = str(data.get("title") or path.stem)
    return FoundStudy(path, title, "", tables, tuple(names) if isinstance(names, dict) else (), asks)
