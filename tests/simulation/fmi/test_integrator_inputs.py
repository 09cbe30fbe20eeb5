"""Inputs of the integrators along their curves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fmuid.data.experiment import Experiment
from fmuid.errors import InputError
from fmuid.simulation import codes
from fmuid.simulation.simulator import Simulator
from tests.support.closed_forms import coil_response
from tests.support.hybrid import hybrid_fmu
from tests.support.integrating import (
    CALLS,
    COUNT,
    DECAY,
    EVENT_TIME,
    INTEGRATORS,
    LINEAR,
    SWITCH,
    Maker,
    U,
    every_integrator,
)


def linear_response(x: float, t: float, a: float, coefficients: NDArray[np.float64]) -> float:
    """Closed form of x' = -a x + u, u a polynomial in t with these coefficients."""
    particular = np.zeros(len(coefficients))  # p' + a p = u, highest power first
    for k in range(len(coefficients) - 1, -1, -1):
        above = (k + 1) * particular[k + 1] if k + 1 < len(coefficients) else 0.0
        particular[k] = (coefficients[k] - above) / a
    return float((x - particular[0]) * np.exp(-a * t) + np.polyval(particular[::-1], t))


@every_integrator
@pytest.mark.parametrize("degree", [0, 1, 3], ids=["held", "linear", "cubic"])
@pytest.mark.parametrize("by_event", [False, True], ids=["plain", "event"])
def test_inputs_equal_their_closed_form(make: Maker, settings: dict[str, Any], degree: int, by_event: bool) -> None:
    rng = np.random.default_rng(degree)
    times = 0.5 + np.cumsum(rng.uniform(0.01, 0.2, 12))
    trial = make(LINEAR, [0.4], [3.0], n_inputs=2, **settings)
    x, t = 0.4, 0.5
    for k, until in enumerate(times.tolist()):
        trial.memory.state.origin = t
        trial.memory.curves[:, : degree + 1] = rng.normal(size=(2, degree + 1))  # they jump at every sample
        if k == 0:
            trial.begin(0.5)
        elif by_event:
            trial.call("enter_events", t)
            trial.numbers[U : U + 2] = trial.memory.curves[:, 0]
            trial.call("leave_events", t)
        u = trial.memory.curves
        x = linear_response(x, until - t, 3.0, u.sum(axis=0))
        assert trial.advance(until)[0] == pytest.approx(x, abs=3e-9)
        assert trial.numbers[U : U + 2] == pytest.approx(u @ (until - t) ** np.arange(4.0), abs=1e-14)
        t = until


@every_integrator
def test_inputs_without_kinks_do_not_restart_the_integrator(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(LINEAR, [0.0], [1.0], n_inputs=1, **settings)
    calls = []
    for jump in (0.0, 1e-3):
        trial.begin()
        before = trial.numbers[CALLS]
        for k in range(50):
            t = 0.02 * k
            trial.memory.state.origin = t
            trial.memory.curves[0, :2] = np.sin(t) + jump * (-1) ** k, (np.sin(t + 0.02) - np.sin(t)) / 0.02
            trial.advance(t + 0.02)
        calls.append(trial.numbers[CALLS] - before)
    assert calls[0] + 49 <= calls[1]


@every_integrator
def test_inputs_of_a_time_are_set_anew_along_new_curves(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(LINEAR, [0.0], [1.0], n_inputs=1, **settings)
    trial.begin()
    for t, value in ((0.1, 1.0), (0.1, 2.0), (0.1, 3.0)):
        trial.memory.curves[0, 0] = value
        trial.advance(t)
        assert trial.numbers[U] == value


@every_integrator
def test_straight_inputs_give_the_same_bits_as_curved_ones(make: Maker, settings: dict[str, Any]) -> None:
    found = []
    for straight in (False, True):
        trial = make(LINEAR, [0.3], [1.0], n_inputs=1, straight=straight, **settings).begin()
        states = []
        for k in range(20):
            trial.memory.state.origin = 0.1 * k
            trial.memory.curves[0, :2] = np.sin(0.1 * k), (np.sin(0.1 * k + 0.1) - np.sin(0.1 * k)) / 0.1
            states.append(trial.advance(0.1 * (k + 1)))
        found.append(np.array(states))
    assert found[0].tobytes() == found[1].tobytes()


def test_no_states_but_an_input_that_switches(make: Maker) -> None:
    for settings in INTEGRATORS:
        trial = make(SWITCH, [], [0.37], n_inputs=1, **settings)
        trial.memory.curves[0, :3] = 0.0, 0.5, 0.5
        trial.begin()
        trial.advance(1.0)
        crossing = np.sqrt(0.25 + 2 * 0.37) - 0.5
        assert trial.numbers[[COUNT, EVENT_TIME]] == pytest.approx([1, crossing], abs=1e-9)
        trial.memory.state.origin = 1.0
        trial.memory.curves[0] = 0.0  # jumps back across the threshold
        trial.advance(1.5)
        assert trial.numbers[[COUNT, EVENT_TIME]].tolist() == [2, 1.0]


def test_no_states_and_a_step_size(make: Maker) -> None:
    trial = make(SWITCH, [], [0.37], n_inputs=1, step_size=0.2)
    trial.memory.curves[0, :3] = 0.0, 2.0, -2.0  # above the threshold between two samples only
    trial.begin()
    trial.advance(1.0)
    assert trial.numbers[COUNT] == 2


@every_integrator
def test_a_step_that_the_fmu_discards_is_halved(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(DECAY, [1.0], [21.0], **settings | {"step_size": 0.1, "tolerance": 1e-6}).begin()
    times = np.linspace(0.1, 0.6, 6)
    bound = 0.03 if settings["integrator"] == "rk4" else 1e-5
    assert trial.trajectory(times)[:, 0] == pytest.approx(np.exp(-21 * times), abs=bound)
    assert trial.memory.state.report.status == codes.DISCARD


@every_integrator
def test_an_array_of_inputs_of_which_one_varies(settings: dict[str, Any], tmp_path: Path) -> None:
    """x' = -x + u[1] + u[2]: u[1] goes straight from sample to sample, u[2] keeps its start value, 0.5."""
    path = hybrid_fmu(tmp_path, "linear", 3)
    rng = np.random.default_rng(2)
    times, u = np.linspace(0.0, 2.0, 30), rng.normal(size=30)
    frame = pd.DataFrame({"time": times, "u": u, "v": u, "x": 0.0})
    experiment = Experiment(frame, {"u[1]": "u"}, {"x0": "x"})
    found = Simulator(path, experiment, values={"p0": 1.0}, **settings)([])[:, 0]
    expected = coil_response(times, u + 0.5, 1.0, 1.0, True)
    assert np.abs(found - expected).max() < 1e-7
    both = Experiment(frame, {"u[1]": "u", "u[2]": "v"}, {"x0": "x"})
    found = Simulator(path, both, values={"p0": 1.0}, **settings)([])[:, 0]
    assert np.abs(found - coil_response(times, 2 * u, 1.0, 1.0, True)).max() < 1e-7
    mixed = Experiment(frame, {"u[1]": "u", "u[2]": "v"}, {"x0": "x"}, interpolation={"u[2]": "zoh"})
    with pytest.raises(InputError, match=r"'u\[2\]' and 'u\[1\]' are elements of one array"):
        Simulator(path, mixed)
