"""Bokeh models as plain data: Bokeh's own classes take seconds to validate a page."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bokeh.core.property.vectorization import Field as Field
from bokeh.core.property.vectorization import Value as Value
from bokeh.core.serialization import Serializer

from fmuid.reports.render.style import DARK

_NUMBERS = itertools.count(1)


class BokehSpec:
    """A Bokeh model by its name; its attributes are the properties set."""

    __slots__ = ("__dict__", "kind")

    def __init__(self, kind: str, **attributes: Any) -> None:
        self.kind = kind
        self.__dict__.update(attributes)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...


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
                return Field(field, of(transform))
            case Value(inner):
                return Value(of(inner, name))
            case str() if dark and name.endswith("color"):
                return DARK.get(value, value)
        return value

    return [of(figure) for figure in figures]


def written(figures: Sequence[BokehSpec]) -> tuple[list[Any], list[str]]:
    """Return figures as BokehJS JSON, and the id of each."""
    roots = Serializer(deferred=False).encode(list(figures))
    return roots, [root["id"] for root in roots]


def _json(model: BokehSpec, serializer: Serializer) -> dict[str, Any]:
    reference = {"id": f"sketch-{next(_NUMBERS)}"}
    serializer.add_ref(model, reference)
    told = {key: serializer.encode(each) for key, each in vars(model).items()}
    return {"type": "object", "name": model.kind, **reference, "attributes": told}


Serializer.register(BokehSpec, _json)
