"""A study of the coil whose cases are varied, and its current in closed form."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fmuid import Study
from fmuid.runs.batch.case import VOLATILE
from tests.support.paths import FMUS

COIL = FMUS / "Coil" / "Coil.fmu"
TIMES = np.arange(120) * 2e-3
VOLTAGE, STD = 10.0, 0.02
R, L = 4.0, 0.1


def current(r: float, inductance: float) -> NDArray[np.float64]:
    """Return the current after a step of the voltage, in closed form."""
    return np.asarray(VOLTAGE / r * (1.0 - np.exp(-r / inductance * TIMES)))


def record(seed: int, r: float = R) -> pd.DataFrame:
    noise = STD * np.random.default_rng(seed).standard_normal(TIMES.size)
    return pd.DataFrame({"time": TIMES, "u": VOLTAGE, "i": current(r, L) + noise})


def study_of(case_folder: Path, batch: Mapping[str, Any] | None, **tables: Any) -> Study:
    data: dict[str, Any] = {
        "model": {"fmu": str(COIL)},
        "experiments": [{"data": "table.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "zoh"}],
        "parameters": {"R": {"start": 3.0, "min": 0.5, "max": 8.0}, "L": {"start": 0.2, "min": 1e-3}},
    }
    return Study.of(data | tables | ({} if batch is None else {"batch": batch}), case_folder / "study.toml")


def bits(row: Mapping[str, object]) -> dict[str, object]:
    """Return a row without its volatile columns, such that equal ones are the same bit for bit."""
    return {k: v.hex() if isinstance(v, float) else v for k, v in row.items() if k not in VOLATILE}
