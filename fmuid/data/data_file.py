"""Data files as frames, with time in seconds and units."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.cells import OVERLOADS, is_number, numbers_of
from fmuid.data.clock import TimedTable, time_column, time_name, with_time
from fmuid.data.headers import RawTable, check_once, named, with_columns
from fmuid.data.long_tables import rows_of_signals, with_columns_of_signals, with_units_of_columns
from fmuid.data.readers import BINARY, WITH_SHEETS, format_of, is_text, read_binary
from fmuid.data.readers.base import FileColumns
from fmuid.data.readers.json_text import read_json
from fmuid.data.readers.text import read_text
from fmuid.data.readers.unpacking import PACKED
from fmuid.data.several_clocks import CLOCKS
from fmuid.data.time_names import is_time_name
from fmuid.data.time_numbers import dates_of_parts, with_dates_of_days
from fmuid.errors import InputError
from fmuid.files import is_file, is_folder
from fmuid.units import SECONDS, TIME_UNITS

TEXT = (".csv", ".txt", ".tsv", ".asc", ".dat", ".lvm", ".tab", ".prn", ".ascii", ".log", ".out")
"""Suffixes of delimited text; packed it has another after them."""
JSON = (".json", ".jsonl", ".ndjson")
TABLE_SUFFIXES = (*TEXT, *JSON, *BINARY)
"""Suffixes of the formats that are read."""
UNITS, BEGIN, SOURCE = "units", "begin", "source"
"""Attributes of a frame that was read: units as the file writes them, the date of second 0, its name in messages."""
LEFT_OUT, DECIDED = "left out", "missing is given"
"""Attributes: columns that were left out or changed, with the reason; whether marks of missing samples are given."""


def read_data(
    path: Path | str,
    time: str | int | None = "time",
    *,
    time_unit: str | None = None,
    sample_rate: float | None = None,
    sheet: str | int | None = None,
    missing: Sequence[str | float] | None = None,
    clocks: Mapping[str, str] | None = None,
    source: str | None = None,
) -> pd.DataFrame:
    """Read a data file.

    The suffix says the format:

    - Text (``.csv``, ``.txt``, ``.tsv``, ``.asc``, ``.dat``; packed as ``.gz``, ``.bz2``, ``.xz`` or ``.zip``)
      in UTF-8, UTF-16 or cp1252.
      Commas, semicolons, tabs, bars or spaces separate cells. Decimals have points or commas. Lines above the header
      are skipped. Empty cells and ``-`` are missing samples. Text of other suffixes is read, too.
    - ``.parquet``, ``.feather``, ``.json``: a named index becomes a column.
    - ``.xlsx``, ``.xls``, ``.ods`` (``pip install "fmuid[excel]"``).
    - ``.mat`` of MATLAB (``fmuid[hdf]`` for version 7.3): vectors of the most common length and matrices with named
      columns, also in structures; `iddata` objects.
    - ``.mat`` of OpenModelica and Dymola (results): each variable becomes a column.
    - ``.h5``, ``.hdf5`` (``fmuid[hdf]``), ``.tdms`` (``fmuid[tdms]``), ``.mf4``, ``.mdf`` (``fmuid[mdf]``).

    Headers such as ``w (rpm)``, a row of units below them and the format itself give units: ``frame.attrs["units"]``.

    Parameters
    ----------
    path : Path or str
        Data file.
    time : str, int or None
        Name of the time column, or its place from 1. ``"time"`` also stands for ``t``, ``Time (ms)`` and the like.
        None: rows without a time, as of steady states.
    time_unit : str, optional
        s, ms, us, ns, min, h or d. Default: the unit in the file, else s.
    sample_rate : float, optional
        Samples per second of a file without times.
    sheet : str or int, optional
        Sheet of a spreadsheet or frame of an HDF5 file, by name or place from 1. Default: the first that
        is no summary of a ten times longer one.
    missing : sequence of str or float, optional
        Texts and numbers that stand for no sample, such as ``["OL", -9999]``. Values far beyond all others are
        refused where they are used, unless it is given.
    clocks : mapping of str to str, optional
        Column to its own time column, of tables with several. Default: by names and positions.
    source : str, optional
        Name in messages. Default: the path.

    Returns
    -------
    pandas.DataFrame
        One row per sample, time in s. Dates count from the first, ``frame.attrs["begin"]``.

    Raises
    ------
    InputError
        If the file is missing, unreadable, empty, of an unknown format, or has no times.

    Examples
    --------
    >>> fmuid.read_data(fmuid.datasets.coil().path).shape
    (200, 3)
    """
    path = Path(path)
    source = source or str(path)
    if not is_file(path):
        raise InputError(f"{source}: {'is a folder' if is_folder(path) else 'file not found'}. Give a data file.")
    try:
        suffix = format_of(path)
    except PermissionError:
        raise InputError(f"{source}: permission denied. Change the permissions of the file.") from None
    inner = Path(path.stem).suffix.lower()
    text = suffix not in (*JSON, *BINARY) and inner not in ((*JSON, *BINARY) if suffix in PACKED else ())
    known = suffix in TABLE_SUFFIXES or (text and (suffix in TEXT or suffix in PACKED))
    if sheet is not None and suffix not in WITH_SHEETS:
        raise InputError(f"{source}: sheet {sheet!r}: this format has no sheets. Remove it.")
    if not known and not (text and _is_text(path)):
        said = f"unknown format {path.suffix or 'without suffix'!r}"
        raise InputError(f"{source}: {said}. Save it as .csv, .mat, .h5, .tdms or .mf4.")
    if text:
        raw = read_text(path, source)
    elif suffix in JSON:
        raw = read_json(path, source)
    else:
        raw = _raw_table(read_binary(path, source, sheet), source)
    if len(raw.frame) == 0:
        raise InputError(f"{source}: no samples below the header. Give measured samples.")
    raw = with_units_of_columns(replace(raw, frame=with_dates_of_days(raw.frame)))
    if time == "time" and (dates := dates_of_parts(raw.frame)) is not None:
        raw = replace(raw, frame=raw.frame.assign(time=dates))
    rows = rows_of_signals(raw) if time is not None else None
    if rows is not None and (column := time_column(rows, time or "time", source)) is not None:
        raw = with_columns_of_signals(rows, column, source)
    raw = replace(raw, frame=with_columns(raw.frame, partial(_without_marks, marks=tuple(missing or ()))))
    timed = TimedTable(raw.frame)
    if time is not None:
        timed = with_time(raw, time, time_unit, sample_rate, clocks or {}, source)
        numeric_column(timed.frame, time_name(time), source)
    frame = _without_events(timed.frame, time_name(time) if time is not None else "")
    others = set(raw.frame.columns) & set(frame.columns) - {time, *timed.clocks.values()}
    frame.attrs = {UNITS: {name: unit for name, unit in raw.units.items() if name in others}, SOURCE: source}
    frame.attrs |= {LEFT_OUT: {**raw.left_out, **timed.notes}}
    frame.attrs |= {CLOCKS: dict(timed.clocks)} if timed.clocks else {}
    frame.attrs |= {DECIDED: True} if missing is not None else {}
    frame.attrs |= {BEGIN: timed.begin} if timed.begin is not None else {}
    return frame


def in_time_of_model(frame: pd.DataFrame, time: str | int, unit: str) -> pd.DataFrame:
    """Convert the times of a frame from s to a model's unit."""
    if unit not in SECONDS:
        raise InputError(f"model_time_unit {unit!r} is unknown. Use {', '.join(TIME_UNITS)}.")
    if SECONDS[unit] == 1.0:
        return frame
    name = time_name(time)
    found = frame.assign(**{name: frame[name] / SECONDS[unit]})
    found.attrs = frame.attrs
    return found


