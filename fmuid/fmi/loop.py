"""What the compiled loop works on: plan and grid of a simulation, and their binding to a set of instances."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.fmi import kernels as k


class Plan(NamedTuple):
    """What the loop does, as arrays.

    `operations` has rows (function, component, first value reference, count, first signal); for COPY the
    row is (COPY, 0, source signal, 1, target signal). `stages` says where each list of operations starts:
    start values | external inputs | exchange between components | outputs | input derivatives.
    """

    operations: NDArray[np.intp]
    stages: NDArray[np.intp]
    references: NDArray[np.uint32]
    signals: NDArray[np.float64]
    strings: NDArray[np.intp]
    parameter_signals: NDArray[np.intp]
    input_signals: NDArray[np.intp]
    input_modes: NDArray[np.intp]
    derivative_signals: NDArray[np.intp]
    output_signals: NDArray[np.intp]


class Grid(NamedTuple):
    """The experiment as the loop walks it: times (K,), substeps of each interval (K-1,), input values (K, n_u)."""

    times: NDArray[np.float64]
    substeps: NDArray[np.intp]
    inputs: NDArray[np.float64]


class Loop:
    """A plan bound to one set of instances: it owns the memory whose addresses the compiled loop works with.

    Parameters
    ----------
    plan : Plan
    grid : Grid
    handles : (n_components,) array of intp
        The instances (fmi2Component).
    addresses : (n_components, n_functions) array of intp
        The FMI functions, in the order of `kernels.FUNCTIONS`.
    used : (n_components,) array of intp
        Whether an instance must be reset before its next simulation; updated.
    """

    def __init__(
        self,
        plan: Plan,
        grid: Grid,
        handles: NDArray[np.intp],
        addresses: NDArray[np.intp],
        used: NDArray[np.intp],
    ) -> None:
        self._signals = plan.signals.copy()
        self._words = np.zeros(len(plan.references) + 1, np.int32)  # whole numbers on their way
        self._ones = np.ones(len(plan.references) + 1, np.int32)  # the order of every input derivative
        self._slopes = np.zeros(len(plan.input_signals) + 1)
        self._calls = self._resolve(plan, handles, addresses)
        self._owned = (plan, grid, handles, addresses, used)  # their addresses are in the memory
        self._memory = np.zeros(k.FIELDS, np.intp)
        fields: dict[int, int | NDArray[Any]] = {
            k.N_COMPONENTS: len(handles),
            k.N_INPUTS: len(plan.input_signals),
            k.N_OUTPUTS: len(plan.output_signals),
            k.N_TIMES: len(grid.times),
            k.N_SIGNALS: len(plan.signals),
            k.N_PARAMETERS: len(plan.parameter_signals),
            k.STAGES: plan.stages,
            k.CALLS: self._calls,
            k.SIGNALS: self._signals,
            k.START_SIGNALS: plan.signals,
            k.WORDS: self._words,
            k.HANDLES: handles,
            k.ADDRESSES: addresses,
            k.USED: used,
            k.TIMES: grid.times,
            k.SUBSTEPS: grid.substeps,
            k.INPUTS: grid.inputs,
            k.INPUT_SIGNALS: plan.input_signals,
            k.INPUT_MODES: plan.input_modes,
            k.DERIVATIVE_SIGNALS: plan.derivative_signals,
            k.OUTPUT_SIGNALS: plan.output_signals,
            k.PARAMETER_SIGNALS: plan.parameter_signals,
            k.SLOPES: self._slopes,
            k.DIRECT_INPUTS: self._direct(plan, 1, k.SET_REAL, plan.input_signals),
            k.DIRECT_OUTPUTS: self._direct(plan, 3, k.GET_REAL, plan.output_signals),
        }
        for field, value in fields.items():
            self._memory[field] = value if isinstance(value, int) else value.ctypes.data

    def run(self, thetas: NDArray[np.float64], outputs: NDArray[np.float64], reports: NDArray[np.intp]) -> None:
        """Simulate thetas (m, N) into outputs (m, K, n_outputs) and reports (m, 4), see `kernels.simulate`."""
        for field, array in ((k.THETAS, thetas), (k.OUTPUTS, outputs), (k.REPORT, reports)):
            if not array.flags.c_contiguous:
                raise ValueError("the compiled loop needs contiguous arrays")
            self._memory[field] = array.ctypes.data
        k.simulate(self._memory.ctypes.data, len(thetas))

    def _resolve(self, plan: Plan, handles: NDArray[np.intp], addresses: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the table of calls: the operations with all the addresses that they need."""
        calls = np.zeros((len(plan.operations), k.COLUMNS), np.intp)
        for row, (function, component, reference, count, signal) in zip(calls, plan.operations.tolist(), strict=True):
            row[[k.FUNCTION, k.COMPONENT, k.COUNT, k.SIGNAL]] = function, component, count, signal
            if function == k.COPY:
                row[k.VALUES] = reference
                continue
            row[k.ADDRESS], row[k.HANDLE] = addresses[component, function], handles[component]
            row[k.REFERENCES] = plan.references.ctypes.data + 4 * reference
            row[k.ORDERS] = self._ones.ctypes.data
            if function == k.SET_STRING:
                row[k.VALUES] = plan.strings.ctypes.data + 8 * signal
            elif k.SET_INTEGER <= function <= k.GET_BOOLEAN:
                row[k.VALUES] = self._words.ctypes.data
            else:
                row[k.VALUES] = self._signals.ctypes.data + 8 * signal
        return calls

    def _direct(self, plan: Plan, stage: int, function: int, signals: NDArray[np.intp]) -> int:
        """Return where to write the address of a whole row of the table, if one call takes it as it is; else 0."""
        first, last = plan.stages[stage : stage + 2].tolist()
        if last != first + 1:
            return 0
        operation = plan.operations[first]
        as_it_is = operation[0] == function and np.array_equal(signals, operation[4] + np.arange(operation[3]))
        return self._calls.ctypes.data + 8 * (k.COLUMNS * first + k.VALUES) if as_it_is else 0
