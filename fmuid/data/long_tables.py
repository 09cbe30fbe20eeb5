"""Tables with one row per sample of one signal: historians, loggers of vehicles, databases."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from fmuid.data.cells import is_missing, numbers_of
from fmuid.data.headers import RawTable, is_unit
from fmuid.errors import InputError

_NAMES = (
    *("varname", "variable", "variablename", "name", "signal", "signalname", "tag", "tagname", "channel"),
    *(
        "channelname",
        "series",
        "metric",
        "sensor",
        "pid",
        "field",
        "parameter",
        "point",
        "pointname",
        "entityid",
        "topic",
    ),
)
_VALUES = ("value", "varvalue", "val", "wert", "state", "payload")
_UNITS = ("units", "unit", "einheit")
"""Headers in small letters of the columns with names, values and units."""


def rows_of_signals(raw: RawTable) -> RawTable | None:
    """Return rows with a value of one signal each; None of other tables."""
    names, values, _ = _roles(raw)
    return None if names is None or values is None else replace(raw, frame=raw.frame.dropna(subset=[names, values]))


def with_columns_of_signals(raw: RawTable, time: str, source: str) -> RawTable:
    """Return a table with a column per signal, and its times.

    Raises
    ------
    InputError
        If a signal has several values at one time, as of several devices.
    """
    names, values, units = _roles(raw)
    assert names is not None and values is not None
    rows = raw.frame.dropna(subset=time)
    if rows.empty:
        raise InputError(f"{source}: no row has a name, a time and a value. Give measured samples.")
    groups = {str(name): part for name, part in rows.groupby(names, sort=False)}
    single = {name: "one value" for name, part in groups.items() if len(part) == 1 < len(rows)}  # marks of events
    groups = {name: part for name, part in groups.items() if name not in single} or groups
    first = next(iter(groups.values()))[time].tolist()
    together = all(part[time].tolist() == first for part in groups.values())
    columns: dict[str, Any] = {}
    said: dict[str, str] = {time: raw.units[time]} if time in raw.units else {}
    clocks: dict[str, str] = {}
    for name, part in groups.items():
        others = part.select_dtypes(exclude="number").drop(columns=[time, names, values], errors="ignore")
        devices = [str(each) for each in others if 1 < others[each].nunique() < len(others) / 2]
        if devices and part[time].duplicated().any():
            said_so = f"signal {name!r} has several values at one time, by column {devices[0]!r}"
            raise InputError(f"{source}: {said_so}. Keep the rows of one {devices[0]}.")
        clock = time if together or not columns else f"{time} {name}"
        columns |= {} if clock in columns else {clock: part[time].reset_index(drop=True)}
        columns[name] = _numbers(part[values]).reset_index(drop=True)
        clocks |= {} if together else {name: clock}
        said |= {clock: said[time]} if time in said else {}
        unit = raw.units.get(values, "") if units is None else _units_in(part[units])
        said |= {name: unit} if unit else {}
    left_out = {**raw.left_out, **{name: reason for name, reason in single.items() if name not in groups}}
    return replace(raw, frame=pd.DataFrame(columns), units=said, time=time, clocks=clocks, left_out=left_out)


def with_units_of_columns(raw: RawTable) -> RawTable:
    """Return a table with the units of columns beside, ``Ch1_Value,Ch1_Unit``."""
    names = [str(name) for name in raw.frame.columns]
    said: dict[str, str] = {}
    for name, after in itertools.pairwise(names):
        words = re.findall(r"[^\W\d_]+", after.lower())
        if name in raw.units or not words or words[-1] not in _UNITS:
            continue
        unit = _units_in(raw.frame[after])
        said |= {name: unit} if unit and all(map(is_unit, unit.split(" or "))) else {}
    return replace(raw, units=raw.units | said)


def _units_in(cells: pd.Series[Any]) -> str:
    """Return the unit of all cells; several are no unit, and refused where they are used."""
    return " or ".join(cells.dropna().astype(str).str.strip().unique())


def _roles(raw: RawTable) -> tuple[str | None, ...]:
    """Return the columns of names, values and units."""
    found = {re.sub(r"[\W_\d]", "", str(name).lower()): str(name) for name in raw.frame.columns}
    return tuple(next((found[each] for each in known if each in found), None) for known in (_NAMES, _VALUES, _UNITS))


def _numbers(cells: pd.Series[Any]) -> pd.Series[Any]:
    """Return cells as numbers, NaN where marked as missing; else unchanged."""
    if pd.api.types.is_numeric_dtype(cells.dtype):
        return cells
    there = cells[[not is_missing(cell) for cell in cells]].astype(str)
    found = numbers_of(there, ".") or numbers_of(there, ",")
    return cells if found is None else pd.Series(found, there.index, dtype=np.float64).reindex(cells.index)
