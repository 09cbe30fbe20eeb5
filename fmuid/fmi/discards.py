"""Hook of the compiled master loop for co-simulation FMUs of FMI 2.0 that discard a step (FMI 2.0.4, section 4.2.2)."""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from fmuid.fmi import codes as k
from fmuid.fmi.kernels import address_of, fail
from fmuid.fmi.native import load_real, load_word, native_call, store_real, store_word

LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3  # fmi2StatusKind
# Steps are shortened down to this share of the communication step, and tried this often.
SHORTEST, TRIALS = 1e-9, 1000

_call_step = native_call(types.intp, types.float64, types.float64, types.int32)
_call_status = native_call(types.intp, types.int32, types.intp)


@numba.cfunc("int32(intp, intp)", cache=True, error_model="numpy")
def _after_discard(m, c):  # type: ignore[no-untyped-def]
    """Go on from the last successful time; in shorter steps where the FMU did not get on."""
    now, until = load_real(m, k.FROM), load_real(m, k.UNTIL)
    handle, scratch, whole = load_word(load_word(m, k.HANDLES), c), load_word(m, k.SCRATCH), until - now
    step = whole
    ask_time, ask_ended = address_of(m, c, k.GET_REAL_STATUS), address_of(m, c, k.GET_BOOLEAN_STATUS)
    for _ in range(TRIALS if ask_time and ask_ended else 0):
        store_word(scratch, 0, 0)
        if _call_status(ask_ended, (handle, TERMINATED, scratch)) <= k.WARNING and load_word(scratch, 0) & 0xFF:
            fail(m, k.ENDED, c, k.DISCARD)
            return k.FAILED
        store_real(scratch, 0, now)
        _call_status(ask_time, (handle, LAST_SUCCESSFUL_TIME, scratch))
        reached = load_real(scratch, 0)
        if not now <= reached <= until:
            break
        if reached == now:
            step *= 0.5
        now = reached
        if step < SHORTEST * whole:
            break
        status = np.int32(0)
        while now < until and status <= k.WARNING:
            length = min(step, until - now)
            status = _call_step(address_of(m, c, k.DO_STEP), (handle, now, length, 1))
            if status <= k.WARNING:
                now = until if length == until - now else now + length
        if status <= k.WARNING:
            return k.GO
        if status != k.DISCARD:
            fail(m, k.DO_STEP, c, status)
            return k.FAILED
    fail(m, k.DO_STEP, c, k.DISCARD)
    return k.FAILED


HOOKS: dict[int, int] = {k.AFTER_DISCARD: _after_discard.address}
"""Field of the memory -> address of the hook that belongs there."""
