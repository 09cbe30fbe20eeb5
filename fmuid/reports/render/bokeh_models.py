"""Models of Bokeh's library as data, without Bokeh's own models.

Those check, default and observe every property, as a server needs it; a page that is only written would pay seconds
for that. `written` turns models into the JSON that the library in a browser reads, `live` into Bokeh's own, which know
and check all names.
"""

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
    """A model by its name in Bokeh; its attributes are what is set of it."""

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
    """A value where a column could stand."""

    value: object


def live(figures: Sequence[BokehSpec], *, dark: bool = False) -> list[Any]:
    """Return figures as Bokeh's own models, for a server; what several share is shared.

    Parameters
    ----------
    figures : sequence of BokehSpec
        Models of Bokeh in them stay as they are.
    dark : bool
        Whether the page is dark: pages without a server exchange colors by a script of their own.

    Raises
    ------
    AttributeError, ValueError
        If Bokeh has no such model, property or value.
    """
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
    """Return figures as JSON that Bokeh's library in a browser reads, and the id of each."""
    ids: dict[int, str] = {}
    roots = [_json(figure, ids) for figure in figures]
    return roots, [root["id"] for root in roots]


def _json(value: Any, ids: dict[int, str]) -> Any:
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else {"type": "number", "value": _beyond(value)}
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


def _beyond(value: float) -> str:
    return "nan" if math.isnan(value) else "+inf" if value > 0 else "-inf"


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
