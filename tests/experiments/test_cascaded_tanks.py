"""The model of the cascaded tanks against its equations, integrated by scipy."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import fmuid
from fmuid.array_types import Floats
from fmuid.export import export_fmu
from tests.support.paths import ROOT

VALUES = {"u0": 0.7, "top1": 7.0, "top2": 6.5, "share": 0.9, "over": 0.1, "x1_start": 4.0, "x2_start": 5.0}


@pytest.mark.slow
def test_tanks_that_overflow(tmp_path: Path) -> None:
    fmu = export_fmu(ROOT / "experiments/cascaded_tanks/CascadedTanks.mo", tmp_path / "CascadedTanks.fmu")
    voltage = np.repeat([3.0, 5.0, 0.5, 4.0], 50)
    times = 4.0 * np.arange(voltage.size)
    frame = pd.DataFrame({"time": times, "u": voltage, "y": 0.0, "x1": 0.0})
    experiment = fmuid.Experiment(frame, ["u"], ["y", "x1"], interpolation="zoh")
    found = fmuid.Simulator(fmu, experiment, values=VALUES)([])

    def rates(_: float, x: Floats, u: float) -> list[float]:
        out = 0.039 * max(x[0], 1e-9) ** 0.5
        upper, lower = 0.1 * max(0.0, x[0] - 7.0), 0.1 * max(0.0, x[1] - 6.5)
        return [0.052 * max(0.0, u - 0.7) - out - upper, out + 0.9 * upper - 0.046 * max(x[1], 1e-9) ** 0.5 - lower]

    levels = [np.array([4.0, 5.0])]
    for u in voltage[:-1]:
        step = solve_ivp(rates, (0.0, 4.0), levels[-1], args=(u,), rtol=1e-9, atol=1e-12, max_step=0.5)
        levels.append(step.y[:, -1])
    expected = np.array(levels)
    assert expected[:, 0].max() > 7.1
    assert expected[:, 1].max() > 6.6
    np.testing.assert_allclose(found[:, 1], expected[:, 0], atol=2e-4)
    np.testing.assert_allclose(found[:, 0], np.minimum(expected[:, 1], 6.5), atol=2e-4)
