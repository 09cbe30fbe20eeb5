"""Sensitivities of a model-exchange FMU's states to parameters, integrated with them (1.26).

The integrated vector is [x, s_1, ..., s_N], s_j = dx/dp_j, with s_j' = (dg/dx) s_j + dg/dp_j. The right-hand sides are
directional derivatives that the FMU gives, or differences to *twins*: instances with p_j + d_j, put beside the model at
x + d_j s_j. Twins are also taken through the model's events. At a state event the time of the event depends on p_j too:
dt_j/dp_j = -(dz/dx s_j + dz/dp_j)/(dz/dt), and with it s_j jumps (E. N. Rozenvasser, Autom. Remote Control 28 (1967)
52).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from fmuid.fmi import block as b
from fmuid.fmi.block import array_call, compiled, copy, fail, put, real
from fmuid.fmi.events import complete_step, to_continuous_time_mode, to_event_mode
from fmuid.fmi.layout import Sensitivities
from fmuid.fmi.native import load_real, load_word, native_call, store_real, store_word

SAME = 1e-9  # a change of derivatives that is less, relatively or over a step and a state's nominal value, is none
PROBE = 2.0**-17  # of a step: how far on either side of an event the rate of its indicator is found
# Events of parameters that differ a little are this close: a share of the step, and of the time.
NEAR, NEARLY = 0.1, 1e-6
NUDGES = 20  # doublings of a rounding of time that bring a twin across a threshold

# The words of the memory of sensitivities.
FIELDS = 14
(
    COUNT,
    TWINS,
    STEPS,
    INITIAL,
    KNOWNS,  # of each parameter: the states' references and its own
    SEEDS,
    X_BEFORE,
    SLOPES_BEFORE,
    SLOPES_AFTER,
    SHIFTS,  # of the time of an event
    X_WORK,
    Z_EVENT,
    Z_EARLY,
    Z_LATE,
) = range(FIELDS)

_call_directional2 = native_call(*[types.intp] * 7)
_call_directional3 = native_call(*[types.intp] * 9)
_HOOK = "int32(intp, float64, intp)"


@compiled("intp(intp, intp)")
def _field(c, field):  # type: ignore[no-untyped-def]
    return load_word(load_word(c, b.SENSITIVITIES), field)


# --- directional derivatives


@compiled("int32(intp, intp, intp, intp, intp, intp)")
def _directional(c, j, x, unknowns, count, values):  # type: ignore[no-untyped-def]
    """Find the derivatives of unknowns along (s_j, dp_j = 1), where the FMU is."""
    n, seeds, function = (
        load_word(c, b.N_STATES),
        _field(c, SEEDS),
        load_word(c, b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE),
    )
    handle, knowns = load_word(c, b.HANDLE), _field(c, KNOWNS) + 4 * (n + 1) * j
    copy(x + 8 * n * (j + 1), seeds, n)
    store_real(seeds, n, 1.0)
    status = b.ERROR_STATUS
    if function and load_word(c, b.VERSION) == 2:
        status = _call_directional2(function, (handle, unknowns, count, knowns, n + 1, seeds, values))
    elif function:
        status = _call_directional3(function, (handle, unknowns, count, knowns, n + 1, seeds, n + 1, values, count))
    return fail(c, b.DIRECTIONAL_DERIVATIVE, status) if status > b.WARNING else b.OK


@numba.cfunc("int32(intp, float64, intp, intp)", cache=True, error_model="numpy")
def _extend(c, _t, x, dx):  # type: ignore[no-untyped-def]
    n, unknowns = load_word(c, b.N_STATES), load_word(c, b.DERIVATIVE_REFERENCES)
    for j in range(_field(c, COUNT) if n else 0):
        if _directional(c, j, x, unknowns, n, dx + 8 * n * (j + 1)) != b.OK:
            return b.FAILED
    return b.OK


@numba.cfunc("int32(intp, intp, intp, intp)", cache=True, error_model="numpy")
def _outputs(c, unknowns, count, values):  # type: ignore[no-untyped-def]
    """Find the sensitivities of outputs (N, count) where the FMU is, like a getter that has the block as instance."""
    x = load_word(c, b.X_END)
    if real(c, b.TIME) < real(c, b.STEP_END):
        x = load_word(c, b.X_AT)
    for j in range(_field(c, COUNT)):
        if _directional(c, j, x, unknowns, count, values + 8 * count * j) != b.OK:
            return b.ERROR_STATUS
    return b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _before(c, _t, x):  # type: ignore[no-untyped-def]
    copy(x, _field(c, X_BEFORE), load_word(c, b.N_STATES))
    return array_call(c, b.GET_DERIVATIVES, _field(c, SLOPES_BEFORE)) if load_word(c, b.INSIDE) else b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _after(c, _t, x):  # type: ignore[no-untyped-def]
    """Begin with the given sensitivities; fail after an event that they may not go through unchanged."""
    n, old, new = load_word(c, b.N_STATES), _field(c, SLOPES_BEFORE), _field(c, SLOPES_AFTER)
    if load_word(c, b.STARTING):
        copy(_field(c, INITIAL), x + 8 * n, n * _field(c, COUNT))
        return b.OK
    for i in range(n):
        if load_real(x, i) != load_real(_field(c, X_BEFORE), i):
            return fail(c, b.JUMP_UNKNOWN, 0)
    if load_word(c, b.INSIDE) == 0:
        return b.OK
    if array_call(c, b.GET_DERIVATIVES, new) != b.OK:
        return b.FAILED
    for i in range(n):
        one, other = load_real(old, i), load_real(new, i)
        nominal = load_real(load_word(c, b.ABSOLUTE), i) / real(c, b.TOLERANCE)
        if abs(one - other) * real(c, b.STEP_LENGTH) > SAME * (
            (abs(one) + abs(other)) * real(c, b.STEP_LENGTH) + nominal
        ):
            return fail(c, b.JUMP_UNKNOWN, 0)
    return b.OK


# --- twins


@compiled("intp(intp, intp)")
def _twin(c, j):  # type: ignore[no-untyped-def]
    return load_word(_field(c, TWINS), j)


@compiled("int32(intp, intp, int32)")
def _heed(c, w, code):  # type: ignore[no-untyped-def]
    """Make a twin's failure that of the model."""
    if code != b.OK:
        fail(c, load_word(w, b.FAILED_FUNCTION), load_word(w, b.FAILED_STATUS))
    return code


