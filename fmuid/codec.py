"""Frozen dataclasses to JSON and back: enums are values; ``null`` is an unknown number, ``"inf"`` an unlimited one."""

from __future__ import annotations

import json
import math
import sys
import types
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np

from fmuid.errors import InputError
from fmuid.files import ContentError, replacing
from fmuid.formatting import bounded

Item = TypeVar("Item")
_UNLIMITED = {"inf": math.inf, "-inf": -math.inf}
_PLACE_SHOWN = 100  # characters


@dataclass(frozen=True)
class Layout:
    """Form of a class in JSON, as its attribute ``json_layout``.

    Fields `omitted` are not written: a reader may set them; otherwise they have defaults or are empty. Keys of fields
    `inlined` stand among those of the class. Properties `derived` are written, not read. `rows` are keys with a row per
    name of field `names`: column to field, property or mapping. `parts` are keys with other fields by new names.
    `types` are modules of names in annotations that are not imported.
    """

    omitted: AbstractSet[str] = frozenset()
    inlined: AbstractSet[str] = frozenset()
    derived: tuple[str, ...] = ()
    names: str = "names"
    rows: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    parts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)

    def elsewhere(self) -> set[str]:
        """Return the fields without a key of their own."""
        placed = {name for each in (*self.rows.values(), *self.parts.values()) for name in each.values()}
        return {*self.omitted, *self.inlined, *placed, *([self.names] if self.rows else [])}


