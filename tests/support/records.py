"""Fits and searches made up for figures."""

import numpy as np
import pandas as pd

from fmuid.simulation import OutputFit


def record(samples: int = 600, outputs: int = 2, name: str = "run", noise: float = 0.1) -> OutputFit:
    """Return a fit with known noise; the first 50 samples do not count and one output lacks some."""
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 1e-3 * (samples - 1), samples)
    simulated = np.stack([np.sin(20 * times * (k + 1)) for k in range(outputs)], axis=1)
    measured = simulated + noise * rng.normal(size=simulated.shape)
    measured[100:110, 0] = np.nan
    counted = ~np.isnan(measured)
    counted[:50] = False
    names = tuple(f"y{k}" for k in range(outputs))
    return OutputFit(name, times, names, ("A",) * outputs, measured, simulated, counted)


def search(names: tuple[str, ...] = ("R", "L")) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the trace of a search of five iterations, the third rejected, and its estimates."""
    values = {name: [5.0, 4.5, 9.0, 4.1, 4.0] for name in names}
    trace = pd.DataFrame(
        {
            "round": [1, 1, 1, 1, 2],
            "iteration": range(5),
            "cost": [900.0, 500.0, 700.0, 110.0, 100.0],
            "damping": [np.nan, 1.0, 0.1, 1.0, np.nan],
            "accepted": [True, True, False, True, True],
            **values,
        }
    )
    estimates = pd.DataFrame({"parameter": names, "value": 4.0, "std": 0.1, "start": 5.0, "unit": "Ohm"})
    shift = pd.DataFrame({"solver_error": 0.01, "lower": 3.8, "upper": 4.2}, index=estimates.index)
    return trace, estimates.assign(prior_mean=np.nan, prior_std=np.nan, **shift)