@compiled("int32(intp, intp, float64, intp, float64)")
def _place(c, j, t, x, shift):  # type: ignore[no-untyped-def]
    """Put a twin at time t where its states are: x + d_j s_j, and further along the slopes before an event."""
    n, w, sensitivities = load_word(c, b.N_STATES), _twin(c, j), x + 8 * load_word(c, b.N_STATES) * (j + 1)
    y, step = load_word(w, b.X_START), load_real(_field(c, STEPS), j)
    for i in range(n):
        store_real(y, i, load_real(x, i) + step * load_real(sensitivities, i))
    if shift != 0.0:
        for i in range(n):
            store_real(y, i, load_real(y, i) + shift * load_real(_field(c, SLOPES_BEFORE), i))
    return _heed(c, w, put(w, t, y))


@numba.cfunc("int32(intp, float64, intp, intp)", cache=True, error_model="numpy")
def _extend_twins(c, t, x, dx):  # type: ignore[no-untyped-def]
    n = load_word(c, b.N_STATES)
    for j in range(_field(c, COUNT)):
        w, slopes, step = _twin(c, j), dx + 8 * n * (j + 1), load_real(_field(c, STEPS), j)
        code = _place(c, j, t, x, 0.0)
        if code == b.OK:
            code = _heed(c, w, array_call(w, b.GET_DERIVATIVES, slopes))
        if code != b.OK:
            return code
        for i in range(n):
            store_real(slopes, i, (load_real(slopes, i) - load_real(dx, i)) / step)
    return b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _follow(c, t, x):  # type: ignore[no-untyped-def]
    for j in range(_field(c, COUNT)):
        if _place(c, j, t, x, 0.0) != b.OK:
            return b.FAILED
    return b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _complete(c, t, x):  # type: ignore[no-untyped-def]
    for j in range(_field(c, COUNT)):
        if _place(c, j, t, x, 0.0) != b.OK or _heed(c, _twin(c, j), complete_step(_twin(c, j))) != b.OK:
            return b.FAILED
    return b.OK


@compiled("intp(intp)")
def _crossing(c):  # type: ignore[no-untyped-def]
    """Return which indicator crossed zero in the step that ends with the event; -1 if none did."""
    for i in range(load_word(c, b.N_INDICATORS)):
        if (load_real(load_word(c, b.Z_START), i) > 0.0) != (load_real(load_word(c, b.Z_END), i) > 0.0):
            return i
    return -1


