"""Readers of binary data files, by suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.readers.arrow import read_feather, read_parquet
from fmuid.data.readers.base import FileColumns, call_reader
from fmuid.data.readers.hdf import read_hdf
from fmuid.data.readers.matlab import read_mat
from fmuid.data.readers.recorders import read_mdf, read_tdms
from fmuid.data.readers.spreadsheet import read_spreadsheet
from fmuid.errors import InputError
from fmuid.files import ContentError

BINARY: dict[str, tuple[str, Callable[[Path, str, str | int | None], FileColumns]]] = {
    **dict.fromkeys((".parquet", ".pq"), ("Parquet table", read_parquet)),
    ".feather": ("Feather table", read_feather),
    **dict.fromkeys((".xlsx", ".xlsm", ".xls", ".ods"), ("spreadsheet", read_spreadsheet)),
    ".mat": ("MAT file", read_mat),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), ("HDF5 file", read_hdf)),
    ".tdms": ("TDMS file", read_tdms),
    **dict.fromkeys((".mf4", ".mdf"), ("MDF file", read_mdf)),
}
"""Formats by suffix: name in messages, and reader."""
WITH_SHEETS = tuple(suffix for suffix, (_, read) in BINARY.items() if read in (read_spreadsheet, read_hdf))
"""Suffixes of files that may hold several tables."""


_BEGINS = {
    b"MDF     ": ".mf4",
    b"\x89HDF": ".h5",
    b"TDSm": ".tdms",
    b"PAR1": ".parquet",
    b"ARROW1": ".feather",
    b"MATLAB 5.0": ".mat",
}
"""First bytes of formats that tools also write under other suffixes."""


def format_of(path: Path) -> str:
    """Return the suffix of a file's format: as its begin says, if its own is none of binary files."""
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        start = file.read(1 << 12)
    if suffix == ".xls" and is_text(start):
        return ".txt"
    if suffix not in BINARY and start.removeprefix(b"\xef\xbb\xbf").lstrip().startswith((b'{"', b'[{"')):
        return ".json"
    return (
        suffix if suffix in BINARY else next((own for begin, own in _BEGINS.items() if start.startswith(begin)), suffix)
    )


def is_text(start: bytes) -> bool:
    """Return whether first bytes are 8-bit text."""
    return bool(start) and all(byte > 31 or byte in b"\t\n\r\f" for byte in start)


def read_binary(path: Path, source: str, sheet: str | int | None = None) -> FileColumns:
    """Read the columns of a binary file in the reader process."""
    try:
        found = call_reader(_plain_columns, path, source, sheet)
    except ContentError as error:
        raise InputError(f"{source}: {error}") from None
    values = (np.fromiter(each, object, len(each)) if isinstance(each, list) else each for each in found["values"])
    return FileColumns(**found | {"values": tuple(values)})


def _plain_columns(path: Path, source: str, sheet: str | int | None) -> dict[str, Any]:
    """Read a binary file; return types that a process can send."""
    name, read = BINARY[format_of(path)]
    try:
        found = read(path, source, sheet)
    except (InputError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException:  # libraries raise errors of all kinds on damaged files; those in Rust panic
        raise InputError(f"{source}: not a readable {name}. Write it again.") from None
    return vars(found) | {"values": [each.tolist() if each.dtype.kind == "O" else each for each in found.values]}
