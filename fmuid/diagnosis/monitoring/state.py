"""The files of a monitoring: its table and its alarms, which grow, and what it needs to go on.

Rows and lines are added first; then the state, which says how long both are, takes the place of the one before, in one
step. After a break whatever is longer is cut off: nothing is lost and nothing is there twice.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from fmuid.diagnosis.evidence.watch import Watch
from fmuid.diagnosis.findings import Explanation
from fmuid.diagnosis.monitoring.alarms import Alarm, onset_of_json
from fmuid.diagnosis.monitoring.seeing import Now, WatchedRecord
from fmuid.errors import InputError
from fmuid.files import as_json, is_file, note, read_content, replacing, with_formulas, without_formulas, write_json
from fmuid.version import __version__

TABLE_FILE, FOUND_FILE, STATE_FILE = "monitoring.csv", "monitoring.json", "monitoring.npz"
ALARMS_FILE = "alarms.jsonl"
KIND, REMEDY = "the monitoring.npz of fmuid monitor", "monitor without appending, or into another folder"
TEXTS, NUMBERS, TRUTHS = ("record", "significant", "alarm"), ("window", "samples"), ("unexplained",)


class Journal:
    """The files of a monitoring in a folder.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lengths, self._rows = {TABLE_FILE: 0, ALARMS_FILE: 0}, 0

    def write(self, now: Now, content: Mapping[str, Any], lines: Sequence[str], state: Mapping[str, Any]) -> list[Path]:
        """Write what is new and return the paths of findings, table and alarms.

        Parameters
        ----------
        now : Now
        content : mapping
            What the JSON file says.
        lines : sequence of str
            Of the alarms.
        state : mapping
            What the state says beside how far the monitoring is.
        """
        self._add_rows(now)
        self._add(ALARMS_FILE, "".join(f"{line}\n" for line in lines))
        whole = {
            **state,
            "version": __version__,
            "records": now.records,
            "alarms": now.alarms,
            "windows": now.row,
            "lengths": self._lengths,
        }
        text = np.frombuffer(json.dumps(as_json(whole)).encode(), np.uint8)
        with replacing(self.folder / STATE_FILE) as draft, draft.open("wb") as file:
            np.savez(file, text=text, point=now.point, **now.watch.state())
            file.flush()
            os.fsync(file.fileno())
        said = {**content, "records": now.records, "windows": now.row, "version": __version__}
        found = [write_json(self.folder / FOUND_FILE, said), self.folder / TABLE_FILE]
        return [*found, self.folder / ALARMS_FILE] if self._lengths[ALARMS_FILE] else found

    def _add_rows(self, now: Now) -> None:
        table = now.table()
        text, new = io.StringIO(), without_formulas(table.loc[self._rows :])
        new.to_csv(text, index=False, header=not self._lengths[TABLE_FILE], lineterminator="\n")
        self._add(TABLE_FILE, text.getvalue() if len(table) else "")
        self._rows = now.row

    def _add(self, name: str, text: str) -> None:
        """Add text to a file, which has the length that the state says before."""
        path = self.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("r+b" if path.is_file() else "w+b") as file:
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

    def read(self, now: Now, same: Mapping[str, Any], rows: int | None) -> tuple[Now, dict[str, Any], dict[str, Any]]:
        """Return how far an earlier run was, the sums of its onsets, for `restored`, and what was written beside.

        Parameters
        ----------
        now : Now
            Before any record.
        same : mapping
            What the state must say.
        rows : int or None
            Of the table, that are read, the last ones; None for all.

        Raises
        ------
        InputError
            If there is none, or it had another rule, other faults or another healthy machine.
        """
        path = self.folder / STATE_FILE
        if not is_file(path):
            raise InputError(f"{self.folder} has no earlier run to append to: {REMEDY} first")
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                sums = dict(file)
            text = sums.pop("text").tobytes()
        except (OSError, ValueError, EOFError, KeyError, BadZipFile) as error:
            raise InputError(f"{path} is not of fmuid monitor, or not whole ({error}): {REMEDY}") from None
        with read_content(text, path, KIND, REMEDY) as content:
            if content["same"] != as_json(same):
                raise InputError(
                    f"{path} is of a run with another rule, other faults or another healthy machine: use the same, or "
                    "another output folder"
                )
            records = tuple(WatchedRecord(**each) for each in content["records"])
            alarms = tuple(_alarm(each) for each in content["alarms"])
            self._rows, self._lengths = int(content["windows"]), dict(content["lengths"])
            beside = dict(content["beside"])
        table = _table(self.folder / TABLE_FILE, self._lengths[TABLE_FILE], self._rows, rows)
        forgotten = self._rows - len(table)
        found = replace(now, records=records, tables=(table,), alarms=alarms, row=self._rows, forgotten=forgotten)
        return found, sums, beside


def restored(watch: Watch, sums: Mapping[str, Any]) -> Watch:
    """Return a watch as it was when its sums were written.

    Raises
    ------
    InputError
        If they are of other coordinates.
    """
    try:
        return watch.restored(sums)
    except (KeyError, ValueError) as error:
        raise InputError(f"the {STATE_FILE} of the earlier run does not fit ({error}): {REMEDY}") from None


def _alarm(data: Mapping[str, Any]) -> Alarm:
    explanations = tuple(map(Explanation.of_json, data["explanations"]))
    return Alarm(**{**data, "onset": onset_of_json(data["onset"]), "explanations": explanations, "trend": None})


def _table(path: Path, length: int, count: int, most: int | None) -> pd.DataFrame:
    """Return the last rows of a table of which so many bytes and rows were written."""
    try:
        with path.open("rb") as file:
            content = file.read(length)
        if len(content) < length:
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
        head, *lines = content.decode().splitlines()
        kept = lines if most is None else lines[-most:]
        text = pd.read_csv(io.StringIO("\n".join([head, *kept])), dtype=str, keep_default_na=False)
        if len(lines) != count or text.isna().to_numpy().any():
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
        text = with_formulas(text)
        # Python reads numbers back exactly, as tables are not always
        return pd.DataFrame({name: [_cell(str(name), each) for each in text[name]] for name in text})
    except (OSError, KeyError, ValueError) as error:
        said = str(error).splitlines()[0]
        raise InputError(f"{path} is no table of fmuid monitor, or not whole ({said}): {REMEDY}") from None


def _cell(column: str, text: str) -> Any:
    if column in TEXTS:
        return text
    if column in NUMBERS:
        return int(text)
    if column in TRUTHS:
        return text == "True"
    return float(text) if text else math.nan
