"""MAT files: of MATLAB in all versions, and the results of OpenModelica and Dymola."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmuid.data.formats.columns import FileColumns, columns_of_vectors
from fmuid.data.formats.hdf import vectors_of_hdf
from fmuid.data.formats.mat_file import check_mat
from fmuid.data.formats.simulation_results import result_columns
from fmuid.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]


def read_mat(path: Path, source: str) -> FileColumns:
    """Read a MAT file: its numeric vectors of the most common length, also those in structures.

    A matrix whose columns are named by a cell array of as many texts gives that many columns. MATLAB writes its own
    tables and timetables in a form that nobody else reads.

    Raises
    ------
    InputError
        Where the file cannot be read, or holds no vectors.
    """
    try:
        content = _content(path)
    except NotImplementedError:  # version 7.3 is HDF5
        return columns_of_vectors(source, vectors_of_hdf(path, source), {}, ".")
    if "Aclass" in content and content["Aclass"].dtype.kind == "U":
        return result_columns(source, content)
    vectors = dict(_vectors(content))
    if not vectors and "MatlabOpaque" in str({value.dtype for value in content.values()}):
        raise InputError(
            f"{source}: MATLAB's tables and timetables cannot be read from MAT files: write it with writetimetable or "
            "parquetwrite, or save its columns as vectors"
        )
    return columns_of_vectors(source, vectors, {}, ".")


def _content(path: Path) -> Arrays:
    from scipy.io import loadmat  # slow to import, and needed for this format only

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what else is in the file, such as functions and objects
        warnings.filterwarnings("error", r'Duplicate variable name "(?!None")|.*may be corrupt')
        check_mat(path)
        # Characters stay single: names of a transposed result file stand in columns.
        content = loadmat(path, chars_as_strings=False)
    return {name: value for name, value in content.items() if isinstance(value, np.ndarray)}


def _vectors(arrays: Arrays, prefix: str = "") -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Yield the numeric vectors by their names, and those in structures as ``structure.field``."""
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
    """Return the texts of a cell array of texts, none where it is something else."""
    cells: Any = value.ravel() if value.dtype.kind == "O" else []
    return ["".join(cell.ravel()).strip() for cell in cells if isinstance(cell, np.ndarray) and cell.dtype.kind == "U"]
