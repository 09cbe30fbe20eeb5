"""The script that makes the induction machine's table, against the Park equations and against the committed table."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from fmuid.transforms import park

FOLDER = Path(__file__).parents[1] / "experiments" / "induction_machine"
SAMPLES = 150


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_table", FOLDER / "make_table.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def frame(script: ModuleType) -> pd.DataFrame:
    simulated: pd.DataFrame = script.simulate(SAMPLES)
    return simulated


def test_the_three_phase_machine_is_the_park_machine(script: ModuleType, frame: pd.DataFrame) -> None:
    """Park's equations (method.md section 8) with the torque p (φ_dr i_qs − φ_qr i_ds), under the same voltages."""
    Rs, Rr, Lm, Lf = (script.TRUTH[name] for name in ("Rs", "Rr", "Lm", "Lf"))
    times, voltages = frame["time"].to_numpy(), frame[["uds", "uqs"]].to_numpy()

    def slope(t: float, x: np.ndarray, k: int) -> list[float]:
        share = (t - times[k]) / (times[k + 1] - times[k])
        ud, uq = voltages[k] + share * (voltages[k + 1] - voltages[k])
        id_, iq, fd, fq, speed = x
        w = script.POLE_PAIRS * speed
        return [
            (ud - (Rs + Rr) * id_ + w * Lf * iq + Rr / Lm * fd + w * fq) / Lf,
            (uq - (Rs + Rr) * iq - w * Lf * id_ + Rr / Lm * fq - w * fd) / Lf,
            Rr * id_ - Rr / Lm * fd,
            Rr * iq - Rr / Lm * fq,
            (script.POLE_PAIRS * (fd * iq - fq * id_) - script.LOAD * speed) / script.INERTIA,
        ]

    states = np.zeros((SAMPLES, 5))
    states[0, 4] = 750 * 2 * np.pi / 60
    for k in range(SAMPLES - 1):
        span = (times[k], times[k + 1])
        states[k + 1] = solve_ivp(slope, span, states[k], "DOP853", rtol=1e-11, atol=1e-12, args=(k,)).y[:, -1]
    assert np.abs(states[:, :2]).max() > 4.0  # the machine is excited here
    np.testing.assert_allclose(frame[["ids", "iqs"]], states[:, :2], rtol=0, atol=1e-7)
    np.testing.assert_allclose(frame["w"], script.POLE_PAIRS * states[:, 4], rtol=1e-9)


def test_phases_and_park_axes_agree(frame: pd.DataFrame) -> None:
    for letter in "ui":
        axes = park(frame, [f"{letter}{phase}" for phase in "abc"], ["d", "q"])
        np.testing.assert_allclose(axes[["d", "q"]], frame[[f"{letter}ds", f"{letter}qs"]], rtol=0, atol=1e-10)


def test_the_committed_table_is_what_the_script_makes(script: ModuleType, frame: pd.DataFrame) -> None:
    table = pd.read_csv(FOLDER / "table.csv")
    assert list(table.columns) == ["time", "uds", "uqs", "w", "ids", "iqs"]
    assert len(table) == 4500
    np.testing.assert_allclose(table["time"], np.arange(4500) * 0.7e-3, rtol=1e-8)
    made = script.add_noise(frame, script.NOISE_VARIANCE, np.random.default_rng(script.SEED))
    np.testing.assert_allclose(table[:SAMPLES], made, rtol=1e-7, atol=1e-7)


def test_the_experiment_is_the_chapters(script: ModuleType) -> None:
    """750 rpm and 90 rpm either way, within what an inverter and a 1.1 kW machine can do; noise variance 0.0462."""
    table = pd.read_csv(FOLDER / "table.csv")
    rpm = script.speed_reference(4500) * 60 / (2 * np.pi)
    np.testing.assert_allclose(np.unique(rpm.round(9)), [660.0, 840.0])
    speed = table["w"] / script.POLE_PAIRS * 60 / (2 * np.pi)
    assert speed.between(630, 870).all()
    assert speed.min() < 665
    assert speed.max() > 835
    assert np.hypot(table["uds"], table["uqs"]).max() < 380
    assert np.hypot(table["ids"], table["iqs"]).max() < 9
    noise = script.add_noise(table, script.NOISE_VARIANCE, np.random.default_rng(5)) - table
    for name in ("ids", "iqs"):  # variance within four standard deviations of its estimate
        assert noise[name].var() == pytest.approx(0.0462, abs=4 * 0.0462 * np.sqrt(2 / 4500))
    assert abs(np.corrcoef(noise["ids"], noise["iqs"])[0, 1]) < 4 / np.sqrt(4500)
    # The second differences of the smooth currents nearly vanish; those of white noise have six times its variance.
    calm = table[2000:2500]
    assert np.diff(calm["ids"], n=2).var() / 6 == pytest.approx(0.0462, rel=0.3)
