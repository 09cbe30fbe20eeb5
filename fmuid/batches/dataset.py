"""The rows of a batch on disk: Parquet files that are each complete or not there, whatever ends the run.

A row counts as finished once the part that has it carries its final name, which it gets after its content has reached
the disk. Parts are merged now and then, new ones complete before old ones go; rows that are there twice meanwhile are
the same.
"""

from __future__ import annotations

import contextlib
import hashlib
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

from fmuid.arrays import Flags
from fmuid.errors import FmuidError, InputError
from fmuid.files import locked

CASES, LOGS, MANIFEST = "cases", "logs", "batch.json"
"""What a batch's folder has: folders of parts and of logs, what the batch is, and the lock of who writes."""
# Rows of a full part: some 10 MB in memory, read at once by whatever reads Parquet.
PART_ROWS = 100_000
# So many parts are merged, so that days of work leave no folder that takes minutes to list.
LOOSE_PARTS = 64
# Of what a case printed; an FMU that prints in every step would fill the disk.
LOG_BYTES = 64 * 1024
_TYPES = {"int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_(), "str": pa.string()}
_TYPES |= {"string": pa.string(), "datetime64[us, UTC]": pa.timestamp("us", "UTC")}
_PART_NAME = re.compile(r"part-(\d{9,})-[0-9a-f]{12}\.parquet")
_DAMAGED = (pa.ArrowException, OSError, ValueError, KeyError)


class Dataset:
    """The rows of a batch in a folder, as parts in its folder ``cases``.

    Parameters
    ----------
    folder : Path
        The batch's folder.
    columns : mapping of str to str
        All columns and their types, those of pandas; ``case`` is the first.
    """

    def __init__(self, folder: Path, columns: Mapping[str, str]) -> None:
        self.folder, self.cases, self.logs = folder, folder / CASES, folder / LOGS
        self.schema = pa.schema([pa.field(name, _TYPES[kind]) for name, kind in columns.items()])

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing to the folder; it is made where needed (`fmuid.files.locked`)."""
        with locked(self.folder, "batch"):
            self.cases.mkdir(exist_ok=True)
            yield

    # --- reading

    def parts(self) -> list[Path]:
        """Return the parts, in the order of their names; files that others have put there are none."""
        return sorted(path for path in self.cases.glob("part-*.parquet") if _PART_NAME.fullmatch(path.name))

    def read(self) -> pd.DataFrame:
        """Return all rows, sorted by case, each case once.

        Raises
        ------
        InputError
            If a part is damaged.
        """
        frame: pd.DataFrame = self._together([self._load(path) for path in self.parts()]).to_pandas()
        return frame

    def finished(self, count: int) -> Flags:
        """Return which of `count` cases are finished, (count,)."""
        found = np.zeros(count, np.bool_)
        for path in self.parts():
            found[self._load(path, ["case"])["case"].to_numpy()] = True
        return found

    def stream(self, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
        """Give some columns of all rows, part by part, each case once; only one part is in memory.

        Raises
        ------
        InputError
            If a part is damaged.
        """
        seen = np.zeros(0, np.bool_)
        for path in self.parts():
            table = self._load(path, list(dict.fromkeys(["case", *columns])))
            cases = table["case"].to_numpy()
            if cases.size and cases.max() >= seen.size:
                seen = np.concatenate([seen, np.zeros(cases.max() + 1 - seen.size, np.bool_)])
            yield table.filter(pa.array(~seen[cases])).select(list(columns)).to_pandas()
            seen[cases] = True

    def _load(self, path: Path, columns: list[str] | None = None) -> pa.Table:
        """Return the rows of a part, sorted by case; all columns or some."""
        try:
            with path.open("rb") as file:
                table = pq.ParquetFile(file).read(columns)
            return table.cast(self.schema if columns is None else pa.schema([self.schema.field(n) for n in columns]))
        except _DAMAGED as error:
            raise InputError(
                f"{path} is damaged ({str(error).splitlines()[0]}): give the batch again, which runs its cases anew"
            ) from None

    def _together(self, tables: Sequence[pa.Table]) -> pa.Table:
        """Return the rows of tables sorted by case; of rows of one case the first."""
        table = pa.concat_tables([self.schema.empty_table(), *tables])
        _, first = np.unique(table["case"].to_numpy(), return_index=True)
        return table.take(pa.array(first))

    # --- writing

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows as a part; when this returns they are on the disk.

        Raises
        ------
        FmuidError
            If they cannot be written.
        """
        with self._writing():
            self._write(self._together([pa.Table.from_pylist([dict(row) for row in rows], self.schema)]))
            if len(self.parts()) > LOOSE_PARTS:
                self._merge([path for path in self.parts() if pq.read_metadata(path).num_rows < PART_ROWS])

    def compact(self) -> None:
        """Merge all parts into as few as there can be, sorted by case; only a few are in memory at a time.

        Raises
        ------
        FmuidError
            If they cannot be written.
        """
        with self._writing():
            self._merge(self.parts())

    def log(self, case: int, text: str) -> None:
        """Keep what a case printed.

        Raises
        ------
        FmuidError
            If it cannot be written.
        """
        with self._writing():
            self.logs.mkdir(exist_ok=True)
            self.log_path(case).write_text(text, encoding="utf-8", errors="replace")

    def log_path(self, case: int) -> Path:
        """Return the file of what a case printed."""
        return self.logs / f"case-{case:06d}.txt"

    def log_count(self) -> int:
        """Return how many cases printed something."""
        return sum(1 for _ in self.logs.glob("case-*.txt"))

    def repair(self) -> tuple[Path, ...]:
        """Remove what an ended run left half written; return the damaged parts that are lost."""
        lost = []
        for path in self._drafts():
            path.unlink(missing_ok=True)
        for path in self.parts():
            try:
                self._load(path)
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
        """Return what a run leaves, each case's log aside."""
        return [self.folder / MANIFEST, *self.parts()]

    def write_manifest(self, text: str) -> None:
        """Write ``batch.json``.

        Raises
        ------
        FmuidError
            If it cannot be written.
        """
        with self._writing():
            self._put(self.folder / MANIFEST, text.encode())

    def _merge(self, paths: Sequence[Path]) -> None:
        """Merge parts into full ones; in memory are only those whose cases interleave."""
        paths = sorted(paths, key=_first_case)
        kept, table = set[Path](), self.schema.empty_table()
        for path, following in zip(paths, [*paths[1:], None], strict=True):
            table = self._together([table, self._load(path)])
            cases = table["case"].to_numpy()
            # what comes before all that is still to be loaded is settled
            settled = len(cases) if following is None else int(np.searchsorted(cases, _first_case(following)))
            full = settled if following is None else settled - settled % PART_ROWS
            kept |= {self._write(table.slice(at, min(PART_ROWS, full - at))) for at in range(0, full, PART_ROWS)}
            table = table.slice(full)
        for path in paths:
            if path not in kept:
                path.unlink()

    def _write(self, table: pa.Table) -> Path:
        """Write a part and return its path; the name has a digest, so that no two parts differ under one name."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        content = sink.getvalue().to_pybytes()
        first, digest = table["case"][0].as_py(), hashlib.sha256(content).hexdigest()[:12]
        path = self.cases / f"part-{first:09d}-{digest}.parquet"  # which `_first_case` reads
        self._put(path, content)
        return path

    def _put(self, path: Path, content: bytes) -> None:
        """Write a file so that it is complete under its name, or not there."""
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
            raise FmuidError(
                f"{self.folder} cannot be written to: {error.strerror or error}; the cases finished so far are kept, "
                "make room and give the same command to go on"
            ) from None


def _first_case(part: Path) -> int:
    return int(part.name.split("-")[1])


def _sync_folder(folder: Path) -> None:
    """Have a new name reach the disk (POSIX; elsewhere the system sees to it)."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def bounded(text: str) -> str:
    """Return a log cut to `LOG_BYTES`: its beginning and its end."""
    content = text.encode(errors="replace")
    if len(content) <= LOG_BYTES:
        return text
    half = LOG_BYTES // 2 - 40
    ends = content[:half].decode(errors="ignore"), content[-half:].decode(errors="ignore")
    return f"{ends[0]}\n... {len(content) - 2 * half} bytes left out ...\n{ends[1]}"
