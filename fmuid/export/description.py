"""Writes the FMI 2.0 model description (modelDescription.xml) of a model."""

from __future__ import annotations

import math
import re
from xml.sax.saxutils import quoteattr

import casadi as ca

from fmuid.errors import ModelicaError, nearest
from fmuid.export.equations import System
from fmuid.export.syntax import Declaration

_BASE_UNITS = ("kg", "m", "s", "A", "rad")
_DERIVED_UNITS = {
    "N": "kg.m.s-2",
    "J": "kg.m2.s-2",
    "W": "kg.m2.s-3",
    "V": "kg.m2.s-3.A-1",
    "Ohm": "kg.m2.s-3.A-2",
    "H": "kg.m2.s-2.A-2",
    "Wb": "kg.m2.s-2.A-1",
}
_DISPLAY_UNITS = {
    "rad": ("deg", 180 / math.pi),
    "rad/s": ("rpm", 30 / math.pi),
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
}
"""Unit -> one that tables often have instead, and how many of it make one."""


def description(system: System, guid: str) -> str:
    """Return the text of modelDescription.xml; by the `guid`, binary and description recognise each other."""
    model, variables = system.model, _Variables(system)
    capabilities = (
        f'modelIdentifier="{model.name}" canNotUseMemoryManagementFunctions="true" canGetAndSetFMUstate="true" '
        'canSerializeFMUstate="true" providesDirectionalDerivative="true"'
    )
    sources = '<SourceFiles><File name="fmi2.c"/></SourceFiles>'
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="2.0" modelName="{model.name}" guid="{guid}"'
            f"{_attribute('description', model.description)}"
            ' generationTool="fmuid" variableNamingConvention="structured" numberOfEventIndicators="0">',
            f'<ModelExchange {capabilities} completedIntegratorStepNotNeeded="true">{sources}</ModelExchange>',
            f'<CoSimulation {capabilities} canHandleVariableCommunicationStepSize="true"'
            f' canInterpolateInputs="true">{sources}</CoSimulation>',
            *variables.unit_definitions(),
            '<LogCategories><Category name="logStatusError" description="why a call failed"/></LogCategories>',
            f'<DefaultExperiment startTime="0.0" stopTime="{model.stop_time!r}" stepSize="{model.interval!r}"/>',
            "<ModelVariables>",
            *variables.elements,
            "</ModelVariables>",
            *variables.structure(),
            "</fmiModelDescription>",
            "",
        ]
    )


def _attribute(name: str, value: str | float | None) -> str:
    if value is None or value == "":
        return ""
    return f" {name}={quoteattr(value if isinstance(value, str) else repr(value))}"


