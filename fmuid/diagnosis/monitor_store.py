"""The files of a monitoring: its table and its alarms, which grow, and what it needs to go on.

Rows and lines are added first; then the state, which says how long both are, takes the place of the one before, in one
step. After a break whatever is longer is cut off: nothing is lost and nothing is there twice.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.codec import as_json, from_json
from fmuid.data import read_arrays, write_arrays
from fmuid.diagnosis.alarms import Alarm
from fmuid.diagnosis.onset_tracker import OnsetTracker
from fmuid.diagnosis.window_evaluation import MonitorState, WatchedRecord
from fmuid.errors import InputError
from fmuid.files import first_line, is_file, note, with_formulas, without_formulas, write_json
from fmuid.version import __version__

TABLE_FILE, FOUND_FILE, STATE_FILE = "monitoring.csv", "monitoring.json", "monitoring.npz"
ALARMS_FILE = "alarms.jsonl"
REMEDY = "monitor without appending, or into another folder"
TEXTS, NUMBERS, TRUTHS = ("record", "significant", "alarm"), ("window", "samples"), ("unexplained",)


@dataclass(frozen=True)
class Resumed:
    """What a monitoring needs to go on beside its records, windows and alarms.

    Attributes
    ----------
    sums : mapping of str to ndarray
        Of its onsets, for `restored`; empty before any record.
    beside : mapping
        What was written beside.
    units : mapping of str to str
        Of the columns.
    columns : tuple of str
        Those of causes beside the faults.
    """

    sums: Mapping[str, Any] = field(default_factory=dict)
    beside: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    columns: tuple[str, ...] = ()


class MonitorStore:
    """The files of a monitoring in a folder.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lengths, self._rows = {TABLE_FILE: 0, ALARMS_FILE: 0}, 0

    def write(
        self,
        now: MonitorState,
        content: Mapping[str, Any],
        lines: Sequence[str],
        same: Mapping[str, Any],
        resumed: Resumed,
    ) -> list[Path]:
        """Write what is new and return the paths of findings, table and alarms.

        Parameters
        ----------
        now : MonitorState
        content : mapping
            What the JSON file says.
        lines : sequence of str
            Of the alarms.
        same : mapping
            What must be the same to go on.
        resumed : Resumed
        """
        self._add_rows(now)
        self._add(ALARMS_FILE, "".join(f"{line}\n" for line in lines))
        whole = {
            "same": same,
            "beside": resumed.beside,
            "units": resumed.units,
            "columns": resumed.columns,
            "version": __version__,
            "records": now.records,
            "alarms": now.alarms,
            "windows": now.row,
            "lengths": self._lengths,
        }
        text = np.frombuffer(json.dumps(as_json(whole)).encode(), np.uint8)
        write_arrays(self.folder / STATE_FILE, {"text": text, **resumed.sums})
        said = {**content, "records": now.records, "windows": now.row, "version": __version__}
        found = write_json(self.folder / FOUND_FILE, said)
        return [found, *(self.folder / name for name in (TABLE_FILE, ALARMS_FILE) if self._lengths[name])]

    def _add_rows(self, now: MonitorState) -> None:
        table = now.table()
        text, new = io.StringIO(), without_formulas(table.loc[self._rows :])
        new.to_csv(text, index=False, header=not self._lengths[TABLE_FILE], lineterminator="\n")
        self._add(TABLE_FILE, text.getvalue() if len(table) else "")
        self._rows = now.row

    def _add(self, name: str, text: str) -> None:
        """Add text to a file after as many bytes as the state says, or as there are where it was cut meanwhile."""
        path = self.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not self._lengths[name] and not text:
                path.unlink(missing_ok=True)
                return
            with path.open("r+b" if path.is_file() else "w+b") as file:
                self._lengths[name] = min(self._lengths[name], file.seek(0, os.SEEK_END))
                file.truncate(self._lengths[name])
                file.seek(self._lengths[name])
                file.write(text.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            why = error.strerror or error
            raise InputError(f"{path} cannot be written: {why}; make room, or choose another with --output") from None
        self._lengths[name] += len(text.encode())
        if text:
            note(path)

    def read(self, now: MonitorState, same: Mapping[str, Any], rows: int | None) -> tuple[MonitorState, Resumed]:
        """Return how far an earlier run was, and what it needs to go on.

        Parameters
        ----------
        now : MonitorState
            Before any record.
        same : mapping
            What the state must say.
        rows : int or None
            Of the table, that are read, the last ones; None for all.

        Raises
        ------
        InputError
            If there is none, or it had another rule, other faults or another healthy machine.
        DamagedStateError
            If its files are damaged or of another version.
        """
        path = self.folder / STATE_FILE
        if not is_file(path):
            raise InputError(f"{self.folder} has no earlier run to append to: {REMEDY} first")
        with damage_of(path):
            sums = read_arrays(path)
            earlier = _Earlier.of(json.loads(sums.pop("text").tobytes()), as_json(same))
        if not earlier.windows:  # nothing was found, whatever the run was of
            return now, Resumed()
        if not earlier.same and earlier.version != __version__:
            raise DamagedStateError(path, f"fmuid {earlier.version} has written it, this is fmuid {__version__}")
        if not earlier.same:
            raise InputError(
                f"{path} is of a run with another rule, other faults or another healthy machine: use the same, or "
                "another output folder"
            )
        self._rows, self._lengths = earlier.windows, earlier.lengths
        table = _table(self.folder / TABLE_FILE, self._lengths[TABLE_FILE], self._rows, rows)
        forgotten = self._rows - len(table)
        found = replace(now, records=earlier.records, tables=(table,), alarms=earlier.alarms, row=self._rows)
        return replace(found, forgotten=forgotten), Resumed(sums, earlier.beside, earlier.units, earlier.columns)


@dataclass(frozen=True)
class _Earlier:
    """What the text of a state says."""

    version: str
    same: bool
    windows: int
    records: tuple[WatchedRecord, ...] = ()
    alarms: tuple[Alarm, ...] = ()
    lengths: dict[str, int] = field(default_factory=dict)
    beside: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    columns: tuple[str, ...] = ()

    @classmethod
    def of(cls, content: Any, same: Any) -> _Earlier:
        """Return what a text says; of a run that found nothing, or is another one, no more than that."""
        version, windows, as_before = str(content["version"]), _count(content["windows"]), content["same"] == same
        if not windows or not as_before:
            return cls(version, as_before, windows)
        records, alarms = tuple(map(_record, content["records"])), tuple(map(_alarm, content["alarms"]))
        if not records:
            raise ValueError("it has windows of no record")
        lengths = {name: _count(content["lengths"][name]) for name in (TABLE_FILE, ALARMS_FILE)}
        beside, units, columns = dict(content["beside"]), dict(content["units"]), tuple(content["columns"])
        return cls(version, True, windows, records, alarms, lengths, beside, units, columns)


class DamagedStateError(InputError):
    """What an earlier run has left is damaged or of another version.

    Attributes
    ----------
    path : Path
    why : str
    """

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"{path} is not of fmuid monitor, or not whole ({why}): {REMEDY}")
        self.path, self.why = path, why


