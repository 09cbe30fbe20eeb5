"""SystemStructure.ssd: elements, connectors, edges of values (SSP 1.0 and 2.0, 5.3).

A node is a connector of an element, or a signal of a dictionary (a bus).
Every node has at most one incoming edge: a value's source is found by going back along the edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models.ssv import Element, children, local, transformation, truth

ElementPath = tuple[str, ...]  # the names of nested elements, from the outermost inwards; the top system is ``()``

_INWARD = ("input", "parameter", "structuralParameter")
_OUTWARD = ("output", "calculatedParameter", "local", "constant")
_PARAMETERS = ("parameter", "structuralParameter")
_FMU_TYPE = "application/x-fmu-sharedlibrary"
_INTERFACES = {"any": None, "CoSimulation": "co-simulation", "ModelExchange": "model-exchange"}


class Node(NamedTuple):
    """A connector of an element, or a signal of a bus."""

    element: ElementPath
    connector: str

    def __str__(self) -> str:
        return ".".join([*(name for name in self.element if name), self.connector])


class Connector(NamedTuple):
    """A declared connector: kind, unit or enumeration, array flag."""

    kind: str
    unit: str | None
    enumeration: str | None
    is_array: bool


@dataclass(frozen=True)
class Edge:
    """A connection: target = factor · source + offset, in the target's unit."""

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


