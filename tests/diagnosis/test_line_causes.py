"""Causes of phase signals: each sensor, each line voltage, joints and dead time, on a machine in its windings."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import fmuid
from fmuid.diagnosis import Causes
from fmuid.diagnosis.causes import ChangeParameterSet, SignalScale, coordinates_of
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from tests.support.winding_machine import MACHINE, STUDY_AXES, record

FMUS = "fmus"
NOISE = 0.1
NOMINAL = {name: fmuid.Parameter(value, min=0.0) for name, value in MACHINE.items()}


@cache
def system() -> fmuid.System:
    return fmuid.System(f"{FMUS}/InductionMachine/InductionMachine.fmu")


@cache
def rotor() -> dict[str, fmuid.Fault]:
    sizes = {
        "eta0": fmuid.Parameter(0.0, min=0.0, nominal=0.1),
        "theta0": fmuid.Parameter(0.0, max=np.pi, min=0.0, nominal=1.0),
    }
    path = f"{FMUS}/InductionMachineRotorFault/InductionMachineRotorFault.fmu"
    return {"rotor": fmuid.Fault(path, sizes, angles=["theta0"])}


def experiment(seed: int = 0, count: int = 600, noise: float = 0.0, **errors: Any) -> fmuid.Experiment:
    sensor, line = errors.pop("sensor", 1.0), errors.pop("line", 1.0)
    frame = record(count, seed=seed, noise=noise, **errors).copy()
    frame["ia"] *= sensor
    frame["ub"] *= line
    return fmuid.Experiment(frame, ["w"], observation=STUDY_AXES, name=f"run{seed}")


@cache
def coordinates() -> ChangeParameterSet:
    noise = {"ia": NOISE, "ib": NOISE}
    return coordinates_of(system(), NOMINAL, rotor(), experiment(), SignalScale(noise), Causes())


def test_each_line_and_sensor_is_a_cause() -> None:
    names = {each.name for each in coordinates().causes}
    assert {"gain(ia)", "delay(ib)", "input gain(ua)", "input gain(w)", "joint(c)", "dead time"} <= names
    assert not any("uds" in name or "ids" in name for name in names)


@pytest.mark.parametrize(
    ("name", "size", "errors"),
    [
        ("gain(ia)", 0.01, {"sensor": 1.01}),
        ("input gain(ub)", 0.01, {"line": 1.0 / 1.01}),
        pytest.param("joint(b)", 0.1, {"joint": (0.0, 0.1, 0.0)}, marks=pytest.mark.slow),
        pytest.param("dead time", 0.5, {"dead_time": 0.5}, marks=pytest.mark.slow),
    ],
)
def test_columns_are_what_the_windings_show(name: str, size: float, errors: dict[str, Any]) -> None:
    own = coordinates()
    sound, other = experiment(), experiment(**errors)
    machine = LinearizedMachine(system(), {}, own, other)
    outputs, columns = machine.linearize(own.healthy)
    j = [each.name for each in own.each].index(name)
    effect = other.output_values - sound.output_values if name != "input gain(ub)" else sound.output_values - outputs
    assert np.linalg.norm(effect - size * columns[:, :, j]) < 0.04 * np.linalg.norm(effect)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "errors"),
    [
        ("gain(ia)", {"sensor": 1.03}),
        ("input gain(ub)", {"line": 1.0 / 1.02}),
        ("joint(b)", {"joint": (0.0, 0.93, 0.0)}),
        ("dead time", {"dead_time": 2.0}),
    ],
)
def test_sensors_and_lines_are_no_fault(cause: str, errors: dict[str, Any]) -> None:
    healthy = [experiment(seed, 1200, NOISE) for seed in (1, 2, 3)]
    baseline = fmuid.Baseline(fmuid.identify(fmuid.Problem(system(), healthy, NOMINAL)), records=healthy)
    found = fmuid.diagnose(experiment(4, 1200, NOISE, **errors), baseline, rotor(), system())
    assert found.kind == "other"
    assert [each.label for each in found.evidence.explanations[0].changes] == [cause]


def test_derivatives_include_the_change_of_the_drops() -> None:
    """At a joint, dead time and supply error: differences of whole fixed points."""
    made = coordinates()
    machine = LinearizedMachine(system(), {}, made, experiment())
    point, names = made.healthy.copy(), [each.name for each in made.each]
    for name, size in {"joint(b)": 0.9, "dead time": 2.0, "input gain(uc)": 0.02, "input gain(w)": 0.01}.items():
        point[names.index(name)] = size
    outputs, columns = machine.linearize(point)
    np.testing.assert_array_equal(outputs, machine.outputs(point))
    plain = LinearizedMachine(system(), {}, made, experiment())
    for name in ("Rs", "Lf", "joint(a)", "dead time", "input gain(uc)", "input gain(w)"):
        i = names.index(name)
        low, high = (plain.outputs(point + side * made.each[i].step * np.eye(point.size)[i]) for side in (-1, 1))
        expected = (high - low) / (2.0 * made.each[i].step)
        np.testing.assert_allclose(columns[:, :, i], expected, rtol=0, atol=1e-3 * np.abs(expected).max(), err_msg=name)
