"""Runge–Kutta steps of a model-exchange FMU: the classical method, and Dormand and Prince's with step-size control.

Both are tables of one compiled loop. The last stage of each stands at the end of the step (of the classical method it
is an extra one), so that it is the first stage of the next step, and the FMU is left where the step ends.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fmuid.fmi import block as b
from fmuid.fmi.block import array_call, compiled, copy, fail, real, right_hand_side, set_real
from fmuid.fmi.native import load_real, load_word, store_real, store_word

EPSILON = 2.0**-52
SAFETY, SHRINK, GROW, PI_EXPONENT = 0.9, 0.2, 10.0, 0.04  # step-size control of Hairer's DOPRI5
STIFF_EVERY, STIFF_AFTER, STIFF_BOUND = 1000, 15, 3.25  # its test of stiffness: steps, hits, |h lambda|


class Tableau:
    """Nodes and weights of an explicit method whose last stage stands at the end of the step.

    Attributes
    ----------
    nodes : (s,) array
    weights : (s + 2, s) array
        Those of the stages, of the error estimate and of the dense output's term of fourth order.
    """

    def __init__(self, nodes: list[float], rows: list[list[float]], error: list[float], dense: list[float]) -> None:
        self.nodes: NDArray[np.float64] = np.array(nodes)
        self.weights: NDArray[np.float64] = np.zeros((len(nodes) + 2, len(nodes)))
        for target, row in zip(self.weights, [[], *rows, error, dense], strict=True):
            target[: len(row)] = row


CLASSICAL = Tableau([0, 1 / 2, 1 / 2, 1, 1], [[1 / 2], [0, 1 / 2], [0, 0, 1], [1 / 6, 1 / 3, 1 / 3, 1 / 6]], [], [])
# J. R. Dormand, P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19; the dense output: E. Hairer, S. P. Norsett,
# G. Wanner, Solving Ordinary Differential Equations I (1993), section II.6 and the code DOPRI5.
DORMAND_PRINCE = Tableau(
    [0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1],
    [
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ],
    [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
    [
        -12715105075 / 11282082432,
        0,
        87487479700 / 32700410799,
        -10690763975 / 1880347072,
        701980252875 / 199316789632,
        -1453857185 / 822651844,
        69997945 / 29380423,
    ],
)


@compiled("void(intp, float64, intp, intp)")
def _add(y, weight, slopes, count):  # type: ignore[no-untyped-def]
    """Add weighted slopes to y."""
    for i in range(count):
        store_real(y, i, load_real(y, i) + weight * load_real(slopes, i))


@compiled("void(intp, intp, float64, intp)")
def _combine(c, row, h, y):  # type: ignore[no-untyped-def]
    """Add h times the sum of the slopes with a row of weights to y."""
    s, n = load_word(c, b.N_STAGES), load_word(c, b.N_TOTAL)
    weights, slopes = load_word(c, b.WEIGHTS) + 8 * row * s, load_word(c, b.SLOPES)
    for q in range(min(row, s)):
        weight = h * load_real(weights, q)
        if weight != 0.0:
            _add(y, weight, slopes + 8 * q * n, n)


@compiled("int32(intp, float64, float64, float64)")
def _stages(c, begin, end, h):  # type: ignore[no-untyped-def]
    """All stages but the first; the last leaves X_END, and the FMU there."""
    n, s, x = load_word(c, b.N_TOTAL), load_word(c, b.N_STAGES), load_word(c, b.X_START)
    slopes = load_word(c, b.SLOPES)
    for r in range(1, s):
        y = load_word(c, b.X_END if r == s - 1 else b.X_STAGE)
        copy(x, y, n)
        _combine(c, r, h, y)
        node = load_real(load_word(c, b.NODES), r)
        code = right_hand_side(c, end if node == 1.0 else begin + node * h, y, slopes + 8 * r * n)
        if code != b.OK:
            return code
    return b.OK


@compiled("float64(intp, intp, intp)")
def _norm(c, values, other):  # type: ignore[no-untyped-def]
    """Return the root of the mean square of values, each measured by its tolerance at X_START (and at `other`)."""
    n, x, absolute = load_word(c, b.N_TOTAL), load_word(c, b.X_START), load_word(c, b.ABSOLUTE)
    total = 0.0
    for i in range(n):
        size = max(abs(load_real(x, i)), abs(load_real(other, i)))
        total += (load_real(values, i) / (load_real(absolute, i) + real(c, b.TOLERANCE) * size)) ** 2
    return math.sqrt(total / n)


@compiled("float64(intp, float64, float64)")
def _first_step(c, begin, gap):  # type: ignore[no-untyped-def]
    """Return the first step length to try (Hairer, Norsett, Wanner, section II.4), a negative one after a failure."""
    n, x, y, slopes = load_word(c, b.N_TOTAL), load_word(c, b.X_START), load_word(c, b.X_STAGE), load_word(c, b.SLOPES)
    size, speed = _norm(c, x, x), _norm(c, slopes, x)
    h = 1e-6 if size < 1e-5 or speed < 1e-5 else 0.01 * size / speed
    h = min(h, gap, real(c, b.LARGEST_STEP))
    for i in range(n):
        store_real(y, i, load_real(x, i) + h * load_real(slopes, i))
    code = right_hand_side(c, begin + h, y, slopes + 8 * n)
    if code != b.OK:
        return h if code == b.REJECT else -1.0
    for i in range(n):
        store_real(y, i, load_real(slopes, n + i) - load_real(slopes, i))
    fastest = max(speed, _norm(c, y, x) / h)
    longest = max(1e-6, 1e-3 * h) if fastest <= 1e-15 else (0.01 / fastest) ** 0.2
    return min(100.0 * h, longest)


@compiled("float64(intp, float64, boolean, boolean)")
def _judge(c, h, clipped, again):  # type: ignore[no-untyped-def]
    """Return the length of the next step: PI control (Hairer, Wanner, volume II, section IV.2)."""
    y = load_word(c, b.X_AT)
    for i in range(load_word(c, b.N_TOTAL)):
        store_real(y, i, 0.0)
    _combine(c, load_word(c, b.N_STAGES), h, y)
    error = _norm(c, y, load_word(c, b.X_END))
    set_real(c, b.ERROR, error)
    raw = error ** (0.2 - 0.75 * PI_EXPONENT)
    if not error <= 1.0:  # also not a number
        return h * max(SHRINK, SAFETY / raw) if error > 1.0 else h * SHRINK
    factor = min(GROW, max(SHRINK, SAFETY * real(c, b.OLD_ERROR) ** PI_EXPONENT / raw)) if raw > 0.0 else GROW
    set_real(c, b.OLD_ERROR, max(error, 1e-4))
    if again:
        factor = min(factor, 1.0)
    if clipped and factor == GROW:  # a short step towards a given time says nothing against the length before
        return max(real(c, b.H), GROW * h)
    return factor * h


@compiled("void(intp)")
def _blame(c):  # type: ignore[no-untyped-def]
    """Note the state whose error is the largest."""
    errors, x, absolute = load_word(c, b.X_AT), load_word(c, b.X_END), load_word(c, b.ABSOLUTE)
    worst = -1.0
    for i in range(load_word(c, b.N_TOTAL)):
        scale = load_real(absolute, i) + real(c, b.TOLERANCE) * abs(load_real(x, i))
        error = abs(load_real(errors, i)) / scale
        if not error <= worst:  # also not a number
            worst = error
            store_word(c, b.BAD_STATE, i)


@compiled("boolean(intp, float64)")
def _is_stiff(c, h):  # type: ignore[no-untyped-def]
    """Return whether stability, not accuracy, has bounded the steps for long (Hairer, Wanner, section IV.2)."""
    n, total, slopes = load_word(c, b.N_STATES), load_word(c, b.N_TOTAL), load_word(c, b.SLOPES)
    taken = load_word(c, b.STEPS) - load_word(c, b.STEPS_BEFORE)  # few steps from sample to sample are no complaint
    if taken % STIFF_EVERY != 0 and load_word(c, b.STIFF_HITS) == 0:
        return False
    above, below = 0.0, 0.0
    for i in range(n):
        above += (load_real(slopes, 6 * total + i) - load_real(slopes, 5 * total + i)) ** 2
        below += (load_real(load_word(c, b.X_END), i) - load_real(load_word(c, b.X_STAGE), i)) ** 2
    if below > 0.0 and h * math.sqrt(above / below) > STIFF_BOUND:
        store_word(c, b.STIFF_MISSES, 0)
        store_word(c, b.STIFF_HITS, load_word(c, b.STIFF_HITS) + 1)
    else:
        store_word(c, b.STIFF_MISSES, load_word(c, b.STIFF_MISSES) + 1)
        if load_word(c, b.STIFF_MISSES) == 6:
            store_word(c, b.STIFF_HITS, 0)
    return load_word(c, b.STIFF_HITS) >= STIFF_AFTER


@compiled("float64(intp, float64, float64)")
def _length(c, begin, gap):  # type: ignore[no-untyped-def]
    """Return the length of the step to try, the gap to the bound at most."""
    largest = real(c, b.LARGEST_STEP)
    if load_word(c, b.INTEGRATOR) == b.RK4:
        h = gap / max(1.0, math.ceil(gap / largest * (1.0 - 1e-3)))
        return min(h, real(c, b.H)) if real(c, b.H) > 0.0 else h
    if real(c, b.H) == 0.0:
        set_real(c, b.H, _first_step(c, begin, gap))
    h = min(real(c, b.H), largest)  # negative after a failure
    return gap if 1.01 * h >= gap and gap <= 1.001 * largest else h


@compiled("int32(intp, float64, float64, float64)")
def _accept(c, begin, end, h):  # type: ignore[no-untyped-def]
    """Make the attempt the current step; prepare its dense output."""
    n, s = load_word(c, b.N_TOTAL), load_word(c, b.N_STAGES)
    dense = load_word(c, b.DENSE)
    for i in range(n):
        store_real(dense, i, 0.0)
        store_real(dense, n + i, load_real(load_word(c, b.X_END), i))
    _combine(c, s + 1, 1.0, dense)
    set_real(c, b.STEP_START, begin)
    set_real(c, b.STEP_END, end)
    set_real(c, b.STEP_LENGTH, h)
    store_word(c, b.FRESH, 1)
    store_word(c, b.HOLDS, 1)
    return b.OK


@compiled("int32(intp, float64)")
def runge_kutta_step(c, bound):  # type: ignore[no-untyped-def]
    """One accepted step from the current time towards `bound`, event indicators at its end included."""
    n, s, slopes = load_word(c, b.N_TOTAL), load_word(c, b.N_STAGES), load_word(c, b.SLOPES)
    begin = real(c, b.STEP_END)
    copy(load_word(c, b.X_END), load_word(c, b.X_START), n)
    if load_word(c, b.FRESH):
        copy(slopes + 8 * (s - 1) * n, slopes, n)
    elif right_hand_side(c, begin, load_word(c, b.X_START), slopes) != b.OK:
        return b.FAILED
    gap, rk4 = bound - begin, load_word(c, b.INTEGRATOR) == b.RK4
    h = _length(c, begin, gap)
    if h < 0.0:
        return b.FAILED
    smallest, again = 4.0 * EPSILON * (abs(begin) + h), False
    while True:
        end = bound if h >= gap else begin + h
        following = 2.0 * real(c, b.H)  # of the classical method, after a halved step
        code = _stages(c, begin, end, h)
        if code == b.OK and not rk4:
            following = _judge(c, h, h < real(c, b.H), again)
            if not real(c, b.ERROR) <= 1.0:
                fail(c, b.STEP_TOO_SMALL, 0)
                code = b.REJECT
        if code == b.OK:
            code = array_call(c, b.GET_INDICATORS, load_word(c, b.Z_END))
        if code != b.REJECT:
            break
        h = 0.5 * h if rk4 or following >= h else following
        set_real(c, b.H, h)
        again = True
        if not h >= smallest:  # also not a number
            if load_word(c, b.FAILED_FUNCTION) == b.STEP_TOO_SMALL:
                _blame(c)
            return b.FAILED
    if code == b.FAILED:
        return b.FAILED
    set_real(c, b.H, following)
    if not rk4 and _is_stiff(c, h):
        return fail(c, b.STIFF, 0)
    return _accept(c, begin, end, h)


@compiled("void(intp, float64)")
def runge_kutta_interpolate(c, t):  # type: ignore[no-untyped-def]
    """Put the states at a time t within the step into X_AT.

    The cubic of the values and slopes at both ends; for Dormand and Prince's method with the term that makes it one of
    fourth order (Hairer, Norsett, Wanner, section II.6).
    """
    n, s, x, dense = load_word(c, b.N_TOTAL), load_word(c, b.N_STAGES), load_word(c, b.X_START), load_word(c, b.DENSE)
    first, last = load_word(c, b.SLOPES), load_word(c, b.SLOPES) + 8 * (s - 1) * n
    h = real(c, b.STEP_LENGTH)
    theta = (t - real(c, b.STEP_START)) / h
    rest = 1.0 - theta
    for i in range(n):
        rise = load_real(dense, n + i) - load_real(x, i)
        bend = h * load_real(first, i) - rise
        turn = rise - h * load_real(last, i) - bend
        inner = turn + rest * h * load_real(dense, i)
        store_real(load_word(c, b.X_AT), i, load_real(x, i) + theta * (rise + rest * (bend + theta * inner)))
