"""JSON Schema of the files of `fmuid.codec`, from the same classes."""

from __future__ import annotations

import json
import re
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np

from fmuid.codec import hints_of, is_required, layout_of
from fmuid.estimation import RESULT_SCHEMA
from fmuid.runs.findings import IdentificationRun


def result_schema_text() -> str:
    """Return the JSON Schema of a ``result.json`` as text."""
    return json.dumps(schema(IdentificationRun, RESULT_SCHEMA), indent=2, ensure_ascii=False)


def schema(kind: type, schema_name: str) -> dict[str, Any]:
    """Return the JSON Schema of a class's files, described by docstrings."""
    known: dict[str, Any] = {}
    root = _schema(kind, known)
    own = {"schema": {"const": schema_name}}
    top = known[root["$ref"].rpartition("/")[2]]
    top["properties"], top["required"] = own | top["properties"], ["schema", *top["required"]]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **root, "$defs": known}


def _schema(kind: Any, known: dict[str, Any]) -> dict[str, Any]:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return {"anyOf": [_schema(each, known) for each in arguments]}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is np.ndarray:
        return {"type": "array", "items": {"anyOf": [_NUMBER, {"type": ["array", "integer", "boolean"]}]}}
    if origin is tuple and arguments[1:] != (...,):
        return {"type": "array", "prefixItems": [_schema(each, known) for each in arguments]}
    if origin in (tuple, list, Sequence, frozenset):
        return {"type": "array", "items": _schema(arguments[0], known)}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": _schema(arguments[1], known)}
    if is_typeddict(kind):
        properties = {name: _schema(each, known) for name, each in hints_of(kind).items()}
        return {"type": "object", "properties": properties, "required": sorted(kind.__required_keys__)}
    if is_dataclass(kind) and isinstance(kind, type):
        if kind.__name__ not in known:
            known[kind.__name__] = {}  # of a class that has itself as a field
            known[kind.__name__] = _object_schema(kind, known)
        return {"$ref": f"#/$defs/{kind.__name__}"}
    if isinstance(kind, type) and issubclass(kind, Enum):
        return {"enum": [each.value for each in kind]}
    return dict(_PLAIN.get(kind, {}))


_NUMBER = {"anyOf": [{"type": ["number", "null"]}, {"enum": ["inf", "-inf"]}]}
_PLAIN: dict[Any, dict[str, Any]] = {
    float: _NUMBER,
    int: {"type": "integer"},
    bool: {"type": "boolean"},
    str: {"type": "string"},
    Path: {"type": "string"},
    type(None): {"type": "null"},
}


def _object_schema(kind: type, known: dict[str, Any]) -> dict[str, Any]:
    layout, hints, told = layout_of(kind), hints_of(kind), _descriptions(kind)
    for name in {*layout.derived, *(name for each in layout.rows.values() for name in each.values())} - set(hints):
        found = getattr(kind, name)  # a property, which may keep its value
        getter = found.func if isinstance(found, cached_property) else found.fget
        hints = hints | {name: get_type_hints(getter)["return"]}
    elsewhere = layout.elsewhere()

    def described(name: str) -> dict[str, Any]:
        return _schema(hints[name], known) | ({"description": told[name]} if name in told else {})

    def cell(name: str) -> dict[str, Any]:
        inner = _schema(get_args(hints[name])[-1], known) if get_origin(hints[name]) in (dict, Mapping) else _NUMBER
        inner = {"type": "string"} if get_origin(hints[name]) is tuple else inner
        return inner | ({"description": told[name]} if name in told else {})

    own = [each for each in fields(kind) if each.name not in elsewhere]
    properties = {name: described(name) for name in (*(each.name for each in own), *layout.derived)}
    inlined = [_object_schema(hints[name], known) for name in layout.inlined]
    for each in inlined:
        properties = each["properties"] | properties
    for key, columns in layout.rows.items():
        row = {"type": "object", "properties": {column: cell(name) for column, name in columns.items()}}
        properties[key] = {"type": "object", "additionalProperties": row}
    for key, parts in layout.parts.items():
        properties[key] = {"type": "object", "properties": {part: described(name) for part, name in parts.items()}}
    required = [name for each in inlined for name in each["required"]]
    required += [*(each.name for each in own if is_required(each)), *layout.rows, *layout.parts]
    summary = (kind.__doc__ or "").split("\n\n")[0]
    return {"type": "object", "description": " ".join(summary.split()), "properties": properties, "required": required}


def _descriptions(kind: type) -> dict[str, str]:
    """Return the descriptions of attributes in the docstring of a class."""
    section = re.search(
        r"(?:Attributes|Parameters)\n\s*-+\n(.*?)(?:\n\s*\n\s*\w+\n\s*---|\Z)", kind.__doc__ or "", re.S
    )
    if section is None:
        return {}
    entries = re.findall(r"^ {4}(\w[\w, ]*?) : [^\n]*\n((?:(?: {8}[^\n]*)?\n?)*)", section[1] + "\n", re.M)
    return {
        name.strip(): " ".join(text.split()) for names, text in entries for name in names.split(",") if text.strip()
    }
