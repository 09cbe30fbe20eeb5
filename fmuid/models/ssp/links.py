"""The FMUs of a system structure package, and the connections between them with their factors and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from urllib.parse import unquote

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.formatting import nearest
from fmuid.models.description import DESCRIPTION_FILE, Description, Unit, Variable, unit_conversion
from fmuid.models.reading import read_description, read_text
from fmuid.models.ssp.structure import Edge, ElementPath, Node, Tree, read_tree
from fmuid.models.ssv import Element, enumerations_of, units_of
from fmuid.models.untrusted_xml import started_elements


@dataclass(frozen=True)
class ComponentEntry:
    """An FMU of the structure: its file, unpacked from the archive, and the interface asked for (None: any)."""

    fmu: Path
    interface: str | None = None


class ConnectionEntry(NamedTuple):
    """An output and the input that it feeds, both as (component, variable): target = factor · source + offset.

    If `units_settled` is False, the structure gives no units, factor and offset are 1 and 0, and the value is to be
    converted between the units that the FMUs declare. If it is True, factor and offset include the conversion.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0
    units_settled: bool = False


class ConnectedVariable(NamedTuple):
    """A component's variable connected to a connector of the whole system.

    Of an input: variable = factor · connector + offset; of an output: connector = factor · variable + offset.
    """

    component: str
    variable: str
    factor: float = 1.0
    offset: float = 0.0


