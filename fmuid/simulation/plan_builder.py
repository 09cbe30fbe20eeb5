"""A system over an experiment as plan and grid of the core."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.models import DEFAULT_TOLERANCE, Connection, System
from fmuid.simulation import codes
from fmuid.simulation.codes import BOOLEAN, FLOAT64, INT32, UINT8, WIRES
from fmuid.simulation.simulation_plan import (
    MOST_STEPS,
    AlgebraicLoop,
    GridSimulation,
    Integration,
    Operation,
    PlanInputs,
    SimulationPlan,
    TimeGrid,
)
from fmuid.simulation.simulation_task import SimulationTask, column_conversion

Found = TypeVar("Found")
Outputs = tuple[list[int], list[int]]
"""The signals that are summed to outputs, and where among them those of each output begin, and the end."""


@dataclass
class PlanBuilder:
    """Parts of a `SimulationPlan`; methods append to them and return signals."""

    task: SimulationTask
    signals: list[float] = field(default_factory=list)
    references: list[int] = field(default_factory=list)
    calls: list[Operation] = field(default_factory=list)
    texts: list[bytes] = field(default_factory=list)
    conversions: list[tuple[float, float]] = field(default_factory=list)
    loops: list[AlgebraicLoop] = field(default_factory=list)

    def transfer(self, names: Sequence[str], *, setting: bool, when: Mapping[str, int] | None = None) -> list[int]:
        """Append a call per component, type and time; return the names' signals."""
        slots: dict[str, int] = {}
        for (component, wire, moment), group in self._grouped(names, setting, when).items():
            first, references = len(self.signals), []
            for name in group:
                if name not in slots:
                    references.append(self.task.system.variables[name].reference)
                    slots |= self._allot(name)
            self.call(component, wire, setting, references, first, moment)
        return [slots[name] for name in names]

    def _allot(self, name: str) -> dict[str, int]:
        """Return new signals of a variable or all its elements."""
        elements, first = self.task.elements(name), len(self.signals)
        self.signals += [self.task.start(element) for element in elements]
        return {element: first + i for i, element in enumerate(elements)}

    def call(self, component: str, wire: str, setting: bool, references: Sequence[int], first: int, when: int) -> None:
        """Append a call that sets or gets the signals from `first` on."""
        place = WIRES.index(wire)
        version = self.task.system.components[component].fmu.description.major_version
        passed = place if place != BOOLEAN else INT32 if version == 2 else UINT8
        function, count = place if setting else codes.N_WIRES + place, len(references)
        values = len(self.signals) - first if wire != "String" else count
        given = self.task.numbers[component], len(self.references), count, first, values, passed, when
        self.calls.append(Operation(function, *given))
        self.references.extend(references)

    def _grouped(
        self, names: Sequence[str], setting: bool, when: Mapping[str, int] | None
    ) -> dict[tuple[str, str, int], list[str]]:
        groups: dict[tuple[str, str, int], list[str]] = defaultdict(list)
        if when is None:
            when = {name: self.task.when(name, connected=False) for name in names if setting}
        for name in names:
            wire = self.task.system.variables[name].wire
            groups[self.task.system.split(name)[0], wire, when.get(name, codes.ALWAYS)].append(name)
        return groups

    def pass_on(self, connections: Iterable[Connection]) -> tuple[int, list[int]]:
        """Append gets, copies, sets; return the sets' beginning and the input signals."""
        group, name = list(connections), self.task.system.full_name
        pairs = [(name(*c.source), name(*c.target)) for c in group]
        sources = list(dict.fromkeys(source for source, _ in pairs))
        got = dict(zip(sources, self.transfer(sources, setting=False), strict=True))
        at = len(self.calls)
        targets = [target for _, target in pairs]
        when = {each: self.task.when(each, connected=True) for each in targets}
        slots = self.transfer(targets, setting=True, when=when)
        first = len(self.conversions)
        self.conversions += [(connection.factor, connection.offset) for connection in group]
        self.calls[at:at] = [
            Operation(codes.COPY, 0, got[source], first + i, slot, 1, 0)
            for i, ((source, _), slot) in enumerate(zip(pairs, slots, strict=True))
        ]
        return at + len(group), slots


def start_values(to: PlanBuilder) -> list[int]:
    """Append sets before the initialization; return the parameters' signals."""
    task, variables = to.task, to.task.system.variables
    numbers = [name for name in task.values if variables[name].type != "String"]
    slots = to.transfer([*numbers, *task.parameters], setting=True, when={})
    for name, slot in zip(numbers, slots, strict=False):
        to.signals[slot] = float(task.values[name])
    for name, value in task.values.items():
        if variables[name].type == "String":
            to.texts.append(str(value).encode())
            component, _ = task.system.split(name)
            to.call(component, "String", True, [variables[name].reference], len(to.texts) - 1, codes.ALWAYS)
    return slots[len(numbers) :]