def as_json(value: Any) -> Any:
    """Return a value for JSON, at all depths."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bool | int | str) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, np.ndarray | np.generic):
        return as_json(value.tolist())
    if isinstance(value, Mapping):
        return {str(as_json(key)): as_json(each) for key, each in value.items()}
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(value):
        return _object(value)
    return [as_json(each) for each in value]


def _object(value: Any) -> dict[str, Any]:
    layout = layout_of(type(value))
    found: dict[str, Any] = {}
    for name in layout.inlined:
        found |= _object(getattr(value, name))
    elsewhere = layout.elsewhere()
    for key, columns in layout.rows.items():
        whole = {column: getattr(value, name) for column, name in columns.items()}
        found[key] = {
            name: {
                column: as_json(values.get(name) if isinstance(values, Mapping) else values[i])
                for column, values in whole.items()
            }
            for i, name in enumerate(getattr(value, layout.names))
        }
    for key, parts in layout.parts.items():
        found[key] = {part: as_json(getattr(value, name)) for part, name in parts.items()}
    for name in (*layout.derived, *(each.name for each in fields(value))):
        if name not in elsewhere:
            found[name] = as_json(getattr(value, name))
    return found


def from_json(kind: type[Item], content: Any, place: str = "") -> Item:
    """Return the value of `as_json`; raise `ContentError` with the place for what does not fit."""
    found: Item = _value(kind, content, place)
    return found


def _value(kind: Any, content: Any, place: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    # what no JSON has, a reader put here
    made = isinstance(content, np.ndarray | tuple) or type(content).__name__ == "DataFrame"
    if kind is Any or kind is object or made:
        return content
    if origin in (Union, types.UnionType):
        return _first(arguments, content, place)
    if origin is Literal:
        return content if content in arguments else _refuse(place, content, f"one of {', '.join(map(str, arguments))}")
    if origin is np.ndarray:
        return _array(get_args(arguments[1])[0], content, place)
    if origin in (tuple, list, Sequence, frozenset):
        return _sequence(origin, arguments, content, place)
    if origin in (dict, Mapping):
        given = _object_of(content, place)
        pairs = ((_value(arguments[0], key, place), key) for key in given)
        return {name: _value(arguments[1], given[key], f"{place}.{key}") for name, key in pairs}
    if is_typeddict(kind):
        return _keys(kind, content, place)
    if is_dataclass(kind):
        return _instance(kind, content, place)
    if isinstance(kind, type) and issubclass(kind, Enum):
        known = [each.value for each in kind]
        return kind(content) if content in known else _refuse(place, content, f"one of {', '.join(map(str, known))}")
    return _scalar(kind, content, place)


def _scalar(kind: Any, content: Any, place: str) -> Any:
    if kind is float:
        if isinstance(content, str) and content in _UNLIMITED:
            return _UNLIMITED[content]
        if content is None:
            return math.nan
        if isinstance(content, bool) or not isinstance(content, int | float) or abs(content) > sys.float_info.max:
            return _refuse(place, content, "a number")
        return float(content)
    if kind is Path:
        return Path(content) if isinstance(content, str) else _refuse(place, content, "a path")
    wanted = {int: "a whole number", str: "a text", bool: "true or false"}[kind]
    fits = isinstance(content, kind) and (kind is bool or not isinstance(content, bool))
    return content if fits else _refuse(place, content, wanted)


def _first(kinds: Sequence[Any], content: Any, place: str) -> Any:
    """Return a value of the first kind that fits; integers come first."""
    if content is None and type(None) in kinds:
        return None
    kinds = sorted((each for each in kinds if each is not type(None)), key=lambda each: (each is float, each is str))
    for each in kinds[:-1]:
        with suppress(ContentError):
            return _value(each, content, place)
    return _value(kinds[-1], content, place)


def _sequence(origin: Any, arguments: tuple[Any, ...], content: Any, place: str) -> Any:
    given = content if isinstance(content, list) else _refuse(place, content, "a list")
    fixed = origin is tuple and arguments[1:] != (...,)
    if fixed and len(given) != len(arguments):
        _refuse(place, content, f"a list of {len(arguments)}")
    kinds = arguments if fixed else [arguments[0]] * len(given)
    values = (_value(kind, one, f"{place}[{i}]") for i, (kind, one) in enumerate(zip(kinds, given, strict=True)))
    return origin(values) if origin in (frozenset, list) else tuple(values)


def _keys(kind: Any, content: Any, place: str) -> dict[str, Any]:
    """Return a dictionary with exactly the keys of a TypedDict."""
    given = _object_of(content, place)
    hints = hints_of(kind)
    for name in sorted(kind.__required_keys__ - given.keys()):
        _miss(place, name)
    for name in sorted(given.keys() - hints.keys()):
        raise ContentError(f"it has {bounded(f'{place}.{name}'.lstrip('.'), _PLACE_SHOWN)!r}, which is no key there")
    return {name: _value(hints[name], each, f"{place}.{name}") for name, each in given.items()}


def _array(kind: Any, content: Any, place: str) -> Any:
    def plain(one: Any) -> Any:
        return [plain(each) for each in one] if isinstance(one, list) else _value(inner, one, place)

    inner = {"f": float, "i": int, "b": bool}[np.dtype(kind).kind]
    try:
        return np.array(plain(content if isinstance(content, list) else _refuse(place, content, "a list")), dtype=kind)
    except ValueError as error:
        if isinstance(error, ContentError):
            raise
        return _refuse(place, content, "rows of one length")


def _instance(kind: Any, content: Any, place: str) -> Any:
    given = _object_of(content, place)
    layout, hints = layout_of(kind), hints_of(kind)
    found = {name: _value(hints[name], content, place) for name in layout.inlined}
    elsewhere = layout.elsewhere() - layout.omitted
    for each in fields(kind):
        if each.init and each.name not in elsewhere:
            if each.name in given:
                found[each.name] = _value(hints[each.name], given[each.name], f"{place}.{each.name}")
            elif each.name in layout.omitted and is_required(each):
                found[each.name] = _empty(hints[each.name])
            elif is_required(each):
                _miss(place, each.name)
    for key, columns in layout.rows.items():
        found |= _columns(kind, given.get(key), f"{place}.{key}", columns)
    for key, parts in layout.parts.items():
        found |= _parts(kind, given.get(key), f"{place}.{key}", parts, found)
    try:
        return kind(**found)
    except (InputError, ValueError) as error:
        raise ContentError(f"{place.lstrip('.')}: {error}".removeprefix(": ")) from None


def _empty(kind: Any) -> Any:
    """Return an array or table without rows."""
    return np.empty(0, get_args(get_args(kind)[1])[0]) if get_origin(kind) is np.ndarray else kind()


def _parts(kind: Any, content: Any, place: str, parts: Mapping[str, str], known: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of an object of their own."""
    hints, default = hints_of(kind), {each.name for each in fields(kind) if not is_required(each)}
    if content is None and default.issuperset(parts.values()):
        return {}
    given = _object_of(content, place)
    found: dict[str, Any] = {}
    for part, name in parts.items():
        if part in given or name not in default:
            found[name] = _value(hints[name], given.get(part), f"{place}.{part}")
        if name in known and known[name] != found[name]:
            raise ContentError(f"{place.lstrip('.')}: the {part} differ from those of the rows")
    return found


