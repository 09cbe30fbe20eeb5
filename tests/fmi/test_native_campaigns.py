"""Campaigns against the core: all tests of FMUs under sanitizers, and simulations that come and go by ten thousands."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest

from fmuid.data.experiment import Experiment
from fmuid.fmi.fmu import FMU
from fmuid.fmi.native import build
from fmuid.models.component import Numerics
from fmuid.models.system import System
from fmuid.simulation.simulator import Simulator
from tests.support.paths import FMUS, ROOT

pytestmark = pytest.mark.slow
TESTS = [
    *("test_native", "test_integrators", "test_model_exchange", "test_fmi3", "test_float_environment"),
    *("../models/test_system", "../simulation/test_sensitivities", "../simulation/test_simulator"),
]


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("gcc") is None, reason="needs gcc's sanitizers")
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    library = tmp_path / "core.so"
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-O1", "-g"]
    flags = ["-std=c11", "-ffp-contract=off", "-shared", "-fPIC", *sanitize]
    subprocess.run(["gcc", *flags, *map(str, build.sources()), "-o", str(library), "-lm"], check=True)
    told = [
        subprocess.run(["gcc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True, check=True)
        for name in ("asan", "ubsan")
    ]
    environment = os.environ | {
        "LD_PRELOAD": " ".join(each.stdout.strip() for each in told),
        "ASAN_OPTIONS": "detect_leaks=0,handle_segv=0",  # Python leaks at its end
        "SANITIZED_CORE": str(library),
    }
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-s", "-p", "no:faulthandler"]
    files = [str(ROOT / "tests" / "fmi" / f"{name}.py") for name in TESTS]
    run = subprocess.run(
        [*command, "-p", "tests.support.sanitized_core", *files],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("name", sorted(path.stem for path in FMUS.glob("*/*.fmu")))
def test_simulations_leave_nothing_behind(name: str, kind: str) -> None:
    """20,000 simulations are the same bit for bit, and take no more memory than the first 2,000."""
    fmu = FMU(FMUS / name / f"{name}.fmu")
    if kind not in fmu.description.interfaces:
        pytest.skip("it has no such interface")
    variables = fmu.description.variables.items()
    inputs = [name for name, variable in variables if variable.causality == "input"]
    outputs = [name for name, variable in variables if variable.causality == "output"]
    columns = {f"in {name}": 0.1 * (k + 1) * np.ones(4) for k, name in enumerate(inputs)}
    frame = pd.DataFrame({"time": np.linspace(0.0, 3e-3, 4), "out": 0.0, **columns})
    experiment = Experiment(
        frame, {name: f"in {name}" for name in inputs}, dict.fromkeys(outputs[:3], "out"), interpolation="hold"
    )
    simulator = Simulator(System(fmu.path, numerics=Numerics(kind)), experiment)
    first = simulator([])
    process, sizes = psutil.Process(), []
    for _ in range(10):
        found = simulator(np.zeros((2000, 0)))
        assert (found == first).all()
        sizes.append(process.memory_info().rss)
    simulator.system.close()
    assert sizes[-1] - sizes[0] < 2e6
