"""Parquet and Feather, read by Arrow alone: pandas' extension types and pickles take no part."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.formats.columns import Array, FileColumns, array_of_cells


def read_parquet(path: Path, source: str) -> FileColumns:  # noqa: ARG001  # readers have one signature
    """Read a Parquet table; a named or dated index of pandas becomes a column."""
    import pyarrow.parquet

    with path.open("rb") as file:
        return _columns(pyarrow.parquet.ParquetFile(file).read())


def read_feather(path: Path, source: str) -> FileColumns:  # noqa: ARG001
    """Read a Feather table; a named or dated index of pandas becomes a column."""
    import pyarrow.feather

    return _columns(pyarrow.feather.read_table(path, memory_map=False))


def _columns(table: Any) -> FileColumns:
    from pyarrow import types

    table.validate(full=True)
    metadata = json.loads((table.schema.metadata or {}).get(b"pandas", b"{}"))
    indices = [each for each in metadata.get("index_columns", []) if isinstance(each, str)]
    said = {each.get("field_name"): each.get("name") for each in metadata.get("columns", [])}
    found: list[tuple[str, int]] = []
    time = None
    for k, field in sorted(enumerate(table.column_names), key=lambda each: each[1] not in indices):
        kind, name = table.field(k).type, said.get(field) if field in indices else field
        if name is None and (types.is_timestamp(kind) or types.is_duration(kind)):
            name, time = "time", len(found)
        if name is not None and (name == field or name not in table.column_names):
            found.append((name, k))
    kinds = [table.field(k).type for _, k in found]
    zones = {k: str(kind.tz) for k, kind in enumerate(kinds) if types.is_timestamp(kind) and kind.tz}
    values = tuple(_array(table.column(k)) for _, k in found)
    return FileColumns(tuple(name for name, _ in found), values, zones=zones, time=time)


def _array(column: Any) -> Array:
    """Return a column as numbers, dates, durations or cells; of a nested type only its name, which is no number."""
    import pyarrow as pa
    from pyarrow import types

    kind = column.type
    if isinstance(kind, pa.BaseExtensionType):
        return _array(pa.chunked_array([each.storage for each in column.chunks], kind.storage_type))
    if types.is_dictionary(kind):
        return _array(column.cast(kind.value_type))
    if types.is_decimal(kind):
        return _array(column.cast(pa.float64()))
    letter = next((each for each, holds in _LETTERS.items() if getattr(types, holds)(kind)), None)
    if letter is not None:
        chunks = [_numbers(each, letter) for each in column.chunks]
        return np.concatenate(chunks) if chunks else np.zeros(0)
    if types.is_string(kind) or types.is_large_string(kind) or types.is_time(kind) or types.is_null(kind):
        return array_of_cells(column.to_pylist())
    return np.full(len(column), str(kind), dtype=object)


_LETTERS = {
    "?": "is_boolean",
    "i": "is_signed_integer",
    "u": "is_unsigned_integer",
    "f": "is_floating",
    "M": "is_timestamp",
    "m": "is_duration",
    "D": "is_date",
}
"""Kinds of numbers, and what Arrow calls the question."""


def _numbers(array: Any, letter: str) -> Array:
    """Return an array of numbers; Arrow's own conversion would import pandas."""
    there, data = array.buffers()
    if not len(array):
        return np.zeros(0)
    if letter == "?":
        found = _bits(data, array)
    else:
        width = array.type.bit_width // 8
        kind = f"{letter if letter in 'uf' else 'i'}{width}"
        found = np.frombuffer(data, kind, len(array), array.offset * width)
    if letter in "mM":
        found = found.view(f"{letter}8[{array.type.unit}]")
    elif letter == "D":
        found = found.astype(np.int64).view("M8[D]" if array.type.bit_width == 32 else "M8[ms]")
    if not array.null_count:
        return found
    missing = np.datetime64("NaT") if found.dtype.kind == "M" else np.timedelta64("NaT") if letter == "m" else np.nan
    return np.where(_bits(there, array), found if letter in "mMD" else found.astype(np.float64), missing)


def _bits(data: Any, array: Any) -> Array:
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
    return bits[array.offset : array.offset + len(array)].astype(np.bool_)
