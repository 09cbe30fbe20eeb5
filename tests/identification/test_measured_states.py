"""States that no output tells, from those that outputs tell and the model's equations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.starts.draws import INDUCTION_MACHINE, bits, draw, simulated
from experiments.starts.study import problem
from fmuid import Simulator
from fmuid.array_types import Floats
from fmuid.estimation import SearchFailure, StartingPointSource
from fmuid.identification.equation_error_start import equation_start, states_from_outputs
from fmuid.simulation import RightHandSide
from tests.support.exported import export_text
from tests.support.paths import FMUS

CUBIC = """model Cubic
  parameter Real a = 2;
  parameter Real b = 3;
  parameter Real z_start = 0.5;
  input Real u;
  output Real x(start=0, fixed=true);
  output Real y;
  Real z(start=z_start, fixed=true);
  Real w(start=1, fixed=true);
equation
  der(x) = u - a*x + w;
  der(z) = x - b*z^3;
  der(w) = z - 5*w;
  y = 2*x;
end Cubic;
"""


def test_the_fluxes_of_a_machine_follow_from_its_currents() -> None:
    """Compared with the fluxes of the machine's own equations, integrated by scipy."""
    machine, rng = INDUCTION_MACHINE, np.random.default_rng(5)
    truth, first = np.array([8.0, 4.0, 0.45, 0.07]), np.array([1.0, -2.0, 0.3, -0.2])
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(4e-4, 1.6e-3, 300))])
    voltage = bits(rng, times, 0.02, [-100, 100])
    inputs = np.column_stack([voltage, voltage[::-1], np.full(times.size, 40.0)])
    states = simulated(machine, truth, first, times, inputs)
    columns = ["time", *machine.inputs, *machine.outputs]
    frame = pd.DataFrame(np.column_stack([times, inputs, states[:, :2]]), columns=columns)
    experiment = fmuid.Experiment(frame, list(machine.inputs), list(machine.outputs), interpolation="zoh")
    given = dict(zip((*machine.parameters, *machine.states), (*truth, *first), strict=True))
    parameters = {name: fmuid.Parameter(float(value), nominal=1.0) for name, value in given.items()}
    whole = fmuid.Problem(FMUS / "InductionMachine" / "InductionMachine.fmu", experiment, parameters)
    (simulator,) = whole.simulators
    assert isinstance(simulator, Simulator)
    side = RightHandSide.of(simulator)
    assert side is not None
    theta = whole.parameters.start
    known, slopes = states_from_outputs(side, theta, times, states[:, :2])
    assert known.unseen.shape == (4, 2)
    assert slopes == pytest.approx(np.eye(2, 4))
    ((found, rates),) = known(theta[None])
    assert found[:, :2] == pytest.approx(states[:, :2], abs=1e-9)
    assert found[:, 2:] == pytest.approx(states[:, 2:], abs=2e-3 * np.abs(states[:, 2:]).max())
    ends = [machine.right(found[k], inputs[k], truth) for k in range(300)]
    assert rates[::2] == pytest.approx(np.array(ends), rel=1e-9, abs=1e-6)


@pytest.fixture(scope="module")
def cubic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("cubic"), CUBIC)


def law(x: Floats, u: Floats, p: Floats) -> list[float]:
    return [u[0] - p[0] * x[0] + x[2], x[0] - p[1] * x[1] ** 3, x[1] - 5.0 * x[2]]


def cubic_problem(cubic: Path, a: float, b: float) -> tuple[fmuid.Problem, Floats]:
    """Return a record of the same equations by scipy, a = 2 and b = 3, and its states; only y = 2 x is measured."""
    times = np.linspace(0.0, 8.0, 401)
    u = np.sign(np.sin(2.0 * times + 0.3)) * (1.0 + (times > 4.0))
    machine = replace(INDUCTION_MACHINE, right=law)
    states = simulated(machine, np.array([2.0, 3.0]), np.array([0.0, 0.5, 1.0]), times, u[:, None])
    noise = 1e-3 * np.random.default_rng(2).standard_normal(401)
    frame = pd.DataFrame({"time": times, "u": u, "y": 2.0 * states[:, 0] + noise})
    parameters = {"a": fmuid.Parameter(a, min=0.0), "b": fmuid.Parameter(b, min=0.0)}
    return fmuid.Problem(cubic, fmuid.Experiment(frame, ["u"], ["y"], interpolation="zoh"), parameters), states


def test_unmeasured_states_with_a_law_that_is_not_linear(cubic: Path) -> None:
    whole, states = cubic_problem(cubic, 2.0, 3.0)
    (simulator,) = whole.simulators
    assert isinstance(simulator, Simulator)
    side = RightHandSide.of(simulator)
    assert side is not None
    (experiment,) = whole.experiments
    known, slopes = states_from_outputs(side, whole.parameters.start, experiment.times, experiment.output_values)
    assert np.abs(slopes).max() == pytest.approx(2.0)
    ((found, _),) = known(whole.parameters.start[None])
    assert found == pytest.approx(states[:, ["xzw".index(name) for name in side.states]], abs=5e-3)
    far, _ = cubic_problem(cubic, 40.0, 0.1)
    start = equation_start(far, far.parameters.start)
    assert start is not None
    assert start[0] == pytest.approx([2.0, 3.0], rel=0.2)


@pytest.mark.slow
def test_a_machine_from_up_to_a_hundred_times_away_is_found_without_its_fluxes() -> None:
    result = fmuid.identify(problem("im", draw("im", 2, 3.0, 100.0)))
    assert result.converged
    assert [(each.remedy, each.trouble) for each in result.history.restarts] == [
        (StartingPointSource.GIVEN, SearchFailure.FAR),
        (StartingPointSource.EQUATION_ERROR, SearchFailure.NONE),
    ]
    assert result.history.simulations < 200
