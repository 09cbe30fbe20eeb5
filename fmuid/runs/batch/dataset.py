"""The rows of a batch on disk: Parquet files, each complete or absent.

A row is finished once its part has its final name, given after the content has reached the disk. Merged parts are
complete before old ones go; rows that are there twice meanwhile are the same.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from fmuid.array_types import Flags
from fmuid.errors import FmuidError, InputError
from fmuid.files import locked

# Folders of parts and of logs, and the file that describes the batch.
CASES, LOGS, MANIFEST = "cases", "logs", "batch.json"
# Rows of a full part, some 10 MB in memory.
PART_ROWS = 100_000
# Number of parts that are merged: days of work leave a folder that lists fast.
LOOSE_PARTS = 64
_TYPES = {"int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_(), "str": pa.string()}
_TYPES |= {"string": pa.string(), "datetime64[us, UTC]": pa.timestamp("us", "UTC")}
_PART_NAME = re.compile(r"part-(\d{9,})-[0-9a-f]{12}\.parquet")
_DAMAGED = (pa.ArrowException, OSError, ValueError, KeyError)


class Dataset:
    """The rows of a batch, as parts; `columns` have pandas types."""

    def __init__(self, folder: Path, columns: Mapping[str, str], count: int) -> None:
        self.folder, self.cases, self.logs, self.count = folder, folder / CASES, folder / LOGS, count
        self.schema = pa.schema([pa.field(name, _TYPES[kind]) for name, kind in columns.items()])

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing to the folder; make it where needed."""
        with locked(self.folder, "batch"):
            self.cases.mkdir(exist_ok=True)
            yield

    def parts(self) -> list[Path]:
        """Return the parts by name, without files of others."""
        return parts_in(self.folder)

    def read(self, columns: Sequence[str] = ()) -> pd.DataFrame:
        """Return all rows, sorted by case, each case once; with ``case`` and some columns, or all."""
        names = list(dict.fromkeys(["case", *columns])) if columns else self.schema.names
        frame: pd.DataFrame = self._together([self._load(path, names) for path in self.parts()], names).to_pandas()
        return frame

    def finished(self) -> Flags:
        """Return the finished cases as flags, (count,)."""
        found = np.zeros(self.count, np.bool_)
        found[self.read(["case"])["case"]] = True
        return found

    def _load(self, path: Path, names: Sequence[str]) -> pa.Table:
        with _whole(path):
            table = _opened(path).read(list(names)).cast(pa.schema([self.schema.field(name) for name in names]))
            cases = table["case"].to_numpy()
            if not ((cases >= 0) & (cases < self.count)).all():
                raise ValueError(f"case number not below {self.count}")
            return table

    def _together(self, tables: Sequence[pa.Table], names: Sequence[str]) -> pa.Table:
        """Return rows sorted by case; of several of one case the first."""
        table = pa.concat_tables([self.schema.empty_table().select(names), *tables])
        _, first = np.unique(table["case"].to_numpy(), return_index=True)
        return table.take(pa.array(first))

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows as a part, on the disk on return."""
        with self._writing():
            new = pa.Table.from_pylist([dict(row) for row in rows], self.schema)
            self._write(self._together([new], self.schema.names))
            if len(self.parts()) > LOOSE_PARTS:
                self._merge()

    def compact(self) -> None:
        """Merge parts into full ones."""
        with self._writing():
            self._merge()

    def log(self, case: int, text: str) -> None:
        """Keep the log of a case."""
        with self._writing():
            self.logs.mkdir(exist_ok=True)
            (self.logs / f"case-{case:06d}.txt").write_text(text, encoding="utf-8", errors="replace")

    def repair(self) -> tuple[Path, ...]:
        """Remove unfinished files of an ended run; return the damaged parts, removed too."""
        lost = []
        for path in self._drafts():
            path.unlink(missing_ok=True)
        for path in self.parts():
            try:
                self._load(path, self.schema.names)
            except InputError:
                path.unlink()
                lost.append(path)
        return tuple(lost)

    def clear(self) -> None:
        """Remove the rows and logs of an earlier batch."""
        (self.folder / MANIFEST).unlink(missing_ok=True)  # first: rows without it are nobody's
        shutil.rmtree(self.logs, ignore_errors=True)
        for path in [*self.parts(), *self._drafts()]:
            path.unlink(missing_ok=True)

    def _drafts(self) -> list[Path]:
        return [*self.cases.glob(".part-*"), *self.folder.glob(f".{MANIFEST}.*")]

    def files(self) -> list[Path]:
        """Return the files of a run without logs."""
        return [self.folder / MANIFEST, *self.parts()]

    def write_manifest(self, content: Mapping[str, Any]) -> None:
        """Write ``batch.json``."""
        with self._writing():
            text = json.dumps(content, indent=1, ensure_ascii=False, default=str)
            self._put(self.folder / MANIFEST, f"{text}\n".encode())

    def _merge(self) -> None:
        """Merge the parts that are not full, the only ones in memory."""
        names = self.schema.names
        loose = [path for path in self.parts() if self._load(path, ["case"]).num_rows < PART_ROWS]
        table = self._together([self._load(path, names) for path in loose], names)
        kept = {self._write(table.slice(at, PART_ROWS)) for at in range(0, table.num_rows, PART_ROWS)}
        for path in loose:
            if path not in kept:
                path.unlink()

    def _write(self, table: pa.Table) -> Path:
        """Write a part, named by first case and digest; return its path."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
        content = sink.getvalue().to_pybytes()
        path = self.cases / f"part-{table['case'][0].as_py():09d}-{_digest(content)}.parquet"
        self._put(path, content)
        return path

    def _put(self, path: Path, content: bytes) -> None:
        """Write a file that is complete under its name, or absent."""
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with draft.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):  # the first error is the one to be told
                draft.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            why = f"{self.folder}: write failed: {error.strerror or error}"
            raise FmuidError(f"{why}. Finished cases are kept: free disk space, and repeat the command.") from None


def parts_in(folder: Path) -> list[Path]:
    """Return the parts of a batch's folder by name."""
    return sorted(path for path in (folder / CASES).glob("part-*.parquet") if _PART_NAME.fullmatch(path.name))


def read_part(path: Path) -> pa.Table:
    """Return a part, checked by its digest."""
    with _whole(path):
        return _opened(path).read()


def _opened(path: Path) -> pq.ParquetFile:
    """Return a part to read from; check all its bytes."""
    content = path.read_bytes()
    if path.stem.rpartition("-")[2] != _digest(content):
        raise ValueError("wrong digest")
    return pq.ParquetFile(pa.BufferReader(content))


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Turn the errors of a damaged part into one sentence."""
    try:
        yield
    except _DAMAGED as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path}: damaged ({why}). Repeat the command to run its cases again.") from None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


def _sync_folder(folder: Path) -> None:
    """Have a new name reach the disk (POSIX)."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
