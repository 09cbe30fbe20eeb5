"""Parameter values (SSV) and mappings of their names (SSM).

SSP 1.0 and 2.0, chapters 6 and 7. Elements are identified by local names: both versions share namespaces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from fmuid.errors import InputError
from fmuid.models.description import FLOATS, INTEGERS, SI_BASE_UNITS, Unit
from fmuid.models.start_values import Value
from fmuid.models.untrusted_xml import LARGEST_XML, parse_xml, xml_attribute
from fmuid.version import __version__

Element = ElementTree.Element

NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructure"  # common prefix of the namespaces of SSP 1.0 and 2.0


class Quantity(NamedTuple):
    """A value, its unit, its description, and its enumeration's items."""

    value: Value
    unit: str | None = None
    description: str = ""
    items: Mapping[str, int] | None = None


@dataclass(frozen=True)
class ParameterValues:
    """Content of an SSV file: name, values in file order, defined units."""

    name: str
    values: Mapping[str, Quantity]
    units: Mapping[str, Unit] = field(default_factory=dict)


class MappingEntry(NamedTuple):
    """`target` = factor · `source` + offset, or `table[source]`."""

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[Value, Value] | None = None
    suppress_units: bool = False


def read_ssv(path: str | Path) -> ParameterValues:
    """Read an SSV file; an `InputError` if it is unreadable, no SSV file, or has a value of a wrong type."""
    return parameter_set(read_xml(Path(path), "ParameterSet", "an SSV file"), str(path))


def write_ssv(path: Path, name: str, values: Mapping[str, Quantity], units: Mapping[str, Unit]) -> None:
    """Write an SSV file of SSP 1.0; numbers read back exactly, units without SI exponents are left out.

    `InputError`: a value is not finite. `OSError`: the file cannot be written.
    """
    defined = {q.unit for q in values.values() if q.unit is not None and q.unit in units and units[q.unit].exponents}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<ssv:ParameterSet xmlns:ssv="{NAMESPACE}ParameterValues" xmlns:ssc="{NAMESPACE}Common"'
        f' version="1.0" name={xml_attribute(name)} generationTool="fmuid {__version__}">',
        "  <ssv:Parameters>",
    ]
    for variable, quantity in values.items():
        said = f" description={xml_attribute(quantity.description)}" if quantity.description else ""
        typed = _typed(variable, quantity, defined)
        lines.append(f"    <ssv:Parameter name={xml_attribute(variable)}{said}>{typed}</ssv:Parameter>")
    lines += ["  </ssv:Parameters>"]
    if defined:
        lines += ["  <ssv:Units>", *(_unit_text(units[unit]) for unit in units if unit in defined), "  </ssv:Units>"]
    path.write_text("\n".join([*lines, "</ssv:ParameterSet>", ""]), encoding="utf-8")


def _typed(name: str, quantity: Quantity, defined: set[str]) -> str:
    value = quantity.value
    if isinstance(value, bool):
        return f'<ssv:Boolean value="{str(value).lower()}"/>'
    if isinstance(value, int):
        return f'<ssv:Integer value="{value}"/>'
    if isinstance(value, str):
        return f"<ssv:String value={xml_attribute(value)}/>"
    if not math.isfinite(value):
        raise InputError(f"parameter {name!r} is {value}. Leave it out.")
    unit = f" unit={xml_attribute(quantity.unit)}" if quantity.unit is not None and quantity.unit in defined else ""
    return f'<ssv:Real value="{float(value)!r}"{unit}/>'


def _unit_text(unit: Unit) -> str:
    given = (*zip(SI_BASE_UNITS, unit.exponents or (), strict=True), ("factor", unit.factor), ("offset", unit.offset))
    base = "".join(f' {name}="{value!r}"' for name, value in given if value != (1.0 if name == "factor" else 0.0))
    return f"    <ssc:Unit name={xml_attribute(unit.name)}><ssc:BaseUnit{base}/></ssc:Unit>"


# --- common to SSV, SSM and SSD files; what is wrong in one is an InputError that names the place


def local(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def children(element: Element | None, *names: str) -> list[Element]:
    """Return the elements at a path of local names, in file order."""
    found = [] if element is None else [element]
    for name in names:
        found = [child for parent in found for child in parent if local(child) == name]
    return found


def read_xml(path: Path, root: str, what: str, where: str = "") -> Element:
    """Read an XML file; check its size, root name and version."""
    where = where or str(path)
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST_XML + 1)
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror or error}. Check the path.") from None
    if len(text) > LARGEST_XML:
        raise InputError(f"{where}: larger than the limit of {LARGEST_XML} bytes of XML.")
    element = parse_xml(text, where)
    if local(element) != root:
        raise InputError(f"{where}: not {what}: root element {local(element)}, not {root}.")
    version = element.get("version", "")
    if not version.startswith(("1.", "2.")):
        raise InputError(f"{where}: SSP {version or 'of unknown version'} is not supported. Use 1.0 or 2.0.")
    return element


def number(element: Element, attribute: str, where: str, default: float | None = None) -> float:
    """Return an attribute as a number."""
    text = element.get(attribute)
    if text is None and default is not None:
        return default
    try:
        found = float(text or "")
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise InputError(f"{where}: {attribute} of {local(element)} must be a finite number, not {text!r}.")
    return found


