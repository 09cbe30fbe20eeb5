"""Declaration of a machine beside its FMU: ``<Model>.nameplate.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from fmuid.codec import from_json
from fmuid.errors import InputError
from fmuid.files import ContentError, is_file
from fmuid.formatting import nearest
from fmuid.models.machine_terminals import MachineTerminals
from fmuid.models.system import System


@dataclass(frozen=True)
class MachineDeclaration:
    """Terminals of a machine, and formulas of first parameter values."""

    path: Path
    terminals: MachineTerminals
    starts: Mapping[str, str]


def machine_of(system: System) -> MachineDeclaration | None:
    """Return the declaration beside the FMU of a system, None without one; an `InputError` if it is wrong."""
    if len(system.components) > 1:
        return None
    (model,) = system.components.values()
    path = model.fmu.path.with_suffix(".nameplate.toml")
    return _read(path) if is_file(path) else None


def _read(path: Path) -> MachineDeclaration:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not readable as TOML ({error}). Correct it.") from None
    for key in (each for each in data if each not in ("terminals", "starts")):
        raise InputError(f"{path}: unknown section {key!r}. Use [terminals] and [starts].")
    starts = data.get("starts", {})
    if not isinstance(starts, dict) or not all(isinstance(each, str) for each in starts.values()):
        raise InputError(f'{path}: starts must be formulas in quotes, such as Rs = "0.05 * Z".')
    return MachineDeclaration(path, _terminals(path, data.get("terminals", {})), starts)


def _terminals(path: Path, given: Any) -> MachineTerminals:
    known = [each.name for each in fields(MachineTerminals)]
    if not isinstance(given, dict):
        raise InputError(f"{path}: terminals must be a section.")
    for key in (each for each in given if each not in known):
        raise InputError(f"{path}: terminals: unknown key {key!r}{nearest(key, known)}. Use {', '.join(known)}.")
    try:
        return from_json(MachineTerminals, given)
    except ContentError as error:
        raise InputError(f"{path}: terminals: {error}. Correct it.") from None
