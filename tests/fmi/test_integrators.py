"""The integrators of model-exchange FMUs: against closed forms, against scipy, and when an FMU fails."""

from __future__ import annotations

import ctypes
import gc
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest
from fmpy.fmi2 import FMU2Model
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.integrate._ivp.rk import RK45

from fmuid.data.experiment import Experiment
from fmuid.errors import InputError
from fmuid.fmi import codes
from fmuid.fmi.failures import describe
from fmuid.fmi.integrator import Integrator, function_table
from fmuid.fmi.native import core
from fmuid.fmi.native.build import compiler_here
from fmuid.simulation.simulator import Simulator
from tests.support.closed_forms import ball, coil_response, park_rates
from tests.support.hybrid import hybrid_fmu
from tests.support.paths import FMUS, HERE

# As in probe/hybrid.c.
BALL, TRIANGLE, ROBERTSON, VAN_DER_POL, LINEAR, CHATTER, STAIRS, DECAY, SWITCH = range(9)
X, DX, P, U = 0, 3, 6, 10
(COUNT, EVENT_TIME, TERMINATE_AT, STEP_EVENT_AT, FAIL_AT, ENDLESS, BROKEN_JACOBIAN, NOMINAL, CALLS, BACKWARDS) = range(
    13, 23
)
INTEGRATORS: list[dict[str, Any]] = [
    {"integrator": "rk4", "step_size": 1e-3},
    {"integrator": "rk45", "tolerance": 1e-10},
    {"integrator": "cvode", "tolerance": 1e-10},
]
every_integrator = pytest.mark.parametrize("settings", INTEGRATORS, ids=lambda settings: settings["integrator"])
Libraries = dict[int, ctypes.CDLL]


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> Libraries:
    folder, headers = tmp_path_factory.mktemp("hybrid"), Path(fmpy.__file__).parent / "c-code"
    found = {}
    for version in (2, 3):
        path = folder / f"hybrid{version}{fmpy.sharedLibraryExtension}"
        command = [*compiler_here(), "-O1", "-shared", "-fPIC", f"-I{headers}", f"-DFMI={version}"]
        subprocess.run([*command, "-o", str(path), str(HERE / "probe" / "hybrid.c")], check=True, capture_output=True)
        found[version] = ctypes.CDLL(str(path))
        found[version].make.restype = ctypes.c_void_p
        found[version].make.argtypes = [ctypes.c_double]
    return found


class Failure(Exception):  # noqa: N818  # it is no error of the test
    """What the core reported; its first argument is the failing function or condition."""


class Trial:
    """One instance of a test model under an integrator."""

    def __init__(
        self,
        library: ctypes.CDLL,
        version: int,
        model: int,
        x: ArrayLike = (),
        p: ArrayLike = (),
        *,
        n_inputs: int = 0,
        without: tuple[str, ...] = ("GetDirectionalDerivative",),
        **settings: Any,
    ) -> None:
        self.library = library
        self.handle = ctypes.c_void_p(library.make(model))
        self.start = np.atleast_1d(np.asarray(x, float))

        def address_of(name: str) -> int:
            found = getattr(library, f"fmi{version}{name}", None) if name not in without else None
            return 0 if found is None else ctypes.cast(found, ctypes.c_void_p).value or 0

        self.numbers = np.ctypeslib.as_array(ctypes.cast(self.handle, ctypes.POINTER(ctypes.c_double)), (23,))
        self.numbers[P : P + np.size(p)] = p
        n = library.n_states(self.handle)
        self.integrator = settings.get("integrator", "rk45")
        self.memory = Integrator(
            version,
            self.handle.value or 0,
            function_table(version, address_of),
            n,
            library.n_indicators(self.handle),
            input_references=np.arange(U, U + n_inputs, dtype=np.uint32),
            state_references=np.arange(X, X + n, dtype=np.uint32),
            derivative_references=np.arange(DX, DX + n, dtype=np.uint32),
            **settings,
        )

    def begin(self, t: float = 0.0) -> Trial:
        self.library.rewind_to_event_mode(self.handle)
        self.numbers[X : X + len(self.start)] = self.start
        self.call("begin", t)
        self.call("leave_events", t)
        return self

    def call(self, function: str, t: float) -> None:
        if getattr(core(), f"integrator_{function}")(self.memory.handle, t) != 0:
            report = self.memory.state.report
            raise Failure(report.failure, report.status, self.memory.state.time)

    def describe(self, states: tuple[str, ...] = ()) -> str:
        state, report = self.memory.state, self.memory.state.report
        name = states[report.state] if 0 <= report.state < len(states) else ""
        return describe(report.failure, report.status, 2, self.integrator, name, state.step_end, state.next_step)

    def advance(self, t: float) -> NDArray[np.float64]:
        """Return the states that the FMU holds at t."""
        self.call("advance", t)
        assert self.memory.state.time == t
        return self.numbers[X : X + self.memory.state.how.n_states].copy()

    def trajectory(self, times: ArrayLike) -> NDArray[np.float64]:
        return np.array([self.advance(t) for t in np.asarray(times, float).tolist()])


Maker = Callable[..., Trial]


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def make(request: pytest.FixtureRequest, libraries: Libraries) -> Iterator[Maker]:
    made: list[Trial] = []

    def maker(*arguments: Any, **settings: Any) -> Trial:
        made.append(Trial(libraries[request.param], request.param, *arguments, **settings))
        return made[-1]

    yield maker
    for trial in made:
        libraries[request.param].drop(trial.handle)


