"""Lays down, as arrays, what the compiled loop does for one system and one experiment."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from ctypes import c_char_p, c_void_p, cast

import numpy as np

from fmuid.errors import InputError, nearest
from fmuid.experiment import Experiment
from fmuid.fmi import kernels
from fmuid.fmi.description import Variable
from fmuid.fmi.loop import Grid, Plan
from fmuid.system import System

Value = float | int | bool | str

# Substeps of a sampling interval where an input is linear in between but the FMU can only hold it. Each substep
# holds the value at its middle, an error of second order in the substep: a hundredth of that of one whole step.
LINEAR_SUBSTEPS = 10
# Steps that differ by less, relatively, count as equal: sampling times are rounded, often to single precision. A second
# substep where the table says 1.00002 ms instead of 1 ms would double a sampled controller's rate.
STEP_TOLERANCE = 1e-3

_SET = {"Real": kernels.SET_REAL, "Integer": kernels.SET_INTEGER, "Boolean": kernels.SET_BOOLEAN}
_GET = {"Real": kernels.GET_REAL, "Integer": kernels.GET_INTEGER, "Boolean": kernels.GET_BOOLEAN}


class PlannedRun:
    """The arrays of one system and one experiment, ready for a `Loop`.

    Parameters
    ----------
    system : System
    experiment : Experiment
    parameters : sequence of str
        The variables that theta sets, in its order.
    values : mapping of str to number, bool or str
        Variables held at a value.
    step_size : float, optional
        Largest communication step, s; default: from sample to sample (`LINEAR_SUBSTEPS` to a sampling interval
        where inputs are linear in between and their FMU cannot interpolate).

    Attributes
    ----------
    plan : Plan
    grid : Grid
    output_names : tuple of str

    Raises
    ------
    InputError
        If a name is unknown or of the wrong causality or type, is given twice, or the FMU cannot step that way.
    """

    def __init__(
        self,
        system: System,
        experiment: Experiment,
        parameters: Sequence[str],
        values: Mapping[str, Value],
        step_size: float | None,
    ) -> None:
        self._system, self._experiment = system, experiment
        self.output_names = experiment.output_names
        self._signals: list[float] = []
        self._references: list[int] = []
        self._operations: list[tuple[int, int, int, int, int]] = []
        self._strings: list[c_char_p] = []
        self._component_index = {name: i for i, name in enumerate(system.components)}
        check_roles(system, experiment, parameters, values)
        if step_size is not None and not step_size > 0:
            raise InputError(f"step_size must be a positive number of seconds, not {step_size:g}")

        stages = [0]
        parameter_slots = self._start_operations(parameters, values)
        stages.append(len(self._operations))
        input_slots = self._transfer(_SET, experiment.input_names)
        stages.append(len(self._operations))
        self._exchange_operations()
        stages.append(len(self._operations))
        output_slots = self._transfer(_GET, experiment.output_names)
        stages.append(len(self._operations))
        modes = [self._mode(name, bool(held)) for name, held in self._inputs()]
        derivative_slots = self._derivative_operations(modes)
        stages.append(len(self._operations))
        self.plan = Plan(
            operations=np.array(self._operations, np.intp).reshape(-1, 5),
            stages=np.array(stages, np.intp),
            references=np.array(self._references, np.uint32),
            signals=np.array(self._signals, np.float64),
            strings=np.array([cast(s, c_void_p).value for s in self._strings], np.intp),
            parameter_signals=np.array(parameter_slots, np.intp),
            input_signals=np.array(input_slots, np.intp),
            input_modes=np.array(modes, np.intp),
            derivative_signals=np.array(derivative_slots, np.intp),
            output_signals=np.array(output_slots, np.intp),
        )
        self.grid = self._build_grid(modes, step_size)

    def _inputs(self) -> list[tuple[str, bool]]:
        return list(zip(self._experiment.input_names, self._experiment.held.tolist(), strict=True))

    def _mode(self, name: str, held: bool) -> int:
        component, inner = self._system.split(name)
        description = self._system.components[component].description
        if held or not description.variables[inner].continuous:
            return kernels.HELD
        interface = description.interfaces.get("co-simulation")
        return kernels.BY_DERIVATIVE if interface and interface.interpolates_inputs else kernels.BY_MIDPOINT

    def _allot(self, count: int) -> int:
        self._signals.extend([0.0] * count)
        return len(self._signals) - count

    def _call(self, function: int, component: str, names: Sequence[str], first: int) -> None:
        variables = self._system.components[component].description.variables
        row = (function, self._component_index[component], len(self._references), len(names), first)
        self._operations.append(row)
        self._references.extend(variables[name].reference for name in names)

    def _transfer(self, calls: Mapping[str, int], names: Sequence[str]) -> list[int]:
        """Append one call for each component and type; return the signal of each name, in their order."""
        slots = {}
        for (component, kind), group in self._grouped(names).items():
            first = self._allot(len(group))
            self._call(calls[kind], component, [self._system.split(name)[1] for name in group], first)
            slots.update({name: first + i for i, name in enumerate(group)})
        return [slots[name] for name in names]

    def _grouped(self, names: Sequence[str]) -> dict[tuple[str, str], list[str]]:
        groups: dict[tuple[str, str], list[str]] = defaultdict(list)
        for name in names:
            groups[self._system.split(name)[0], self._system.variables[name].type].append(name)
        return groups

    def _start_operations(self, parameters: Sequence[str], values: Mapping[str, Value]) -> list[int]:
        numbers = [name for name in values if self._system.variables[name].type != "String"]
        slots = self._transfer(_SET, [*numbers, *parameters])
        for name, slot in zip(numbers, slots, strict=False):
            self._signals[slot] = float(values[name])
        for name in values:
            if self._system.variables[name].type == "String":
                component, inner = self._system.split(name)
                self._strings.append(c_char_p(str(values[name]).encode()))
                self._call(kernels.SET_STRING, component, [inner], len(self._strings) - 1)
        return slots[len(numbers) :]

    def _exchange_operations(self) -> None:
        for group in self._system.exchange_order:
            pairs = [
                (self._system.full_name(*connection.source), self._system.full_name(*connection.target))
                for connection in group
            ]
            sources = list(dict.fromkeys(source for source, _ in pairs))
            got = dict(zip(sources, self._transfer(_GET, sources), strict=True))
            at = len(self._operations)
            targets = [target for _, target in pairs]
            to = self._transfer(_SET, targets)
            self._operations[at:at] = [
                (kernels.COPY, 0, got[source], 1, slot) for (source, _), slot in zip(pairs, to, strict=True)
            ]

    def _derivative_operations(self, modes: Sequence[int]) -> list[int]:
        unused = self._allot(1)  # where the slopes of the inputs go that are given none
        slots = dict.fromkeys(self._experiment.input_names, unused)
        linear = [n for n, mode in zip(slots, modes, strict=True) if mode == kernels.BY_DERIVATIVE]
        calls = dict.fromkeys(_SET, kernels.SET_DERIVATIVES)
        slots.update(zip(linear, self._transfer(calls, linear), strict=True))
        return list(slots.values())

    def _build_grid(self, modes: Sequence[int], step_size: float | None) -> Grid:
        intervals = np.diff(self._experiment.times)
        if step_size is not None:
            substeps = np.ceil(intervals / step_size * (1 - STEP_TOLERANCE))
        else:
            substeps = np.full(intervals.shape, LINEAR_SUBSTEPS if kernels.BY_MIDPOINT in modes else 1)
        substeps = np.maximum(substeps, 1).astype(np.intp)
        self._check_steps(intervals / substeps)
        return Grid(np.array(self._experiment.times), substeps, self._converted_inputs())

    def _check_steps(self, steps: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
        """Refuse unequal steps where an FMU declares that it cannot take them."""
        taken = steps[steps > 0]
        if taken.size == 0 or np.ptp(taken) <= STEP_TOLERANCE * taken.max():
            return
        for fmu in self._system.components.values():
            interface = fmu.description.interfaces.get("co-simulation")
            if interface is not None and not interface.variable_step:
                raise InputError(
                    f"{fmu.path.name} needs communication steps of one length, and {self._experiment.source} "
                    f"is sampled irregularly ({taken.min():g} s to {taken.max():g} s); resample the table"
                )

    def _converted_inputs(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        inputs = np.array(self._experiment.input_values, np.float64, order="C")
        for j, name in enumerate(self._experiment.input_names):
            if name in self._experiment.units:
                factor, offset = unit_conversion(self._system, name, self._experiment.units[name])
                inputs[:, j] = factor * inputs[:, j] + offset
        return inputs


def unit_conversion(system: System, name: str, unit: str) -> tuple[float, float]:
    """Return (factor, offset): the value in the variable's unit is factor times that in `unit`, plus offset."""
    component, inner = system.split(name)
    description = system.components[component].description
    return description.conversion(description.variables[inner], unit)


