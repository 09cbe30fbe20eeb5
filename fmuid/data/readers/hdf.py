"""HDF5: vectors in groups, compound vectors, frames of pandas, MATLAB 7.3."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.cells import Array
from fmuid.data.readers.base import FileColumns, chosen, columns_of_vectors, library
from fmuid.data.readers.pandas_hdf import PANDAS_TYPE, read_frame
from fmuid.errors import InputError

_NAME_ATTRIBUTES = ("columns", "column_names", "names")
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")


def read_hdf(path: Path, source: str, frame: str | int | None) -> FileColumns:
    """Read a frame (by key or place from 1), or vectors."""
    with _opened(path, source) as file:
        objects = _objects(file)
        found = [name for name, each in objects if PANDAS_TYPE in each.attrs]
        outer = [name for name in found if not name.startswith(tuple(f"{each}/" for each in found))]
        frames = {name: each for name, each in objects if name in outer}
        if len(frames) > 1 and frame is None:
            raise InputError(f"{source}: several frames: {', '.join(frames)}. Choose one by sheet.")
        try:
            if frames:
                return read_frame(frames[chosen([*frames], 1 if frame is None else frame, source)], source)
            return columns_of_vectors(source, *_vectors(objects), "/")
        except OSError:
            _check_compression(objects, source)
            raise


def variables_of_hdf(path: Path, source: str) -> dict[str, Any]:
    """Return the variables of a MAT file of version 7.3: arrays, texts, lists of cells, mappings of structures."""
    with _opened(path, source) as file:
        return {name: _variable(file, item) for name, item in file.items() if not name.startswith("#")}


def _variable(file: Any, item: Any) -> Any:
    if not hasattr(item, "shape"):
        fields = {name: _variable(file, each) for name, each in item.items()}
        lists = [each for each in fields.values() if isinstance(each, list)]
        if len(lists) == len(fields) and len({len(each) for each in lists}) == 1:  # an array of structures
            return [dict(zip(fields, each, strict=True)) for each in zip(*lists, strict=True)]
        return fields
    if item.dtype.kind == "O":
        return [_variable(file, file[each]) for each in item[()].ravel()]
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, item[()].ravel()))
    return np.transpose(item[()]) if item.ndim == 2 else item[()]


def _objects(file: Any) -> list[tuple[str, Any]]:
    """Return all groups and datasets by path, each once."""
    found: list[tuple[str, Any]] = []
    file.visititems(lambda name, item: found.append((name, item)))
    return found


def _check_compression(objects: list[tuple[str, Any]], source: str) -> None:
    """Refuse datasets with filters that are not installed, such as blosc."""
    from h5py.h5z import filter_avail

    for path, item in objects:
        if not hasattr(item, "shape"):
            continue
        filters = item.id.get_create_plist()
        for k in range(filters.get_nfilters()):
            code, *_, name = filters.get_filter(k)
            if not filter_avail(code):
                said = f"{path!r} is compressed by {name.decode(errors='replace')}, which is not installed"
                raise InputError(f"{source}: {said}. Save it with zlib or uncompressed.")


def _vectors(objects: list[tuple[str, Any]]) -> tuple[dict[str, Array], dict[str, str]]:
    datasets = [(path, item) for path, item in objects if hasattr(item, "shape")]  # no groups or types
    found = [each for path, item in datasets for each in _of_dataset(path, item)]
    return {name: value for name, value, _ in found}, {name: unit for name, _, unit in found if unit}


def _of_dataset(path: str, item: Any) -> Iterator[tuple[str, Array, str]]:
    """Yield name, values and unit of each numeric vector."""
    prefix = path[: path.rfind("/") + 1]
    if item.dtype.names and item.ndim == 1:
        values = item[()]
        yield from ((prefix + field, values[field], "") for field in item.dtype.names if values[field].ndim == 1)
    elif item.dtype.kind in "biufS" and item.ndim and item.size == max(item.shape):
        yield path, _decoded(item[()].ravel()), _unit(item)
    elif item.dtype.kind in "biuf" and item.ndim == 2:
        named = next((item.attrs[each] for each in _NAME_ATTRIBUTES if each in item.attrs), ())
        if len(named) == item.shape[1]:
            texts = [each.decode() if isinstance(each, bytes) else str(each) for each in named]
            yield from ((prefix + each, item[:, k], "") for k, each in enumerate(texts))


def _decoded(values: Array) -> Array:
    return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values


def _unit(item: Any) -> str:
    found = next((item.attrs[name] for name in _UNIT_ATTRIBUTES if name in item.attrs), "")
    return found.decode() if isinstance(found, bytes) else str(found)


def _opened(path: Path, source: str) -> Any:
    h5py = library("h5py", "hdf", source)
    try:
        return h5py.File(path, "r")
    except OSError:  # said of MAT files too, whose version 7.3 is HDF5
        raise InputError(f"{source}: not a readable HDF5 file. Write it again.") from None
