"""The study that a result was made by: kept in its ``result.json``, and read from there."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fmuid.errors import InputError
from fmuid.files import content_of, is_file, is_folder
from fmuid.studies import Study, override

RESULT_FILE = "result.json"
# JSON has no infinite numbers, and a study may: they are an object with this key.
NUMBER = "number:"


def origin_of(study: Study, folder: Path) -> dict[str, Any]:
    """Return what a ``result.json`` in a folder keeps of its study: the file, relative to the folder, and its content.

    The content is that with which the study was run, values put in place of the file's included.
    """
    try:
        file = os.path.relpath(study.path.resolve(), folder.resolve())
    except ValueError:  # on another drive
        file = str(study.path.resolve())
    return {"file": Path(file).as_posix(), "content": _mapped(study.data, _as_json)}


def study_of(
    result: Path,
    overrides: Sequence[str] = (),
    *,
    isolated: bool = False,
    in_place: Path | None = None,
) -> Study:
    """Return the study that a result was made by, as it was then.

    Parameters
    ----------
    result : Path
        The ``result.json``, or the folder that has it.
    overrides, isolated
        As for `Study.read`.
    in_place : Path, optional
        A file that stands for tables of the study that are no longer there.

    Raises
    ------
    InputError
        If the file cannot be read or does not say by which study it was made, or a file that the study names is gone.
    """
    path = result_path(result)
    with content_of(path, "the result.json of an identification", "name the study file with --study") as kept:
        origin = kept.get("study")
        if not isinstance(origin, dict) or not isinstance(origin.get("content", {}), dict):
            raise InputError(f"{path} does not say by which study it was made: name the study file with --study")
        file, data = path.parent / str(kept["study"]["file"]), _mapped(kept["study"]["content"], _of_json)
    file = Path(os.path.normpath(file))
    for setting in overrides:
        override(data, setting, str(file))
    if in_place is not None:
        given = data.get("experiments")
        for experiment in given if isinstance(given, list) else ():  # `Study.of` refuses another type
            if isinstance(experiment, dict) and not is_file(file.parent / str(experiment.get("data", ""))):
                experiment["data"] = str(in_place.resolve())
    return Study.of(data, file, isolated=isolated)


def result_path(given: Path) -> Path:
    """Return the ``result.json`` of a path that is it, or the folder that has it.

    Raises
    ------
    InputError
        If there is none.
    """
    path = given / RESULT_FILE if is_folder(given) else given
    if not is_file(path):
        raise InputError(f"{path}: there is no such result: give a result.json, or the folder that has it")
    return path


def _mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return nested tables and lists with each of their values changed."""
    if isinstance(value, Mapping):
        changed = change(value)
        return changed if changed is not value else {str(key): _mapped(each, change) for key, each in value.items()}
    if isinstance(value, list):
        return [_mapped(each, change) for each in value]
    return change(value)


def _as_json(value: Any) -> Any:
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite else {NUMBER: str(value)}


def _of_json(value: Any) -> Any:
    return float(value[NUMBER]) if isinstance(value, Mapping) and set(value) == {NUMBER} else value
