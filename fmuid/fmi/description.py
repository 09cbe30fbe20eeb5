"""What an FMU declares: variables, units, capabilities (FMI 2.0.4, section 2.2; FMI 3.0.2, section 2.4)."""

from __future__ import annotations

import itertools
import math
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.fmi import safe_xml
from fmuid.fmi.archive import Zipped, archive_of
from fmuid.fmi.start_values import applied_values

DESCRIPTION_FILE = "modelDescription.xml"
READABLE_VERSIONS = ("2.0", "3.0")
KINDS = ("co-simulation", "model-exchange")
MOST_ELEMENTS = 1_000_000
"""Variables, with every element of an array: a few words of XML can declare any number."""
SI_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

# FMI type -> (type in fmuid, FMI 3.0 type that the binary's functions take)
_TYPES = {
    "Real": ("Real", "Float64"),
    "Float64": ("Real", "Float64"),
    "Float32": ("Real", "Float32"),
    "Integer": ("Integer", "Int32"),
    **{f"{sign}Int{bits}": ("Integer", f"{sign}Int{bits}") for sign in ("", "U") for bits in (8, 16, 32, 64)},
    "Boolean": ("Boolean", "Boolean"),
    "String": ("String", "String"),
    "Binary": ("Binary", "Binary"),
    "Clock": ("Clock", "Clock"),
}

_NEVER_SET = ("calculatedParameter", "independent", "structuralParameter")


@dataclass(frozen=True)
class Variable:
    """One scalar variable of an FMU (FMI 2.0.4, section 2.2.7; FMI 3.0.2, section 2.4.7), or one element of an array.

    `start`, `min`, `max` and `nominal` are in `unit`; `type` is Real, Integer, Boolean, String, Binary or Clock
    (an enumeration is an Integer), `wire` the FMI 3.0 type that the binary's functions take. The elements of an array
    (FMI 3.0) are variables ``x[1,1]``, ``x[1,2]`` of one `reference`; `array` has all their names, row by row.
    """

    name: str
    reference: int
    type: str
    wire: str
    causality: str
    variability: str
    initial: str | None = None
    unit: str | None = None
    start: float | int | bool | str | None = None
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    description: str = ""
    is_state: bool = False
    array: tuple[str, ...] = ()

    @property
    def settable(self) -> bool:
        """Whether a value set before initialisation has an effect that the standard promises."""
        if self.variability == "constant" or self.causality in _NEVER_SET:
            return False
        return self.causality in ("parameter", "input") or self.initial in ("exact", "approx")

    @property
    def continuous(self) -> bool:
        """Whether the variable may change continuously, so that interpolation makes sense."""
        return self.type == "Real" and self.variability == "continuous"


@dataclass(frozen=True)
class Unit:
    """A unit that the FMU defines: SI exponents, ``base = factor * value + offset``, and its display units.

    ``display = factor * value + offset`` for each of `display_units` (FMI 2.0.4, section 2.2.2).
    """

    name: str
    exponents: tuple[int, ...] | None
    factor: float
    offset: float
    display_units: Mapping[str, tuple[float, float]]


def unit_conversion(source: Unit | None, target: Unit | None) -> tuple[float, float] | None:
    """Return (factor, offset) with ``target = factor * source + offset``; None where the units do not convert."""
    if source is None or target is None or source.exponents is None or source.exponents != target.exponents:
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


@dataclass(frozen=True)
class Interface:
    """One of the two FMI interfaces and its capabilities (FMI 2.0.4, sections 3.3.1, 4.3.1; FMI 3.0.2, 2.4.8)."""

    kind: str
    identifier: str
    needs_execution_tool: bool
    once_per_process: bool
    directional_derivatives: bool
    variable_step: bool = False
    interpolates_inputs: bool = False
    event_mode: bool = False
    completed_step: bool = True
    declared_repeatable: bool = False  # explicitly declared not `once_per_process`


