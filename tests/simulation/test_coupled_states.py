"""States of coupled FMUs that show their derivatives: a DC motor in two parts, against its equations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid
from fmuid.data import SteadyExperiment
from fmuid.simulation import RightHandSide, Simulator
from fmuid.simulation.point_model import ModelOfPoints, PointModel
from fmuid.simulation.solver_refinement import AS_ASKED, Refinement, by_model_exchange, next_refinement
from tests.support.coupled_motor import MOTOR, coupled_motor

R, L, K, J, B = MOTOR.values()
SLOPES = np.array([[-R / L, -K / L], [K / J, -B / J]])


def test_derivatives_at_given_states(made: Callable[[str], Path]) -> None:
    """Each part sees what the states of the other make, not what it saw at the sample before."""
    times, rng = 0.01 * np.arange(6.0), np.random.default_rng(5)
    frame = pd.DataFrame({"time": times, "u": rng.normal(size=6), "i": 0.0, "w": 0.0})
    columns = {"winding.i": "i", "rotor.w": "w"}
    experiment = fmuid.Experiment(frame, {"winding.u": "u"}, columns, interpolation="zoh")
    side = RightHandSide.of(Simulator(coupled_motor(made), experiment, list(MOTOR)))
    assert side is not None
    assert side.states == ("winding.i", "rotor.w")
    states = rng.normal(size=(10, 2))
    rates, outputs = side(states, np.array([list(MOTOR.values())]))
    volts = np.repeat(frame["u"].to_numpy()[:5], 2)
    np.testing.assert_allclose(rates[0], states @ SLOPES.T + np.outer(volts / L, [1.0, 0.0]), rtol=1e-12)
    np.testing.assert_allclose(outputs[0], states, rtol=1e-12)


def test_linear_model_and_rest(made: Callable[[str], Path]) -> None:
    system, inputs = coupled_motor(made), {"winding.u": np.linspace(3.0, 24.0, 8)}
    exchanged = by_model_exchange(system)
    assert exchanged is not None
    outputs = ["winding.i", "rotor.w"]
    model = PointModel(ModelOfPoints(exchanged, tuple(MOTOR), {}, "points"), inputs, tuple(inputs), outputs, {})
    found = model.at(np.ones((8, 2)), np.array([list(MOTOR.values())]))
    for own in found.a[0]:
        np.testing.assert_allclose(own, SLOPES, rtol=1e-6)
    frame = pd.DataFrame({"winding.u": inputs["winding.u"], "rotor.w": 1.0})
    experiment = SteadyExperiment(frame, ["winding.u"], ["rotor.w"])
    problem = fmuid.Problem(system, experiment, {name: fmuid.Parameter(value) for name, value in MOTOR.items()})
    speeds = problem.simulators[0](list(MOTOR.values()))[:, 0]
    np.testing.assert_allclose(speeds, K * inputs["winding.u"] / (R * B + K**2), rtol=1e-9)


def test_corrected_states(made: Callable[[str], Path]) -> None:
    """Samples move the states of both parts, as those of the discrete equations."""
    times = 0.004 * np.arange(40.0)
    frame = pd.DataFrame({"time": times, "u": 6.0, "w": 40.0 * (1.0 - np.exp(-times / 0.05))})
    experiment = fmuid.Experiment(frame, {"winding.u": "u"}, {"rotor.w": "w"}, interpolation="zoh")
    side = RightHandSide.of(Simulator(coupled_motor(made, 1e-5), experiment, list(MOTOR)))
    assert side is not None
    gain = np.array([[0.05], [0.3]])
    found = side.corrected(gain, 1e-9)(list(MOTOR.values()))[:, 0]
    values, vectors = np.linalg.eig(SLOPES)
    step = (vectors * np.exp(values * 0.004)) @ np.linalg.inv(vectors)
    forced = np.linalg.solve(SLOPES, (step - np.eye(2)) @ np.array([6.0 / L, 0.0]))
    state, expected = np.zeros(2), list[float]()
    for measured in frame["w"]:
        expected.append(float(state[1].real))
        state = step @ (state + gain[:, 0] * (measured - state[1])) + forced
    np.testing.assert_allclose(found, expected, atol=1e-3 * max(expected))


def test_communication_steps_are_divided_beyond_the_least_tolerance(made: Callable[[str], Path]) -> None:
    system, ladder = coupled_motor(made), [AS_ASKED]
    while (finer := next_refinement(system, ladder[-1])) is not None:
        ladder.append(finer)
    assert [each.divisor for each in ladder] == [1, 4, 16, 64, 256, 1024]
    tolerances = [each.tolerance for each in ladder[1:]]
    np.testing.assert_allclose(np.array(tolerances, float), [1e-9, 1e-11, 1e-13, 1e-13, 1e-13])
    # one FMU has nothing but its tolerance
    assert next_refinement(fmuid.System(system.components["rotor"].fmu), Refinement(1e-13)) is None
