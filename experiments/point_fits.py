"""Processor time of fits of 60 points without a time axis, beside that of the FMU; best of 20.

python -m experiments.point_fits
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd

import fmuid
from fmuid.data import FrequencyExperiment, Response, RotatingFrame, SteadyExperiment
from fmuid.simulation.simulation_loop import SimulationLoop
from tests.support.exported import export_text
from tests.support.paths import FMUS
from tests.support.resting import MACHINE, SATURATED, induction_machine, saturated_motor

LEVEL = 0.003
COIL = fmuid.datasets.coil().fmu


def spectrum(random: np.random.Generator) -> fmuid.Problem:
    """Return a coil's impedance at 60 frequencies."""
    frequencies = np.logspace(-1.0, 2.0, 60)
    noise = LEVEL * (random.normal(size=60) + 1j * random.normal(size=60))
    values = (4.0 + 0.2j * np.pi * frequencies) * (1.0 + noise)
    frame = pd.DataFrame({"f": frequencies, "re": values.real, "im": values.imag})
    response = {"Z": Response("u / i", real="re", imaginary="im")}
    free = {"R": fmuid.Parameter(3.0, min=0.1), "L": fmuid.Parameter(0.2, min=0.01)}
    return fmuid.Problem(COIL, FrequencyExperiment(frame, frequency="f", responses=response), free)


def load_points(random: np.random.Generator) -> fmuid.Problem:
    """Return 60 load points of an induction machine by its circuit."""
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
    """Return 60 load points of a motor with a saturated field, by fsolve."""
    truth = {"R": 0.6, "k": 1.1, "c": 900.0, "b": 2e-3}
    points = np.array([(u, load) for u in np.linspace(12.0, 96.0, 15) for load in (0.2, 1.0, 2.0, 3.0)])
    values = saturated_motor(np.array(list(truth.values())), points) * (1.0 + LEVEL * random.normal(size=(60, 2)))
    frame = pd.DataFrame(np.hstack([points, values]), columns=["u", "load", "i", "w"])
    free = {name: fmuid.Parameter(1.3 * value, min=1e-6) for name, value in truth.items()}
    return fmuid.Problem(fmu, SteadyExperiment(frame, ["u", "load"], ["i", "w"]), free)


def own_time(make: Callable[[], fmuid.Problem]) -> tuple[float, float]:
    """Return processor time of the best of 20 fits beside its FMU's, and the FMU's, s."""
    inside, run, found = list[float](), SimulationLoop.run, []

    def timed(loop: SimulationLoop, *given: Any) -> None:
        begin = time.process_time()
        run(loop, *given)
        inside.append(time.process_time() - begin)

    with mock.patch.object(SimulationLoop, "run", timed):
        for _ in range(20):
            problem = make()
            inside.clear()
            begin = time.process_time()
            if not fmuid.identify(problem).converged:
                raise SystemExit("a fit did not converge")
            spent = sum(inside)
            found.append((time.process_time() - begin - spent, spent))
    return min(found)


def main() -> None:
    """Print the times of three kinds of points."""
    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        fmu = export_text(Path(folder), SATURATED)
        makers: dict[str, Callable[[], fmuid.Problem]] = {
            "spectrum": lambda: spectrum(random),
            "load points": lambda: load_points(random),
            "saturated": lambda: saturated(random, fmu),
        }
        for name, make in makers.items():
            beside, spent = own_time(make)
            print(f"{name}: {1e3 * beside:.1f} ms beside {1e3 * spent:.1f} ms of the FMU")


if __name__ == "__main__":
    main()
