"""Compiled loops over FMI functions: a whole simulation, life cycle included, without returning to Python.

A numba loop calls the FMI functions of the loaded libraries at their addresses. It is compiled once
and cached on disk, releases the interpreter lock, and needs no compiler on the user's machine. What the loop does in
which order is laid down beforehand by `fmuid.fmi.loop`: a list of operations, each one call that sets or gets
the variables of one component from or into the vector of signals.

Co-simulation FMUs of FMI 2.0 are stepped right here. All others have a *stepper*: memory of their own and compiled
functions that take them from one communication point to the next (`fmuid.fmi.integrators` for model exchange,
`fmuid.fmi.co_simulation` for FMI 3.0). Steppers, and whatever else not everybody needs (*hooks*: `fmuid.fmi.coupling`,
`fmuid.fmi.conversions`, `fmuid.fmi.discards`), are called by address: who has no use for them does not compile them.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from fmuid.fmi.codes import (
    ADDRESS,
    ADDRESSES,
    ADVANCE_STEPPER,
    AFTER,
    AFTER_DISCARD,
    BEFORE_SETTING,
    BEGIN_STEPPER,
    BEND,
    BLOCK,
    BY_DERIVATIVE,
    BY_MIDPOINT,
    CALLS,
    CHORDS,
    COLUMNS,
    COMPONENT,
    CONVERSIONS,
    COPY,
    COUNT,
    CURVES,
    DERIVATIVE_SIGNALS,
    DIRECT_INPUTS,
    DIRECT_OUTPUTS,
    DISCARD,
    DO_STEP,
    ENTER_INITIALIZATION,
    ERROR,
    EXCHANGE,
    EXIT_INITIALIZATION,
    FLOAT64,
    FLOATS,
    FROM,
    FROM_WIRE,
    FUNCTION,
    GAUSS_SEIDEL,
    GO,
    HANDLE,
    HANDLES,
    HELD,
    IN_EVENT,
    IN_EVENTS,
    INITIALIZING,
    INPUT_MODES,
    INPUT_SIGNALS,
    INPUTS,
    KIND,
    LENGTH,
    MORE,
    N_COMPONENTS,
    N_FUNCTIONS,
    N_INPUTS,
    N_OUTPUTS,
    N_PARAMETERS,
    N_SIGNALS,
    N_STEPPERS,
    N_TIMES,
    N_VALUES,
    NOW,
    ORDERS,
    OTHER,
    OUTPUT_SIGNALS,
    OUTPUT_TERMS,
    OUTPUTS,
    OWN_TIMES,
    PARAMETER_SIGNALS,
    PLAIN,
    REFERENCES,
    REPORT,
    RESET,
    RESTORING,
    SETTLE,
    SETUP,
    SIGNAL,
    SIGNALS,
    SKIP,
    STAGES,
    START_SIGNALS,
    STEPPED,
    STEPPER_COLUMNS,
    STEPPERS,
    STRIDES,
    STRING,
    SUBSTEP,
    SUBSTEPS,
    TELL_ORIGIN,
    THETAS,
    TIMES,
    TO_WIRE,
    TOLERANCES,
    UNDONE,
    UNTIL,
    USED,
    VALUES,
    VERSION,
    WARNING,
    WHEN,
    WIRE,
)
from fmuid.fmi.native import call_plain, load_real, load_word, native_call, store_real, store_word

_call_values = native_call(types.intp, types.intp, types.intp, types.intp)
_call_more_values = native_call(types.intp, types.intp, types.intp, types.intp, types.intp)
_call_hook = native_call(types.intp, types.intp)
_call_step = native_call(types.intp, types.float64, types.float64, types.int32)
_call_setup = native_call(types.intp, types.int32, types.float64, types.float64, types.int32, types.float64)


@numba.njit("boolean(intp, intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def fail(m, function, component, status):  # type: ignore[no-untyped-def]
    """Write a failing call into the report."""
    store_word(load_word(m, REPORT), 0, function)
    store_word(load_word(m, REPORT), 1, component)
    store_word(load_word(m, REPORT), 2, status)
    return False


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy")
def _perform_other(m, row):  # type: ignore[no-untyped-def]
    """Perform an operation that is not one of the usual two."""
    count, values, signal = load_word(row, COUNT), load_word(row, VALUES), load_word(row, SIGNAL)
    function, wire = load_word(row, FUNCTION), load_word(row, WIRE)
    if function == COPY:
        pair, signals = 2 * count, load_word(m, SIGNALS)
        factor, offset = load_real(load_word(m, CONVERSIONS), pair), load_real(load_word(m, CONVERSIONS), pair + 1)
        store_real(signals, signal, factor * load_real(signals, values) + offset)
        return True
    if load_word(row, WHEN):
        verdict = _call_hook(load_word(m, BEFORE_SETTING), (m, row))
        if verdict != GO:
            return verdict == SKIP
    if wire != FLOAT64 and wire != STRING:
        _call_hook(load_word(m, TO_WIRE), (m, row))
    address, handle, references = load_word(row, ADDRESS), load_word(row, HANDLE), load_word(row, REFERENCES)
    if load_word(row, MORE):
        status = _call_more_values(address, (handle, references, count, values, load_word(row, N_VALUES)))
    else:
        status = _call_values(address, (handle, references, count, values))
    if status > WARNING:
        return fail(m, function, load_word(row, COMPONENT), status)
    if wire != FLOAT64 and wire != STRING:
        _call_hook(load_word(m, FROM_WIRE), (m, row))
    return True


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def perform(m, first, last):  # type: ignore[no-untyped-def]
    """Perform the operations from number `first` up to `last`; stop at the first that fails."""
    for i in range(first, last):
        row = load_word(m, CALLS) + 8 * COLUMNS * i
        kind = load_word(row, KIND)
        if kind == OTHER:
            if not _perform_other(m, row):
                return False
            continue
        address, handle, references = load_word(row, ADDRESS), load_word(row, HANDLE), load_word(row, REFERENCES)
        count, values = load_word(row, COUNT), load_word(row, VALUES)
        if kind == PLAIN:
            status = _call_values(address, (handle, references, count, values))
        else:
            status = _call_more_values(address, (handle, references, count, load_word(row, ORDERS), values))
        if status > WARNING:
            return fail(m, load_word(row, FUNCTION), load_word(row, COMPONENT), status)
    return True


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _stage(m, first, last):  # type: ignore[no-untyped-def]
    """Perform the operations from stage `first` up to stage `last`."""
    stages = load_word(m, STAGES)
    return perform(m, load_word(stages, first), load_word(stages, last))


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def stage(m, first, last):  # type: ignore[no-untyped-def]
    """Do the same, compiled once for all callers."""
    return _stage(m, first, last)


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _settle(m):  # type: ignore[no-untyped-def]
    """Give the components their inputs, from the table and from each other."""
    if load_word(m, SETTLE):
        return stage(m, 1, 2) and _call_hook(load_word(m, SETTLE), (m, 0)) == GO
    return stage(m, 1, 3)


@numba.njit("intp(intp, intp)", cache=True, nogil=True, error_model="numpy")
def stepper_of(m, component):  # type: ignore[no-untyped-def]
    """Return the address of a component's row in the table of steppers."""
    return load_word(m, STEPPERS) + 8 * STEPPER_COLUMNS * component


