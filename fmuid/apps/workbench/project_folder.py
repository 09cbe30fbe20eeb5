"""What a folder has: studies, results, batches. Its files are all that the workbench remembers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from fmuid.apps.workbench.saved import read_json, study_of_content
from fmuid.errors import InputError
from fmuid.files import full, is_file, is_folder
from fmuid.studies import read_toml

RESULTS = {
    "result.json": "identification",
    "diagnosis.json": "diagnosis",
    "monitoring.json": "monitoring",
    "prediction.json": "prediction",
    "batch.json": "batch",
}
"""What a command leaves, and which one that is."""
# Deeper folders, and more entries than these, are not looked at: a home directory is no folder of studies.
DEEPEST, MOST_ENTRIES = 6, 20_000
# A larger file is no study.
LARGEST_STUDY = 2**20


@dataclass(frozen=True)
class FoundStudy:
    """A study file.

    Attributes
    ----------
    path : Path
    title : str
    error : str
        Why it cannot be read, or nothing.
    tables, parameters : tuple of str
    asks : tuple of str
        What it has words for besides an identification: ``diagnosis``, ``batch``.
    """

    path: Path
    title: str
    error: str = ""
    tables: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()

    @property
    def results(self) -> Path:
        """The folder that its command writes into."""
        return self.path.parent / "results"

    def has_run(self, result: FoundResult) -> bool:
        """Whether a result is of this study; that of a batch has the study itself, by which it is known."""
        if result.kind != "batch":
            return result.study == self.path.resolve()
        if "batch" not in self.asks:
            return False
        from fmuid.runs import NOT_IN_ROWS

        asked = {key: value for key, value in read_toml(self.path).items() if key not in NOT_IN_ROWS}
        return bool(result.content.get("study") == asked)


@dataclass(frozen=True)
class FoundResult:
    """What a command has left in a folder.

    Attributes
    ----------
    path : Path
        The file that says so.
    kind : str
        Of `RESULTS`.
    study : Path or None
        That it says it is of.
    content : mapping
        What the file says; nothing where it cannot be read.
    error : str
        Why it cannot be read, or nothing.
    """

    path: Path
    kind: str
    study: Path | None
    content: Mapping[str, Any]
    error: str = ""

    @classmethod
    def of(cls, path: Path) -> FoundResult:
        """Return what a file of `RESULTS` is."""
        try:
            content, error = read_json(path), ""
        except InputError as wrong:
            content, error = {}, str(wrong)
        given = study_of_content(content)
        file = given.get("file") if isinstance(given, dict) else given
        # a search for faults says its study's name alone, as its files are to be passed on
        near = [each / file for each in path.parents[:DEEPEST]] if isinstance(file, str) and file else []
        study = next((each.resolve() for each in near if is_file(each)), None)
        return cls(path, RESULTS[path.name], study, content, error)

    @property
    def folder(self) -> Path:
        """Where its files are."""
        return self.path.parent


class Folder:
    """The folder that is open, and nothing outside of it.

    Parameters
    ----------
    root : Path

    Raises
    ------
    InputError
        If there is no such folder.
    """

    def __init__(self, root: Path) -> None:
        if not is_folder(root):
            raise InputError(f"{root}: there is no such folder: give a study file, or a folder that has some")
        self.root = root.resolve()

    def path(self, name: str) -> Path:
        """Return the path of a file or folder, by its name relative to this folder.

        Raises
        ------
        InputError
            If it is outside, also by a link, or not there.
        """
        try:
            found = (self.root / name).resolve(strict=True)
        except (OSError, ValueError, RuntimeError):
            raise InputError(f"{name[:200]!r} is not in {full(self.root)}") from None
        if not found.is_relative_to(self.root):
            raise InputError(f"{name[:200]!r} is not in {full(self.root)}")
        return found

    def name(self, path: Path) -> str:
        """Return the name of a path relative to this folder, as `path` takes it."""
        return Path(os.path.relpath(path.resolve(), self.root)).as_posix()

    def has(self, path: Path) -> bool:
        """Whether a path lies in this folder."""
        return path.resolve().is_relative_to(self.root)

    def look(self) -> tuple[list[FoundStudy], list[FoundResult]]:
        """Return the studies and the results there are, each in the order of their names."""
        studies, results = [], []
        for path in self.files((".toml", ".json")):
            if path.suffix == ".toml":
                found = read_study(path)
                studies += [found] if found is not None else []
            elif path.name in RESULTS:
                results += [FoundResult.of(path)]
        return studies, results

    def files(self, kinds: tuple[str, ...]) -> Iterator[Path]:
        """Yield the files whose names end so, in the order of their names."""
        seen, depth = 0, len(self.root.parts)
        for place, folders, files in os.walk(self.root):
            here = Path(place)
            deep = len(here.parts) - depth >= DEEPEST
            folders[:] = sorted(f for f in folders if not deep and not f.startswith(".") and f not in _NOT_OURS)
            seen += len(files) + len(folders)
            if seen > MOST_ENTRIES:
                return
            yield from (here / name for name in sorted(files) if name.lower().endswith(kinds))


TABLES = (".csv", ".parquet", ".mat", ".xlsx", ".ods", ".h5", ".tdms", ".mf4")
"""Tables that can be chosen; others are dropped."""
MOST_CHOICES = 200


def tables(folder: Folder) -> list[Path]:
    """Return the tables in the folder that are no results."""
    return [path for path in choices(folder, TABLES) if not any((path.parent / mark).exists() for mark in _MARKS)]


def beside(path: Path, study: Path) -> str:
    """Return the name of a file or folder as a command takes it that is given in a study's folder."""
    return Path(os.path.relpath(path, study.parent)).as_posix()


def choices(folder: Folder, kinds: tuple[str, ...]) -> list[Path]:
    """Return the files of some kinds in the folder, at most so many as can be chosen from."""
    return list(islice((path for path in folder.files(kinds) if folder.has(path)), MOST_CHOICES))


_MARKS = (*RESULTS, "simulated.csv", "design.csv", "report.html")
_NOT_OURS = ("cases", "logs", "figures", "node_modules", "__pycache__")


def read_study(path: Path) -> FoundStudy | None:
    """Return what a TOML file says if it is a study; what is wrong with it is found when it is opened."""
    try:
        if path.stat().st_size > LARGEST_STUDY:
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
