"""A coil under a held voltage: its current in closed form, and its problem."""

from __future__ import annotations

import numpy as np
import pandas as pd

import fmuid
from fmuid.array_types import Floats
from tests.support.paths import FMUS

COIL, R, L, STEP, COUNT = FMUS / "Coil" / "Coil.fmu", 4.0, 0.1, 0.002, 1000
TIMES = STEP * np.arange(COUNT)


def held_voltage(rng: np.random.Generator) -> Floats:
    return 12.0 * np.repeat(rng.choice([-1.0, 0.0, 1.0], COUNT // 15 + 2), 15)[:COUNT]


def closed(u: Floats, delay: float = 0.0) -> Floats:
    """Return the current (K,) of the held voltage, read `delay` samples late."""
    decay, found = np.exp(-R / L * STEP), np.zeros(len(u))
    for k in range(len(u) - 1):
        found[k + 1] = decay * found[k] + (1.0 - decay) / R * u[k]
    part = np.exp(-R / L * STEP * (1.0 - delay))
    late = np.concatenate([[0.0], part * found[:-1] + (1.0 - part) / R * u[:-1]])
    return late if delay else found


def problem_of(u: Floats, i: Floats, interpolation: str = "zoh", delay_std: float = 0.0) -> fmuid.Problem:
    frame = pd.DataFrame({"time": TIMES, "u": u, "i": i})
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation=interpolation)
    parameters = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.03, min=1e-4)}
    return fmuid.Problem(COIL, experiment, parameters, noise=fmuid.Noise(delay_std=delay_std))