def check_roles(system: System, experiment: Experiment, parameters: Sequence[str], values: Mapping[str, Value]) -> None:
    """Check that every name exists and can play its role.

    Raises
    ------
    InputError
        One sentence that names the variable, what is wrong with it, and the nearest names or the remedy.
    """
    for name in experiment.input_names:
        variable = _with_causality(system, name, "input", ("input",), experiment.source)
        if name in system.connected_inputs:
            raise InputError(f"input {name!r} is fed by a connection; take it out of the inputs of {experiment.source}")
        if name in parameters or name in values:
            raise InputError(f"{name!r} is an input from {experiment.source}; it cannot also be given a value")
        if variable.type == "String":
            raise InputError(f"input {name!r} is a String; only numbers can come from a table")
    for name in experiment.output_names:
        variable = _with_causality(system, name, "output", ("output", "local"), experiment.source)
        if variable.type == "String":
            raise InputError(f"output {name!r} is a String and cannot be compared with measurements")
    for name in parameters:
        variable = system.variable(name, "parameter")
        if variable.type != "Real":
            raise InputError(f"{name!r} is of type {variable.type}; only Real parameters can be estimated")
        _check_settable(system, variable)
        if name in values:
            raise InputError(f"{name!r} is both a parameter and held at a value; keep one of the two")
    for name, value in values.items():
        _check_value(system, system.variable(name, "variable"), value)


