"""Event Mode of a model-exchange FMU: entering it, iterating in it, leaving it (FMI 2.0.4, section 3.2; 3.0, 3.3.2)."""

from __future__ import annotations

import numpy as np
from numba import types

from fmuid.fmi import block as b
from fmuid.fmi.block import array_call, clear_flags, compiled, copy, fail, hook, put, real, set_real
from fmuid.fmi.native import load_int32, load_real, load_word, native_call, store_real, store_word

MAX_ITERATIONS = 100  # of one event; the standard sets no bound, but an event that needs as many never ends

_call_plain = native_call(types.intp)
_call_pointer = native_call(types.intp, types.intp)
_call_completed = native_call(types.intp, types.int32, types.intp, types.intp)
_call_update = native_call(types.intp, *[types.intp] * 6)


@compiled("int32(intp, intp)")
def _plain_call(c, function):  # type: ignore[no-untyped-def]
    """Call an FMI function that takes nothing but the instance."""
    status = _call_plain(load_word(c, b.FUNCTIONS + function), (load_word(c, b.HANDLE),))
    return fail(c, function, status) if status > b.WARNING else b.OK


@compiled("int32(intp)")
def _new_discrete_states(c):  # type: ignore[no-untyped-def]
    """One call of fmi2NewDiscreteStates or fmi3UpdateDiscreteStates; what it returns lies in FLAGS as fmi2EventInfo."""
    clear_flags(c, 8)
    function = load_word(c, b.FUNCTIONS + b.NEW_DISCRETE_STATES)
    handle, flags = load_word(c, b.HANDLE), load_word(c, b.FLAGS)
    if load_word(c, b.VERSION) == 2:
        status = _call_pointer(function, (handle, flags))
    else:
        status = _call_update(function, (handle, flags, flags + 4, flags + 8, flags + 12, flags + 16, flags + 24))
    return fail(c, b.NEW_DISCRETE_STATES, status) if status > b.WARNING else b.OK


@compiled("int32(intp, float64)")
def _iterate(c, t):  # type: ignore[no-untyped-def]
    """Iterate until the discrete states stay as they are; note the next time event."""
    flags = load_word(c, b.FLAGS)
    set_real(c, b.TIME, t)
    for _ in range(MAX_ITERATIONS):
        if _new_discrete_states(c) != b.OK:
            return b.FAILED
        if load_int32(flags, 1):
            return fail(c, b.TERMINATED_BY_FMU, 0)
        if load_int32(flags, 2):
            store_word(c, b.NOMINALS_KNOWN, 0)
        if not load_int32(flags, 0):
            set_real(c, b.NEXT_EVENT, load_real(flags, 3) if load_int32(flags, 4) else np.inf)
            return b.OK
    return fail(c, b.EVENT_ITERATION_DIVERGES, 0)


