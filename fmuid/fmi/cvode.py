"""Steps of a model-exchange FMU by CVODE (BDF, dense linear solver), without Python between the steps.

The libraries are those that FMPy carries (SUNDIALS 7). A. C. Hindmarsh et al., ACM Trans. Math. Softw. 31 (2005) 363.
"""

from __future__ import annotations

import ctypes
import weakref
from typing import Any

import numba
from numba import types

from fmuid.errors import InputError
from fmuid.fmi import block as b
from fmuid.fmi.block import array_call, compiled, copy, fail, put, real, right_hand_side, set_real
from fmuid.fmi.native import load_real, load_word, native_call, store_real, store_word

BDF, ONE_STEP = 2, 2  # CV_BDF, CV_ONE_STEP
STOPPED = 1  # CV_TSTOP_RETURN
NO_SETUP = -6  # CV_LSETUP_FAIL
INCREMENT = 2.0**-26  # of a state, relatively, for differences
NOTHING = -1  # the word FAILED_FUNCTION before a step

_call_step = native_call(types.intp, types.float64, types.intp, types.intp, types.int32)
_call_reinit = native_call(types.intp, types.float64, types.intp)
_call_number = native_call(types.intp, types.float64)
_call_dky = native_call(types.intp, types.float64, types.int32, types.intp)
_call_pointer = native_call(types.intp, types.intp)
_call_directional2 = native_call(*[types.intp] * 7)
_call_directional3 = native_call(*[types.intp] * 9)


@numba.cfunc("int32(float64, intp, intp, intp)", cache=True, error_model="numpy")
def _derivatives(t, y, dy, c):  # type: ignore[no-untyped-def]
    """CVRhsFn; a serial N_Vector points to its content, whose third word points to the numbers."""
    return right_hand_side(c, t, load_word(load_word(y, 0), 2), load_word(load_word(dy, 0), 2))


@compiled("int32(intp, intp)")
def _columns(c, entries):  # type: ignore[no-untyped-def]
    """Find the columns of the model's Jacobian by directional derivatives where the FMU is."""
    n, handle, function = load_word(c, b.N_STATES), load_word(c, b.HANDLE), b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE
    known, unknown, one = load_word(c, b.STATE_REFERENCES), load_word(c, b.DERIVATIVE_REFERENCES), load_word(c, b.DENSE)
    store_real(one, 0, 1.0)
    for j in range(n):
        column = entries + 8 * load_word(c, b.N_TOTAL) * j
        if load_word(c, b.VERSION) == 2:
            status = _call_directional2(load_word(c, function), (handle, unknown, n, known + 4 * j, 1, one, column))
        else:
            status = _call_directional3(
                load_word(c, function), (handle, unknown, n, known + 4 * j, 1, one, 1, column, n)
            )
        if status > b.ERROR_STATUS:
            return fail(c, b.DIRECTIONAL_DERIVATIVE, status)
        if status > b.WARNING:
            store_word(c, function, 0)
            return b.FAILED
    return b.OK


@compiled("int32(intp, float64, intp, intp)")
def _difference_columns(c, t, x, entries):  # type: ignore[no-untyped-def]
    """Find them by differences of the model's right-hand side, for a system with sensitivities."""
    n, y, base = load_word(c, b.N_STATES), load_word(c, b.DENSE), load_word(c, b.DENSE) + 8 * load_word(c, b.N_TOTAL)
    code = array_call(c, b.GET_DERIVATIVES, base)
    for j in range(n):
        column = entries + 8 * load_word(c, b.N_TOTAL) * j
        copy(x, y, n)
        nominal = load_real(load_word(c, b.ABSOLUTE), j) / real(c, b.TOLERANCE)
        store_real(y, j, load_real(x, j) + INCREMENT * max(abs(load_real(x, j)), nominal))
        step = load_real(y, j) - load_real(x, j)
        if code == b.OK:
            code = put(c, t, y)
        if code == b.OK:
            code = array_call(c, b.GET_DERIVATIVES, column)
        for i in range(n):
            store_real(column, i, (load_real(column, i) - load_real(base, i)) / step)
    return code


@numba.cfunc("int32(float64, intp, intp, intp, intp, intp, intp, intp)", cache=True, error_model="numpy")
def _jacobian(t, y, dy, matrix, c, work1, work2, work3):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """CVLsJacFn: one directional derivative a column; where the FMU fails to give one, none is asked for again.

    What is integrated with the states are their sensitivities, all with the same matrix: it is repeated along the
    diagonal, and what couples them to the states is left out, which Newton's iteration bears (T. Maly, L. R. Petzold,
    Appl. Numer. Math. 20 (1996) 57).
    """
    code = put(c, t, load_word(load_word(y, 0), 2))
    if code != b.OK:
        return code
    n, total, entries = load_word(c, b.N_STATES), load_word(c, b.N_TOTAL), load_word(load_word(matrix, 0), 2)
    if load_word(c, b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE):
        code = _columns(c, entries)
    else:
        code = _difference_columns(c, t, load_word(load_word(y, 0), 2), entries)
    for shift in range(n, total, n):
        for j in range(n):
            copy(entries + 8 * total * j, entries + 8 * (total * (shift + j) + shift), n)
    return code