@numba.njit("intp(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def address_of(m, component, function):  # type: ignore[no-untyped-def]
    """Return the address of a component's FMI function."""
    return load_word(load_word(m, ADDRESSES), component * N_FUNCTIONS + function)


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _prepare(m):  # type: ignore[no-untyped-def]
    """Reset what was used and set up the experiment; the stop time stays open."""
    begin = load_real(load_word(m, TIMES), 0)
    for c in range(load_word(m, N_COMPONENTS)):
        handle = load_word(load_word(m, HANDLES), c)
        if load_word(load_word(m, USED), c):
            status = call_plain(address_of(m, c, RESET), (handle,))
            if status > WARNING:
                return fail(m, RESET, c, status)
        store_word(load_word(m, USED), c, 1)
        store_word(load_word(m, IN_EVENT), c, INITIALIZING)
        store_real(load_word(m, OWN_TIMES), c, begin)
        if load_word(stepper_of(m, c), VERSION) == 2:
            tolerance = load_real(load_word(m, TOLERANCES), c)
            given = np.int32(tolerance > 0.0)
            status = _call_setup(address_of(m, c, SETUP), (handle, given, tolerance, begin, 0, 0.0))
            if status > WARNING:
                return fail(m, SETUP, c, status)
    return True


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _enter_initialization(m):  # type: ignore[no-untyped-def]
    for c in range(load_word(m, N_COMPONENTS)):
        handle, address = load_word(load_word(m, HANDLES), c), address_of(m, c, ENTER_INITIALIZATION)
        if load_word(stepper_of(m, c), VERSION) == 2:
            status = call_plain(address, (handle,))
        else:
            tolerance = load_real(load_word(m, TOLERANCES), c)
            given = np.int32(tolerance > 0.0)
            begin = load_real(load_word(m, TIMES), 0)
            status = _call_setup(address, (handle, given, tolerance, begin, 0, 0.0))
        if status > WARNING:
            return fail(m, ENTER_INITIALIZATION, c, status)
    return True


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _exit_initialization(m):  # type: ignore[no-untyped-def]
    for c in range(load_word(m, N_COMPONENTS)):
        status = call_plain(address_of(m, c, EXIT_INITIALIZATION), (load_word(load_word(m, HANDLES), c),))
        if status > WARNING:
            return fail(m, EXIT_INITIALIZATION, c, status)
        store_word(load_word(m, IN_EVENT), c, IN_EVENTS)
        if load_word(stepper_of(m, c), BLOCK) and _call_hook(load_word(m, BEGIN_STEPPER), (m, c)) != GO:
            return False
    return True


@numba.njit("float64(intp, float64)", cache=True, nogil=True, error_model="numpy")
def polynomial(curve, after):  # type: ignore[no-untyped-def]
    """Return the value of a cubic polynomial whose coefficients are stored lowest power first."""
    high = load_real(curve, 2) + after * load_real(curve, 3)
    return load_real(curve, 0) + after * (load_real(curve, 1) + after * high)


@numba.njit("void(intp, intp, float64, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _set_inputs(m, k, after, modes_from):  # type: ignore[no-untyped-def]
    """Put the inputs, a time `after` past sample k, into the signals; only those of a mode from `modes_from` on."""
    n, signals, slots = load_word(m, N_INPUTS), load_word(m, SIGNALS), load_word(m, INPUT_SIGNALS)
    modes, curves = load_word(m, INPUT_MODES), load_word(m, CURVES)
    row = load_word(m, INPUTS) + 8 * n * k
    direct = load_word(m, DIRECT_INPUTS)
    if direct:
        store_word(direct, 0, row if after == 0.0 else signals + 8 * load_word(slots, 0))
        if after == 0.0:
            return
    for j in range(n):
        mode = load_word(modes, j)
        if mode >= modes_from:
            value = load_real(row, j)
            if after != 0.0 and mode != HELD:
                value = polynomial(load_word(curves, j), after)
            store_real(signals, load_word(slots, j), value)


@numba.njit("boolean(intp, intp, float64, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _set_curves(m, k, length, substeps):  # type: ignore[no-untyped-def]
    """Find the polynomials of the inputs in interval k, lowest power first; return whether any goes by midpoints."""
    n, signals, slots = load_word(m, N_INPUTS), load_word(m, SIGNALS), load_word(m, DERIVATIVE_SIGNALS)
    modes, curves = load_word(m, INPUT_MODES), load_word(m, CURVES)
    row = load_word(m, INPUTS) + 8 * n * k
    needed = substeps > 1 or load_word(m, BEND) != 0  # an FMU that goes along the slope needs no more
    by_midpoint = False
    for j in range(n):
        mode = load_word(modes, j)
        if mode != HELD:
            slope = (load_real(row, n + j) - load_real(row, j)) / length
            store_real(signals, load_word(slots, j), slope)
            if needed or mode != BY_DERIVATIVE:
                curve = load_word(curves, j)
                store_real(curve, 0, load_real(row, j))
                store_real(curve, 1, slope)
            by_midpoint = by_midpoint or mode == BY_MIDPOINT
    if load_word(m, BEND):
        _call_hook(load_word(m, BEND), (m, k))
    return by_midpoint


@numba.njit(
    "boolean(intp, intp, float64, float64, float64)", cache=True, nogil=True, error_model="numpy", forceinline=True
)
def _advance(m, c, now, h, until):  # type: ignore[no-untyped-def]
    """Take one component over one of its steps."""
    if load_word(m, N_STEPPERS) and load_word(stepper_of(m, c), BLOCK):
        store_real(m, FROM, now)
        store_real(m, UNTIL, until)
        return _call_hook(load_word(m, ADVANCE_STEPPER), (m, c)) == GO
    status = _call_step(address_of(m, c, DO_STEP), (load_word(load_word(m, HANDLES), c), now, h, 1))
    if status > WARNING:
        if status == DISCARD and load_word(m, AFTER_DISCARD):
            store_real(m, FROM, now)
            store_real(m, UNTIL, until)
            return _call_hook(load_word(m, AFTER_DISCARD), (m, c)) == GO
        return fail(m, DO_STEP, c, status)
    return True


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _interval(m, k):  # type: ignore[no-untyped-def]
    """All components from sample k to sample k + 1, in equal substeps; the first exchange is done already."""
    times = load_word(m, TIMES)
    begin, end = load_real(times, k), load_real(times, k + 1)
    length = end - begin
    store_word(m, STEPPED, length <= 0.0)
    if length <= 0.0:  # a time given twice: a step of the inputs
        return True
    n = load_word(load_word(m, SUBSTEPS), k)
    h = length / n
    by_midpoint = _set_curves(m, k, length, n)
    if load_word(m, N_STEPPERS):
        _call_hook(load_word(m, TELL_ORIGIN), (m, 0))
    strides, gauss_seidel = load_word(m, STRIDES), load_word(m, GAUSS_SEIDEL)
    for s in range(n):
        now = begin + s * h
        until = end if s == n - 1 else begin + (s + 1) * h
        store_word(m, SUBSTEP, s)
        if s > 0:
            store_real(m, NOW, now)
            _set_inputs(m, k, s * h, HELD)
            if not _settle(m):
                return False
        if by_midpoint:
            _set_inputs(m, k, (s + 0.5) * h, BY_MIDPOINT)
            if not stage(m, 1, 2):
                return False
        if load_word(m, CHORDS):
            store_real(m, AFTER, s * h)
            store_real(m, LENGTH, h)
            _call_hook(load_word(m, CHORDS), (m, 0))
        if not _stage(m, 4, 5):
            return False
        for c in range(load_word(m, N_COMPONENTS)):
            if strides == 0:
                if not _advance(m, c, now, h, until):
                    return False
            elif (s + 1) % load_word(strides, c) == 0 or s == n - 1:
                own = load_real(load_word(m, OWN_TIMES), c)
                store_real(load_word(m, OWN_TIMES), c, until)
                if not _advance(m, c, own, until - own, until):
                    return False
            if gauss_seidel and not stage(m, 5 + c, 6 + c):
                return False
    return True


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _sample(m, k):  # type: ignore[no-untyped-def]
    """Set the inputs of sample k, pass outputs on, and record the outputs."""
    n, signals, slots = load_word(m, N_OUTPUTS), load_word(m, SIGNALS), load_word(m, OUTPUT_SIGNALS)
    row = load_word(m, OUTPUTS) + 8 * n * k
    direct = load_word(m, DIRECT_OUTPUTS)
    if direct:
        store_word(direct, 0, row)
    store_real(m, NOW, load_real(load_word(m, TIMES), k))
    store_word(m, SUBSTEP, 0)
    _set_inputs(m, k, 0.0, HELD)
    if load_word(m, SETTLE) == 0:
        if not _stage(m, 1, 4):
            return False
    elif not (_settle(m) and stage(m, 3, 4)):
        return False
    if not direct:
        terms = load_word(m, OUTPUT_TERMS)
        for j in range(n):
            value = 0.0
            for i in range(load_word(terms, j), load_word(terms, j + 1)):
                value += load_real(signals, load_word(slots, i))
            store_real(row, j, value)
    return True


@numba.njit("boolean(intp)", cache=True, nogil=True, error_model="numpy")
def _simulate(m):  # type: ignore[no-untyped-def]
    """One simulation: inputs set, outputs passed on and recorded, all components stepped, sample by sample."""
    store_word(m, STEPPED, 0)
    store_word(m, SUBSTEP, 0)
    store_real(m, NOW, load_real(load_word(m, TIMES), 0))
    if not (_prepare(m) and stage(m, 0, 1) and _enter_initialization(m)):
        return False
    _set_inputs(m, 0, 0.0, HELD)
    if load_word(m, EXCHANGE) == 0:
        if not stage(m, 1, 3):
            return False
    elif not stage(m, 1, 2) or _call_hook(load_word(m, EXCHANGE), (m, 0)) != GO:
        return False
    if not _exit_initialization(m):
        return False
    last = load_word(m, N_TIMES) - 1
    for k in range(last + 1):
        store_word(load_word(m, REPORT), 3, k)
        if not _sample(m, k):
            return False
        if k < last and not _interval(m, k):
            return False
    return True


@numba.njit("void(intp)", cache=True, nogil=True, error_model="numpy", forceinline=True)
def _restore_floats(m):  # type: ignore[no-untyped-def]
    """Put back the floating-point environment: what an FMU did to it ends with the simulation."""
    restoring = load_word(m, RESTORING)
    if restoring:
        call_plain(restoring, (load_word(m, FLOATS),))


@numba.njit("void(intp, intp)", cache=True, nogil=True, error_model="numpy")
def simulate(m, count):  # type: ignore[no-untyped-def]
    """Simulate one after the other for `count` thetas on one set of instances.

    The memory says where everything is; `fmuid.fmi.loop.Loop` lays it out. For each theta four words are reported:
    (function, component, status, sample) of the failing call, function -1 where none failed. After a fatal failure the
    others are not simulated any more: their status is `UNDONE`.
    """
    n, parameters, slots = load_word(m, N_PARAMETERS), load_word(m, THETAS), load_word(m, PARAMETER_SIGNALS)
    signals, starts = load_word(m, SIGNALS), load_word(m, START_SIGNALS)
    report, outputs = load_word(m, REPORT), load_word(m, OUTPUTS)
    for i in range(count):
        store_word(m, REPORT, report + 32 * i)
        store_word(m, OUTPUTS, outputs + 8 * i * load_word(m, N_TIMES) * load_word(m, N_OUTPUTS))
        for j in range(4):
            store_word(report + 32 * i, j, -1)
        store_word(report + 32 * i, 2, UNDONE)
        for j in range(load_word(m, N_SIGNALS)):
            store_real(signals, j, load_real(starts, j))
        for j in range(n):
            store_real(signals, load_word(slots, j), load_real(parameters, i * n + j))
        succeeded = _simulate(m)
        _restore_floats(m)
        if succeeded:
            store_word(report + 32 * i, 2, -1)
        elif load_word(report + 32 * i, 2) > ERROR:
            for j in range(i + 1, count):  # the instance must not be touched again
                store_word(report + 32 * j, 2, UNDONE)
            return
