"""The tree of a SystemStructureDescription: elements, connectors, and along which edges values flow (SSP, 5.3).

A node is a connector of an element, or a signal of a dictionary (a bus). Every node has one incoming edge at most, so
that the source of a value is found by going back along the edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models.ssv import Element, children, local, transformation, truth

ElementPath = tuple[str, ...]
"""The names of nested elements, from the outermost inwards; the top system is ``()``."""

_INWARD = ("input", "parameter", "structuralParameter")
_OUTWARD = ("output", "calculatedParameter", "local", "constant")
_PARAMETERS = ("parameter", "structuralParameter")
_FMU_TYPE = "application/x-fmu-sharedlibrary"


class Node(NamedTuple):
    """A connector of an element, or a signal of a bus."""

    element: ElementPath
    connector: str

    def __str__(self) -> str:
        return ".".join([*(name for name in self.element if name), self.connector])


@dataclass(frozen=True)
class Connector:
    """A connector as declared: its kind, its unit or enumeration or None, and whether it is an array."""

    kind: str
    unit: str | None = None
    enumeration: str | None = None
    is_array: bool = False


@dataclass(frozen=True)
class Edge:
    """A connection from source to target: target = factor · source + offset, the source in the target's unit."""

    source: Node
    target: Node
    factor: float
    offset: float
    suppress_units: bool
    label: str

    @property
    def transforms(self) -> bool:
        """Whether the connection has a transformation."""
        return (self.factor, self.offset) != (1.0, 0.0)


@dataclass(frozen=True)
class ComponentElement:
    """An FMU in the structure: its path in the archive, and the interface to use (None: any)."""

    source: str
    interface: str | None


@dataclass
class Tree:
    """The tree of a system structure file.

    Attributes
    ----------
    where : str
        The file, for messages.
    components, systems, buses
        By their paths. A bus maps a reference to a signal dictionary to the path of the dictionary itself.
    connectors : dict of Node to Connector
    incoming : dict of Node to Edge
    bindings : list of (ElementPath, Element)
        The ParameterBinding elements with their owners, in order of increasing precedence.
    """

    where: str
    components: dict[ElementPath, ComponentElement] = field(default_factory=dict)
    systems: set[ElementPath] = field(default_factory=set)
    buses: dict[ElementPath, ElementPath] = field(default_factory=dict)
    connectors: dict[Node, Connector] = field(default_factory=dict)
    incoming: dict[Node, Edge] = field(default_factory=dict)
    bindings: list[tuple[ElementPath, Element]] = field(default_factory=list)

    def elements_in(self, system: ElementPath) -> list[str]:
        """Return the names of the elements directly in a system."""
        everything: Iterator[ElementPath] = (p for some in (self.components, self.systems, self.buses) for p in some)
        return [path[-1] for path in everything if len(path) == len(system) + 1 and path[:-1] == system]

    def connectors_of(self, element: ElementPath) -> list[str]:
        """Return the names of an element's connectors."""
        return [node.connector for node in self.connectors if node.element == element]

    def chain_to(self, target: Node) -> list[Edge]:
        """Return the edges that lead to a node, from the source of its value on; empty if nothing feeds it."""
        chain: list[Edge] = []
        node = target
        while node in self.incoming:
            edge = self.incoming[node]
            if edge in chain:
                raise InputError(f"{self.where}: {edge.label} closes a circle without any component; take it out")
            chain.append(edge)
            node = edge.source
        return chain[::-1]


def read_tree(root: Element, where: str) -> Tree:
    """Read the tree of an SSD file.

    Parameters
    ----------
    root : Element
        SystemStructureDescription.
    where : str
        The file, for messages.

    Raises
    ------
    InputError
        If a connection names something that does not exist, connects unsuitable kinds or feeds a connector twice, or
        if something is not supported.
    """
    systems = children(root, "System")
    if len(systems) != 1:
        raise InputError(f"{where} has {len(systems)} top-level systems instead of one")
    reader = _Reader(where)
    reader.system(systems[0], ())
    return reader.tree


