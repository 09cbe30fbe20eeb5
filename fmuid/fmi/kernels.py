"""Compiled loops over FMI functions: a whole simulation, life cycle included, without returning to Python.

A numba loop calls the FMI functions of the loaded libraries at their addresses. It is compiled once
and cached on disk, releases the interpreter lock, and needs no compiler on the user's machine. What the loop does in
which order is laid down beforehand by `fmuid.fmi.loop`: a list of operations, each one call that sets or gets
the variables of one component from or into the vector of signals.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from fmuid.fmi.native import load_int32, load_real, load_word, native_call, store_int32, store_real, store_word

# Indices of the FMI functions in a component's row of addresses; also the first word of an operation.
SET_REAL, GET_REAL, SET_INTEGER, GET_INTEGER, SET_BOOLEAN, GET_BOOLEAN, SET_STRING = range(7)
SET_DERIVATIVES, DO_STEP, RESET, SETUP, ENTER_INITIALIZATION, EXIT_INITIALIZATION = range(7, 13)
COPY = 13  # not a call: one signal to another
FUNCTIONS = (
    "fmi2SetReal",
    "fmi2GetReal",
    "fmi2SetInteger",
    "fmi2GetInteger",
    "fmi2SetBoolean",
    "fmi2GetBoolean",
    "fmi2SetString",
    "fmi2SetRealInputDerivatives",
    "fmi2DoStep",
    "fmi2Reset",
    "fmi2SetupExperiment",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
)
N_FUNCTIONS = len(FUNCTIONS)
COLUMNS, FIELDS = 9, 28  # of the table of calls and of the memory of one simulation, see below
HELD, BY_DERIVATIVE, BY_MIDPOINT = range(3)  # what an input does between two samples
WARNING = 1  # fmi2Warning, the last status that counts as success
ERROR = 3  # fmi2Error, the last status after which an instance may be reset


_call_values = native_call(types.intp, types.intp, types.intp, types.intp)
_call_derivatives = native_call(types.intp, types.intp, types.intp, types.intp, types.intp)
_call_step = native_call(types.intp, types.float64, types.float64, types.int32)
_call_setup = native_call(types.intp, types.int32, types.float64, types.float64, types.int32, types.float64)
_call_plain = native_call(types.intp)

# Columns of the table of calls: one row an operation, with the addresses that the operation needs.
ADDRESS, HANDLE, REFERENCES, COUNT, VALUES, ORDERS, FUNCTION, COMPONENT, SIGNAL = range(COLUMNS)


# The memory of one simulation: sizes and addresses of all that the loop touches, in one array whose address is `m`.
(
    N_COMPONENTS,
    N_INPUTS,
    N_OUTPUTS,
    N_TIMES,
    STAGES,
    CALLS,
    SIGNALS,
    WORDS,
    HANDLES,
    ADDRESSES,
    USED,
    TIMES,
    SUBSTEPS,
    INPUTS,
    INPUT_SIGNALS,
    INPUT_MODES,
    DERIVATIVE_SIGNALS,
    OUTPUT_SIGNALS,
    SLOPES,
    OUTPUTS,
    REPORT,
    DIRECT_INPUTS,
    DIRECT_OUTPUTS,
    N_SIGNALS,
    N_PARAMETERS,
    THETAS,
    PARAMETER_SIGNALS,
    START_SIGNALS,
) = range(FIELDS)


@numba.njit("boolean(intp, intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _fail(m, function, component, status):  # type: ignore[no-untyped-def]
    """Write a failing call into the report."""
    store_word(load_word(m, REPORT), 0, function)
    store_word(load_word(m, REPORT), 1, component)
    store_word(load_word(m, REPORT), 2, status)
    return False


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _perform(m, first, last):  # type: ignore[no-untyped-def]
    """Perform the calls from stage `first` up to stage `last`; stop at the first that fails."""
    for i in range(load_word(load_word(m, STAGES), first), load_word(load_word(m, STAGES), last)):
        row = load_word(m, CALLS) + 8 * COLUMNS * i
        address, handle, references = load_word(row, ADDRESS), load_word(row, HANDLE), load_word(row, REFERENCES)
        count, values = load_word(row, COUNT), load_word(row, VALUES)
        function, signal = load_word(row, FUNCTION), load_word(row, SIGNAL)
        if function <= GET_REAL or function == SET_STRING:
            status = _call_values(address, (handle, references, count, values))
        elif function == SET_DERIVATIVES:
            status = _call_derivatives(address, (handle, references, count, load_word(row, ORDERS), values))
        elif function == COPY:
            store_real(load_word(m, SIGNALS), signal, load_real(load_word(m, SIGNALS), values))
            status = np.int32(0)
        else:
            for j in range(count):
                store_int32(values, j, np.int32(round(load_real(load_word(m, SIGNALS), signal + j))))
            status = _call_values(address, (handle, references, count, values))
            for j in range(count):
                store_real(load_word(m, SIGNALS), signal + j, np.float64(load_int32(values, j)))
        if status > WARNING:
            return _fail(m, function, load_word(row, COMPONENT), status)
    return True


@numba.njit("intp(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _address(m, component, function):  # type: ignore[no-untyped-def]
    return load_word(load_word(m, ADDRESSES), component * N_FUNCTIONS + function)


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _prepare(m):  # type: ignore[no-untyped-def]
    """Reset what was used and set up the experiment; the stop time stays open."""
    for c in range(load_word(m, N_COMPONENTS)):
        handle = load_word(load_word(m, HANDLES), c)
        if load_word(load_word(m, USED), c):
            status = _call_plain(_address(m, c, RESET), (handle,))
            if status > WARNING:
                return _fail(m, RESET, c, status)
        store_word(load_word(m, USED), c, 1)
        status = _call_setup(_address(m, c, SETUP), (handle, 0, 0.0, load_real(load_word(m, TIMES), 0), 0, 0.0))
        if status > WARNING:
            return _fail(m, SETUP, c, status)
    return True


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy")
def _all_components(m, function):  # type: ignore[no-untyped-def]
    """Call a function without further arguments on every component."""
    for c in range(load_word(m, N_COMPONENTS)):
        status = _call_plain(_address(m, c, function), (load_word(load_word(m, HANDLES), c),))
        if status > WARNING:
            return _fail(m, function, c, status)
    return True


@numba.njit("void(intp, intp, float64, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _set_inputs(m, k, after, modes_from):  # type: ignore[no-untyped-def]
    """Put the inputs, a time `after` past sample k, into the signals; only those of a mode from `modes_from` on."""
    n, signals, slots = load_word(m, N_INPUTS), load_word(m, SIGNALS), load_word(m, INPUT_SIGNALS)
    modes, slopes = load_word(m, INPUT_MODES), load_word(m, SLOPES)
    row = load_word(m, INPUTS) + 8 * n * k
    direct = load_word(m, DIRECT_INPUTS)
    if direct:
        store_word(direct, 0, row if after == 0.0 else signals + 8 * load_word(slots, 0))
        if after == 0.0:
            return
    for j in range(n):
        if load_word(modes, j) >= modes_from:
            store_real(signals, load_word(slots, j), load_real(row, j) + load_real(slopes, j) * after)


@numba.njit("boolean(intp, intp, float64)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _set_slopes(m, k, length):  # type: ignore[no-untyped-def]
    """Find the slopes of the linear inputs in interval k; return whether any input goes by midpoints."""
    n, signals, slots = load_word(m, N_INPUTS), load_word(m, SIGNALS), load_word(m, DERIVATIVE_SIGNALS)
    modes, slopes = load_word(m, INPUT_MODES), load_word(m, SLOPES)
    row = load_word(m, INPUTS) + 8 * n * k
    by_midpoint = False
    for j in range(n):
        mode = load_word(modes, j)
        if mode != HELD:
            slope = (load_real(row, n + j) - load_real(row, j)) / length
            store_real(slopes, j, slope)
            store_real(signals, load_word(slots, j), slope)
            by_midpoint = by_midpoint or mode == BY_MIDPOINT
    return by_midpoint


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _interval(m, k):  # type: ignore[no-untyped-def]
    """All components from sample k to sample k + 1, in equal substeps; the first exchange is done already."""
    times = load_word(m, TIMES)
    begin = load_real(times, k)
    length = load_real(times, k + 1) - begin
    if length <= 0.0:  # a time given twice: a step of the inputs
        return True
    n = load_word(load_word(m, SUBSTEPS), k)
    h = length / n
    by_midpoint = _set_slopes(m, k, length)
    for s in range(n):
        if s > 0:
            _set_inputs(m, k, s * h, HELD)
            if not _perform(m, 1, 3):
                return False
        if by_midpoint:
            _set_inputs(m, k, (s + 0.5) * h, BY_MIDPOINT)
            if not _perform(m, 1, 2):
                return False
        if not _perform(m, 4, 5):
            return False
        handles = load_word(m, HANDLES)
        for c in range(load_word(m, N_COMPONENTS)):
            status = _call_step(_address(m, c, DO_STEP), (load_word(handles, c), begin + s * h, h, 1))
            if status > WARNING:
                return _fail(m, DO_STEP, c, status)
    return True


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _sample(m, k):  # type: ignore[no-untyped-def]
    """Set the inputs of sample k, pass outputs on, and record the outputs."""
    n, signals, slots = load_word(m, N_OUTPUTS), load_word(m, SIGNALS), load_word(m, OUTPUT_SIGNALS)
    row = load_word(m, OUTPUTS) + 8 * n * k
    direct = load_word(m, DIRECT_OUTPUTS)
    if direct:
        store_word(direct, 0, row)
    _set_inputs(m, k, 0.0, HELD)
    if not _perform(m, 1, 4):
        return False
    if not direct:
        for j in range(n):
            store_real(row, j, load_real(signals, load_word(slots, j)))
    return True


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _simulate(m):  # type: ignore[no-untyped-def]
    """One simulation: inputs set, outputs passed on and recorded, all components stepped, sample by sample."""
    if not (_prepare(m) and _perform(m, 0, 1) and _all_components(m, ENTER_INITIALIZATION)):
        return False
    _set_inputs(m, 0, 0.0, HELD)
    if not (_perform(m, 1, 3) and _all_components(m, EXIT_INITIALIZATION)):
        return False
    last = load_word(m, N_TIMES) - 1
    for k in range(last + 1):
        store_word(load_word(m, REPORT), 3, k)
        if not _sample(m, k):
            return False
        if k < last and not _interval(m, k):
            return False
    return True


@numba.njit("void(intp, intp)", cache=True, nogil=True, error_model="numpy")
def simulate(m, count):  # type: ignore[no-untyped-def]
    """Simulate one after the other for `count` thetas on one set of instances.

    The memory says where everything is; `fmuid.fmi.loop.Loop` lays it out. For each theta four words are reported:
    (function, component, status, sample) of the failing call, function -1 where none failed.
    """
    n, parameters, slots = load_word(m, N_PARAMETERS), load_word(m, THETAS), load_word(m, PARAMETER_SIGNALS)
    signals, starts = load_word(m, SIGNALS), load_word(m, START_SIGNALS)
    report, outputs = load_word(m, REPORT), load_word(m, OUTPUTS)
    for i in range(count):
        store_word(m, REPORT, report + 32 * i)
        store_word(m, OUTPUTS, outputs + 8 * i * load_word(m, N_TIMES) * load_word(m, N_OUTPUTS))
        for j in range(4):
            store_word(report + 32 * i, j, -1)
        for j in range(load_word(m, N_SIGNALS)):
            store_real(signals, j, load_real(starts, j))
        for j in range(n):
            store_real(signals, load_word(slots, j), load_real(parameters, i * n + j))
        if not _simulate(m) and load_word(report + 32 * i, 2) > ERROR:
            for j in range(4 * (i + 1), 4 * count):  # the instance must not be touched again
                store_word(report, j, load_word(report, j - 4))
            return
