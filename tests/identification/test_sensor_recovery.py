"""Errors of sensors and lines of a machine in its windings are found beside its parameters, with honest intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.interpolate import CubicSpline

import fmuid
from fmuid import Parameter
from fmuid.array_types import Floats
from fmuid.data import Sensor
from fmuid.identification import find_model_errors
from tests.support.winding_machine import MACHINE, STUDY_AXES, Condition, excitation, record, tables

FMU = "fmus/InductionMachine/InductionMachine.fmu"
NOISE, COUNT = 0.1, 1500
EACH = 20  # machines of one excitation


def free(start: float, std: float) -> Parameter:
    return Parameter(start, nominal=std, prior=fmuid.Normal(start, std))


OBSERVATION = replace(
    STUDY_AXES,
    sensors={"ia": Sensor(offset=free(0.0, 1.0)), "ib": Sensor(gain=free(1.0, 0.3), delay=free(0.0, 1e-3))},
    phase_resistance={"a": free(0.0, 5.0)},
    dead_time_voltage=free(0.0, 20.0),
)
NAMES = (*MACHINE, "offset(ia)", "gain(ib)", "delay(ib)", "phase_resistance(a)", "dead_time_voltage")


def draws(count: int) -> Iterator[tuple[pd.DataFrame, Floats]]:
    """Yield tables of machines with errors, and the true values."""
    for seed in range(-(-count // EACH)):
        rng, members = np.random.default_rng([21, seed]), min(EACH, count - seed * EACH)
        joint, dead = rng.uniform(0.0, 0.9, members), rng.uniform(0.0, 3.0, members)
        errors = [(0.1 * rng.standard_normal(), 0.03 * rng.standard_normal(), rng.uniform(0, 3e-4)) for _ in joint]
        off = [
            Condition((r, 0.0, 0.0), v, offset=(o, 0.0), gain=(0.0, g), delay=(0.0, d))
            for r, v, (o, g, d) in zip(joint, dead, errors, strict=True)
        ]
        for k, frame in enumerate(tables([excitation(COUNT, 100 + seed)] * members, off, NOISE, 100 + seed)):
            offset, gain, delay = errors[k]
            yield frame, np.array([*MACHINE.values(), offset, 1.0 + gain, delay, joint[k], dead[k]])


def scores(count: int) -> Floats:
    """Return (estimate − true value)/σ of each draw and parameter."""
    found = []
    for frame, true in draws(count):
        experiment = fmuid.Experiment(frame, ["w"], observation=OBSERVATION)
        parameters = {name: Parameter(1.2 * value, min=0.0) for name, value in MACHINE.items()}
        result = fmuid.identify(fmuid.Problem(FMU, experiment, parameters))
        assert result.converged and set(result.names) == set(NAMES)
        found.append([(result[name].value - value) / result[name].std for name, value in zip(NAMES, true, strict=True)])
    return np.array(found)


@pytest.mark.slow
def test_sensors_and_lines_are_found() -> None:
    found = scores(3)
    assert np.abs(found).max() < 4.0
    assert 0.4 < np.sqrt(np.mean(found**2)) < 1.6


@pytest.mark.campaign
def test_intervals_hold() -> None:
    found = scores(200)
    within = (np.abs(found) < 1.96).sum(axis=0)
    print(dict(zip(NAMES, np.atleast_1d(within), strict=True)), np.sqrt(np.mean(found**2, axis=0)).round(2))
    least, most = (stats.binom.ppf(p, len(found), 0.95) for p in (5e-4, 1 - 5e-4))  # of nine parameters together: 1 %
    assert ((within >= least) & (within <= most)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("errors", "kind", "subject", "size"),
    [
        ({"delay": 1.5e-4}, "delay", "ib", 0.3),
        ({"offset": 0.1}, "offset", "ib", 0.1),
        ({"supply": 1.02}, "input_gain", "uc", 0.02),
        ({"joint": (0.0, 0.45, 0.0)}, "joint", "ub", 0.45),
    ],
)
def test_directed_tests_name_the_sensor_and_the_line(
    errors: dict[str, Any], kind: str, subject: str, size: float
) -> None:
    frame = record(1500, noise=NOISE, seed=3, joint=errors.get("joint", (0.0, 0.0, 0.0))).copy()
    frame["uc"] *= errors.get("supply", 1.0)
    late = np.maximum(frame["time"] - errors.get("delay", 0.0), 0.0)
    frame["ib"] = CubicSpline(frame["time"], frame["ib"])(late) + errors.get("offset", 0.0)
    parameters = {name: Parameter(1.2 * value, min=0.0) for name, value in MACHINE.items()}
    problem = fmuid.Problem(FMU, fmuid.Experiment(frame, ["w"], observation=STUDY_AXES), parameters)
    found = find_model_errors(problem, fmuid.identify(problem))
    assert found is not None and found.errors
    strongest = found.errors[0].test
    assert (strongest.direction.kind.value, strongest.direction.subject) == (kind, (subject,))
    assert strongest.size == pytest.approx(size, rel=0.25)
