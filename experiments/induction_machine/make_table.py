"""Make table.csv: a 1.1 kW induction machine under vector control (method.md section 8), measured with noise.

    python experiments/induction_machine/make_table.py

The three-phase equations (1.58) are integrated themselves, with their matrices turning with the rotor: nothing here
knows the Park model that is identified from the table. One sample of 0.7 ms is 14 steps of Runge-Kutta 4.

- Before t = 0 the DC machine turns the unexcited induction machine at 750 rpm. At t = 0 it becomes a generator on a
  resistor (torque proportional to speed) and the control starts: all currents and fluxes start at zero.
- The control is sampled with the measurements and sees their noise-free values. Between samples the inverter moves the
  voltages of the Park axes linked to the rotor straight from one command to the next, one sample late: the linear
  interpolation of the table is the machine's true input. For the speed it is nearly so: from the table without noise
  the four parameters come back within 0.004 of the standard deviations that they have with it.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import max_len_seq

Array = npt.NDArray[np.floating]

TRUTH = {"Rs": 9.8, "Rr": 3.8, "Lm": 0.436, "Lf": 0.0762}
"""Resistances in ohm and inductances in henry, near the chapter's estimates."""

SAMPLES = 4500
SAMPLE_TIME = 7e-4  # s
SUBSTEPS = 14  # 50 us, which leaves errors below 1e-8 A
NOISE_VARIANCE = 0.0462  # A², on each of the two currents
SEED = 0

POLE_PAIRS = 2
INERTIA = 0.02  # kg m², both machines
LOAD = 0.05  # N m s, torque of the generator over the mechanical speed: 3.9 N m at 750 rpm
RPM = 2 * pi / 60  # rad/s
SPEED, SPEED_STEP = 750 * RPM, 90 * RPM  # rad/s, mechanical
BIT = 145  # samples of one bit of the PRBS, 0.1 s: 31 bits fill the table

PHASES = 2 * pi / 3 * np.arange(3)
OWN = TRUTH["Lm"] * (np.eye(3) - 1 / 3)
"""Magnetising inductances of stator or rotor, H: L_p = 2/3 L_m on the diagonal, -L_p/2 off it."""
FREE = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
"""Rotor currents from the first two: the rotor has no zero sequence, along which its inductances are singular."""
T23 = np.sqrt(2 / 3) * np.array([[1.0, -0.5, -0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]])
"""Concordia matrix; the power-invariant one."""


def currents_and_torque(state: Array) -> tuple[Array, float]:
    """Return the currents (three of the stator, the first two of the rotor), A, and the torque, N m.

    The fluxes of (1.58) are solved for the currents; the torque is the derivative of the co-energy by the angle.
    """
    angles = state[6] + PHASES[np.newaxis, :] - PHASES[:, np.newaxis]
    mutual = TRUTH["Lm"] * 2 / 3 * np.cos(angles)
    inductances = np.empty((5, 5))
    inductances[:3, :3] = OWN + TRUTH["Lf"] * np.eye(3)
    inductances[:3, 3:] = mutual @ FREE
    inductances[3:, :3] = mutual.T[:2]
    inductances[3:, 3:] = (OWN @ FREE)[:2]
    currents = np.linalg.solve(inductances, state[:5])
    turned = -TRUTH["Lm"] * 2 / 3 * np.sin(angles)
    return currents, float(POLE_PAIRS * currents[:3] @ turned @ FREE @ currents[3:])


def phases(axes: Array, angle: float) -> Array:
    """Return the three phases of two axes linked to the rotor: the inverse Park transform."""
    c, s = cos(angle), sin(angle)
    voltages: Array = np.array([c * axes[0] - s * axes[1], s * axes[0] + c * axes[1]]) @ T23
    return voltages


def slope(state: Array, axes: Array) -> Array:
    """Return the time derivative of the state under the stator voltages `axes`: (1.58) and the mechanical equation.

    The state: three stator fluxes, the first two rotor fluxes (Wb), mechanical speed (rad/s), electrical angle (rad).
    """
    currents, torque = currents_and_torque(state)
    stator = phases(axes, state[6]) - TRUTH["Rs"] * currents[:3]
    rotor = -TRUTH["Rr"] * currents[3:]
    return np.array([*stator, *rotor, (torque - LOAD * state[5]) / INERTIA, POLE_PAIRS * state[5]])


def next_sample(state: Array, before: Array, after: Array) -> Array:
    """Return the state one sample later, by Runge-Kutta 4, the voltages going straight from `before` to `after`."""
    h = SAMPLE_TIME / SUBSTEPS
    for k in range(SUBSTEPS):
        start, middle, end = (before + (k + part) / SUBSTEPS * (after - before) for part in (0.0, 0.5, 1.0))
        first = slope(state, start)
        second = slope(state + h / 2 * first, middle)
        third = slope(state + h / 2 * second, middle)
        fourth = slope(state + h * third, end)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    return state


