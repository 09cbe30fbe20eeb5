"""The memory of one model-exchange instance, and the FMI calls of its integration, from compiled loops.

A block is an array of words whose address `c` is passed around; it holds sizes, addresses of work arrays and of the
FMI functions. FMI 2.0 and 3.0 differ in the signature of a few functions only, and the block knows its version.
"""

from __future__ import annotations

from functools import partial

import numba
from numba import types

from fmuid.fmi.native import load_int32, load_real, load_word, native_call, store_int32, store_real, store_word

# The FMI functions, as indices into the addresses at the end of the block and as what a failure names.
(
    SET_TIME,
    SET_REAL,
    SET_STATES,
    GET_DERIVATIVES,
    GET_INDICATORS,
    GET_STATES,
    GET_NOMINALS,
    ENTER_EVENT_MODE,
    NEW_DISCRETE_STATES,
    ENTER_CONTINUOUS_TIME_MODE,
    COMPLETED_STEP,
    DIRECTIONAL_DERIVATIVE,
) = range(12)
N_FUNCTIONS = 12

# What else a failure names.
(
    STEP_TOO_SMALL,
    STATE_NOT_FINITE,
    EVENT_ITERATION_DIVERGES,
    TERMINATED_BY_FMU,
    TOO_MANY_STEPS,
    TOO_MANY_EVENTS,
    STIFF,
    CVODE_FAILED,
    JUMP_UNKNOWN,
    JUMP_REFUSED,
) = range(N_FUNCTIONS, N_FUNCTIONS + 10)

RK4, RK45, CVODE = range(3)  # the word INTEGRATOR
EVENT_MODE, CONTINUOUS_TIME_MODE = range(2)  # the word MODE
SETTLED, COMPLETION, EVENT = range(3)  # the word PENDING: what is still to be done at the end of the step
OK, REJECT, FAILED = 0, 1, -1  # results of compiled functions; as CVODE reads those of a right-hand side
WARNING, DISCARD, ERROR_STATUS = 1, 2, 3  # fmi*Status

# The words of a block.
(
    VERSION,  # of the FMI standard, 2 or 3
    HANDLE,
    N_STATES,
    N_TOTAL,  # length of the integrated vector: the states, and what is integrated with them
    N_INDICATORS,
    N_INPUTS,  # values; an array of FMI 3.0 has several
    N_INPUT_REFERENCES,
    INTEGRATOR,
    MODE,
    PENDING,
    FRESH,  # whether the integrator may go on from where it is: derivatives of the step's end, history of CVODE
    HOLDS,  # whether the FMU holds time, inputs and states of the step's end
    NOMINALS_KNOWN,
    STEPS,  # since `begin`
    STEPS_BEFORE,  # the present `advance`
    EVENTS,  # since `begin`, those that `enter_events` brought from outside included
    STIFF_HITS,
    STIFF_MISSES,
    FAILED_FUNCTION,
    FAILED_STATUS,
    BAD_STATE,
    STARTING,  # whether the event that is to be left is the first
    INSIDE,  # whether the event that was entered was found by the integrator, not brought from outside
    REALS,  # from here on addresses
    COEFFICIENTS,
    INPUT_REFERENCES,
    INPUT_VALUES,  # that the FMU holds; not a number where that is unknown
    INPUT_SCALES,  # largest magnitudes so far
    FLAGS,  # 16 int32: what functions return through pointers, among it fmi2EventInfo
    X_START,
    X_END,  # of the current step; between steps the states
    X_STAGE,
    X_AT,  # interpolated
    ABSOLUTE,  # absolute tolerances
    SLOPES,  # (n_stages, n_total)
    DENSE,  # (2, n_total)
    Z_START,
    Z_END,
    Z_AT,
    N_STAGES,
    NODES,
    WEIGHTS,  # (n_stages, n_stages) of the stages, then one row each of the error and of the dense output
    CVODE_MEMORY,
    CVODE_STATE,  # N_Vector of X_END
    CVODE_AT,  # N_Vector of X_AT
    CVODE_ABSOLUTE,  # N_Vector of ABSOLUTE
    CVODE_STEP,  # from here on addresses of functions
    CVODE_REINIT,
    CVODE_SET_TOLERANCES,
    CVODE_SET_STOP_TIME,
    CVODE_SET_INIT_STEP,
    CVODE_GET_DKY,
    CVODE_SET_JACOBIAN,
    STATE_REFERENCES,
    DERIVATIVE_REFERENCES,
    MAGNITUDES,  # of the parameters whose sensitivities are integrated with the states
    SENSITIVITIES,  # memory of `fmuid.fmi.sensitivities`
    EXTEND,  # from here on compiled functions that deal with what is integrated beside the states, 0 without it
    FOLLOW,
    COMPLETE,
    BEFORE_EVENT,
    AFTER_EVENT,
    FUNCTIONS,  # the first of N_FUNCTIONS addresses; 0 where the FMU has none
) = range(63)
N_WORDS = FUNCTIONS + N_FUNCTIONS

# The numbers of a block, at the address in its word REALS.
(
    ORIGIN,  # time at which the inputs' polynomials have their tau = 0
    LIMIT,  # steps may go beyond the wanted time up to here
    TIME,  # that the FMU holds, or was given last before it failed
    STEP_START,
    STEP_END,
    STEP_LENGTH,  # before an event cut the step
    NEXT_EVENT,  # time of the next time event; infinite where there is none
    H,  # step length to try next; 0 where unknown
    LARGEST_STEP,
    TOLERANCE,
    ERROR,  # of the last attempt, 1 being just acceptable
    OLD_ERROR,
    RETURNED,  # time that CVODE returns
) = range(13)
N_REALS = 13

