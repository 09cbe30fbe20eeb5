"""The reader process: binary files are read there, where a crash, a hang or a lack of memory costs one sentence.

One process serves all files that a process reads. It begins with the first of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.formats.binary import read_columns
from fmuid.data.formats.columns import Array, FileColumns
from fmuid.data.npz import read_arrays
from fmuid.errors import InputError
from fmuid.files import ContentError
from fmuid.processes import CRASHED, GREW, HUNG, HostExitError, IsolatedCaller

READING_SECONDS = 60.0
"""Time in which any file is read, s; larger files have more."""
_SLOWEST_READING = 1e5
"""Bytes read in a second at least: a tenth of what spreadsheets take on a slow machine."""
_SHARE_OF_MEMORY = 0.5
_REMEDY = "it is damaged or too large, write it again or in parts"


def read_isolated(path: Path, source: str, sheet: str | int | None = None) -> FileColumns:
    """Read the columns of a binary file in the reader process; a sheet is one of a spreadsheet.

    Raises
    ------
    InputError
        If the file cannot be read, holds no table, or the process is lost over it.
    """
    try:
        found = _called(_plain_columns, path, path.absolute(), source, sheet)
    except ContentError as error:
        raise InputError(f"{source}: {error}") from None
    values = tuple(_of_cells(each) if isinstance(each, list) else each for each in found["values"])
    return FileColumns(**found | {"values": values})


def read_arrays_isolated(path: Path) -> dict[str, Array]:
    """Read the arrays of an ``.npz`` file in the reader process.

    Raises
    ------
    ValueError
        If it cannot be read, or the process is lost over it.
    """
    return _called(read_arrays, path, path.absolute())


def _called(function: Callable[..., dict[str, Any]], path: Path, *arguments: Any) -> dict[str, Any]:
    """Call a reader of a file in the reader process; `ContentError` says what became of the process if it is lost."""
    try:
        limit = READING_SECONDS + path.stat().st_size / _SLOWEST_READING
        return _reader().call(function, *arguments, time_limit=limit)
    except OSError as error:
        raise ContentError(f"the file cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise ContentError(f"the file needs more memory than there is: {_REMEDY}") from None
    except HostExitError as end:
        raise ContentError(_lost(end, limit)) from None


def _lost(end: HostExitError, limit: float) -> str:
    """Return what became of the reader process over a file, and what to do."""
    if end.kind == CRASHED:
        return f"the library that reads the file crashed ({end.signal_name}): the file is damaged, write it again"
    if end.kind == HUNG:
        return f"the file was not read within {limit:.3g} s: {_REMEDY}"
    if end.kind == GREW:
        return f"reading the file took more than {end.number} MB: {_REMEDY}"
    return "the process that read the file was ended from outside: read it again, or free memory"


@cache
def _reader() -> IsolatedCaller:
    import psutil

    return IsolatedCaller(READING_SECONDS, _SHARE_OF_MEMORY * psutil.virtual_memory().total / 1e6)


def _plain_columns(path: Path, source: str, sheet: str | int | None) -> dict[str, Any]:
    """Return what `read_columns` does, in types that a process answers with."""
    found = read_columns(path, source, sheet)
    values = [each.tolist() if each.dtype.kind == "O" else each for each in found.values]
    return vars(found) | {"values": values}


def _of_cells(cells: list[Any]) -> Array:
    return np.fromiter(cells, dtype=object, count=len(cells))