class VectorControl:
    """Sampled vector control in the axes of an estimated rotor flux; it knows its machine roughly."""

    Rs = 9.5
    Rr = 4.0
    Lm = 0.44
    Lf = 0.075
    flux = 1.15  # Wb, reference: that of 230 V at 50 Hz is 1.27 Wb
    current_time = 3e-3  # s, closed loop
    speed_time = 30e-3  # s, closed loop
    torque_limit = 8.0  # N m
    flux_current_limit = 6.0  # A
    voltage_limit = 380.0  # V, of the vector: 540 V / sqrt(2)

    def __init__(self) -> None:
        self.estimate = 0j  # rotor flux in the axes of the rotor, Wb
        self.voltage_integral = 0j  # V, flux axes
        self.torque_integral = LOAD * SPEED  # N m: the operator knows the load

    def command(self, current: complex, speed: float, reference: float) -> complex:
        """Return the voltage for the next sample, V, from the current, A, and the mechanical speed, rad/s.

        Currents and voltages are complex, in the axes linked to the rotor.
        """
        flux, direction = abs(self.estimate), np.exp(-1j * np.angle(self.estimate))
        i = current * direction
        wanted = 1j * self._torque(speed, reference) / (POLE_PAIRS * self.flux)
        wanted += min(self.flux / self.Lm + 20 * (self.flux - flux), self.flux_current_limit)
        slip = self.Rr * i.imag / max(flux, 0.5 * self.flux)
        turning = POLE_PAIRS * speed + slip
        voltage = (
            self.Lf / self.current_time * (wanted - i) + self.voltage_integral + 1j * turning * (self.Lf * i + flux)
        )
        if abs(voltage) > self.voltage_limit:
            voltage *= self.voltage_limit / abs(voltage)
        else:
            self.voltage_integral += (self.Rs + self.Rr) / self.current_time * SAMPLE_TIME * (wanted - i)
        decay = exp(-self.Rr / self.Lm * SAMPLE_TIME)
        self.estimate = decay * self.estimate + (1 - decay) * self.Lm * current
        return complex(voltage / direction * np.exp(1j * slip * SAMPLE_TIME))

    def _torque(self, speed: float, reference: float) -> float:
        gain = INERTIA / self.speed_time
        torque = gain * (reference - speed) + self.torque_integral
        if abs(torque) > self.torque_limit:
            return float(np.copysign(self.torque_limit, torque))
        self.torque_integral += gain / (4 * self.speed_time) * SAMPLE_TIME * (reference - speed)
        return torque


def speed_reference(samples: int) -> Array:
    """Return 750 rpm plus or minus 90 rpm, a maximum-length sequence of 31 bits, rad/s (samples,)."""
    bits = 2.0 * max_len_seq(5)[0] - 1.0
    wanted: Array = SPEED + SPEED_STEP * bits[np.arange(samples) // BIT % bits.size]
    return wanted


def simulate(samples: int = SAMPLES) -> pd.DataFrame:
    """Return what noise-free sensors would show.

    Columns: ``time`` (s); ``uds``, ``uqs``, ``ids``, ``iqs`` (V and A, Park axes linked to the rotor); ``w``
    (electrical speed, rad/s); ``ua`` to ``uc``, ``ia`` to ``ic`` (phases); ``theta`` (electrical rotor angle, rad).
    """
    control, reference = VectorControl(), speed_reference(samples)
    state: Array = np.array([0.0, 0.0, 0.0, 0.0, 0.0, SPEED, 0.0])
    voltage: Array = np.zeros(2)
    rows = np.empty((samples, 13))
    for k in range(samples):
        phase_currents = currents_and_torque(state)[0][:3]
        current = complex(*(T23 @ phase_currents)) * np.exp(-1j * state[6])
        axes = (*voltage, POLE_PAIRS * state[5], current.real, current.imag)
        rows[k] = (k * SAMPLE_TIME, *axes, *phases(voltage, state[6]), *phase_currents, state[6])
        command = control.command(current, state[5], reference[k])
        after = np.array([command.real, command.imag])
        state, voltage = next_sample(state, voltage, after), after
    names = ["time", "uds", "uqs", "w", "ids", "iqs", "ua", "ub", "uc", "ia", "ib", "ic", "theta"]
    return pd.DataFrame(rows, columns=names)


def add_noise(frame: pd.DataFrame, variance: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return the columns of table.csv, with white Gaussian noise of a variance (A²) on the two currents."""
    table = frame[["time", "uds", "uqs", "w", "ids", "iqs"]].copy()
    table[["ids", "iqs"]] += rng.normal(scale=sqrt(variance), size=(len(table), 2))
    return table


def main() -> None:
    """Rewrite table.csv beside this script."""
    table = add_noise(simulate(), NOISE_VARIANCE, np.random.default_rng(SEED))
    table.to_csv(Path(__file__).with_name("table.csv"), index=False, float_format="%.9g", lineterminator="\n")


if __name__ == "__main__":
    main()
