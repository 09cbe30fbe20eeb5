"""Files of measurements: one reader a format, all of which return columns with their names and units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fmuid.data.formats.binary import BINARY, SPREADSHEETS, raw_table
from fmuid.data.formats.columns import TIME_NAMES, RawTable, is_number, named, split_header
from fmuid.errors import InputError

Reader = Callable[[Path, str], RawTable]


def reader_of(path: Path, sheet: str | int | None = None) -> Reader | None:
    """Return what reads files of this suffix, None where nothing does; a sheet is one of spreadsheets."""
    suffix = path.suffix.lower()
    if suffix in BINARY:
        return lambda path, source: _read_binary(path, source, sheet)
    if suffix == ".json":
        return _read_json
    inner = Path(path.stem).suffix.lower()
    packed = suffix in (".gz", ".zip") and (inner in TEXT or not inner)
    return _read_text if suffix in TEXT or packed else None


TEXT = (".csv", ".txt", ".tsv", ".asc", ".dat")
"""Suffixes of delimited text; packed it has .gz or .zip after them."""
TABLE_SUFFIXES = (
    *TEXT,
    ".parquet",
    ".feather",
    ".json",
    ".xlsx",
    ".xls",
    ".ods",
    ".mat",
    ".h5",
    ".hdf5",
    ".tdms",
    ".mf4",
    ".mdf",
)
"""Suffixes of the formats that are read."""


def _read_binary(path: Path, source: str, sheet: str | int | None) -> RawTable:
    from fmuid.data.formats.isolated import read_isolated

    return raw_table(read_isolated(path, source, sheet), source)


def _read_text(path: Path, source: str) -> RawTable:
    from fmuid.data.formats.text import read_text

    return read_text(path, source)


def _read_json(path: Path, source: str) -> RawTable:
    import pandas as pd

    try:
        frame = pd.read_json(path)
    except Exception:  # pandas has no error of its own for it
        raise InputError(f"{source}: the file is no readable JSON table: write it again") from None
    dated = isinstance(frame.index, pd.DatetimeIndex)
    if dated and "time" not in frame.columns:
        frame = frame.rename_axis("time").reset_index()
    names, units = named([str(column) for column in frame.columns])
    return RawTable(frame.set_axis(names, axis="columns"), units, "time" if dated else None)


__all__ = ["SPREADSHEETS", "TABLE_SUFFIXES", "TIME_NAMES", "RawTable", "is_number", "reader_of", "split_header"]
