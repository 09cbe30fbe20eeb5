"""SSP packages: coupled FMUs, connections and parameter values (SSP 1.0 and 2.0)."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from urllib.parse import unquote

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.formatting import nearest
from fmuid.models.archive import file_digest, unpacked
from fmuid.models.description import Unit, Variable, unit_conversion
from fmuid.models.fmu import FMU
from fmuid.models.ssd import Edge, ElementPath, Node, StructureTree
from fmuid.models.ssv import (
    Element,
    MappingEntry,
    Quantity,
    children,
    enumerations_of,
    mapping_entries,
    parameter_set,
    read_xml,
    units_of,
)
from fmuid.models.start_values import Value

STRUCTURE_FILE = "SystemStructure.ssd"


@dataclass(frozen=True)
class SystemStructure:
    """Content of an .ssp file, nested systems flattened, as arguments of `fmuid.System`."""

    components: Mapping[str, tuple[FMU, str | None]]  # FMU and requested interface
    # without factor and offset if the structure gives no units
    connections: tuple[tuple[str, str] | tuple[str, str, float, float], ...]
    connectors: Mapping[str, Sequence[tuple[str, float, float]]]
    values: Mapping[str, Value]  # in the variables' units, without unknown names (SSP 1.0, 5.3.1)


def read_ssp(path: str | Path) -> SystemStructure:
    """Read an ``.ssp`` file, unpacked into the user's cache; an `InputError` if it is wrong."""
    path = Path(path)
    if not is_file(path):
        raise InputError(f"{path}: SSP file not found. Check the path.")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path}: not an SSP: no zip archive. Export the system again.")
    folder = unpacked(path, file_digest(path))
    if not (folder / STRUCTURE_FILE).is_file():
        raise InputError(f"{path}: not an SSP: no {STRUCTURE_FILE} at its top level.")
    where = f"{path}: {STRUCTURE_FILE}"
    root = read_xml(folder / STRUCTURE_FILE, "SystemStructureDescription", "a system structure", where)
    package = _Package(path, folder, root)
    for element, binding in package.tree.bindings:
        package.bind(element, binding)
    components = {".".join(each): (package.fmus[each], kind) for each, (_, kind) in package.tree.components.items()}
    return SystemStructure(components, package.connections(), package.own_connectors(), package.values)


