"""Tables in JSON: rows, columns, pandas' layouts, and a row a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.data.headers import RawTable, check_once, named
from fmuid.data.readers.text import as_numbers
from fmuid.errors import InputError


def read_json(path: Path, source: str) -> RawTable:
    """Read a table; an index of times becomes a column."""
    try:
        frame = _frame(_content(path.read_text("utf-8-sig")))
        frame = frame.apply(as_numbers, decimal=".")
    except Exception:  # of any shape: pandas has no error of its own for it
        raise InputError(f"{source}: not a readable JSON table. Write it again.") from None
    for name in frame.columns:
        if frame[name].map(lambda cell: isinstance(cell, list | dict)).any():
            raise InputError(
                f"{source}: column {str(name)!r} has lists in its cells. Save it as CSV, a column per signal."
            )
    names, units = named([str(column) for column in frame.columns])
    check_once(source, names)
    return RawTable(frame.set_axis(names, axis="columns"), units)


def _content(text: str) -> Any:
    try:
        return json.loads(text, parse_int=_integer)
    except json.JSONDecodeError:
        if not text.lstrip().startswith("{"):
            raise
        return [json.loads(line, parse_int=_integer) for line in text.splitlines() if line.strip()]  # a row a line


def _integer(digits: str) -> float:
    """Return an integer of 64 bits, larger ones as floating-point numbers."""
    return int(digits) if abs(float(digits)) < 2.0**63 else float(digits)


def _frame(content: Any) -> pd.DataFrame:
    """Return rows, or columns, with their index in front."""
    index: list[Any] = []
    if isinstance(content, dict) and {"columns", "data"} <= set(content):
        frame, index = pd.DataFrame(content["data"], columns=content["columns"]), content.get("index", [])
    elif isinstance(content, dict) and {"schema", "data"} <= set(content):
        frame = pd.DataFrame(content["data"]).rename(columns={"index": ""})
    elif isinstance(content, dict) and all(isinstance(each, dict) for each in content.values()):
        frame = pd.DataFrame(content)
        if content and all(map(_is_place, content)):  # by rows
            frame = frame.T.infer_objects()
        index = [*frame.index]
        frame = frame.reset_index(drop=True)
    else:
        frame = pd.json_normalize(content) if isinstance(content, list) else pd.DataFrame(content)
    if index:
        frame.insert(0, "", index)
    rows = "" in frame.columns and [str(each) for each in frame[""]] == [str(k) for k in range(len(frame))]
    return frame.drop(columns="") if rows else frame


def _is_place(key: str) -> bool:
    """Return whether a key is one of rows: a number or a date."""
    return key[:1].isdigit()
