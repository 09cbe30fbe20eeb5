"""Binds plan and grid of a simulation to a set of instances: the memory that the compiled loop works on."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_char_p, c_void_p, cast
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fmuid.fmi import codes as k
from fmuid.fmi import float_environment
from fmuid.fmi.codes import FLOAT64, STRING
from fmuid.fmi.instance import Instance, function_names
from fmuid.fmi.kernels import simulate
from fmuid.fmi.layout import Grid, Operation, Plan


class Stepper(Protocol):
    """What takes an instance from one communication point to the next in compiled functions of its own."""

    block: int
    functions: tuple[int, ...]
    failure: int
    origin: int
    fresh: int
    coefficients: NDArray[np.float64]
    sensitivities: int

    def whereabouts(self) -> tuple[float, float]:
        """Return the time that was reached and the step that was tried last, s."""

    def bad_state(self) -> str:
        """Return the name of the state that ceased to be finite."""


class Loop:
    """A plan bound to one set of instances: it owns the memory whose addresses the compiled loop works with.

    Parameters
    ----------
    plan : Plan
    grid : Grid
    instances : sequence of Instance
        One for each component.
    used : (n_components,) array of intp
        Whether an instance must be reset before its next simulation; updated.

    Raises
    ------
    InputError
        If a binary lacks a function that is needed.
    """

    def __init__(self, plan: Plan, grid: Grid, instances: Sequence[Instance], used: NDArray[np.intp]) -> None:
        n = len(instances)
        self._instances = instances
        handles = np.array([instance.handle for instance in instances], np.intp)
        addresses = np.array([instance.addresses for instance in instances], np.intp)
        self._signals = plan.signals.copy()
        self._words = np.zeros(len(plan.signals) + 1, np.uint64)  # values of other types on their way
        self._last = np.zeros(len(plan.signals) + 1)
        self._texts = [c_char_p(text) for text in plan.texts]
        self._strings = np.array([cast(text, c_void_p).value for text in self._texts], np.intp)
        self._ones = np.ones(len(plan.references) + 1, np.int32)  # the order of every input derivative
        self._steppers: list[Stepper | None] = []
        for i in range(n):
            self._steppers.append(self._stepper(i, plan, grid))
        self._calls = self._resolve(plan, addresses, handles)
        self._loops, self._loop_memory = self._feed_through(plan)
        self._curves = np.zeros((len(plan.input_signals) + 1, 4))
        curves = self._curve_addresses(plan)
        table = self._stepper_table()
        in_event, own_times, scratch = np.zeros(n, np.intp), np.zeros(n), np.zeros(2, np.intp)
        self._owned = (plan, grid, handles, addresses, used, curves, table, in_event, own_times, scratch)
        self._floats = float_environment.FloatEnvironment()
        self._memory = np.zeros(k.FIELDS, np.intp)
        fields: dict[int, int | NDArray[Any] | None] = {
            k.N_COMPONENTS: n,
            k.N_INPUTS: len(plan.input_signals),
            k.N_OUTPUTS: len(plan.output_terms) - 1,
            k.N_TIMES: len(grid.times),
            k.N_SIGNALS: len(plan.signals),
            k.N_PARAMETERS: len(plan.parameter_signals),
            k.N_STEPPERS: sum(stepper is not None for stepper in self._steppers),
            k.STAGES: plan.stages,
            k.CALLS: self._calls,
            k.SIGNALS: self._signals,
            k.START_SIGNALS: plan.signals,
            k.CONVERSIONS: plan.conversions,
            k.HANDLES: handles,
            k.ADDRESSES: addresses,
            k.USED: used,
            k.TOLERANCES: plan.tolerances,
            k.TIMES: grid.times,
            k.SUBSTEPS: grid.substeps,
            k.STRIDES: grid.strides if (grid.strides > 1).any() else None,
            k.OWN_TIMES: own_times,
            k.INPUTS: grid.inputs,
            k.INPUT_SIGNALS: plan.input_signals,
            k.INPUT_MODES: plan.input_modes,
            k.INPUT_SLOPES: grid.slopes,
            k.CURVES: curves,
            k.DERIVATIVE_SIGNALS: plan.derivative_signals,
            k.OUTPUT_SIGNALS: plan.output_signals,
            k.OUTPUT_TERMS: plan.output_terms,
            k.PARAMETER_SIGNALS: plan.parameter_signals,
            k.DIRECT_INPUTS: self._direct(plan, 1, 0, plan.input_signals),
            k.DIRECT_OUTPUTS: self._direct(plan, 3, k.N_WIRES, plan.output_signals),
            k.STEPPERS: table,
            k.IN_EVENT: in_event,
            k.LOOPS: self._loops,
            k.GROUPS: plan.groups,
            k.N_GROUPS: len(plan.groups),
            k.GAUSS_SEIDEL: int(plan.gauss_seidel),
            k.SCRATCH: scratch,
            k.RESTORING: float_environment.RESTORING,
            k.FLOATS: self._floats.address,
        }
        for field, value in fields.items():
            self._memory[field] = 0 if value is None else value if isinstance(value, int) else value.ctypes.data
        for field, address in self._hooks(plan, grid).items():
            self._memory[field] = address

    def run(self, thetas: NDArray[np.float64], outputs: NDArray[np.float64], reports: NDArray[np.intp]) -> None:
        """Simulate thetas (m, N) into outputs (m, K, n_outputs) and reports (m, 4), see `kernels.simulate`."""
        self._simulate(thetas, outputs, reports)
        discarded = (reports[:, 0] == k.DO_STEP) & (reports[:, 2] == k.DISCARD)
        if discarded.any() and not self._memory[k.AFTER_DISCARD]:
            from fmuid.fmi.discards import HOOKS  # compiled only where an FMU does so

            self._memory[k.AFTER_DISCARD] = HOOKS[k.AFTER_DISCARD]
            before = reports.copy()
            self._simulate(thetas, outputs, reports)
            # what comes not even as far again is an FMU that its end has spoiled: the first end was the true one
            worse = (before[:, 0] >= 0) & (reports[:, 0] >= 0) & (reports[:, 3] < before[:, 3])
            reports[worse] = before[worse]

    def _simulate(self, *arrays: NDArray[Any]) -> None:
        for field, array in zip((k.THETAS, k.OUTPUTS, k.REPORT), arrays, strict=True):  # the loop moves on in them
            if not array.flags.c_contiguous:
                raise ValueError("the compiled loop needs contiguous arrays")
            self._memory[field] = array.ctypes.data
        self._floats.save()
        simulate(self._memory.ctypes.data, len(arrays[0]))

    def _hooks(self, plan: Plan, grid: Grid) -> dict[int, int]:
        """Return the addresses of the hooks that this run has a use for, compiled only now."""
        found: dict[int, int] = {}
        if any(operation.wire not in (FLOAT64, STRING) for operation in plan.operations):
            from fmuid.fmi.conversions import HOOKS

            found |= HOOKS
        steppers = any(stepper is not None for stepper in self._steppers)
        curved = grid.slopes is not None
        if steppers or curved or plan.loops or any(operation.when for operation in plan.operations):
            from fmuid.fmi import coupling

            found |= coupling.HOOKS
            if not steppers and not plan.loops:
                found[k.SETTLE] = found[k.EXCHANGE] = 0
            if not curved:
                found[k.BEND] = found[k.CHORDS] = 0
        return found

    def whereabouts(self, component: int) -> tuple[float, float]:
        """Return the time that a component reached in the last simulation and the step that it tried last, s."""
        stepper = self._steppers[component]
        return stepper.whereabouts() if stepper is not None else (np.nan, np.nan)

    def bad_state(self, component: int) -> str:
        """Return which state of a component ceased to be finite in the last simulation."""
        stepper = self._steppers[component]
        return stepper.bad_state() if stepper is not None else ""

    def _resolve(self, plan: Plan, addresses: NDArray[np.intp], handles: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the table of calls: the operations with all the addresses that they need."""
        calls = np.zeros((len(plan.operations), k.COLUMNS), np.intp)
        for row, operation in zip(calls, plan.operations, strict=True):
            row[[k.FUNCTION, k.COMPONENT, k.COUNT]] = operation.function, operation.component, operation.n_references
            row[[k.SIGNAL, k.N_VALUES]] = operation.signal, operation.n_values
            if operation.function == k.COPY:
                row[k.VALUES], row[k.KIND] = operation.reference, k.OTHER
                continue
            row[k.REFERENCES] = plan.references.ctypes.data + 4 * operation.reference
            stepper = self._steppers[operation.component]
            if operation.function == k.SENSITIVITIES and stepper is not None:
                row[[k.ADDRESS, k.HANDLE]] = stepper.sensitivities, stepper.block
                row[k.WIRE], row[k.VALUES] = FLOAT64, self._signals.ctypes.data + 8 * operation.signal
                continue
            instance = self._instances[operation.component]
            row[k.ADDRESS], row[k.HANDLE] = (
                addresses[operation.component, operation.function],
                handles[operation.component],
            )
            if not row[k.ADDRESS]:
                instance.required(function_names(instance.version).get(operation.function, "SetRealInputDerivatives"))
            row[[k.WIRE, k.WHEN, k.MORE]] = operation.wire, operation.when, int(instance.version == 3)
            row[k.ORDERS] = self._ones.ctypes.data
            row[k.KIND] = _kind(operation, instance.version)
            row[k.LAST] = self._last.ctypes.data + 8 * operation.signal
            if operation.wire == STRING:
                row[k.VALUES] = self._strings.ctypes.data + 8 * operation.signal
            else:
                memory = self._signals if operation.wire == FLOAT64 else self._words
                row[k.VALUES] = memory.ctypes.data + 8 * operation.signal
        return calls

    def _stepper(self, number: int, plan: Plan, grid: Grid) -> Stepper | None:
        instance = self._instances[number]
        if instance.kind == "model-exchange":
            from fmuid.fmi.model_exchange import ModelExchangeStepper  # compiled only where it is needed

            integration = plan.integrations[number]
            if integration is None:
                raise ValueError("a component for model exchange needs an integration")
            wanted = integration.sensitivities.twins if integration.sensitivities else ()
            twins = [twin.block for twin in (self._steppers[i] for i in wanted) if twin is not None]
            return ModelExchangeStepper(instance, integration, float(grid.times[-1]), twins)
        if instance.version == 3:
            from fmuid.fmi.co_simulation import CoSimulation3

            return CoSimulation3(instance.handle, instance.required, instance.event_mode)
        return None

    def _stepper_table(self) -> NDArray[np.intp]:
        table = np.zeros((len(self._instances), k.STEPPER_COLUMNS), np.intp)
        for row, instance, stepper in zip(table, self._instances, self._steppers, strict=True):
            row[k.VERSION] = instance.version
            if stepper is not None:
                row[k.BLOCK], row[k.FAILURE] = stepper.block, stepper.failure
                row[k.BEGIN : k.ADVANCE + 1] = stepper.functions
                row[k.ORIGIN], row[k.FRESH] = stepper.origin, stepper.fresh
        return table

    def _curve_addresses(self, plan: Plan) -> NDArray[np.intp]:
        """Return where the polynomial of each input is: in the memory of a stepper, or here."""
        found = []
        for own, (component, row) in zip(self._curves, plan.input_curves, strict=False):
            stepper = self._steppers[component] if component >= 0 else None
            found.append((own if stepper is None else stepper.coefficients[row]).ctypes.data)
        return np.array(found, np.intp)

    @staticmethod
    def _feed_through(plan: Plan) -> tuple[NDArray[np.intp], list[NDArray[Any]]]:
        table, owned = np.zeros((len(plan.loops), k.LOOP_COLUMNS), np.intp), []
        for row, loop in zip(table, plan.loops, strict=True):
            n = len(loop.signals)
            signals, work = np.array(loop.signals, np.intp), np.zeros(2 * n + n * n)
            owned += [signals, work]
            row[:] = loop.first, loop.setting, loop.last, n, signals.ctypes.data, work.ctypes.data
        return table, owned

    def _direct(self, plan: Plan, stage: int, function: int, signals: NDArray[np.intp]) -> int:
        """Return where to write the address of a whole row of the table, if one call takes it as it is; else 0."""
        first, last = map(int, plan.stages[stage : stage + 2])
        if last != first + 1:
            return 0
        operation = plan.operations[first]
        summed = stage == 3 and len(signals) != len(plan.output_terms) - 1
        in_order = not summed and np.array_equal(signals, operation.signal + np.arange(operation.n_values))
        if not in_order or operation.function != function or operation.when != k.ALWAYS:
            return 0
        address: int = self._calls.ctypes.data
        return address + 8 * (k.COLUMNS * first + k.VALUES)


def _kind(operation: Operation, version: int) -> int:
    """Return whether an operation is one of the usual two calls."""
    if operation.function == k.SET_DERIVATIVES:
        return k.SLOPES
    plain = operation.wire in (FLOAT64, STRING) and operation.when == k.ALWAYS and version == 2
    return k.PLAIN if plain else k.OTHER