class _Reader:
    def __init__(self, where: str) -> None:
        self.where, self.tree = where, Tree(where)
        self.dictionaries: set[ElementPath] = set()

    def error(self, text: str) -> InputError:
        return InputError(f"{self.where}: {text}")

    def system(self, xml: Element, path: ElementPath) -> None:
        self.tree.systems.add(path)
        self.connectors(xml, path)
        self.dictionaries |= {
            (*path, d.get("name", "")) for d in children(xml, "SignalDictionaries", "SignalDictionary")
        }
        for child in [child for elements in children(xml, "Elements") for child in elements]:
            name = child.get("name", "")
            if not name:
                raise self.error(f"an element of {_system_name(path)} has no name; give it one")
            if name in self.tree.elements_in(path):
                raise self.error(f"{_system_name(path)} has two elements {name!r}; rename one")
            self.element(child, (*path, name))
        for connections in children(xml, "Connections"):
            for connection in connections:
                self.connection(connection, path)
        self.tree.bindings += [(path, b) for b in children(xml, "ParameterBindings", "ParameterBinding")]

    def element(self, xml: Element, path: ElementPath) -> None:
        kind = local(xml)
        if kind == "System":
            self.system(xml, path)
        elif kind == "Component":
            self.tree.components[path] = self.component(xml, ".".join(path))
            self.connectors(xml, path)
            self.tree.bindings += [(path, b) for b in children(xml, "ParameterBindings", "ParameterBinding")]
        elif kind == "SignalDictionaryReference":
            self.tree.buses[path] = self.bus(xml, path)
            self.connectors(xml, path)
        else:
            raise self.error(f"element {'.'.join(path)!r} is a {kind}, which is not supported; use FMUs and systems")

    def component(self, xml: Element, name: str) -> ComponentElement:
        kind, source = xml.get("type", _FMU_TYPE), xml.get("source", "")
        if kind != _FMU_TYPE:
            raise self.error(
                f"component {name!r} is of type {kind}, and only FMUs ({_FMU_TYPE}) are supported; "
                "put its content into this structure as a nested system"
            )
        interfaces = {"any": None, "CoSimulation": "co-simulation", "ModelExchange": "model-exchange"}
        asked = xml.get("implementation", "any")
        if asked not in interfaces:
            raise self.error(f"component {name!r} asks for {asked}, and only {', '.join(interfaces)} are supported")
        return ComponentElement(source, interfaces[asked])

    def bus(self, xml: Element, path: ElementPath) -> ElementPath:
        """Return the path of the dictionary that a reference names: that of the nearest enclosing system."""
        name = xml.get("dictionary", "")
        for depth in range(len(path) - 1, -1, -1):
            if (*path[:depth], name) in self.dictionaries:
                return (*path[:depth], "", name)  # no element has an empty name
        known = [dictionary[-1] for dictionary in self.dictionaries]
        raise self.error(f"{'.'.join(path)!r} refers to no signal dictionary {name!r}{nearest(name, known)}")

    def connectors(self, xml: Element, path: ElementPath) -> None:
        for connector in children(xml, "Connectors", "Connector"):
            units = (child.get("unit") for child in connector if child.get("unit"))
            is_array = bool(children(connector, "Dimension"))
            items = next((child.get("name") for child in children(connector, "Enumeration")), None)
            found = Connector(connector.get("kind", ""), next(units, None), items, is_array)
            self.tree.connectors[Node(path, connector.get("name", ""))] = found

    # --- connections

    def connection(self, xml: Element, system: ElementPath) -> None:
        if local(xml) != "Connection":
            return
        ends = [self.end(xml, system, which) for which in ("start", "end")]
        label = f"connection {ends[0][0]} -> {ends[1][0]}"
        source, target = self.directed(ends, system, label)
        factor, offset, table = transformation(xml, f"{self.where}: {label}")
        if table is not None:
            raise self.error(f"{label} maps values by a table, which is supported for parameters only")
        source, target = (
            Node(self.tree.buses.get(node.element, node.element), node.connector) for node in (source, target)
        )
        if target in self.tree.incoming:
            raise self.error(f"{target} is fed twice, by {self.tree.incoming[target].label} and by {label}; keep one")
        suppress = truth(xml, "suppressUnitConversion", f"{self.where}: {label}")
        self.tree.incoming[target] = Edge(source, target, factor, offset, suppress, label)

    def end(self, xml: Element, system: ElementPath, which: str) -> tuple[Node, Connector]:
        """Return one end of a connection, which must exist."""
        element, name = xml.get(f"{which}Element"), xml.get(f"{which}Connector", "")
        path = (*system, element) if element else system
        if element and element not in self.tree.elements_in(system):
            raise self.error(
                f"a connection names the element {element!r}, which {_system_name(system)} does not have"
                f"{nearest(element, self.tree.elements_in(system))}"
            )
        node = Node(path, name)
        connector = self.tree.connectors.get(node)
        if connector is None:
            known = self.tree.connectors_of(path)
            owner = f"element {element!r}" if element else _system_name(path)
            raise self.error(
                f"a connection names the connector {name!r}, which {owner} does not have{nearest(name, known)}"
            )
        if connector.is_array:
            raise self.error(f"connector {node} is an array, which is not supported; connect its elements one by one")
        if path not in self.tree.buses and connector.kind not in (*_INWARD, *_OUTWARD):
            raise self.error(
                f"connector {node} is of kind {connector.kind!r}, which is not supported; use input or output"
            )
        return node, connector

    def directed(self, ends: list[tuple[Node, Connector]], system: ElementPath, label: str) -> tuple[Node, Node]:
        """Return (source, target), determined by the kinds of the connectors, not by start and end."""
        gives = [self.gives(node, connector, system) for node, connector in ends]
        if gives[0] is None and gives[1] is not None:
            gives[0] = not gives[1]
        if gives[1] is None and gives[0] is not None:
            gives[1] = not gives[0]
        if gives[0] is None or gives[0] == gives[1]:
            kinds = " and ".join(f"{node} ({connector.kind})" for node, connector in ends)
            raise self.error(f"{label} connects {kinds}, between which nothing can flow; connect an output to an input")
        (source, given), (target, taken) = ends if gives[0] else ends[::-1]
        inner = [node.element != system and node.element not in self.tree.buses for node in (source, target)]
        to_parameter = inner[1] and taken.kind in _PARAMETERS and given.kind not in _PARAMETERS
        if to_parameter or (inner == [True, True] and given.kind != "output"):
            raise self.error(
                f"{label} leads from {source} ({given.kind}) to {target} ({taken.kind}), which is not supported: "
                "an input takes an output, and a parameter takes a parameter of the system"
            )
        return source, target

    def gives(self, node: Node, connector: Connector, system: ElementPath) -> bool | None:
        """Return whether a connector provides a value, seen from inside a system; None for a bus, which does both."""
        if node.element in self.tree.buses:
            return None
        return (connector.kind in _INWARD) == (node.element == system)


def _system_name(path: ElementPath) -> str:
    return f"system {'.'.join(path)!r}" if path else "the top system"