class _Variables:
    """The variables in the order of their declarations, then the derivatives; `index` counts from 1 (FMI)."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.units: dict[str, str] = {}  # name -> BaseUnit element
        references = {name: k for k, name in enumerate(system.names())}
        declared = [d for d in system.model.declarations if d.role != "constant"]
        rates = [_rate(d) for d in system.states]
        self.index = {d.name: k for k, d in enumerate([*declared, *rates], start=1)}
        self.elements = [self.element(d, references[d.name]) for d in declared]
        for d, rate in zip(system.states, rates, strict=True):
            self.elements.append(self.element(rate, references[rate.name], str(self.index[d.name])))

    def element(self, d: Declaration, reference: int, derivative: str | None = None) -> str:
        number = self.system.numbers.get
        if d.unit is not None:
            self.units[d.unit] = self.base_unit(d)
        initial = {"parameter": "exact", "input": None}.get(d.role, "calculated")
        start = {"parameter": number((d.name, "value")), "input": number((d.name, "start"), 0.0)}.get(d.role)
        limits = {key: number((d.name, key)) for key in ("min", "max", "nominal")}
        real = {"unit": d.unit, **limits, "start": start, "derivative": derivative}
        return (
            f'  <ScalarVariable name="{d.name}" valueReference="{reference}"'
            f'{_attribute("description", d.description)} causality="{d.role}"'
            f' variability="{"tunable" if d.role == "parameter" else "continuous"}"{_attribute("initial", initial)}>'
            f"<Real{''.join(_attribute(key, value) for key, value in real.items())}/></ScalarVariable>"
        )

    def base_unit(self, d: Declaration) -> str:
        """Return the BaseUnit element of a variable's unit, such as ``V.s/m`` or ``N/(m.s)``."""
        exponents = dict.fromkeys(_BASE_UNITS, 0)

        def multiply(product: str, power: int) -> None:
            for factor in product.split("."):
                match = re.fullmatch(r"([A-Za-z]+|1)(-?\d+)?", factor)
                name = match[1] if match else factor
                exponent = power * int(match[2] or 1) if match else 0
                if name in exponents:
                    exponents[name] += exponent
                elif name in _DERIVED_UNITS:
                    multiply(_DERIVED_UNITS[name], exponent)
                elif factor != "1":
                    known = [*_BASE_UNITS, *_DERIVED_UNITS]
                    raise ModelicaError(
                        self.system.model.file,
                        d.line,
                        f"unit '{d.unit}' of '{d.name}' is outside the exported subset: "
                        f"write it as in 'V.s/m2' with {', '.join(known)}{nearest(name, known)}",
                    )

        numerator, _, denominator = str(d.unit).partition("/")
        multiply(numerator, 1)
        multiply(re.sub(r"^\((.*)\)$", r"\1", denominator) or "1", -1)
        return f"<BaseUnit{''.join(_attribute(name, str(e)) for name, e in exponents.items() if e)}/>"

    def unit_definitions(self) -> list[str]:
        lines = []
        for unit, base in sorted(self.units.items()):
            name, factor = _DISPLAY_UNITS.get(unit, (None, 0.0))
            display = f'<DisplayUnit name="{name}" factor="{factor!r}"/>' if name else ""
            lines.append(f'  <Unit name="{unit}">{base}{display}</Unit>')
        return ["<UnitDefinitions>", *lines, "</UnitDefinitions>"] if lines else []

    def structure(self) -> list[str]:
        """Return the ModelStructure: exactly what depends on what, from the symbols in each expression."""
        s = self.system
        rates = [_rate(d).name for d in s.states]
        now = ca.vertcat(s.x, s.plain(ca.vertcat(s.derivatives, s.algebraic)))
        initially = ca.substitute(now, s.x, s.starts)
        names = [*(d.name for d in s.states), *rates, *(d.name for d in s.others)]
        knowns, initial_knowns = ({d.name for d in (*s.inputs, *more)} for more in (s.states, s.parameters))

        def unknown(name: str, values: ca.SX, knowns: set[str]) -> str:
            symbols = {symbol.name() for symbol in ca.symvar(values[names.index(name)])}
            dependencies = " ".join(map(str, sorted(self.index[known] for known in symbols & knowns)))
            return f'    <Unknown index="{self.index[name]}" dependencies="{dependencies}"/>'

        outputs = [d.name for d in s.model.declarations if d.role == "output"]
        initial = sorted({*outputs, *rates, *(d.name for d in s.states)}, key=self.index.__getitem__)
        lines = []
        for element, unknowns in (
            ("Outputs", [unknown(name, now, knowns) for name in outputs]),
            ("Derivatives", [unknown(name, now, knowns) for name in rates]),
            ("InitialUnknowns", [unknown(name, initially, initial_knowns) for name in initial]),
        ):
            lines += [f"  <{element}>", *unknowns, f"  </{element}>"] if unknowns else []
        return ["<ModelStructure>", *lines, "</ModelStructure>"]


def _rate(state: Declaration) -> Declaration:
    """Return the declaration of a state's derivative."""
    unit = state.unit
    if unit is not None:
        numerator, _, denominator = unit.partition("/")
        per_second = {"": "s", "s": "s2"}.get(denominator, f"({denominator.strip('()')}.s)")
        unit = f"{numerator}/{per_second}"
    what = f"time derivative of {state.description or state.name}"
    return Declaration(f"der({state.name})", "local", state.line, what, unit)
