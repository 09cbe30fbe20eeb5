"""HDF5: vectors in groups, tables with named fields, tables of pandas; MATLAB's version 7.3 is HDF5 too."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.data.formats.columns import RawTable, named, table_of_vectors
from fmuid.data.formats.libraries import library
from fmuid.errors import InputError

_NAME_ATTRIBUTES = ("columns", "column_names", "names")
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")


def read_hdf(path: Path, source: str) -> RawTable:
    """Read the vectors of the most common length in an HDF5 file, with their attribute ``unit`` or ``units``.

    Raises
    ------
    InputError
        Where the file cannot be read, a library is missing, or there are no vectors of one length.
    """
    with _opened(path, source) as file:
        of_pandas = [name for name, group in file.items() if "pandas_type" in group.attrs]
    if of_pandas:
        return _of_pandas(path, source, of_pandas[0])
    return table_of_vectors(source, *_vectors(path, source), "/")


def vectors_of_hdf(path: Path, source: str) -> dict[str, npt.NDArray[Any]]:
    """Return the numeric vectors of a MAT file of version 7.3, those of structures as ``structure.field``."""
    vectors, _ = _vectors(path, source)
    return {name.replace("/", "."): value for name, value in vectors.items() if not name.startswith("#")}


def _vectors(path: Path, source: str) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    vectors: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    with _opened(path, source) as file:
        for name, value, unit in _datasets(file):
            vectors[name] = value
            if unit:
                units[name] = unit
    return vectors, units


def _datasets(group: Any, prefix: str = "") -> Iterator[tuple[str, npt.NDArray[Any], str]]:
    """Yield name, values and unit of each numeric vector; also of compound ones and of matrices with names."""
    for name, item in group.items():
        if hasattr(item, "items"):
            yield from _datasets(item, f"{prefix}{name}/")
            continue
        if item.dtype.names and item.ndim == 1:
            values = item[()]
            yield from ((prefix + field, values[field], "") for field in item.dtype.names if values[field].ndim == 1)
        elif item.dtype.kind in "biufS" and item.ndim and item.size == max(item.shape):
            yield prefix + name, _decoded(item[()].ravel()), _unit(item)
        elif item.dtype.kind in "biuf" and item.ndim == 2:
            named = next((item.attrs[each] for each in _NAME_ATTRIBUTES if each in item.attrs), ())
            if len(named) == item.shape[1]:
                texts = [each.decode() if isinstance(each, bytes) else str(each) for each in named]
                yield from ((prefix + each, item[:, k], "") for k, each in enumerate(texts))


def _decoded(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values


def _unit(item: Any) -> str:
    found = next((item.attrs[name] for name in _UNIT_ATTRIBUTES if name in item.attrs), "")
    return found.decode() if isinstance(found, bytes) else str(found)


def _opened(path: Path, source: str) -> Any:
    h5py = library("h5py", "hdf", source)
    try:
        return h5py.File(path, "r")
    except OSError:
        raise InputError(f"{source}: the file is no readable HDF5 file: write it again") from None


def _of_pandas(path: Path, source: str, key: str) -> RawTable:
    library("tables", "hdf", source)
    frame = pd.read_hdf(path, key)
    if not isinstance(frame, pd.DataFrame):
        raise InputError(f"{source}: {key!r} is no table: save a DataFrame")
    kept = frame.reset_index() if frame.index.name else frame
    names, units = named([re.sub(r"\s+", " ", str(name)) for name in kept.columns])
    return RawTable(kept.set_axis(names, axis="columns"), units)
