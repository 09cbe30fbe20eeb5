"""The fault models at zero fault, against the windings they stand for, and beside a machine in a system.

Their equations as such are held in tests/fmus/test_models.py.
"""

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import fmuid
from experiments.machine_faults import models
from tests.support.paths import FMUS
from tests.support.winding_machine import CONTACT, STUDY_AXES, Condition, excitation, leaking_stator, tables
from tests.support.winding_machine import MACHINE as MACHINE_IN_WINDINGS

Array = npt.NDArray[np.floating]

MACHINE = {"Rs": 8.5, "Rr": 4.4, "Lm": 0.39, "Lf": 0.081}
INPUTS = ["uds", "uqs", "w"]


def path(model: str) -> Path:
    return FMUS / model / f"{model}.fmu"


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    """Voltages and speed of a machine at about 50 Hz, the angle that belongs to them, and some of each phase."""
    rng = np.random.default_rng(1)
    times = 7e-4 * np.arange(200)
    angle = 300.0 * times
    speed = 290.0 + 3.0 * rng.standard_normal(200)
    ud, uq = 280.0 * np.cos(angle - 290.0 * times), 280.0 * np.sin(angle - 290.0 * times)
    columns = {"time": times, "uds": ud, "uqs": uq, "w": speed, "theta": 290.0 * times, "u": ud / 100.0}
    return pd.DataFrame(columns)


def run(model: Any, frame: pd.DataFrame, inputs: list[str], outputs: list[str], values: dict[str, float]) -> Array:
    wanted = frame.assign(**dict.fromkeys(outputs, 0.0))
    return fmuid.Simulator(model, fmuid.Experiment(wanted, inputs, outputs), values=values)([])


COIL = {"R": 3.3, "L": 0.08, "i_start": 0.4}
STATES = ["ids", "iqs", "phidr", "phiqr"]
TURNED, CAGE = MACHINE | {"theta0": 1.1}, MACHINE | {"theta0": 1.1, "ring": 0.05}


@pytest.mark.parametrize(
    ("healthy", "faulty", "outputs", "values", "fault", "tolerance"),
    [
        ("Coil", "FaultyCoil", ["i"], COIL, {"dR": 0.01}, 0.0),
        ("Coil", "CoilTurns", ["i"], COIL, {"lost": 0.01}, 0.0),
        ("InductionMachine", "InductionMachineRotorFault", STATES, MACHINE, {"eta0": 0.1}, 1e-11),
        ("InductionMachine", "InductionMachineRotorFault", STATES, TURNED, {"eta0": 0.1}, 1e-11),
        ("InductionMachine", "InductionMachineBrokenBars", STATES, CAGE, {"crack0": 0.5}, 1e-11),
    ],
)
def test_zero_fault_is_the_healthy_machine(
    frame: pd.DataFrame,
    healthy: str,
    faulty: str,
    outputs: list[str],
    values: dict[str, float],
    fault: dict[str, float],
    tolerance: float,
) -> None:
    inputs = ["u"] if healthy == "Coil" else INPUTS
    known = {name: value for name, value in values.items() if name not in ("theta0", "ring")}
    sound = run(path(healthy), frame, inputs, outputs, known)
    assert np.ptp(sound) > 0.1
    found = run(path(faulty), frame, inputs, outputs, values)
    np.testing.assert_allclose(found, sound, rtol=0, atol=tolerance * np.abs(sound).max())
    assert np.abs(run(path(faulty), frame, inputs, outputs, values | fault) - sound).max() > 1e-4


def test_zero_short_circuit_is_the_healthy_stator(frame: pd.DataFrame) -> None:
    """Beside a machine (figure 1.7), by the connectors of the system: the machine's currents, to the bit."""
    outputs = ["machine.ids + fault.ids", "machine.iqs + fault.iqs"]
    healthy = run(path("InductionMachine"), frame, INPUTS, ["ids", "iqs"], MACHINE)
    found = run(models.stator(), frame, [*INPUTS, "theta"], outputs, MACHINE)
    np.testing.assert_array_equal(found, healthy)
    stator = ["uds", "uqs", "theta"], ["ids", "iqs"]
    for name in ("StatorShortCircuitContact", "StatorShortCircuitLeakage"):
        np.testing.assert_array_equal(run(path(name), frame, *stator, {"Rs": 8.5}), 0.0)


