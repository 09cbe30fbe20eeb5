"""A faulty machine in its windings: three phases, shorted turns, and a cage of 28 bars, under vector control.

Nothing here knows of Park's model or of the fault models. The natural equations (1.58) are written for windings i with
n_i turns (in shares of a phase's) around axes at electrical angles a_i:

    u_i = R_i i_i + dφ_i/dt,    air gap: L_ij = (2/3) L_g n_i n_j cos(a_i - a_j),    and leakage.

- A short circuit divides a phase into what is left, (1 - η) of its turns, and ηN turns that the contact closes on
  itself through `CONTACT`. Currents: i in the first, i - i_f in the second.
- The slot part of the leakage belongs to each of the `COILS` of a phase by itself: so the shorted turns, all in one
  coil, have more leakage than their share. The rest is common to all turns.
- The star point is isolated: i_a + i_b + i_c = 0, whatever its potential is.
- The cage is a mesh: loop k lies between the bars k and k + 1, all space harmonics of its field included, with
  resistance and leakage of bars and of ring segments. A broken bar makes the loops on either side of it one loop.

The constraints on the currents, i = G z, leave Gᵀ(u - R i - dφ/dt) = 0 (G. Kron). The drive is that of
experiments/induction_machine, here in continuous time; all is integrated together by Runge-Kutta 4.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from math import cos, pi, sin, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import linalg

from fmuid.array_types import Floats
from fmuid.data.signals import T23
from fmuid.simulation.native.build import FLAGS, WARNINGS, compiler_here

SOURCE = Path(__file__).with_suffix(".c")

POLE_PAIRS = 2
TURNS, BARS = 464, 28
TRUTH = {"Rs": 9.8, "Rr": 3.8, "Lm": 0.436, "Lf": 0.0762}
"""What the healthy machine is in Park axes with the leakage summed at the stator: resistances in ohm, H."""

STATOR_LEAKAGE = 0.04  # H; with that of the cage it makes Lf
SLOTS = 0.5  # share of it that belongs to the slots
COILS = 8  # of one phase, each of 58 turns
CONTACT = 1e-3  # ohm, where the turns touch
RINGS = 0.2  # share of the end rings in resistance and leakage of the cage


class Windings(NamedTuple):
    """The equations after constraints: currents of the two stator axes and of the shorted turns, modes of the cage."""

    inductance: Floats
    """Of the stator (3, 3), H."""
    resistance: Floats
    """Likewise, ohm."""
    axes: Floats
    """Turns of the stator along two fixed axes (3, 2)."""
    coupling: Floats
    """What links the stator's turns along axes linked to the rotor with the modes of the cage (2, BARS), sqrt(H)."""
    decay: Floats
    """Rates at which these modes die away by themselves (BARS,), 1/s."""


@dataclass(frozen=True)
class Condition:
    """What a machine is like: shorted turns of a phase (0 to 2), broken bars beside each other, and how warm it is."""

    turns: int = 0
    phase: int = 0
    bars: int = 0
    warmth: float = 1.0
    """Factor of all resistances of the windings."""


def windings(condition: Condition) -> Windings:
    """Return the matrices of a machine in a condition."""
    gap = TRUTH["Lf"] + TRUTH["Lm"] - STATOR_LEAKAGE
    return Windings(*_stator(condition, gap), *_modes(*_cage(condition, gap)))


