"""The integrators of model-exchange FMUs: closed forms and scipy, inputs, events, failures."""

import ctypes
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate._ivp.rk import RK45

from fmuid import InputError, Simulator
from fmuid.simulation import codes
from fmuid.simulation.codes import describe
from fmuid.simulation.native.library import core
from tests.support.closed_forms import ball, coil_response
from tests.support.experiments import record
from tests.support.hybrid import hybrid_fmu
from tests.support.integrating import (
    BACKWARDS,
    BALL,
    BROKEN_JACOBIAN,
    CHATTER,
    COUNT,
    DECAY,
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
    U,
    X,
    every_integrator,
    van_der_pol,
)


def test_tableau_is_scipys() -> None:
    rows = np.ctypeslib.as_array((ctypes.c_double * 70).in_dll(core(), "dormand_prince")).reshape(10, 7)
    nodes, weights, error = rows[0], rows[1:8], rows[8]
    assert np.allclose(nodes[:6], RK45.C, rtol=1e-15)
    assert np.allclose(weights[:6, :5], RK45.A, rtol=1e-15)
    assert np.allclose(weights[6, :6], RK45.B, rtol=1e-15)
    assert np.allclose(error, -RK45.E, rtol=1e-13)


def test_classical_method_is_of_fourth_order(make: Maker) -> None:
    exact = van_der_pol([4.0], 1.0)[0]
    errors = []
    for step_size in (0.05, 0.025, 0.0125):
        trial = make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk4", step_size=step_size).begin()
        errors.append(np.abs(trial.advance(4.0) - exact).max())
        assert trial.memory.state.n_steps == round(4.0 / step_size)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([4, 4], abs=0.25)


def test_adaptive_method_against_dop853(make: Maker) -> None:
    times = np.linspace(0.1, 20, 200)
    exact = van_der_pol(times, 5.0)
    errors = []
    for tolerance in (1e-6, 1e-9):
        trial = make(VAN_DER_POL, [2.0, 0.0], [5.0], integrator="rk45", tolerance=tolerance)
        trial.memory.state.how.limit = times[-1]
        errors.append(np.abs(trial.begin().trajectory(times) - exact).max())
    assert errors[0] < 1e-3
    assert errors[1] < 1e-6


STIFF_TIMES = [100.0, 700.0, 1000.0, 2000.0]


@pytest.fixture(scope="module")
def stiff() -> NDArray[np.float64]:
    return van_der_pol(STIFF_TIMES, 1000.0)


@pytest.mark.slow
@pytest.mark.parametrize("jacobian", ["exact", "differences", "broken"])
def test_stiff_van_der_pol_against_radau(make: Maker, jacobian: str, stiff: NDArray[np.float64]) -> None:
    without = ("GetDirectionalDerivative",) if jacobian == "differences" else ()
    trial = make(VAN_DER_POL, [2.0, 0.0], [1000.0], integrator="cvode", tolerance=1e-11, without=without)
    trial.numbers[BROKEN_JACOBIAN] = jacobian == "broken"
    assert trial.begin().trajectory(STIFF_TIMES) == pytest.approx(stiff, rel=1e-6)
    assert (trial.numbers[COUNT] > 0) == (jacobian == "exact")


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
    experiment = record(times, {"u[1]": u}, ["x0"], "linear")
    found = Simulator(path, experiment, values={"p0": 1.0}, **settings)([])[:, 0]
    expected = coil_response(times, u + 0.5, 1.0, 1.0, True)
    assert np.abs(found - expected).max() < 1e-7
    both = record(times, {"u[1]": u, "u[2]": u}, ["x0"], "linear")
    found = Simulator(path, both, values={"p0": 1.0}, **settings)([])[:, 0]
    assert np.abs(found - coil_response(times, 2 * u, 1.0, 1.0, True)).max() < 1e-7
    mixed = record(times, {"u[1]": u, "u[2]": u}, ["x0"], {"u[2]": "zoh"})
    with pytest.raises(InputError, match=r"'u\[2\]' and 'u\[1\]' are elements of one array"):
        Simulator(path, mixed)


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