def _with_causality(system: System, name: str, role: str, wanted: tuple[str, ...], source: str) -> Variable:
    variable = system.variable(name, role)
    if variable.causality not in wanted:
        same = [v.name for v in system.variables.values() if v.causality == role]
        raise InputError(
            f"{name!r} cannot be an {role} of {source}: {system.label} declares it as {variable.causality!r}; "
            f"its {role}s are {', '.join(same[:12]) or 'none'}{', ...' if len(same) > 12 else ''}"
        )
    return variable


def _check_settable(system: System, variable: Variable) -> None:
    if variable.name in system.connected_inputs:
        raise InputError(f"{variable.name!r} is fed by a connection and cannot be set")
    if not variable.settable:
        parameters = [v.name for v in system.variables.values() if v.causality == "parameter" and v.settable]
        raise InputError(
            f"{variable.name!r} cannot be set: {system.label} fixes it (causality {variable.causality!r}, variability "
            f"{variable.variability!r}); set one of its parameters{nearest(variable.name, parameters)}"
        )


def _check_value(system: System, variable: Variable, value: Value) -> None:
    _check_settable(system, variable)
    fits = {
        "Real": isinstance(value, int | float) and not isinstance(value, bool),
        "Integer": isinstance(value, int) and not isinstance(value, bool),
        "Boolean": isinstance(value, bool),
        "String": isinstance(value, str),
    }[variable.type]
    if not fits:
        raise InputError(f"{variable.name!r} is of type {variable.type} and cannot be held at {value!r}")
    if isinstance(value, float) and not np.isfinite(value):
        raise InputError(f"{variable.name!r} cannot be held at {value!r}; give a finite number")