def exchange(to: PlanBuilder) -> list[tuple[int, int]]:
    """Append the exchange of outputs; return the groups of `SimulationPlan`."""
    groups = []
    for group, is_loop in to.task.system.exchange_order:
        first = len(to.calls)
        setting, slots = to.pass_on(group)
        if is_loop:
            groups.append((-1, len(to.loops)))
            words = " -> ".join(to.task.system.full_name(*connection.target) for connection in group)
            nominals = tuple(_nominal(to.task.system, connection) for connection in group)
            to.loops.append(AlgebraicLoop(first, setting, len(to.calls), tuple(slots), nominals, words))
        else:
            groups.append((first, len(to.calls)))
    return groups


def _nominal(system: System, connection: Connection) -> float:
    """Return an input's nominal value, own or of its source; else 0."""
    ends = (system.full_name(*end) for end in (connection.target, connection.source))
    of_input, of_output = (system.variables[end].nominal for end in ends)
    stated = abs(of_input or connection.factor * (of_output or 0.0))
    return stated if math.isfinite(stated) else 0.0


def outputs(to: PlanBuilder) -> Outputs:
    """Append gets of the experiment's outputs."""
    terms, found = _terms(to.task)
    slots = dict(zip(found, to.transfer(found, setting=False), strict=True))
    return [slots[term] for some in terms for term in some], [0, *itertools.accumulate(map(len, terms))]


def outputs_with_sensitivities(to: PlanBuilder, count: int) -> Outputs:
    """Append gets of outputs and their sensitivities, by parameters."""
    slots, bounds = outputs(to)
    terms, found = _terms(to.task)
    first, size = len(to.signals), count * len(found)
    to.signals += [0.0] * size
    to.calls.append(Operation(codes.SENSITIVITIES, 0, len(to.references), len(found), first, size, FLOAT64))
    to.references += [to.task.system.variables[term].reference for term in found]
    for j in range(count):
        for some in terms:
            slots += [first + j * len(found) + found.index(term) for term in some]
            bounds.append(len(slots))
    return slots, bounds


def _terms(task: SimulationTask) -> tuple[list[list[str]], list[str]]:
    terms = [task.system.terms(name) for name in task.experiment.output_names]
    return terms, list(dict.fromkeys(term for some in terms for term in some))


def input_slopes(to: PlanBuilder) -> list[int]:
    """Append sets of input derivatives; return the slope signals of all inputs."""
    unused = len(to.signals)  # where the slopes of the inputs go that are given none
    to.signals.append(0.0)
    slots = dict.fromkeys(to.task.targets, unused)
    linear = [name for name, mode in to.task.modes.items() if mode == codes.BY_DERIVATIVE]
    first = len(to.calls)
    found = to.transfer(linear, setting=True, when={})
    for i in range(first, len(to.calls)):
        to.calls[i] = to.calls[i]._replace(function=codes.SET_DERIVATIVES)
    slots.update(zip(linear, found, strict=True))
    for slot in found:
        to.signals[slot] = 0.0
    return list(slots.values())


# Substeps of a sampling interval where an input is linear in between but the FMU can only hold it. Each substep
# holds the value at its middle, an error of second order in the substep: a hundredth of that of one whole step.
LINEAR_SUBSTEPS = 10
# Steps that differ by less, relatively, count as equal: sampling times are rounded, often to single precision. A second
# substep where the table says 1.00002 ms instead of 1 ms would double a sampled controller's rate.
STEP_TOLERANCE = 1e-3


def grid_of(task: SimulationTask) -> TimeGrid:
    """Return the grid of a task; an `InputError` if steps must be equal.

    Inputs that are linear between samples get `LINEAR_SUBSTEPS` if their FMU cannot interpolate.
    """
    intervals = np.diff(task.experiment.times)
    steps = [step for step in task.steps.values() if step is not None]
    strides = np.ones(len(task.steps), np.intp)
    curved = {name for name, each in task.targets.items() if task.experiment.curved[each.column]}
    if steps:
        smallest = min(steps)
        substeps = np.ceil(intervals / smallest * (1 - STEP_TOLERANCE))
        strides[:] = [max(1, round((step or smallest) / smallest)) for step in task.steps.values()]
    else:
        coarse = codes.BY_MIDPOINT in task.modes.values()
        coarse |= any(task.modes[name] == codes.BY_DERIVATIVE for name in curved)
        substeps = np.full(intervals.shape, LINEAR_SUBSTEPS if coarse else 1)
    substeps = np.maximum(substeps, 1).astype(np.intp) * task.divisor
    strides *= [1 if task.system.integrates(component) else task.divisor for component in task.steps]
    _check_steps(task, intervals / substeps)
    inputs, slopes = converted_inputs(task)
    return TimeGrid(np.array(task.experiment.times), substeps, strides, inputs, slopes if curved else None)