def units_of(root: Element, where: str) -> dict[str, Unit]:
    """Return the units defined in an SSD or SSV file."""
    found = {}
    for element in children(root, "Units", "Unit"):
        name = element.get("name", "")
        at = f"{where}, unit {name!r}"
        for base in children(element, "BaseUnit"):
            exponents = tuple(round(number(base, si, at, 0.0)) for si in SI_BASE_UNITS)
            factor = number(base, "factor", at, 1.0)
            if factor == 0:
                raise InputError(f"{at}: factor 0 converts nothing.")
            found[name] = Unit(name, exponents, factor, number(base, "offset", at, 0.0), {})
    return found


def enumerations_of(root: Element, where: str) -> dict[str, dict[str, int]]:
    """Return the enumerations of an SSD or SSV file: numbers by names."""
    return {
        element.get("name", ""): {
            item.get("name", ""): round(number(item, "value", where)) for item in children(element, "Item")
        }
        for element in children(root, "Enumerations", "Enumeration")
    }


def parameter_set(
    root: Element, where: str, enumerations: Mapping[str, Mapping[str, int]] | None = None
) -> ParameterValues:
    """Return the content of a ParameterSet element."""
    known = {**(enumerations or {}), **enumerations_of(root, where)}
    values: dict[str, Quantity] = {}
    for parameter in children(root, "Parameters", "Parameter"):
        name = parameter.get("name", "")
        typed = [child for child in parameter if local(child) != "Annotations"]
        if len(typed) != 1 or typed[0].get("value") is None:
            raise InputError(f"{where}: parameter {name!r} needs one value, such as <Real value=...>.")
        if name in values:
            raise InputError(f"{where}: parameter {name!r} occurs twice. Keep one.")
        value = _value(typed[0], f"{where}, parameter {name!r}")
        items = known.get(typed[0].get("name", "")) if local(typed[0]) == "Enumeration" else None
        values[name] = Quantity(value, typed[0].get("unit") or None, parameter.get("description", ""), items)
    return ParameterValues(root.get("name", ""), values, units_of(root, where))


def _value(element: Element, where: str) -> Value:
    kind, text = local(element), element.get("value", "")
    if kind in ("Real", *FLOATS):
        return number(element, "value", where)
    if kind in ("Integer", *INTEGERS):
        return whole(element, "value", where)
    if kind == "Boolean":
        return truth(element, "value", where)
    if kind in ("String", "Enumeration"):
        return text
    raise InputError(f"{where}: type {kind} is not supported. Remove it.")


def whole(element: Element, attribute: str, where: str) -> int:
    """Return an attribute as an integer."""
    try:
        return int(element.get(attribute, ""))
    except ValueError:
        raise InputError(f"{where}: {element.get(attribute)!r} is not an integer.") from None


def truth(element: Element, attribute: str, where: str) -> bool:
    """Return an attribute as a Boolean; false if it is missing."""
    text = element.get(attribute, "false").strip()
    if text not in ("true", "1", "false", "0"):
        raise InputError(f"{where}: {attribute} of {local(element)} must be true or false, not {text!r}.")
    return text in ("true", "1")


def mapping_entries(root: Element, where: str) -> tuple[MappingEntry, ...]:
    """Return the content of a ParameterMapping element."""
    entries: list[MappingEntry] = []
    for element in children(root, "MappingEntry"):
        source, target = element.get("source"), element.get("target", "")
        if source is None or not target:  # editors write an empty source for a parameter without a value
            raise InputError(f"{where}: a MappingEntry needs both source and target.")
        if target in (entry.target for entry in entries):
            raise InputError(f"{where}: two entries map to {target!r}. Keep one.")
        at = f"{where}, mapping of {source!r}"
        factor, offset, table = transformation(element, at)
        suppress = truth(element, "suppressUnitConversion", at)
        entries.append(MappingEntry(source, target, factor, offset, table, suppress))
    return tuple(entries)


def transformation(element: Element, where: str) -> tuple[float, float, dict[Value, Value] | None]:
    """Return factor and offset, or the table, of an element (SSP 4.5.2)."""
    for child in element:
        kind = local(child)
        if kind == "LinearTransformation":
            return number(child, "factor", where, 1.0), number(child, "offset", where, 0.0), None
        if kind.endswith("MappingTransformation"):
            return 1.0, 0.0, _table(child, kind.removesuffix("MappingTransformation"), where)
        if kind.endswith("Transformation"):
            raise InputError(f"{where}: {kind} is not supported. Use a LinearTransformation or a table.")
    return 1.0, 0.0, None


def _table(element: Element, kind: str, where: str) -> dict[Value, Value]:
    def read(entry: Element, attribute: str) -> Value:
        if kind == "Boolean":
            return truth(entry, attribute, where)
        return whole(entry, attribute, where) if kind == "Integer" else entry.get(attribute, "")

    if kind not in ("Boolean", "Integer", "Enumeration"):
        raise InputError(f"{where}: {kind}MappingTransformation is not supported. Use Boolean, Integer or Enumeration.")
    return {read(entry, "source"): read(entry, "target") for entry in children(element, "MapEntry")}
