"""New records of a logger, and rows of a growing file.

Files are looked at again and again, which works on network drives too. A text is read as it grows, by whole lines.
Other files, and texts that are preprocessed as a whole, are read once they have not changed for `SETTLED`. Records are
examined one after the other, in the order of their names.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data import TEXT, Experiment, missing_rows, numeric_column, tables_in, time_name
from fmuid.errors import InputError
from fmuid.runs.log_file import MOST_BYTES, LogFile, NewRows, good_rows
from fmuid.studies import ExperimentSettings

# A file that has not changed for so long is whole, s.
SETTLED = 5.0
# Such files are whole or cannot be read, as they end with their table of contents.
WHOLE_OR_NOT = (".parquet", ".feather")
# Windows at the beginning of a record: two tell whether the transient is long enough.
BEGINS_WITH = 2.5
# Files that are gone are remembered, in case they come back, at most so many.
GONE = 1000


@dataclass(frozen=True, eq=False)
class RecordUpdate:
    """A record, or its new part."""

    record: Experiment
    grows: bool
    _file: LogFile
    _rows: NewRows | None = None
    until: int = 0  # the byte after its last row
    splits: bool = False  # the record ends in the middle of the file, where time jumps


class LogFollower:
    """Looks repeatedly at the files of a logger.

    `state` is of an earlier run; `window` and `transient` are those of `fmuid.Rule`, s; without a window each record is
    one.
    """

    def __init__(
        self,
        words: ExperimentSettings,
        place: Path,
        window: float | None,
        transient: float,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        if not place.exists():
            raise InputError(f"{place}: no such folder or file. Give the folder of the logger.")
        self.words, self.place, self.window, self.transient = words, place, window, transient
        files = [] if state is None else state["files"]
        self._files = {each["file"]: LogFile(**{**each, "begins": tuple(each["begins"])}) for each in files}
        self._numbers: dict[str, int] = {} if state is None else dict(state["numbers"])  # records of each stem
        self._by_rows = window is not None and words.preprocess.by_rows
        self._most = MOST_BYTES
        self.folder = place if place.is_dir() else place.parent

    @property
    def state(self) -> dict[str, Any]:
        """The place of reading in all files, for another run."""
        gone = [name for name in self._files if not (self.folder / name).exists()]
        for name in gone[:-GONE]:
            del self._files[name]
        unkept = ("seen", "since", "read")
        every = map(asdict, self._files.values())
        files = [{key: value for key, value in each.items() if key not in unkept} for each in every]
        stems = {Path(name).stem for name in self._files}
        self._numbers = {stem: number for stem, number in self._numbers.items() if stem in stems}
        return {"files": files, "numbers": self._numbers}

    def look(self) -> Iterator[RecordUpdate | str]:
        """Yield new pieces, to be `taken` or `refused`, and remarks."""
        yield from self._found()
        here = [each for _, each in sorted(self._files.items()) if (self.folder / each.file).exists()]
        waiting = [each for each in here if not each.done]
        for each in sorted(waiting, key=lambda one: not one.begun):
            path = self.folder / each.file
            others = any(one is not each and not one.done for one in waiting)
            try:
                yield from self._of_rows(path, each, others) if self._growing(path) else self._whole(path, each)
            except OSError as error:
                yield from _say(each, f"{path}: read failed: {error.strerror or error}")
            if not each.done:
                return

    def taken(self, piece: RecordUpdate, needed: float) -> None:
        """Note that a piece was examined; rows after `needed` are read again."""
        each, rows = piece._file, piece._rows
        path, each.begun = self.folder / each.file, True
        if rows is None:
            each.finish(path)
            return
        each.reference = rows.reference
        stop = int(np.searchsorted(rows.starts, piece.until))
        # a row more than is needed, as times are rounded
        at = max(0, min(int(np.searchsorted(piece.record.times, needed)) - 1, stop))
        each.rows, each.position = each.rows + at, int(rows.starts[at])
        each.mark(path, piece.until)

    def refused(self, piece: RecordUpdate) -> None:
        """Note that a piece cannot be examined: a new record follows."""
        path = self.folder / piece._file.file
        if piece._rows is None:
            piece._file.finish(path)
        else:
            self._end(path, piece._file, piece.until)

    def _growing(self, path: Path) -> bool:
        return self._by_rows and path.suffix.lower() in TEXT

    def _whole(self, path: Path, each: LogFile) -> Iterator[RecordUpdate | str]:
        """Yield a file as one record, once it is whole."""
        settled = _settled(each)
        if not settled and path.suffix.lower() not in WHOLE_OR_NOT:
            return
        try:
            record = self.words.model_copy(update={"name": each.record}).read_experiment(path)
        except InputError as error:
            if settled:
                each.finish(path)
                yield from _say(each, str(error))
            return
        yield RecordUpdate(record, False, each)

    def _of_rows(self, path: Path, each: LogFile, others: bool) -> Iterator[RecordUpdate | str]:
        """Yield the new rows of a text; end its record where another file waits."""
        over = others and _settled(each)
        more = each.read != each.seen or over
        while more:
            each.read, record = each.seen, each.record
            try:
                rows, skipped = good_rows(path, each, self.words, self._most)
                piece = None if rows is None else self._piece(path, each, rows, over)
            except InputError as error:
                if over:
                    each.finish(path)
                if over or _settled(each):
                    yield from _say(each, str(error))
                return
            if piece is not None:
                yield piece
            more = rows is not None and rows.more
            whole = rows is None or piece is None or piece.until == rows.starts[-1]
            if skipped and whole:
                self._end(path, each, skipped)
                yield f"{path}: invalid line ignored; following rows are record {each.record!r}."
                more = True
            elif piece is not None and piece.splits and each.record == record:
                self._end(path, each, piece.until)
                more = True
            if more and piece is None:
                self._most *= 2
        each.done = over

    def _piece(self, path: Path, each: LogFile, rows: NewRows, over: bool) -> RecordUpdate | None:
        """Return rows up to a jump of time; None if too few."""
        assert self.window is not None  # only windows of a record that grows are examined
        times = numeric_column(rows.frame, time_name(self.words.time), str(path))
        steps = np.diff(times)
        jumps = np.flatnonzero(~(steps >= 0) | (steps > max(self.window, self.transient)))
        jumps = jumps if jumps.size or times.size < 2 else missing_rows(times)
        count = int(jumps[0]) + 1 if jumps.size else times.size
        splits = bool(jumps.size) or rows.broken
        last = splits or (over and not rows.more)
        if not last and not each.begun and times[-1] - times[0] < BEGINS_WITH * self.window:
            return None
        if count < 2:
            return None
        update = {"name": each.record, **({"warmup": 0.0} if each.begun else {})}
        frame = rows.frame.iloc[:count]
        frame.attrs = rows.frame.attrs
        record = self.words.model_copy(update=update).experiment(frame, str(path))
        return RecordUpdate(record, not last, each, rows, int(rows.starts[count]), splits)

    def _end(self, path: Path, each: LogFile, at: int) -> None:
        """Let a record end at a byte, and another one begin there."""
        each.mark(path, at)
        each.position, each.rows, each.reference, each.begun, each.done = at, 0, "", False, False
        each.record = self._name(Path(each.file).stem)

    def _found(self) -> Iterator[str]:
        """Update the files: new, changed, moved and replaced ones; yield remarks."""
        names = [self.place.name]
        if self.place.is_dir():  # files that begin with a dot are being written
            names = [path.name for path in tables_in(self.place) if not path.name.startswith(".")]
        lost = [each for name, each in self._files.items() if name not in names]
        now = time.monotonic()
        fresh: list[tuple[str, tuple[int, int]]] = []
        for name in names:
            path, each = self.folder / name, self._files.get(name)
            try:
                told = path.stat()
                seen = (told.st_size, told.st_mtime_ns)
                if each is None:
                    fresh.append((name, seen))
                elif seen != each.seen:
                    if each.end and (seen[0] < each.end or not each.is_of(path)):
                        # another file in its place: it may be there under another name
                        lost.append(self._files.pop(name))
                        each.file = f".{each.record}"
                        self._files[each.file] = each
                        fresh.append((name, seen))
                        continue
                    each.seen, each.since = seen, now
                    if each.done and seen[0] > each.end:
                        yield self._later(path, each)
            except OSError:  # gone meanwhile, or not there for a moment
                continue
        for name, seen in fresh:
            path = self.folder / name
            each = next((one for one in lost if one.end and one.is_of(path)), None)  # one that was moved
            if each is None:
                each = LogFile(name, self._name(path.stem))
                if each.record != path.stem:
                    yield f"{path}: replaced by another file; its record is {each.record!r}."
            else:
                lost.remove(each)
                self._files.pop(each.file, None)
                each.file = name
            each.seen, each.since = seen, now
            self._files[name] = each

    def _later(self, path: Path, each: LogFile) -> str:
        """Go on with a file that has changed after its end; return a remark."""
        if self._growing(path):
            self._end(path, each, each.end)
        else:
            each.record, each.begun, each.done = self._name(path.stem), False, False
        return f"{path}: changed after its record was examined; new rows are record {each.record!r}."

    def _name(self, stem: str) -> str:
        """Return the name of another record from a file."""
        self._numbers[stem] = number = self._numbers.get(stem, 0) + 1
        return stem if number == 1 else f"{stem} ({number})"


def _settled(each: LogFile) -> bool:
    return time.monotonic() - each.since >= SETTLED


def _say(each: LogFile, text: str) -> Iterator[str]:
    if each.said != text:
        each.said = text
        yield text