class Package:
    """An unpacked package and its structure.

    Parameters
    ----------
    path : Path
        The ``.ssp`` file.
    folder : Path
        The folder with its files.
    root : Element
        SystemStructureDescription.

    Raises
    ------
    InputError
        If the structure is wrong or not supported (`fmuid.models.ssp.structure.read_tree`), or a component has no file
        that is an FMU.
    """

    def __init__(self, path: Path, folder: Path, root: Element) -> None:
        self.path, self.folder, self.root = path, folder, root
        self.tree: Tree = read_tree(root, str(path))
        self.units = units_of(root, str(path))
        self.enumerations = enumerations_of(root, str(path))
        self.descriptions: dict[ElementPath, Description] = {}
        self.entries = {
            element: ComponentEntry(self.fmu_file(".".join(element), component.source), component.interface)
            for element, component in self.tree.components.items()
        }
        self.chains = {node: self.tree.chain_to(node) for node in self.tree.connectors}

    def error(self, text: str) -> InputError:
        """Return an error that names the file."""
        return InputError(f"{self.path}: {text}")

    # --- files

    def file_in_archive(self, source: str, what: str) -> Path:
        """Return a file of the archive by its relative URI (SSP 1.0, 5.3.4)."""
        name = unquote(source)
        parts = PurePosixPath(name).parts
        if not name or ":" in name or "#" in source or name.startswith("/") or "\\" in name or ".." in parts:
            raise self.error(f"{what} has the source {source!r}; only files inside the archive are supported")
        file = self.folder.joinpath(*parts)
        if not is_file(file):
            there = [p.relative_to(self.folder).as_posix() for p in self.folder.rglob("*") if p.is_file()]
            raise self.error(f"{what} needs the file {name!r}, which the archive does not have{nearest(name, there)}")
        return file

    def fmu_file(self, name: str, source: str) -> Path:
        """Return the FMU of a component, of an FMI version that may be read."""
        what = f"component {name!r}"
        file = self.file_in_archive(source, what)
        try:
            first = next(started_elements(read_text(file), DESCRIPTION_FILE))
        except (InputError, StopIteration) as error:
            said = str(error).replace(str(file), source) or "it is empty"
            raise self.error(f"{what}: {source} is not an FMU with a readable modelDescription.xml: {said}") from None
        version = first.get("fmiVersion", "")
        if version.startswith("1"):
            raise self.error(f"{what} is an FMU of FMI {version}, which is not supported; export it as FMI 2.0 or 3.0")
        return file

    def description(self, element: ElementPath) -> Description:
        """Return the description of an FMU, read when a binding or a unit first needs it."""
        if element not in self.descriptions:
            self.descriptions[element] = read_description(self.entries[element].fmu)
        return self.descriptions[element]

    def variable(self, node: Node) -> Variable | None:
        """Return the FMU's variable of a component's connector."""
        return self.description(node.element).variables.get(node.connector) if node.element in self.entries else None

    # --- connections

    def own(self, kind: str) -> list[Node]:
        """Return the connectors of a kind of the whole system."""
        return [node for node, c in self.tree.connectors.items() if node.element == () and c.kind == kind]

    def fed_by_component(self, target: Node) -> bool:
        """Whether the value of a connector comes from a component, through connections."""
        chain = self.chains.get(target)
        return chain is not None and len(chain) > 0 and chain[0].source.element in self.entries

    def ends_of(self, source: Node) -> list[tuple[Node, int]]:
        """Return the components' connectors fed by a system's connector, with its index in their chains."""
        found = []
        for node, chain in self.chains.items():
            sources = [edge.source for edge in chain]
            if node.element in self.entries and source in sources:
                found.append((node, sources.index(source)))
        return found

    def links(self) -> list[ConnectionEntry]:
        """Return the connections between components."""
        found = []
        for node, chain in self.chains.items():
            if node.element in self.entries and self.fed_by_component(node):
                source = chain[0].source
                ends = [(".".join(end.element), end.connector) for end in (source, node)]
                found.append(ConnectionEntry(ends[0], ends[1], *self.composed(chain)))
        return found

    def fed_by(self, source: Node) -> list[ConnectedVariable]:
        """Return the components' variables that a connector of the whole system feeds."""
        found = []
        for node, _ in self.ends_of(source):
            factor, offset, _ = self.composed(self.chains[node])
            found.append(ConnectedVariable(".".join(node.element), node.connector, factor, offset))
        return found

    def behind(self, target: Node) -> ConnectedVariable | None:
        """Return the component's variable that feeds a connector of the whole system."""
        if not self.fed_by_component(target):
            return None
        chain = self.chains[target]
        factor, offset, _ = self.composed(chain)
        return ConnectedVariable(".".join(chain[0].source.element), chain[0].source.connector, factor, offset)

    def composed(self, chain: list[Edge]) -> tuple[float, float, bool]:
        """Return factor and offset along a chain of connections, and whether they include the conversion of units.

        Where a connector of the chain states a unit or a connection has a transformation, a component's connector that
        states none has the unit of its variable, and one between components that of what feeds it (SSP, 4.5.1). The
        transformation of a connection follows the conversion, and stands alone where the units are of different
        dimensions.
        """
        nodes = [chain[0].source, *(edge.target for edge in chain)]
        known = any(self.stated(node) for node in nodes) or any(edge.transforms for edge in chain)
        unit = self.unit(nodes[0]) if known else None
        factor, offset = 1.0, 0.0
        for edge in chain:
            end = self.unit(edge.target) if known else None
            if unit and end and unit != end and not edge.suppress_units:
                defined = self.units_along(chain)
                conversion = unit_conversion(defined.get(unit), defined.get(end))
                if conversion is None and not edge.transforms:
                    raise self.error(f"{edge.label}: the units {unit!r} and {end!r} do not convert into each other")
                if conversion is not None:
                    factor, offset = conversion[0] * factor, conversion[0] * offset + conversion[1]
            factor, offset = edge.factor * factor, edge.factor * offset + edge.offset
            unit = end if end or edge.suppress_units else unit
        return factor, offset, known or any(edge.suppress_units for edge in chain)

    def items(self, node: Node, default: Mapping[str, int] | None) -> Mapping[str, int]:
        """Return the numbers of the items of a connector's enumeration."""
        connector = self.tree.connectors.get(node)
        return self.enumerations.get((connector.enumeration if connector else None) or "", default or {})

    def stated(self, node: Node) -> str | None:
        """Return the unit that the structure states for a connector."""
        connector = self.tree.connectors.get(node)
        return connector.unit if connector else None

    def unit(self, node: Node) -> str | None:
        """Return the unit of a connector: stated, or that of the FMU's variable."""
        variable = None if self.stated(node) else self.variable(node)
        return variable.unit if variable else self.stated(node)

    def units_along(self, chain: list[Edge]) -> dict[str, Unit]:
        """Return the units that the FMUs at the ends define and, above these, those of the structure."""
        found: dict[str, Unit] = {}
        for node in (chain[0].source, chain[-1].target):
            if node.element in self.entries:
                found |= self.description(node.element).units
        return found | self.units
