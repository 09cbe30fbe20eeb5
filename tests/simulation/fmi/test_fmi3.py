"""FMI 3.0, both kinds, through the master loop; events in both versions; sensitivities that an FMU outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fmuid import FMU, Component, Experiment, InputError, Numerics, Parameter, Problem, Simulator, System, identify
from fmuid.estimation import SensitivityMethod
from tests.support.closed_forms import coil_response
from tests.support.exported import export_text
from tests.support.paths import FMUS

COIL = FMUS / "Coil" / "Coil.fmu"
COIL_TEXT = (FMUS / "Coil" / "Coil.mo").read_text(encoding="utf-8")
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def coil3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("coil3"), COIL_TEXT, fmi="3.0")


def record(times: Array, **columns: Any) -> pd.DataFrame:
    return pd.DataFrame({"time": times, **columns})


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
def test_coil_of_fmi3_equals_its_closed_form(coil3: Path, kind: str, interpolation: str) -> None:
    assert FMU(coil3).description.major_version == 3
    rng = np.random.default_rng(3)
    times = 0.3 + np.cumsum(rng.uniform(1e-4, 2e-3, 300))
    times[200] = times[199]
    u = rng.normal(size=300)
    experiment = Experiment(record(times, u=u, i=0.0), ["u"], ["i"], interpolation=interpolation)
    system = System(coil3, numerics=Numerics(kind, tolerance=1e-11))
    got = Simulator(system, experiment, ["R", "L"])([[3.0, 0.05]] * 4)
    expected = coil_response(times, u, 3.0, 0.05, interpolation == "linear")
    # co-simulation of FMI 3.0 has no input slopes: ten substeps an interval hold the values at their middles
    tolerance = 5e-4 if (kind, interpolation) == ("co-simulation", "linear") else 1e-8
    assert np.abs(got[..., 0] - expected).max() < tolerance * np.abs(expected).max()


def test_versions_and_kinds_mix(coil3: Path) -> None:
    """Current of a coil of FMI 3.0 as the voltage of one of FMI 2.0, against the product of their time constants."""
    times = np.linspace(0.0, 0.2, 41)
    experiment = Experiment(record(times, u=1.0, i=0.0), {"one.u": "u"}, {"two.i": "i"})
    T = 0.1 / 4.0
    expected = (1.0 - np.exp(-times / T) * (1.0 + times / T)) / 16.0
    for first, second in (("co-simulation", "model-exchange"), ("model-exchange", "co-simulation")):
        system = System(
            components={"one": Component(coil3, Numerics(first)), "two": Component(COIL, Numerics(second))},
            connections=[("one.i", "two.u", 1.0, 0.0)],
            numerics=Numerics(step_size=1e-5),
        )
        got = Simulator(system, experiment)([])[:, 0]
        assert np.abs(got - expected).max() < 3e-4 * expected.max()  # values held over 10 us, of 25 ms: first order


def test_sensitivities_of_the_fmu_serve_the_search(tmp_path: Path) -> None:
    """The same optimum as by differences, from fewer simulations; the result says which served."""
    fmu = export_text(tmp_path, COIL_TEXT, sensitivities=["R", "L"])
    times: Array = np.linspace(0.0, 0.599, 600)
    u = np.sign(np.sin(0.13 * np.arange(600)))
    rng = np.random.default_rng(8)
    i = coil_response(times, u, 4.2, 0.09, False) + 0.01 * rng.normal(size=600)
    experiment = Experiment(record(times, u=u, i=i), ["u"], ["i"], interpolation="zoh")
    parameters = {"R": Parameter(start=6.0, min=0.0), "L": Parameter(start=0.05, min=1e-3)}
    by_fmu = identify(Problem(fmu, experiment, parameters, sensitivity="fmu"))
    by_differences = identify(Problem(fmu, experiment, parameters))
    assert by_fmu.converged
    assert np.abs((by_fmu.values - by_differences.values) / by_differences.std).max() < 1e-4
    assert by_fmu.std == pytest.approx(by_differences.std, rel=1e-5)
    assert by_fmu.history.simulations < by_differences.history.simulations
    assert by_fmu.setup.sensitivity == SensitivityMethod("fmu")
    assert by_differences.setup.sensitivity == SensitivityMethod("finite-difference")


def test_missing_sensitivities_are_one_sentence() -> None:
    experiment = Experiment(record(np.arange(5.0), u=0.0, i=0.0), ["u"], ["i"])
    with pytest.raises(InputError, match=r"output 'sens\.R\.i'.*--sensitivities"):
        Problem(COIL, experiment, {"R": Parameter(start=4.0)}, sensitivity="fmu")
    with pytest.raises(InputError, match=r"sensitivity: unknown value 'forwards'.*'forward'"):
        Problem(COIL, experiment, {"R": Parameter(start=4.0)}, sensitivity="forwards")
    system = System(components={"a": COIL, "b": COIL})
    coupled = Experiment(record(np.arange(5.0), i=0.0), outputs={"a.i": "i"})
    with pytest.raises(InputError, match="needs a single FMU"):
        Problem(system, coupled, {"a.R": Parameter(start=4.0)}, sensitivity="fmu")
