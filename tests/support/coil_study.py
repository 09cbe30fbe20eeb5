"""A study of a coil, its table, and the command line that runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.cli.app import run
from tests.support.paths import FMUS

COIL = FMUS / "Coil/Coil.fmu"


R, L, NOISE, STEP = 4.0, 0.1, 0.02, 1e-3


def coil_current(voltage: npt.NDArray[np.float64], start: float) -> npt.NDArray[np.float64]:
    """Return the current of the coil for a held voltage: exact, sample by sample."""
    decay = np.exp(-R / L * STEP)
    current = np.empty(voltage.size)
    current[0] = start
    for k in range(voltage.size - 1):
        current[k + 1] = decay * current[k] + (1 - decay) / R * voltage[k]
    return current


def coil_table(path: Path, start: float, seed: int, noise: float = NOISE) -> None:
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.choice([-1.0, 1.0], 40), 15)
    current = coil_current(voltage, start) + noise * rng.normal(size=voltage.size)
    times = np.linspace(0.0, STEP * (voltage.size - 1), voltage.size)
    pd.DataFrame({"time": times, "u": voltage, "i": current}).to_csv(path, index=False)


STUDY = f"""
title = "Coil"
[model]
fmu = "{COIL.as_posix()}"
[[experiments]]
table = "first.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "hold"
[parameters]
R = {{ start = 6.0, min = 0.0 }}
L = {{ start = 0.05, min = 1e-3 }}
"""


def result(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def fmuid_(*arguments: str | Path) -> int:
    return run([str(argument) for argument in arguments])
