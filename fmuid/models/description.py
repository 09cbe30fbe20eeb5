"""Declarations of an FMU (FMI 2.0.4, 2.2; FMI 3.0.2, 2.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from fmuid.errors import InputError
from fmuid.units import SHORT_FORMS, BaseUnit, parse_unit

DESCRIPTION_FILE = "modelDescription.xml"
KINDS = ("co-simulation", "model-exchange")
FLOATS = ("Float64", "Float32")
INTEGERS = tuple(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))
SI_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_NEVER_SET = ("calculatedParameter", "independent", "structuralParameter")


class Variable(NamedTuple):
    """A scalar variable of an FMU, or one element of an array.

    `start`, `min`, `max` and `nominal` are in `unit`. `wire` is the FMI 3.0 type of the binary's functions.
    Elements of an array are variables ``x[1,2]`` with one `reference`; `array` has all their names, row by row.
    `items` are the values of an enumeration (FMI 2.0.4, 2.2.7; FMI 3.0.2, 2.4.7).
    """

    name: str
    reference: int
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
    items: tuple[int, ...] = ()

    @property
    def type(self) -> str:
        """Real, Integer (also of an enumeration), Boolean, String, Binary or Clock."""
        if self.wire.startswith("Float"):
            return "Real"
        return "Integer" if "Int" in self.wire else self.wire

    @property
    def settable(self) -> bool:
        """Whether the standard promises an effect of a value set before initialization."""
        if self.variability == "constant" or self.causality in _NEVER_SET:
            return False
        return self.causality in ("parameter", "input") or self.initial in ("exact", "approx")

    @property
    def continuous(self) -> bool:
        """Whether the variable may change continuously."""
        return self.type == "Real" and self.variability == "continuous"


@dataclass(frozen=True)
class Unit:
    """A unit of an FMU: ``base = factor * value + offset``.

    ``display = factor * value + offset`` for each of `display_units` (FMI 2.0.4, 2.2.2).
    """

    name: str
    exponents: tuple[int, ...] | None
    factor: float
    offset: float
    display_units: Mapping[str, tuple[float, float]]


def unit_conversion(source: Unit | BaseUnit | None, target: Unit | BaseUnit | None) -> tuple[float, float] | None:
    """Return (factor, offset), ``target = factor * source + offset``; None without conversion."""
    if source is None or target is None or source.exponents is None or source.exponents != target.exponents:
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


@dataclass(frozen=True)
class Interface:
    """Capabilities of an FMI interface (FMI 2.0.4, 3.3.1, 4.3.1; FMI 3.0.2, 2.4.8)."""

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
    """Content of a modelDescription.xml, as used by fmuid."""

    model_name: str
    fmi_version: str
    guid: str
    description: str
    generation_tool: str
    variables: Mapping[str, Variable]
    units: Mapping[str, Unit]
    interfaces: Mapping[str, Interface]
    default_experiment: Mapping[str, float]
    # for each output: the variables that it depends on directly; None where the FMU does not say
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    derivatives: tuple[str, ...] = ()  # the derivatives of the continuous states, in the order of the states
    states: tuple[str, ...] = ()  # the continuous states, in their order
    indicators: int = 0  # number of event indicators
    # start values written by `fmuid apply`: the importer must set them (`fmuid.models.start_values`)
    applied: Mapping[str, float | int | bool | str] = field(default_factory=dict)

    # declared attributes of each interface; "needsCompletedIntegratorStep" has its FMI 3.0 name
    capabilities: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

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
        """Return (factor, offset) from a unit to the variable's unit; `InputError` if they do not convert.

        The FMU's own definitions precede general ones (`fmuid.units`).
        """
        if unit == (variable.unit or ""):
            return 1.0, 0.0
        own = self.units.get(variable.unit or "")
        if own is not None and unit in own.display_units:
            factor, offset = own.display_units[unit]
            return 1.0 / factor, -offset / factor
        meant, expected = parse_unit(unit), parse_unit(variable.unit or "")
        short = parse_unit(SHORT_FORMS[unit]) if unit in SHORT_FORMS else None
        for pair in ((self.units.get(unit), own), (meant, own), (meant, expected), (short, own), (short, expected)):
            conversion = unit_conversion(*pair)
            if conversion is not None and (variable.unit or conversion == (1.0, 0.0)):
                return conversion
        if variable.unit:
            key = variable.name if variable.name.isidentifier() else f'"{variable.name}"'
            share, counted = ("%", "percent") if "%" in unit else ("pu", "multiples")
            raise InputError(
                f"{variable.name}: column unit {unit!r} does not convert to {variable.unit!r} of {self.model_name}. "
                f'Set units = {{ {key} = "{variable.unit}" }} for numbers in {variable.unit}, '
                f'or "{share} of 10 {variable.unit}" for {counted} of 10 {variable.unit}.'
            )
        if meant is not None and (meant.factor, meant.offset) == (1.0, 0.0):
            return 1.0, 0.0  # coherent SI, as Modelica computes in
        raise InputError(
            f"{variable.name}: column unit {unit!r}, but {self.model_name} declares none. "
            f'Convert the column or set units = {{ {variable.name} = "1" }}.'
        )
