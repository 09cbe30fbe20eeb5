"""The study that a result was made by: kept in its ``result.json``, and read from there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fmuid import codec
from fmuid.errors import InputError
from fmuid.estimation import RESULT_SCHEMA
from fmuid.files import is_file, is_folder
from fmuid.runs.findings import Provenance
from fmuid.runs.folder import RESULT_FILE
from fmuid.runs.provenance import mapped, of_json
from fmuid.studies import Study, override


@dataclass(frozen=True)
class _Origin:
    """Of a ``result.json``, no more than where it is from."""

    origin: Provenance | None = None


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
    origin = codec.read(path, RESULT_SCHEMA, _Origin, "name the study file with --study").origin
    if origin is None or origin.study is None or origin.study.content is None:
        raise InputError(f"{path} does not say by which study it was made: name the study file with --study")
    file, data = path.parent / origin.study.file, mapped(dict(origin.study.content), of_json)
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
