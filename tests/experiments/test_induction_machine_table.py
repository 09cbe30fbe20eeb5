"""The script that makes the induction machine's table: its machine, its shaft, its straight lines, and the table."""

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from experiments.induction_machine import chapter, make_table
from fmuid.data.signals import T23

TABLE = chapter.HERE / "table.csv"
SAMPLES = 190  # 0.13 s: the start, and the first change of the reference


@pytest.fixture(scope="module")
def steps() -> pd.DataFrame:
    """What the FMUs exchange at every communication step of the same samples."""
    columns = make_table.RECORDED | {"w": "shaft.w", "torque": "machine.torque"}
    columns |= {f"u{phase}": f"inverter.u{phase}" for phase in "abc"}
    count = SAMPLES * make_table.SUBSTEPS
    reference = np.repeat(make_table.speed_reference(SAMPLES), make_table.SUBSTEPS)
    return make_table.record(make_table.SAMPLE_TIME / make_table.SUBSTEPS * np.arange(count), reference, columns)


def test_the_shaft_and_its_load(steps: pd.DataFrame) -> None:
    """J dΩ/dt = torque − f Ω in closed form under the held torque, and the mean speed that the machine is given."""
    J, f, h = 0.02, make_table.LOAD, float(steps["time"].iloc[1])
    torque, speed = steps["torque"].to_numpy(), steps["speed"].to_numpy()
    decay = np.exp(-f / J * h)
    np.testing.assert_allclose(speed[1:], decay * speed[:-1] + (1 - decay) * torque[:-1] / f, rtol=1e-12)
    means = make_table.POLE_PAIRS * (speed[1:] + speed[:-1]) / 2
    assert np.abs(np.diff(speed)).max() > 1e-3
    np.testing.assert_allclose(steps["w"][:-1], means, rtol=1e-7)


def test_the_inverter_gives_the_mean_of_its_voltage(steps: pd.DataFrame) -> None:
    """The mean over a step of the voltage of the turning axes: a cubic spline, integrated; mV are left."""
    c, s = np.cos(steps["theta"].to_numpy()), np.sin(steps["theta"].to_numpy())
    axes = steps[["uds", "uqs"]].to_numpy().T
    times, fixed = steps["time"].to_numpy(), np.array([c * axes[0] - s * axes[1], s * axes[0] + c * axes[1]]).T
    means = np.diff(CubicSpline(times, fixed).antiderivative()(times), axis=0) / times[1] @ T23
    assert np.abs(means).max() > 150
    np.testing.assert_allclose(steps[["ua", "ub", "uc"]][:-1], means, rtol=0, atol=0.01)


def test_the_committed_table_is_what_the_script_makes(clean: pd.DataFrame) -> None:
    table = pd.read_csv(TABLE)
    assert list(table.columns) == ["time", "uds", "uqs", "w", "ids", "iqs"]
    assert len(table) == 4500
    np.testing.assert_allclose(table["time"], np.arange(4500) * 0.7e-3, rtol=1e-8)
    made = make_table.add_noise(clean, make_table.NOISE_VARIANCE, np.random.default_rng(make_table.SEED))
    np.testing.assert_allclose(table, made, rtol=1e-8, atol=1e-8)  # nine digits are printed