@compiled("int32(intp, float64, float64, intp, intp)")
def _indicators(c, t, shift, x, z):  # type: ignore[no-untyped-def]
    """Find the model's indicators a time after t, the states going on along their slopes."""
    y = _field(c, X_WORK)
    for i in range(load_word(c, b.N_STATES)):
        store_real(y, i, load_real(x, i) + shift * load_real(_field(c, SLOPES_BEFORE), i))
    code = put(c, t + shift, y)
    return array_call(c, b.GET_INDICATORS, z) if code == b.OK else code


@compiled("float64(intp, float64, intp, intp)")
def _rate(c, t, x, k):  # type: ignore[no-untyped-def]
    """Return the time derivative of indicator k at the event, zero after a failure; the model is left at t, Z_EVENT."""
    late = (t + PROBE * real(c, b.STEP_LENGTH)) - t
    if late == 0.0:
        return 0.0
    done = _indicators(c, t, late, x, _field(c, Z_LATE)) == b.OK
    done = done and _indicators(c, t, -late, x, _field(c, Z_EARLY)) == b.OK
    done = done and _indicators(c, t, 0.0, x, _field(c, Z_EVENT)) == b.OK
    store_word(c, b.HOLDS, 1)
    if not done:
        return 0.0
    return (load_real(_field(c, Z_LATE), k) - load_real(_field(c, Z_EARLY), k)) / (2.0 * late)


@compiled("boolean(intp, intp)")
def _sides_differ(c, z):  # type: ignore[no-untyped-def]
    for i in range(load_word(c, b.N_INDICATORS)):
        if (load_real(z, i) > 0.0) != (load_real(load_word(c, b.Z_END), i) > 0.0):
            return True
    return False


@compiled("boolean(intp, float64, float64)")
def _is_near(c, shift, t):  # type: ignore[no-untyped-def]
    """Return whether two events may be the same one; not so if the shift is not a number."""
    return abs(shift) <= NEAR * real(c, b.STEP_LENGTH) + NEARLY * abs(t)


@compiled("int32(intp, intp, float64, intp, intp, float64)")
def _cross(c, j, t, x, k, rate):  # type: ignore[no-untyped-def]
    """Put a twin just after its own crossing of indicator k; note by how much that is later."""
    w, z = _twin(c, j), _field(c, Z_LATE)
    if _place(c, j, t, x, 0.0) != b.OK or _heed(c, w, array_call(w, b.GET_INDICATORS, z)) != b.OK:
        return b.FAILED
    shift = (load_real(_field(c, Z_EVENT), k) - load_real(z, k)) / rate
    nudge = 2.0**-52 * abs(t)
    for _ in range(NUDGES):
        if not _is_near(c, shift, t):
            break
        shift = (t + shift) - t
        if _place(c, j, t + shift, x, shift) != b.OK or _heed(c, w, array_call(w, b.GET_INDICATORS, z)) != b.OK:
            return b.FAILED
        if not _sides_differ(c, z):
            store_real(_field(c, SHIFTS), j, shift)
            return b.OK
        shift += nudge
        nudge *= 2.0
    return fail(c, b.JUMP_REFUSED, 0)


@compiled("int32(intp, float64, intp)")
def _go_through(c, t, x):  # type: ignore[no-untyped-def]
    """Take all twins through their own events, each at its own time."""
    k, by_time, rate = _crossing(c), real(c, b.NEXT_EVENT) <= t, 1.0
    if array_call(c, b.GET_DERIVATIVES, _field(c, SLOPES_BEFORE)) != b.OK:
        return b.FAILED
    if k >= 0:
        rate = _rate(c, t, x, k)
    if rate == 0.0 or (k >= 0 and by_time):
        return fail(c, b.JUMP_REFUSED, 0)
    for j in range(_field(c, COUNT)):
        w, shift = _twin(c, j), 0.0
        if k >= 0:
            if _cross(c, j, t, x, k, rate) != b.OK:
                return b.FAILED
            shift = load_real(_field(c, SHIFTS), j)
        else:
            if by_time:
                shift = real(w, b.NEXT_EVENT) - t
            if not _is_near(c, shift, t):
                return fail(c, b.JUMP_REFUSED, 0)
            if _place(c, j, t + shift, x, shift) != b.OK:
                return b.FAILED
            store_real(_field(c, SHIFTS), j, shift)
        done = complete_step(w) == b.OK and to_event_mode(w) == b.OK
        if not done or to_continuous_time_mode(w, t + shift) != b.OK:
            return _heed(c, w, b.FAILED)
    return b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _before_twins(c, t, x):  # type: ignore[no-untyped-def]
    copy(x, _field(c, X_BEFORE), load_word(c, b.N_STATES))
    for j in range(_field(c, COUNT)):
        store_real(_field(c, SHIFTS), j, 0.0)
    return _go_through(c, t, x) if load_word(c, b.INSIDE) else b.OK


