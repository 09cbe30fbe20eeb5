"""Files of measurements: one reader a format, all of which return columns with their names and units."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd

from fmuid.data.formats.columns import TIME_NAMES, RawTable, is_number, named, split_header
from fmuid.errors import InputError

Reader = Callable[[Path, str], RawTable]


def reader_of(path: Path, sheet: str | int | None = None) -> Reader | None:
    """Return what reads files of this suffix, None where nothing does; a sheet is one of spreadsheets."""
    from fmuid.data.formats.hdf import read_hdf
    from fmuid.data.formats.matlab import read_mat
    from fmuid.data.formats.recorders import read_mdf, read_tdms
    from fmuid.data.formats.spreadsheet import read_spreadsheet
    from fmuid.data.formats.text import read_text

    suffix = path.suffix.lower()
    if suffix in SPREADSHEETS:
        return partial(read_spreadsheet, sheet=sheet)
    inner = Path(path.stem).suffix.lower()
    if suffix in (".gz", ".zip"):
        return read_text if inner in TEXT or not inner else None
    readers: dict[str, Reader] = {
        **dict.fromkeys(TEXT, read_text),
        **dict.fromkeys(_OF_PANDAS, _read_with_pandas),
        **dict.fromkeys((".h5", ".hdf5", ".hdf"), read_hdf),
        ".mat": read_mat,
        ".tdms": read_tdms,
        **dict.fromkeys((".mf4", ".mdf"), read_mdf),
    }
    return readers.get(suffix)


TEXT = (".csv", ".txt", ".tsv", ".asc", ".dat")
"""Suffixes of delimited text; packed it has .gz or .zip after them."""
SPREADSHEETS = (".xlsx", ".xlsm", ".xls", ".ods")
"""Suffixes of files that have sheets."""
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
_OF_PANDAS: dict[str, tuple[str, Callable[[Path], pd.DataFrame]]] = {
    ".parquet": ("Parquet", lambda path: pd.read_parquet(path, engine="pyarrow")),
    ".feather": ("Feather", pd.read_feather),
    ".json": ("JSON", pd.read_json),
}


def _read_with_pandas(path: Path, source: str) -> RawTable:
    name, read = _OF_PANDAS[path.suffix.lower()]
    try:
        frame = read(path)
    except Exception:  # pyarrow's own errors are few, but on broken files there are others, even KeyError
        raise InputError(f"{source}: the file is no readable {name} table: write it again") from None
    dated = isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex)
    if frame.index.name is not None or dated:
        index = str(frame.index.name or "time")
        if index not in frame.columns:
            frame = frame.rename_axis(index).reset_index()
    names, units = named([str(column) for column in frame.columns])
    return RawTable(frame.set_axis(names, axis="columns"), units, "time" if dated and "time" in names else None)


__all__ = ["SPREADSHEETS", "TABLE_SUFFIXES", "TIME_NAMES", "RawTable", "is_number", "reader_of", "split_header"]
