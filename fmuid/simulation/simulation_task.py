"""A system over an experiment: variables checked for their roles, inputs and components."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fmuid.data import Experiment
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import System, Variable
from fmuid.models import Value as Value
from fmuid.simulation import codes


class InputTarget(NamedTuple):
    """Column of a variable, with factor and offset."""

    column: int
    factor: float
    offset: float


@dataclass(frozen=True)
class SimulationTask:
    """One system over one experiment.

    `values` are set before the initialization, beside `parameters`; `targets` are fed by columns, with `modes` between
    samples (`codes.HELD` ...). `steps` are largest communication steps by component, s; None: from sample to sample.
    `divisor` divides steps of components that integrate; `step_size`, s, replaces the system's.
    """

    system: System
    experiment: Experiment
    parameters: tuple[str, ...]
    values: Mapping[str, Value]
    step_size: float | None
    targets: dict[str, InputTarget]
    modes: dict[str, int]
    steps: dict[str, float | None]
    divisor: int = 1

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Number of each component."""
        return {name: i for i, name in enumerate(self.system.components)}

    def start(self, name: str) -> float:
        """Return the start value of a variable, 0 without a number."""
        start = self.system.variables[name].start
        return float(start) if isinstance(start, int | float) else 0.0

    def elements(self, name: str) -> list[str]:
        """Return all elements of a variable's array, or the variable."""
        component, _ = self.system.split(name)
        return [self.system.full_name(component, each) for each in self.system.variables[name].array] or [name]

    def polynomial_rows(self, component: str) -> list[str]:
        """Return the continuous inputs of a component, with all array elements."""
        rows: dict[str, None] = {}
        for name, mode in self.modes.items():
            if mode != codes.BY_STEPPER or self.system.split(name)[0] != component or name in rows:
                continue
            elements = self.elements(name)
            held = [element for element in elements if self.modes.get(element, mode) != mode]
            if held:
                raise InputError(
                    f"{self.system.label}: {held[0]!r} and {name!r} are elements of one array with different "
                    f"interpolation. Give them the same."
                )
            rows |= dict.fromkeys(elements)
        return list(rows)

    def when(self, name: str, connected: bool) -> int:
        """Return the setting times of a variable, as bits (`codes`)."""
        component, inner = self.system.split(name)
        model = self.system.components[component]
        description = model.fmu.description
        steps = [step for step in self.steps.values() if step is not None]
        slower = bool(steps) and (self.steps[component] or 0.0) > min(steps)
        slower |= self.divisor > 1 and not self.system.integrates(component)
        latched = codes.LATCHED if slower else codes.ALWAYS
        exchanging = model.kind == "model-exchange"
        if not exchanging and not description.interfaces[model.kind].event_mode:
            return latched
        if connected and description.variables[inner].continuous:
            return latched | (codes.WITH_RESTART if exchanging else codes.ALWAYS)
        if exchanging and not connected and self.modes[name] == codes.BY_MIDPOINT:
            return latched | codes.WITH_RESTART
        if not connected and self.modes[name] != codes.HELD:
            return latched | (codes.AT_STEPS if exchanging else codes.ALWAYS)
        return latched | codes.AS_EVENT


def task_of(
    system: System,
    experiment: Experiment,
    parameters: Sequence[str],
    values: Mapping[str, Value],
    step_size: float | None,
    divisor: int = 1,
) -> SimulationTask:
    """Return the task of a system and an experiment, its variables checked."""
    check_roles(system, experiment, parameters, values)
    if step_size is not None and not (isinstance(step_size, int | float) and step_size > 0):
        raise InputError(f"step_size: {step_size!r} is not a positive number of seconds")
    targets = _targets(system, experiment)
    modes = {name: _mode(system, name, bool(experiment.held[each.column])) for name, each in targets.items()}
    applied: dict[str, Value] = {
        system.full_name(component, name): value
        for component, model in system.components.items()
        for name, value in model.fmu.description.applied.items()
    }
    fed = {*parameters, *targets, *system.connected_inputs}
    known = {name: value for name, value in {**applied, **system.values}.items() if name not in fed} | dict(values)
    alone = len(system.components) == 1  # its integrator may step as it likes between the samples
    steps = {
        name: None if alone and model.kind == "model-exchange" else step_size or model.numerics.step_size
        for name, model in system.components.items()
    }
    return SimulationTask(system, experiment, tuple(parameters), known, step_size, targets, modes, steps, divisor)


def _targets(system: System, experiment: Experiment) -> dict[str, InputTarget]:
    found: dict[str, InputTarget] = {}
    for column, given in enumerate(experiment.input_names):
        for name, factor, offset in system.targets(given):
            if name in found:
                raise InputError(f"{experiment.source}: {name!r} has two inputs, {given!r} is one. Remove one.")
            found[name] = InputTarget(column, factor, offset)
    return found


