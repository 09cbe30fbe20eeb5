"""The integrators of model-exchange FMUs: against closed forms, against scipy, and when an FMU fails."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.integrate._ivp.rk import RK45

from fmuid.simulation import codes
from fmuid.simulation.native.library import core
from fmuid.simulation.simulation_plan import Integration
from fmuid.simulation.solver import IntegratedModel, Integrator, function_table
from tests.support.closed_forms import park_rates
from tests.support.integrating import (
    BACKWARDS,
    BROKEN_JACOBIAN,
    CALLS,
    COUNT,
    INTEGRATORS,
    LINEAR,
    NOMINAL,
    ROBERTSON,
    VAN_DER_POL,
    Failure,
    Maker,
    X,
    every_integrator,
    van_der_pol,
)
from tests.support.paths import FMUS


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


@every_integrator
def test_induction_machine_against_dop853(settings: dict[str, Any], tmp_path: Path) -> None:
    """The committed FMU by FMPy's hands, its Jacobian by directional derivatives, its inputs linear."""
    path, rng = FMUS / "InductionMachine" / "InductionMachine.fmu", np.random.default_rng(4)
    description = fmpy.read_model_description(path)
    interface = description.modelExchange
    fmpy.extract(str(path), str(tmp_path))
    fmu = FMU2Model(guid=description.guid, unzipDirectory=str(tmp_path), modelIdentifier=interface.modelIdentifier)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    slopes = [unknown.variable for unknown in description.derivatives]
    model = IntegratedModel(
        2,
        fmu.component,
        function_table(2, lambda name: ctypes.cast(getattr(fmu.dll, f"fmi2{name}"), ctypes.c_void_p).value or 0),
        len(slopes),
        description.numberOfEventIndicators,
        np.array([slope.derivative.valueReference for slope in slopes], np.uint32),
        np.array([slope.valueReference for slope in slopes], np.uint32),
    )
    inputs = np.array([references[name] for name in ("uds", "uqs", "w")], np.uint32)
    settings = settings | {"step_size": 1e-4}
    memory = Integrator(model, Integration(inputs=inputs, input_starts=np.zeros(3), **settings))
    for function in (core().integrator_begin, core().integrator_leave_events):
        assert function(memory.handle, 0.0) == 0
    theta = fmu.getReal([references[name] for name in ("Rs", "Rr", "Lm", "Lf")])
    times = np.arange(40) * 7e-4
    inputs = np.column_stack([100 + 20 * rng.normal(size=(40, 2)).cumsum(axis=0), 157 + rng.normal(size=40)])

    def slope(t: float, x: NDArray[np.float64]) -> list[float]:
        return park_rates(x, [np.interp(t, times, inputs[:, j]) for j in range(3)], theta)

    x = np.zeros(4)
    for k in range(39):
        x = solve_ivp(slope, times[k : k + 2].tolist(), x, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        memory.state.origin = times[k]
        memory.curves[:, 0] = inputs[k]
        memory.curves[:, 1] = (inputs[k + 1] - inputs[k]) / 7e-4
        assert core().integrator_advance(memory.handle, times[k + 1]) == 0
        assert fmu.getReal([references["ids"], references["iqs"]]) == pytest.approx(x[:2], rel=1e-7, abs=1e-7)
    fmu.freeInstance()


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


@pytest.mark.parametrize("settings", INTEGRATORS[1:], ids=lambda settings: settings["integrator"])
def test_steps_beyond_the_sample_spare_calls_and_change_nothing(make: Maker, settings: dict[str, Any]) -> None:
    times = np.linspace(0.001, 2.0, 1000)
    got, calls = [], []
    for limit in (-np.inf, 2.0):
        trial = make(VAN_DER_POL, [2.0, 0.0], [1.0], **settings)
        trial.memory.state.how.limit = limit
        got.append(trial.begin().trajectory(times))
        calls.append(trial.numbers[CALLS])
        assert trial.numbers[BACKWARDS] == 0
    assert np.abs(got[0] - got[1]).max() < 1e-7
    assert calls[1] < calls[0] / 3


STIFF_TIMES = [100.0, 700.0, 1000.0, 2000.0]


@pytest.fixture(scope="module")
def stiff() -> NDArray[np.float64]:
    return van_der_pol(STIFF_TIMES, 1000.0)


@pytest.mark.parametrize("integrator", ["rk45", "cvode"])
def test_tolerances_follow_the_nominal_values(make: Maker, integrator: str) -> None:
    """States and nominal values a thousand times as large, from an event on: as many steps, the same relative error."""
    trial = make(LINEAR, [1.0], [1.0], n_inputs=1, integrator=integrator, tolerance=1e-5)
    steps, states = [], []
    for k, scale in enumerate((1.0, 1e3, 1e-3)):
        trial.numbers[NOMINAL] = scale
        trial.memory.curves[0, 1] = scale
        trial.memory.state.origin = 5.0 * k
        if k == 0:
            trial.begin()
        else:
            trial.call("enter_events", 5.0 * k)
            trial.numbers[X], trial.memory.state.next_step = scale, 0.0
            trial.call("leave_events", 5.0 * k)
        before = trial.memory.state.n_steps
        states.append(trial.advance(5.0 * k + 5.0)[0] / scale)
        steps.append(trial.memory.state.n_steps - before)
    assert steps[0] == steps[1] == steps[2]
    assert states == pytest.approx([states[0]] * 3, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("jacobian", ["exact", "differences", "broken"])
def test_stiff_van_der_pol_against_radau(make: Maker, jacobian: str, stiff: NDArray[np.float64]) -> None:
    without = ("GetDirectionalDerivative",) if jacobian == "differences" else ()
    trial = make(VAN_DER_POL, [2.0, 0.0], [1000.0], integrator="cvode", tolerance=1e-11, without=without)
    trial.numbers[BROKEN_JACOBIAN] = jacobian == "broken"
    assert trial.begin().trajectory(STIFF_TIMES) == pytest.approx(stiff, rel=1e-6)
    assert (trial.numbers[COUNT] > 0) == (jacobian == "exact")


@pytest.mark.slow
def test_robertson_against_radau(make: Maker) -> None:
    trial = make(ROBERTSON, [1.0, 0.0, 0.0], integrator="cvode", tolerance=1e-11).begin()

    def slope(_t: float, x: NDArray[np.float64]) -> list[float]:
        first, last = -0.04 * x[0] + 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return [first, -first - last, last]

    times = [0.4, 40.0, 4e5]
    exact = solve_ivp(slope, (0, 4e5), [1, 0, 0], "Radau", times, rtol=1e-11, atol=1e-15).y.T
    assert trial.trajectory(times) == pytest.approx(exact, rel=1e-6)


def test_stiffness_is_found(make: Maker) -> None:
    trial = make(VAN_DER_POL, [2.0, 0.0], [1000.0], integrator="rk45").begin()
    with pytest.raises(Failure) as failure:
        trial.advance(500.0)
    assert failure.value.args[0] == codes.STIFF
    assert 'Choose solver = "cvode"' in trial.describe()