@numba.cfunc(_HOOK, cache=True, error_model="numpy")
def _after_twins(c, _t, x):  # type: ignore[no-untyped-def]
    """Find the sensitivities after an event, or at the beginning, from where the twins have come out of it."""
    n, old, new = load_word(c, b.N_STATES), _field(c, SLOPES_BEFORE), _field(c, SLOPES_AFTER)
    starting, inside = load_word(c, b.STARTING), load_word(c, b.INSIDE)
    if inside and array_call(c, b.GET_DERIVATIVES, new) != b.OK:
        return b.FAILED
    for j in range(_field(c, COUNT)):
        w, step, shift = _twin(c, j), load_real(_field(c, STEPS), j), load_real(_field(c, SHIFTS), j)
        put_there, found, s = load_word(w, b.X_START), load_word(w, b.X_END), x + 8 * n * (j + 1)
        for i in range(n):
            kept = load_real(x, i) == load_real(_field(c, X_BEFORE), i)
            kept = kept and load_real(found, i) == load_real(put_there, i)
            drift = shift * load_real(new, i) if inside else 0.0
            if kept and not starting:  # free of the rounding of a difference
                if inside:
                    store_real(s, i, load_real(s, i) + (shift * load_real(old, i) - drift) / step)
            else:
                store_real(s, i, (load_real(found, i) - drift - load_real(x, i)) / step)
    return b.OK


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def _twin_enters(w, _t):  # type: ignore[no-untyped-def]
    """Go into Event Mode with the model, which has put the twin at its place."""
    return b.OK if load_word(w, b.MODE) == b.EVENT_MODE else to_event_mode(w)


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def _twin_leaves(w, t):  # type: ignore[no-untyped-def]
    return to_continuous_time_mode(w, t)


@numba.cfunc("int32(intp, float64)", cache=True, error_model="numpy")
def _twin_follows(_w, _t):  # type: ignore[no-untyped-def]
    return b.OK


TWIN_FUNCTIONS: tuple[int, ...] = tuple(each.address for each in (_twin_enters, _twin_leaves, _twin_follows))
"""Addresses of what stands for enter_events, leave_events and advance of a twin; it begins like any other."""
OUTPUTS: int = _outputs.address
"""Address of the getter (block, references, count, values) of the outputs' sensitivities by directional derivatives."""


class SensitivityMemory:
    """What the compiled functions need to integrate sensitivities with a model's states.

    Parameters
    ----------
    words : array of intp
        The model's block: the hooks are written there.
    given : Sensitivities
    state_references : (n_states,) array of uint32
    twins : sequence of int
        Addresses of the twins' blocks, none where the FMU gives directional derivatives.
    """

    def __init__(
        self, words: NDArray[np.intp], given: Sensitivities, state_references: NDArray[np.uint32], twins: Sequence[int]
    ) -> None:
        n, n_indicators, count = int(words[b.N_STATES]), int(words[b.N_INDICATORS]), len(given.magnitudes)
        knowns = np.zeros((count, n + 1), np.uint32)
        if not twins:
            knowns[:, :n], knowns[:, n] = state_references, given.references
        arrays: dict[int, NDArray[Any]] = {
            TWINS: np.array(twins, np.intp),
            STEPS: given.steps,
            INITIAL: given.initial,
            KNOWNS: knowns,
            SEEDS: np.zeros(n + 1),
            SHIFTS: np.zeros(count),
        }
        arrays |= {field: np.zeros(n) for field in (X_BEFORE, SLOPES_BEFORE, SLOPES_AFTER, X_WORK)}
        arrays |= {field: np.zeros(n_indicators) for field in (Z_EVENT, Z_EARLY, Z_LATE)}
        self._memory = np.zeros(FIELDS, np.intp)
        self._memory[COUNT] = count
        for field, array in arrays.items():
            self._memory[field] = array.ctypes.data
        self._owned = arrays
        words[b.SENSITIVITIES] = self._memory.ctypes.data
        if twins:
            words[[b.EXTEND, b.FOLLOW, b.COMPLETE]] = _extend_twins.address, _follow.address, _complete.address
            words[[b.BEFORE_EVENT, b.AFTER_EVENT]] = _before_twins.address, _after_twins.address
        else:
            words[b.EXTEND] = _extend.address
            words[[b.BEFORE_EVENT, b.AFTER_EVENT]] = _before.address, _after.address