def _is_text(path: Path) -> bool:
    """Return whether a file begins with 8-bit text."""
    with path.open("rb") as file:
        return is_text(file.read(1 << 12))


def with_missing(frame: pd.DataFrame, missing: Sequence[float]) -> pd.DataFrame:
    """Return a frame as `read_data` returns it with these marks."""
    found = with_columns(frame, partial(_without_marks, marks=tuple(missing))).copy(deep=False)
    found.attrs = {**frame.attrs, DECIDED: True}
    return found


def _without_marks(column: pd.Series[Any], marks: Sequence[str | float]) -> pd.Series[Any]:
    """Return a column with NaN for marks and SCPI's infinity."""
    kind = column.dtype
    if pd.api.types.is_float_dtype(kind) or (marks and pd.api.types.is_integer_dtype(kind)):
        numbers = [each for each in marks if isinstance(each, int | float)]
        found = column.isin(numbers) if numbers else None
        if pd.api.types.is_float_dtype(kind) and _largest(column) > min(OVERLOADS) / 2:
            beyond = np.isclose(column.abs().to_numpy()[:, None], OVERLOADS, rtol=1e-6).any(axis=1)
            found = beyond if found is None else found | beyond
        return column if found is None or not found.any() else column.mask(found).astype(np.float64)
    if marks and (pd.api.types.is_object_dtype(kind) or pd.api.types.is_string_dtype(kind)):
        texts = {str(each).strip().lower() for each in marks}
        kept = column.where(~column.map(lambda cell: str(cell).strip().lower() in texts))
        numbers_or_none = numbers_of(kept.dropna().astype(str), ".")
        if numbers_or_none is None:
            return kept
        return pd.Series(numbers_or_none, kept.dropna().index, dtype=np.float64).reindex(column.index)
    return column


