"""The script that makes the induction machine's table: its machine, its shaft, its straight lines, and the table."""

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from experiments.induction_machine import chapter, make_table
from fmuid.data.signals import T23

Array = npt.NDArray[np.floating]

TABLE = chapter.HERE / "table.csv"
SAMPLES = 190  # 0.13 s: the start, and the first change of the reference
TRUTH = make_table.TRUTH

PHASES = 2 * np.pi / 3 * np.arange(3)
OWN = TRUTH["Lm"] * (np.eye(3) - 1 / 3)
"""Magnetising inductances of stator or rotor, H: L_p = 2/3 L_m on the diagonal, -L_p/2 off it."""
FREE = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
"""Rotor currents from the first two: the rotor has no zero sequence, along which its inductances are singular."""


@pytest.fixture(scope="module")
def steps() -> pd.DataFrame:
    """What the FMUs exchange at every communication step of the same samples."""
    columns = make_table.RECORDED | {"w": "shaft.w", "torque": "machine.torque"}
    columns |= {f"u{phase}": f"inverter.u{phase}" for phase in "abc"}
    count = SAMPLES * make_table.SUBSTEPS
    reference = np.repeat(make_table.speed_reference(SAMPLES), make_table.SUBSTEPS)
    return make_table.record(make_table.SAMPLE_TIME / make_table.SUBSTEPS * np.arange(count), reference, columns)


def currents_and_torque(state: Array) -> tuple[Array, float]:
    """Return the currents (three of the stator, the first two of the rotor), A, and the torque, N m.

    The fluxes of (1.58) are solved for the currents; the torque is the derivative of the co-energy by the angle.
    """
    angles = state[5] + PHASES[np.newaxis, :] - PHASES[:, np.newaxis]
    mutual = TRUTH["Lm"] * 2 / 3 * np.cos(angles)
    inductances = np.empty((5, 5))
    inductances[:3, :3] = OWN + TRUTH["Lf"] * np.eye(3)
    inductances[:3, 3:] = mutual @ FREE
    inductances[3:, :3] = mutual.T[:2]
    inductances[3:, 3:] = (OWN @ FREE)[:2]
    currents = np.linalg.solve(inductances, state[:5])
    turned = -TRUTH["Lm"] * 2 / 3 * np.sin(angles)
    return currents, float(make_table.POLE_PAIRS * currents[:3] @ turned @ FREE @ currents[3:])


def slope(state: Array, voltages: Array, speed: float) -> Array:
    """Return the time derivative of three stator fluxes, the first two rotor fluxes (Wb) and the electrical angle."""
    currents, _ = currents_and_torque(state)
    return np.array([*(voltages - TRUTH["Rs"] * currents[:3]), *(-TRUTH["Rr"] * currents[3:]), speed])


@pytest.mark.slow
def test_the_machine_is_that_of_the_chapter(steps: pd.DataFrame) -> None:
    """(1.58) with its matrices, by Runge-Kutta 4 under the same held voltages and speed: 1e-8 A is its own error."""
    h = float(steps["time"].iloc[1])
    state: Array = np.zeros(6)
    found = []
    for voltages, speed in zip(steps[["ua", "ub", "uc"]].to_numpy(), steps["w"].to_list(), strict=True):
        currents, torque = currents_and_torque(state)
        found.append([*currents[:3], state[5], torque])
        first = slope(state, voltages, speed)
        second = slope(state + h / 2 * first, voltages, speed)
        third = slope(state + h / 2 * second, voltages, speed)
        fourth = slope(state + h * third, voltages, speed)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    expected = np.array(found)
    assert np.abs(expected[:, :3]).max() > 4.0  # the machine is excited here
    assert np.abs(expected[:, 4]).max() > 4.0
    np.testing.assert_allclose(steps[["ia", "ib", "ic", "theta", "torque"]], expected, rtol=0, atol=1e-7)


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


def test_the_experiment_is_the_chapters() -> None:
    """750 rpm and 90 rpm either way, within what an inverter and a 1.1 kW machine can do; noise variance 0.0462."""
    table = pd.read_csv(TABLE)
    speed = table["w"] / make_table.POLE_PAIRS * 60 / (2 * np.pi)
    assert speed.between(630, 870).all()
    assert np.ptp(speed) > 170
    assert np.hypot(table["uds"], table["uqs"]).max() < 380
    assert np.hypot(table["ids"], table["iqs"]).max() < 9
    # The second differences of the smooth currents nearly vanish; those of white noise have six times its variance.
    assert np.diff(table["ids"][2000:2500], n=2).var() / 6 == pytest.approx(0.0462, rel=0.3)
