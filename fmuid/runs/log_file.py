"""One file of a logger, which digests identify: loggers rename and rewrite files; and its new rows."""

from __future__ import annotations

import hashlib
import tempfile
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.data import head_length, numeric_column, time_name
from fmuid.errors import InputError
from fmuid.studies import ExperimentSettings

# Bytes at the begin, and before the place of reading, that identify a file.
MARK = 4096
# Bytes read at once: a day at 1 kHz is some gigabytes, and takes thirty times its size in memory.
MOST_BYTES, HEAD_BYTES = 1 << 21, 1 << 16


@dataclass
class LogFile:
    """A followed file, its place of reading, and its marks."""

    file: str
    record: str
    head: int = -1  # bytes before the first sample, -1 while unknown
    reference: str = ""  # the first row of the record, from which dates are counted
    position: int = 0  # byte of the first row that is still needed
    rows: int = 0  # rows of the record before that
    end: int = 0  # byte up to which the file is read
    begun: bool = False  # windows of the record are examined
    done: bool = False  # the record is whole
    begins: tuple[int, str] = (0, "")  # length of the marked begin, and its digest
    ends: str = ""  # digest of the bytes before `end`
    said: str = ""  # last remark
    seen: tuple[int, int] = field(default=(-1, -1), repr=False)  # size and time of change at the last look
    read: tuple[int, int] = field(default=(-2, -2), repr=False)  # the same at the last reading
    since: float = field(default=0.0, repr=False)  # monotonic time of the last change, s

    def mark(self, path: Path, end: int) -> None:
        """Note that a file was read up to a byte."""
        self.end = end
        with path.open("rb") as file:
            start = file.read(min(MARK, end))
            file.seek(max(0, end - MARK))
            self.ends = _digest(file.read(min(MARK, end)))
        self.begins = (len(start), _digest(start))

    def finish(self, path: Path) -> None:
        """Note that file and record are whole."""
        self.mark(path, path.stat().st_size)
        self.done = True

    def is_of(self, path: Path) -> bool:
        """Return True if a file still has the bytes read."""
        count, digest = self.begins
        with path.open("rb") as file:
            if _digest(file.read(count)) != digest:
                return False
            file.seek(max(0, self.end - MARK))
            return _digest(file.read(min(MARK, self.end))) == self.ends


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@dataclass(frozen=True, eq=False)
class NewRows:
    """Rows of a file, with the time in s of the record."""

    frame: pd.DataFrame
    starts: npt.NDArray[np.int64]  # (n + 1,) bytes at which rows begin, and the last one ends
    reference: str
    more: bool  # the file goes on
    broken: bool = False  # a line follows that is no row


def good_rows(path: Path, each: LogFile, words: ExperimentSettings, most: int) -> tuple[NewRows | None, int]:
    """Return new rows before a bad line, and the byte after it."""
    with path.open("rb") as file:
        if each.head < 0:
            start = file.read(HEAD_BYTES)
            each.head = head_length(start[: start.rfind(b"\n") + 1], str(path))
            each.position = each.head
        file.seek(0)
        head = file.read(each.head)
        file.seek(each.position)
        content = file.read(most)
        more = len(content) == most
    content = content[: content.rfind(b"\n") + 1]
    if not content.strip():
        return None, 0
    given = _Lines(path, each, words, head, content)
    count = given.ends.size
    try:
        return given.rows(count, more), 0
    except InputError:
        good = bisect_left(range(1, count), True, key=lambda lines: not given.readable(lines))
        skipped = each.position + int(given.ends[good])
        found = given.rows(good, more) if given.there[:good].any() else None
        return None if found is None else replace(found, broken=True), skipped


class _Lines:
    def __init__(self, path: Path, each: LogFile, words: ExperimentSettings, head: bytes, content: bytes) -> None:
        self.path, self.each, self.words, self.head, self.content = path, each, words, head, content
        self.ends = 1 + np.flatnonzero(np.frombuffer(content, np.uint8) == ord("\n"))
        self.lengths = np.diff(self.ends, prepend=0)
        self.there = self.lengths > 2  # a row has two cells at least, an empty line its end alone
        first = content[: int(self.ends[np.argmax(self.there)])].splitlines(keepends=True)[-1]
        self.reference = each.reference.encode("utf-8", errors="surrogateescape") or first

    def readable(self, count: int) -> bool:
        """Return True if the first lines are rows."""
        try:
            self.rows(count, False)
        except InputError:
            return False
        return True

    def rows(self, count: int, more: bool) -> NewRows:
        """Return the first lines as rows."""
        words, there = self.words, self.there[:count]
        with tempfile.TemporaryDirectory() as folder:  # read as the file of the same kind
            copy = Path(folder, f"rows{self.path.suffix}")
            copy.write_bytes(self.head + self.reference + self.content[: int(self.ends[count - 1]) if count else 0])
            frame = words.read_frame(copy, str(self.path))
        for column in [time_name(words.time), *words.columns]:
            if column in frame.columns and not words.preprocess.computed_columns:
                numeric_column(frame, column, str(self.path))
        if len(frame) != 1 + np.count_nonzero(there):
            raise InputError(
                f"{self.path}: some rows span several lines. Save one row per line, or pass the finished file."
            )
        attributes = frame.attrs
        frame = frame.iloc[1:].reset_index(drop=True)
        frame.attrs = attributes
        if words.sample_rate is not None:
            frame[time_name(words.time)] = (self.each.rows + np.arange(len(frame))) / words.sample_rate
        ends = self.each.position + self.ends[:count]
        starts = np.append((ends - self.lengths[:count])[there], ends[-1] if count else self.each.position)
        return NewRows(frame, starts, self.reference.decode("utf-8", errors="surrogateescape"), more)