def _largest(column: pd.Series[Any]) -> float:
    """Return the largest absolute value of a column of real numbers; -inf if there is none."""
    values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    return float(max(np.fmax.reduce(values, initial=-np.inf), -np.fmin.reduce(values, initial=np.inf)))


def _without_events(frame: pd.DataFrame, time: str) -> pd.DataFrame:
    """Return a frame without last rows of text alone, a logger's events."""
    others = frame.drop(columns=time, errors="ignore")
    kinds = {kind: others[[name for name in others if others[name].dtype.kind in kind]] for kind in ("f", "iu", "MOTU")}
    measured, texts = kinds["iu"] if kinds["f"].empty else kinds["f"], kinds["MOTU"]
    if texts.empty:
        return frame
    is_event = (measured.isna().all(axis="columns") & texts.notna().any(axis="columns")).to_numpy()
    return frame if is_event.all() or not is_event[-1] else frame[: int(np.flatnonzero(~is_event)[-1]) + 1]


@np.errstate(all="ignore")  # of numbers beyond double precision
def _raw_table(found: FileColumns, source: str) -> RawTable:
    """Return columns of a binary file with names and units."""
    names, units = named(found.headers, found.below) if found.units_in_headers else ([*found.headers], {})
    check_once(source, names)
    columns: dict[str, Any] = {}
    for k, (name, values) in enumerate(zip(names, found.values, strict=True)):
        kind = np.dtype(np.float64) if values.dtype.kind == "f" and values.dtype.itemsize > 8 else values.dtype
        native = values.astype(kind.newbyteorder("="), copy=False)
        columns[name] = _in_zone(native, found.zones[k], source) if k in found.zones else native
    units |= {names[k]: unit for k, unit in found.units.items()}
    time = None if found.time is None else names[found.time]
    clocks = {names[k]: names[clock] for k, clock in found.clocks.items()}
    days = frozenset(names[k] for k in found.days)
    return RawTable(pd.DataFrame(columns), units, time, days, clocks, dict(found.left_out))


def _in_zone(dates: np.ndarray[Any, Any], zone: str, source: str) -> Any:
    try:
        return pd.Series(dates).dt.tz_localize("UTC").dt.tz_convert(zone)
    except Exception:  # pandas, pytz and zoneinfo have errors of their own
        raise InputError(f"{source}: unknown time zone {zone!r} of dates. Write them in UTC.") from None


