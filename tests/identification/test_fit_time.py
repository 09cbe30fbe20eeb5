"""Time of fits of 60 points without a time axis, beside that of the FMU."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.data import FrequencyExperiment, Response, RotatingFrame, SteadyExperiment
from fmuid.simulation.simulation_loop import SimulationLoop
from tests.support.paths import FMUS
from tests.support.resting import MACHINE, SATURATED, induction_machine, saturated_motor

LEVEL = 0.003
COIL = fmuid.datasets.coil().fmu


def spectrum(random: np.random.Generator) -> fmuid.Problem:
    frequencies = np.logspace(-1.0, 2.0, 60)
    noise = LEVEL * (random.normal(size=60) + 1j * random.normal(size=60))
    values = (4.0 + 0.2j * np.pi * frequencies) * (1.0 + noise)
    frame = pd.DataFrame({"f": frequencies, "re": values.real, "im": values.imag})
    response = {"Z": Response("u / i", real="re", imaginary="im")}
    free = {"R": fmuid.Parameter(3.0, min=0.1), "L": fmuid.Parameter(0.2, min=0.01)}
    return fmuid.Problem(COIL, FrequencyExperiment(frame, frequency="f", responses=response), free)


def load_points(random: np.random.Generator) -> fmuid.Problem:
    points = [(u, s) for u in (120.0, 180.0, 230.0) for s in np.geomspace(0.001, 1.0, 20)]
    found = [(u, s, *induction_machine(u, s)[:2]) for u, s in points]
    frame = pd.DataFrame(found, columns=["U", "s", "I", "P"])
    frame["P"] = frame["P"].to_numpy().real
    frame[["I", "P"]] *= 1.0 + LEVEL * random.normal(size=(60, 2))
    supply = RotatingFrame(50.0, "U", slip="s")
    free = {name: fmuid.Parameter(1.2 * value, min=1e-3) for name, value in MACHINE.items()}
    experiment = SteadyExperiment(frame, outputs={"I_rms": "I", "P": "P"}, supply=supply)
    return fmuid.Problem(FMUS / "InductionMachine/InductionMachine.fmu", experiment, free)


def saturated(random: np.random.Generator, fmu: Path) -> fmuid.Problem:
    truth = {"R": 0.6, "k": 1.1, "c": 900.0, "b": 2e-3}
    points = np.array([(u, load) for u in np.linspace(12.0, 96.0, 15) for load in (0.2, 1.0, 2.0, 3.0)])
    values = saturated_motor(np.array(list(truth.values())), points) * (1.0 + LEVEL * random.normal(size=(60, 2)))
    frame = pd.DataFrame(np.hstack([points, values]), columns=["u", "load", "i", "w"])
    free = {name: fmuid.Parameter(1.3 * value, min=1e-6) for name, value in truth.items()}
    return fmuid.Problem(fmu, SteadyExperiment(frame, ["u", "load"], ["i", "w"]), free)


def own_time(make: Callable[[], fmuid.Problem], monkeypatch: pytest.MonkeyPatch) -> tuple[float, float]:
    """Return processor time of the best of 20 fits beside its FMU's, and the FMU's, s."""
    inside, run = [], SimulationLoop.run

    def timed(loop: SimulationLoop, *given: np.ndarray) -> None:
        begin = time.process_time()
        run(loop, *given)
        inside.append(time.process_time() - begin)

    monkeypatch.setattr(SimulationLoop, "run", timed)
    found = []
    for _ in range(20):
        problem = make()
        inside.clear()
        begin = time.process_time()
        assert fmuid.identify(problem).converged
        spent = sum(inside)
        found.append((time.process_time() - begin - spent, spent))
    return min(found)


@pytest.mark.campaign
@pytest.mark.parametrize(("name", "most"), [("spectrum", 0.05), ("load points", 0.05), ("saturated", 0.1)])
def test_sixty_points_are_fitted_in_50_ms(
    made: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, name: str, most: float
) -> None:
    """Twice as long where Newton's method finds the states."""
    random, fmu = np.random.default_rng(1), made(SATURATED)
    makers: dict[str, Callable[[np.random.Generator], fmuid.Problem]] = {
        "spectrum": spectrum,
        "load points": load_points,
        "saturated": lambda each: saturated(each, fmu),
    }
    beside, spent = own_time(lambda: makers[name](random), monkeypatch)
    print(f"{name}: {1e3 * beside:.1f} ms beside {1e3 * spent:.1f} ms of the FMU")
    assert beside <= most
