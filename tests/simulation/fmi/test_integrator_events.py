"""Events of model exchange: state, time and step events, bounces; integrations that fail, and what is said."""

import sys
from typing import Any

import numpy as np
import pytest

from fmuid import InputError
from fmuid.simulation import codes
from fmuid.simulation.codes import describe
from tests.support.closed_forms import ball
from tests.support.integrating import (
    BACKWARDS,
    BALL,
    CHATTER,
    COUNT,
    ENDLESS,
    EVENT_TIME,
    FAIL_AT,
    LINEAR,
    STAIRS,
    TERMINATE_AT,
    TRIANGLE,
    VAN_DER_POL,
    Failure,
    Libraries,
    Maker,
    Trial,
    X,
    every_integrator,
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
def test_time_events_are_hit_exactly(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(TRIANGLE, [0.0], [0.1], **settings).begin()
    for t in np.linspace(0.07, 2.0, 40).tolist():
        phase = t / 0.2 - np.floor(t / 0.2)
        assert trial.advance(t)[0] == pytest.approx(0.2 * min(phase, 1 - phase), abs=1e-9)
        count = trial.numbers[COUNT]
        assert trial.numbers[EVENT_TIME] == count * 0.1 <= t < (count + 1) * 0.1


@every_integrator
@pytest.mark.parametrize(
    ("what", "setting", "expected", "status"),
    [
        (CHATTER, {}, codes.TOO_MANY_EVENTS, 0),
        (VAN_DER_POL, {FAIL_AT: 0.5}, codes.GET_DERIVATIVES, 3),
        (VAN_DER_POL, {X: np.nan}, codes.STATE_NOT_FINITE, 0),
        (TRIANGLE, {X: np.inf}, codes.STATE_NOT_FINITE, 0),
        (BALL, {TERMINATE_AT: 0.3}, codes.ENDED, 0),
        (BALL, {ENDLESS: 1.0}, codes.ENDLESS_EVENT, 0),
    ],
)
def test_failures(
    make: Maker, settings: dict[str, Any], what: int, setting: dict[int, float], expected: int, status: int
) -> None:
    trial = make(what, [1.0, 0.0][: 2 if what in (VAN_DER_POL, BALL) else 1], [9.81, 0.7], **settings).begin()
    for reference, value in setting.items():
        trial.numbers[reference] = value
    if X in setting:
        trial.call("enter_events", 0.0)
        trial.call("leave_events", 0.0)
    with pytest.raises(Failure) as failure:
        trial.advance(2.0)
    assert failure.value.args[:2] == (expected, status)
    assert trial.describe(("h", "v"))


def test_every_failure_has_words() -> None:
    for code in {*range(codes.SET_DERIVATIVES, codes.PROCESS)} - {codes.LOOP, codes.COPY}:  # spoken elsewhere
        said = describe(code, 2, 3 if code == codes.ENTER_STEP_MODE else 2, "rk4", "phi", (0.5, 1e-9))
        assert len(said) > 15
        assert "\n" not in said
    assert describe(codes.GET_DERIVATIVES, 3, 2) == "fmi2GetDerivatives returned fmi2Error"
    assert describe(codes.GET_DERIVATIVES, 9, 3) == "fmi3GetContinuousStateDerivatives returned the illegal status 9"
    assert describe(codes.FLOAT64, 4, 2) == "fmi2SetReal returned fmi2Fatal"
    assert describe(codes.N_WIRES + codes.UINT8, 3, 3) == "fmi3GetUInt8 returned fmi3Error"
    assert "state phi" in describe(codes.STATE_NOT_FINITE, 0, 2, "rk45", "phi", (0.5, 1e-9))
    small = describe(codes.STEP_TOO_SMALL, 0, 2, "rk45", "phi", (0.5, 1e-9))
    assert "at t = 0.5 s (state phi, step 1e-09 s)" in small


@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_bad_tolerance(make: Maker, tolerance: float) -> None:
    with pytest.raises(InputError, match=f"tolerance: {tolerance:g} is outside"):
        make(LINEAR, [0.0], [1.0], tolerance=tolerance)


def test_platform_without_cvode(libraries: Libraries, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fmpy.sundials", None)
    with pytest.raises(InputError, match=r'no library for this platform.*Choose "rk45"'):
        Trial(libraries[2], 2, LINEAR, [0.0], [1.0], integrator="cvode")
