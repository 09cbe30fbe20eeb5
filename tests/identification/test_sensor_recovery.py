"""Errors of sensors and lines of a machine in its windings are found beside its parameters, with honest intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.interpolate import CubicSpline

import fmuid
from fmuid.array_types import Floats
from fmuid.data import Parameter, Sensor
from tests.support.winding_machine import MACHINE, STUDY_AXES, currents, excitation, to_phases

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
        times, speed, angle, axes = excitation(COUNT, 100 + seed)
        joint, dead = rng.uniform(0.0, 0.9, members), rng.uniform(0.0, 3.0, members)
        found = currents(times, speed, angle, axes, np.outer(joint, [1.0, 0.0, 0.0]), dead)
        for k in range(members):
            offset, gain, delay = 0.1 * rng.standard_normal(), 1.0 + 0.03 * rng.standard_normal(), rng.uniform(0, 3e-4)
            frame = pd.DataFrame({"time": times, "w": speed, "theta": angle})
            frame[["ua", "ub", "uc"]] = to_phases(axes, angle)
            late = CubicSpline(times, found[k, :, 1])(np.maximum(times - delay, 0.0))
            noise = NOISE * rng.standard_normal((2, COUNT))
            frame["ia"], frame["ib"] = found[k, :, 0] + offset + noise[0], gain * late + noise[1]
            yield frame, np.array([*MACHINE.values(), offset, gain, delay, joint[k], dead[k]])


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
