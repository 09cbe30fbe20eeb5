"""Read tables of measurements: CSV, Parquet, MAT, and the result files of OpenModelica and Dymola."""

from __future__ import annotations

import csv
import math
import re
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.data.mat_file import check_mat
from fmuid.errors import InputError
from fmuid.files import is_file, is_folder
from fmuid.text import nearest

_LISTED_NAMES = 12
"""Names listed in a message: enough to recognise the table, short enough for one sentence."""

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")


def read_table(path: Path | str, time: str = "time", *, source: str | None = None) -> pd.DataFrame:
    """Read a table of measurements.

    - ``.csv``: comma-separated, decimal points, UTF-8, names in the first line (names with commas in double quotes).
      Empty cells are missing samples; a row with fewer cells than there are names is refused.
    - ``.parquet``: an index named like the time column becomes a column.
    - ``.mat`` of MATLAB (v4 to v7): every numeric vector as long as the time vector becomes a column; the other
      arrays are left out.
    - ``.mat`` of OpenModelica and Dymola (results, "trajectory" files, stored either way round; the format is
      described in the OpenModelica User's Guide, "The MATv4 Result File Format"): every variable becomes a column.
      Parameters and constants become constant columns, because the tools store inputs that do not move as such.
      The time column is called `time` however the tool capitalises it. Of three or more rows at the time of an
      event the first and the last are kept: the values before and after.

    Parameters
    ----------
    path : Path or str
        The file; its suffix says the format.
    time : str
        Name of the time column, s.
    source : str, optional
        What the table is called in messages; default: its path.

    Returns
    -------
    pandas.DataFrame
        One row a sample, with a numeric column `time`. The other columns may hold anything: an `Experiment`
        checks those that it uses.

    Raises
    ------
    InputError
        Where the file is missing, unreadable, empty, of an unknown format, or has no numeric time column.
    """
    path = Path(path)
    source = source or str(path)
    readers = {".csv": _read_csv, ".parquet": _read_parquet, ".mat": _read_mat}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{source}: tables of the kind {path.suffix or 'without suffix'!r} are not read: "
            f"save it as one of {', '.join(readers)}"
        )
    if not is_file(path):
        raise InputError(
            f"{source}: {'this is a folder' if is_folder(path) else 'there is no such file'}: give a table"
        )
    try:
        frame = reader(path, time, source)
    except PermissionError:
        raise InputError(f"{source}: the file may not be read: change its permissions") from None
    if time not in frame.columns:
        raise InputError(f"{source}: {missing_column('time', time, frame.columns)}")
    if len(frame) == 0:
        raise InputError(f"{source}: the table has a header but no rows: give measured samples")
    numeric_column(frame, time, source)
    return frame


def missing_column(role: str, column: str, known: Iterable[object]) -> str:
    """Return the part of a sentence that says that a column is missing, with the nearest names or all of them."""
    names = [str(name) for name in known]
    listed = ", ".join(names[:_LISTED_NAMES]) + (", …" if len(names) > _LISTED_NAMES else "")
    found = nearest(column, names) or f" (there is {listed or 'nothing numeric'})"
    return f"the {role} column {column!r} is missing{found}: name the column that holds it"


def numeric_column(frame: pd.DataFrame, column: str, source: str) -> npt.NDArray[np.float64]:
    """Return a column as float64, NaN where it is missing.

    Parameters
    ----------
    frame : pandas.DataFrame
        The table.
    column : str
        A name in it, there once.
    source : str
        File name, for messages.

    Returns
    -------
    ndarray (K,)
        Booleans become 0 and 1; nullable and Arrow types are accepted.

    Raises
    ------
    InputError
        Where a cell holds text or anything else that is no real number; names the first such row (counted from 1,
        without the header).
    """
    series = frame[column]
    kind = series.dtype
    real = pd.api.types.is_bool_dtype(kind) or pd.api.types.is_numeric_dtype(kind)
    real = real and not pd.api.types.is_complex_dtype(kind)
    if not real and pd.api.types.is_object_dtype(kind):
        real = all(isinstance(cell, (int, float, np.number, np.bool_)) or cell is None for cell in series)
    if real:
        return series.to_numpy(dtype=np.float64, na_value=np.nan)
    if pd.api.types.is_datetime64_any_dtype(kind) or pd.api.types.is_timedelta64_dtype(kind):
        raise InputError(
            f"{source}: column {column!r} holds dates or durations ({kind}): convert it to numbers, times to seconds"
        )
    row, cell = _first_text(series)
    if _DECIMAL_COMMA.fullmatch(cell):
        remedy = "write numbers with decimal points"
    else:
        remedy = "give numbers only, and leave cells without a sample empty"
    raise InputError(f"{source}: column {column!r} holds {cell!r} in row {row}, which is no real number: {remedy}")


