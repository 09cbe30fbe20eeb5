"""Records of a coil that warms up and fails."""

import math

import numpy as np
import pandas as pd

from experiments.coil import study as coil


def warming(
    seconds: int,
    to: float,
    fails: float = math.inf,
    size: float = 0.5,
    seed: int = 0,
    noise: float = 1.0,
    grows: float = 0.0,
) -> pd.DataFrame:
    """Return a record of the coil whose R rises from 4 Ω second by second, with ΔR = size from a time on; exact.

    ΔR grows by `grows` Ω in a second, in steps of 0.1 s.
    """
    rng = np.random.default_rng(seed)
    samples = 1000 * seconds
    voltage = np.repeat(rng.choice([-1.0, 1.0], samples // coil.BIT + 1), coil.BIT)[:samples]

    def at(k: int) -> tuple[float, float]:
        fault = size + grows * (k / 10 - fails) if k / 10 >= fails else 0.0
        return coil.R + (to - coil.R) * (k // 10) / seconds + fault, coil.L + 2 * coil.TAU * fault

    current = coil.piecewise(voltage, map(at, range(10 * seconds)), 100, 0.02)
    current += noise * math.sqrt(coil.NOISE_VARIANCE) * rng.standard_normal(samples)
    return pd.DataFrame({"time": coil.STEP * np.arange(samples), "u": voltage, "i": current})
