"""Simulators of phase signals: sensors, joints and dead time around a machine in rotating axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmuid
from fmuid import Parameter
from fmuid.array_types import Floats
from fmuid.data import Angle, Observation
from fmuid.simulation import derivatives_of
from tests.support.winding_machine import MACHINE, STUDY_AXES, record

FMU = "fmus/InductionMachine/InductionMachine.fmu"
NAMES = ("Rs", "Rr", "Lm", "Lf")
TRUE = [MACHINE[name] for name in NAMES]
EXACT = fmuid.Numerics("model-exchange", tolerance=1e-10)


def simulator(*more: str, observation: Observation = STUDY_AXES) -> fmuid.Simulator:
    experiment = fmuid.Experiment(record(600), ["w"], observation=observation)
    return fmuid.Simulator(fmuid.System(FMU, numerics=EXACT), experiment, [*NAMES, *more])


@pytest.mark.parametrize(
    ("errors", "changed", "left"),
    [
        pytest.param({"dead_time": 2.0}, {"dead_time_voltage": 2.0}, 0.03, marks=pytest.mark.slow),
        # a tenth of the voltage: beside zero current the drop is a resistance of 40 times R_s
        ({"dead_time": 10.0}, {"dead_time_voltage": 10.0}, 0.05),
        pytest.param(
            {"joint": (0.9, 0.0, 0.3)}, {"phase_resistance": {"a": 0.9, "c": 0.3}}, 0.005, marks=pytest.mark.slow
        ),
    ],
)
def test_the_map_of_a_machine_in_windings(errors: dict[str, Any], changed: dict[str, Any], left: float) -> None:
    """Joints and dead time of a machine in its windings, from the voltages at the inverter."""
    exact, frame = record(600)[["ia", "ib"]].to_numpy(), record(600, **errors)
    np.testing.assert_allclose(simulator()(TRUE), exact, rtol=0, atol=2e-5)
    effect = frame[["ia", "ib"]].to_numpy() - exact
    found = simulator(observation=replace(STUDY_AXES, **changed))(TRUE) - exact
    assert np.linalg.norm(found - effect) < left * np.linalg.norm(effect)


@pytest.mark.parametrize("delay", [1e-4, -3e-4])
def test_derivatives_are_those_of_differences(delay: float) -> None:
    more = ("gain(ib)", "offset(ia)", "delay(ia)", "gain(ua)", "phase_resistance(b)", "dead_time_voltage", "delay(uc)")
    own = simulator(*more)
    theta = np.array([*TRUE, 1.02, 0.05, delay, 1.0, 0.0, 0.0, 0.0])
    found = derivatives_of(own, "forward")(theta)
    for j, name in enumerate(own.parameters):
        step = 1e-6 if name.startswith("delay") else 1e-4 * max(abs(theta[j]), 0.1)
        moved = np.eye(theta.size)[j] * step
        expected = (own(theta + moved) - own(theta - moved)) / (2.0 * step)
        np.testing.assert_allclose(found[j], expected, rtol=0, atol=1e-3 * np.abs(expected).max(), err_msg=name)


def test_sensors_cost_no_simulation() -> None:
    calls = []
    own = simulator("gain(ia)", "offset(ia)", "delay(ib)")
    observed = own.observed
    assert observed is not None
    thetas = np.tile([*TRUE, 1.0, 0.0, 0.0], (8, 1))
    thetas[:, 4:] += 1e-3 * np.arange(24).reshape(8, 3) * [1.0, 1.0, 1e-3]

    def counted(given: Floats, inputs: Floats | None) -> object:
        calls.append(len(given))
        return observed.simulate(given, inputs)

    replace(observed, simulate=counted).readings(thetas, own.own)  # type: ignore[arg-type]
    assert calls == [1]


def test_parameters_without_a_sensor_are_refused() -> None:
    experiment = fmuid.Experiment(record(600), ["w"], observation=STUDY_AXES)
    with pytest.raises(fmuid.InputError, match=r"'gain\(ic\)': no experiment has this sensor"):
        fmuid.Problem(FMU, experiment, {"Rs": Parameter(9.0), "gain(ic)": Parameter(1.0)})


def test_a_drop_that_does_not_settle_is_a_failed_simulation() -> None:
    own = simulator("phase_resistance(a)")
    with pytest.raises(fmuid.SimulationError, match="do not settle"):
        own([*TRUE, 3e3])


def test_the_angle_of_a_speed_is_that_of_a_column() -> None:
    frame = record(600)
    by_column = fmuid.Experiment(frame, ["w"], observation=replace(STUDY_AXES, angle=Angle(column="theta")))
    by_speed = fmuid.Experiment(frame, ["w"], observation=STUDY_AXES)
    np.testing.assert_allclose(by_speed.input_values, by_column.input_values, rtol=0, atol=0.05)
