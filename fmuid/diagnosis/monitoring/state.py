"""The files of a monitoring: its table, what it has found, and what it needs to go on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.diagnosis.evidence.watch import Watch
from fmuid.diagnosis.findings import Explanation
from fmuid.diagnosis.monitoring.alarms import Alarm, onset_of_json
from fmuid.diagnosis.monitoring.seeing import Now, WatchedRecord
from fmuid.errors import InputError
from fmuid.files import as_json, content_of, is_file, replacing, write_json, write_table
from fmuid.version import __version__

TABLE_FILE, STATE_FILE, SUMS_FILE = "monitoring.csv", "monitoring.json", "monitoring.npz"
REMEDY = "monitor without appending"
TEXTS, NUMBERS, TRUTHS = ("record", "significant", "alarm"), ("window", "samples"), ("unexplained",)


def write(folder: Path, now: Now, table: pd.DataFrame, content: Mapping[str, Any]) -> list[Path]:
    """Write the files of a monitoring and return the paths of findings and table.

    Parameters
    ----------
    folder : Path
    now : Now
    table : DataFrame
    content : mapping
        What the JSON file says beside what is needed to go on; ``rule`` and ``healthy`` must be the same then.
    """
    whole = {**content, "records": now.records, "windows": now.row, "version": __version__}
    with replacing(folder / SUMS_FILE) as draft, draft.open("wb") as file:
        np.savez(file, point=now.point, **now.watch.state())
    return [write_json(folder / STATE_FILE, whole), write_table(folder / TABLE_FILE, table)]


def read(folder: Path, now: Now, same: Mapping[str, Any]) -> tuple[Now, dict[str, Any]]:
    """Return how far an earlier run was, and the sums of its onsets, for `restored`.

    Parameters
    ----------
    folder : Path
    now : Now
        Before any record.
    same : mapping
        What its JSON file must say.

    Raises
    ------
    InputError
        If there is none, or it had another rule, other faults or another healthy machine.
    """
    path = folder / STATE_FILE
    if not is_file(path):
        raise InputError(f"{folder} has no earlier run to append to: {REMEDY} first")
    with content_of(path, "the monitoring.json of fmuid monitor", REMEDY) as content:
        if any(content[key] != as_json(value) for key, value in same.items()):
            raise InputError(
                f"{path} is of a run with another rule, other faults or another healthy machine: use the same, or "
                "another output folder"
            )
        records = tuple(WatchedRecord(**each) for each in content["records"])
        alarms = tuple(_alarm(each) for each in content["alarms"])
        windows = int(content["windows"])
    table = _table(folder / TABLE_FILE, windows)
    try:
        with np.load(folder / SUMS_FILE) as file:
            sums = dict(file)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{folder / SUMS_FILE} is not of fmuid monitor, or not whole ({error}): {REMEDY}") from None
    return replace(now, records=records, tables=(table,), alarms=alarms, row=windows), sums


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
        raise InputError(f"the {SUMS_FILE} of the earlier run does not fit ({error}): {REMEDY}") from None


def _alarm(data: Mapping[str, Any]) -> Alarm:
    explanations = tuple(map(Explanation.of_json, data["explanations"]))
    return Alarm(**{**data, "onset": onset_of_json(data["onset"]), "explanations": explanations, "trend": None})


def _table(path: Path, count: int) -> pd.DataFrame:
    """Return a written table, which must have so many rows."""
    try:
        text = pd.read_csv(path, dtype=str, keep_default_na=False)
        if len(text) != count or text.isna().to_numpy().any():
            raise ValueError(f"it has not the {count} windows that {STATE_FILE} is of")
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