def _first_text(series: pd.Series[Any]) -> tuple[int, str]:
    """Return row (from 1) and text of the first cell that is no number (of the first cell, if all are)."""
    there = [pd.api.types.is_list_like(cell) or not pd.isna(cell) for cell in series]
    cells = [(row, cell) for row, (cell, given) in enumerate(zip(series, there, strict=True), start=1) if given]
    texts = [(row, str(cell)) for row, cell in cells if isinstance(cell, str | complex)]
    # read as the columns are: Python's float takes 1_000 and full-width digits as well
    numbers = pd.to_numeric(pd.Series([text for _, text in texts], dtype=object), errors="coerce")
    for place, number in zip(texts, numbers, strict=True):
        if math.isnan(number):
            return place
    return (cells[0][0], str(cells[0][1])) if cells else (1, "")


def _read_csv(path: Path, time: str, source: str) -> pd.DataFrame:
    try:
        rows = _csv_rows(path)
        header = [name.strip() for name in next(rows, [])]
        _check_csv_header(source, time, header, next(rows, []))
        frame = pd.read_csv(
            path,
            header=0,
            names=header,
            index_col=False,
            encoding="utf-8-sig",
            skipinitialspace=True,
            low_memory=False,
        )
        if frame[header[-1]].hasnans:  # as it is, too, where a row ends early
            _check_csv_rows(path, source, len(header))
    except UnicodeDecodeError:
        raise InputError(f"{source}: the file is no UTF-8 text: save it as a UTF-8 CSV file") from None
    except (csv.Error, pd.errors.ParserError) as error:
        raise InputError(
            f"{source}: the file is no CSV table ({str(error).strip()}): give every row as many cells as the header"
        ) from None
    return frame


