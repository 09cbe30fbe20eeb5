"""Files of results in which the type of a value has changed."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np

OTHERS: tuple[Any, ...] = (None, True, 7, -1.5, "text", [], ["text"], [1.0, 2.0], {}, {"key": [1]}, [[{}]])
"""Values that stand where another one stood."""


def _places(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the places of all values of a JSON document, at all depths."""
    if place:
        yield place
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in pairs:
        yield from _places(value, (*place, key))


def with_changed_type(content: dict[str, Any], rng: np.random.Generator) -> tuple[dict[str, Any], str]:
    """Return a document with one value of another type, and where it is; all keys of a depth are as likely."""
    places = list(_places(content))
    depth = rng.choice(sorted({len(place) for place in places}))
    some = [place for place in places if len(place) == depth]
    place = some[int(rng.integers(len(some)))]
    found = copy.deepcopy(content)
    within: Any = found
    for key in place[:-1]:
        within = within[key]
    others = [each for each in OTHERS if type(each) is not type(within[place[-1]])]
    within[place[-1]] = copy.deepcopy(others[int(rng.integers(len(others)))])
    return found, f"{'.'.join(map(str, place))} = {within[place[-1]]!r}"
