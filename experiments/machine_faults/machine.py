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

from dataclasses import dataclass
from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numba
import numpy as np

from fmuid.arrays import Floats
from fmuid.data.transforms import T23

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
    """The equations after constraints: nz currents of the stator, nr loops of the cage."""

    inductance: Floats
    """Of the stator (nz, nz), H."""
    resistance: Floats
    """Likewise, ohm."""
    axes: Floats
    """Turns of the stator along two fixed axes (nz, 2)."""
    loops: Floats
    """The same of the cage, along axes linked to it, times the mutual inductance (2, nr), H."""
    admittance: Floats
    """Inverse of the inductance of the cage (nr, nr), 1/H."""
    answer: Floats
    """`admittance` times `loops` transposed (nr, 2): what the cage's currents do against the stator's."""
    reduction: Floats
    """`loops` times `answer` (2, 2): what that takes from the stator's inductance, H."""
    loop_resistance: Floats
    """Of the cage (nr, nr), ohm."""


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
    total = TRUTH["Lf"] + TRUTH["Lm"]
    gap = total - STATOR_LEAKAGE
    return Windings(*_stator(condition, gap), *_cage(condition, gap))


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
    free = np.column_stack([directions, [0, -1, 0, 0]])[:, : 3 if condition.turns else 2]
    inductance = free.T @ (gap * axes @ axes.T + leakage) @ free
    resistance = condition.warmth * TRUTH["Rs"] * free.T @ np.diag(turns) @ free
    if condition.turns:
        resistance[2, 2] += CONTACT
    return inductance, np.asarray(resistance, dtype=np.float64), free.T @ axes


