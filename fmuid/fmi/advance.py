"""The compiled functions that take a model-exchange FMU through time: from event to event, step by step.

All four take the address of a block and a time, and return 0 or, after a failure, another number; the block then says
what failed. Compiled loops call them at their addresses (`advance.address`).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from fmuid.fmi import block as b
from fmuid.fmi.block import array_call, compiled, copy, fail, hook, input_at, put, put_inputs, real, set_real
from fmuid.fmi.cvode import cvode_interpolate, cvode_step
from fmuid.fmi.events import complete_step, settle, to_continuous_time_mode, to_event_mode
from fmuid.fmi.native import load_real, load_word, store_real, store_word
from fmuid.fmi.runge_kutta import EPSILON, runge_kutta_interpolate, runge_kutta_step

MAX_STEPS = 1_000_000  # of one advance, where the integrator chooses them: some seconds, then it will never arrive
MAX_EVENTS = 10_000  # of one advance: chattering, or bounces without end
INPUT_JUMP = 1e-9  # of an input's magnitude: less is rounding of its polynomials


@compiled("int32(intp, float64)")
def _interpolate(c, t):  # type: ignore[no-untyped-def]
    """Put the states at a time t within the step into X_AT."""
    if real(c, b.STEP_LENGTH) == 0.0:
        copy(load_word(c, b.X_END), load_word(c, b.X_AT), load_word(c, b.N_TOTAL))
        return b.OK
    if load_word(c, b.INTEGRATOR) == b.CVODE:
        return cvode_interpolate(c, t)
    runge_kutta_interpolate(c, t)
    return b.OK


@compiled("int32(intp, float64)")
def _coast(c, end):  # type: ignore[no-untyped-def]
    """Let time pass without integrating: there are no states, or the time is too short to change them."""
    set_real(c, b.STEP_START, real(c, b.STEP_END))
    set_real(c, b.STEP_END, end)
    set_real(c, b.STEP_LENGTH, 0.0)
    if put(c, end, load_word(c, b.X_END)) != b.OK:
        return b.FAILED
    store_word(c, b.HOLDS, 1)
    return array_call(c, b.GET_INDICATORS, load_word(c, b.Z_END))


@compiled("boolean(intp, intp)")
def _crossed(c, after):  # type: ignore[no-untyped-def]
    """Return whether an indicator left its domain, z > 0 or z <= 0 (FMI 2.0.4, section 3.1.1; 3.0, 3.1.1)."""
    for i in range(load_word(c, b.N_INDICATORS)):
        if (load_real(load_word(c, b.Z_START), i) > 0.0) != (load_real(after, i) > 0.0):
            return True
    return False


@compiled("float64(intp, float64, float64)")
def _secant(c, low, high):  # type: ignore[no-untyped-def]
    """Return the first time at which a straight line through an indicator's values at both ends crosses zero."""
    first = high
    for i in range(load_word(c, b.N_INDICATORS)):
        before, after = load_real(load_word(c, b.Z_START), i), load_real(load_word(c, b.Z_END), i)
        if (before > 0.0) != (after > 0.0):
            first = min(first, low + (high - low) * (before / (before - after)))
    return first


@compiled("int32(intp)")
def _locate(c):  # type: ignore[no-untyped-def]
    """Cut the step just after the first crossing in it.

    A bracket is kept, no indicator having crossed at its low end; it shrinks by the method ITP (I. F. D. Oliveira,
    R. H. C. Takahashi, ACM Trans. Math. Softw. 47 (2021) 5), which needs one probe more than bisection at worst.
    """
    low, high = real(c, b.STEP_START), real(c, b.STEP_END)
    width = high - low
    half = 2.0 * EPSILON * max(abs(low), abs(high))
    radius = half * 2.0 ** (math.ceil(math.log2(max(width / (2.0 * half), 1.0))) + 1)
    while high - low > 2.0 * half:
        middle = 0.5 * (low + high)
        reach, nudge = radius - 0.5 * (high - low), 0.2 / width * (high - low) ** 2
        radius *= 0.5
        guess = _secant(c, low, high)
        side = math.copysign(1.0, middle - guess)
        t = guess + side * nudge if nudge <= abs(middle - guess) else middle
        t = t if abs(t - middle) <= reach else middle - side * reach
        t = t if low < t and t < high else middle
        if _interpolate(c, t) != b.OK or put(c, t, load_word(c, b.X_AT)) != b.OK:
            return b.FAILED
        if array_call(c, b.GET_INDICATORS, load_word(c, b.Z_AT)) != b.OK:
            return b.FAILED
        after = _crossed(c, load_word(c, b.Z_AT))
        copy(load_word(c, b.Z_AT), load_word(c, b.Z_END if after else b.Z_START), load_word(c, b.N_INDICATORS))
        if after:
            high = t
            copy(load_word(c, b.X_AT), load_word(c, b.X_END), load_word(c, b.N_TOTAL))
        else:
            low = t
        store_word(c, b.HOLDS, 1 if after else 0)
    set_real(c, b.STEP_END, high)
    return b.OK


@compiled("int32(intp, float64)")
def _step(c, bound):  # type: ignore[no-untyped-def]
    """One step towards `bound`, cut at the first state event in it."""
    begin = real(c, b.STEP_END)
    store_word(c, b.STEPS, load_word(c, b.STEPS) + 1)
    if load_word(c, b.N_TOTAL) == 0:
        code = _coast(c, min(bound, begin + real(c, b.LARGEST_STEP)))
    elif bound - begin <= 100.0 * EPSILON * max(abs(begin), abs(bound)):
        code = _coast(c, bound)
    elif load_word(c, b.INTEGRATOR) == b.CVODE:
        code = cvode_step(c, bound)
    else:
        code = runge_kutta_step(c, bound)
    if code != b.OK:
        return b.FAILED
    store_word(c, b.PENDING, b.COMPLETION)
    if _crossed(c, load_word(c, b.Z_END)):
        store_word(c, b.PENDING, b.EVENT)
        return _locate(c)
    return b.OK


