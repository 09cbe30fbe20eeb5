"""The core's loop: against closed forms, against itself in threads, and when an FMU fails."""

import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from fmuid import Experiment, InputError, Isolation, Numerics, SimulationError, Simulator, System
from fmuid.array_types import Floats
from fmuid.simulation import close, closing
from fmuid.simulation.worker import SimulationThread
from tests.support.closed_forms import park_rates
from tests.support.compiled import ProbeMaker
from tests.support.hybrid import hybrid_fmu
from tests.support.paths import FMUS

COIL = FMUS / "Coil" / "Coil.fmu"
INDUCTION = FMUS / "InductionMachine" / "InductionMachine.fmu"


def record(times: ArrayLike, outputs: Any = ("x",), interpolation: str = "zoh", **inputs: Any) -> Experiment:
    """Return an experiment whose columns are its inputs; outputs are zero."""
    frame = pd.DataFrame({"time": np.asarray(times, float)} | inputs | dict.fromkeys(outputs, 0.0))
    return Experiment(frame, tuple(inputs), outputs, interpolation=interpolation)


def ramp(samples: int = 4) -> Experiment:
    """Return an experiment in which the probe's x is gain × t."""
    return record(np.arange(samples), u=np.ones(samples))


# --- against closed forms


def test_induction_machine_equals_its_equations_integrated_by_scipy() -> None:
    times, theta = np.arange(300) * 7e-4, [9.0, 4.0, 0.4, 0.08]
    rng = np.random.default_rng(4)
    inputs = np.column_stack([100 + 20 * rng.normal(size=(300, 2)).cumsum(axis=0), 157 + rng.normal(size=300)])

    def slope(t: float, x: Floats) -> list[float]:
        return park_rates(x, [np.interp(t, times, inputs[:, j]) for j in range(3)], theta)

    x, expected = np.zeros(4), [[0.0, 0.0]]
    for k in range(299):  # interval by interval: the inputs have kinks at the samples
        x = solve_ivp(slope, times[k : k + 2].tolist(), x, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        expected.append([x[0], x[1]])
    columns = dict(zip(("uds", "uqs", "w"), inputs.T, strict=True))
    got = Simulator(INDUCTION, record(times, ["ids", "iqs"], "linear", **columns), ["Rs", "Rr", "Lm", "Lf"])(theta)
    assert np.abs(got - expected).max() < 1e-7 * np.abs(expected).max()


def test_many_thetas_in_threads_equal_one_after_the_other() -> None:
    times = np.arange(400) * 1e-3
    simulator = Simulator(COIL, record(times, ["i"], u=np.sign(np.sin(40 * times))), ["R", "L"])
    thetas = np.random.default_rng(5).uniform([1, 0.01], [9, 0.2], (37, 2))
    assert np.array_equal(simulator(thetas), np.array([simulator(theta) for theta in thetas]))


def test_linear_inputs_go_by_midpoints_where_an_fmu_cannot_interpolate(probe: ProbeMaker) -> None:
    times, u = np.array([0.0, 0.1, 0.3, 0.35]), np.array([0.0, 2.0, -1.0, 4.0])
    got = Simulator(probe(), record(times, ["x", "y"], "linear", u=u), ["gain"])([2.0])
    area = 2.0 * np.concatenate([[0], np.cumsum(np.diff(times) * (u[1:] + u[:-1]) / 2)])
    assert got[:, 0] == pytest.approx(area, abs=1e-14)
    assert got[:, 1] == pytest.approx(area + u, abs=1e-14)  # direct feed-through sees the sample, not the midpoint


def test_held_inputs_and_a_step_of_the_inputs(probe: ProbeMaker) -> None:
    got = Simulator(probe(), record([0.0, 1.0, 1.0, 2.0], ["x", "y"], u=[1.0, 5.0, 3.0, 0.0]))([])
    assert got.T.tolist() == [[0.0, 1.0, 1.0, 4.0], [1.0, 6.0, 4.0, 4.0]]


def test_integers_booleans_strings_and_units(probe: ProbeMaker) -> None:
    columns = {"u": 60.0, "n": [1, 2, 3, 4], "b": [True, False, True, False], "x": 0.0, "ten_n": 0.0, "not_b": 0.0}
    frame, units = pd.DataFrame({"time": np.arange(4.0)} | columns), {"u": "rpm", "x": "deg"}
    experiment = Experiment(frame, ["n", "u", "b"], ["not_b", "x", "ten_n"], interpolation="zoh", units=units)
    got = Simulator(probe(), experiment, ["gain"], values={"word": "hello"})([0.5])
    assert got[:, [0, 2]].T.tolist() == [[0, 1, 0, 1], [10, 20, 30, 40]]
    assert got[:, 1] == pytest.approx(0.5 * 360.0 * np.arange(4.0))  # 60 rpm is 360 deg/s


def test_parameters_may_be_start_values_and_inputs(probe: ProbeMaker) -> None:
    assert Simulator(probe(), record(np.arange(3.0)), ["u", "x"])([2.0, 10.0])[:, 0].tolist() == [10.0, 12.0, 14.0]


def test_step_size_divides_the_sampling_interval(probe: ProbeMaker) -> None:
    """The second probe integrates the staircase of the first; sampling times are rounded to single precision."""
    system = System(components={"a": probe(), "b": probe()}, connections=[("a.z", "b.u")])

    def staircase(times: Any) -> Experiment:
        frame = pd.DataFrame({"time": times, "u": 1.0, "x": 0.0})
        return Experiment(frame, {"a.u": "u"}, {"b.x": "x"}, interpolation="zoh")

    for n in (1, 4, 10):  # sum of k h * h for k < n with n = 1 / h
        experiment = staircase([0.0, 1.0])
        assert Simulator(system, experiment, step_size=1.0 / n)([])[-1, 0] == pytest.approx((n - 1) / (2 * n))
    experiment = staircase(np.float32(np.arange(400) * 1e-3).astype(float))
    by_samples, by_step_size = (Simulator(system, experiment, step_size=size)([]) for size in (None, 1e-3))
    assert np.array_equal(by_samples, by_step_size)  # no second substep


# --- failures


def test_failed_step_names_fmu_time_parameters_and_message(probe: ProbeMaker) -> None:
    path = probe()
    simulator = Simulator(path, ramp(6), ["gain", "fail_at"], values={"word": "ouch"})
    with pytest.raises(SimulationError, match=r"DoStep returned fmi2Discard.*ouch: the solver gave up at 3") as told:
        simulator([2.0, 3.5])
    error = told.value
    assert (error.fmu, error.time, error.parameters) == (str(path), 3.0, {"gain": 2.0, "fail_at": 3.5})
    batch = simulator.many([[1.0, 99.0], [1.0, 2.5], [3.0, 99.0]])  # the others are not touched
    assert [e is None for e in batch.errors] == [True, False, True]
    assert np.isnan(batch.outputs[1]).all()
    assert batch.outputs[2, :, 0].tolist() == [0, 3, 6, 9, 12, 15]


@pytest.mark.parametrize("defines", [("FATAL",), ("NO_RESET",)])
def test_new_instance_serves_after_a_fatal_error_or_without_reset(probe: ProbeMaker, defines: tuple[str]) -> None:
    simulator = Simulator(probe(*defines), ramp(), ["gain", "fail_at"])
    for _ in range(3):
        with pytest.raises(SimulationError):
            simulator([1.0, 1.5])
        assert simulator([2.0, 99.0])[:, 0].tolist() == [0, 2, 4, 6]
        assert simulator([3.0, 99.0])[:, 0].tolist() == [0, 3, 6, 9]


def test_incomplete_reset_makes_new_instances_and_warns(probe: ProbeMaker, caplog: pytest.LogCaptureFixture) -> None:
    simulator = Simulator(probe("LEAKY_RESET"), ramp(), ["gain"])
    for gains in ([[1.0]], [[2.0], [3.0], [4.0]], [[5.0]] * 9):
        assert simulator(gains)[:, :, 0].tolist() == [[0, g, 2 * g, 3 * g] for (g,) in gains]
    assert sum("its reset does not work" in each.getMessage() for each in caplog.records) == 1


def test_fmu_without_reset_or_second_instance_is_simulated_once(
    probe: ProbeMaker, caplog: pytest.LogCaptureFixture
) -> None:
    simulator = Simulator(probe("LEAKY_RESET", canBeInstantiatedOnlyOncePerProcess="true"), ramp(), ["gain"])
    assert simulator([2.0])[:, 0].tolist() == [0, 2, 4, 6]
    for _ in range(2):
        with pytest.raises(InputError, match=r"probe.*only one simulation is possible.*working reset"):
            simulator([2.0])
    assert not caplog.records


def test_interruption_ends_the_simulations_of_other_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The caller's own share is interrupted while another thread is in a simulation that takes for ever."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    path = hybrid_fmu(tmp_path, "van_der_pol", attributes='canBeInstantiatedOnlyOncePerProcess="false"')
    system = System(path, numerics=Numerics("model-exchange", "rk4", step_size=1e-9))
    simulator = Simulator(system, record([0.0, 1e5], ["x0"]), ["start0"], values={"p0": 1.0})
    other, original = threading.Event(), SimulationThread._simulate

    def simulate(thread: SimulationThread, *arguments: Any) -> None:
        if thread._index == 0:
            assert other.wait(60.0)
            raise KeyboardInterrupt
        other.set()
        original(thread, *arguments)

    monkeypatch.setattr(SimulationThread, "_simulate", simulate)
    with pytest.raises(KeyboardInterrupt):
        simulator([[2.0], [2.0]])


# --- instances and warnings


def test_one_instance_serves_where_the_fmu_allows_no_more(probe: ProbeMaker) -> None:
    system = System(probe("ONCE", canBeInstantiatedOnlyOncePerProcess="true"))
    simulators = [Simulator(system, record(np.arange(3.0), ["instances"]), ["gain"]) for _ in range(2)]
    for simulator in simulators:
        assert (simulator(np.ones((9, 1))) == 1).all()
    simulators[0].close()
    with pytest.raises(InputError, match="only once in a process"):
        simulators[1]([1.0])


def test_instances_are_kept_and_freed(probe: ProbeMaker) -> None:
    path = probe(maxOutputDerivativeOrder="0")  # another file: its library counts its own instances
    simulator = Simulator(path, record(np.arange(3.0), ["instances"]), ["gain"])
    simulator(np.ones((8, 1)))
    first = simulator([1.0]).max()
    assert simulator(np.ones((200, 1))).max() == first  # not one more for 200 simulations
    simulator.close()
    assert simulator([1.0]).max() == 1


@pytest.mark.parametrize("once", ["false", "true"])
@pytest.mark.parametrize("isolation", [None, Isolation(threads=2)])
def test_warnings_are_passed_on_once(
    probe: ProbeMaker,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    once: str,
    isolation: Isolation | None,
) -> None:
    """Two simulations at a time, in threads or in processes of their own; and anew, with other instances."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with closing(System(probe(canBeInstantiatedOnlyOncePerProcess=once), isolation=isolation)) as system:
        simulator = Simulator(system, record(np.arange(3.0)), ["gain"], values={"n": 7, "word": "lucky"})
        with caplog.at_level(logging.WARNING, "fmuid.fmu"):
            simulator(np.ones((20, 1)))
            if isolation is not None or once == "false":  # one that can be instantiated once stays
                close(system)
            simulator(np.ones((20, 1)))
    said = sorted(each.getMessage() for each in caplog.records)
    assert said == ["Probe: lucky: seven at 0", "Probe: lucky: seven at 1"]


# --- refusals


def test_irregular_sampling_is_refused_where_the_fmu_needs_equal_steps(probe: ProbeMaker) -> None:
    path = probe(canHandleVariableCommunicationStepSize="false")
    assert Simulator(path, record(np.arange(5) * 0.1))([]).shape == (5, 1)
    with pytest.raises(InputError, match="needs equal communication steps"):
        Simulator(path, record([0, 1.0, 2.5]))


@pytest.mark.parametrize(
    ("roles", "message"),
    [
        ({"inputs": ["v"]}, "no input 'v'"),
        ({"inputs": ["gain"]}, "'gain' as 'parameter', not as input. Its inputs are u, n, b"),
        ({"inputs": ["word"]}, "'word' as 'parameter', not as input"),
        ({"outputs": ["gain"]}, "'gain' as 'parameter', not as output"),
        ({"outputs": ["x + y"]}, "sums different units: 'x' in rad, 'y' in no unit"),
        ({"parameters": ["gian"]}, r"no parameter 'gian' \(did you mean 'gain'"),
        ({"parameters": ["gain", "gain"]}, "'gain' is listed twice"),
        ({"parameters": ["twice"]}, "'twice' cannot be set"),
        ({"parameters": ["word"]}, "Only Real parameters"),
        ({"parameters": ["u"]}, "'u' is an input of the table"),
        ({"parameters": ["gain"], "values": {"gain": 2.0}}, "both a parameter and fixed"),
        ({"values": {"n": 1.5}}, "of type Integer"),
        ({"values": {"n": 2**40}}, "finite number within Int32"),
        ({"values": {"gain": True}}, "of type Real"),
        ({"units": {"u": "furlong"}}, "u: column unit 'furlong' does not convert to 'rad/s'"),
    ],
)
def test_wrong_roles_are_refused(probe: ProbeMaker, roles: dict[str, Any], message: str) -> None:
    columns = dict.fromkeys(("u", "x", "gain", "v", "x + y", "word"), 0.0)
    frame = pd.DataFrame({"time": np.arange(3.0)} | columns)
    inputs, outputs, units = (roles.pop(each, default) for each, default in ROLES)
    with pytest.raises(InputError, match=message):
        Simulator(probe(), Experiment(frame, inputs, outputs, units=units), **roles)


ROLES: tuple[tuple[str, Any], ...] = (("inputs", ["u"]), ("outputs", ["x"]), ("units", {}))


@pytest.mark.parametrize(("theta", "words"), [([1.0], "must have 2 values"), ([1.0, np.nan], "must be finite")])
def test_wrong_theta_is_refused(theta: list[float], words: str) -> None:
    simulator = Simulator(COIL, record(np.arange(3.0), ["i"]), ["R", "L"])
    with pytest.raises(InputError, match=words):
        simulator(theta)
    assert simulator.unfed_inputs == ("u",)
