"""The core's loop: against closed forms, against itself in threads, and when an FMU fails."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fmuid.data.experiment import Experiment
from fmuid.errors import InputError, SimulationError
from fmuid.models.component import Isolation, Numerics
from fmuid.models.system import System
from fmuid.simulation.executor_pool import close, closing, executor_of
from fmuid.simulation.simulation_plan import SimulationJob
from fmuid.simulation.simulator import Simulator
from fmuid.simulation.worker import SimulationThread
from tests.support.closed_forms import coil_response, park_rates
from tests.support.hybrid import hybrid_fmu
from tests.support.paths import FMUS
from tests.support.probe_fmu import ProbeMaker

COIL = FMUS / "Coil" / "Coil.fmu"
INDUCTION = FMUS / "InductionMachine" / "InductionMachine.fmu"


def table(times: NDArray[np.floating[Any]], **columns: object) -> pd.DataFrame:
    return pd.DataFrame({"time": times, **columns})


@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
def test_coil_on_an_irregular_grid_equals_its_closed_form(interpolation: str) -> None:
    rng = np.random.default_rng(3)
    times = 0.3 + np.cumsum(rng.uniform(1e-4, 2e-3, 500))
    times[200] = times[199]  # a time given twice is a step of the inputs
    u = rng.normal(size=500)
    experiment = Experiment(table(times, u=u, i=0.0 * u), ["u"], ["i"], interpolation=interpolation)
    got = Simulator(COIL, experiment, ["R", "L"])([3.0, 0.05])
    expected = coil_response(times, u, 3.0, 0.05, interpolation == "linear")
    assert got.shape == (500, 1)
    assert np.abs(got[:, 0] - expected).max() < 1e-9 * np.abs(expected).max()


def test_induction_machine_equals_its_equations_integrated_by_scipy() -> None:
    times = np.arange(300) * 7e-4
    rng = np.random.default_rng(4)
    inputs = np.column_stack([100 + 20 * rng.normal(size=(300, 2)).cumsum(axis=0), 157 + rng.normal(size=300)])
    theta = [9.0, 4.0, 0.4, 0.08]

    def slope(t: float, x: NDArray[np.float64]) -> list[float]:
        return park_rates(x, [np.interp(t, times, inputs[:, j]) for j in range(3)], theta)

    x, expected = np.zeros(4), [[0.0, 0.0]]
    for k in range(299):  # interval by interval: the inputs have kinks at the samples
        x = solve_ivp(slope, times[k : k + 2].tolist(), x, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        expected.append([x[0], x[1]])
    experiment = Experiment(
        table(times, uds=inputs[:, 0], uqs=inputs[:, 1], w=inputs[:, 2], ids=0.0, iqs=0.0),
        ["uds", "uqs", "w"],
        ["ids", "iqs"],
    )
    got = Simulator(INDUCTION, experiment, ["Rs", "Rr", "Lm", "Lf"])(theta)
    assert np.abs(got - expected).max() < 1e-7 * np.abs(expected).max()


def test_many_thetas_in_threads_equal_one_after_the_other() -> None:
    times = np.arange(400) * 1e-3
    experiment = Experiment(table(times, u=np.sign(np.sin(40 * times)), i=0 * times), ["u"], ["i"])
    simulator = Simulator(COIL, experiment, ["R", "L"])
    thetas = np.random.default_rng(5).uniform([1, 0.01], [9, 0.2], (37, 2))
    assert np.array_equal(simulator(thetas), np.array([simulator(theta) for theta in thetas]))


def test_an_fmu_that_cannot_interpolate_gets_linear_inputs_by_midpoints(probe: ProbeMaker) -> None:
    times = np.array([0.0, 0.1, 0.3, 0.35])
    u = np.array([0.0, 2.0, -1.0, 4.0])
    experiment = Experiment(table(times, u=u, x=0 * u, y=0 * u), ["u"], ["x", "y"])
    got = Simulator(probe(), experiment, ["gain"])([2.0])
    area = 2.0 * np.concatenate([[0], np.cumsum(np.diff(times) * (u[1:] + u[:-1]) / 2)])
    assert got[:, 0] == pytest.approx(area, abs=1e-14)
    assert got[:, 1] == pytest.approx(area + u, abs=1e-14)  # direct feed-through sees the sample, not the midpoint


def test_held_inputs_and_a_step_of_the_inputs(probe: ProbeMaker) -> None:
    times = np.array([0.0, 1.0, 1.0, 2.0])
    u = np.array([1.0, 5.0, 3.0, 0.0])
    experiment = Experiment(table(times, u=u, x=0 * u, y=0 * u), ["u"], ["x", "y"], interpolation="zoh")
    got = Simulator(probe(), experiment)([])
    assert got[:, 0].tolist() == [0.0, 1.0, 1.0, 4.0]
    assert got[:, 1].tolist() == [1.0, 6.0, 4.0, 4.0]


def test_integers_booleans_strings_and_units(probe: ProbeMaker) -> None:
    times = np.arange(4.0)
    frame = table(
        times, u=[60.0] * 4, n=[1, 2, 3, 4], b=[True, False, True, False], x=0 * times, ten_n=0 * times, not_b=0 * times
    )
    experiment = Experiment(
        frame, ["n", "u", "b"], ["not_b", "x", "ten_n"], interpolation="zoh", units={"u": "rpm", "x": "deg"}
    )
    got = Simulator(probe(), experiment, ["gain"], values={"word": "hello"})([0.5])
    assert got[:, 0].tolist() == [0, 1, 0, 1]
    assert got[:, 2].tolist() == [10, 20, 30, 40]
    assert got[:, 1] == pytest.approx(0.5 * 360.0 * times)  # 60 rpm is 360 deg/s


def test_parameters_may_be_start_values_and_inputs(probe: ProbeMaker) -> None:
    times = np.arange(3.0)
    experiment = Experiment(table(times, x=0 * times), outputs=["x"])
    got = Simulator(probe(), experiment, ["u", "x"])([2.0, 10.0])
    assert got[:, 0].tolist() == [10.0, 12.0, 14.0]


def test_step_size_divides_the_sampling_interval(probe: ProbeMaker) -> None:
    times = np.array([0.0, 1.0])
    system = System(components={"a": probe(), "b": probe()}, connections=[("a.z", "b.u")])
    experiment = Experiment(table(times, u=[1.0, 1.0], x=[0.0, 0.0]), {"a.u": "u"}, {"b.x": "x"}, interpolation="zoh")
    # b integrates a's staircase: sum of k h * h for k < n with n = 1 / h
    for n in (1, 4, 10):
        got = Simulator(system, experiment, step_size=1.0 / n)([])
        assert got[-1, 0] == pytest.approx((n - 1) / (2 * n), abs=1e-12)


def test_rounded_sampling_times_do_not_cost_a_second_substep(probe: ProbeMaker) -> None:
    times = np.float32(np.arange(400) * 1e-3).astype(float)
    system = System(components={"a": probe(), "b": probe()}, connections=[("a.z", "b.u")])
    frame = table(times, u=1 + 0 * times, x=0 * times)
    experiment = Experiment(frame, {"a.u": "u"}, {"b.x": "x"}, interpolation="zoh")
    by_samples, by_step_size = (Simulator(system, experiment, step_size=size)([]) for size in (None, 1e-3))
    assert np.array_equal(by_samples, by_step_size)


def test_a_failed_step_names_fmu_time_parameters_and_message(probe: ProbeMaker) -> None:
    times = np.arange(6.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    path = probe()
    simulator = Simulator(path, experiment, ["gain", "fail_at"], values={"word": "ouch"})
    with pytest.raises(SimulationError) as caught:
        simulator([2.0, 3.5])
    error = caught.value
    assert error.fmu == str(path)
    assert error.time == 3.0
    assert error.parameters == {"gain": 2.0, "fail_at": 3.5}
    assert "fmi2DoStep returned fmi2Discard" in str(error)
    assert "ouch: the solver gave up at 3" in str(error)
    batch = simulator.many([[1.0, 99.0], [1.0, 2.5], [3.0, 99.0]])  # the others are not touched
    assert [e is None for e in batch.errors] == [True, False, True]
    assert np.isnan(batch.outputs[1]).all()
    assert batch.outputs[2, :, 0].tolist() == [0, 3, 6, 9, 12, 15]


def test_failed_initialisation_and_nan_outputs(probe: ProbeMaker) -> None:
    times = np.arange(4.0)
    experiment = Experiment(table(times, x=0 * times), outputs=["x"])
    with pytest.raises(SimulationError, match=r"t = 0 s .*nothing: cannot initialise with 3"):
        Simulator(probe(), experiment, ["fail_init"])([3.0])
    with pytest.raises(SimulationError, match=r"t = 2 s with nan_at = 1\.5: output 'x' is not finite"):
        Simulator(probe(), experiment, ["nan_at"])([1.5])


@pytest.mark.parametrize("defines", [("FATAL",), ("NO_RESET",)])
def test_after_a_fatal_error_or_without_reset_a_new_instance_serves(probe: ProbeMaker, defines: tuple[str]) -> None:
    times = np.arange(4.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    simulator = Simulator(probe(*defines), experiment, ["gain", "fail_at"])
    for _ in range(3):
        with pytest.raises(SimulationError):
            simulator([1.0, 1.5])
        assert simulator([2.0, 99.0])[:, 0].tolist() == [0, 2, 4, 6]
        assert simulator([3.0, 99.0])[:, 0].tolist() == [0, 3, 6, 9]


def test_an_fmu_whose_reset_keeps_something_is_instantiated_anew_and_the_user_told(
    probe: ProbeMaker, caplog: pytest.LogCaptureFixture
) -> None:
    times = np.arange(4.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    simulator = Simulator(probe("LEAKY_RESET"), experiment, ["gain"])
    for gains in ([[1.0]], [[2.0], [3.0], [4.0]], [[5.0]] * 9):
        assert simulator(gains)[:, :, 0].tolist() == [[0, g, 2 * g, 3 * g] for (g,) in gains]
    assert sum("its reset does not work" in record.getMessage() for record in caplog.records) == 1


def test_an_fmu_that_neither_resets_nor_can_be_replaced_is_simulated_once(
    probe: ProbeMaker, caplog: pytest.LogCaptureFixture
) -> None:
    times = np.arange(4.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    simulator = Simulator(probe("LEAKY_RESET", canBeInstantiatedOnlyOncePerProcess="true"), experiment, ["gain"])
    assert simulator([2.0])[:, 0].tolist() == [0, 2, 4, 6]
    for _ in range(2):
        with pytest.raises(InputError, match=r"probe.*only one simulation is possible.*working reset"):
            simulator([2.0])
    assert not caplog.records


@pytest.mark.parametrize("at", [1, 2])
def test_a_cancelled_repetition_says_nothing_of_the_fmu(
    at: int, probe: ProbeMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.arange(4.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    system = System(probe())
    simulator, repeats, asked = Simulator(system, experiment, ["gain"]), SimulationThread._repeats, list[int]()

    def cancelled(thread: SimulationThread, job: SimulationJob) -> tuple[bool, bool]:
        asked.append(len(asked) + 1)
        if asked[-1] == at:
            executor_of(system).cancel()
        return repeats(thread, job) if at == 1 or asked[-1] > 1 else (False, False)

    monkeypatch.setattr(SimulationThread, "_repeats", cancelled)
    simulator([2.0])
    monkeypatch.undo()
    assert asked == [1, 2]
    for _ in range(2):
        assert simulator([2.0])[:, 0].tolist() == [0, 2, 4, 6]


def test_a_binary_without_functions_that_nobody_calls_serves(probe: ProbeMaker) -> None:
    times = np.arange(3.0)
    experiment = Experiment(table(times, u=1 + 0 * times, x=0 * times), ["u"], ["x"], interpolation="zoh")
    assert Simulator(probe("INCOMPLETE"), experiment)([])[:, 0].tolist() == [0, 1, 2]


def test_one_instance_serves_where_the_fmu_allows_no_more(probe: ProbeMaker) -> None:
    times = np.arange(3.0)
    experiment = Experiment(table(times, instances=0 * times), outputs=["instances"])
    system = System(probe("ONCE", canBeInstantiatedOnlyOncePerProcess="true"))
    simulators = [Simulator(system, experiment, ["gain"]) for _ in range(2)]
    for simulator in simulators:
        assert (simulator(np.ones((9, 1))) == 1).all()
    simulators[0].close()
    with pytest.raises(InputError, match="only once in a process"):
        simulators[1]([1.0])


def test_instances_are_kept_and_freed(probe: ProbeMaker) -> None:
    times = np.arange(3.0)
    experiment = Experiment(table(times, instances=0 * times), outputs=["instances"])
    path = probe(maxOutputDerivativeOrder="0")  # another file: its library counts its own instances
    simulator = Simulator(path, experiment, ["gain"])
    simulator(np.ones((8, 1)))
    first = simulator([1.0]).max()
    assert simulator(np.ones((200, 1))).max() == first  # not one more for 200 simulations
    simulator.close()
    assert simulator([1.0]).max() == 1


def test_warnings_of_the_fmu_reach_the_user_once(probe: ProbeMaker, caplog: pytest.LogCaptureFixture) -> None:
    times = np.arange(3.0)
    experiment = Experiment(table(times, x=0 * times), outputs=["x"])
    simulator = Simulator(probe(), experiment, values={"n": 7, "word": "lucky"})
    with caplog.at_level(logging.WARNING, "fmuid.fmu"):
        for _ in range(3):
            simulator([])
    assert [record.getMessage() for record in caplog.records] == [
        "Probe: lucky: seven at 0",
        "Probe: lucky: seven at 1",
    ]


@pytest.mark.parametrize("once", ["false", "true"])
@pytest.mark.parametrize("isolation", [None, Isolation(threads=2)])
def test_warnings_are_passed_on_once_for_all_threads_and_processes(
    probe: ProbeMaker,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    once: str,
    isolation: Isolation | None,
) -> None:
    """Two simulations at a time, in threads or in processes of their own; and anew, with other instances."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    experiment = Experiment(table(np.arange(3.0), x=np.zeros(3)), outputs=["x"])
    with closing(System(probe(canBeInstantiatedOnlyOncePerProcess=once), isolation=isolation)) as system:
        simulator = Simulator(system, experiment, ["gain"], values={"n": 7, "word": "lucky"})
        with caplog.at_level(logging.WARNING, "fmuid.fmu"):
            simulator(np.ones((20, 1)))
            if isolation is not None or once == "false":  # one that can be instantiated once stays
                close(system)
            simulator(np.ones((20, 1)))
    said = [record.getMessage() for record in caplog.records]
    assert sorted(said) == ["Probe: lucky: seven at 0", "Probe: lucky: seven at 1"]


