"""Variables of model descriptions: units, limits, dependencies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import casadi as ca

from fmuid.errors import ModelicaError
from fmuid.export.explicit_model import ExplicitModel
from fmuid.export.syntax import Declaration
from fmuid.units import parse_unit

_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DISPLAY_UNITS = {"rad": ("deg", 180 / math.pi), "rad/s": ("rpm", 30 / math.pi), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
"""Unit -> display unit, and its number per unit."""


@dataclass(frozen=True)
class DescribedVariable:
    """FMI variable; a derivative has the name of its `state`."""

    name: str
    reference: int
    causality: str
    description: str = ""
    initial: str | None = None
    state: str | None = None
    attributes: tuple[tuple[str, str | float | None], ...] = ()

    @property
    def variability(self) -> str:
        """FMI's variability."""
        return "tunable" if self.causality == "parameter" else "continuous"


@dataclass(frozen=True)
class Unknown:
    """Computed variable with the known variables that it depends on."""

    name: str
    dependencies: frozenset[str]


def variables(system: ExplicitModel) -> list[DescribedVariable]:
    """Return the declared variables in their order, then the derivatives."""
    references = {name: k for k, name in enumerate(system.names())}
    number = system.numbers.get

    def variable(d: Declaration, state: str | None = None) -> DescribedVariable:
        initial = {"parameter": "exact", "input": None}.get(d.role, "calculated")
        start = {"parameter": number((d.name, "value")), "input": number((d.name, "start"), 0.0)}.get(d.role)
        limits = ((key, number((d.name, key))) for key in ("min", "max", "nominal"))
        attributes = (("unit", d.unit), *limits, ("start", start))
        return DescribedVariable(d.name, references[d.name], d.role, d.description, initial, state, attributes)

    declared = [variable(d) for d in system.model.declarations if d.role != "constant"]
    return [*declared, *(variable(_rate(d), d.name) for d in system.states)]


def indicators(system: ExplicitModel) -> list[DescribedVariable]:
    """Return the event indicators."""
    names = system.indicator_names()
    texts = [f"it changes sign with {each.text}" for each in system.relations]
    for each in system.integers:
        texts += [f"not positive where {each.text} jumps up", f"positive where {each.text} jumps down"]
    first = len(system.names()) - 1 - len(names)
    return [
        DescribedVariable(name, first + k, "local", f"event indicator: {text}", "calculated")
        for k, (name, text) in enumerate(zip(names, texts, strict=True))
    ]


def _rate(state: Declaration) -> Declaration:
    """Return the declaration of a state's derivative."""
    unit = state.unit
    if unit is not None:
        numerator, _, denominator = unit.partition("/")
        per_second = {"": "s", "s": "s2"}.get(denominator, f"({denominator.strip('()')}.s)")
        unit = f"{numerator}/{per_second}"
    what = f"time derivative of {state.description or state.name}"
    return Declaration(f"der({state.name})", "local", state.line, what, unit)


def unknowns(system: ExplicitModel) -> dict[str, list[Unknown]]:
    """Return the dependencies of "outputs", "derivatives", "initial" unknowns and "indicators"."""
    s = system
    computed = s.plain(ca.vertcat(s.derivatives, s.algebraic, s.indicators))
    now = ca.vertcat(s.x, _settled(s, computed))
    initially = ca.substitute(now, s.x, s.starts)
    rates = [f"der({d.name})" for d in s.states]
    names = [*(d.name for d in s.states), *rates, *(d.name for d in s.others), *s.indicator_names()]
    place = {name: k for k, name in enumerate(names)}
    outputs = [d.name for d in s.model.declarations if d.role == "output"]
    knowns, initial_knowns = ({"time", *(d.name for d in (*s.inputs, *more))} for more in (s.states, s.parameters))

    def of(chosen: list[str], values: Any, knowns: set[str]) -> list[Unknown]:
        symbols = ({symbol.name() for symbol in ca.symvar(values[place[name]])} for name in chosen)
        return [Unknown(name, frozenset(each & knowns)) for name, each in zip(chosen, symbols, strict=True)]

    order = {each.name: k for k, each in enumerate(variables(s))}
    initial = sorted({*outputs, *rates, *(d.name for d in s.states)}, key=order.__getitem__)
    return {
        "outputs": of(outputs, now, knowns),
        "derivatives": of(rates, now, knowns),
        "initial": of(initial, initially, initial_knowns),
        "indicators": of(s.indicator_names(), now, knowns),
    }


def _settled(system: ExplicitModel, expressions: Any) -> Any:
    """Return expressions with relations and floor() replaced by their arguments."""
    signs = [system.indicators[k] > 0 for k in range(len(system.relations))]
    values = system.plain(ca.vertcat(*signs, ca.floor(system.counted)))
    while system.r.numel() and ca.depends_on(expressions, system.r):  # relations may depend on others
        expressions = ca.substitute(expressions, system.r, values)
    return expressions


def attribute(name: str, value: str | float | None) -> str:
    """Return an XML attribute after a space, or nothing."""
    if value is None or value == "":
        return ""
    return f" {name}={quoteattr(value if isinstance(value, str) else repr(value))}"


def unit_definitions(system: ExplicitModel) -> list[str]:
    """Return the UnitDefinitions; raise `ModelicaError` for unsupported units."""
    declared = [d for d in system.model.declarations if d.role != "constant"]
    units = {d.unit: d for d in [*map(_rate, system.states), *declared] if d.unit is not None}
    lines = []
    for unit, d in sorted(units.items()):
        name, factor = _DISPLAY_UNITS.get(unit, (None, 0.0))
        display = f'<DisplayUnit name="{name}" factor="{factor!r}"/>' if name else ""
        lines.append(f'  <Unit name="{unit}">{_base_unit(d, system.model.file)}{display}</Unit>')
    return ["<UnitDefinitions>", *lines, "</UnitDefinitions>"] if lines else []


def _base_unit(d: Declaration, file: str) -> str:
    """Return the BaseUnit element of a unit such as ``V.s/m``."""
    unit = parse_unit(str(d.unit)) or parse_unit(f"1.{d.unit}")  # C and F alone: no temperatures in Modelica
    if unit is None:
        said = f"unit '{d.unit}' of '{d.name}' is outside the exported subset"
        raise ModelicaError(file, d.line, f"{said}: write it as in 'V.s/m2'")
    powers = "".join(attribute(name, str(e)) for name, e in zip(_BASE_UNITS, unit.exponents, strict=True) if e)
    factor = attribute("factor", unit.factor) if unit.factor != 1.0 else ""
    return f"<BaseUnit{powers}{factor}{attribute('offset', unit.offset) if unit.offset else ''}/>"