@compiled("int32(intp)")
def _restart(c):  # type: ignore[no-untyped-def]
    """Let CVODE begin anew at the step's end; H is the first step length, 0 leaves it to CVODE."""
    memory = load_word(c, b.CVODE_MEMORY)
    flag = _call_reinit(load_word(c, b.CVODE_REINIT), (memory, real(c, b.STEP_END), load_word(c, b.CVODE_STATE)))
    if flag == 0:
        absolute = load_word(c, b.CVODE_ABSOLUTE)  # CVODE has a copy of its own
        flag = _call_reinit(load_word(c, b.CVODE_SET_TOLERANCES), (memory, real(c, b.TOLERANCE), absolute))
    if flag == 0:
        flag = _call_number(load_word(c, b.CVODE_SET_INIT_STEP), (memory, real(c, b.H)))
    set_real(c, b.H, 0.0)
    return fail(c, b.CVODE_FAILED, flag) if flag < 0 else b.OK


@compiled("int32(intp, float64)")
def _one_step(c, bound):  # type: ignore[no-untyped-def]
    """One internal step of CVODE; return its flag, negative if it failed (and then the failure is written down)."""
    memory, returned = load_word(c, b.CVODE_MEMORY), load_word(c, b.REALS) + 8 * b.RETURNED
    if not load_word(c, b.FRESH) and _restart(c) != b.OK:
        return b.FAILED
    store_word(c, b.FAILED_FUNCTION, NOTHING)
    flag = _call_number(load_word(c, b.CVODE_SET_STOP_TIME), (memory, bound))
    if flag == 0:
        state = load_word(c, b.CVODE_STATE)
        flag = _call_step(load_word(c, b.CVODE_STEP), (memory, bound, state, returned, ONE_STEP))
    if flag < 0 and load_word(c, b.FAILED_FUNCTION) == NOTHING:  # neither the FMU nor its numbers are why
        fail(c, b.CVODE_FAILED, flag)
    return flag


@compiled("int32(intp, float64)")
def cvode_step(c, bound):  # type: ignore[no-untyped-def]
    """One accepted step from the current time towards `bound`, event indicators at its end included."""
    memory, n, begin = load_word(c, b.CVODE_MEMORY), load_word(c, b.N_TOTAL), real(c, b.STEP_END)
    copy(load_word(c, b.X_END), load_word(c, b.X_START), n)
    while True:
        flag = _one_step(c, bound)
        if flag == NO_SETUP and load_word(c, b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE) == 0:
            # The first directional derivative failed: from here on CVODE takes differences.
            _call_pointer(load_word(c, b.CVODE_SET_JACOBIAN), (memory, 0))
            copy(load_word(c, b.X_START), load_word(c, b.X_END), n)
            store_word(c, b.FRESH, 0)
            flag = _one_step(c, bound)
        if flag < 0:
            return b.FAILED
        end = bound if flag == STOPPED else real(c, b.RETURNED)
        code = b.OK
        if load_word(c, b.N_INDICATORS):
            code = put(c, end, load_word(c, b.X_END))
            if code == b.OK:
                code = array_call(c, b.GET_INDICATORS, load_word(c, b.Z_END))
        if code != b.REJECT:
            break
        set_real(c, b.H, 0.5 * (end - begin))
        copy(load_word(c, b.X_START), load_word(c, b.X_END), n)
        store_word(c, b.FRESH, 0)
        if begin + real(c, b.H) == begin:
            return b.FAILED
    store_word(c, b.HOLDS, 1 if load_word(c, b.N_INDICATORS) else 0)
    store_word(c, b.FRESH, 1)
    set_real(c, b.STEP_START, begin)
    set_real(c, b.STEP_END, end)
    set_real(c, b.STEP_LENGTH, end - begin)
    return code


@compiled("int32(intp, float64)")
def cvode_interpolate(c, t):  # type: ignore[no-untyped-def]
    """Put the states at a time t within the step into X_AT."""
    flag = _call_dky(load_word(c, b.CVODE_GET_DKY), (load_word(c, b.CVODE_MEMORY), t, 0, load_word(c, b.CVODE_AT)))
    return fail(c, b.CVODE_FAILED, flag) if flag < 0 else b.OK


