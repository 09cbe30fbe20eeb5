"""Rows of a text table that grows: those that are whole by now, as a table with the times of the whole one."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fmuid.data import head_length, numeric_column, time_name
from fmuid.errors import InputError
from fmuid.runs.log_following.file_state import Followed
from fmuid.studies import ExperimentSettings

if TYPE_CHECKING:
    import pandas as pd

# So many bytes are read at once: a day at 1 kHz is some gigabytes, and what is read takes thirty times its room.
MOST_BYTES = 1 << 21
HEAD_BYTES = 1 << 16


@dataclass(frozen=True, eq=False)
class NewRows:
    """Rows of a file.

    Attributes
    ----------
    frame : pandas.DataFrame
        With the time in s of the record.
    starts : (n + 1,) array
        Bytes of the file at which they begin, and at which the last one ends.
    reference : str
        The first row of the record.
    more : bool
        Whether the file goes on.
    broken : bool
        Whether a line follows that is no row.
    """

    frame: pd.DataFrame
    starts: npt.NDArray[np.int64]
    reference: str
    more: bool
    broken: bool = False


def good_rows(path: Path, each: Followed, words: ExperimentSettings, most: int) -> tuple[NewRows | None, int]:
    """Return the rows of a file from where reading is on, up to a line that is none, and the byte after that line.

    Parameters
    ----------
    path : Path
    each : Followed
    words : ExperimentSettings
    most : int
        Bytes that are read.

    Returns
    -------
    rows : NewRows or None
        None where there is no whole one.
    skipped : int
        0 where all lines are rows.

    Raises
    ------
    InputError
        If the file is no table, or has no samples yet.
    """
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
        good, bad = 0, count
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if given.readable(middle) else (good, middle)
        skipped = each.position + int(given.ends[bad - 1])
        found = given.rows(good, more) if given.there[:good].any() else None
        return None if found is None else replace(found, broken=True), skipped


class _Lines:
    """Lines of a file, the first of which is where reading is."""

    def __init__(self, path: Path, each: Followed, words: ExperimentSettings, head: bytes, content: bytes) -> None:
        self.path, self.each, self.words, self.head, self.content = path, each, words, head, content
        self.ends = 1 + np.flatnonzero(np.frombuffer(content, np.uint8) == ord("\n"))
        self.lengths = np.diff(self.ends, prepend=0)
        self.there = self.lengths > 2  # a row has two cells at least, an empty line its end alone
        first = content[: int(self.ends[np.argmax(self.there)])].splitlines(keepends=True)[-1]
        self.reference = each.reference.encode("utf-8", errors="surrogateescape") or first

    def readable(self, count: int) -> bool:
        """Whether so many lines are rows."""
        try:
            self.rows(count, False)
        except InputError:
            return False
        return True

    def rows(self, count: int, more: bool) -> NewRows:
        """Return so many lines as rows."""
        words, there = self.words, self.there[:count]
        frame = self._read(self.head + self.reference + self.content[: int(self.ends[count - 1]) if count else 0])
        columns = [time_name(words.time), *words.inputs.values(), *words.outputs.values()]
        for column in columns:
            if column in frame.columns and not words.preprocess.computed_columns:
                numeric_column(frame, column, str(self.path))
        if len(frame) != 1 + np.count_nonzero(there):
            raise InputError(f"{self.path}: its rows are no lines: save it otherwise, or give it when it is whole")
        attributes = frame.attrs
        frame = frame.iloc[1:].reset_index(drop=True)
        frame.attrs = attributes
        if words.sample_rate is not None:
            frame[time_name(words.time)] = (self.each.rows + np.arange(len(frame))) / words.sample_rate
        ends = self.each.position + self.ends[:count]
        starts = np.append((ends - self.lengths[:count])[there], ends[-1] if count else self.each.position)
        return NewRows(frame, starts, self.reference.decode("utf-8", errors="surrogateescape"), more)

    def _read(self, content: bytes) -> pd.DataFrame:
        """Read a text as the file of the same kind is read."""
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder, f"rows{self.path.suffix}")
            copy.write_bytes(content)
            return self.words.read_frame(copy, str(self.path))
