"""Frames of pandas in HDF5, in both layouts: pickles of names and time zones are read as plain values."""

from __future__ import annotations

import io
import pickle
import re
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmuid.data.cells import Array
from fmuid.data.readers.base import FileColumns, array_of_cells
from fmuid.errors import InputError

PANDAS_TYPE = "pandas_type"
"""Attribute of a group that pandas has written."""

_NAMED_ZONES = ("zoneinfo.ZoneInfo._unpickle", "pytz._p")
"""Functions that pickles of time zones call with the name of the zone."""


def read_frame(group: Any, source: str) -> FileColumns:
    """Read a frame; its index is a column if it has a name or dates."""
    kind = _attribute(group, PANDAS_TYPE)
    if kind not in ("frame", "frame_table"):
        raise InputError(f"{source}: {group.name!r} is no frame. Save a DataFrame.")
    frame = _Frame(group, source)
    return frame.of_table() if kind == "frame_table" else frame.of_blocks()


@dataclass(eq=False)
class PickledObject:
    """Object of a pickle by name, neither imported nor built."""

    name: str
    arguments: tuple[Any, ...] = ()
    state: Any = None

    def __call__(self, *arguments: Any) -> PickledObject:
        """Return the object of a call."""
        if self.name in ("__builtin__.getattr", "builtins.getattr"):
            owner, attribute = arguments
            return PickledObject(f"{owner.name}.{attribute}")
        return PickledObject(self.name, arguments)

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _NamesAlone(pickle.Unpickler):
    """Unpickler without imports (Python's documentation, "Restricting Globals")."""

    def find_class(self, module: str, name: str) -> PickledObject:
        """Return a class or function by its name."""
        return PickledObject(f"{module}.{name}")


def plain_value(data: bytes) -> Any:
    """Return the plain value of a pickle, or raise `ValueError`."""
    try:
        return _NamesAlone(io.BytesIO(data), encoding="latin-1").load()
    except Exception as error:  # of many kinds
        raise ValueError(str(error)) from None


