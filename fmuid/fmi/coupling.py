"""Hooks of the compiled master loop for components with steppers, loops of direct feed-through, and curved inputs.

Each is a compiled function of the memory of a simulation (`fmuid.fmi.kernels`) and a row or number, called by address.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from fmuid.fmi import codes as k
from fmuid.fmi.kernels import fail, perform, polynomial, stepper_of
from fmuid.fmi.native import load_real, load_word, native_call, store_real, store_word

LOOP_ITERATIONS = 30
LOOP_TOLERANCE = 1e-10
LOOP_DIFFERENCE = 1e-6
EVENT_ROUNDS = 20  # of events at one time that cause one another in several components
# A pivot below this is rounding: the derivatives are differences, and of order one.
SINGULAR = 1e-8

_call_stepper = native_call(types.intp, types.float64)
_HOOK = "int32(intp, intp)"


@numba.njit("boolean(intp, intp, intp, float64)", cache=True, nogil=True, error_model="numpy")
def _step_on(m, component, function, time):  # type: ignore[no-untyped-def]
    """Call a function of a component's stepper."""
    stepper = stepper_of(m, component)
    if _call_stepper(load_word(stepper, function), (load_word(stepper, k.BLOCK), time)) == 0:
        return True
    failure = load_word(stepper, k.FAILURE)
    return fail(m, k.STEPPER + load_word(failure, 0), component, load_word(failure, 1))


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _before_setting(m, row):  # type: ignore[no-untyped-def]
    """Say whether a value is to be set now, and take its component into the right mode."""
    component, when = load_word(row, k.COMPONENT), load_word(row, k.WHEN)
    if when & k.LATCHED and load_word(m, k.SUBSTEP) % load_word(load_word(m, k.STRIDES), component) != 0:
        return k.SKIP
    if when & (k.AS_EVENT | k.AT_STEPS | k.WITH_RESTART) == 0:
        return k.GO
    last, first = load_word(row, k.LAST), load_word(row, k.SIGNAL)
    changed = False
    for j in range(load_word(row, k.N_VALUES)):
        value = load_real(load_word(m, k.SIGNALS), first + j)
        changed = changed or value != load_real(last, j)
        store_real(last, j, value)
    if load_word(load_word(m, k.IN_EVENT), component) != k.RUNNING:
        return k.GO
    if not changed:
        return k.SKIP if when & k.AS_EVENT else k.GO
    if when & k.AS_EVENT or (when & k.AT_STEPS and load_word(m, k.STEPPED)):
        if not _step_on(m, component, k.ENTER_EVENTS, load_real(m, k.NOW)):
            return k.FAILED
        store_word(load_word(m, k.IN_EVENT), component, k.IN_EVENTS)
    elif when & k.WITH_RESTART:
        fresh = load_word(stepper_of(m, component), k.FRESH)
        if fresh:
            store_word(fresh, 0, 0)
    return k.GO


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _perform(m, first, last):  # type: ignore[no-untyped-def]
    return perform(m, first, last)


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _loop_residual(m, loop, residual):  # type: ignore[no-untyped-def]
    """Set the unknowns, which follow on each other in the loop's work memory, pass the outputs on, and compare."""
    n, slots, x = load_word(loop, k.LOOP_COUNT), load_word(loop, k.LOOP_SIGNALS), load_word(loop, k.LOOP_WORK)
    signals = load_word(m, k.SIGNALS)
    for j in range(n):
        store_real(signals, load_word(slots, j), load_real(x, j))
    if not _perform(m, load_word(loop, k.LOOP_SET), load_word(loop, k.LOOP_END)):
        return False
    if not _perform(m, load_word(loop, k.LOOP_GET), load_word(loop, k.LOOP_SET)):
        return False
    for j in range(n):
        store_real(residual, j, load_real(signals, load_word(slots, j)) - load_real(x, j))
    return True