class Solver:
    """The memory of CVODE for one block, whose words it fills in; freed with the object.

    Parameters
    ----------
    words : sequence of int
        The block, its other words filled in.
    largest_step : float
        s; infinite for no bound.

    Raises
    ------
    InputError
        If there is no CVODE for this platform.
    """

    def __init__(self, words: Any, largest_step: float) -> None:
        libraries = _libraries()
        core, serial, cvode = libraries.sundials_core, libraries.sundials_nvecserial, libraries.sundials_cvode
        n, block = int(words[b.N_TOTAL]), ctypes.c_void_p(words.ctypes.data)
        pointer, size, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
        context = pointer()
        _do(core, "SUNContext_Create", ctypes.c_int(0), ctypes.byref(context))
        _do(core, "SUNContext_ClearErrHandlers", context)  # they would print; the flags say what is wrong
        data = [pointer(int(words[field])) for field in (b.X_END, b.X_AT, b.ABSOLUTE)]
        vectors = [_make(serial, "N_VMake_Serial", size(n), numbers, context) for numbers in data]
        matrix = _make(libraries.sundials_sunmatrixdense, "SUNDenseMatrix", size(n), size(n), context)
        linear = _make(libraries.sundials_sunlinsoldense, "SUNLinSol_Dense", vectors[0], matrix, context)
        memory = _make(cvode, "CVodeCreate", ctypes.c_int(BDF), context)
        _do(cvode, "CVodeInit", memory, pointer(_derivatives.address), number(0.0), vectors[0])
        _do(cvode, "CVodeSetUserData", memory, block)
        _do(cvode, "CVodeSVtolerances", memory, number(1e-6), vectors[2])
        _do(cvode, "CVodeSetLinearSolver", memory, linear, matrix)
        _do(cvode, "CVodeSetMaxHnilWarns", memory, ctypes.c_int(-1))
        if largest_step < float("inf"):
            _do(cvode, "CVodeSetMaxStep", memory, number(largest_step))
        if words[b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE] or words[b.N_TOTAL] > words[b.N_STATES]:
            _do(cvode, "CVodeSetJacFn", memory, pointer(_jacobian.address))
        self._finalizer = weakref.finalize(self, _free, libraries, memory, linear, matrix, vectors, context)
        for field, value in zip((b.CVODE_STATE, b.CVODE_AT, b.CVODE_ABSOLUTE), vectors, strict=True):
            words[field] = value.value
        words[b.CVODE_MEMORY] = memory.value
        for field, name in (
            (b.CVODE_STEP, "CVode"),
            (b.CVODE_REINIT, "CVodeReInit"),
            (b.CVODE_SET_TOLERANCES, "CVodeSVtolerances"),
            (b.CVODE_SET_STOP_TIME, "CVodeSetStopTime"),
            (b.CVODE_SET_INIT_STEP, "CVodeSetInitStep"),
            (b.CVODE_GET_DKY, "CVodeGetDky"),
            (b.CVODE_SET_JACOBIAN, "CVodeSetJacFn"),
        ):
            words[field] = ctypes.cast(cvode[name], pointer).value


def _libraries() -> Any:
    """Return FMPy's handles of the SUNDIALS libraries."""
    try:
        from fmpy.sundials import libraries
    except Exception as error:  # FMPy lets through what the loader raises: OSError, AttributeError, its own
        raise InputError(
            f'integrator = "cvode" has no library for this platform ({error}); '
            'choose integrator = "rk45", or "rk4" with a step_size'
        ) from error
    return libraries


def _make(library: Any, name: str, *arguments: Any) -> ctypes.c_void_p:
    """Return the pointer that a SUNDIALS constructor returns."""
    function = library[name]  # a handle of our own: FMPy declares arguments on those that are attributes
    function.restype = ctypes.c_void_p
    made = function(*arguments)
    if not made:
        raise MemoryError(f"{name} of SUNDIALS cannot allocate its memory")
    return ctypes.c_void_p(made)


def _do(library: Any, name: str, *arguments: Any) -> None:
    """Call a SUNDIALS function; it cannot fail but through a defect of this module."""
    flag = library[name](*arguments)
    if flag != 0:
        raise RuntimeError(f"{name} of SUNDIALS returned {flag}")


def _free(libraries: Any, memory: Any, linear: Any, matrix: Any, vectors: list[Any], context: Any) -> None:
    libraries.sundials_cvode["CVodeFree"](ctypes.byref(memory))
    core = libraries.sundials_core
    core["SUNLinSolFree"](linear)
    core["SUNMatDestroy"](matrix)
    for vector in vectors:
        core["N_VDestroy"](vector)
    core["SUNContext_Free"](ctypes.byref(context))
