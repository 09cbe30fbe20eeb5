"""Parquet and Feather by Arrow alone, without pandas' extension types and pickles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.cells import Array
from fmuid.data.readers.base import FileColumns, array_of_cells

_NO_DATE = np.iinfo(np.int64).min
"""NumPy's NaT."""


def read_parquet(path: Path, _source: str, _sheet: object) -> FileColumns:
    """Read a Parquet file."""
    import pyarrow.parquet

    with path.open("rb") as file:
        return _columns(pyarrow.parquet.ParquetFile(file).read())


def read_feather(path: Path, _source: str, _sheet: object) -> FileColumns:
    """Read a Feather file."""
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
    """Return a column as numbers, dates or cells; of nested types only the type name."""
    import pyarrow as pa
    from pyarrow import types

    kind = column.type
    if isinstance(kind, pa.BaseExtensionType):
        return _array(pa.chunked_array([each.storage for each in column.chunks], kind.storage_type))
    if types.is_dictionary(kind):
        return _array(column.cast(kind.value_type))
    if types.is_date(kind):
        return _array(column.cast(pa.timestamp("ms")))
    if types.is_timestamp(kind) or types.is_duration(kind):
        letter = "M" if types.is_timestamp(kind) else "m"
        return _values(column.cast(pa.int64()).fill_null(_NO_DATE)).view(f"{letter}8[{kind.unit}]")
    if types.is_boolean(kind) and not column.null_count:
        return _values(column.cast(pa.uint8())).astype(np.bool_)
    if types.is_decimal(kind) or (column.null_count and (types.is_boolean(kind) or types.is_integer(kind))):
        column = column.cast(pa.uint8()) if types.is_boolean(kind) else column
        return _array(column.cast(pa.float64(), safe=False))
    if types.is_integer(kind) or types.is_floating(kind):
        return _values(column.fill_null(np.nan) if column.null_count else column)
    if types.is_string(kind) or types.is_large_string(kind) or types.is_time(kind) or types.is_null(kind):
        return array_of_cells(column.to_pylist())
    return np.full(len(column), str(kind), dtype=object)


def _values(column: Any) -> Array:
    """Return numbers without missing ones; Arrow's own conversion would import pandas."""
    kind = np.dtype(column.type.to_pandas_dtype())
    filled = [each for each in column.chunks if len(each)]
    chunks = [np.frombuffer(each.buffers()[1], kind, len(each), each.offset * kind.itemsize) for each in filled]
    return np.concatenate([np.zeros(0, kind), *chunks])
