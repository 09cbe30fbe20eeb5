"""System structures: coupled FMUs, their connections and parameter values from one .ssp file (SSP 1.0 and 2.0)."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.models.archive import file_digest, unpacked
from fmuid.models.ssp.bindings import Bindings
from fmuid.models.ssp.links import ComponentEntry, ConnectedVariable, ConnectionEntry, Package
from fmuid.models.ssv import children, number, read_xml
from fmuid.models.start_values import Value

STRUCTURE_FILE = "SystemStructure.ssd"


@dataclass(frozen=True)
class Structure:
    """The content of an .ssp file, nested systems flattened.

    Attributes
    ----------
    path : Path
        The file.
    name : str
    components : mapping of str to ComponentEntry
        One inside nested systems is ``outer.inner``.
    connections : tuple of ConnectionEntry
    values : mapping of str to value
        By ``component.variable``, as set by parameter bindings, in the unit of the variable.
    inputs : mapping of str to tuple of ConnectedVariable
        The system's own input connectors with the variables that each feeds.
    outputs : mapping of str to ConnectedVariable
        The system's own output connectors that an output of a component feeds.
    default_experiment : mapping of str to float
        ``start`` and ``stop``, s, where the file has them.
    unused : tuple of str
        Names in parameter bindings without a variable; the standard requires to ignore them (SSP 1.0, 5.3.1).
    """

    path: Path
    name: str
    components: Mapping[str, ComponentEntry]
    connections: tuple[ConnectionEntry, ...]
    values: Mapping[str, Value] = field(default_factory=dict)
    inputs: Mapping[str, tuple[ConnectedVariable, ...]] = field(default_factory=dict)
    outputs: Mapping[str, ConnectedVariable] = field(default_factory=dict)
    default_experiment: Mapping[str, float] = field(default_factory=dict)
    unused: tuple[str, ...] = ()


def read_ssp(path: str | Path) -> Structure:
    """Read a system structure package; it is unpacked into the user's cache.

    Parameters
    ----------
    path : path-like
        The ``.ssp`` file.

    Raises
    ------
    InputError
        If the file is missing or no archive, has no system structure or lacks a file that this names, if a connection
        or a binding is wrong, if units do not convert, or if something in it is not supported. What only the FMUs
        know (causalities, types, units that the structure does not state) is not checked here.
    """
    path = Path(path)
    if not is_file(path):
        raise InputError(f"{path}: there is no such SSP file; check the path")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is not an SSP: it is not a zip archive; export the system again")
    folder = unpacked(path, file_digest(path))
    if not (folder / STRUCTURE_FILE).is_file():
        raise InputError(f"{path} is not an SSP: it has no {STRUCTURE_FILE} at its top level")
    try:
        root = read_xml(folder / STRUCTURE_FILE, "SystemStructureDescription", "a system structure")
    except InputError as error:
        raise InputError(f"{path}: {str(error).replace(str(folder / STRUCTURE_FILE), STRUCTURE_FILE)}") from None
    return _structure(Package(path, folder, root))


def _structure(package: Package) -> Structure:
    if not package.entries:
        raise package.error("the structure has no components; add at least one FMU")
    bindings, links = Bindings(package), package.links()
    outputs = {node.connector: package.behind(node) for node in package.own("output")}
    return Structure(
        package.path,
        package.root.get("name", ""),
        {".".join(element): entry for element, entry in package.entries.items()},
        tuple(links),
        bindings.values,
        {node.connector: tuple(package.fed_by(node)) for node in package.own("input")},
        {name: port for name, port in outputs.items() if port is not None},
        _default_experiment(package),
        tuple(bindings.unused),
    )


def _default_experiment(package: Package) -> dict[str, float]:
    return {
        word: number(experiment, key, str(package.path))
        for experiment in children(package.root, "DefaultExperiment")
        for word, key in (("start", "startTime"), ("stop", "stopTime"))
        if experiment.get(key) is not None
    }
