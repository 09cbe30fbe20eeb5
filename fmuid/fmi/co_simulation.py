"""Steps of co-simulation FMUs of FMI 3.0, compiled: events between steps, early returns (FMI 3.0.2, section 4).

The functions are called by `fmuid.fmi.kernels` through their addresses, each with the address of a block of memory and
a time, and return 0 or, after writing what failed into the block, 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
from numba import types

from fmuid.fmi.native import call_plain, load_int32, load_real, load_word, native_call, store_real, store_word

# Functions in the order of their addresses in the block; failures are reported by their places here.
FUNCTIONS = ("DoStep", "EnterEventMode", "UpdateDiscreteStates", "EnterStepMode")
DO_STEP, ENTER_EVENT_MODE, UPDATE_DISCRETE_STATES, ENTER_STEP_MODE, ENDED, STUCK, ENDLESS = range(7)

FIELDS = 12
HANDLE, FIRST_ADDRESS, EVENT_MODE, FAILED_FUNCTION, FAILED_STATUS, TIME, FLAGS = 0, 1, 5, 6, 7, 8, 9
# FLAGS are two words of eight one-byte booleans, and the last successful or next event time after them.

WARNING = 1
EVENT_ITERATIONS = 100
# Returns from one step before its end; an FMU that returns more often does not get on.
EARLY_RETURNS = 100_000

_call_do_step = native_call(
    types.intp, types.float64, types.float64, types.int32, types.intp, types.intp, types.intp, types.intp
)
_call_update = native_call(types.intp, types.intp, types.intp, types.intp, types.intp, types.intp, types.intp)
_SIGNATURE = "int32(intp, float64)"


@numba.njit("int32(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def _failed(block, function, status):  # type: ignore[no-untyped-def]
    store_word(block, FAILED_FUNCTION, function)
    store_word(block, FAILED_STATUS, status)
    return np.int32(1)


@numba.njit("int32(intp, intp)", cache=True, nogil=True, error_model="numpy")
def _plain(block, function):  # type: ignore[no-untyped-def]
    status = call_plain(load_word(block, FIRST_ADDRESS + function), (load_word(block, HANDLE),))
    return _failed(block, function, status) if status > WARNING else np.int32(0)


@numba.njit(_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def _leave_events(block, time):  # type: ignore[no-untyped-def]
    """Iterate the discrete states until they rest, and enter step mode."""
    store_real(block, TIME, time)
    if not load_word(block, EVENT_MODE):
        return np.int32(0)
    flags = block + 8 * FLAGS
    for _ in range(EVENT_ITERATIONS):
        store_word(flags, 0, 0)
        status = _call_update(
            load_word(block, FIRST_ADDRESS + UPDATE_DISCRETE_STATES),
            (load_word(block, HANDLE), flags, flags + 1, flags + 2, flags + 3, flags + 4, flags + 8),
        )
        if status > WARNING:
            return _failed(block, UPDATE_DISCRETE_STATES, status)
        if load_int32(flags, 0) & 0xFF00:
            return _failed(block, ENDED, 0)
        if load_int32(flags, 0) & 0xFF == 0:
            return _plain(block, ENTER_STEP_MODE)
    return _failed(block, ENDLESS, 0)


@numba.njit(_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def _enter_events(block, time):  # type: ignore[no-untyped-def]  # noqa: ARG001
    return _plain(block, ENTER_EVENT_MODE) if load_word(block, EVENT_MODE) else np.int32(0)


@numba.njit(_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def _advance(block, until):  # type: ignore[no-untyped-def]
    """Step to a time, through the events and early returns on the way."""
    flags = block + 8 * FLAGS
    for _ in range(EARLY_RETURNS):
        now = load_real(block, TIME)
        if not now < until:
            return np.int32(0)
        store_word(flags, 0, 0)
        store_real(flags, 1, until)
        status = _call_do_step(
            load_word(block, FIRST_ADDRESS + DO_STEP),
            (load_word(block, HANDLE), now, until - now, 1, flags, flags + 1, flags + 2, flags + 8),
        )
        if status > WARNING:
            return _failed(block, DO_STEP, status)
        told = load_int32(flags, 0)
        if told & 0xFF00:
            return _failed(block, ENDED, 0)
        reached = load_real(flags, 1) if told & 0xFF0000 else until
        store_real(block, TIME, reached)
        if told & 0xFF and load_word(block, EVENT_MODE):
            if _plain(block, ENTER_EVENT_MODE) or _leave_events(block, reached):
                return np.int32(1)
        elif reached <= now:
            break
    return _failed(block, STUCK, 0)


@numba.njit(_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def _begin(block, time):  # type: ignore[no-untyped-def]
    store_real(block, TIME, time)
    return np.int32(0)


_COMPILED = tuple(
    numba.cfunc(_SIGNATURE, cache=True)(function.py_func)
    for function in (_begin, _enter_events, _leave_events, _advance)
)


class CoSimulation3:
    """The stepper of one co-simulation instance of FMI 3.0.

    Parameters
    ----------
    handle : int
        The instance (fmi3Instance).
    address_of : callable
        Address of an FMI function by its name without prefix.
    event_mode : bool
        Whether the instance was told that event mode is used.

    Attributes
    ----------
    block : int
        Address of its memory.
    functions : tuple of int
        Addresses of begin, enter_events, leave_events and advance.
    failure : int
        Address of two words, what failed and its status.
    """

    def __init__(self, handle: int, address_of: Callable[[str], int], event_mode: bool) -> None:
        self._memory = np.zeros(FIELDS, np.intp)
        self._memory[HANDLE], self._memory[EVENT_MODE] = handle, event_mode
        used = FUNCTIONS if event_mode else FUNCTIONS[:1]
        self._memory[FIRST_ADDRESS : FIRST_ADDRESS + len(used)] = [address_of(name) for name in used]
        self.block: int = self._memory.ctypes.data
        self.failure = self.block + 8 * FAILED_FUNCTION
        self.origin = self.fresh = self.sensitivities = 0  # no inputs that vary within a step, nothing to restart
        self.coefficients = np.zeros((0, 4))
        self.functions: tuple[int, ...] = tuple(function.address for function in _COMPILED)

    def whereabouts(self) -> tuple[float, float]:
        """Return the time that was reached, s; steps are inside the FMU."""
        return float(self._memory.view(np.float64)[TIME]), np.nan

    def bad_state(self) -> str:
        """Return nothing: the states are inside the FMU."""
        return ""


def describe(code: int, status: str) -> str:
    """Return in words what failed.

    Parameters
    ----------
    code : int
        From the block.
    status : str
        The FMI status in words.
    """
    if code < len(FUNCTIONS):
        return f"fmi3{FUNCTIONS[code]} returned {status}"
    return {
        ENDED: "the FMU ended the simulation",
        STUCK: "fmi3DoStep returns early again and again without getting on",
        ENDLESS: f"the event iteration does not end: {EVENT_ITERATIONS} calls of fmi3UpdateDiscreteStates",
    }[code]
