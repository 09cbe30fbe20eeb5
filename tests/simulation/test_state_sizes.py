"""States whose FMU states no nominal value are integrated as accurately in tiny signals as in those of order one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.data.experiment import Experiment
from fmuid.simulation.simulator import Simulator
from tests.support.stepping import LAG, stepping_fmu

K = 100.0


@pytest.fixture(scope="module")
def lag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stepping_fmu(tmp_path_factory.mktemp("lag"), LAG, exchange=True)


@pytest.mark.parametrize("step", [1e-3, 1e-2, 1e-1], ids=["fast", "like", "slow"])
@pytest.mark.parametrize("size", [1e-15, 1e-9, 1e-6, 1.0, 1e9])
@pytest.mark.parametrize(("integrator", "error"), [("rk45", 1e-4), ("cvode", 1e-3)])
def test_states_of_every_size(lag: Path, integrator: str, error: float, size: float, step: float) -> None:
    """x' = u - k x from zero against its closed form, u held over a tenth, one and ten time constants."""
    u = size * np.random.default_rng(1).choice([-1.0, 1.0], 50)
    x = np.zeros(50)
    for i in range(49):
        x[i + 1] = u[i] / K + (x[i] - u[i] / K) * np.exp(-K * step)
    frame = pd.DataFrame({"time": step * np.arange(50), "u": u, "x": x})
    simulator = Simulator(
        lag,
        Experiment(frame, ["u"], ["x"], interpolation="zoh"),
        ["k"],
        interface="model-exchange",
        integrator=integrator,
    )
    np.testing.assert_allclose(simulator([K])[:, 0], x, rtol=0.0, atol=error * np.abs(x).max())