def _mode(system: System, name: str, held: bool) -> int:
    component, inner = system.split(name)
    model = system.components[component]
    description = model.fmu.description
    if held or not description.variables[inner].continuous:
        return codes.HELD
    if model.kind == "model-exchange":  # whose integrators set 64-bit numbers
        return codes.BY_STEPPER if description.variables[inner].wire == "Float64" else codes.BY_MIDPOINT
    return codes.BY_DERIVATIVE if description.interfaces[model.kind].interpolates_inputs else codes.BY_MIDPOINT


def column_conversion(system: System, name: str, unit: str) -> tuple[float, float]:
    """Return (factor, offset) from a unit to the variable's unit."""
    component, inner = system.split(system.terms(name)[0])
    description = system.components[component].fmu.description
    return description.conversion(description.variables[inner], unit)


def check_roles(system: System, experiment: Experiment, parameters: Sequence[str], values: Mapping[str, Value]) -> None:
    """Check names against their roles; an `InputError` gives near names or a remedy."""
    for name in experiment.input_names:
        variable = _with_causality(system, name, "input", ("input",), experiment.source)
        if name in system.connected_inputs:
            raise InputError(f"{experiment.source}: input {name!r} has a connection, too. Remove one.")
        if name in parameters or name in values:
            raise InputError(f"{name!r} is an input of {experiment.source} and has a value, too. Remove one.")
        if variable.type not in _NUMBERS:
            raise InputError(f"input {name!r} is a {variable.type}. Only numbers can come from a data file.")
    for name in experiment.output_names:
        _check_output(system, name, experiment.source)
    for name in parameters:
        variable = system.variable(name, "parameter")
        if variable.type != "Real":
            raise InputError(f"{name!r} is of type {variable.type}. Only Real parameters can be estimated.")
        _check_settable(system, variable)
        if name in values:
            raise InputError(f"{name!r} is both a parameter and fixed at a value. Remove one.")
    for name, value in values.items():
        _check_value(system, system.variable(name, "variable"), value)


_NUMBERS = ("Real", "Integer", "Boolean")


def _check_output(system: System, name: str, source: str) -> None:
    terms = [_with_causality(system, term, "output", ("output", "local"), source) for term in system.terms(name)]
    for variable in terms:
        if variable.type not in _NUMBERS:
            raise InputError(f"output {variable.name!r} is a {variable.type}. Only numbers can be outputs.")
        if variable.unit != terms[0].unit:
            raise InputError(
                f"output {name!r} sums different units: {terms[0].name!r} in {terms[0].unit or 'no unit'}, "
                f"{variable.name!r} in {variable.unit or 'no unit'}. Sum variables of one unit."
            )


def _with_causality(system: System, name: str, role: str, wanted: tuple[str, ...], source: str) -> Variable:
    variable = system.variable(name, role)
    if variable.causality not in wanted:
        same = [v.name for v in system.variables.values() if v.causality == role]
        raise InputError(
            f"{source}: {system.label} declares {name!r} as {variable.causality!r}, not as {role}. "
            f"Its {role}s are {', '.join(same[:12]) or 'none'}{', ...' if len(same) > 12 else ''}."
        )
    return variable


def _check_settable(system: System, variable: Variable) -> None:
    if variable.name in system.connected_inputs:
        raise InputError(f"{variable.name!r} has a connection. It cannot be set, too.")
    if not variable.settable:
        parameters = [v.name for v in system.variables.values() if v.causality == "parameter" and v.settable]
        raise InputError(
            f"{system.label}: {variable.name!r} cannot be set (causality {variable.causality!r}, variability "
            f"{variable.variability!r}). Set one of its parameters{nearest(variable.name, parameters)}."
        )


def _check_value(system: System, variable: Variable, value: Value) -> None:
    _check_settable(system, variable)
    kinds: dict[str, tuple[type, ...]] = {"Real": (int, float), "Integer": (int,), "Boolean": (bool,), "String": (str,)}
    if not isinstance(value, kinds.get(variable.type, ())) or (isinstance(value, bool) and variable.type != "Boolean"):
        raise InputError(f"{variable.name!r} is of type {variable.type} and cannot have the value {value!r}")
    if isinstance(value, bool | str):
        return
    whole = np.iinfo(variable.wire.lower()) if variable.type == "Integer" else None
    low, high = (whole.min, whole.max) if whole else (-sys.float_info.max, sys.float_info.max)
    if not low <= value <= high:
        raise InputError(
            f"{variable.name!r} cannot have the value {value!r}. Give a finite number within {variable.wire}."
        )