def _columns(kind: Any, content: Any, place: str, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return the fields whose values stand in rows by name."""
    layout, hints = layout_of(kind), hints_of(kind)
    rows = _object_of(content, place)
    found: dict[str, Any] = {layout.names: tuple(rows)}
    for name, row in rows.items():
        _object_of(row, f"{place}.{name}")
    for column, field_name in columns.items():
        if field_name not in hints:
            continue  # a property
        if get_origin(hints[field_name]) in (dict, Mapping):
            inner = get_args(hints[field_name])[1]
            there = {name: row[column] for name, row in rows.items() if row.get(column) is not None}
            found[field_name] = {name: _value(inner, each, f"{place}.{name}.{column}") for name, each in there.items()}
        else:
            cells = [_value(float, row.get(column), f"{place}.{name}.{column}") for name, row in rows.items()]
            found[field_name] = np.array(cells, dtype=np.float64)
    return found


def is_required(each: Field[Any]) -> bool:
    """Return whether a field has no default."""
    return each.default is MISSING and each.default_factory is MISSING


def layout_of(kind: type) -> Layout:
    """Return the layout of a class."""
    found: Layout = getattr(kind, "json_layout", Layout())
    return found


@cache
def hints_of(kind: type) -> dict[str, Any]:
    """Return the types of the fields of a class."""
    names = {name: getattr(import_module(module), name) for name, module in layout_of(kind).types.items()}
    return get_type_hints(kind, localns=names)


def _miss(place: str, name: str) -> None:
    raise ContentError(f"it has no {f'{place}.{name}'.lstrip('.')!r}")


def _object_of(content: Any, place: str) -> dict[str, Any]:
    return content if isinstance(content, dict) else _refuse(place, content, "an object")


def _refuse(place: str, content: Any, wanted: str) -> Any:
    shown = bounded(place.lstrip(".") or "it", _PLACE_SHOWN)
    raise ContentError(f"{shown}: the value should be {wanted}, not {bounded(json.dumps(content, default=str), 60)}")


def write(path: Path, schema_name: str, content: Any, **more: Any) -> Path:
    """Write a JSON file whose first key names its schema; return its path."""
    return write_object(path, {"schema": schema_name, **as_json(content), **as_json(more)})


def write_object(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON file of values of `as_json`; return its path."""
    with replacing(path) as draft:
        draft.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    return path


def read(path: Path, schema_name: str, kind: type[Item], remedy: str) -> Item:
    """Return the content of a JSON file as a class; raise `InputError` with the remedy for another file."""
    return decoded(path, content_of(path, schema_name, remedy), kind, remedy)


def read_part(path: Path, schema_name: str, key: str, kind: type[Item], remedy: str) -> Item | None:
    """Return the value of one key, None without it; errors as in `read`."""
    part = content_of(path, schema_name, remedy).get(key)
    return None if part is None else decoded(path, part, kind, remedy, key)


def object_of(path: Path, remedy: str) -> dict[str, Any]:
    """Return the object of a JSON file; raise `InputError` with the remedy if it has none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({bounded(str(error), _PLACE_SHOWN)}): {remedy}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} has no JSON object: {remedy}")
    return content


def content_of(path: Path, schema_name: str, remedy: str) -> dict[str, Any]:
    """Return the object of a JSON file; errors as in `read`."""
    content = object_of(path, remedy)
    given = content.get("schema")
    if given != schema_name:
        of = f"of schema {bounded(str(given), 60)!r}" if given else "of no schema"
        raise InputError(f"{path} is {of}, not {schema_name!r}: {remedy}")
    return content


def decoded(path: Path, content: Any, kind: type[Item], remedy: str, place: str = "") -> Item:
    """Return the value of a file's content; errors as in `read`."""
    try:
        return from_json(kind, content, place)
    except (ContentError, RecursionError) as error:
        why = error if isinstance(error, ContentError) else "it is nested too deeply"
        raise InputError(f"{path} cannot be right: {why}; {remedy}") from None