@contextmanager
def damage_of(path: Path) -> Iterator[None]:
    """Have errors that show damage of a file be a `DamagedStateError`."""
    try:
        yield
    except (OSError, LookupError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        said = f"it has no {error}" if isinstance(error, KeyError) else first_line(error)
        said = "its content is of other types" if isinstance(error, TypeError | AttributeError) else said
        raise DamagedStateError(path, said) from None


def restored(watch: OnsetTracker, sums: Mapping[str, Any], path: Path) -> OnsetTracker:
    """Return a watch as it was when its sums were written to a file.

    Raises
    ------
    DamagedStateError
        If they are of other coordinates.
    """
    with damage_of(path):
        return watch.restored(sums)


def _record(data: Mapping[str, Any]) -> WatchedRecord:
    numbers = {name: float(data[name]) for name in ("begin", "clock", "counts")}
    return WatchedRecord(
        **{**data, **numbers, "name": str(data["name"]), "date": str(data["date"]), "windows": _count(data["windows"])}
    )


def _count(given: Any) -> int:
    """Return a number of something."""
    if not isinstance(given, int) or given < 0:
        raise ValueError(f"{given!r} is no number of rows or bytes")
    return given


def _alarm(data: Mapping[str, Any]) -> Alarm:
    return from_json(Alarm, {**data, "trend": None})


def _table(path: Path, length: int, count: int, most: int | None) -> pd.DataFrame:
    """Return the last rows of a table of which so many bytes and rows were written."""
    with damage_of(path):
        with path.open("rb") as file:
            content = file.read(length)
        head, *lines = content.decode().splitlines() or [""]
        kept = lines if most is None else lines[-most:]
        if len(content) < length or len(lines) != count:
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
        text = pd.read_csv(io.StringIO("\n".join([head, *kept])), dtype=str, keep_default_na=False)
        if text.isna().to_numpy().any():
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
        text = with_formulas(text)
        # Python reads numbers back exactly, as tables are not always
        return pd.DataFrame({name: [_cell(str(name), each) for each in text[name]] for name in text})


def _cell(column: str, text: str) -> Any:
    if column in TEXTS:
        return text
    if column in NUMBERS:
        return int(text)
    if column in TRUTHS:
        return text == "True"
    return float(text) if text else math.nan
