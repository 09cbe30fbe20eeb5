"""The study file: all its sections, and values set in it by ``--set parameters.Rs.start=9``."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator

from fmuid.data import Nameplate, Noise
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import Isolation
from fmuid.studies.array_elements import by_element
from fmuid.studies.batch import BatchSettings
from fmuid.studies.estimation import EstimationSection, MonitoringSection, UncertaintySection
from fmuid.studies.faults import DiagnosisSection
from fmuid.studies.model import ExperimentSettings, ModelSection
from fmuid.studies.nameplate import PriorOrNameplate
from fmuid.studies.parameters import ParameterSection
from fmuid.studies.section import Settings, StudySection, entries_of, entry, keys_of, only_tables, table_of
from fmuid.studies.toml import TomlReadError, parsed, show
from fmuid.studies.value_kinds import Text

_SEGMENT = re.compile(r"""\s*(?:"([^"]*)"|'([^']*)'|([^."'\s]+))\s*(?:\.|$)""")


class StudyFile(StudySection):
    """Study: model, experiments, parameters and settings."""

    title: Text = entry("", "title of the study")
    model: ModelSection = entry({}, "model", validate_default=True)
    experiments: list[ExperimentSettings] = entry([], "data files")
    parameters: Annotated[dict[str, ParameterSection], BeforeValidator(by_element)] = entry({}, "free parameters")
    prior: PriorOrNameplate | None = entry(None, 'joint prior of several parameters, or "nameplate"')
    nameplate: Annotated[Nameplate | None, Settings()] = entry(None, 'what is printed, for prior = "nameplate"')
    noise: Annotated[Noise, Settings()] = entry(Noise(), "measurement noise")
    estimation: EstimationSection = entry({}, "optimization of the parameters", validate_default=True)
    uncertainty: UncertaintySection = entry({}, "intervals beyond the local standard deviations", validate_default=True)
    diagnosis: DiagnosisSection | None = entry(None, "fault diagnosis against a baseline")
    monitoring: MonitoringSection = entry({}, "diagnosis of long recordings", validate_default=True)
    batch: BatchSettings | None = entry(None, "many identifications, called cases")
    isolation: Annotated[Isolation, Settings()] = entry(Isolation(), "limits of FMU processes")


def override(data: dict[str, Any], setting: str, file: str) -> None:
    """Set one value of a study in place by its dotted path; a value that is no TOML is a string.

    List entries go by number (``experiments.0.data``). ``parameters.Rs=9.8`` fixes a parameter,
    ``parameters.J={ start = 1.0 }`` frees a fixed one.
    """
    path, equals, text = setting.partition("=")
    segments = _segments(path)
    if not equals or not segments:
        raise InputError(f"--set {setting}: no path=value. Write, for example, --set parameters.Rs.start=9.")
    value, name = value_of(text.strip()), ".".join(segments[1:])
    known = data.get("parameters")
    one = isinstance(known, dict) and name in known and not (len(segments) > 2 and segments[1] in known)
    if segments[0] == "parameters" and one and type(value) in (int, float):
        del data["parameters"][name]
        segments = ["model", "fixed", name]
    elif segments[0] == "parameters" and isinstance(value, dict) and isinstance(model := data.get("model"), dict):
        fixed = model.get("fixed")
        if isinstance(fixed, dict):
            fixed.pop(name, None)
    _assign(data, segments, value, (), StudyFile, f"--set {setting}: {file}")


def _segments(path: str) -> list[str]:
    """Split a path at dots outside quotes; empty if it is none."""
    found, position = [], 0
    while position < len(path):
        match = _SEGMENT.match(path, position)
        if match is None:
            return []
        found.append(next(group for group in match.groups() if group is not None))
        position = match.end()
    return found if not path.rstrip().endswith(".") else []


def value_of(text: str) -> Any:
    """Return the TOML value of a text, or else the text."""
    try:
        found = parsed(f"value = {text}")
    except (TomlReadError, tomllib.TOMLDecodeError):
        return text
    return found["value"] if len(found) == 1 else text


def _assign(node: Any, segments: Sequence[str], value: Any, above: tuple[str, ...], shape: Any, where: str) -> None:
    """Set the value at the path `segments` below `node` of type `shape`."""
    key: Any
    if isinstance(node, list):
        key, rest = _index(node, segments, above, where), segments[1:]
    elif isinstance(node, dict):
        key, rest = _key(node, segments, value, above, shape, where)
    else:
        raise InputError(f"{where}: {'.'.join(above)} is {show(node)} and has no key {segments[0]!r}.")
    if rest:
        below = shape if isinstance(node, list) else _below(shape, str(key))
        _assign(node[key], rest, value, (*above, str(key)), below, where)
    else:
        node[key] = value


def _index(node: list[Any], segments: Sequence[str], above: tuple[str, ...], where: str) -> int:
    if not segments[0].isdecimal() or int(segments[0]) >= len(node):
        name = ".".join(above)
        raise InputError(f"{where}: {name}.{segments[0]} not found. Entries have numbers from 0 to {len(node) - 1}.")
    return int(segments[0])


def _key(
    node: dict[str, Any], segments: Sequence[str], value: Any, above: tuple[str, ...], shape: Any, where: str
) -> tuple[str, Sequence[str]]:
    """Return the first key of `segments` in `node`, and the other segments."""
    joined = [".".join(segments[: count + 1]) for count in range(len(segments))]
    here = ".".join(above)
    present = [count for count, name in enumerate(joined) if name in node]
    if len(present) > 1:
        names = " or ".join(f'"{joined[count]}"' for count in present)
        raise InputError(f"{where}: {here} has several keys for this path. Quote one of them, {names}.")
    if present:
        return joined[present[0]], segments[present[0] + 1 :]
    named = entries_of(shape)
    if named is not None and (isinstance(value, dict) or not only_tables(named)):
        return joined[-1], ()
    if named is None and len(segments) == 1:
        return segments[0], ()  # the check of its section knows whether it exists
    below = _below(shape, segments[0])
    if named is None and (table_of(below) is not None or entries_of(below) is not None):
        node[segments[0]] = {}
        return segments[0], segments[1:]
    name = joined[-2] if named is not None and len(segments) > 1 else segments[0]
    raise InputError(f"{where}: {here + ': ' if here else ''}unknown key {name!r}{nearest(name, node)}")


def _below(shape: Any, key: str) -> Any:
    """Return the type below a key, if known."""
    table = table_of(shape)
    known = {} if table is None else keys_of(table)
    return entries_of(shape) if table is None else known[key].annotation if key in known else None
