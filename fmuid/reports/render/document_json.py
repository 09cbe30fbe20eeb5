"""Documents as JSON: ``documents`` by kind; ``{"array": k}`` is array k of ``arrays`` (base64)."""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fmuid import codec
from fmuid.errors import InputError
from fmuid.files import is_file, replacing
from fmuid.reports.document import Document

DOCUMENT_FILE = "document.json"
SCHEMA = "fmuid/document/1"
AGAIN = "run the command again that has written it"
_DTYPES = {"float32": "<f4", "float64": "<f8"}


def write_documents(folder: Path, documents: Mapping[str, Document]) -> Path:
    """Write ``document.json`` of a folder; return its path."""
    path = folder / DOCUMENT_FILE
    with replacing(path) as draft:
        draft.write_text(to_json(documents), encoding="utf-8")
    return path


def kept_documents(folder: Path) -> dict[str, Document]:
    """Return the documents that earlier commands have left; none if the file is damaged: they can run again."""
    try:
        return read_documents(folder) if is_file(folder / DOCUMENT_FILE) else {}
    except InputError:
        return {}


def to_json(documents: Mapping[str, Document]) -> str:
    """Return documents as JSON."""
    arrays: list[np.ndarray[Any, Any]] = []
    content = {kind: _encoded(each, arrays, {}) for kind, each in documents.items()}
    packed = [
        {"dtype": each.dtype.name, "data": base64.b64encode(each.astype(_DTYPES[each.dtype.name]).tobytes()).decode()}
        for each in arrays
    ]
    return json.dumps({"schema": SCHEMA, "documents": content, "arrays": packed}, allow_nan=False) + "\n"


def table_json(document: Document) -> str:
    """Return a document without its charts as JSON."""
    plain = (dataclasses.replace(each, charts=(), zoom=None) for each in document.sections)
    return to_json({document.kind: dataclasses.replace(document, sections=tuple(plain))})


def read_documents(folder: Path) -> dict[str, Document]:
    """Return the documents of a folder by their kind."""
    path = folder / DOCUMENT_FILE
    if not is_file(path):
        raise InputError(f"{folder} has no {DOCUMENT_FILE}: give the folder that a command has written into")
    content = codec.content_of(path, SCHEMA, AGAIN)
    try:
        arrays = [np.frombuffer(base64.b64decode(each["data"]), _DTYPES[each["dtype"]]) for each in content["arrays"]]
        documents = _decoded(content["documents"], arrays)
    except (ValueError, RecursionError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{path} cannot be right: {type(error).__name__}: {error}; {AGAIN}") from None
    return codec.decoded(path, documents, dict[str, Document], AGAIN)


def _encoded(value: Any, arrays: list[np.ndarray[Any, Any]], known: dict[int, int]) -> Any:
    match value:
        case np.ndarray():
            if id(value) not in known:
                known[id(value)] = len(arrays)
                arrays.append(value if value.dtype.name in _DTYPES else value.astype(np.float64))
            return {"array": known[id(value)]}
        case Mapping():
            return {str(key): _encoded(each, arrays, known) for key, each in value.items()}
        case tuple() | list():
            return [_encoded(each, arrays, known) for each in value]
        case frozenset():
            return sorted(value)
        case None | bool() | int() | float() | str() | np.generic():
            return codec.as_json(value)
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {
                each.name: _encoded(found, arrays, known)
                for each in dataclasses.fields(value)
                if not callable(found := getattr(value, each.name)) and not _is_default(each, found)
            }
    return str(value)


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    if field.default_factory is not dataclasses.MISSING:
        return not value
    same: bool = type(value) is type(field.default) and value == field.default
    return same


def _decoded(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"array"}:
            return arrays[value["array"]]
        return {key: _decoded(each, arrays) for key, each in value.items()}
    return [_decoded(each, arrays) for each in value] if isinstance(value, list) else value
