"""Columns of binary data files, and the one process that reads them."""

from __future__ import annotations

import importlib
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.data.cells import Array, Cell
from fmuid.data.time_names import TIME_NAMES, is_time_name, plain_name
from fmuid.errors import InputError
from fmuid.files import ContentError
from fmuid.formatting import nearest

if TYPE_CHECKING:
    from fmuid.processes import HostExitError, IsolatedCaller

READING_SECONDS = 60.0
"""Time in which any file is read, s; larger files have more."""
_REMEDY = "Write it again, or in parts."


@dataclass(frozen=True)
class FileColumns:
    """Columns of a binary file as plain arrays under their headers.

    `values` are numbers, dates (UTC if zoned), durations or cells. By place: `units` outside headers, time `zones`, the
    format's own `time`, and `days` for possible pandas durations. `below` is a row of units. Headers end in a unit only
    if `units_in_headers`. `clocks` are the places of columns' own times; `left_out` names what was not read, and why.
    """

    headers: tuple[str, ...]
    values: tuple[Array, ...]
    units: dict[int, str] = field(default_factory=dict)
    below: tuple[str, ...] = ()
    zones: dict[int, str] = field(default_factory=dict)
    time: int | None = None
    days: tuple[int, ...] = ()
    units_in_headers: bool = True
    clocks: dict[int, int] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def library(name: str, extra: str, source: str) -> ModuleType:
    """Import the library of a format, or name the extra to install."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f'{source}: needs {name}. Install it: pip install "fmuid[{extra}]".') from None


def chosen(names: Sequence[str], wanted: str | int, source: str) -> str:
    """Return a sheet's name by name or place from 1."""
    if isinstance(wanted, int) and 1 <= wanted <= len(names):
        return names[wanted - 1]
    if isinstance(wanted, str) and wanted in names:
        return wanted
    near = nearest(wanted, names) if isinstance(wanted, str) else ""
    raise InputError(f"{source}: no sheet {wanted!r}{near}. Choose one of {', '.join(names)}.")


def columns_of_vectors(
    source: str, vectors: Mapping[str, Array], units: Mapping[str, str], separator: str
) -> FileColumns:
    """Return vectors as columns; others than the time's length need times of their own."""
    lengths = Counter(value.size for value in vectors.values() if value.size > 1)
    if not lengths:
        raise InputError(f"{source}: no numeric vectors. Save the columns as vectors of one length.")
    times = {name: value.size for name, value in vectors.items() if is_time_name(name.rpartition(separator)[2])}
    plain = {size for name, size in times.items() if plain_name(name.rpartition(separator)[2]) in TIME_NAMES}
    length = max(lengths, key=lambda size: (size in plain, lengths[size], size))
    own: dict[str, str] = {}
    left_out: dict[str, str] = {}
    for name, value in vectors.items():
        fitting = [clock for clock, size in times.items() if size == value.size > 1]
        beside = [clock for clock in fitting if clock.rpartition(separator)[0] == name.rpartition(separator)[0]]
        fitting = beside if len(beside) == 1 else fitting
        if len(fitting) == 1 and len(times) > 1:
            own[name] = fitting[0]
        elif value.size != length and value.size > 1:
            left_out[name] = f"{value.size} samples in place of {length}, without times of their own"
    columns = {name: value for name, value in vectors.items() if value.size == length or name in own}
    shared = len({name.rpartition(separator)[0] for name in columns}) == 1
    headers = tuple(name.rpartition(separator)[2] if shared else name for name in columns)
    return FileColumns(
        headers,
        padded([*columns.values()]),
        {k: units[name] for k, name in enumerate(columns) if name in units},
        clocks={k: [*columns].index(own[name]) for k, name in enumerate(columns) if own.get(name, name) != name},
        left_out=left_out,
    )


def padded(columns: Sequence[Array]) -> tuple[Array, ...]:
    """Return columns of one length; shorter ones end in missing samples."""
    length = max((each.size for each in columns), default=0)
    return tuple(
        each if each.size == length else np.concatenate([each.astype(np.float64), np.full(length - each.size, np.nan)])
        for each in columns
    )


def array_of_cells(cells: Sequence[Cell]) -> Array:
    """Return cells as numbers, dates or durations, if uniform; else as objects."""
    kinds = {type(cell) for cell in cells} - {type(None)}
    if kinds and kinds <= {bool, int, float}:
        return np.array([math.nan if cell is None else cell for cell in cells], dtype=np.float64)
    for kind, dtype in ((datetime, "datetime64[us]"), (timedelta, "timedelta64[us]")):
        if kinds == {kind}:
            return np.array(cells, dtype=dtype)
    plain = [cell if cell is None or isinstance(cell, str | bool | int | float) else str(cell) for cell in cells]
    return np.fromiter(plain, dtype=object, count=len(plain))


def call_reader(function: Callable[..., dict[str, Any]], path: Path, *arguments: Any) -> dict[str, Any]:
    """Call a reader in the reader process; raise `ContentError` if it fails."""
    from fmuid.processes import HostExitError

    try:
        limit = READING_SECONDS + path.stat().st_size / 1e5  # a tenth of a slow machine's speed with spreadsheets
        return _reader().call(function, path.absolute(), *arguments, time_limit=limit)
    except OSError as error:
        raise ContentError(f"cannot be read: {error.strerror or error}.") from None
    except MemoryError:
        raise ContentError(f"not enough memory to read the file. {_REMEDY}") from None
    except HostExitError as end:
        raise ContentError(_lost(end, limit)) from None


def _lost(end: HostExitError, limit: float) -> str:
    from fmuid.processes import ProcessEnd

    if end.kind == ProcessEnd.CRASHED:
        return f"the reading library crashed ({end.signal_name}). {_REMEDY}"
    if end.kind == ProcessEnd.HUNG:
        return f"not read within {limit:.3g} s. {_REMEDY}"
    if end.kind == ProcessEnd.GREW:
        return f"reading took more than {end.number} MB. {_REMEDY}"
    return "the reading process was killed. Read the file again, or free memory."


@cache
def _reader() -> IsolatedCaller:
    import psutil

    from fmuid.processes import IsolatedCaller

    return IsolatedCaller(READING_SECONDS, 0.5 * psutil.virtual_memory().total / 1e6)