@compiled("int32(intp, float64)")
def _heed_inputs(c, t):  # type: ignore[no-untyped-def]
    """See whether an input has jumped at the current time: the integrator starts anew, maybe with a state event."""
    jump = False
    for j in range(load_word(c, b.N_INPUTS)):
        change = abs(input_at(c, j, t) - load_real(load_word(c, b.INPUT_VALUES), j))
        jump = jump or change > INPUT_JUMP * load_real(load_word(c, b.INPUT_SCALES), j)
    if not jump:
        return b.OK
    store_word(c, b.FRESH, 0)
    if load_word(c, b.N_INDICATORS) == 0:
        return b.OK
    if put_inputs(c, t) != b.OK or array_call(c, b.GET_INDICATORS, load_word(c, b.Z_AT)) != b.OK:
        return b.FAILED
    if _crossed(c, load_word(c, b.Z_AT)):
        store_word(c, b.PENDING, b.EVENT)
    return b.OK


@compiled("int32(intp, float64)")
def _arrive(c, t):  # type: ignore[no-untyped-def]
    """Leave time t, the inputs and the states as of t in the FMU; t is within the step or its settled end."""
    end = real(c, b.STEP_END)
    x = load_word(c, b.X_END if t == end else b.X_AT)
    if t == end and load_word(c, b.HOLDS):
        code = put_inputs(c, t)  # they may have new polynomials
    elif t == end:
        code = put(c, t, x)
        store_word(c, b.HOLDS, 1)
    else:
        code = put(c, t, x) if _interpolate(c, t) == b.OK else b.FAILED
    return hook(c, b.FOLLOW, t, x) if code == b.OK else code


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def begin(c, t):  # type: ignore[no-untyped-def]
    """Make the memory fresh for a simulation from time t on; the FMU has left Initialization Mode for Event Mode."""
    for field in (b.NOMINALS_KNOWN, b.STEPS, b.EVENTS, b.FRESH, b.HOLDS, b.INSIDE):
        store_word(c, field, 0)
    store_word(c, b.STARTING, 1)
    store_word(c, b.MODE, b.EVENT_MODE)
    store_word(c, b.PENDING, b.SETTLED)
    set_real(c, b.TIME, t)
    set_real(c, b.STEP_END, t)
    set_real(c, b.NEXT_EVENT, np.inf)
    set_real(c, b.H, 0.0)
    for j in range(load_word(c, b.N_INPUTS)):
        store_real(load_word(c, b.INPUT_VALUES), j, np.nan)
        store_real(load_word(c, b.INPUT_SCALES), j, 0.0)
    return b.OK


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def enter_events(c, t):  # type: ignore[no-untyped-def]
    """Enter Event Mode at the current time t, time and states set as of t; do nothing if already in it."""
    if load_word(c, b.MODE) == b.EVENT_MODE:
        return b.OK
    if t < real(c, b.STEP_END):
        if _interpolate(c, t) != b.OK:
            return b.FAILED
        copy(load_word(c, b.X_AT), load_word(c, b.X_END), load_word(c, b.N_TOTAL))
        set_real(c, b.STEP_END, t)
        store_word(c, b.HOLDS, 0)
    if not load_word(c, b.HOLDS) and put(c, t, load_word(c, b.X_END)) != b.OK:
        return b.FAILED
    if load_word(c, b.PENDING) != b.SETTLED and complete_step(c) != b.OK:
        return b.FAILED
    return to_event_mode(c)


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def leave_events(c, t):  # type: ignore[no-untyped-def]
    """Event iteration at time t, then Continuous-Time Mode; the integrator starts anew."""
    return to_continuous_time_mode(c, t)


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def advance(c, t):  # type: ignore[no-untyped-def]
    """Integrate from the current time to t, events handled on the way and at t; the FMU then holds t, u(t), x(t)."""
    last_event = load_word(c, b.EVENTS) + MAX_EVENTS
    store_word(c, b.STEPS_BEFORE, load_word(c, b.STEPS))
    store_word(c, b.STIFF_HITS, 0)
    look_ahead = load_word(c, b.INTEGRATOR) != b.RK4 and load_word(c, b.N_TOTAL) > 0
    while True:
        end = real(c, b.STEP_END)
        if t < end:
            return _arrive(c, t)
        if load_word(c, b.PENDING) != b.SETTLED or real(c, b.NEXT_EVENT) <= end:
            if load_word(c, b.EVENTS) >= last_event:
                return fail(c, b.TOO_MANY_EVENTS, 0)
            if settle(c) != b.OK:
                return b.FAILED
        elif t == end:
            return _arrive(c, t)
        else:
            if load_word(c, b.HOLDS) and _heed_inputs(c, end) != b.OK:
                return b.FAILED
            if load_word(c, b.PENDING) == b.EVENT:
                continue
            if look_ahead and load_word(c, b.STEPS) >= load_word(c, b.STEPS_BEFORE) + MAX_STEPS:
                return fail(c, b.TOO_MANY_STEPS, 0)
            bound = min(max(t, real(c, b.LIMIT)) if look_ahead else t, real(c, b.NEXT_EVENT))
            if _step(c, bound) != b.OK:
                return b.FAILED