@numba.njit("boolean(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _solve(n, matrix, right):  # type: ignore[no-untyped-def]
    """Solve by elimination with pivots, in place; the matrix is stored column by column. False if it is singular."""
    for j in range(n):
        pivot = j
        for i in range(j + 1, n):
            if abs(load_real(matrix, n * j + i)) > abs(load_real(matrix, n * j + pivot)):
                pivot = i
        largest = load_real(matrix, n * j + pivot)
        if abs(largest) < SINGULAR or not np.isfinite(largest):
            return False
        for c in range(j, n):
            kept = load_real(matrix, n * c + j)
            store_real(matrix, n * c + j, load_real(matrix, n * c + pivot))
            store_real(matrix, n * c + pivot, kept)
        kept = load_real(right, j)
        store_real(right, j, load_real(right, pivot))
        store_real(right, pivot, kept)
        for i in range(j + 1, n):
            factor = load_real(matrix, n * j + i) / largest
            for c in range(j, n):
                store_real(matrix, n * c + i, load_real(matrix, n * c + i) - factor * load_real(matrix, n * c + j))
            store_real(right, i, load_real(right, i) - factor * load_real(right, j))
    for j in range(n - 1, -1, -1):
        value = load_real(right, j) / load_real(matrix, n * j + j)
        store_real(right, j, value)
        for i in range(j):
            store_real(right, i, load_real(right, i) - load_real(matrix, n * j + i) * value)
    return True


@numba.njit("boolean(intp, intp)", cache=True, nogil=True, error_model="numpy")
def _solve_loop(m, number):  # type: ignore[no-untyped-def]
    """Solve a loop of direct feed-through for the inputs in it, by Newton's method with differences.

    The unknowns x are the inputs; the residual is what the outputs, passed on, would make of them, less x.
    """
    loop = load_word(m, k.LOOPS) + 8 * k.LOOP_COLUMNS * number
    n, slots, x = load_word(loop, k.LOOP_COUNT), load_word(loop, k.LOOP_SIGNALS), load_word(loop, k.LOOP_WORK)
    residual, matrix = x + 8 * n, x + 16 * n
    signals = load_word(m, k.SIGNALS)
    for j in range(n):
        store_real(x, j, load_real(signals, load_word(slots, j)))
    for _ in range(LOOP_ITERATIONS):
        if not _loop_residual(m, loop, residual):
            return False
        solved = True
        for j in range(n):
            solved = solved and abs(load_real(residual, j)) <= LOOP_TOLERANCE * (1.0 + abs(load_real(x, j)))
        if solved:
            for j in range(n):
                store_real(signals, load_word(slots, j), load_real(x, j))
            return True
        for j in range(n):
            value = load_real(x, j)
            step = LOOP_DIFFERENCE * max(1.0, abs(value))
            store_real(x, j, value + step)
            if not _loop_residual(m, loop, matrix + 8 * n * j):
                return False
            store_real(x, j, value)
            for i in range(n):
                change = load_real(matrix, n * j + i) - load_real(residual, i)
                store_real(matrix, n * j + i, change / step)
        if not _solve(n, matrix, residual):
            break
        for j in range(n):
            store_real(x, j, load_real(x, j) - load_real(residual, j))
    return fail(m, k.LOOP, number, 0)


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _exchange(m, _number):  # type: ignore[no-untyped-def]
    """Pass the outputs on, group by group; a negative group is a loop to solve."""
    groups = load_word(m, k.GROUPS)
    for g in range(load_word(m, k.N_GROUPS)):
        first, last = load_word(groups, 2 * g), load_word(groups, 2 * g + 1)
        if first >= 0:
            if not _perform(m, first, last):
                return k.FAILED
        elif not _solve_loop(m, last):
            return k.FAILED
    return k.GO


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _settle(m, _number):  # type: ignore[no-untyped-def]
    """Pass the outputs on until no component with a stepper is left in event mode."""
    for _ in range(EVENT_ROUNDS):
        if _exchange(m, 0) != k.GO:
            return k.FAILED
        left = False
        for c in range(load_word(m, k.N_COMPONENTS)):
            if load_word(load_word(m, k.IN_EVENT), c) == k.IN_EVENTS and load_word(stepper_of(m, c), k.BLOCK):
                if not _step_on(m, c, k.LEAVE_EVENTS, load_real(m, k.NOW)):
                    return k.FAILED
                store_word(load_word(m, k.IN_EVENT), c, k.RUNNING)
                left = True
        if not left:
            break
    return k.GO


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _begin_stepper(m, component):  # type: ignore[no-untyped-def]
    done = _step_on(m, component, k.BEGIN, load_real(load_word(m, k.TIMES), 0))
    return k.GO if done else k.FAILED


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _advance_stepper(m, component):  # type: ignore[no-untyped-def]
    if load_word(load_word(m, k.IN_EVENT), component) == k.IN_EVENTS:
        if not _step_on(m, component, k.LEAVE_EVENTS, load_real(m, k.FROM)):
            return k.FAILED
        store_word(load_word(m, k.IN_EVENT), component, k.RUNNING)
    return k.GO if _step_on(m, component, k.ADVANCE, load_real(m, k.UNTIL)) else k.FAILED


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _tell_origin(m, _number):  # type: ignore[no-untyped-def]
    """Tell the steppers from when on the polynomials of the inputs count."""
    for c in range(load_word(m, k.N_COMPONENTS)):
        origin = load_word(stepper_of(m, c), k.ORIGIN)
        if origin:
            store_real(origin, 0, load_real(m, k.NOW))
    return k.GO


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _bend(m, sample):  # type: ignore[no-untyped-def]
    """Make straight inputs the cubic curves (Hermite) that have the slopes given at their ends, if these are given."""
    n, times = load_word(m, k.N_INPUTS), load_word(m, k.TIMES)
    length = load_real(times, sample + 1) - load_real(times, sample)
    for j in range(n):
        ends = load_word(m, k.INPUT_SLOPES) + 8 * (n * sample + j)
        first, last = load_real(ends, 0), load_real(ends, n)
        if np.isfinite(first):
            curve = load_word(load_word(m, k.CURVES), j)
            slope = load_real(curve, 1)
            store_real(curve, 1, first)
            store_real(curve, 2, (3.0 * slope - 2.0 * first - last) / length)
            store_real(curve, 3, (first + last - 2.0 * slope) / (length * length))
    return k.GO


@numba.njit(_HOOK, cache=True, nogil=True, error_model="numpy")
def _chords(m, _number):  # type: ignore[no-untyped-def]
    """Give curved inputs, where an FMU interpolates them, the slope of the chord over the coming step."""
    after, h = load_real(m, k.AFTER), load_real(m, k.LENGTH)
    for j in range(load_word(m, k.N_INPUTS)):
        if load_word(load_word(m, k.INPUT_MODES), j) == k.BY_DERIVATIVE:
            curve = load_word(load_word(m, k.CURVES), j)
            change = polynomial(curve, after + h) - polynomial(curve, after)
            store_real(load_word(m, k.SIGNALS), load_word(load_word(m, k.DERIVATIVE_SIGNALS), j), change / h)
    return k.GO


HOOKS: dict[int, int] = {
    field: numba.cfunc(_HOOK, cache=True, error_model="numpy")(function.py_func).address
    for field, function in {
        k.BEFORE_SETTING: _before_setting,
        k.SETTLE: _settle,
        k.EXCHANGE: _exchange,
        k.BEGIN_STEPPER: _begin_stepper,
        k.ADVANCE_STEPPER: _advance_stepper,
        k.TELL_ORIGIN: _tell_origin,
        k.BEND: _bend,
        k.CHORDS: _chords,
    }.items()
}
"""Field of the memory -> address of the hook that belongs there."""
