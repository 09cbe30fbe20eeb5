"""Integrations that fail, and what is said."""

from __future__ import annotations

import gc
import sys
from typing import Any

import numpy as np
import pytest

from fmuid.errors import InputError
from fmuid.simulation import codes
from fmuid.simulation.failures import describe
from tests.support.integrating import (
    BALL,
    CHATTER,
    ENDLESS,
    FAIL_AT,
    LINEAR,
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


def test_bounces_without_end_come_to_an_end(make: Maker) -> None:
    trial = make(BALL, [1.0, 0.0], [9.81, 0.5], integrator="rk45").begin()
    with pytest.raises(Failure) as failure:
        trial.advance(3.0)
    end = float(np.sqrt(2 / 9.81)) * 3
    assert failure.value.args == (codes.TOO_MANY_EVENTS, 0, pytest.approx(end, abs=1e-9))


@every_integrator
def test_a_solution_that_ends_in_finite_time(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(VAN_DER_POL, [3.0, 1.0], [-5.0], **settings | {"tolerance": 1e-6}).begin()
    with pytest.raises(Failure) as failure:
        trial.advance(1.0)
    reasons = {"rk4": codes.STATE_NOT_FINITE, "rk45": codes.STEP_TOO_SMALL, "cvode": codes.STATE_NOT_FINITE}
    assert failure.value.args[0] == reasons[settings["integrator"]]
    if settings["integrator"] == "rk45":
        assert "state speed, step" in trial.describe(("place", "speed"))


def test_steps_without_end(make: Maker) -> None:
    trial = make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk45", tolerance=1e-18).begin()
    with pytest.raises(Failure) as failure:
        trial.advance(1000.0)
    assert failure.value.args[0] == codes.TOO_MANY_STEPS


def test_steps_between_two_times_are_limited(make: Maker) -> None:
    """So many do, as the integrator counts them, and one less does not."""
    free = make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk45").begin()
    free.advance(5.0)
    needed = free.memory.state.n_steps
    make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk45", most_steps=needed).begin().advance(5.0)
    short = make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk45", most_steps=needed - 1).begin()
    with pytest.raises(Failure) as failure:
        short.advance(5.0)
    assert failure.value.args[0] == codes.TOO_MANY_STEPS
    assert "max_solver_steps" in short.describe()


def test_every_failure_has_words() -> None:
    spoken_elsewhere = (codes.LOOP, codes.COPY)
    for code in range(codes.SET_DERIVATIVES, codes.PROCESS):
        for integrator in ("", "rk4", "rk45", "cvode"):
            said = (
                ""
                if code in spoken_elsewhere
                else describe(code, 2, 3 if code == codes.ENTER_STEP_MODE else 2, integrator, "phi", (0.5, 1e-9))
            )
            assert code in spoken_elsewhere or len(said) > 15
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


@pytest.mark.slow
def test_many_solvers_come_and_go(libraries: Libraries) -> None:
    for _ in range(200):
        trial = Trial(libraries[3], 3, LINEAR, [1.0], [2.0], integrator="cvode").begin()
        assert trial.advance(1.0)[0] == pytest.approx(np.exp(-2.0), abs=1e-5)
        libraries[3].drop(trial.handle)
    gc.collect()