def _stator(condition: Condition, gap: float) -> tuple[Floats, Floats, Floats]:
    ratio = condition.turns / TURNS
    order = [condition.phase, condition.phase, *(k for k in range(3) if k != condition.phase)]
    turns = np.array([1 - ratio, ratio, 1, 1])
    directions = T23.T[order]  # sqrt(2/3) (cos a, sin a) of each winding
    axes = turns[:, None] * directions
    leakage = (1 - SLOTS) * STATOR_LEAKAGE * np.outer(turns, turns) * np.kron(np.eye(2), np.ones((2, 2)))
    leakage[2:, 2:] = STATOR_LEAKAGE * np.eye(2)
    own = COILS * ratio**2  # of the shorted turns; the whole phase has 1
    leakage[:2, :2] += SLOTS * STATOR_LEAKAGE * np.array([[1 - 2 * ratio + own, ratio - own], [ratio - own, own]])
    free = np.column_stack([directions, [0, -1, 0, 0]])
    inductance = free.T @ (gap * axes @ axes.T + leakage) @ free
    resistance = condition.warmth * TRUTH["Rs"] * free.T @ np.diag(turns) @ free
    resistance[2, 2] += CONTACT
    if not condition.turns:
        inductance[2, 2] = 1.0  # no turns, no flux: whatever the inductance, no current
    return inductance, np.asarray(resistance, dtype=np.float64), free.T @ axes


def _cage(condition: Condition, gap: float) -> tuple[Floats, Floats, Floats]:
    """Return inductance (nr, nr), resistance (nr, nr) and mutual inductance (2, nr) of the loops that are left."""
    angles = 2 * pi * POLE_PAIRS / BARS * np.arange(BARS)
    loops = sqrt(2 / BARS) * np.array([np.cos(angles), np.sin(angles)])
    half = pi * POLE_PAIRS / BARS
    field = gap * (half / sin(half)) ** 2  # of a loop: its share in the fundamental is the gap's inductance
    neighbours = np.roll(np.eye(BARS), 1, axis=0)
    bar = (2 * np.eye(BARS) - neighbours - neighbours.T) / (2 - 2 * cos(2 * half))
    mesh = RINGS * np.eye(BARS) + (1 - RINGS) * bar  # 1 for the currents that the stator brings about
    # the equivalent with all leakage at the stator has Lm = gap²/whole and Rr = R (gap/whole)²
    whole = gap**2 / TRUTH["Lm"]
    inductance = field * (np.eye(BARS) - 1 / BARS) + (whole - field) * mesh
    resistance = condition.warmth * TRUTH["Rr"] * (whole / gap) ** 2 * mesh
    joined = np.eye(BARS)[:, condition.bars :].copy()
    joined[: condition.bars, 0] = 1.0
    return joined.T @ inductance @ joined, joined.T @ resistance @ joined, gap * loops @ joined


def _modes(inductance: Floats, resistance: Floats, mutual: Floats) -> tuple[Floats, Floats]:
    """Return coupling and decay of the modes: combinations of loops that have 1 H and no resistance in common."""
    decay, loops = linalg.eigh(resistance, inductance)
    missing = BARS - decay.size  # broken bars leave fewer loops: the others are coupled with nothing
    return np.pad(mutual @ loops, ((0, 0), (0, missing))), np.pad(decay, (0, missing))


def bar_angle(bars: int) -> float:
    """Return the electrical angle in [0, pi) along which broken bars hinder the rotor current, rad.

    Those of a condition lie between the loops 0 to `bars`; a bar carries what differs between its loops, which is most
    where the loops' current passes zero.
    """
    return (2 * pi * POLE_PAIRS / BARS * bars / 2 + pi / 2) % pi


# ---- the drive, experiments/induction_machine in continuous time

LOAD = 0.09  # N m s, generator: 7.1 N m at 750 rpm, full load
INERTIA = 0.02  # kg m²
RPM = 2 * pi / 60
SPEED, SPEED_STEP = 750 * RPM, 90 * RPM  # rad/s, mechanical
GAIN, INTEGRAL_TIME, SMOOTHING, TORQUE_MAX = 0.67, 0.12, 0.01, 14.0  # of the speed: N m s, s, s, N m
KNOWN_RS, KNOWN_RR, KNOWN_LM, KNOWN_LF = 9.5, 4.0, 0.44, 0.075  # what the control takes the machine for
FLUX, FLUX_GAIN, CURRENT_MAX, VOLTAGE_MAX = 1.15, 20.0, 6.0, 380.0  # Wb, A/Wb, A, V
CURRENT_TIME, MAGNETISING_TIME, INVERTER_TIME = 0.003, 0.01, 0.002  # s
FLUXES = 3 + BARS  # of the stator and of the cage's modes: the first states
STATES = FLUXES + 12


