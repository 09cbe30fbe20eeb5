"""Records of three machines, by their own equations and scipy, and starts that lie far from the truth.

Nothing here knows an FMU. Samples are irregular, some are missing, the initial states are not zero and not told; the
noise is white. The truth is another in each draw.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """One draw: held inputs, measured outputs (NaN where missing), those without noise, and the noise's σ."""

    times: Floats
    inputs: Floats
    measured: Floats
    clean: Floats
    truth: Floats
    start: Floats
    noise: Floats


@dataclass(frozen=True)
class Machine:
    """What is drawn of a machine: the right-hand side in its states, which begin with the outputs."""

    name: str
    right: Callable[[Floats, Floats, Floats], list[float]]
    parameters: tuple[str, ...]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    noise: tuple[float, ...]
    missing: tuple[float, ...]
    first: tuple[float, ...]
    samples: int
    step: float
    nominal: tuple[float, ...]


def dc_motor(x: Floats, u: Floats, p: Floats) -> list[float]:
    """Return di/dt = (u − R i − k ω)/L and dω/dt = (k i − b ω − T_c tanh(2 ω))/J."""
    resistance, inductance, constant, inertia, viscous, coulomb = p
    return [
        (u[0] - resistance * x[0] - constant * x[1]) / inductance,
        (constant * x[0] - viscous * x[1] - coulomb * np.tanh(x[1] / 0.5)) / inertia,
    ]


def pmsm(x: Floats, u: Floats, p: Floats) -> list[float]:
    """Return the slopes of the currents in the rotor's axes and of the speed, four pole pairs."""
    resistance, direct, quadrature, flux, inertia, viscous = p
    return [
        (u[0] - resistance * x[0] + 4 * x[2] * quadrature * x[1]) / direct,
        (u[1] - resistance * x[1] - 4 * x[2] * (direct * x[0] + flux)) / quadrature,
        (6 * (flux * x[1] + (direct - quadrature) * x[0] * x[1]) - viscous * x[2]) / inertia,
    ]


def induction_machine(x: Floats, u: Floats, p: Floats) -> list[float]:
    """Return the slopes of the stator's currents and the rotor's fluxes in its axes (1.60); u[2] is the speed."""
    stator, rotor, magnetizing, leakage = p
    return [
        (u[0] - (stator + rotor) * x[0] + u[2] * leakage * x[1] + rotor / magnetizing * x[2] + u[2] * x[3]) / leakage,
        (u[1] - (stator + rotor) * x[1] - u[2] * leakage * x[0] + rotor / magnetizing * x[3] - u[2] * x[2]) / leakage,
        rotor * x[0] - rotor / magnetizing * x[2],
        rotor * x[1] - rotor / magnetizing * x[3],
    ]


DC_MOTOR = Machine(
    "DcMotor",
    dc_motor,
    ("R", "L", "k", "J", "b", "Tc"),
    (0.4, 3e-4, 0.02, 2e-5, 2e-5, 0.003),
    (3.0, 4e-3, 0.1, 3e-4, 3e-4, 0.03),
    ("i_start", "w_start"),
    ("u",),
    ("i", "w"),
    (0.3, 1.0),
    (0.2, 0.1),
    (2.0, 50.0),
    1200,
    1e-3,
    (1.0, 10.0),
)
PMSM = Machine(
    "Pmsm",
    pmsm,
    ("R", "Ld", "Lq", "psi", "J", "B"),
    (0.2, 1e-3, 1e-3, 0.02, 4e-4, 5e-4),
    (1.5, 5e-3, 8e-3, 0.15, 4e-3, 5e-3),
    ("id_start", "iq_start", "w_start"),
    ("ud", "uq"),
    ("id", "iq", "w"),
    (0.1, 0.4, 1.0),
    (0.2, 0.1, 0.5),
    (3.0, 3.0, 20.0),
    1200,
    4e-4,
    (1.0, 1.0, 10.0),
)
INDUCTION_MACHINE = Machine(
    "InductionMachine",
    induction_machine,
    ("Rs", "Rr", "Lm", "Lf"),
    (3.0, 1.5, 0.2, 0.02),
    (15.0, 8.0, 0.8, 0.12),
    ("ids_start", "iqs_start", "phidr_start", "phiqr_start"),
    ("uds", "uqs", "w"),
    ("ids", "iqs"),
    (0.05, 0.3),
    (0.2, 0.1),
    (2.0, 2.0, 0.4, 0.4),
    1500,
    1e-3,
    (1.0, 1.0, 0.5, 0.5),
)
MACHINES = {"dc": DC_MOTOR, "pmsm": PMSM, "im": INDUCTION_MACHINE}


def bits(rng: np.random.Generator, times: Floats, hold: float, levels: list[float]) -> Floats:
    """Return a random binary or multi-level sequence at times (K,)."""
    values = rng.choice(levels, int(times[-1] / hold) + 2)
    return np.asarray(values[(times / hold).astype(int)], dtype=np.float64)


def excitation(kind: str, rng: np.random.Generator, times: Floats) -> Floats:
    """Return the inputs of a machine (K, n_u)."""
    if kind == "dc":
        return bits(rng, times, 0.04, [-24, -12, 12, 24])[:, None]
    if kind == "pmsm":
        return np.column_stack([bits(rng, times, 2e-3, [-20, 20]), bits(rng, times, 3e-3, [-30, 60])])
    speed = np.interp(times, np.linspace(0.0, times[-1], 6), rng.uniform(0.0, 150.0, 6))
    return np.column_stack([bits(rng, times, 0.02, [-100, 100]), bits(rng, times, 0.03, [-100, 100]), speed])


def simulated(machine: Machine, truth: Floats, first: Floats, times: Floats, inputs: Floats) -> Floats:
    """Return the states (K, n_x), integrated interval by interval under held inputs."""
    states = np.empty((len(times), first.size))
    states[0] = first
    for k in range(len(times) - 1):
        ends = [times[k], times[k + 1]]
        held = (inputs[k], truth)
        states[k + 1] = odeint(lambda x, _, u, p: machine.right(x, u, p), states[k], ends, held, rtol=1e-9, atol=1e-9)[
            1
        ]
    return states


def draw(kind: str, seed: int, least: float = 0.0, most: float = 0.0) -> Record:
    """Return a record and a start that is off by factors from `least` to `most`; 0: by 50 to 300 %."""
    machine = MACHINES[kind]
    rng = np.random.default_rng([seed, list(MACHINES).index(kind)])
    truth = rng.uniform(machine.lowest, machine.highest)
    gaps = rng.uniform(0.4, 1.6, machine.samples - 1) * machine.step
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    inputs = excitation(kind, rng, times)
    clean = simulated(machine, truth, rng.normal(0.0, machine.first), times, inputs)[:, : len(machine.outputs)]
    measured = clean + rng.normal(0.0, machine.noise, clean.shape)
    measured[rng.random(clean.shape) < machine.missing] = np.nan
    up = rng.random(truth.size) < 0.5
    if most:
        factor = np.exp(rng.uniform(np.log(least), np.log(most), truth.size))
        factor = np.where(up, factor, 1.0 / factor)
    else:
        factor = np.where(up, rng.uniform(1.5, 4.0, truth.size), rng.uniform(0.25, 0.67, truth.size))
    return Record(times, inputs, measured, clean, truth, truth * factor, np.array(machine.noise))