def numeric_column(frame: pd.DataFrame, column: str, source: str) -> Floats:
    """Return a column as float64 (K,), NaN where a sample is missing; booleans become 0 and 1.

    Raises
    ------
    InputError
        If a cell is no real number; rows count from 1, without the header.
    """
    series = frame[column]
    kind = series.dtype
    real = pd.api.types.is_bool_dtype(kind) or pd.api.types.is_numeric_dtype(kind)
    real = real and not pd.api.types.is_complex_dtype(kind)
    if not real and pd.api.types.is_object_dtype(kind):
        real = all(isinstance(cell, (int, float, np.number, np.bool_)) or cell is None for cell in series)
    if real:
        with np.errstate(over="ignore"):  # beyond double precision
            return series.to_numpy(dtype=np.float64, na_value=np.nan)
    if pd.api.types.is_datetime64_any_dtype(kind) or pd.api.types.is_timedelta64_dtype(kind):
        said = f"column {column!r} holds dates or durations ({kind})"
        raise InputError(f"{source}: {said}. Convert it to numbers, times to seconds.")
    row, cell = _first_text(series)
    comma = "," in cell and is_number(cell, ",")
    remedy = "Write decimal points." if comma else _remedy_of_texts(series)
    if column == "time" and not any(map(str.isdigit, cell)) and row > 1:
        remedy = "Remove rows without a time."
    if is_time_name(column) and not comma and any(map(str.isdigit, cell)):
        remedy = "Write dates as 2026-02-28 12:00:00, times as 12:00:00."
    raise InputError(f"{source}: column {column!r}: {cell!r} in row {row} is no real number. {remedy}")


def _remedy_of_texts(series: pd.Series[Any]) -> str:
    """Return what to do with texts: few among numbers stand for no sample."""
    cells = series.dropna().astype(str)
    texts = cells[pd.to_numeric(cells, errors="coerce").isna()]
    known = [*texts.unique()]
    if len(known) > 4 or 2 * len(texts) > len(cells):
        return "Give numbers; leave missing cells empty."
    return f"Set missing = {json.dumps(known, ensure_ascii=False)} if they stand for no sample."


def _first_text(series: pd.Series[Any]) -> tuple[int, str]:
    """Return row (from 1) and text of the first non-numeric cell."""
    there = [pd.api.types.is_list_like(cell) or not pd.isna(cell) for cell in series]
    cells = [(row, cell) for row, (cell, given) in enumerate(zip(series, there, strict=True), start=1) if given]
    texts = [(row, str(cell)) for row, cell in cells if isinstance(cell, str | complex)]
    # read as the columns are: Python's float takes 1_000 and full-width digits as well
    numbers = pd.to_numeric(pd.Series([text for _, text in texts], dtype=object), errors="coerce")
    for place, number in zip(texts, numbers, strict=True):
        if math.isnan(number):
            return place
    return (cells[0][0], str(cells[0][1])) if cells else (1, "")


def tables_in(folder: Path) -> list[Path]:
    """Return the data files of a folder, sorted by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in TABLE_SUFFIXES)


def record_files(paths: Sequence[Path]) -> list[Path]:
    """Return data files, with folders replaced by their data files.

    Raises
    ------
    InputError
        If a folder has none, a file is given twice, or two have one name.
    """
    found: list[Path] = []
    for path in paths:
        inside = tables_in(path) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"{path}: no data file in this folder. Known formats: {', '.join(TABLE_SUFFIXES)}.")
        found += inside
    names: dict[str, Path] = {}
    for path in found:
        if path in names.values():
            raise InputError(f"{path}: given twice. Give each file once.")
        if path.stem in names:
            raise InputError(f"{path}: {names[path.stem]} has the same name. Rename one.")
        names[path.stem] = path
    return found