def van_der_pol(times: ArrayLike, mu: float, x: tuple[float, float] = (2.0, 0.0)) -> NDArray[np.float64]:
    """Return scipy's solution at the times, (len(times), 2)."""

    def slope(_t: float, x: NDArray[np.float64]) -> list[float]:
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    def jacobian(_t: float, x: NDArray[np.float64]) -> list[list[float]]:
        return [[0, 1], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]]

    times = np.asarray(times, float)
    if mu > 100:
        return solve_ivp(slope, (0, times[-1]), x, "Radau", times, rtol=1e-10, atol=1e-13, jac=jacobian).y.T
    return solve_ivp(slope, (0, times[-1]), x, "DOP853", times, rtol=1e-12, atol=1e-13).y.T


def test_tableau_is_scipys() -> None:
    rows = np.ctypeslib.as_array((ctypes.c_double * 70).in_dll(core(), "dormand_prince")).reshape(10, 7)
    nodes, weights, error = rows[0], rows[1:8], rows[8]
    assert np.allclose(nodes[:6], RK45.C, rtol=1e-15)
    assert np.allclose(weights[:6, :5], RK45.A, rtol=1e-15)
    assert np.allclose(weights[6, :6], RK45.B, rtol=1e-15)
    assert np.allclose(error, -RK45.E, rtol=1e-13)


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
def test_several_bounces_between_two_samples(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(BALL, [1.0, 0.0], [9.81, 0.7], **settings).begin()
    assert trial.advance(2.0)[0] == pytest.approx(ball(2.0, 9.81, 0.7)[0], abs=1e-6)
    assert trial.numbers[COUNT] == 4


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
    memory = Integrator(
        2,
        fmu.component,
        function_table(2, lambda name: ctypes.cast(getattr(fmu.dll, f"fmi2{name}"), ctypes.c_void_p).value or 0),
        len(slopes),
        description.numberOfEventIndicators,
        input_references=np.array([references[name] for name in ("uds", "uqs", "w")], np.uint32),
        state_references=np.array([slope.derivative.valueReference for slope in slopes], np.uint32),
        derivative_references=np.array([slope.valueReference for slope in slopes], np.uint32),
        **settings | {"step_size": 1e-4},
    )
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


def test_samples_close_to_each_other_do_not_shorten_later_steps(make: Maker) -> None:
    steps = []
    for extra in ([], [5.0 + 1e-9]):
        trial = make(VAN_DER_POL, [2.0, 0.0], [1.0], integrator="rk45").begin()
        trial.trajectory([5.0, *extra, 6.0])
        steps.append(trial.memory.state.n_steps - len(extra))
    assert steps[0] == steps[1]


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
    assert 'choose integrator = "cvode"' in trial.describe()


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


@every_integrator
def test_beginning_again_repeats_to_the_last_bit(make: Maker, settings: dict[str, Any]) -> None:
    trial = make(BALL, [1.0, 0.0], [9.81, 0.7], **settings)
    times = np.linspace(0.1, 1.5, 15)
    first = trial.begin().trajectory(times)
    again = trial.begin().trajectory(times)
    assert first.tolist() == again.tolist()


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
        assert "state speed errs most" in trial.describe(("place", "speed"))


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
    assert "most_steps" in short.describe()


def test_every_failure_has_words() -> None:
    spoken_elsewhere = (codes.LOOP, codes.COPY)
    for code in range(codes.SET_DERIVATIVES, codes.PROCESS):
        for integrator in ("", "rk4", "rk45", "cvode"):
            said = (
                ""
                if code in spoken_elsewhere
                else describe(code, 2, 3 if code == codes.ENTER_STEP_MODE else 2, integrator, "phi", 0.5, 1e-9)
            )
            assert code in spoken_elsewhere or len(said) > 15
            assert "\n" not in said
    assert describe(codes.GET_DERIVATIVES, 3, 2) == "fmi2GetDerivatives returned fmi2Error"
    assert describe(codes.GET_DERIVATIVES, 9, 3) == "fmi3GetContinuousStateDerivatives returned the illegal status 9"
    assert describe(codes.FLOAT64, 4, 2) == "fmi2SetReal returned fmi2Fatal"
    assert describe(codes.N_WIRES + codes.UINT8, 3, 3) == "fmi3GetUInt8 returned fmi3Error"
    assert "state phi" in describe(codes.STATE_NOT_FINITE, 0, 2, "rk45", "phi", 0.5, 1e-9)
    small = describe(codes.STEP_TOO_SMALL, 0, 2, "rk45", "phi", 0.5, 1e-9)
    assert "at t = 0.5 s (the last one 1e-09 s; state phi errs most)" in small


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"integrator": "euler"}, 'integrator = "euler" is none; choose one of rk4, rk45, cvode'),
        ({"tolerance": 0.0}, "tolerance = 0 must lie between 0 and 1"),
        ({"step_size": -1.0}, "step_size = -1 must be a positive number of seconds"),
    ],
)
def test_bad_settings(make: Maker, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(LINEAR, [0.0], [1.0], **settings)


def test_platform_without_cvode(libraries: Libraries, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fmpy.sundials", None)
    with pytest.raises(InputError, match=r'no library for this platform.*choose integrator = "rk45"'):
        Trial(libraries[2], 2, LINEAR, [0.0], [1.0], integrator="cvode")


def test_many_solvers_come_and_go(libraries: Libraries) -> None:
    for _ in range(200):
        trial = Trial(libraries[3], 3, LINEAR, [1.0], [2.0], integrator="cvode").begin()
        assert trial.advance(1.0)[0] == pytest.approx(np.exp(-2.0), abs=1e-5)
        libraries[3].drop(trial.handle)
    gc.collect()


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
    mixed = Experiment(frame, {"u[1]": "u", "u[2]": "v"}, {"x0": "x"}, interpolation={"u[2]": "hold"})
    with pytest.raises(InputError, match=r"'u\[2\]' is held.*'u\[1\]' is not.*give them one interpolation"):
        Simulator(path, mixed)
