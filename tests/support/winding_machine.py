"""An induction machine in its three windings, integrated by scipy: no model of this package.

Star point isolated: u_p − e0 sign(i_p) − R_p i_p = v_n + L_f di_p/dt + e_p, Σ i_p = 0; rotor flux in the rotor's axes
φ' = R_r (1 + k n nᵀ) (i_dq − φ/L_m), e = Tᵀ P(θ) (φ' + w J φ); n is the direction of broken bars. Of phase p the share
μ of the turns is shorted: i_p − μ i_f makes its flux, and the loop with a leakage of its own, a share λ, has
L_f i_p' − ((1 − λ) μ + λ) L_f i_f' = R_f i_f − R_s (i_p − i_f) − e_p. Several machines are integrated at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

import fmuid
from fmuid.array_types import Floats
from fmuid.data import Angle, Observation
from tests.support.paths import FMUS

MACHINE = {"Rs": 9.3, "Rr": 4.1, "Lm": 0.41, "Lf": 0.071}
STEP = 5e-4
AXES = {"ids": ("ia", "ib"), "iqs": ("ia", "ib")}
VOLTAGES = {"uds": ("ua", "ub", "uc"), "uqs": ("ua", "ub", "uc")}
STUDY_AXES = Observation(Angle(column="theta"), AXES, VOLTAGES)
PARK = np.sqrt(2.0 / 3.0)
SHIFTS = np.array([0.0, -2.0 * np.pi / 3.0, 2.0 * np.pi / 3.0])


def to_axes(phases: Floats, angle: ArrayLike) -> Floats:
    """Return x_dq (..., 2) of phases (..., 3) at an electrical angle."""
    turned = np.asarray(angle)[..., None] + SHIFTS
    d, q = (phases * np.cos(turned)).sum(-1), -(phases * np.sin(turned)).sum(-1)
    return np.asarray(PARK * np.stack([d, q], axis=-1))


def to_phases(axes: Floats, angle: ArrayLike) -> Floats:
    """Return phases (..., 3) of x_dq (..., 2)."""
    turned = np.asarray(angle)[..., None] + SHIFTS
    return np.asarray(PARK * (axes[..., :1] * np.cos(turned) - axes[..., 1:] * np.sin(turned)))


def excitation(count: int, seed: int = 0) -> tuple[Floats, Floats, Floats, Floats]:
    """Return times, speed, angle and voltages of the axes (K, 2)."""
    rng = np.random.default_rng([11, seed])
    times: Floats = STEP * np.arange(count, dtype=np.float64)
    first, slip = rng.uniform(100.0, 150.0), rng.uniform(1.5, 3.0)
    speed = first + 8.0 * np.sin(2.0 * np.pi * 1.3 * times + rng.uniform(0.0, 6.0))
    angle = rng.uniform(0.0, 6.0) + np.concatenate([[0.0], np.cumsum(STEP * (speed[1:] + speed[:-1]) / 2.0)])
    size, turn = 0.9 * (first + 2.0 * np.pi * slip), 2.0 * np.pi * slip * times + rng.uniform(0.0, 6.0)
    steps = np.repeat(rng.integers(0, 2, (count // 25 + 1, 2)) * 2.0 - 1.0, 25, axis=0)[:count]
    return (
        times,
        np.asarray(speed),
        np.asarray(angle),
        np.asarray(size) * (np.stack([np.cos(turn), np.sin(turn)], axis=-1) + 0.25 * steps),
    )


@dataclass(frozen=True)
class Condition:
    """What is off in a machine, its sensors and its inverter."""

    joint: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Ohm
    dead_time: float = 0.0  # V
    warm: float = 1.0  # of both resistances
    saturation: float = 0.0  # of L_m at a flux of 1 Vs
    turns: float = 0.0  # share μ of a phase ...
    phase: int = 0
    own: float = 0.3  # ... with this share λ of leakage
    bars: float = 0.0  # share of the bars, at an angle
    bars_at: float = 0.0
    supply: tuple[float, float, float] = (0.0, 0.0, 0.0)  # share of voltage that the table does not show
    gain: tuple[float, float] = (0.0, 0.0)  # of the sensors
    offset: tuple[float, float] = (0.0, 0.0)  # A
    delay: tuple[float, float] = (0.0, 0.0)  # s


Drive = tuple[Floats, Floats, Floats, Floats]  # times, speed, angle, voltages of the axes
STEPS = 4  # of Runge and Kutta in a sampling interval
CONTACT = 0.02  # resistance of a short circuit over R_s of its turns


def fine_times(count: int) -> Floats:
    """Return the times of fine currents of K samples, s."""
    return np.asarray(STEP / STEPS * np.arange((count - 1) * STEPS + 1))


def currents(drives: Sequence[Drive], conditions: Sequence[Condition], *, fine: bool = False) -> Floats:
    """Return line currents (m, K, 3) of m machines over drives with the same times; fine ones after all steps."""

    def of(name: str) -> Floats:
        return np.array([getattr(each, name) for each in conditions], float)

    speed, angle, axes = (np.array([drive[k] for drive in drives]) for k in (1, 2, 3))
    rs, rr, lm, lf = (MACHINE[name] for name in ("Rs", "Rr", "Lm", "Lf"))
    turns, warm, saturation, supply = of("turns"), of("warm")[:, None], of("saturation")[:, None], of("supply")
    resistance, dead, at = rs * warm + of("joint"), of("dead_time")[:, None], np.eye(3)[of("phase").astype(int)]
    bars = np.stack([np.cos(of("bars_at")), np.sin(of("bars_at"))], axis=-1)
    more = (2.0 * of("bars") / (3.0 - 2.0 * of("bars")))[:, None]
    # L di_a, L di_b, L di_c, L di_f, v_n of three phases, the loop and the star point
    left = np.zeros((len(drives), 5, 5))
    left[:, :3, :3], left[:, :3, 3], left[:, :3, 4] = np.eye(3), -turns[:, None] * at, 1.0
    left[:, 3, :3], left[:, 3, 3], left[:, 4, :3] = at, -np.where(turns > 0, turns + of("own") * (1 - turns), 1.0), 1.0
    inverse, right = np.linalg.inv(left), np.zeros((len(drives), 5))

    def slope(state: Floats, theta: Floats, w: Floats, volts: Floats) -> Floats:
        i, loop, flux = state[:, :3], state[:, 3:4], state[:, 4:]
        shorted = turns[:, None] * loop * at
        total = lm * (1.0 - saturation * np.minimum((flux**2).sum(-1, keepdims=True), 2.0))
        slip = to_axes(i - shorted, theta) - flux / total
        rotor = rr * warm * (slip + more * bars * (bars * slip).sum(-1, keepdims=True))
        back = to_phases(rotor + w[:, None] * np.stack([-flux[:, 1], flux[:, 0]], axis=-1), theta)
        given = (1.0 + supply) * to_phases(volts, theta) - dead * np.tanh(i / 0.02)
        right[:, :3] = given - resistance * i + rs * warm * shorted - back
        right[:, 3:4] = (CONTACT + 1.0) * rs * warm * loop - (at * (rs * warm * i + back)).sum(-1, keepdims=True)
        rates = np.einsum("mij,mj->mi", inverse, right)[:, :4] / lf
        return np.concatenate([rates, rotor], axis=1)

    h, state = STEP / STEPS, np.zeros((len(drives), 6))
    found = np.zeros((len(drives), (speed.shape[1] - 1) * STEPS + 1, 3))
    for k in range(speed.shape[1] - 1):
        for part in range(STEPS):
            rates = [np.zeros_like(state)]
            for share in (0.0, 0.5, 0.5, 1.0):
                s = (part + share) / STEPS
                w = speed[:, k] + s * (speed[:, k + 1] - speed[:, k])
                theta = angle[:, k] + s * STEP * (speed[:, k] + w) / 2.0
                volts = (1.0 - s) * axes[:, k] + s * axes[:, k + 1]
                rates.append(slope(state + share * h * rates[-1], theta, w, volts))
            state = state + h / 6.0 * (rates[1] + 2.0 * rates[2] + 2.0 * rates[3] + rates[4])
            found[:, k * STEPS + part + 1] = state[:, :3]
    return found if fine else found[:, ::STEPS]


def tables(drives: Sequence[Drive], conditions: Sequence[Condition], noise: float, seed: int) -> list[pd.DataFrame]:
    """Return tables of phase signals: voltages asked of the inverter, currents that sensors of lines a and b read."""
    rng, found = np.random.default_rng([12, seed]), []
    fine = currents(drives, conditions, fine=True)
    for (times, speed, angle, axes), off, lines in zip(drives, conditions, fine, strict=True):
        frame = pd.DataFrame({"time": times, "w": speed, "theta": angle})
        frame[["ua", "ub", "uc"]] = to_phases(axes, angle)
        for j, name in enumerate(("ia", "ib")):
            late = CubicSpline(fine_times(len(times)), lines[:, j])(np.maximum(times - off.delay[j], 0.0))
            frame[name] = (1.0 + off.gain[j]) * late + off.offset[j] + noise * rng.standard_normal(times.size)
        found.append(frame)
    return found


@cache
def record(
    count: int,
    *,
    joint: tuple[float, float, float] = (0.0, 0.0, 0.0),
    dead_time: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> pd.DataFrame:
    """Return a table of phase signals, not to be changed: voltages of the inverter, currents of lines a and b."""
    (frame,) = tables([excitation(count, seed)], [Condition(joint=joint, dead_time=dead_time)], noise, seed)
    return frame


def leaking_stator(own: Sequence[float]) -> fmuid.Fault:
    """Return shorted turns beside the machine, with this leakage of their own."""
    machine, short = (FMUS / name / f"{name}.fmu" for name in ("InductionMachine", "StatorShortCircuitLeakage"))
    connectors = {
        name: [(f"{part}.{name}", 1.0, 0.0) for part in ("machine", "fault")] for name in ("Rs", "Lf", "uds", "uqs")
    }
    both = fmuid.System(components={"machine": machine, "fault": short}, connectors=connectors)
    names = {name: f"machine.{name}" for name in ("Rr", "Lm", "w")}
    names |= {name: f"machine.{name} + fault.{name}" for name in ("ids", "iqs")}
    turns = {f"fault.eta_{p}": fmuid.Parameter(0.0, nominal=0.01, min=0.0) for p in "abc"}
    nuisance = {"fault.own": own} if own else {}
    return fmuid.Fault(both, turns, variable_map=names, inputs={"fault.theta": "theta"}, nuisance=nuisance)