@dataclass(frozen=True)
class Description:
    """The parts of a modelDescription.xml that fmuid works with."""

    model_name: str
    fmi_version: str
    guid: str
    description: str
    generation_tool: str
    variables: Mapping[str, Variable]
    units: Mapping[str, Unit]
    interfaces: Mapping[str, Interface]
    default_experiment: Mapping[str, float]
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    """For each output: the variables that it depends on directly; None where the FMU does not say."""
    derivatives: tuple[str, ...] = ()
    """The derivatives of the continuous states, in the order of the states."""
    states: tuple[str, ...] = ()
    """The continuous states, in their order."""
    indicators: int = 0
    """Number of event indicators."""
    applied: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    """Start values written by `fmuid apply`: the importer must set them (`fmuid.fmi.start_values`)."""

    @property
    def major_version(self) -> int:
        """2 or 3."""
        return int(self.fmi_version[0])

    def with_causality(self, causality: str) -> list[Variable]:
        """Return the variables of one causality, in the FMU's order."""
        return [variable for variable in self.variables.values() if variable.causality == causality]

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of all inputs."""
        return tuple(variable.name for variable in self.with_causality("input"))

    def conversion(self, variable: Variable, unit: str) -> tuple[float, float]:
        """Return (factor, offset) such that ``value in variable.unit = factor * value in unit + offset``.

        Raises
        ------
        InputError
            If the FMU defines no conversion between the two units.
        """
        if unit == variable.unit:
            return 1.0, 0.0
        own = self.units.get(variable.unit or "")
        if own is not None and unit in own.display_units:
            factor, offset = own.display_units[unit]
            return 1.0 / factor, -offset / factor
        conversion = unit_conversion(self.units.get(unit), own)
        if conversion is not None:
            return conversion
        known = sorted(set(own.display_units) if own else set())
        known += [u.name for u in self.units.values() if own and u is not own and u.exponents == own.exponents]
        raise InputError(
            f"{self.model_name} defines no conversion from {unit!r} to the unit of {variable.name!r}, "
            f"{variable.unit or 'none'!r}; convert the column, or use one of: {', '.join(known) or 'no other unit'}"
        )


@safe_xml.uncollected()
def read_description(path: Path) -> Description:
    """Read the model description inside an FMU.

    Raises
    ------
    InputError
        If the file is missing, is no zip archive, has no readable model description, or is of another FMI version.
    """
    if not is_file(path):
        raise InputError(f"{path}: there is no such FMU file; check the path")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is not an FMU: it is not a zip archive; export the model again")
    text = read_text(path)
    root = _checked_root(path, text)
    from fmpy import read_model_description

    try:
        parsed = read_model_description(archive_of({DESCRIPTION_FILE: text}), validate=False)
        if parsed.coSimulation is None and parsed.modelExchange is None:
            raise InputError(f"{path} offers neither co-simulation nor model exchange; export it as one of these")
        elements = {element.tag: element for element in root}
        return replace(_convert(parsed, elements), applied=applied_values(text))
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None
    except Exception as error:  # FMPy raises errors of many kinds, even AttributeError
        said = f"it refers to {error}, which it does not declare" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: its {DESCRIPTION_FILE} cannot be read: {said}") from error


def read_text(path: Path) -> bytes:
    """Return the modelDescription.xml of an FMU.

    Raises
    ------
    InputError
        If the archive is refused, or has none.
    """
    with Zipped(path) as archive:
        if DESCRIPTION_FILE not in archive.names:
            raise InputError(f"{path} is not an FMU: it has no {DESCRIPTION_FILE} at its top level")
        return archive.read(DESCRIPTION_FILE)


def _checked_root(path: Path, text: bytes) -> Element:
    """Return the root of a model description, of a supported version."""
    root = safe_xml.parse(text, f"{path}: its {DESCRIPTION_FILE}")
    version = root.get("fmiVersion")
    if not re.match(r"(2\.0|3\.0)(\.|$)", version or ""):
        raise InputError(
            f"{path} is an FMU of FMI {version or 'of unknown version'}, and only FMI "
            f"{' and '.join(READABLE_VERSIONS)} are read; export the model as one of these"
        )
    return root


def _convert(parsed: Any, elements: Mapping[str, Element]) -> Description:
    states = {unknown.variable.derivative.name for unknown in parsed.derivatives if unknown.variable.derivative}
    _check_names(parsed)
    _check_size(parsed)
    experiment = parsed.defaultExperiment
    words = {"start": "startTime", "stop": "stopTime", "tolerance": "tolerance", "step_size": "stepSize"}
    enumeration = "Int32" if parsed.fmiVersion.startswith("2") else "Int64"
    declared = {word: getattr(experiment, attribute, None) for word, attribute in words.items()}
    return Description(
        model_name=parsed.modelName,
        fmi_version=parsed.fmiVersion,
        guid=parsed.guid,
        description=parsed.description or "",
        generation_tool=parsed.generationTool or "",
        variables={
            v.name: v for given in parsed.modelVariables for v in _scalars(given, given.name in states, enumeration)
        },
        units={unit.name: _unit(unit) for unit in parsed.unitDefinitions},
        interfaces={
            kind: _interface(kind, element, elements[type(element).__name__])
            for kind, element in zip(KINDS, (parsed.coSimulation, parsed.modelExchange), strict=True)
            if element is not None
        },
        default_experiment={word: _finite(value, words[word]) for word, value in declared.items() if value is not None},
        dependencies={
            name: depends
            for unknown in parsed.outputs
            for depends in [None if unknown.dependencies is None else tuple(_names(unknown.dependencies))]
            for name in _names([unknown.variable])
        },
        derivatives=tuple(_names(unknown.variable for unknown in parsed.derivatives)),
        states=tuple(_names(u.variable.derivative for u in parsed.derivatives if u.variable.derivative)),
        indicators=int(parsed.numberOfEventIndicators),
    )


def _check_names(parsed: Any) -> None:
    given = [("fmiModelDescription", parsed.modelName), ("Unit", *(unit.name for unit in parsed.unitDefinitions))]
    given.append(("DisplayUnit", *(each.name for unit in parsed.unitDefinitions for each in unit.displayUnits)))
    for element, *names in given:
        if None in names:
            raise InputError(f"its {DESCRIPTION_FILE} has a {element} without its name")
    if parsed.guid is None:
        raise InputError(f"its {DESCRIPTION_FILE} has no guid or instantiationToken, which the binary asks for")


def _check_size(parsed: Any) -> None:
    """Refuse what does not fit in memory, before it is built, and what the binary's functions do not take."""
    count = sum(math.prod(variable.shape or ()) for variable in parsed.modelVariables)
    for what, number in (
        ("variables and elements of arrays", count),
        ("event indicators", parsed.numberOfEventIndicators),
    ):
        if not 0 <= number <= MOST_ELEMENTS:
            raise InputError(f"its {DESCRIPTION_FILE} declares {number} {what}, and at most {MOST_ELEMENTS} are read")
    for variable in parsed.modelVariables:
        if not 0 <= variable.valueReference < 2**32:
            raise InputError(
                f"its {DESCRIPTION_FILE} gives {variable.name!r} the value reference {variable.valueReference}, "
                "which is no unsigned 32-bit integer"
            )


