"""Lays down, as arrays, what the core does for one system and one experiment."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.data import Experiment
from fmuid.errors import InputError
from fmuid.fmi import BOOLEAN, INT32, UINT8, WIRES, FeedThrough, Grid, Integration, Operation, Plan, Run, codes
from fmuid.models import DEFAULT_TOLERANCE, Connection, System, Value, check_roles, column_conversion

# Substeps of a sampling interval where an input is linear in between but the FMU can only hold it. Each substep
# holds the value at its middle, an error of second order in the substep: a hundredth of that of one whole step.
LINEAR_SUBSTEPS = 10
# Steps that differ by less, relatively, count as equal: sampling times are rounded, often to single precision. A second
# substep where the table says 1.00002 ms instead of 1 ms would double a sampled controller's rate.
STEP_TOLERANCE = 1e-3


class _Target(NamedTuple):
    """Which column feeds a variable: factor times it plus offset."""

    column: int
    factor: float
    offset: float


class PlannedRun(Run):
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
        Largest communication step, s, in place of the system's; default: from sample to sample (`LINEAR_SUBSTEPS` to a
        sampling interval where inputs are linear in between and their FMU cannot interpolate).

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
        self._operations: list[Operation] = []
        self._texts: list[bytes] = []
        self._conversions: list[tuple[float, float]] = []
        self._loops: list[FeedThrough] = []
        self._component_index = {name: i for i, name in enumerate(system.components)}
        check_roles(system, experiment, parameters, values)
        if step_size is not None and not step_size > 0:
            raise InputError(f"step_size must be a positive number of seconds, not {step_size:g}")
        self._step_size = step_size
        self._steps = self._component_steps(step_size)
        self._targets = self._input_targets()
        self._modes = {
            name: self._mode(name, bool(experiment.held[each.column])) for name, each in self._targets.items()
        }

        stages = [0]
        parameter_slots = self._start_operations(parameters, self._all_values(parameters, values))
        stages.append(len(self._operations))
        input_slots = self._transfer(list(self._targets), setting=True)
        stages.append(len(self._operations))
        groups = self._exchange_operations()
        stages.append(len(self._operations))
        output_slots, output_terms = self._output_operations()
        stages.append(len(self._operations))
        derivative_slots = self._derivative_operations()
        stages.append(len(self._operations))
        for component in system.components:
            if system.master == "gauss-seidel":
                self._pass_on_after(component)
            stages.append(len(self._operations))
        plan = Plan(
            operations=tuple(self._operations),
            stages=np.array(stages, np.intp),
            groups=np.array(groups, np.intp).reshape(-1, 2),
            loops=tuple(self._loops),
            references=np.array(self._references, np.uint32),
            signals=np.array(self._signals, np.float64),
            conversions=np.array(self._conversions, np.float64).reshape(-1, 2),
            texts=tuple(self._texts),
            parameter_signals=np.array(parameter_slots, np.intp),
            input_signals=np.array(input_slots, np.intp),
            input_modes=np.array(list(self._modes.values()), np.intp),
            input_curves=self._curves(),
            derivative_signals=np.array(derivative_slots, np.intp),
            output_signals=np.array(output_slots, np.intp),
            output_terms=np.array(output_terms, np.intp),
            integrations=self._integrations(),
            tolerances=np.array([model.numerics.tolerance or 0.0 for model in system.components.values()]),
            gauss_seidel=system.master == "gauss-seidel",
        )
        super().__init__(plan, self._build_grid(), self.output_names)

    def _input_targets(self) -> dict[str, _Target]:
        """Return the variables that the table feeds, with their columns; a connector of the system may feed several."""
        found: dict[str, _Target] = {}
        for column, given in enumerate(self._experiment.input_names):
            for name, factor, offset in self._system.targets(given):
                if name in found:
                    raise InputError(f"{self._experiment.source} feeds {name!r} twice, through {given!r} too; keep one")
                found[name] = _Target(column, factor, offset)
        return found

    # --- how each component runs

    def _component_steps(self, step_size: float | None) -> dict[str, float | None]:
        """Return the largest communication step of each component; None where the samples decide."""
        models = self._system.components
        alone = len(models) == 1  # its integrator may step as it likes between the samples
        return {
            name: None if alone and model.kind == "model-exchange" else step_size or model.numerics.step_size
            for name, model in models.items()
        }

    def _mode(self, name: str, held: bool) -> int:
        component, inner = self._system.split(name)
        model = self._system.components[component]
        description = model.fmu.description
        if held or not description.variables[inner].continuous:
            return codes.HELD
        if model.kind == "model-exchange":  # whose integrators set 64-bit numbers
            return codes.BY_STEPPER if description.variables[inner].wire == "Float64" else codes.BY_MIDPOINT
        return codes.BY_DERIVATIVE if description.interfaces[model.kind].interpolates_inputs else codes.BY_MIDPOINT

    def _when(self, name: str, connected: bool) -> int:
        """Return when a variable may be set once the simulation runs, as bits (`codes`)."""
        component, inner = self._system.split(name)
        model = self._system.components[component]
        description = model.fmu.description
        steps = [step for step in self._steps.values() if step is not None]
        latched = codes.LATCHED if steps and (self._steps[component] or 0.0) > min(steps) else codes.ALWAYS
        exchanging = model.kind == "model-exchange"
        if not exchanging and not description.interfaces[model.kind].event_mode:
            return latched
        if connected and description.variables[inner].continuous:
            return latched | (codes.WITH_RESTART if exchanging else codes.ALWAYS)
        if exchanging and not connected and self._modes[name] == codes.BY_MIDPOINT:
            return latched | codes.WITH_RESTART
        if not connected and self._modes[name] != codes.HELD:
            return latched | (codes.AT_STEPS if exchanging else codes.ALWAYS)
        return latched | codes.AS_EVENT

    def _integrations(self) -> tuple[Integration | None, ...]:
        return tuple(self._integration(name) for name in self._system.components)

    def _integration(self, component: str) -> Integration | None:
        model = self._system.components[component]
        if model.kind != "model-exchange":
            return None
        inputs = [name for name in self._modes if self._system.split(name)[0] == component]
        varying = self._polynomial_rows(component)
        connected = any(connection.target[0] == component for connection in self._system.connections)
        numerics = model.numerics
        return Integration(
            model.integrator,
            numerics.tolerance or DEFAULT_TOLERANCE,
            self._step_size or numerics.step_size,
            np.array(list(dict.fromkeys(self._system.variables[name].reference for name in varying)), np.uint32),
            np.array([self._start(name) for name in varying], np.float64),
            # with events, no step goes beyond a sample: a long one may step over what happens inside it
            autonomous=not inputs and not connected and model.fmu.description.indicators == 0,
        )

    def _curves(self) -> tuple[tuple[int, int], ...]:
        """Return for each input which row of which component's polynomials it is."""
        found = []
        for name, mode in self._modes.items():
            component = self._system.split(name)[0]
            if mode == codes.BY_STEPPER:
                found.append((self._component_index[component], self._polynomial_rows(component).index(name)))
            else:
                found.append((-1, -1))
        return tuple(found)

    def _polynomial_rows(self, component: str) -> list[str]:
        """Return the inputs of a component that vary continuously, with all elements of the arrays among them."""
        rows: dict[str, None] = {}
        for name, mode in self._modes.items():
            if mode != codes.BY_STEPPER or self._system.split(name)[0] != component or name in rows:
                continue
            array = self._system.variables[name].array
            elements = [self._system.full_name(component, element) for element in array] or [name]
            held = [element for element in elements if self._modes.get(element, mode) != mode]
            if held:
                raise InputError(
                    f"{held[0]!r} is held between the samples and {name!r} is not, and both are elements of one array "
                    f"of {self._system.label}; give them one interpolation"
                )
            rows |= dict.fromkeys(elements)
        return list(rows)

    def _start(self, name: str) -> float:
        start = self._system.variables[name].start
        return float(start) if isinstance(start, int | float) else 0.0

    # --- operations

    def _transfer(self, names: Sequence[str], *, setting: bool, when: Mapping[str, int] | None = None) -> list[int]:
        """Append one call for each component, type and time of setting; return the signal of each name, in order."""
        slots: dict[str, int] = {}
        for (component, wire, moment), group in self._grouped(names, setting, when).items():
            first, references = len(self._signals), []
            for name in group:
                if name not in slots:
                    references.append(self._system.variables[name].reference)
                    slots |= self._allot(component, name)
            self._call(component, wire, setting, references, first, moment)
        return [slots[name] for name in names]

    def _allot(self, component: str, name: str) -> dict[str, int]:
        """Return the signals of a variable, for one element of an array those of all, holding their start values."""
        variable = self._system.variables[name]
        elements = [self._system.full_name(component, element) for element in variable.array] or [name]
        first = len(self._signals)
        self._signals += [self._start(element) for element in elements]
        return {element: first + i for i, element in enumerate(elements)}

    def _call(self, component: str, wire: str, setting: bool, references: Sequence[int], first: int, when: int) -> None:
        place = WIRES.index(wire)
        version = self._system.components[component].fmu.description.major_version
        passed = place if place != BOOLEAN else INT32 if version == 2 else UINT8
        self._operations.append(
            Operation(
                place if setting else codes.N_WIRES + place,
                self._component_index[component],
                len(self._references),
                len(references),
                first,
                len(self._signals) - first if wire != "String" else len(references),
                passed,
                when,
            )
        )
        self._references.extend(references)

    def _grouped(
        self, names: Sequence[str], setting: bool, when: Mapping[str, int] | None
    ) -> dict[tuple[str, str, int], list[str]]:
        groups: dict[tuple[str, str, int], list[str]] = defaultdict(list)
        moments = when if when is not None else {name: self._when(name, connected=False) for name in names if setting}
        for name in names:
            wire = self._system.variables[name].wire
            groups[self._system.split(name)[0], wire, moments.get(name, codes.ALWAYS)].append(name)
        return groups

    def _all_values(self, parameters: Sequence[str], values: Mapping[str, Value]) -> dict[str, Value]:
        """Return all that is set before the initialisation but the parameters: values written into an FMU, too."""
        known: dict[str, Value] = {
            self._system.full_name(component, name): value
            for component, model in self._system.components.items()
            for name, value in model.fmu.description.applied.items()
        }
        fed = {*parameters, *self._targets, *self._system.connected_inputs}
        known = {name: value for name, value in (known | self._system.values).items() if name not in fed}
        return known | dict(values)

    def _start_operations(self, parameters: Sequence[str], values: Mapping[str, Value]) -> list[int]:
        variables = self._system.variables
        numbers = [name for name in values if variables[name].type != "String"]
        slots = self._transfer([*numbers, *parameters], setting=True, when={})
        for name, slot in zip(numbers, slots, strict=False):
            self._signals[slot] = float(values[name])
        for name in values:
            if variables[name].type == "String":
                self._texts.append(str(values[name]).encode())
                component, _ = self._system.split(name)
                self._call(component, "String", True, [variables[name].reference], len(self._texts) - 1, codes.ALWAYS)
        return slots[len(numbers) :]

    def _exchange_operations(self) -> list[tuple[int, int]]:
        """Append what passes outputs on; return the groups of `Plan`."""
        groups = []
        for group, is_loop in self._system.exchange_order:
            first = len(self._operations)
            setting, slots = self._pass_on(group)
            if is_loop:
                groups.append((-1, len(self._loops)))
                words = " -> ".join(self._system.full_name(*connection.target) for connection in group)
                self._loops.append(FeedThrough(first, setting, len(self._operations), tuple(slots), words))
            else:
                groups.append((first, len(self._operations)))
        return groups

    def _pass_on_after(self, component: str) -> None:
        """Append what passes the outputs of a component on to those that step after it."""
        later = [
            name for name in self._system.components if self._component_index[name] > self._component_index[component]
        ]
        self._pass_on([c for c in self._system.connections if c.source[0] == component and c.target[0] in later])

    def _pass_on(self, connections: Iterable[Connection]) -> tuple[int, list[int]]:
        """Append gets, copies and sets; return where the sets begin, and the signals of the inputs."""
        group = list(connections)
        pairs = [(self._system.full_name(*c.source), self._system.full_name(*c.target)) for c in group]
        sources = list(dict.fromkeys(source for source, _ in pairs))
        got = dict(zip(sources, self._transfer(sources, setting=False), strict=True))
        at = len(self._operations)
        targets = [target for _, target in pairs]
        slots = self._transfer(targets, setting=True, when={name: self._when(name, connected=True) for name in targets})
        copies = []
        for connection, (source, _), slot in zip(group, pairs, slots, strict=True):
            copies.append(Operation(codes.COPY, 0, got[source], len(self._conversions), slot, 1, 0))
            self._conversions.append((connection.factor, connection.offset))
        self._operations[at:at] = copies
        return at + len(copies), slots

    def _output_operations(self) -> tuple[list[int], list[int]]:
        """Append what gets the outputs; return the signals summed, and where those of each output begin."""
        terms = [self._system.terms(name) for name in self.output_names]
        found = list(dict.fromkeys(term for some in terms for term in some))
        slots = dict(zip(found, self._transfer(found, setting=False), strict=True))
        return [slots[term] for some in terms for term in some], np.cumsum([0, *map(len, terms)]).tolist()

    def _derivative_operations(self) -> list[int]:
        unused = len(self._signals)  # where the slopes of the inputs go that are given none
        self._signals.append(0.0)
        slots = dict.fromkeys(self._targets, unused)
        linear = [name for name, mode in self._modes.items() if mode == codes.BY_DERIVATIVE]
        first = len(self._operations)
        found = self._transfer(linear, setting=True, when={})
        for i in range(first, len(self._operations)):
            self._operations[i] = self._operations[i]._replace(function=codes.SET_DERIVATIVES)
        slots.update(zip(linear, found, strict=True))
        for slot in found:
            self._signals[slot] = 0.0
        return list(slots.values())

    # --- the grid

    def _build_grid(self) -> Grid:
        intervals = np.diff(self._experiment.times)
        steps = [step for step in self._steps.values() if step is not None]
        strides = np.ones(len(self._steps), np.intp)
        curved = {name for name, each in self._targets.items() if self._experiment.curved[each.column]}
        if steps:
            smallest = min(steps)
            substeps = np.ceil(intervals / smallest * (1 - STEP_TOLERANCE))
            strides[:] = [max(1, round((step or smallest) / smallest)) for step in self._steps.values()]
        else:
            coarse = any(
                mode == codes.BY_MIDPOINT or (mode == codes.BY_DERIVATIVE and name in curved)
                for name, mode in self._modes.items()
            )
            substeps = np.full(intervals.shape, LINEAR_SUBSTEPS if coarse else 1)
        substeps = np.maximum(substeps, 1).astype(np.intp)
        self._check_steps(intervals / substeps)
        inputs, slopes = self._converted_inputs()
        return Grid(np.array(self._experiment.times), substeps, strides, inputs, slopes if curved else None)

    def _check_steps(self, steps: NDArray[np.float64]) -> None:
        """Refuse unequal steps where an FMU declares that it cannot take them."""
        taken = steps[steps > 0]
        if taken.size == 0 or np.ptp(taken) <= STEP_TOLERANCE * taken.max():
            return
        for model in self._system.components.values():
            interface = model.fmu.description.interfaces[model.kind]
            if model.kind == "co-simulation" and not interface.variable_step:
                raise InputError(
                    f"{model.fmu.path.name} needs communication steps of one length, and {self._experiment.source} "
                    f"is sampled irregularly ({taken.min():g} s to {taken.max():g} s); resample the table"
                )

    def _converted_inputs(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the inputs, and their slopes at the samples, in the units of the FMU."""
        columns = [each.column for each in self._targets.values()]
        inputs = np.array(self._experiment.input_values[:, columns], np.float64, order="C")
        slopes = np.array(self._experiment.input_slopes[:, columns], np.float64, order="C")
        for j, each in enumerate(self._targets.values()):
            name = self._experiment.input_names[each.column]
            factor, offset = 1.0, 0.0
            if name in self._experiment.units:
                factor, offset = column_conversion(self._system, name, self._experiment.units[name])
            inputs[:, j] = each.factor * (factor * inputs[:, j] + offset) + each.offset
            slopes[:, j] *= factor * each.factor
        return inputs, slopes