class _Package:
    """An unpacked package: tree, FMUs, values of bindings."""

    def __init__(self, path: Path, folder: Path, root: Element) -> None:
        self.path, self.folder, self.tree = path, folder, StructureTree(root, str(path))
        self.error = self.tree.error
        self.units, self.enumerations = units_of(root, str(path)), enumerations_of(root, str(path))
        components = self.tree.components.items()
        if not components:
            raise self.error("no components. Add at least one FMU.")
        self.fmus = {element: self._fmu(".".join(element), source) for element, (source, _) in components}
        self.chains = {node: self.tree.chain_to(node) for node in self.tree.connectors}
        self.values: dict[str, Value] = {}

    def _file(self, source: str, what: str) -> Path:
        """Return a file by its relative URI (SSP 1.0, 5.3.4)."""
        name = unquote(source)
        parts = PurePosixPath(name).parts
        if not name or ":" in name or "#" in source or name.startswith("/") or "\\" in name or ".." in parts:
            raise self.error(f"{what}: source {source!r} is outside the archive. Use a file inside.")
        file = self.folder.joinpath(*parts)
        if not is_file(file):
            there = [p.relative_to(self.folder).as_posix() for p in self.folder.rglob("*") if p.is_file()]
            raise self.error(f"{what}: file {name!r} is not in the archive{nearest(name, there)}.")
        return file

    def _fmu(self, name: str, source: str) -> FMU:
        file = self._file(source, f"component {name!r}")
        try:
            return FMU(file)
        except InputError as error:
            raise self.error(f"component {name!r}: {str(error).replace(str(file), source)}") from None

    def _variable(self, node: Node) -> Variable | None:
        fmu = self.fmus.get(node.element)
        return fmu.description.variables.get(node.connector) if fmu else None

    def _conversion(
        self, source: str, target: str, elements: Iterable[ElementPath], own: Mapping[str, Unit] | None = None
    ) -> tuple[float, float] | None:
        """Return (factor, offset) between units of components' FMUs; the structure's precede, and a file's `own`."""
        known: dict[str, Unit] = {}
        for element in elements:
            known |= self.fmus[element].description.units if element in self.fmus else {}
        known |= self.units
        return unit_conversion({**known, **(own or {})}.get(source), known.get(target))

    def _stated(self, node: Node) -> str | None:
        connector = self.tree.connectors.get(node)
        return connector.unit if connector else None

    def _unit(self, node: Node) -> str | None:
        """Return a connector's unit: stated, or that of its variable."""
        variable = None if self._stated(node) else self._variable(node)
        return variable.unit if variable else self._stated(node)

    # --- connections

    def connections(self) -> tuple[tuple[str, str] | tuple[str, str, float, float], ...]:
        found: list[tuple[str, str] | tuple[str, str, float, float]] = []
        for node, chain in self.chains.items():
            if node.element in self.fmus and self._fed_by_component(node):
                factor, offset, settled = self._composed(chain)
                ends = str(chain[0].source), str(node)
                found.append((*ends, factor, offset) if settled else ends)
        return tuple(found)

    def own_connectors(self) -> dict[str, list[tuple[str, float, float]]]:
        """Return the variables behind the system's own inputs and outputs."""
        found: dict[str, list[tuple[str, float, float]]] = {}
        for node, connector in self.tree.connectors.items():
            if node.element == () and connector.kind == "input":
                fed = [(end, self.chains[end]) for end, _ in self._fed_by(node)]
            elif node.element == () and connector.kind == "output" and self._fed_by_component(node):
                fed = [(self.chains[node][0].source, self.chains[node])]
            else:
                continue
            found[node.connector] = [(str(end), *self._composed(chain)[:2]) for end, chain in fed]
        return found

    def _fed_by_component(self, target: Node) -> bool:
        chain = self.chains.get(target)
        return bool(chain and chain[0].source.element in self.fmus)

    def _fed_by(self, source: Node) -> list[tuple[Node, list[Edge]]]:
        """Return the component connectors behind a system connector, with their edges."""
        return [
            (node, chain[i:])
            for node, chain in self.chains.items()
            for i, edge in enumerate(chain)
            if node.element in self.fmus and edge.source == source
        ]

    def _composed(self, chain: list[Edge]) -> tuple[float, float, bool]:
        """Return factor, offset and validity of a chain of connections (SSP, 4.5.1).

        A transformation follows the unit conversion, and stands alone between different dimensions.
        """
        # if a connector states a unit or a connection transforms, others take their variable's or source's unit
        nodes = [chain[0].source, *(edge.target for edge in chain)]
        known = any(self._stated(node) for node in nodes) or any(edge.transforms for edge in chain)
        unit = self._unit(nodes[0]) if known else None
        factor, offset = 1.0, 0.0
        for edge in chain:
            end = self._unit(edge.target) if known else None
            if unit and end and unit != end and not edge.suppress_units:
                conversion = self._conversion(unit, end, (nodes[0].element, nodes[-1].element))
                if conversion is None and not edge.transforms:
                    raise self.error(f"{edge.label}: units {unit!r} and {end!r} do not convert.")
                if conversion is not None:
                    factor, offset = conversion[0] * factor, conversion[0] * offset + conversion[1]
            factor, offset = edge.factor * factor, edge.factor * offset + edge.offset
            unit = end if end or edge.suppress_units else unit
        return factor, offset, known or any(edge.suppress_units for edge in chain)

    # --- bindings: the variables of FMUs that they set

    def bind(self, element: ElementPath, binding: Element) -> None:
        owner = f"a parameter binding of {'.'.join(element) or 'the top system'}"
        prefix, mappings = binding.get("prefix", ""), children(binding, "ParameterMapping")
        entries: list[MappingEntry] = []
        for mapping in mappings:
            for root, where in self._contents(mapping, "ParameterMapping", "parameter-mapping", owner, mapping):
                entries += mapping_entries(root, where)
        inline = next(iter(children(binding, "ParameterValues")), None)
        for root, where in self._contents(binding, "ParameterSet", "parameter-set", owner, inline):
            given = parameter_set(root, where, self.enumerations)
            values = {prefix + name: quantity for name, quantity in given.values.items()}
            for entry in entries if mappings else [MappingEntry(name, name) for name in values]:
                if entry.source in values:
                    label = f"{where}: parameter {entry.source!r}"
                    self._assign(element, _Given(entry, values[entry.source], given.units, label))

    def _contents(
        self, holder: Element, root: str, kind: str, owner: str, inline: Element | None
    ) -> list[tuple[Element, str]]:
        """Return root elements, in a file or inline, with their places."""
        if holder.get("type", f"application/x-ssp-{kind}") != f"application/x-ssp-{kind}":
            raise self.error(f"{owner}: type {holder.get('type')} is not supported. Use application/x-ssp-{kind}.")
        source = holder.get("source")
        if not source:
            found = children(inline, root)
            if not found:
                raise self.error(f"{owner}: neither a source nor a {root}.")
            return [(each, str(self.path)) for each in found]
        if holder.get("sourceBase", "SSD") != "SSD":
            raise self.error(f"{owner}: {source} inside a component is not supported. Put it beside.")
        file = self._file(source, owner)
        return [(read_xml(file, root, f"a {root} file", f"{self.path}: {source}"), f"{self.path}, {source}")]

    def _assign(self, element: ElementPath, given: _Given) -> None:
        """Set a variable, or all variables behind a connector, to a value."""
        node = self._named(element, given.entry.target)
        if node is None:
            return
        for target, chain in self._fed_by(node) if node.element in self.tree.systems else [(node, [])]:
            variable = self._variable(target)
            if variable is None or not variable.settable or self._fed_by_component(target):
                continue  # the start of what is fed does not matter
            value = self._transformed(node, target, chain, given)
            if variable.type == "Integer" and isinstance(value, str):
                connector = self.tree.connectors.get(target)
                named = (connector.enumeration if connector else None) or ""
                value = self.enumerations.get(named, given.quantity.items or {}).get(value, value)
            self.values[str(target)] = _fitting(value, variable, f"{given.label} for {str(target)!r}")

    def _named(self, element: ElementPath, name: str) -> Node | None:
        """Return the node of a hierarchical name inside an element, if any."""
        node = Node(element, name)
        if element in self.fmus or node in self.tree.connectors:
            return node
        inner = [e for e in self.tree.elements_in(element) if name.startswith(f"{e}.")]
        if not inner:
            return None
        longest = max(inner, key=len)  # names of elements may contain dots
        return self._named((*element, longest), name[len(longest) + 1 :])

    def _transformed(self, node: Node, target: Node, chain: list[Edge], given: _Given) -> Value:
        """Return the value in the target's unit: converted, mapped, transformed by connections."""
        entry, value, unit = given.entry, given.quantity.value, given.quantity.unit
        if entry.table is not None:
            if value not in entry.table:
                raise InputError(f"{given.label} is {value!r}, which its mapping lacks.")
            value = entry.table[value]
        if isinstance(value, bool | str):
            return value
        steps = [(entry.factor, entry.offset), *([self._composed(chain)[:2]] if chain else [])]
        wanted = self._unit(node) or self._unit(target)
        if unit and wanted and unit != wanted and not entry.suppress_units:
            conversion = self._conversion(unit, wanted, [target.element], given.units)
            if conversion is None:
                raise InputError(f"{given.label}: units {unit!r} and {wanted!r} do not convert.")
            steps.insert(0, conversion)
        for factor, offset in steps:
            if (factor, offset) != (1.0, 0.0):  # keep integers where there is nothing to transform
                value = factor * value + offset
        return value


class _Given(NamedTuple):
    """A value of a binding, its mapping, and its file's units."""

    entry: MappingEntry
    quantity: Quantity
    units: Mapping[str, Unit]
    label: str


def _fitting(value: Value, variable: Variable, label: str) -> Value:
    kind = variable.type
    if kind == "Real" and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if kind == "Integer" and not isinstance(value, str | bool) and float(value).is_integer():
        return int(value)
    if (kind == "Boolean" and isinstance(value, bool)) or (kind == "String" and isinstance(value, str)):
        return value
    if kind == "Boolean" and value in (0, 1):
        return bool(value)
    raise InputError(f"{label} is {value!r}, which does not fit its type {kind}.")
