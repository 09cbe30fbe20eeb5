"""Parameter bindings of a system structure: the variables of FMUs that they set (SSP 1.0 and 2.0, 5.3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fmuid.errors import InputError
from fmuid.models.description import Unit, Variable, unit_conversion
from fmuid.models.ssp.links import Package
from fmuid.models.ssp.structure import Edge, ElementPath, Node
from fmuid.models.ssv import (
    Element,
    MappingEntry,
    Quantity,
    children,
    mapping_entries,
    parameter_set,
    read_xml,
)
from fmuid.models.start_values import Value


@dataclass(frozen=True)
class _Given:
    """A value of a binding, its mapping, and the units that its file defines."""

    entry: MappingEntry
    quantity: Quantity
    units: Mapping[str, Unit]
    label: str


class Bindings:
    """The values that the bindings of a package set.

    Attributes
    ----------
    values : dict of str to value
        By ``component.variable``, in the variable's unit.
    unused : dict of str to None
        Names that match no variable that can be set, in the order of the file.
    """

    def __init__(self, package: Package) -> None:
        self.package, self.tree = package, package.tree
        self.values: dict[str, Value] = {}
        self.unused: dict[str, None] = {}
        for element, binding in self.tree.bindings:
            self.bind(element, binding)

    def bind(self, element: ElementPath, binding: Element) -> None:
        """Apply one ParameterBinding to the element that has it."""
        owner = f"a parameter binding of {'.'.join(element) or 'the top system'}"
        prefix = binding.get("prefix", "")
        mappings = children(binding, "ParameterMapping")
        entries: list[MappingEntry] = []
        for mapping in mappings:
            for root, where in self.contents(mapping, "ParameterMapping", "parameter-mapping", owner, mapping):
                entries += mapping_entries(root, where)
        inline = next(iter(children(binding, "ParameterValues")), None)
        for root, where in self.contents(binding, "ParameterSet", "parameter-set", owner, inline):
            given = parameter_set(root, where, self.package.enumerations)
            values = {prefix + name: quantity for name, quantity in given.values.items()}
            for entry in entries if mappings else [MappingEntry(name, name) for name in values]:
                if entry.source in values:
                    label = f"{where}: parameter {entry.source!r}"
                    self.assign(element, _Given(entry, values[entry.source], given.units, label))
                else:
                    self.unused[entry.source or entry.target] = None

    def contents(
        self, holder: Element, root: str, kind: str, owner: str, inline: Element | None
    ) -> list[tuple[Element, str]]:
        """Return the root elements in the file named by `holder` or inside `inline`, with their places in words."""
        if holder.get("type", f"application/x-ssp-{kind}") != f"application/x-ssp-{kind}":
            raise self.package.error(
                f"{owner} is of type {holder.get('type')}, and only application/x-ssp-{kind} is supported"
            )
        source = holder.get("source")
        if not source:
            found = children(inline, root)
            if not found:
                raise self.package.error(f"{owner} has neither a source nor a {root} in it")
            return [(each, str(self.package.path)) for each in found]
        if holder.get("sourceBase", "SSD") != "SSD":
            raise self.package.error(
                f"{owner} takes {source} from inside a component, which is not supported; put it beside"
            )
        file = self.package.file_in_archive(source, owner)
        try:
            return [(read_xml(file, root, f"a {root} file"), f"{self.package.path}, {source}")]
        except InputError as error:
            raise self.package.error(str(error).replace(str(file), source)) from None

    def assign(self, element: ElementPath, given: _Given) -> None:
        """Set a name, as seen from an element, to a value: one variable, or all variables that a connector feeds."""
        package, node = self.package, self.named(element, given.entry.target)
        reached = [] if node is None else [(node, list[Edge]())]
        if node is not None and node.element in self.tree.systems:
            reached = [(end, package.chains[end][start:]) for end, start in package.ends_of(node)]
        used = False
        for target, chain in reached:
            variable = package.variable(target)
            if node is None or variable is None or not variable.settable:
                continue
            used = True
            if package.fed_by_component(target):
                continue  # its start does not matter
            value = self.transformed(node, target, chain, given)
            if variable.type == "Integer" and isinstance(value, str):
                value = package.items(target, given.quantity.items).get(value, value)
            name = ".".join([*target.element, target.connector])
            self.values[name] = _fitting(value, variable, f"{given.label} for {name!r}")
        if not used:
            self.unused[".".join([*element, given.entry.target])] = None

    def named(self, element: ElementPath, name: str) -> Node | None:
        """Return the connector or variable of a hierarchical name seen from an element; None where there is none."""
        node = Node(element, name)
        if element in self.package.entries or node in self.tree.connectors:
            return node
        inner = [e for e in self.tree.elements_in(element) if name.startswith(f"{e}.")]
        if not inner:
            return None
        longest = max(inner, key=len)  # names of elements may contain dots
        return self.named((*element, longest), name[len(longest) + 1 :])

    def transformed(self, node: Node, target: Node, chain: list[Edge], given: _Given) -> Value:
        """Return the value in the target's unit: converted, then mapped, then transformed by the connections."""
        entry, value, unit = given.entry, given.quantity.value, given.quantity.unit
        if entry.table is not None:
            if value not in entry.table:
                raise InputError(f"{given.label} is {value!r}, for which its mapping has no entry")
            value = entry.table[value]
        if isinstance(value, bool | str):
            return value
        steps = [(entry.factor, entry.offset), *([self.package.composed(chain)[:2]] if chain else [])]
        wanted = self.package.unit(node) or self.package.unit(target)
        if unit and wanted and unit != wanted and not entry.suppress_units:
            known = {**self.package.description(target.element).units, **self.package.units}
            conversion = unit_conversion({**known, **given.units}.get(unit), known.get(wanted))
            if conversion is None:
                raise InputError(f"{given.label}: the units {unit!r} and {wanted!r} do not convert into each other")
            steps.insert(0, conversion)
        for factor, offset in steps:
            if (factor, offset) != (1.0, 0.0):  # keep integers where there is nothing to transform
                value = factor * value + offset
        return value


def _fitting(value: Value, variable: Variable, label: str) -> Value:
    """Return a value converted to its variable's type."""
    kind = variable.type
    if kind == "Real" and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if kind == "Integer" and not isinstance(value, str | bool) and float(value).is_integer():
        return int(value)
    if (kind == "Boolean" and isinstance(value, bool)) or (kind == "String" and isinstance(value, str)):
        return value
    if kind == "Boolean" and value in (0, 1):
        return bool(value)
    raise InputError(f"{label} is {value!r}, which does not fit its type {kind}")