def _finite(number: Any, what: str, *, zero: bool = True) -> float:
    found = float(number)
    if not math.isfinite(found) or (found == 0 and not zero):
        raise InputError(f"its {DESCRIPTION_FILE} has {what} = {number}, which no calculation can use")
    return found


def _names(variables: Iterable[Any]) -> list[str]:
    """Return the names of variables, those of all its elements for an array: row by row, counted from 1."""
    found = []
    for variable in variables:
        subscripts = itertools.product(*(range(1, n + 1) for n in variable.shape or ()))
        found += [variable.name + f"[{','.join(map(str, each))}]" * bool(each) for each in subscripts]
    return found


def _scalars(parsed: Any, is_state: bool, enumeration: str) -> list[Variable]:
    """Return a variable, or all elements of an array."""
    declared = parsed.declaredType
    kind, wire = ("Integer", enumeration) if parsed.type == "Enumeration" else _TYPES[parsed.type]

    def number(attribute: str) -> float | None:
        text = getattr(parsed, attribute) or (declared and getattr(declared, attribute))
        return float(text) if text else None

    names = _names([parsed]) if parsed.shape else [parsed.name]
    array = tuple(names) if parsed.shape else ()
    starts = [parsed.start]
    if parsed.shape:
        listed = (parsed.start or "").split()
        starts = listed if len(listed) == len(names) else [listed[0] if listed else None] * len(names)
    return [
        Variable(
            name=name,
            reference=parsed.valueReference,
            type=kind,
            wire=wire,
            causality=parsed.causality or "local",
            variability=parsed.variability or "continuous",
            initial=parsed.initial,
            unit=parsed.unit or (declared.unit if declared else None) or None,
            start=_start(kind, start),
            min=number("min"),
            max=number("max"),
            nominal=number("nominal"),
            description=parsed.description or "",
            is_state=is_state,
            array=array,
        )
        for name, start in zip(names, starts, strict=True)
    ]


def _start(kind: str, text: str | None) -> float | int | bool | str | None:
    if kind == "Boolean" and text is not None:
        return text.lower() in ("true", "1")
    return text if text is None else {"Real": float, "Integer": int}.get(kind, str)(text)


def _unit(parsed: Any) -> Unit:
    base = parsed.baseUnit
    return Unit(
        name=parsed.name,
        exponents=None if base is None else tuple(int(getattr(base, si)) for si in SI_BASE_UNITS),
        factor=1.0 if base is None else _finite(base.factor, f"the factor of {parsed.name!r}", zero=False),
        offset=0.0 if base is None else _finite(base.offset, f"the offset of {parsed.name!r}"),
        display_units={
            display.name: (
                _finite(display.factor, f"the factor of {display.name!r}", zero=False),
                _finite(display.offset, f"the offset of {display.name!r}"),
            )
            for display in parsed.displayUnits
        },
    )


def _interface(kind: str, parsed: Any, element: Element) -> Interface:
    identifier = parsed.modelIdentifier
    if not identifier or set("/\\:\0") & set(identifier):  # it names the binary: a path would lead to another file
        raise InputError(f"its modelIdentifier is {identifier!r}, which is no name of a binary in it; export it again")
    # FMPy reads this attribute for FMI 2.0 only, and does not tell defaults from declared values
    directional = element.get("providesDirectionalDerivatives") in ("true", "1")
    return Interface(
        kind=kind,
        identifier=identifier,
        needs_execution_tool=bool(parsed.needsExecutionTool),
        once_per_process=bool(parsed.canBeInstantiatedOnlyOncePerProcess),
        declared_repeatable=element.get("canBeInstantiatedOnlyOncePerProcess") in ("false", "0"),
        directional_derivatives=directional or bool(parsed.providesDirectionalDerivative),
        variable_step=bool(getattr(parsed, "canHandleVariableCommunicationStepSize", False)),
        interpolates_inputs=bool(getattr(parsed, "canInterpolateInputs", False)),
        event_mode=bool(getattr(parsed, "hasEventMode", False)),
        completed_step=bool(getattr(parsed, "needsCompletedIntegratorStep", True)),
    )