def test_irregular_sampling_is_refused_where_the_fmu_needs_equal_steps(probe: ProbeMaker) -> None:
    path = probe(canHandleVariableCommunicationStepSize="false")
    regular = Experiment(table(np.arange(5) * 0.1, x=np.zeros(5)), outputs=["x"])
    assert Simulator(path, regular)([]).shape == (5, 1)
    irregular = Experiment(table(np.array([0, 1.0, 2.5]), x=np.zeros(3)), outputs=["x"])
    with pytest.raises(InputError, match="needs equal communication steps"):
        Simulator(path, irregular)


@pytest.mark.parametrize(
    ("roles", "message"),
    [
        ({"inputs": ["v"], "outputs": ["x"]}, "no input 'v'"),
        (
            {"inputs": ["gain"], "outputs": ["x"]},
            "'gain' as 'parameter', not as input. Its inputs are u, n, b",
        ),
        ({"inputs": ["u"], "outputs": ["gain"]}, "'gain' as 'parameter', not as output"),
        ({"inputs": ["u"], "outputs": ["x"], "parameters": ["gian"]}, r"no parameter 'gian' \(did you mean 'gain'"),
        ({"inputs": ["u"], "outputs": ["x"], "parameters": ["twice"]}, "'twice' cannot be set"),
        ({"inputs": ["u"], "outputs": ["x"], "parameters": ["word"]}, "Only Real parameters"),
        ({"inputs": ["u"], "outputs": ["x"], "parameters": ["u"]}, "'u' is an input of the table"),
        (
            {"inputs": ["u"], "outputs": ["x"], "parameters": ["gain"], "values": {"gain": 2.0}},
            "both a parameter and fixed",
        ),
        ({"inputs": ["u"], "outputs": ["x"], "values": {"n": 1.5}}, "of type Integer"),
        ({"inputs": ["u"], "outputs": ["x"], "values": {"gain": True}}, "of type Real"),
        (
            {"inputs": ["u"], "outputs": ["x"], "units": {"u": "furlong"}},
            "'furlong', the unit of the column of 'u', does not convert to 'rad/s'",
        ),
    ],
)
def test_wrong_roles_are_one_sentence(probe: ProbeMaker, roles: dict[str, object], message: str) -> None:
    columns = {name: np.zeros(3) for name in ("u", "x", "gain", "v")}
    with pytest.raises(InputError, match=message):
        Simulator(
            probe(),
            Experiment(
                table(np.arange(3.0), **columns),
                roles["inputs"],  # type: ignore[arg-type]
                roles["outputs"],  # type: ignore[arg-type]
                units=roles.get("units", {}),  # type: ignore[arg-type]
            ),
            roles.get("parameters", ()),  # type: ignore[arg-type]
            values=roles.get("values", {}),  # type: ignore[arg-type]
        )


