"""An induction machine in its three windings, integrated by scipy: no model of this package.

Star point isolated: u_p − e0 sign(i_p) − R_p i_p = v_n + L_f di_p/dt + e_p, Σ i_p = 0; rotor flux in the rotor's axes
φ' = R_r (i_dq − φ/L_m), e = Tᵀ P(θ) (φ' + w J φ). Several machines are integrated at once.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from fmuid.array_types import Floats
from fmuid.data import Angle, Observation

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


def currents(
    times: Floats,
    speed: Floats,
    angle: Floats,
    axes: Floats,
    joint: ArrayLike = 0.0,
    dead_time: ArrayLike = 0.0,
) -> Floats:
    """Return line currents (m, K, 3) of m machines with joints (m, 3), Ohm, and dead times (m,), V."""
    joint = np.atleast_2d(np.asarray(joint, float) + np.zeros(3))
    dead = np.atleast_1d(np.asarray(dead_time, float))[:, None]
    joint, dead = (
        np.broadcast_to(joint, (max(len(joint), len(dead)), 3)),
        np.broadcast_to(dead, (max(len(joint), len(dead)), 1)),
    )
    rs, rr, lm, lf = (MACHINE[name] for name in ("Rs", "Rr", "Lm", "Lf"))
    count = len(joint)
    turning = CubicSpline(times, angle)

    def slope(t: float, state: Floats) -> Floats:
        own = state.reshape(count, 5)
        i, flux = own[:, :3], own[:, 3:]
        theta, w = float(turning(t)), float(np.interp(t, times, speed))
        rotor = rr * (to_axes(i, theta) - flux / lm)
        back = to_phases(rotor + w * np.stack([-flux[:, 1], flux[:, 0]], axis=-1), theta)
        volts = np.array([np.interp(t, times, axes[:, 0]), np.interp(t, times, axes[:, 1])])
        left = to_phases(volts, theta) - dead * np.tanh(i / 0.02) - (rs + joint) * i - back
        rates = (left - left.mean(axis=1, keepdims=True)) / lf
        return np.concatenate([rates, rotor], axis=1).ravel()

    kinks = solve_ivp(
        slope, (times[0], times[-1]), np.zeros(5 * count), t_eval=times, rtol=1e-8, atol=1e-9, max_step=STEP
    )
    return np.moveaxis(kinks.y.reshape(count, 5, -1)[:, :3], 2, 1)


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
    times, speed, angle, axes = excitation(count, seed)
    frame = pd.DataFrame({"time": times, "w": speed, "theta": angle})
    frame[["ua", "ub", "uc"]] = to_phases(axes, angle)
    found = currents(times, speed, angle, axes, joint, dead_time)[0, :, :2]
    frame[["ia", "ib"]] = found + noise * np.random.default_rng([12, seed]).standard_normal(found.shape)
    return frame
