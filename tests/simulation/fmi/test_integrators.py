"""The integrators of model-exchange FMUs: against closed forms and scipy; inputs along their curves."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate._ivp.rk import RK45

from fmuid import InputError, Simulator
from fmuid.simulation import codes
from fmuid.simulation.native.library import core
from tests.support.closed_forms import coil_response
from tests.support.experiments import record
from tests.support.hybrid import hybrid_fmu
from tests.support.integrating import (
    BROKEN_JACOBIAN,
    COUNT,
    DECAY,
    LINEAR,
    VAN_DER_POL,
    Maker,
    U,
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
