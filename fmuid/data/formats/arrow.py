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
    if types.is_date(kind):
        return _array(column.cast(pa.timestamp("ms")))
    if types.is_decimal(kind):
        return _array(column.cast(pa.float64()))
    if types.is_boolean(kind) and column.null_count:
        return _array(column.cast(pa.uint8()))
    if types.is_primitive(kind) and not types.is_time(kind):
        found: Array = column.to_numpy()
        return found
    if types.is_string(kind) or types.is_large_string(kind) or types.is_time(kind) or types.is_null(kind):
        return array_of_cells(column.to_pylist())
    return np.full(len(column), str(kind), dtype=object)