def _csv_rows(path: Path) -> Iterator[list[str]]:
    """Yield the cells of each row, the header first; blank lines are no rows."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        yield from (row for row in csv.reader(file, skipinitialspace=True) if len(row) > 1 or "".join(row).strip())


def _check_csv_rows(path: Path, source: str, names: int) -> None:
    """Refuse rows with too few cells, which pandas fills up as if samples were missing."""
    for number, row in enumerate(_csv_rows(path)):
        if len(row) < names:
            raise InputError(
                f"{source}: the header has {names} names but row {number} has {_cells(len(row))}: give every row as "
                "many cells as the header, empty ones where samples are missing"
            )


def _cells(count: int) -> str:
    return f"{count} cell{'s' * (count != 1)}"


def _check_csv_header(source: str, time: str, header: list[str], first: list[str]) -> None:
    """Refuse what pandas would read silently as something else."""
    if not any(header):
        raise InputError(f"{source}: the table is empty: give a header with the names and rows of samples")
    if time not in header:
        for separator, word in ((";", "semicolons"), ("\t", "tabs")):
            if separator in "".join(header):
                raise InputError(
                    f"{source}: the table is separated by {word}: separate it by commas and write decimal points"
                )
        if all(_is_number(name) for name in header):
            raise InputError(f"{source}: the first line holds numbers: put the names there, {time!r} among them")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{source}: the column {name!r} is there twice: rename or remove one of the two")
    if first and len(first) != len(header):
        raise InputError(
            f"{source}: the header has {len(header)} names but row 1 has {len(first)} cells: give every row as many "
            f'cells as the header, names with commas in quotes, such as "x[1,2]", and write decimal points'
        )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_parquet(path: Path, time: str, source: str) -> pd.DataFrame:
    try:
        frame = pd.read_parquet(path, engine="pyarrow")
    except PermissionError:
        raise
    except Exception:  # pyarrow's own errors are few, but on broken files there are others, even KeyError
        raise InputError(f"{source}: the file is no readable Parquet table: write it again") from None
    return frame.reset_index() if frame.index.name == time and time not in frame.columns else frame


def _read_mat(path: Path, time: str, source: str) -> pd.DataFrame:
    from scipy.io import loadmat  # slow to import, and needed for this format only

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what else is in the file, such as functions and objects
            warnings.filterwarnings("error", r'Duplicate variable name "(?!None")|.*may be corrupt')
            # Characters stay single: names of a transposed result file stand in columns.
            check_mat(path)
            content = loadmat(path, chars_as_strings=False)
    except PermissionError:
        raise
    except NotImplementedError:
        raise InputError(
            f"{source}: MAT files of version 7.3 are not read: save it by save(…, '-v7') in MATLAB, or as CSV"
        ) from None
    except Exception:  # scipy raises errors of many kinds, on broken files even TypeError and struct.error
        raise InputError(f"{source}: the file is no readable MAT file: write it again") from None
    arrays = {name: value for name, value in content.items() if isinstance(value, np.ndarray)}
    if "Aclass" in arrays and arrays["Aclass"].dtype.kind == "U":
        return _result_frame(source, arrays, time)
    vectors = {
        name: value.ravel()
        for name, value in arrays.items()
        if value.dtype.kind in "biuf" and value.size == max(value.shape, default=0)
    }
    if time not in vectors:
        raise InputError(f"{source}: {missing_column('time', time, vectors)}")
    length = vectors[time].size
    return pd.DataFrame({name: value for name, value in vectors.items() if value.size == length})


def _result_frame(source: str, arrays: dict[str, npt.NDArray[Any]], time: str) -> pd.DataFrame:
    """Return the table in a result file of OpenModelica or Dymola (Aclass version 1.1, and 1.0 of Dymola's export)."""
    kind = ["".join(row).strip(" \0") for row in arrays["Aclass"]]
    if kind[0] != "Atrajectory" or len(kind) < 4 or kind[3] not in ("binTrans", "binNormal"):
        raise InputError(f"{source}: the file holds {kind[0]!r} data and no trajectories: give a simulation result")
    if kind[3] == "binTrans":
        arrays = {name: value if name == "Aclass" else value.T for name, value in arrays.items()}
    try:
        columns = _version_1_0(arrays) if "data" in arrays else _version_1_1(arrays)
    except (KeyError, IndexError, ValueError):
        raise InputError(f"{source}: the result file is incomplete: simulate again") from None
    names = [time if name.lower() == time.lower() else name for name in columns]
    frame = pd.DataFrame(dict(zip(names, columns.values(), strict=True)))
    if time not in frame.columns:
        raise InputError(f"{source}: {missing_column('time', time, names)}")
    times = frame[time].to_numpy()
    inside = np.zeros(len(times), dtype=bool)
    inside[1:-1] = (times[1:-1] == times[:-2]) & (times[1:-1] == times[2:])
    return frame[~inside].reset_index(drop=True)


def _version_1_0(arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    return {_text(name): arrays["data"][:, k] for k, name in enumerate(arrays["names"])}


def _version_1_1(arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Take each variable from where dataInfo says.

    Column 1 of dataInfo is the matrix: 0 for time, 1 for data_1 (constants: their start and stop values), 2 for
    data_2 (one row a sample, time first). Column 2 is the column there, from 1, negative for a negated alias.
    """
    samples = len(arrays["data_2"])
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, info in zip(arrays["name"], arrays["dataInfo"].astype(int), strict=True):
        matrix, place = int(info[0]), int(info[1])
        if matrix == 1:
            values = np.full(samples, arrays["data_1"][0, abs(place) - 1])
        else:
            values = arrays["data_2"][:, abs(place) - 1]
        columns[_text(name)] = -values if place < 0 else values
    return columns


def _text(characters: npt.NDArray[np.str_]) -> str:
    """Join single characters to a name; the tools write UTF-8 bytes, which the MAT format takes for characters."""
    joined = "".join(characters).strip(" \0")
    try:
        return joined.encode("latin-1").decode("utf-8")
    except UnicodeError:
        return joined
