"""MAT files of MATLAB; results of OpenModelica and Dymola (its User's Guide, "The MATv4 Result File Format")."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmuid.data.readers.base import FileColumns, columns_of_vectors
from fmuid.data.readers.hdf import vectors_of_hdf
from fmuid.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]


def read_mat(path: Path, source: str, _sheet: object) -> FileColumns:
    """Read numeric vectors of a MAT file, or variables of a result."""
    try:
        content = _content(path)
    except NotImplementedError:  # version 7.3 is HDF5
        return columns_of_vectors(source, vectors_of_hdf(path, source), {}, ".")
    if "Aclass" in content and content["Aclass"].dtype.kind == "U":
        return _result_columns(source, content)
    vectors = dict(_vectors(content))
    if not vectors and "MatlabOpaque" in str({value.dtype for value in content.values()}):
        said = "MATLAB tables and timetables are not readable"
        raise InputError(f"{source}: {said}. Use writetimetable, parquetwrite or vectors.")
    return columns_of_vectors(source, vectors, {}, ".")


def _content(path: Path) -> Arrays:
    from scipy.io import loadmat  # slow to import, and needed for this format only

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what else is in the file, such as functions and objects
        warnings.filterwarnings("error", r'Duplicate variable name "(?!None")|.*may be corrupt')
        # Characters stay single: names of a transposed result file stand in columns.
        content = loadmat(path, chars_as_strings=False)
    return {name: value for name, value in content.items() if isinstance(value, np.ndarray)}


def _vectors(arrays: Arrays, prefix: str = "") -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Yield numeric vectors by name, ``structure.field`` in structures."""
    for name, value in arrays.items():
        if value.dtype.names and value.size == 1:
            fields = value.ravel()[0]
            yield from _vectors({each: np.asarray(fields[each]) for each in value.dtype.names}, f"{prefix}{name}.")
        elif value.dtype.kind in "biuf" and value.size == max(value.shape, default=0):
            yield prefix + name, value.ravel()
        elif value.dtype.kind in "biuf" and value.ndim == 2:
            names = next((texts for texts in map(_names, arrays.values()) if len(texts) == value.shape[1]), [])
            yield from ((each, value[:, k]) for k, each in enumerate(names))


def _names(value: npt.NDArray[Any]) -> list[str]:
    """Return the texts of a cell array; none for other arrays."""
    cells: Any = value.ravel() if value.dtype.kind == "O" else []
    return ["".join(cell.ravel()).strip() for cell in cells if isinstance(cell, np.ndarray) and cell.dtype.kind == "U"]


def _result_columns(source: str, arrays: Arrays) -> FileColumns:
    """Return the variables of a result, Aclass 1.0 or 1.1; of rows at one time the first and last."""
    kind = ["".join(row).strip(" \0") for row in arrays["Aclass"]]
    if kind[0] != "Atrajectory" or len(kind) < 4 or kind[3] not in ("binTrans", "binNormal"):
        raise InputError(f"{source}: holds {kind[0]!r} data, no trajectories. Give a simulation result.")
    if kind[3] == "binTrans":
        arrays = {name: value if name == "Aclass" else value.T for name, value in arrays.items()}
    try:
        if "data" in arrays:  # version 1.0
            columns = {_text(name): arrays["data"][:, k] for k, name in enumerate(arrays["names"])}
        else:
            columns = _version_1_1(arrays)
    except (KeyError, IndexError, ValueError):
        raise InputError(f"{source}: incomplete result file. Simulate again.") from None
    names = ["time" if name.lower() == "time" else name for name in columns]
    if "time" not in names:
        raise InputError(f"{source}: no time in the result file. Simulate again.")
    values = list(columns.values())
    times = values[names.index("time")]
    inside = np.zeros(len(times), dtype=bool)
    inside[1:-1] = (times[1:-1] == times[:-2]) & (times[1:-1] == times[2:])
    return FileColumns(tuple(names), tuple(each[~inside] for each in values), units_in_headers=False)


def _version_1_1(arrays: Arrays) -> Arrays:
    """Return variables by dataInfo: matrix (1: constants in data_1) and column from 1, negative if negated."""
    samples = len(arrays["data_2"])
    columns: Arrays = {}
    for name, (matrix, place, *_) in zip(arrays["name"], arrays["dataInfo"].astype(int).tolist(), strict=True):
        values = arrays[f"data_{1 if matrix == 1 else 2}"][:, abs(place) - 1]
        values = np.full(samples, values[0]) if matrix == 1 else values
        columns[_text(name)] = -values if place < 0 else values
    return columns


def _text(characters: npt.NDArray[np.str_]) -> str:
    """Return a name; tools write UTF-8 bytes as MAT characters."""
    joined = "".join(characters).strip(" \0")
    try:
        return joined.encode("latin-1").decode("utf-8")
    except UnicodeError:  # from a tool that writes characters indeed
        return joined