@cache
def _compiled() -> ctypes.CDLL:
    """Compile machine.c, once a process, with this module's constants."""
    constants = {name: value for name, value in globals().items() if name.isupper() and isinstance(value, int | float)}
    macros = [f"-D{name}=({value!r})" for name, value in constants.items()]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        library = Path(folder) / "machine.so"
        flags = [*FLAGS, *WARNINGS, "-fvisibility=default", "-fPIC", *macros]
        subprocess.run([*compiler_here(), *flags, str(SOURCE), "-lm", "-o", str(library)], check=True)
        return ctypes.CDLL(str(library))


class _Pointers(ctypes.Structure):
    """`Windings`, as machine.c has them."""

    _fields_ = [(name, ctypes.c_void_p) for name in Windings._fields]

    def __init__(self, windings: Windings) -> None:
        self.arrays = Windings(*(np.ascontiguousarray(each, dtype=np.float64) for each in windings))
        super().__init__(*(each.ctypes.data for each in self.arrays))


def _data(array: Floats) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def slope(x: Floats, reference: float, w: Windings) -> tuple[Floats, Floats]:
    """Return the rates of all states (STATES,), listed in machine.c, and the currents ids, iqs (2,)."""
    x, rates, currents = np.ascontiguousarray(x, dtype=np.float64), np.empty(STATES), np.empty(2)
    _compiled().slope(_data(x), ctypes.c_double(reference), ctypes.byref(_Pointers(w)), _data(rates), _data(currents))
    return rates, currents


def run(
    condition: Condition,
    references: Floats,
    sample_time: float,
    substeps: int,
    later: tuple[int, Condition] | None = None,
) -> Floats:
    """Run the drive from 750 rpm without current or flux, controlled from the first sample on.

    References are mechanical speeds, rad/s; from the sample `later` on, turns of the same phase are shorted. Columns of
    the result (K, 6): ``uds``, ``uqs`` (V), electrical ``w`` (rad/s), ``theta`` (rad), ``ids``, ``iqs`` (A).
    """
    references, found = np.ascontiguousarray(references, dtype=np.float64), np.empty((references.size, 6))
    x = np.zeros(STATES)
    x[FLUXES + 1 : FLUXES + 6] = SPEED, SPEED, SPEED, LOAD * SPEED, 0.01  # the flux of the control must not be zero
    now, h = windings(condition), ctypes.c_double(sample_time / substeps)

    def go_on(part: slice) -> None:
        count, w = ctypes.c_int(len(found[part])), ctypes.byref(_Pointers(now))
        pieces = _data(references[part]), count, h, ctypes.c_int(substeps), w, _data(found[part])
        _compiled().integrate(_data(x), *pieces)

    go_on(slice(None if later is None else later[0]))
    if later is not None:
        before, now = now, windings(later[1])
        currents = np.linalg.solve(*_fluxes(x, before))
        currents[2] = 0.0  # the shorted turns carry none yet; their flux goes on
        reduced, left = _fluxes(x, now)
        x[2] += (reduced @ currents - left)[2]
        go_on(slice(later[0], None))
    return found


def _fluxes(x: Floats, w: Windings) -> tuple[Floats, Floats]:
    """Return what the stator's currents are multiplied by (3, 3), and its fluxes without those of the cage (3,)."""
    c, s = cos(x[FLUXES]), sin(x[FLUXES])
    turned = w.axes @ np.array([[c, -s], [s, c]])
    reduced = w.inductance - turned @ w.coupling @ w.coupling.T @ turned.T
    return reduced, x[:3] - turned @ w.coupling @ x[3 : 3 + BARS]