class _Frame:
    """Group of one frame."""

    def __init__(self, group: Any, source: str) -> None:
        self._group, self._source = group, source
        self._encoding = str(_attribute(group, "encoding") or "UTF-8")

    def of_blocks(self) -> FileColumns:
        """Return the columns of layout ``fixed``: one matrix per type."""
        found: dict[str, tuple[Array, str | None]] = {}
        for k in range(int(_attribute(self._group, "nblocks"))):
            node, names = self._group[f"block{k}_values"], self._labels(f"block{k}_items")
            values = self._values(node, _attribute(node, "value_type"), names)
            zone = self._zone(_attribute(node, "tz"))
            columns = [values] if values.ndim == 1 else values.T
            found |= {name: (each, zone) for name, each in zip(names, columns, strict=True)}
        if _attribute(self._group, "axis1_variety") != "regular":
            raise self._refusal("its index", "levels")
        node = self._group["axis1"]
        index = self._values(node, _attribute(node, "kind"), ["index"]).ravel()
        zone = self._zone(_attribute(node, "tz"))
        columns_of = {each: found[each] for each in self._labels("axis0")}
        return _with_index(_attribute(node, "name"), index, zone, columns_of)

    def of_table(self) -> FileColumns:
        """Return the columns of layout ``table``: rows of index and typed blocks."""
        table, info = self._group["table"], _attribute(self._group, "info") or {}
        rows = table[()]
        found: dict[str, tuple[Array, str | None]] = {}
        for field in _attribute(self._group, "values_cols"):
            names = [str(name) for name in _attribute(table, f"{field}_kind")]
            if _attribute(table, f"{field}_meta") == "category":
                raise self._refusal(repr(names[0]), "categories")
            values = self._typed(rows[field], _attribute(table, f"{field}_dtype"), names)
            zone = self._zone(info.get(field, {}).get("tz"))
            columns = [values] if values.ndim == 1 else values.T
            found |= {name: (each, zone) for name, each in zip(names, columns, strict=True)}
        if _attribute(self._group, "levels") not in (None, 1, []):
            raise self._refusal("its index", "levels")
        ((_, labels),) = _attribute(self._group, "non_index_axes")
        ((_, field),) = _attribute(self._group, "index_cols")
        index, said = self._typed(rows[field], _attribute(table, f"{field}_kind"), ["index"]), info.get(field, {})
        columns_of = {str(each): found[str(each)] for each in labels}
        return _with_index(said.get("index_name"), index, self._zone(said.get("tz")), columns_of)

    def _labels(self, name: str) -> list[str]:
        if _attribute(self._group, f"{name}_variety") != "regular":
            raise self._refusal("its header", "levels")
        node = self._group[name]
        kind = _attribute(node, "kind")
        if kind not in ("string", "integer", "float"):
            labels = f"labels of the type {kind}" if isinstance(kind, str) else "Python objects"
            raise self._refusal("its header", labels)
        if _attribute(node, "shape") is not None:  # an axis without labels
            return []
        return [self._text(each) for each in node[()].tolist()]

    def _values(self, node: Any, kind: Any, names: list[str]) -> Array:
        """Return the values of a node, (K,) or (K, columns)."""
        if _attribute(node, "shape") is not None:  # of a table without rows
            return np.zeros((0, len(names)))
        if _attribute(node, "PSEUDOATOM") == "object":
            return self._objects(node[0].tobytes(), names)
        return self._typed(node[()], kind, names)

    def _typed(self, values: Array, kind: Any, names: list[str]) -> Array:
        kind = str(kind)
        if kind.startswith(("datetime64", "timedelta64")):
            return values.view(kind if kind.endswith("]") else f"{kind}[ns]")
        if kind.startswith("period") or kind in ("category", "date", "object"):
            raise self._refusal(repr(names[0]), {"category": "categories"}.get(kind, f"values of the type {kind}"))
        if values.dtype.kind == "S":
            return np.array([self._text(each) for each in values.ravel().tolist()], object).reshape(values.shape)
        if values.dtype.kind not in "biuf":
            raise self._refusal(repr(names[0]), f"values of the type {values.dtype}")
        return values

    def _objects(self, data: bytes, names: list[str]) -> Array:
        """Return the texts of a pickled array."""
        refusal = self._refusal(repr(names[0]), "Python objects")
        try:
            found = plain_value(data)
            (_, shape, _, by_columns, cells) = found.state
        except (AttributeError, TypeError, ValueError):
            raise refusal from None
        plain = isinstance(cells, list) and all(isinstance(each, str | bool | int | float | None) for each in cells)
        if not found.name.endswith("multiarray._reconstruct") or not plain:
            raise refusal
        return array_of_cells(cells).reshape(shape, order="F" if by_columns else "C")

    def _text(self, value: object) -> str:
        return value.decode(self._encoding, "replace") if isinstance(value, bytes) else str(value)

    def _zone(self, given: Any) -> str | None:
        if isinstance(given, PickledObject) and given.name == "datetime.timezone":
            days, seconds, _ = given.arguments[0].arguments
            minutes = round((days * 86_400 + seconds) / 60)
            return f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02}:{abs(minutes) % 60:02}"
        if isinstance(given, PickledObject) and given.name in _NAMED_ZONES:
            given = given.arguments[0]
        if given is None or isinstance(given, str):
            return given
        raise self._refusal("a column of dates", "a time zone that is stored as a Python object")

    def _refusal(self, where: str, what: str) -> InputError:
        said = f"{where} in {self._group.name!r} has {what}"
        return InputError(f"{self._source}: {said}. Save numbers, dates and texts only.")


def _with_index(name: Any, index: Array, zone: str | None, columns: dict[str, tuple[Array, str | None]]) -> FileColumns:
    """Return the columns, with an index of dates or with a name."""
    dated = index.dtype.kind in "mM"
    own = "time" if name is None and dated else name
    if own is not None and str(own) not in columns:
        columns = {str(own): (index, zone), **columns}
    headers = [re.sub(r"\s+", " ", each) for each in columns]
    return FileColumns(
        tuple(headers),
        tuple(values for values, _ in columns.values()),
        zones={k: zone for k, (_, zone) in enumerate(columns.values()) if zone is not None},
        time=headers.index("time") if dated and own == "time" else None,
    )


def _attribute(node: Any, name: str) -> Any:
    """Return an attribute of PyTables as a plain value."""
    value = node.attrs.get(name)
    if isinstance(value, bytes):
        if value.endswith(b"."):
            with suppress(ValueError):  # a text that ends with a full stop
                return plain_value(value)
        return value.decode("utf-8", "replace")
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float) else None
