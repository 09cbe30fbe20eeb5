"""Checks of variables against their roles: inputs, outputs, parameters, values."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np

from fmuid.data import Experiment
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import System, Variable
from fmuid.models import Value as Value


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
