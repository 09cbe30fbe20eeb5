"""Loops of direct feed-through against their solutions in closed form, in signals of every size; events in circles."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import Numerics, SimulationError, Simulator, System
from fmuid.array_types import Floats
from tests.support.bad_input import rezip
from tests.support.compiled import ProbeMaker
from tests.support.experiments import record
from tests.support.exported import export_text

SIZES = [1e-15, 1.8e-9, 1.0, 1e9]
EXACT = 1e-9
CURVED = """model Curved
  parameter Real k = 0; parameter Real g = 0;
  input Real u; input Real d; output Real y;
equation
  y = k*u*u + g*u + d;
end Curved;"""


@pytest.fixture(scope="module")
def curved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """y = k u² + g u + d."""
    return export_text(tmp_path_factory.mktemp("loops"), CURVED)


def loop_of(path: Path, **given: Any) -> System:
    return System(components={"a": path, "b": path}, connections=[("a.y", "b.u"), ("b.y", "a.u")], **given)


def linear(path: Path, there: float, back: float, thetas: Floats) -> Floats:
    """Return y of a and b, each x + u, in a loop with these factors, at the first sample for each x of a (m,)."""
    system = System(
        components={"a": path, "b": path}, connections=[("a.y", "b.u", there, 0.0), ("b.y", "a.u", back, 0.0)]
    )
    simulator = Simulator(system, record([0.0, 1e-3], {}, ["a.y", "b.y"]), ["a.x"])
    return np.array([simulator(theta)[0] for theta in thetas[:, np.newaxis]])


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("there", "back"), [(1.0, 0.95), (1.0, -0.5), (1e18, 0.5e-18), (1e3, -1e3), (1e-4, 1e-5)],
    ids=["slow", "fast", "mixed", "high", "low"],
)  # fmt: skip
def test_linear_loops_in_signals_of_every_size(probe: ProbeMaker, there: float, back: float, size: float) -> None:
    """y_a = x / (1 - f g), however small: 1.8e-9 is not 9e-11."""
    thetas = size * np.array([1.0, 0.05, -3.0])
    y = linear(probe(), there, back, thetas)
    np.testing.assert_allclose(y[:, 0], thetas / (1.0 - there * back), rtol=EXACT)
    np.testing.assert_allclose(y[:, 1], there * thetas / (1.0 - there * back), rtol=EXACT)


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("size", SIZES)
def test_curved_loops_in_signals_of_every_size(curved: Path, size: float, kind: str) -> None:
    """y = k g² y² + d, k = 1 / size, g = 1/2: y = 2 d / (1 + sqrt(1 - d / size)), over twelve decades and zero."""
    d = size * np.array([0.5, 0.9, -3.0, 0.0, 1e-6, 0.999, 1e-12, -1e-12, 0.3, 0.3, 0.0, -0.7])
    system = loop_of(curved, numerics=Numerics(kind))
    y = Simulator(system, record(1e-3 * np.arange(d.size), {"a.d": d}, ["a.y"]), ["a.k", "b.g"])([1.0 / size, 0.5])[
        :, 0
    ]
    expected = 2.0 * d / (1.0 + np.sqrt(1.0 - d / size))
    np.testing.assert_allclose(y, expected, rtol=EXACT, atol=1e-23 * size)  # which is zero


def test_a_simulation_does_not_depend_on_the_one_before(curved: Path) -> None:
    """What a loop keeps from step to step is forgotten: the bits are the same whatever was simulated before."""
    experiment = record(1e-3 * np.arange(20), {"a.d": np.sin(np.arange(20.0))}, ["a.y"])
    simulator = Simulator(loop_of(curved), experiment, ["a.k", "b.g"])
    first = simulator([0.5, 0.3])
    simulator([-0.3, 0.8])
    np.testing.assert_array_equal(simulator([0.5, 0.3]), first)


def edited(path: Path, target: Path, old: str, new: str) -> Path:
    """Return a copy of an FMU whose description says something else."""
    shutil.copy(path, target)

    def change(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        assert text.count(old) == 1
        files["modelDescription.xml"] = text.replace(old, new).encode()

    rezip(target, change)
    return target


U = 'name="u" valueReference="0" causality="input" variability="continuous"><Real start="0.0"/>'


@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_events_that_cause_each_other_without_end_fail(curved: Path, tmp_path: Path, gain: float) -> None:
    """Inputs that act by events: y_a = d + y_b, y_b = g y_a has a rest for g = 0, for g = -1 it alternates."""
    discrete = edited(curved, tmp_path / "u.fmu", U, U.replace("continuous", "discrete"))
    path = edited(
        discrete,
        tmp_path / "discrete.fmu",
        'index="5" dependencies="3 4"/>\n  </Outputs>',
        'index="5" dependencies="4"/></Outputs>',
    )
    system = loop_of(path, numerics=Numerics("model-exchange"))
    assert not any(is_loop for _, is_loop in system.exchange_order)
    experiment = record([0.0, 1.0, 2.0], {"a.d": [0.0, 0.0, 1.0]}, ["a.y"])
    simulator = Simulator(system, experiment, ["b.g"], values={"a.g": 1.0})
    if gain == 0.0:
        assert simulator([gain])[:, 0].tolist() == [0.0, 0.0, 1.0]
        return
    with pytest.raises(
        SimulationError, match=r"[ab] \(.*\) failed at t = 2 s.*trigger each other endlessly.*hysteresis"
    ):
        simulator([gain])
