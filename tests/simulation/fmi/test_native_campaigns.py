"""Campaigns against the core: all tests of FMUs under sanitizers, and simulations that come and go by ten thousands."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest

from fmuid.data.experiment import Experiment
from fmuid.models.component import Numerics
from fmuid.models.fmu import FMU
from fmuid.models.system import System
from fmuid.simulation.native import build
from fmuid.simulation.simulator import Simulator
from tests.support.paths import FMUS
from tests.support.sanitizers import SANITIZE, assert_nothing_found, needs_sanitizers

TESTS = [
    *(
        f"simulation/fmi/test_{name}"
        for name in ("native", "integrators", "model_exchange", "fmi3", "float_environment")
    ),
    *(f"simulation/test_{name}" for name in ("state_sizes", "sensitivities", "simulator")),
    *("models/test_system", "models/test_loops"),
]


@pytest.mark.slow
@needs_sanitizers
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    library = tmp_path / "core.so"
    flags = ["-std=c11", "-ffp-contract=off", build.DEFINED, *SANITIZE]
    subprocess.run(["gcc", *flags, *map(str, build.sources()), "-o", str(library), "-lm"], check=True)
    assert_nothing_found("tests.support.sanitized_core", TESTS, SANITIZED_CORE=str(library))


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("name", sorted(path.stem for path in FMUS.glob("*/*.fmu")))
@pytest.mark.parametrize(
    "count", [pytest.param(200, marks=pytest.mark.slow), pytest.param(2000, marks=pytest.mark.campaign)]
)
def test_simulations_leave_nothing_behind(name: str, kind: str, count: int) -> None:
    """Ten times as many simulations are the same bit for bit, and take no more memory than the first tenth."""
    fmu = FMU(FMUS / name / f"{name}.fmu")
    if kind not in fmu.description.interfaces:
        pytest.skip("it has no such interface")
    variables = fmu.description.variables.items()
    inputs = [name for name, variable in variables if variable.causality == "input"]
    outputs = [name for name, variable in variables if variable.causality == "output"]
    columns = {f"in {name}": 0.1 * (k + 1) * np.ones(4) for k, name in enumerate(inputs)}
    frame = pd.DataFrame({"time": np.linspace(0.0, 3e-3, 4), "out": 0.0, **columns})
    experiment = Experiment(
        frame, {name: f"in {name}" for name in inputs}, dict.fromkeys(outputs[:3], "out"), interpolation="zoh"
    )
    simulator = Simulator(System(fmu.path, numerics=Numerics(kind)), experiment)
    first = simulator([])
    process, sizes = psutil.Process(), []
    for _ in range(10):
        found = simulator(np.zeros((count, 0)))
        assert (found == first).all()
        sizes.append(process.memory_info().rss)
    simulator.close()
    assert sizes[-1] - sizes[0] < 2e6