# For functions that only compiled functions call: without wrappers for Python and C a sixth less time to compile.
compiled = partial(
    numba.njit, cache=True, nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
)

_call_time = native_call(types.intp, types.float64)
_call_set2 = native_call(types.intp, types.intp, types.intp, types.intp)
_call_set3 = native_call(types.intp, types.intp, types.intp, types.intp, types.intp)
_call_array = native_call(types.intp, types.intp, types.intp)
_call_extend = native_call(types.intp, types.float64, types.intp, types.intp)
_call_hook = native_call(types.intp, types.float64, types.intp)


@compiled("float64(intp, intp)")
def real(c, index):  # type: ignore[no-untyped-def]
    """Return a number of the block."""
    return load_real(load_word(c, REALS), index)


@compiled("void(intp, intp, float64)")
def set_real(c, index, value):  # type: ignore[no-untyped-def]
    """Write a number of the block."""
    store_real(load_word(c, REALS), index, value)


@compiled("void(intp, intp, intp)")
def copy(source, target, count):  # type: ignore[no-untyped-def]
    """Copy numbers from one address to another."""
    for i in range(count):
        store_real(target, i, load_real(source, i))


@compiled("int32(intp, intp, intp)")
def fail(c, function, status):  # type: ignore[no-untyped-def]
    """Write down what failed; return FAILED."""
    store_word(c, FAILED_FUNCTION, function)
    store_word(c, FAILED_STATUS, status)
    return FAILED


@compiled("int32(intp, intp, intp)")
def array_call(c, function, values):  # type: ignore[no-untyped-def]
    """Call an FMI function (instance, values, count) on states or indicators; REJECT where it discards."""
    count = load_word(c, N_INDICATORS if function == GET_INDICATORS else N_STATES)
    if count == 0:
        return OK
    status = _call_array(load_word(c, FUNCTIONS + function), (load_word(c, HANDLE), values, count))
    if status > WARNING:
        fail(c, function, status)
        return REJECT if status == DISCARD else FAILED
    return OK


@compiled("float64(intp, intp, float64)")
def input_at(c, j, t):  # type: ignore[no-untyped-def]
    """Return input j at time t: a cubic polynomial in t - ORIGIN."""
    row = load_word(c, COEFFICIENTS) + 32 * j
    tau = t - real(c, ORIGIN)
    return load_real(row, 0) + tau * (load_real(row, 1) + tau * (load_real(row, 2) + tau * load_real(row, 3)))


@compiled("int32(intp, float64)")
def put_inputs(c, t):  # type: ignore[no-untyped-def]
    """Set the inputs as of time t, unless the FMU holds them already."""
    n, values, scales = load_word(c, N_INPUTS), load_word(c, INPUT_VALUES), load_word(c, INPUT_SCALES)
    same = True
    for j in range(n):
        value = input_at(c, j, t)
        same = same and value == load_real(values, j)
        store_real(values, j, value)
        store_real(scales, j, max(load_real(scales, j), abs(value)))
    if same:
        return OK
    function, handle = load_word(c, FUNCTIONS + SET_REAL), load_word(c, HANDLE)
    references, count = load_word(c, INPUT_REFERENCES), load_word(c, N_INPUT_REFERENCES)
    if load_word(c, VERSION) == 2:
        status = _call_set2(function, (handle, references, count, values))
    else:
        status = _call_set3(function, (handle, references, count, values, n))
    return fail(c, SET_REAL, status) if status > WARNING else OK


@compiled("int32(intp, float64)")
def put_time(c, t):  # type: ignore[no-untyped-def]
    """Set the FMU's time."""
    status = _call_time(load_word(c, FUNCTIONS + SET_TIME), (load_word(c, HANDLE), t))
    return fail(c, SET_TIME, status) if status > WARNING else OK


@compiled("int32(intp, float64, intp)")
def put(c, t, x):  # type: ignore[no-untyped-def]
    """Set time, inputs and states."""
    store_word(c, HOLDS, 0)
    set_real(c, TIME, t)
    code = put_time(c, t)
    if code == OK:
        code = put_inputs(c, t)
    return array_call(c, SET_STATES, x) if code == OK else code


@compiled("int32(intp, float64, intp, intp)")
def right_hand_side(c, t, x, dx):  # type: ignore[no-untyped-def]
    """Find the derivatives dx of the integrated vector x at time t, inputs as of t; REJECT where there are none."""
    code = put(c, t, x)
    if code == OK:
        code = array_call(c, GET_DERIVATIVES, dx)
    if code == OK and load_word(c, EXTEND):
        code = _call_extend(load_word(c, EXTEND), (c, t, x, dx))
    if code != OK:
        return code
    for i in range(load_word(c, N_TOTAL)):
        value, slope = load_real(x, i), load_real(dx, i)
        if (value - value) + (slope - slope) != 0.0:  # one is infinite or not a number
            fail(c, STATE_NOT_FINITE, 0)
            store_word(c, BAD_STATE, i)
            return REJECT
    return OK


@compiled("int32(intp, intp, float64, intp)")
def hook(c, field, t, x):  # type: ignore[no-untyped-def]
    """Call what deals with what is integrated beside the states x, if there is anything."""
    address = load_word(c, field)
    return _call_hook(address, (c, t, x)) if address else OK


@compiled("int32(intp, intp)")
def clear_flags(c, count):  # type: ignore[no-untyped-def]
    """Zero the first flags: FMI 3.0 writes single bytes into them."""
    flags = load_word(c, FLAGS)
    for i in range(count):
        store_int32(flags, i, 0)
    return load_int32(flags, 0)