def test_theta_of_the_wrong_shape_is_refused() -> None:
    times = np.arange(3.0)
    simulator = Simulator(COIL, Experiment(table(times, i=0 * times), outputs=["i"]), ["R", "L"])
    with pytest.raises(InputError, match="theta must have 2 values"):
        simulator([1.0])
    with pytest.raises(InputError, match="must be finite"):
        simulator([1.0, np.nan])
    assert simulator.unfed_inputs == ("u",)


def test_the_working_directory_stays(probe: ProbeMaker) -> None:
    here = Path.cwd()
    times = np.arange(3.0)
    Simulator(probe(), Experiment(table(times, x=0 * times), outputs=["x"]))([])
    assert Path.cwd() == here


def test_failure_over_dirty_memory(probe: ProbeMaker, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the memory behind a failed simulation held before, infinities of both signs say, is never looked at."""
    empty = np.empty

    def dirty(*arguments: Any, **words: Any) -> Any:
        array = empty(*arguments, **words)
        if array.dtype == float:
            array.ravel()[:] = np.resize([np.inf, -np.inf, 1e308], array.size)
        return array

    times = np.arange(10) * 0.1
    experiment = Experiment(table(times, u=0.0, x=0.0), ["u"], ["x"])
    simulator = Simulator(probe(), experiment, ["fail_at"])
    monkeypatch.setattr(np, "empty", dirty)
    batch = simulator.many([[0.15]])
    assert isinstance(batch.errors[0], SimulationError)
    assert np.isnan(batch.outputs).all()


def test_an_interruption_ends_the_simulations_of_other_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The caller's own share is interrupted while another thread is in a simulation that takes for ever."""
    numerics = Numerics("model-exchange", "rk4", step_size=1e-9)
    frame = table(np.array([0.0, 1e5]), x=np.zeros(2))
    experiment = Experiment(frame, outputs={"x0": "x"})
    path = hybrid_fmu(tmp_path, "van_der_pol", attributes='canBeInstantiatedOnlyOncePerProcess="false"')
    simulator = Simulator(System(path, numerics=numerics), experiment, ["start0"], values={"p0": 1.0})
    other = threading.Event()
    original = SimulationThread._simulate

    def simulate(thread: SimulationThread, *arguments: Any) -> None:
        if thread._index == 0:
            assert other.wait(60.0)
            raise KeyboardInterrupt
        other.set()
        original(thread, *arguments)

    monkeypatch.setattr(SimulationThread, "_simulate", simulate)
    with pytest.raises(KeyboardInterrupt):
        simulator([[2.0], [2.0]])
