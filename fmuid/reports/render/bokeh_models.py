"""Bokeh models as plain data: Bokeh's own classes take seconds to validate a page."""

from __future__ import annotations

import base64
import gzip
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.reports.render.style import DARK

_NUMBERS = itertools.count(1)
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))


class BokehSpec:
    """A Bokeh model by its name; its attributes are the properties set."""

    __slots__ = ("__dict__", "kind")

    def __init__(self, kind: str, **attributes: Any) -> None:
        self.kind = kind
        self.__dict__.update(attributes)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...


@dataclass(frozen=True)
class Field:
    """A column of a source, and the colors that it goes through."""

    field: str
    transform: BokehSpec | None = None


@dataclass(frozen=True)
class Value:
    """A constant in place of a column."""

    value: object


def live(figures: Sequence[BokehSpec], *, dark: bool = False) -> list[Any]:
    """Return figures as Bokeh's own models, for a server."""
    from bokeh import models as library

    made: dict[int, Any] = {}

    def of(value: Any, name: str = "") -> Any:
        match value:
            case BokehSpec():
                if id(value) not in made:
                    told = {key: of(each, key) for key, each in vars(value).items()}
                    made[id(value)] = getattr(library, value.kind)(**told)
                return made[id(value)]
            case list() | tuple():
                return type(value)(of(each) for each in value)
            case Field(field, transform):
                return field if transform is None else {"field": field, "transform": of(transform)}
            case Value(inner):
                return {"value": of(inner, name)} if isinstance(inner, str) else inner
            case str() if dark and name.endswith("color"):
                return DARK.get(value, value)
        return value

    return [of(figure) for figure in figures]


def written(figures: Sequence[BokehSpec]) -> tuple[list[Any], list[str]]:
    """Return figures as BokehJS JSON, and the id of each."""
    ids: dict[int, str] = {}
    roots = [_json(figure, ids) for figure in figures]
    return roots, [root["id"] for root in roots]


def _json(value: Any, ids: dict[int, str]) -> Any:
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return (
                value
                if math.isfinite(value)
                else {"type": "number", "value": "nan" if math.isnan(value) else f"{value:+}"}
            )
        case np.generic():
            return _json(value.item(), ids)
        case BokehSpec():
            if id(value) in ids:
                return {"id": ids[id(value)]}
            ids[id(value)] = name = f"sketch-{next(_NUMBERS)}"
            told = {key: _json(each, ids) for key, each in vars(value).items()}
            return {"type": "object", "name": value.kind, "id": name, "attributes": told}
        case Field(field, transform):
            told = {"type": "field", "field": field}
            return told if transform is None else told | {"transform": _json(transform, ids)}
        case Value(inner):
            return {"type": "value", "value": _json(inner, ids)}
        case dict():
            return {"type": "map", "entries": [[key, _json(each, ids)] for key, each in value.items()]}
        case np.ndarray():
            return _array(value, ids)
    return [_json(each, ids) for each in value]


def _array(values: np.ndarray[Any, Any], ids: dict[int, str]) -> Any:
    if values.dtype.kind not in "fiu":
        return [_json(each, ids) for each in values.tolist()]
    if values.dtype not in _FLOATS:
        values = values.astype(np.float64)
    packed = gzip.compress(values.astype(values.dtype.newbyteorder("<")).tobytes(), compresslevel=6, mtime=1)
    told = {"type": "bytes", "data": base64.b64encode(packed).decode()}
    return {
        "type": "ndarray",
        "array": told,
        "shape": list(values.shape),
        "dtype": values.dtype.name,
        "order": "little",
    }