def _check_steps(task: SimulationTask, steps: Floats) -> None:
    taken = steps[steps > 0]
    if taken.size == 0 or np.ptp(taken) <= STEP_TOLERANCE * taken.max():
        return
    for model in task.system.components.values():
        interface = model.fmu.description.interfaces[model.kind]
        if model.kind == "co-simulation" and not interface.variable_step:
            raise InputError(
                f"{task.experiment.source}: {model.fmu.path.name} needs equal communication steps, but sampling "
                f"intervals are {taken.min():g} s to {taken.max():g} s. Resample the data."
            )


def converted_inputs(task: SimulationTask) -> tuple[Floats, Floats]:
    """Return inputs and their slopes in units of the FMU."""
    experiment = task.experiment
    columns = [each.column for each in task.targets.values()]
    inputs = np.array(experiment.input_values[:, columns], np.float64, order="C")
    slopes = np.array(experiment.input_slopes[:, columns], np.float64, order="C")
    for j, each in enumerate(task.targets.values()):
        name = experiment.input_names[each.column]
        factor, offset = 1.0, 0.0
        if name in experiment.units:
            factor, offset = column_conversion(task.system, name, experiment.units[name])
        inputs[:, j] = each.factor * (factor * inputs[:, j] + offset) + each.offset
        slopes[:, j] *= factor * each.factor
    return inputs, slopes


def simulation_of(task: SimulationTask) -> GridSimulation:
    """Return the simulation of a task; an `InputError` if impossible."""
    return GridSimulation(plan_of(task), grid_of(task), task.experiment.output_names)


def plan_of(task: SimulationTask, add_outputs: Callable[[PlanBuilder], Outputs] = outputs) -> SimulationPlan:
    """Return the plan of a task; `add_outputs` appends gets of the outputs."""
    system, to = task.system, PlanBuilder(task)
    stages = [0]

    def stage(found: Found) -> Found:
        stages.append(len(to.calls))
        return found

    parameter_slots = stage(start_values(to))
    input_slots = stage(to.transfer(list(task.targets), setting=True))
    groups = stage(exchange(to))
    output_slots, output_terms = stage(add_outputs(to))
    slope_slots = stage(input_slopes(to))
    for component, number in task.numbers.items():
        if system.master == "gauss-seidel":  # from a component to later ones
            to.pass_on(c for c in system.connections if c.source[0] == component and task.numbers[c.target[0]] > number)
        stage(None)
    return SimulationPlan(
        operations=tuple(to.calls),
        stages=np.array(stages, np.intp),
        groups=np.array(groups, np.intp).reshape(-1, 2),
        loops=tuple(to.loops),
        references=np.array(to.references, np.uint32),
        signals=np.array(to.signals, np.float64),
        conversions=np.array(to.conversions, np.float64).reshape(-1, 2),
        texts=tuple(to.texts),
        parameter_signals=np.array(parameter_slots, np.intp),
        inputs=PlanInputs(
            np.array(input_slots, np.intp),
            np.array(slope_slots, np.intp),
            np.array(list(task.modes.values()), np.intp),
            tuple(_curve(task, name) for name in task.modes),
        ),
        output_signals=np.array(output_slots, np.intp),
        output_terms=np.array(output_terms, np.intp),
        integrations=tuple(_integration(task, name) for name in system.components),
        tolerances=np.array([model.numerics.tolerance or 0.0 for model in system.components.values()]),
        gauss_seidel=system.master == "gauss-seidel",
    )


def _integration(task: SimulationTask, component: str) -> Integration | None:
    model, system = task.system.components[component], task.system
    if model.kind != "model-exchange":
        return None
    inputs = [name for name in task.modes if system.split(name)[0] == component]
    varying = task.polynomial_rows(component)
    connected = any(connection.target[0] == component for connection in system.connections)
    return Integration(
        model.integrator,
        model.numerics.tolerance or DEFAULT_TOLERANCE,
        task.step_size or model.numerics.step_size,
        np.array(list(dict.fromkeys(system.variables[name].reference for name in varying)), np.uint32),
        np.array([task.start(name) for name in varying], np.float64),
        # with events, no step goes beyond a sample: a long one may step over what happens inside it
        autonomous=not inputs and not connected and model.fmu.description.indicators == 0,
        most_steps=model.numerics.most_steps or MOST_STEPS,
    )


def _curve(task: SimulationTask, name: str) -> tuple[int, int]:
    if task.modes[name] != codes.BY_STEPPER:
        return -1, -1
    component = task.system.split(name)[0]
    return task.numbers[component], task.polynomial_rows(component).index(name)
