"""Vectors and matrices of a study, element by element: ``A[1,2]``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fmuid.errors import InputError
from fmuid.models import System
from fmuid.studies.value_kinds import refusal

MAX_DIMENSIONS = 8  # dimensions of an array; deeper lists are refused


def by_element(table: Any) -> Any:
    """Return a section with arrays replaced by their elements; bounds may be arrays, too."""
    if not isinstance(table, dict):
        return table
    found: dict[str, Any] = {}
    for name, given in table.items():
        rows = _rows(given)
        words = given if isinstance(given, dict) else {"value": given}
        if rows is not None and "prior" in words:
            raise refusal(f"{name!r}: an array takes no prior. Give each element its own, or use [prior].")
        for place in [()] if rows is None else _places(name, "start" if words is given else "the value", rows):
            element = name if rows is None else f"{name}[{','.join(str(k + 1) for k in place)}]"
            if element in found:
                raise refusal(f"{element!r} is given alone and in the array. Keep one of the two.")
            here = {key: _at(name, key, each, place) for key, each in words.items()}
            found[element] = given if rows is None else here if words is given else here["value"]
    return found


def _rows(given: Any) -> list[Any] | None:
    """Return the rows of an array or of a parameter's start."""
    rows = given.get("start") if isinstance(given, dict) else given
    return rows if isinstance(rows, list) else None


def _places(name: str, what: str, rows: list[Any], depth: int = 1) -> list[tuple[int, ...]]:
    """Return the indices, from 0, of all elements."""
    deep = depth > MAX_DIMENSIONS
    below = [_places(name, what, row, depth + 1) if isinstance(row, list) else [()] for row in rows if not deep]
    if not below or any(each != below[0] for each in below):
        raise refusal(f"{name!r}: {what} must be a number, a vector or a matrix with equal rows.")
    return [(k, *rest) for k, each in enumerate(below) for rest in each]


def _at(name: str, key: str, given: Any, place: Sequence[int]) -> Any:
    """Return the entry of one element; a single value is for all."""
    if not isinstance(given, list):
        return given
    for k in place:
        if not isinstance(given, list) or k >= len(given):
            raise refusal(f"{name!r}: {key} must be one value, or as many as start.")
        given = given[k]
    return given


def check_shapes(system: System, data: Mapping[str, Any], where: str) -> None:
    """Check arrays of a study or fault against the model."""
    for table, name, rows in _wholes(data):
        places = re.compile(re.escape(name) + r"\[(\d+(?:,\d+)*)\]")
        found = [match[1] for each in system.variables if (match := places.fullmatch(each))]
        there = tuple(map(max, zip(*([int(k) for k in each.split(",")] for each in found), strict=False)))
        given = _shape(rows)
        if name in system.variables and not found:
            raise InputError(f"{where}: {table}.{name}: {_said(given)} values given, but {system.label} has one.")
        if found and there != given:
            raise InputError(
                f"{where}: {table}.{name}: {_said(given)} values given, but {system.label} has {_said(there)}. "
                f'Give all, or single ones as "{name}[{found[0]}]".'
            )


def _wholes(data: Mapping[str, Any]) -> Iterator[tuple[str, str, list[Any]]]:
    """Yield section, name and rows of each array."""
    tables = {"model.fixed": data.get("model", {}).get("fixed", {}), "fixed": data.get("fixed", {})}
    tables |= {"parameters": data.get("parameters", {})}
    for k, each in enumerate(data.get("experiments", [])):
        tables[f"experiments[{k}].fixed"] = each.get("fixed", {})
    for table, entries in tables.items():
        yield from ((table, name, rows) for name, each in entries.items() if (rows := _rows(each)) is not None)


def _shape(rows: Any) -> tuple[int, ...]:
    return (len(rows), *_shape(rows[0])) if isinstance(rows, list) else ()


def _said(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))
