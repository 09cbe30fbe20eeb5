"""Files of a monitoring: its growing table and alarms, and its state.

Rows are added first; then the state with their lengths replaces the old one. After a break longer files are cut off.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.codec import as_json, from_json, write_object
from fmuid.data import read_arrays, write_arrays
from fmuid.diagnosis.alarms import Alarm
from fmuid.diagnosis.window_evaluation import MonitorState
from fmuid.diagnosis.windows import WatchedRecord
from fmuid.errors import InputError
from fmuid.files import first_line, is_file, note, with_formulas, without_formulas
from fmuid.version import __version__

TABLE_FILE, FOUND_FILE, STATE_FILE = "monitoring.csv", "monitoring.json", "monitoring.npz"
ALARMS_FILE = "alarms.jsonl"
REMEDY = "Monitor without --resume, or choose another folder."
KINDS: Mapping[str, Callable[[str], Any]] = {
    **dict.fromkeys(("record", "significant", "alarm"), str),
    **dict.fromkeys(("window", "samples"), int),
    "unexplained": lambda text: text == "True",
}
"""Columns of the table that are no real numbers."""


@dataclass(frozen=True)
class MonitorSnapshot:
    """State of an earlier run beside its records, windows and alarms."""

    sums: Mapping[str, Any] = field(default_factory=dict)  # arrays of its onsets; empty before any record
    beside: Mapping[str, Any] = field(default_factory=dict)  # of the caller
    units: Mapping[str, str] = field(default_factory=dict)  # by column
    columns: tuple[str, ...] = ()  # of causes beside the faults


@dataclass(frozen=True)
class _State:
    """Text of a ``monitoring.npz``; `same` must be equal to go on."""

    same: Any
    beside: Mapping[str, Any]
    units: Mapping[str, str]
    columns: tuple[str, ...]
    version: str
    records: tuple[WatchedRecord, ...]
    alarms: tuple[Alarm, ...]
    windows: int
    lengths: dict[str, int]  # bytes of the growing files


class MonitorStore:
    """Files of a monitoring in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lengths, self._rows = {TABLE_FILE: 0, ALARMS_FILE: 0}, 0

    def write(
        self,
        now: MonitorState,
        content: Mapping[str, Any],
        lines: Sequence[str],
        same: Mapping[str, Any],
        resumed: MonitorSnapshot,
    ) -> list[Path]:
        """Write new rows, lines of alarms, the JSON `content` and the state; return the paths but for the state's."""
        table = now.table()
        text, new = io.StringIO(), without_formulas(table.loc[self._rows :])
        new.to_csv(text, index=False, header=not self._lengths[TABLE_FILE], lineterminator="\n")
        self._add(TABLE_FILE, text.getvalue() if len(table) else "")
        self._rows = now.row
        self._add(ALARMS_FILE, "".join(f"{line}\n" for line in lines))
        kept = same, resumed.beside, resumed.units, resumed.columns
        state = as_json(_State(*kept, __version__, now.records, now.alarms, now.row, self._lengths))
        encoded = np.frombuffer(json.dumps(state).encode(), np.uint8)
        write_arrays(self.folder / STATE_FILE, {"text": encoded, **resumed.sums})
        said = {**content, "records": now.records, "windows": now.row, "version": __version__}
        write_object(self.folder / FOUND_FILE, as_json(said))
        return [self.folder / name for name in (FOUND_FILE, TABLE_FILE, ALARMS_FILE) if self._lengths.get(name, 1)]

    def _add(self, name: str, text: str) -> None:
        """Add text to a file, after its valid part."""
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
            remedy = "Free disk space, or choose another folder with --output."
            raise InputError(f"{path}: write failed: {error.strerror or error}. {remedy}") from None
        self._lengths[name] += len(text.encode())
        if text:
            note(path)

    def read(
        self, now: MonitorState, same: Mapping[str, Any], rows: int | None
    ) -> tuple[MonitorState, MonitorSnapshot]:
        """Return the state of an earlier run; `rows` limits its table (None: all)."""
        path = self.folder / STATE_FILE
        if not is_file(path):
            raise InputError(f"{self.folder}: no earlier run to resume. {REMEDY}")
        with damage_of(path):
            sums = read_arrays(path)
            earlier = from_json(_State, json.loads(sums.pop("text").tobytes()))
        if not earlier.windows:  # nothing was found, whatever the run was of
            return now, MonitorSnapshot()
        if earlier.same != as_json(same):
            if earlier.version != __version__:
                raise DamagedStateError(path, f"written by fmuid {earlier.version}, this is {__version__}")
            said = "made with another rule, other faults or another healthy machine"
            raise InputError(f"{path}: {said}. Use the same, or another output folder.")
        self._rows, self._lengths = earlier.windows, earlier.lengths
        table = _table(self.folder / TABLE_FILE, self._lengths[TABLE_FILE], self._rows, rows)
        forgotten = self._rows - len(table)
        found = replace(now, records=earlier.records, tables=(table,), alarms=earlier.alarms, row=self._rows)
        return replace(found, forgotten=forgotten), MonitorSnapshot(
            sums, earlier.beside, earlier.units, earlier.columns
        )


class DamagedStateError(InputError):
    """Damaged files of an earlier run, or of another version.

    Attributes
    ----------
    path : Path
    why : str
    """

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"{path}: no complete file of fmuid monitor ({why}). {REMEDY}")
        self.path, self.why = path, why


@contextmanager
def damage_of(path: Path) -> Iterator[None]:
    """Raise errors of a damaged file as `DamagedStateError`."""
    try:
        yield
    except (OSError, LookupError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        said = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        said = "wrong types" if isinstance(error, TypeError | AttributeError) else said
        raise DamagedStateError(path, said) from None


def _table(path: Path, length: int, count: int, most: int | None) -> pd.DataFrame:
    """Return the last rows (`most`, None: all) of a table with `count` rows in `length` bytes."""
    with damage_of(path):
        with path.open("rb") as file:
            content = file.read(length)
        head, *lines = content.decode().splitlines() or [""]
        kept = lines if most is None else lines[-most:]
        if len(content) < length or len(lines) != count:
            raise ValueError(f"not the {count} windows of {STATE_FILE}")
        text = pd.read_csv(io.StringIO("\n".join([head, *kept])), dtype=str, keep_default_na=False)
        if text.isna().to_numpy().any():
            raise ValueError(f"not the {count} windows of {STATE_FILE}")
        text = with_formulas(text)
        # Python reads numbers back exactly, as tables are not always
        return pd.DataFrame({name: [KINDS.get(str(name), _number)(each) for each in text[name]] for name in text})


def _number(text: str) -> float:
    return float(text or math.nan)
