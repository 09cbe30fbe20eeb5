"""JSON schema and reference page of the study file.

``python -m fmuid.studies.schema > docs/study-reference.md`` writes the page.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import Annotated, Any, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from fmuid.studies.section import entries_of, keys_of, own_first, summary, table_of
from fmuid.studies.study_file import StudyFile
from fmuid.studies.toml import show
from fmuid.studies.value_kinds import ValueKind

HEAD = """# Keys of the study file

All sections and keys. `fmuid schema` prints the same for editors.
[The study file](study-file.md) shows examples. Paths are relative to the study file.
"""
SHORT = {
    r" in quotes|the path of a |\b(an?|the) ": "",
    "whole number": "integer",
    "(number )?above": ">",
    "(number)?, 0 or >": " ≥ 0",
}
"""Patterns in names of kinds, and what the page has in their place."""


class _Schema(GenerateJsonSchema):
    """Schema without null, which TOML lacks."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])


def schema() -> dict[str, Any]:
    """Return the JSON schema for editors."""
    found = StudyFile.model_json_schema(schema_generator=_Schema)
    return {"$schema": GenerateJsonSchema.schema_dialect, "title": "fmuid study file", **_plain(found)}


def _plain(value: Any) -> Any:
    """Return a schema without titles and empty defaults."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    said = {key: _plain(item) for key, item in value.items() if not (key == "title" and isinstance(item, str))}
    default = said.get("default", 0)
    if default in (None, "", math.inf, -math.inf) or isinstance(default, dict):
        del said["default"]
    return said


def reference() -> str:
    """Return the reference page, in Markdown; keys of several sections are explained once."""
    names = dict[type, list[str]]()
    for name, table in _tables(StudyFile, ""):
        names.setdefault(table, []).append(name)
    parts, shown = [HEAD], dict[str, str]()
    for table, (name, *others) in names.items():
        rows = {key: _row(key, each, name) for key, each in own_first(table)}
        rows = {key: row for key, row in rows.items() if name or " (section): " not in row}  # a heading says it
        again = dict[str, list[str]]()
        for key, row in rows.items():
            if shown.setdefault(row, name) != name:
                again.setdefault(shown[row], []).append(f"`{key}`")
        head = [f"## `{name}`", "", summary(table)] if name else ["## Top level"]
        head += [f"Also {', '.join(f'`{each}`' for each in others)}."] if others else []
        said = [f"Also {', '.join(keys)} as in `{where}`.\n" for where, keys in again.items()]
        own = [row for row in rows.values() if shown[row] == name]
        parts.append("\n".join([*head, "", *own, "", *said]))
    return "\n".join(parts)


def _row(key: str, field: FieldInfo, name: str) -> str:
    """Return the line of a key: kind, default and meaning."""
    kind = _kind(key, field, name)
    for long, short in SHORT.items():
        kind = re.sub(long, short, kind)
    given = ", ".join(each for each in (kind.strip(), _default(field)) if each)
    return f"- `{key}`{f' ({given})' if given else ''}: {field.description}"


def _tables(table: type, name: str) -> Iterator[tuple[str, type]]:
    yield name, table
    for key, each in keys_of(table).items():
        below = _below(key, each.annotation, name)
        if below is not None:
            yield from _tables(below[1], below[0])


def _below(key: str, type_: Any, above: str) -> tuple[str, type] | None:
    """Return name and class of the section below a key."""
    path = f"{above.strip('[]')}.{key}".lstrip(".")
    table = table_of(type_)
    if table is not None:
        return (f"[[{path}]]" if get_origin(type_) is list else f"[{path}]"), table
    table = table_of(entries_of(type_)) if entries_of(type_) is not None else None
    return None if table is None else (f"[{path}.<name>]", table)


def _kind(key: str, field: FieldInfo, above: str) -> str:
    below = _below(key, field.annotation, above)
    if below is not None:
        return "section"
    kinds = [each.name for each in field.metadata if isinstance(each, ValueKind)][-1:] or _kinds(field.annotation)
    return re.sub(",? or ", ", ", ", ".join(kinds)).replace("finite number", "number")


def _kinds(type_: Any) -> list[str]:
    """Return the names of the kinds of a type."""
    if get_origin(type_) is Annotated:
        own = [each.name for each in type_.__metadata__ if isinstance(each, ValueKind)]
        return own[-1:] or _kinds(get_args(type_)[0])
    return [] if get_origin(type_) in (list, dict) else [name for part in get_args(type_) for name in _kinds(part)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default: Any = field.default
    if is_dataclass(default) and any(each.is_required() for each in keys_of(default.__class__).values()):
        return f"default `{{ {', '.join(f'{key} = {show(value)}' for key, value in vars(default).items())} }}`"
    return "" if is_dataclass(default) or default in (None, "", [], (), {}) else f"default `{show(default)}`"


def schema_text() -> str:
    """Return the JSON schema as text."""
    return json.dumps(schema(), indent=2, allow_nan=False, ensure_ascii=False)


if __name__ == "__main__":
    print(reference(), end="")
