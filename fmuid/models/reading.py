"""Reader of a modelDescription.xml, with the standard's defaults.

FMI 2.0.4, section 2.2; FMI 3.0.2, section 2.4.
"""

from __future__ import annotations

import itertools
import math
import re
import zipfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.models.archive import CheckedArchive
from fmuid.models.description import (
    DESCRIPTION_FILE,
    FLOATS,
    INTEGERS,
    KINDS,
    SI_BASE_UNITS,
    Description,
    Interface,
    Unit,
    Variable,
)
from fmuid.models.start_values import ANNOTATION, TOOL, Value
from fmuid.models.untrusted_xml import parse_xml, uncollected

MAX_ELEMENTS = 1_000_000  # variables and elements of arrays: a few words of XML can declare any number

# version -> type of a variable -> FMI 3.0 type of the binary's functions
_TYPES = {
    2: {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32", "Boolean": "Boolean", "String": "String"},
    3: {name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String", "Binary", "Clock")} | {"Enumeration": "Int64"},
}
_INTERFACES = {
    "co-simulation": "CoSimulation", "model-exchange": "ModelExchange", "scheduled-execution": "ScheduledExecution"
}  # fmt: skip
_TRUE = ("true", "1")
_PARAMETERS = ("parameter", "calculatedParameter", "structuralParameter")
# variability -> causality -> initial; what is missing is not allowed (FMI 2.0.4, section 2.2.7; FMI 3.0.2, 2.4.7.4)
_KEPT = {
    **dict.fromkeys(("structuralParameter", "parameter"), "exact"),
    **dict.fromkeys(("calculatedParameter", "local"), "calculated"),
}
_CHANGING = {"input": "exact", "output": "calculated", "local": "calculated"}
_INITIAL: Mapping[str, Mapping[str, str | None]] = {
    "constant": {"output": "exact", "local": "exact"},
    "fixed": _KEPT,
    "tunable": _KEPT,
    "discrete": _CHANGING,
    "continuous": {**_CHANGING, "independent": None},
}
_EXPERIMENT = {"start": "startTime", "stop": "stopTime", "tolerance": "tolerance", "step_size": "stepSize"}
_NO_TYPE = Element("none")


@uncollected()
def read_description(path: Path) -> Description:
    """Read the model description of an FMU; an `InputError` if missing, unreadable, or of another FMI version."""
    if not is_file(path):
        raise InputError(f"{path}: FMU not found. Check the path.")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path}: not an FMU: no zip archive. Export the model again.")
    with CheckedArchive(path) as archive:
        if DESCRIPTION_FILE not in archive.names:
            raise InputError(f"{path}: not an FMU: no {DESCRIPTION_FILE} at its top level.")
        root = parse_xml(archive.read(DESCRIPTION_FILE), f"{path}: {DESCRIPTION_FILE}")
    version = root.get("fmiVersion") or "of unknown version"
    if not re.fullmatch(r"2\.0|3\.0(\..*)?", version):
        raise InputError(f"{path}: FMI {version} is not supported. Export FMI 2.0 or 3.0.")
    try:
        described = _described(root, int(version[0]))
    except InputError as error:
        raise InputError(f"{path}: {DESCRIPTION_FILE}: {error}") from None
    if not described.interfaces:
        raise InputError(f"{path}: neither Co-Simulation nor Model Exchange. Export one of them.")
    return described


def _described(root: Element, version: int) -> Description:
    """Return the root's description; refusals continue the file's name."""
    token = root.get("guid" if version == 2 else "instantiationToken")
    if token is None:
        raise InputError("no guid or instantiationToken. Export the model again.")
    declared, capabilities = _Variables(root, version), _capabilities(root, version)
    derivatives = [variable for _, variable in declared.unknowns("Derivatives", "ContinuousStateDerivative")]
    states = [state for each in derivatives if (state := declared.state(each)) is not None]
    variables = _by_name(declared.variables({_name(each) for each in states}))
    return Description(
        model_name=_name(root),
        fmi_version=root.get("fmiVersion", ""),
        guid=token,
        description=root.get("description", ""),
        generation_tool=root.get("generationTool", ""),
        variables=variables,
        units={_name(each): _unit(each) for each in root.iterfind("UnitDefinitions/Unit")},
        interfaces={kind: _interface(kind, capabilities[kind], version) for kind in KINDS if kind in capabilities},
        default_experiment={
            word: _finite(text, attribute)
            for each in root.iterfind("DefaultExperiment")
            for word, attribute in _EXPERIMENT.items()
            if (text := each.get(attribute)) is not None
        },
        dependencies={
            name: depends
            for each, output in declared.unknowns("Outputs", "Output")
            for depends in [declared.dependencies(each)]
            for name in declared.names(output)
        },
        derivatives=tuple(name for each in derivatives for name in declared.names(each)),
        states=tuple(name for each in states for name in declared.names(each)),
        indicators=declared.indicators,
        applied=_applied(root, version, variables),
        capabilities=capabilities,
    )


class _Variables:
    """Variable elements, known by index (FMI 2.0) or value reference (3.0)."""

    def __init__(self, root: Element, version: int) -> None:
        self.root, self.version, self.wires = root, version, _TYPES[version]
        self.elements = [each for each in root.iterfind("ModelVariables/*") if each.get("name") is not None]
        self.types: dict[str | None, Element] = {None: _NO_TYPE}
        self.aliases: list[tuple[Element, Element]] = []
        if version == 2:
            self.known = dict(enumerate(self.elements, 1))
            self.types |= {each.get("name"): next(iter(each), _NO_TYPE) for each in root.iterfind("TypeDefinitions/*")}
            self.indicators = _integer(root.get("numberOfEventIndicators", "0"), "numberOfEventIndicators")
            count = len(self.elements)
        else:
            self.known = {_reference(each): each for each in self.elements}
            self.types |= {each.get("name"): each for each in root.iterfind("TypeDefinitions/*")}
            self.aliases = [(each, alias) for each in self.elements for alias in each.iterfind("Alias")]
            indicators = [variable for _, variable in self.unknowns("", "EventIndicator")]
            self.indicators = sum(math.prod(self.shape(each)) for each in indicators)
            count = sum(math.prod(self.shape(each)) for each in (*self.elements, *(each for each, _ in self.aliases)))
        for what, number in (("variables and elements of arrays", count), ("event indicators", self.indicators)):
            if number > MAX_ELEMENTS:  # before they are built
                raise InputError(f"{number} {what}; at most {MAX_ELEMENTS} are read.")

    def called(self, key: str | None) -> Element:
        found = self.known.get(_integer(key, "reference to a variable"))
        if found is None:
            raise InputError(f"refers to {key}, which is not declared.")
        return found

    def unknowns(self, tag_2: str, tag_3: str) -> list[tuple[Element, Element]]:
        """Return the entries of a ModelStructure list, each with its variable."""
        path, key = (f"{tag_2}/Unknown", "index") if self.version == 2 else (tag_3, "valueReference")
        return [(each, self.called(each.get(key))) for each in self.root.iterfind(f"ModelStructure/{path}")]

    def dependencies(self, unknown: Element) -> tuple[str, ...] | None:
        given = unknown.get("dependencies")
        return None if given is None else tuple(name for key in given.split() for name in self.names(self.called(key)))

    def state(self, derivative: Element) -> Element | None:
        key = self._value(derivative).get("derivative")
        return None if key is None else self.called(key)

    def shape(self, element: Element) -> list[int]:
        """Return the sizes of an array's dimensions; empty for a scalar."""
        return [
            _integer(each.get("start") or self.called(each.get("valueReference")).get("start"), "the size of an array")
            for each in element.iterfind("Dimension")
        ]

    def names(self, element: Element, name: str | None = None) -> list[str]:
        """Return a variable's name, or an array's element names, row by row."""
        name = name or _name(element)
        if not len(element) or not (shape := self.shape(element)):
            return [name]
        return [f"{name}[{','.join(map(str, at))}]" for at in itertools.product(*(range(1, n + 1) for n in shape))]

    def variables(self, states: Collection[str]) -> Iterator[Variable]:
        for element, called in (*((each, each) for each in self.elements), *self.aliases):
            name, description = _name(called), called.get("description") or element.get("description") or ""
            yield from self._read(element, name, description, name in states)

    def _value(self, element: Element) -> Element:
        """Return the element named after a variable's type; in FMI 3.0 itself."""
        if element.tag in self.wires:
            return element
        for each in element:
            if self.version == 2 and each.tag in self.wires:
                return each
        raise InputError(f"variable {_name(element)!r}: {element.tag} is no type of FMI {self.version}.0.")

    def _read(self, element: Element, name: str, description: str, is_state: bool) -> list[Variable]:
        typed = self._value(element)
        wire = self.wires[typed.tag]
        declared = self.types.get(typed.get("declaredType"))
        if declared is None:
            raise InputError(f"variable {name!r}: type {typed.get('declaredType')!r} is not defined.")
        roles = self._roles(element, name, wire)
        start, unit = typed.get("start"), typed.get("unit") or declared.get("unit") or None
        names, starts = [name], [start]
        array: tuple[str, ...] = ()
        if len(element) and self.version == 3:
            names = self.names(element, name)
            array = () if names == [name] else tuple(names)
            texts = (each.get("value", "") for each in element.iterfind("Start"))
            listed = list(texts) if wire in ("String", "Binary") else (start or "").split()
            one = listed[0] if listed else None
            starts = [*listed] if len(listed) == len(names) else [one] * len(names)
        reference = _reference(element)
        try:
            low, high, nominal = [
                float(text) if (text := typed.get(word) or declared.get(word)) else None
                for word in ("min", "max", "nominal")
            ]
            items = tuple(int(item.get("value", "")) for item in declared.iterfind("Item"))
            values = (None if text is None else _start(text, wire) for text in starts)
            return [
                Variable(
                    each, reference, wire, *roles, unit, value, low, high, nominal, description, is_state, array, items
                )
                for each, value in zip(names, values, strict=True)
            ]
        except ValueError as error:
            raise InputError(f"variable {name!r}: wrong value: {error}.") from None

    def _roles(self, element: Element, name: str, wire: str) -> tuple[str, str, str | None]:
        causality, variability = element.get("causality", "local"), element.get("variability")
        if variability is None:
            fixed = self.version == 3 and causality in _PARAMETERS
            continuous = self.version == 2 or wire.startswith("Float")
            variability = "fixed" if fixed else "continuous" if continuous else "discrete"
        allowed = _INITIAL.get(variability, {})
        initial = element.get("initial", allowed.get(causality))
        if "initial" not in element.attrib and causality not in allowed:
            raise InputError(
                f"variable {name!r}: FMI does not allow causality {causality!r} with variability {variability!r}."
            )
        return causality, variability, initial


def _start(text: str, wire: str) -> Value:
    if wire.startswith("Float"):
        return float(text)
    if wire == "Boolean":
        return text.lower() in _TRUE
    return int(text) if wire in INTEGERS else text


def _by_name(variables: Iterator[Variable]) -> dict[str, Variable]:
    found: dict[str, Variable] = {}
    for variable in variables:
        if found.setdefault(variable.name, variable) is not variable:
            raise InputError(f"variable {variable.name!r} is declared twice. Export the model with distinct names.")
    return found


def _applied(root: Element, version: int, variables: Mapping[str, Variable]) -> dict[str, Value]:
    """Return the start values written by `with_starts`."""
    note = (
        f"VendorAnnotations/Tool[@name='{TOOL}']" if version == 2 else f"Annotations/Annotation[@type='{ANNOTATION}']"
    )
    named = [v for each in root.iterfind(f"{note}//Start") if (v := variables.get(each.get("name", ""))) is not None]
    if not named:
        return {}
    # of variables that share a reference one has the start (FMI 2.0.4, 2.2.7)
    starts = {(v.type, v.reference): v.start for v in variables.values() if v.start is not None and not v.array}
    found = {v.name: starts.get((v.type, v.reference)) if v.start is None else v.start for v in named}
    return {name: start for name, start in found.items() if start is not None}


def _name(element: Element) -> str:
    found = element.get("modelName" if element.tag == "fmiModelDescription" else "name")
    if found is None:
        raise InputError(f"{element.tag} without a name.")
    return found


def _integer(text: str | None, what: str) -> int:
    """Return a value reference, an index or a size."""
    try:
        number = int(text or "")
    except ValueError:
        number = -1
    if not 0 <= number < 2**32:
        raise InputError(f"{what} = {text} is no unsigned 32-bit integer.")
    return number


def _reference(element: Element) -> int:
    return _integer(element.get("valueReference"), f"the value reference of {element.get('name')!r}")


def _finite(text: str, what: str, *, zero: bool = True) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or (number == 0 and not zero):
        raise InputError(f"{what} = {text} is not a usable number.")
    return number


def _linear(element: Element) -> tuple[float, float]:
    what = repr(element.get("name", "a unit"))
    factor = _finite(element.get("factor", "1"), f"the factor of {what}", zero=False)
    return factor, _finite(element.get("offset", "0"), f"the offset of {what}")


def _unit(element: Element) -> Unit:
    base = element.find("BaseUnit")
    factor, offset = (1.0, 0.0) if base is None else _linear(base)
    exponents = None
    if base is not None:
        try:
            exponents = tuple(int(base.get(si, "0")) for si in SI_BASE_UNITS)
        except ValueError as error:
            raise InputError(f"unit {element.get('name')!r}: wrong exponent: {error}.") from None
    display_units = {_name(each): _linear(each) for each in element.iterfind("DisplayUnit")}
    return Unit(_name(element), exponents, factor, offset, display_units)


def _capabilities(root: Element, version: int) -> dict[str, dict[str, str]]:
    found = {kind: dict(each.attrib) for kind, tag in _INTERFACES.items() for each in root.iterfind(tag)}
    if version == 2 and "model-exchange" in found:  # FMI 2.0 states the opposite
        given = found["model-exchange"]
        told = given.pop("completedIntegratorStepNotNeeded", "false").strip() in _TRUE
        given["needsCompletedIntegratorStep"] = "false" if told else "true"
    return found


def _interface(kind: str, given: Mapping[str, str], version: int) -> Interface:
    def true(attribute: str) -> bool:
        return given.get(attribute) in _TRUE

    identifier = given.get("modelIdentifier")
    if not identifier or set("/\\:\0") & set(identifier):  # it names the binary: a path would lead to another file
        raise InputError(f"modelIdentifier {identifier!r} names no binary. Export the model again.")
    of_steps = kind == "co-simulation"
    return Interface(
        identifier=identifier,
        needs_execution_tool=true("needsExecutionTool"),
        once_per_process=true("canBeInstantiatedOnlyOncePerProcess"),
        declared_repeatable=given.get("canBeInstantiatedOnlyOncePerProcess") in ("false", "0"),
        directional_derivatives=true("providesDirectionalDerivative" + "s" * (version == 3)),
        variable_step=of_steps and true("canHandleVariableCommunicationStepSize"),
        interpolates_inputs=of_steps and true("canInterpolateInputs"),
        event_mode=of_steps and version == 3 and true("hasEventMode"),
        completed_step=of_steps or true("needsCompletedIntegratorStep"),
    )
