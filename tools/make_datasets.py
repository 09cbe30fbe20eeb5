"""Makes the tables of `fmuid.datasets`: closed forms, no FMU; ``python -m tools.make_datasets``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import max_len_seq

Floats = NDArray[np.float64]

FOLDER = Path(__file__).parents[1] / "fmuid" / "datasets"
COIL_STEP, COIL_SAMPLES, COIL_NOISE = 1e-3, 200, 0.01  # s, -, A
MACHINE_STEP, MACHINE_SAMPLES, MACHINE_NOISE = 2e-3, 400, 0.02
SPEED = 150.0  # rad/s, electrical


def voltage(samples: int, bit: int, size: float, seed: int) -> Floats:
    """Return a pseudo-random binary voltage, `bit` samples a bit."""
    bits = max_len_seq(7, state=np.array([int(b) for b in f"{seed + 1:07b}"], dtype=np.int8))[0]
    return np.asarray(np.resize(np.repeat(size * (2.0 * bits - 1.0), bit), samples))


def coil(R: float, L: float, seed: int) -> pd.DataFrame:
    """Return a record of L di/dt = u − R i, in closed form for a voltage that is linear between samples."""
    times, u, i = np.arange(COIL_SAMPLES) * COIL_STEP, voltage(COIL_SAMPLES, 8, 12.0, seed), np.zeros(COIL_SAMPLES)
    decay = np.exp(-R / L * COIL_STEP)
    ramp = (COIL_STEP - L / R * (1.0 - decay)) / (R * COIL_STEP)  # what a rise by 1 V within a step leaves
    for k in range(COIL_SAMPLES - 1):
        i[k + 1] = decay * i[k] + (1.0 - decay) / R * u[k] + ramp * (u[k + 1] - u[k])
    i += COIL_NOISE * np.random.default_rng(seed).standard_normal(COIL_SAMPLES)
    return pd.DataFrame({"time": times, "u": u, "i": i})


def machine(Rs: float, Rr: float, Lm: float, Lf: float, seed: int) -> pd.DataFrame:
    """Return a record of Park's machine (fmus/InductionMachine/README.md) in rotor axes at constant speed, exact."""
    times = np.arange(MACHINE_SAMPLES) * MACHINE_STEP
    u = np.column_stack([voltage(MACHINE_SAMPLES, bit, 100.0, seed + bit) for bit in (7, 11)])
    own = np.array(
        [
            [-(Rs + Rr) / Lf, SPEED, Rr / (Lm * Lf), SPEED / Lf],
            [-SPEED, -(Rs + Rr) / Lf, -SPEED / Lf, Rr / (Lm * Lf)],
            [Rr, 0.0, -Rr / Lm, 0.0],
            [0.0, Rr, 0.0, -Rr / Lm],
        ]
    )
    # states, voltages and the rise of the voltages within a step obey one linear equation
    whole = np.zeros((8, 8))
    whole[:4, :4], whole[:2, 4:6], whole[4:6, 6:] = MACHINE_STEP * own, MACHINE_STEP / Lf * np.eye(2), np.eye(2)
    step, x = expm(whole)[:4], np.zeros((MACHINE_SAMPLES, 4))
    for k in range(MACHINE_SAMPLES - 1):
        x[k + 1] = step @ np.concatenate([x[k], u[k], u[k + 1] - u[k]])
    noisy = x[:, :2] + MACHINE_NOISE * np.random.default_rng(seed).standard_normal((2, MACHINE_SAMPLES)).T
    w = np.full(MACHINE_SAMPLES, SPEED)
    return pd.DataFrame({"time": times, "uds": u[:, 0], "uqs": u[:, 1], "w": w, "ids": noisy[:, 0], "iqs": noisy[:, 1]})


TABLES: Mapping[str, Callable[[], pd.DataFrame]] = {
    "coil": lambda: coil(4.0, 0.1, 1),
    "faulty_coil": lambda: coil(4.0 - 0.08, 0.1 - 2.0 * 0.025 * 0.08, 2),
    "induction_machine": lambda: machine(9.8, 3.8, 0.436, 0.0762, 3),
}

if __name__ == "__main__":
    for name, make in TABLES.items():
        make().to_csv(FOLDER / f"{name}.csv", index=False, float_format="%.6g")