class StructureTree:
    """Content of the file by paths of elements.

    `components` have source and interface; `buses` map a dictionary reference to its dictionary's path.
    `bindings` are in order of increasing precedence.
    """

    def __init__(self, root: Element, where: str) -> None:
        self.where = where
        self.components: dict[ElementPath, tuple[str, str | None]] = {}
        self.systems: set[ElementPath] = set()
        self.buses: dict[ElementPath, ElementPath] = {}
        self.dictionaries: set[ElementPath] = set()
        self.connectors: dict[Node, Connector] = {}
        self.incoming: dict[Node, Edge] = {}
        self.bindings: list[tuple[ElementPath, Element]] = []
        systems = children(root, "System")
        if len(systems) != 1:
            raise InputError(f"{where}: {len(systems)} top-level systems instead of one.")
        self._element(systems[0], ())

    def error(self, text: str) -> InputError:
        """Return an error with the file's name."""
        return InputError(f"{self.where}: {text}")

    def elements_in(self, system: ElementPath) -> list[str]:
        """Return the names of the elements directly in a system."""
        everything = (path for some in (self.components, self.systems, self.buses) for path in some)
        return [path[-1] for path in everything if len(path) == len(system) + 1 and path[:-1] == system]

    def chain_to(self, target: Node) -> list[Edge]:
        """Return the edges from a value's source to a node."""
        chain: list[Edge] = []
        node = target
        while node in self.incoming:
            edge = self.incoming[node]
            if edge in chain:
                raise self.error(f"{edge.label} closes a circle without a component. Remove it.")
            chain.append(edge)
            node = edge.source
        return chain[::-1]

    def _element(self, xml: Element, path: ElementPath) -> None:
        kind = local(xml)
        if kind == "System":
            self.systems.add(path)
        elif kind == "Component":
            self.components[path] = self._component(xml, ".".join(path))
        elif kind == "SignalDictionaryReference":
            self.buses[path] = self._bus(xml, path)
        else:
            raise self.error(f"element {'.'.join(path)!r} is a {kind}, which is not supported. Use FMUs and systems.")
        for connector in children(xml, "Connectors", "Connector"):
            unit = next((child.get("unit") for child in connector if child.get("unit")), None)
            items = next((child.get("name") for child in children(connector, "Enumeration")), None)
            found = Connector(connector.get("kind", ""), unit, items, bool(children(connector, "Dimension")))
            self.connectors[Node(path, connector.get("name", ""))] = found
        if kind == "System":
            self._content(xml, path)
        self.bindings += [(path, binding) for binding in children(xml, "ParameterBindings", "ParameterBinding")]

    def _content(self, system: Element, path: ElementPath) -> None:
        dictionaries = children(system, "SignalDictionaries", "SignalDictionary")
        self.dictionaries |= {(*path, dictionary.get("name", "")) for dictionary in dictionaries}
        for child in [child for elements in children(system, "Elements") for child in elements]:
            name = child.get("name", "")
            if not name:
                raise self.error(f"{_system_name(path)}: an element has no name. Name it.")
            if name in self.elements_in(path):
                raise self.error(f"{_system_name(path)}: two elements {name!r}. Rename one.")
            self._element(child, (*path, name))
        for connection in children(system, "Connections", "Connection"):
            self._connect(connection, path)

    def _component(self, xml: Element, name: str) -> tuple[str, str | None]:
        kind, asked = xml.get("type", _FMU_TYPE), xml.get("implementation", "any")
        if kind != _FMU_TYPE:
            raise self.error(
                f"component {name!r}: type {kind} is not supported. Use FMUs ({_FMU_TYPE}) or nested systems."
            )
        if asked not in _INTERFACES:
            raise self.error(f"component {name!r}: {asked} is not supported. Use {', '.join(_INTERFACES)}.")
        return xml.get("source", ""), _INTERFACES[asked]

    def _bus(self, xml: Element, path: ElementPath) -> ElementPath:
        """Return the path of the nearest enclosing dictionary of a reference."""
        name = xml.get("dictionary", "")
        for depth in range(len(path) - 1, -1, -1):
            if (*path[:depth], name) in self.dictionaries:
                return (*path[:depth], "", name)  # no element has an empty name
        known = [dictionary[-1] for dictionary in self.dictionaries]
        raise self.error(f"{'.'.join(path)!r}: no signal dictionary {name!r}{nearest(name, known)}.")

    def _connect(self, xml: Element, system: ElementPath) -> None:
        ends = [self._end(xml, system, which) for which in ("start", "end")]
        label = f"connection {ends[0][0]} -> {ends[1][0]}"
        directed = self._directed(ends, system, label)
        factor, offset, table = transformation(xml, f"{self.where}: {label}")
        if table is not None:
            raise self.error(f"{label}: tables are supported for parameters only.")
        source, target = (Node(self.buses.get(node.element, node.element), node.connector) for node in directed)
        if target in self.incoming:
            raise self.error(f"{target} is fed twice, by {self.incoming[target].label} and {label}. Keep one.")
        suppress = truth(xml, "suppressUnitConversion", f"{self.where}: {label}")
        self.incoming[target] = Edge(source, target, factor, offset, suppress, label)

    def _end(self, xml: Element, system: ElementPath, which: str) -> tuple[Node, Connector]:
        element, name = xml.get(f"{which}Element"), xml.get(f"{which}Connector", "")
        path = (*system, element) if element else system
        there = self.elements_in(system)
        if element and element not in there:
            raise self.error(f"connection: {_system_name(system)} has no element {element!r}{nearest(element, there)}.")
        node = Node(path, name)
        connector = self.connectors.get(node)
        if connector is None:
            owner = f"element {element!r}" if element else _system_name(path)
            known = [node.connector for node in self.connectors if node.element == path]
            raise self.error(f"connection: {owner} has no connector {name!r}{nearest(name, known)}.")
        if connector.is_array:
            raise self.error(f"connector {node} is an array, which is not supported. Connect its elements.")
        if path not in self.buses and connector.kind not in (*_INWARD, *_OUTWARD):
            raise self.error(f"connector {node}: kind {connector.kind!r} is not supported. Use input or output.")
        return node, connector

    def _directed(self, ends: list[tuple[Node, Connector]], system: ElementPath, label: str) -> tuple[Node, Node]:
        """Return (source, target) by the kinds of the connectors."""
        first, second = (
            None if node.element in self.buses else (connector.kind in _INWARD) == (node.element == system)
            for node, connector in ends  # sources inside the system; a bus does both
        )
        if first is None and second is not None:
            first = not second
        if first is None or first == second:
            kinds = " and ".join(f"{node} ({connector.kind})" for node, connector in ends)
            raise self.error(f"{label} connects {kinds}. Connect an output to an input.")
        (source, given), (target, taken) = ends if first else ends[::-1]
        inner = [node.element != system and node.element not in self.buses for node in (source, target)]
        to_parameter = inner[1] and taken.kind in _PARAMETERS and given.kind not in _PARAMETERS
        if to_parameter or (inner == [True, True] and given.kind != "output"):
            raise self.error(
                f"{label}: {source} ({given.kind}) cannot feed {target} ({taken.kind}). "
                "Feed inputs by outputs, parameters by parameters of the system."
            )
        return source, target


def _system_name(path: ElementPath) -> str:
    return f"system {'.'.join(path)!r}" if path else "the top system"