@compiled("int32(intp)")
def _find_tolerances(c):  # type: ignore[no-untyped-def]
    """Set the absolute tolerances from the nominal values of the states."""
    absolute = load_word(c, b.ABSOLUTE)
    if array_call(c, b.GET_NOMINALS, absolute) != b.OK:
        return b.FAILED
    for i in range(load_word(c, b.N_STATES)):
        nominal = abs(load_real(absolute, i))
        store_real(absolute, i, real(c, b.TOLERANCE) * (nominal if nominal > 0.0 and nominal < np.inf else 1.0))
    n = load_word(c, b.N_STATES)
    for i in range(n, load_word(c, b.N_TOTAL)):
        store_real(absolute, i, load_real(absolute, i % n) / load_real(load_word(c, b.MAGNITUDES), i // n - 1))
    store_word(c, b.NOMINALS_KNOWN, 1)
    return b.OK


@compiled("int32(intp, float64)")
def to_continuous_time_mode(c, t):  # type: ignore[no-untyped-def]
    """Event iteration, then Continuous-Time Mode at time t; the integrator starts anew from there."""
    if _iterate(c, t) != b.OK or (not load_word(c, b.NOMINALS_KNOWN) and _find_tolerances(c) != b.OK):
        return b.FAILED
    if _plain_call(c, b.ENTER_CONTINUOUS_TIME_MODE) != b.OK:
        return b.FAILED
    # The states are read whether or not the FMU says that it changed them: not all that do so say so.
    if array_call(c, b.GET_STATES, load_word(c, b.X_END)) != b.OK:
        return b.FAILED
    if array_call(c, b.GET_INDICATORS, load_word(c, b.Z_START)) != b.OK:
        return b.FAILED
    set_real(c, b.STEP_START, t)
    set_real(c, b.STEP_END, t)
    set_real(c, b.OLD_ERROR, 1e-4)
    store_word(c, b.MODE, b.CONTINUOUS_TIME_MODE)
    store_word(c, b.PENDING, b.SETTLED)
    store_word(c, b.FRESH, 0)
    store_word(c, b.HOLDS, 1)
    for j in range(load_word(c, b.N_INPUTS)):
        store_real(load_word(c, b.INPUT_VALUES), j, np.nan)
    code = hook(c, b.AFTER_EVENT, t, load_word(c, b.X_END))
    store_word(c, b.INSIDE, 0)
    store_word(c, b.STARTING, 0)
    return code


@compiled("int32(intp)")
def to_event_mode(c):  # type: ignore[no-untyped-def]
    """Enter Event Mode from the step's end."""
    if hook(c, b.BEFORE_EVENT, real(c, b.STEP_END), load_word(c, b.X_END)) != b.OK:
        return b.FAILED
    store_word(c, b.MODE, b.EVENT_MODE)
    store_word(c, b.EVENTS, load_word(c, b.EVENTS) + 1)
    return _plain_call(c, b.ENTER_EVENT_MODE)


@compiled("int32(intp)")
def complete_step(c):  # type: ignore[no-untyped-def]
    """Tell the FMU that the step to the time that it holds is complete; PENDING becomes EVENT if it wants one."""
    function, flags = load_word(c, b.FUNCTIONS + b.COMPLETED_STEP), load_word(c, b.FLAGS)
    if function == 0:
        return b.OK
    clear_flags(c, 2)
    status = _call_completed(function, (load_word(c, b.HANDLE), 1, flags, flags + 4))
    if status > b.WARNING:
        return fail(c, b.COMPLETED_STEP, status)
    if load_int32(flags, 1):
        return fail(c, b.TERMINATED_BY_FMU, 0)
    if load_int32(flags, 0):
        store_word(c, b.PENDING, b.EVENT)
    return hook(c, b.COMPLETE, real(c, b.STEP_END), load_word(c, b.X_END))


@compiled("int32(intp)")
def settle(c):  # type: ignore[no-untyped-def]
    """Bring the FMU to the end of the step and do what is pending there: completion, a state, step or time event."""
    end = real(c, b.STEP_END)
    set_real(c, b.TIME, end)
    event = load_word(c, b.PENDING) == b.EVENT or real(c, b.NEXT_EVENT) <= end
    if not load_word(c, b.HOLDS) and (event or load_word(c, b.FUNCTIONS + b.COMPLETED_STEP)):
        if put(c, end, load_word(c, b.X_END)) != b.OK:
            return b.FAILED
        store_word(c, b.HOLDS, 1)
    if load_word(c, b.PENDING) != b.SETTLED and complete_step(c) != b.OK:
        return b.FAILED
    store_word(c, b.INSIDE, 1)
    if event or load_word(c, b.PENDING) == b.EVENT:
        return to_continuous_time_mode(c, end) if to_event_mode(c) == b.OK else b.FAILED
    store_word(c, b.INSIDE, 0)
    store_word(c, b.PENDING, b.SETTLED)
    copy(load_word(c, b.Z_END), load_word(c, b.Z_START), load_word(c, b.N_INDICATORS))
    return b.OK
