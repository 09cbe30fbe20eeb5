"""States that are given: right-hand sides at measured states, and simulations that measurements correct."""

from pathlib import Path

import numpy as np
import pytest

import fmuid
from fmuid.array_types import Floats
from fmuid.simulation import RightHandSide
from tests.support.experiments import record
from tests.support.exported import export_text
from tests.support.paths import FMUS

OSCILLATOR = """model Oscillator
  parameter Real k = 2;
  parameter Real d = 0.3;
  parameter Real x_start = 0;
  input Real u;
  output Real x(start=x_start, fixed=true);
  Real v(start=0, fixed=true, nominal=10);
  output Real y;
equation
  der(x) = v;
  der(v) = u - k*x - d*v;
  y = 3*x + 0.5*v + 2*u;
end Oscillator;
"""
SWITCH = """model Switch
  parameter Real a = 1;
  input Real u;
  output Real x(start=0, fixed=true);
equation
  der(x) = if x > 0.5 then -a + u else a + u;
end Switch;
"""
RNG = np.random.default_rng(0)
TIMES = np.cumsum(RNG.uniform(0.02, 0.1, 40))
INPUT = RNG.standard_normal(40)


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("oscillator"), OSCILLATOR)


def side_of(path: Path, given: fmuid.Experiment, parameters: list[str]) -> RightHandSide:
    side = RightHandSide.of(fmuid.Simulator(path, given, parameters))
    assert side is not None
    return side


@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
def test_the_right_hand_side_is_that_of_the_equations(oscillator: Path, interpolation: str) -> None:
    """At the two ends of each interval, under the input of the interval; several thetas at once."""
    side = side_of(oscillator, record(TIMES, {"u": INPUT}, ["y"], interpolation), ["k", "d"])
    assert [name.rpartition(".")[2] for name in side.states] == ["x", "v"]
    assert side.nominals.tolist() == [1.0, 10.0]
    states = RNG.standard_normal((78, 2))
    thetas = np.array([[2.0, 0.3], [5.0, -1.0]])
    slopes, outputs = side(states, thetas)
    u = np.repeat(INPUT, 2)[1:-1].copy()
    if interpolation == "zoh":
        u[1::2] = u[::2]
    for theta, dx, y in zip(thetas, slopes, outputs, strict=True):
        assert dx[:, 0] == pytest.approx(states[:, 1], abs=1e-14)
        assert dx[:, 1] == pytest.approx(u - theta[0] * states[:, 0] - theta[1] * states[:, 1], abs=1e-12)
        assert y[:, 0] == pytest.approx(3 * states[:, 0] + 0.5 * states[:, 1] + 2 * u, abs=1e-12)


def test_branches_are_those_of_the_states_that_are_shown(tmp_path: Path) -> None:
    """An indicator that leaves its domain between points is an event: the branch must follow, to and fro."""
    path = export_text(tmp_path, SWITCH)
    side = side_of(path, record(TIMES, {"u": INPUT}, ["x"]), ["a"])
    states = RNG.uniform(0.0, 1.0, (78, 1))
    slopes, _ = side(states, np.array([[1.5]]))
    u = np.repeat(INPUT, 2)[1:-1].copy()
    u[1::2] = u[::2]
    assert slopes[0, :, 0] == pytest.approx(np.where(states[:, 0] > 0.5, -1.5, 1.5) + u, abs=1e-12)


@pytest.mark.parametrize("interpolation", ["zoh", "pchip"])
def test_initial_states_and_slopes_of_the_outputs(oscillator: Path, interpolation: str) -> None:
    side = side_of(oscillator, record(TIMES, {"u": INPUT}, ["y"], interpolation), ["x_start"])
    assert side.initial(np.array([[0.7], [-2.0]])) == pytest.approx(np.array([[0.7, 0.0], [-2.0, 0.0]]))
    slopes, states, outputs = side.output_slopes(np.array([0.7]))
    assert slopes == pytest.approx(np.array([[3.0, 5.0]]), rel=1e-9)  # times the nominals
    assert states == pytest.approx([0.7, 0.0])
    assert outputs[0, 0] == pytest.approx(3 * 0.7 + 2 * INPUT[0])


def test_units_are_those_of_the_table() -> None:
    given = record(TIMES, {"u": 1e3 * INPUT}, ["i"], units={"u": "mV", "i": "mA"})
    side = side_of(FMUS / "Coil" / "Coil.fmu", given, ["R"])
    states = np.full((78, 1), 2.0)
    slopes, outputs = side(states, np.array([[4.0]]))
    u = np.repeat(INPUT, 2)[1:-1].copy()
    u[1::2] = u[::2]
    assert outputs[0, :, 0] == pytest.approx(2000.0)
    assert slopes[0, :, 0] == pytest.approx((u - 8.0) / 0.1, abs=1e-9)


# --- corrections


def corrected(path: Path, given: fmuid.Experiment, gain: Floats, theta: Floats, names: list[str]) -> Floats:
    side = side_of(path, given, names)
    return np.asarray(side.corrected(gain, 1e-9)(theta))


def test_corrections_follow_the_closed_form_of_the_coil() -> None:
    """Between samples the coil's exponential, at each measured one (in mA) a jump of the gain times what is missing."""
    measured = RNG.standard_normal(40)
    measured[[5, 6, 20]] = np.nan
    given = record(TIMES, {"u": INPUT}, {"i": 1e3 * measured}, units={"i": "mA"})
    found = corrected(FMUS / "Coil" / "Coil.fmu", given, np.array([[0.6]]), np.array([4.0, 0.3]), ["R", "L"])[:, 0]
    i = 0.0
    for k in range(40):
        assert found[k] == pytest.approx(1e3 * i, abs=1e-4), k
        if np.isfinite(measured[k]):
            i += 0.6 * (measured[k] - i)
        if k < 39:
            fade = np.exp(-4.0 / 0.3 * (TIMES[k + 1] - TIMES[k]))
            i = i * fade + INPUT[k] / 4.0 * (1.0 - fade)


def test_a_correction_across_a_switch_is_an_event(tmp_path: Path) -> None:
    """From 0 the state rises by 1/s; each correction throws it above the switch, where it falls by 1/s."""
    path = export_text(tmp_path, SWITCH)
    given = record(np.arange(5) * 0.1, {"u": 0.0}, {"x": [0.9, 0.2, 0.9, 0.2, 0.9]})
    found = corrected(path, given, np.array([[1.0]]), np.array([1.0]), ["a"])[:, 0]
    assert found == pytest.approx([0.0, 0.8, 0.3, 0.8, 0.3], abs=1e-9)
