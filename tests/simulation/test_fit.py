"""The one measure of fit: NRMSE in % and RMSE, over counted samples, against the closed form."""

import math

import numpy as np
import pytest

from fmuid.array_types import Floats
from fmuid.simulation import OutputFit, nrmse_fit

TIMES = np.linspace(0.0, 10.0, 500)
SIGNAL = np.sin(TIMES)


def made(measured: Floats, simulated: Floats, counted: Floats | None = None) -> OutputFit:
    """Return the fit of outputs (K, n_outputs)."""
    names = tuple(f"y{j}" for j in range(measured.shape[1]))
    there = np.isfinite(measured) if counted is None else counted.astype(np.bool_)
    return OutputFit("run", TIMES, names, ("K",) * len(names), measured, simulated, there)


@pytest.mark.parametrize("offset", [0.0, 300.0, 1e6])
def test_fit_does_not_depend_on_the_mean(offset: float) -> None:
    """Kelvin and °C of one temperature fit alike; 0 is the mean, 100 the measurement itself."""
    error = 0.1 * np.cos(7.0 * TIMES)
    measured = offset + SIGNAL
    columns = np.column_stack([measured + error, np.full(500, measured.mean()), measured])
    found = made(np.column_stack([measured] * 3), columns)
    spread = np.linalg.norm(SIGNAL - SIGNAL.mean())
    assert found.fit == pytest.approx((100.0 * (1.0 - np.linalg.norm(error) / spread), 0.0, 100.0), abs=1e-6)
    assert found.rmse == pytest.approx((np.sqrt(np.mean(error**2)), np.std(SIGNAL), 0.0), abs=1e-9)


def test_fit_counts_counted_samples_only() -> None:
    """Gaps and the warm-up are in neither the errors nor the mean."""
    measured = np.column_stack([SIGNAL, 5.0 + SIGNAL])
    simulated = measured + 0.2
    measured[:100] += 50.0
    measured[200:220, 1] = np.nan
    counted = np.isfinite(measured) & (np.arange(500) >= 100)[:, None]
    found = made(measured, simulated, counted)
    for j in range(2):
        own = measured[counted[:, j], j]
        fit = 100.0 * (1.0 - 0.2 * math.sqrt(own.size) / np.linalg.norm(own - own.mean()))
        assert found.fit[j] == pytest.approx(fit)
        assert found.rmse[j] == pytest.approx(0.2)


def test_fit_of_experiments_takes_the_mean_of_each() -> None:
    pairs = [(SIGNAL, SIGNAL + 0.1), (100.0 + SIGNAL, 100.0 + SIGNAL - 0.1)]
    assert nrmse_fit(pairs) == pytest.approx(nrmse_fit(pairs[:1]))