def _cage(condition: Condition, gap: float) -> tuple[Floats, Floats, Floats, Floats, Floats]:
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
    admittance = np.asarray(np.linalg.inv(joined.T @ inductance @ joined), dtype=np.float64)
    coupled = gap * loops @ joined
    answer = admittance @ coupled.T
    return coupled, admittance, answer, coupled @ answer, joined.T @ resistance @ joined


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
CONTROL_STATES = 12


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def control(x: Floats, ids: float, iqs: float, reference: float, rates: Floats) -> None:
    """Rates of speed control (halfway, smooth, integral), current control (flux, wanted, integrals) and inverter.

    x: angle and mechanical speed of the rotor, then these states; voltages and currents in axes linked to the rotor.
    """
    speed, halfway, smooth, integral, fluxd, fluxq, wanted, vf, vt, ud, uq = x[1:]
    unlimited = GAIN * (smooth - speed) + integral
    torque = max(-TORQUE_MAX, min(TORQUE_MAX, unlimited))
    rates[2] = (reference - halfway) / SMOOTHING
    rates[3] = (halfway - smooth) / SMOOTHING
    rates[4] = (GAIN * (smooth - speed) + torque - unlimited) / INTEGRAL_TIME
    rates[5] = KNOWN_RR * (ids - fluxd / KNOWN_LM)
    rates[6] = KNOWN_RR * (iqs - fluxq / KNOWN_LM)
    flux = sqrt(fluxd * fluxd + fluxq * fluxq)
    c, s = fluxd / flux, fluxq / flux
    along, across = c * ids + s * iqs, c * iqs - s * ids
    rates[7] = (min(CURRENT_MAX, FLUX / KNOWN_LM + FLUX_GAIN * (FLUX - flux)) - wanted) / MAGNETISING_TIME
    ef, et = wanted - along, torque / (POLE_PAIRS * FLUX) - across
    turning = POLE_PAIRS * speed + KNOWN_RR * across / max(flux, FLUX / 2)
    uf = KNOWN_LF / CURRENT_TIME * ef + vf - turning * KNOWN_LF * across
    ut = KNOWN_LF / CURRENT_TIME * et + vt + turning * (KNOWN_LF * along + flux)
    share = VOLTAGE_MAX / max(VOLTAGE_MAX, sqrt(uf * uf + ut * ut))
    rates[8] = ((KNOWN_RS + KNOWN_RR) * ef + (share - 1) * uf) / CURRENT_TIME
    rates[9] = ((KNOWN_RS + KNOWN_RR) * et + (share - 1) * ut) / CURRENT_TIME
    rates[10] = (share * (c * uf - s * ut) - ud) / INVERTER_TIME
    rates[11] = (share * (s * uf + c * ut) - uq) / INVERTER_TIME


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def slope(x: Floats, reference: float, w: Windings, rates: Floats) -> tuple[float, float]:
    """Rates of all states: stator fluxes, fluxes of the cage's loops, `control`'s; returns the currents ids, iqs."""
    nz, nr = w.axes.shape[0], w.admittance.shape[0]
    rest = x[nz + nr :]
    c, s = cos(rest[0]), sin(rest[0])
    turned = np.empty((nz, 2))  # the stator's turns along axes linked to the rotor
    turned[:, 0] = c * w.axes[:, 0] + s * w.axes[:, 1]
    turned[:, 1] = c * w.axes[:, 1] - s * w.axes[:, 0]
    still = w.admittance @ x[nz : nz + nr]  # currents of the cage, were there none in the stator
    reduced = w.inductance - turned @ w.reduction @ turned.T
    currents = np.linalg.solve(reduced, x[:nz] - turned @ (w.loops @ still))
    along = turned.T @ currents
    loops = still - w.answer @ along
    field = w.loops @ loops
    ud, uq = rest[10], rest[11]
    rates[:nz] = -(w.resistance @ currents)
    rates[0] += c * ud - s * uq
    rates[1] += s * ud + c * uq
    rates[nz : nz + nr] = -(w.loop_resistance @ loops)
    torque = POLE_PAIRS * (field[0] * along[1] - field[1] * along[0])
    ids, iqs = c * currents[0] + s * currents[1], c * currents[1] - s * currents[0]
    others = rates[nz + nr :]
    others[0] = POLE_PAIRS * rest[1]
    others[1] = (torque - LOAD * rest[1]) / INERTIA
    control(rest, ids, iqs, reference, others)
    return ids, iqs


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def integrate(start: Floats, references: Floats, h: float, substeps: int, w: Windings) -> Floats:
    """Return voltages, electrical speed, angle and currents at every sample (K, 6) under references (K,) held."""
    found = np.empty((references.size, 6))
    x = start.copy()
    before = x.size - CONTROL_STATES
    one, two, three, four = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
    for k in range(references.size):
        ids, iqs = slope(x, references[k], w, one)
        rest = x[before:]
        found[k] = rest[10], rest[11], POLE_PAIRS * rest[1], rest[0], ids, iqs
        for _ in range(substeps):
            slope(x, references[k], w, one)
            slope(x + h / 2 * one, references[k], w, two)
            slope(x + h / 2 * two, references[k], w, three)
            slope(x + h * three, references[k], w, four)
            x = x + h / 6 * (one + 2 * two + 2 * three + four)
    return found


def run(condition: Condition, references: Floats, sample_time: float, substeps: int) -> Floats:
    """Run the drive from 750 rpm without current or flux, controlled from the first sample on.

    Parameters
    ----------
    condition : Condition
    references : (K,) array
        Mechanical speed wanted, rad/s, held from sample to sample.
    sample_time : float
        s.
    substeps : int
        Runge-Kutta steps of a sample.

    Returns
    -------
    (K, 6) array
        ``uds``, ``uqs`` (V), electrical speed ``w`` (rad/s), ``theta`` (rad), ``ids``, ``iqs`` (A).
    """
    matrices = Windings(*(np.ascontiguousarray(each, dtype=np.float64) for each in windings(condition)))
    start = np.zeros(matrices.axes.shape[0] + matrices.admittance.shape[0] + CONTROL_STATES)
    start[-CONTROL_STATES:][1:6] = SPEED, SPEED, SPEED, LOAD * SPEED, 0.01  # the flux of the control must not be zero
    return np.asarray(integrate(start, references, sample_time / substeps, substeps, matrices))
