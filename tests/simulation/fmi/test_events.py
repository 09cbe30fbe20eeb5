"""Events of model exchange: state, time and step events, bounces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.closed_forms import ball
from tests.support.integrating import (
    BACKWARDS,
    BALL,
    COUNT,
    EVENT_TIME,
    STAIRS,
    STEP_EVENT_AT,
    TRIANGLE,
    VAN_DER_POL,
    Maker,
    X,
    every_integrator,
    van_der_pol,
)


@every_integrator
def test_bounces_are_found(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(BALL, [1.0, 0.0], [9.81, 0.7], **settings).begin()
    for t in np.linspace(0.013, 2.3, 150).tolist():
        height, count, bounce = ball(t, 9.81, 0.7)
        assert trial.advance(t)[0] == pytest.approx(height, abs=1e-6)
        assert trial.numbers[COUNT] == count
        assert trial.numbers[EVENT_TIME] == pytest.approx(bounce, abs=1e-6)
    assert trial.memory.state.n_events == trial.numbers[COUNT] > 5
    assert trial.numbers[BACKWARDS] == 0


@every_integrator
def test_events_close_to_each_other_and_twice_of_one_indicator(make: Maker, settings: dict[str, Any]) -> None:
    bounded = settings | {"step_size": min(settings.get("step_size", 0.15), 0.15)}
    trial = make(STAIRS, [0.0], [0.3, 0.3 + 1e-7, 0.5, 0.7], **bounded).begin()
    found = []
    for t in (0.2, 0.3 + 5e-8, 0.4, 0.6, 0.9):
        assert trial.advance(t)[0] == pytest.approx(t, abs=1e-12)
        found.append((trial.numbers[COUNT], trial.numbers[EVENT_TIME]))
    assert [count for count, _ in found] == [0, 1, 2, 3, 4]
    assert [time for _, time in found[1:]] == pytest.approx([0.3, 0.3 + 1e-7, 0.5, 0.7], abs=1e-10)
    assert all(time >= at for (_, time), at in zip(found[1:], [0.3, 0.3 + 1e-7, 0.5, 0.7], strict=True))


@every_integrator
def test_first_of_all_events_in_a_step(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(STAIRS, [0.0], [0.8, 0.25, 2.0, 3.0], **settings).begin()
    trial.advance(1.0)
    assert trial.numbers[[COUNT, EVENT_TIME]] == pytest.approx([2, 0.8], abs=1e-10)


@every_integrator
def test_time_events_are_hit_exactly(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(TRIANGLE, [0.0], [0.1], **settings).begin()
    for t in np.linspace(0.07, 2.0, 40).tolist():
        phase = t / 0.2 - np.floor(t / 0.2)
        assert trial.advance(t)[0] == pytest.approx(0.2 * min(phase, 1 - phase), abs=1e-9)
        count = trial.numbers[COUNT]
        assert trial.numbers[EVENT_TIME] == count * 0.1 <= t < (count + 1) * 0.1


@every_integrator
def test_a_time_event_at_a_sample_is_handled_there(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(TRIANGLE, [0.0], [0.1], **settings).begin()
    trial.advance(0.1)
    assert trial.numbers[COUNT] == 1
    trial.advance(0.1)
    assert trial.numbers[COUNT] == 1
    trial.advance(5 * 0.1)
    assert trial.numbers[COUNT] == 5


@every_integrator
def test_step_event(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(STAIRS, [0.0], [9.0, 9.0, 9.0, 10.0], **settings | {"step_size": 0.01})
    trial.memory.state.how.limit = 1.0
    trial.numbers[STEP_EVENT_AT] = 0.505
    trial.begin().trajectory(np.linspace(0.003, 1.0, 300))
    assert trial.numbers[COUNT] == 1
    assert 0.505 <= trial.numbers[EVENT_TIME] < 0.52
    assert trial.numbers[BACKWARDS] == 0


@every_integrator
def test_event_mode_from_outside_in_the_middle_of_a_step(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(VAN_DER_POL, [2.0, 0.0], [1.0], **settings)
    trial.memory.state.how.limit = 2.0
    trial.begin().advance(0.3)
    trial.call("enter_events", 0.3)
    trial.call("enter_events", 0.3)
    assert trial.numbers[COUNT] == 1
    trial.numbers[X : X + 2] = 1.0, 0.5
    trial.call("leave_events", 0.3)
    exact = van_der_pol([1.2], 1.0, (1.0, 0.5))
    assert trial.advance(1.5) == pytest.approx(exact[0], abs=1e-7)