@pytest.mark.parametrize("phase", range(3))
def test_shorted_turns_of_one_phase(frame: pd.DataFrame, phase: int) -> None:
    """A current η u/R_s in one phase alone, u being the voltage of that phase, transformed by the table's own way."""
    phases = fmuid.data.signals.inverse_park(frame, ["uds", "uqs"], ["ua", "ub", "uc"])
    ratio, names = 0.03, ["ia", "ib", "ic"]
    voltage = phases[["ua", "ub", "uc"]].to_numpy()[:, phase]
    currents = np.zeros((len(frame), 3))
    currents[:, phase] = ratio / MACHINE["Rs"] * voltage
    expected = fmuid.signals.park_transform(
        phases.assign(**dict(zip(names, currents.T, strict=True))), names, ["d", "q"]
    )
    values = {"Rs": MACHINE["Rs"], f"eta_{'abc'[phase]}": ratio}
    found = run(path("StatorShortCircuit"), frame, ["uds", "uqs", "theta"], ["ids", "iqs"], values)
    np.testing.assert_allclose(found, expected[["d", "q"]], rtol=0, atol=1e-12)


def test_broken_bars_of_a_cage() -> None:
    """R_eq is the inverse of the conductance of the 28 bars less one, all between rings of equal potential."""
    bars, broken, Rr = 28, 5, 4.4
    angles = 2 * np.pi * 2 * np.arange(bars) / bars
    axes = np.array([np.cos(angles), np.sin(angles)])
    there = np.arange(bars) != broken
    resistance = np.linalg.inv(2 / bars / Rr * axes[:, there] @ axes[:, there].T)
    state = {"ids_start": 1.3, "iqs_start": -0.6, "phidr_start": 0.4, "phiqr_start": 0.7}
    values = MACHINE | state | {"eta0": 3 / bars, "theta0": float(angles[broken])}
    fmu = fmpy.read_model_description(str(path("InductionMachineRotorFault")))
    assert {v.name: v.nominal for v in fmu.modelVariables if v.name in ("eta0", "theta0")} == {
        "eta0": "0.1",
        "theta0": "1.0",
    }
    frame = pd.DataFrame({"time": [0.0, 1e-6], "uds": 0.0, "uqs": 0.0, "w": 0.0})
    fluxes = run(path("InductionMachineRotorFault"), frame, INPUTS, ["phidr", "phiqr"], values)
    currents = np.array([1.3, -0.6]) - np.array([0.4, 0.7]) / MACHINE["Lm"]
    np.testing.assert_allclose(np.diff(fluxes, axis=0)[0] / 1e-6, resistance @ currents, rtol=1e-3)


def test_a_broken_bar_between_rings_of_no_resistance(frame: pd.DataFrame) -> None:
    """α = 2/(n − 1), the existing model's with as many bars less one."""
    cage = run(
        path("InductionMachineBrokenBars"), frame, INPUTS, STATES,
        MACHINE | {"crack0": 1.0, "theta0": 0.7, "ring": 1e-6, "bars": 28.0},
    )  # fmt: skip
    rotor = run(path("InductionMachineRotorFault"), frame, INPUTS, STATES, MACHINE | {"eta0": 3 / 27, "theta0": 0.7})
    np.testing.assert_allclose(cage, rotor, rtol=0, atol=1e-4 * np.abs(rotor).max())


def test_leaking_turns_settle_at_those_without_leakage(frame: pd.DataFrame) -> None:
    """One phase, constant voltages: after many lags the current is that of StatorShortCircuitContact."""
    held = frame.assign(uds=90.0, uqs=-50.0, theta=0.7)
    given, stator = {"Rs": 8.5, "eta_b": 0.12, "contact": 0.05}, (["uds", "uqs", "theta"], ["ids", "iqs"])
    expected = run(path("StatorShortCircuitContact"), held, *stator, given)
    found = run(path("StatorShortCircuitLeakage"), held, *stator, given | {"own": 0.2})
    np.testing.assert_allclose(found[-1], expected[-1], rtol=1e-9)
    assert abs(found[2] - expected[2]).max() > 0.01 * abs(expected[2]).max()


@pytest.mark.parametrize(
    ("turns", "own"),
    [(0.1, 0.05), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.02, 0.3), (0.3, 0.4)))],
)
def test_leaking_turns_are_those_of_a_machine_in_its_windings(turns: float, own: float) -> None:
    """Beside the machine, at varying speed; phase b, from the same contact."""
    (table,) = tables([excitation(500, 5)], [Condition(turns=turns, phase=1, own=own)], 0.0, 1)
    fault = leaking_stator(())
    machine = {"Rs": "Rs", "Lf": "Lf", "Rr": "machine.Rr", "Lm": "machine.Lm"}
    values = {machine[name]: value for name, value in MACHINE_IN_WINDINGS.items()}
    values |= {"fault.own": own, "fault.contact": CONTACT, "fault.eta_b": turns}
    experiment = fault.renamed(fmuid.Experiment(table, ["w"], observation=STUDY_AXES))
    found = fmuid.Simulator(fault.model, experiment, values=values)([])
    np.testing.assert_allclose(found, table[["ia", "ib"]], rtol=0, atol=1e-5)
    assert abs(fmuid.Simulator(fault.model, experiment, values=values | {"fault.eta_b": 0.0})([]) - found).max() > 0.1
