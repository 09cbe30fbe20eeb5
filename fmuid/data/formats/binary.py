"""Binary files: the reader of each suffix, and a table of the columns that it returns."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fmuid.data.formats.columns import FileColumns, RawTable, check_once, named
from fmuid.errors import InputError


class BinaryFormat(NamedTuple):
    """A binary format.

    Attributes
    ----------
    name : str
        In messages.
    module, function : str
        Its reader, of this package.
    """

    name: str
    module: str
    function: str


_HDF = BinaryFormat("HDF5 file", "hdf", "read_hdf")
_MDF = BinaryFormat("MDF file", "recorders", "read_mdf")
_SHEETS = BinaryFormat("spreadsheet", "spreadsheet", "read_spreadsheet")
SPREADSHEETS = (".xlsx", ".xlsm", ".xls", ".ods")
"""Suffixes of files that have sheets."""
BINARY = {
    ".parquet": BinaryFormat("Parquet table", "arrow", "read_parquet"),
    ".feather": BinaryFormat("Feather table", "arrow", "read_feather"),
    **dict.fromkeys(SPREADSHEETS, _SHEETS),
    ".mat": BinaryFormat("MAT file", "matlab", "read_mat"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), _HDF),
    ".tdms": BinaryFormat("TDMS file", "recorders", "read_tdms"),
    **dict.fromkeys((".mf4", ".mdf"), _MDF),
}
"""Binary formats by their suffixes."""


def read_columns(path: Path, source: str, sheet: str | int | None = None) -> FileColumns:
    """Read the columns of a binary file; a sheet is one of a spreadsheet.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no table.
    """
    suffix = path.suffix.lower()
    name, module, function = BINARY[suffix]
    read = getattr(importlib.import_module(f"fmuid.data.formats.{module}"), function)
    try:
        found: FileColumns = read(path, source, sheet) if suffix in SPREADSHEETS else read(path, source)
        return found
    except (InputError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException:  # libraries raise errors of all kinds on damaged files; those in Rust panic
        raise InputError(f"{source}: the file is no readable {name}: write it again") from None


def raw_table(found: FileColumns, source: str) -> RawTable:
    """Return columns of a binary file as a table, with the names and units that their headers say."""
    import pandas as pd

    names, units = named(found.headers, found.below) if found.units_in_headers else ([*found.headers], {})
    check_once(source, names)
    columns: dict[str, Any] = {}
    for k, (name, values) in enumerate(zip(names, found.values, strict=True)):
        native = values.astype(values.dtype.newbyteorder("="), copy=False)
        columns[name] = _in_zone(native, found.zones[k], source) if k in found.zones else native
    units |= {names[k]: unit for k, unit in found.units.items()}
    time = None if found.time is None else names[found.time]
    return RawTable(pd.DataFrame(columns), units, time, frozenset(names[k] for k in found.days))


def _in_zone(dates: np.ndarray[Any, Any], zone: str, source: str) -> Any:
    import pandas as pd

    try:
        return pd.Series(dates).dt.tz_localize("UTC").dt.tz_convert(zone)
    except Exception:  # pandas, pytz and zoneinfo have errors of their own
        raise InputError(f"{source}: dates have the unknown time zone {zone!r}: write them in UTC") from None
