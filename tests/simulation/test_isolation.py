"""FMUs in separate processes: misbehavior costs one simulation; all others equal those in this process."""

import gc
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from fmuid import FmuidError, InputError, Isolation, Numerics, SimulationError, Simulator, System
from fmuid.array_types import Floats
from fmuid.processes.limits import condition_of
from fmuid.simulation import FmuHost, closing, derivatives_of, executor_of
from fmuid.simulation.isolation.host import TimeLimits
from fmuid.simulation.isolation.isolated_executor import IsolatedExecutor, MultiProcessExecutor
from tests.support.experiments import record
from tests.support.isolated import (
    BAD,
    NAMES,
    PROCESSES,
    RECORD,
    check_costs_only_its_own,
    closed_form,
    expected,
    pair,
    processes,
    thetas,
    wait_until,
)
from tests.support.misbehaving import Mode, Where, misbehaving_fmu
from tests.support.paths import FMUS
from tests.support.quick import first

pytestmark = PROCESSES
LARGE, HANGS = "took more than 300 MB and was stopped", "did not end within 1 s and was stopped"
SMALL, SHORT = Isolation(time_limit=600.0, memory_limit_mb=300.0), Isolation(time_limit=1.0)
CRASHES = {
    Mode.SEGFAULT: "crashed with SIGSEGV",
    Mode.ABORT: "crashed with SIGABRT",
    Mode.FORGE: "corrupted the connection to its process",
    Mode.GARBLE: "corrupted the connection to its process",
    Mode.ILLEGAL: "crashed with SIGILL",
    Mode.DIVISION: "crashed with SIGFPE",
    Mode.DOUBLE_FREE: "crashed with SIGABRT",
    Mode.STACK: "crashed with SIG",  # SIGSEGV or SIGBUS
    Mode.EXIT_0: "ended its process with exit code 0",
    Mode.EXIT_3: "ended its process with exit code 3",
    Mode.KILL: "SIGKILL",
    Mode.STOP: "was stopped (SIGSTOP) and did not continue",
}
STATUSES = {
    Mode.RETURN_ERROR: "returned fmi2Error",
    Mode.RETURN_FATAL: "returned fmi2Fatal",
    Mode.RETURN_DISCARD: "returned fmi2Discard",
    Mode.RETURN_NONSENSE: "returned the illegal status 17",
    Mode.NOT_A_NUMBER: "output 'x' is not finite",
}


@pytest.mark.parametrize("mode", first(2, CRASHES))
def test_crash_costs_one_simulation(folder: Path, mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(mode), CRASHES[mode], Isolation(time_limit=600.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "words", "isolation", "given"),
    [
        (Mode.LOOP, HANGS, SHORT, {"numerics": Numerics("model-exchange", "cvode")}),
        (Mode.SLEEP, HANGS, SHORT, {}),
        (Mode.STUBBORN, HANGS, SHORT, {}),
        (Mode.RUNAWAY, LARGE, SMALL, {"amount": 0}),
        (Mode.LEAK, LARGE, SMALL, {"amount": 60}),
        (Mode.SHARE, LARGE, SMALL, {}),
        (Mode.BROOD, LARGE, SMALL, {}),
    ],
)
def test_hang_or_memory_costs_one_simulation(
    folder: Path, mode: Mode, words: str, isolation: Isolation, given: dict[str, Any]
) -> None:
    if mode in (Mode.SHARE, Mode.BROOD) and sys.platform != "linux":
        pytest.skip("only Linux counts shared memory and that of children")
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(mode), words, isolation, **given)


@pytest.mark.parametrize("mode", first(1, STATUSES))
def test_failing_status_equals_in_process(folder: Path, mode: Mode) -> None:
    """Also after a reset that fails: it is not charged to the next simulation."""
    fmu, some = misbehaving_fmu(folder), thetas(mode)
    check_costs_only_its_own(fmu, some, STATUSES[mode], Isolation())
    alone, isolated = (Simulator(fmu, RECORD, NAMES, values={"at": 0.95}, isolation=each) for each in pair())
    one, other = alone.many(some), isolated.many(some)
    assert [str(error) for error in other.errors] == [str(error) for error in one.errors]
    assert np.array_equal(other.outputs, one.outputs, equal_nan=True)
    for isolation in (None, Isolation(threads=1)):
        simulator = Simulator(fmu, RECORD, NAMES, values={"where": float(Where.RESET)}, isolation=isolation)
        simulator(some[:3])  # by now a reset is known to work
        assert np.array_equal(simulator(some), expected(folder, some))


@pytest.mark.parametrize("version", first(1, [2, 3]))
@pytest.mark.parametrize("kind", first(1, ["model-exchange", "co-simulation"]))
@pytest.mark.parametrize("where", [Where.STEP, Where.INITIALIZATION, Where.GETTING])
def test_crash_in_every_interface_and_call(folder: Path, version: int, kind: str, where: Where) -> None:
    fmu, some, words = misbehaving_fmu(folder, version=version), thetas(Mode.SEGFAULT), CRASHES[Mode.SEGFAULT]
    check_costs_only_its_own(fmu, some, words, Isolation(), numerics=Numerics(kind), where=where)


@pytest.mark.parametrize("where", [Where.RESET, Where.FREEING])
def test_crash_after_a_simulation_costs_nothing(folder: Path, where: Where) -> None:
    """Some instances crash when they are reset or freed, or all."""
    some = thetas(Mode.SEGFAULT)
    for each in (some, some * [1, 1, 0] + [0, 0, Mode.SEGFAULT]):
        simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values={"where": where}, isolation=Isolation())
        found = simulator.many(each)
        simulator.close()
        assert found.errors == (None,) * len(each)
        assert np.abs(found.outputs - expected(folder, each)).max() < 1e-14


@pytest.mark.parametrize("how", [{"token": f"at-instantiation-{Mode.SEGFAULT:d}"}, {"at_loading": Mode.SEGFAULT}])
def test_crash_without_instance_names_the_fmu(folder: Path, how: dict[str, Any]) -> None:
    fmu = misbehaving_fmu(folder, **how)
    with pytest.raises(FmuidError, match="its process crashed with SIGSEGV") as caught:
        Simulator(fmu, RECORD, NAMES, isolation=Isolation())([1.0, 1.0, 0.0])
    assert str(fmu) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_default_time_limit_follows_earlier_simulations(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.simulation.isolation.host.TIME_LIMITS", TimeLimits(first=1e6, least=0.2, slower=1.0))
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation())
    simulator([1.0, 1.0, 0.0])
    with pytest.raises(SimulationError, match=r"did not end within the default time limit .* and was stopped"):
        simulator([1.0, 1.0, Mode.LOOP])


@pytest.mark.parametrize(
    ("word", "value"), [("time_limit", 0.0), ("memory_limit_mb", -1.0), ("max_simulations_per_process", 0)]
)
def test_isolation_refuses_wrong_settings(word: str, value: Any) -> None:
    with pytest.raises(InputError, match=word):
        Isolation(**{word: value})


# --- what the FMU prints


def test_printed_text_is_kept_apart(folder: Path) -> None:
    """Lines, half lines, text of loading and before a crash; the fixture of all tests sees that none comes out here."""
    system = System(misbehaving_fmu(folder, at_loading=Mode.SPEAK), isolation=Isolation())
    simulator, executor = Simulator(system, RECORD, NAMES), executor_of(system)
    simulator([2.0, 0.5, 0.0])
    assert "the FMU says on stdout" in executor.printed()
    for mode, words in ((Mode.SPEAK, "the FMU says on {}: gain"), (Mode.MUTTER, "no line of {}")):
        assert np.array_equal(simulator([[2.0, 0.5, mode]]), expected(folder, np.array([[2.0, 0.5, 0.0]])))
        said = executor.printed()
        assert words.format("stdout") in said
        assert words.format("stderr") in said
        assert executor.printed() == ""
    with pytest.raises(SimulationError, match="SIGABRT"):
        simulator([2.0, 0.5, Mode.DOUBLE_FREE])
    assert sys.platform != "linux" or "double free" in executor.printed()


# --- memory


@pytest.mark.slow
def test_recycling_bounds_the_memory_of_a_leak(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """8 MB a simulation, 60 simulations: a process that is replaced every ten has 80 MB of it before its end."""
    sizes, close = list[tuple[int, float]](), FmuHost.close

    def measure(host: FmuHost) -> None:
        sizes.append((host.simulations, psutil.Process(host.pid).memory_info().rss / 1e6))
        close(host)

    monkeypatch.setattr(FmuHost, "close", measure)
    gc.collect()  # what other tests have left is not counted
    sizes.clear()
    some = np.tile([2.0, 0.5, Mode.LEAK_ONCE], (60, 1))
    for isolation, each in ((Isolation(threads=1), some[:1] * [1.0, 1.0, 0.0]), (Isolation(None, None, 10, 1), some)):
        values = {"amount": 8.0}
        simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values=values, isolation=isolation)
        assert np.array_equal(simulator(each), expected(folder, each))
        simulator.close()
    (one, without), *leaked = sizes
    assert [one, *(simulations for simulations, _ in leaked)] == [1] + 6 * [10]
    assert all(9 * 8 <= size - without < 160 for _, size in leaked)


# --- the same numbers as in-process


@pytest.mark.parametrize("integrator", ["rk45", "cvode"])
def test_outputs_and_forward_sensitivities_equal_in_process(integrator: str) -> None:
    times: Floats = np.linspace(0.0, 299 * 7e-4, 300)
    inputs: dict[str, Any] = {"uds": 100 * np.cos(300 * times), "uqs": 100 * np.sin(300 * times), "w": 150.0}
    experiment = record(times, inputs, ["ids", "iqs"], "linear")
    some = np.random.default_rng(3).uniform([8.0, 3.0, 0.4, 0.07], [11.0, 5.0, 0.5, 0.09], (5, 4))
    found = []
    for isolation in pair():
        path, numerics = FMUS / "InductionMachine" / "InductionMachine.fmu", Numerics("model-exchange", integrator)
        simulator = Simulator(
            System(path, numerics=numerics, isolation=isolation), experiment, ("Rs", "Rr", "Lm", "Lf")
        )
        found.append((simulator(some), derivatives_of(simulator, "forward")(some[0])))
    assert all(np.array_equal(one, other) and np.abs(one).max() > 0 for one, other in zip(*found, strict=True))


def test_fmu_with_state_of_the_whole_process(folder: Path) -> None:
    """Two systems of it cannot be in this process, but each in its own."""
    fmu = misbehaving_fmu(folder, token="shared", canBeInstantiatedOnlyOncePerProcess="true")
    some = thetas(Mode.SOUND)
    isolated, alone = ([Simulator(System(fmu, isolation=i), RECORD, NAMES) for _ in range(2)] for i in (SHORT, None))
    for simulator in (*isolated, *isolated, alone[0]):
        assert np.array_equal(simulator(some), expected(folder, some))
    with pytest.raises(InputError, match="only once in a process"):
        alone[1](some)


@pytest.mark.slow
def test_threads_call_simulators_at_the_same_time(folder: Path) -> None:
    """Four threads, three systems, one of them shared, one that crashes now and then."""
    shared, crashing, own = (Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=SMALL) for _ in range(3))
    some, bad = thetas(Mode.SOUND), thetas(Mode.ABORT)
    every, found = np.arange(len(some)), list[bool]()

    def work(simulator: Simulator, each: Floats, rows: NDArray[np.intp]) -> None:
        for _ in range(2):
            found.append(np.array_equal(simulator.many(each).outputs[rows], expected(folder, each)[rows]))

    jobs = [(shared, some, every), (shared, some, every), (crashing, bad, np.setdiff1d(every, BAD)), (own, some, every)]
    threads = [threading.Thread(target=work, args=job) for job in jobs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [True] * 8


# --- FMUs that do not bear threads, spread over processes

OPEN_MODELICA: dict[str, Any] = {"tool": "OpenModelica Compiler", "canBeInstantiatedOnlyOncePerProcess": "false"}


@pytest.fixture
def three_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")


def hosts_of(system: System) -> set[int]:
    """Return the processes that a system has."""
    executor: Any = executor_of(system)
    assert isinstance(executor, MultiProcessExecutor)
    return {host.pid for part in executor._parts for host in part._keeper._hosts}


@pytest.mark.usefixtures("three_at_a_time")
def test_it_runs_in_a_process_for_each_core_with_the_same_bits(tmp_path: Path) -> None:
    fmu, some = misbehaving_fmu(tmp_path, token="alone", **OPEN_MODELICA), thetas(Mode.SOUND)
    with closing(System(fmu, isolation=Isolation())) as system, closing(System(fmu)) as alone:
        found = Simulator(system, RECORD, NAMES)(some)
        assert np.array_equal(found, Simulator(alone, RECORD, NAMES)(some))
        assert np.abs(found[:, :, 0] - closed_form(some)).max() < 1e-14
        assert len(hosts_of(system)) == 3
    assert hosts_of(system) == set()


@pytest.mark.usefixtures("three_at_a_time")
@pytest.mark.parametrize(
    ("said", "threads", "spread"),
    [(OPEN_MODELICA, None, True), (OPEN_MODELICA, 1, False), ({"tool": "fmuid"}, None, False)],
)
def test_who_is_spread(tmp_path: Path, said: dict[str, Any], threads: int | None, spread: bool) -> None:
    system = System(misbehaving_fmu(tmp_path, **said), isolation=Isolation(threads=threads))
    assert isinstance(executor_of(system), MultiProcessExecutor if spread else IsolatedExecutor)


@pytest.mark.usefixtures("three_at_a_time")
@pytest.mark.parametrize("kind", ["spread", "one"])
def test_what_one_finds_stiff_is_run_again_by_all(kind: str) -> None:
    """The last theta is stiff, the first ones are not; in-process all are integrated as stiff then.

    One process alone has the first theta by itself, and the others afterwards.
    """
    experiment = record(np.linspace(0.0, 0.1, 11), {"u": 1.0}, ["i"], "linear")
    some = np.array([[1.0, 0.1], [2.0, 0.1], [4.0, 0.1], [4e3, 1e-5]])
    coil = FMUS / "Coil" / "Coil.fmu"
    system, alone = (System(coil, numerics=Numerics("model-exchange")) for _ in range(2))
    made = MultiProcessExecutor if kind == "spread" else IsolatedExecutor
    simulator: Any = Simulator(system, experiment, ["R", "L"])
    executor = simulator._executor = made(system.components, 3, Isolation(), set())
    found = simulator(some)
    plain = Simulator(alone, experiment, ["R", "L"])(some[:1])
    assert np.array_equal(found, Simulator(alone, experiment, ["R", "L"])(some))
    assert not np.array_equal(found[:1], plain)
    executor.close()


@pytest.mark.usefixtures("three_at_a_time")
def test_an_interruption_ends_all(tmp_path: Path) -> None:
    """All shares hang, that of this thread and those of the others, for longer than anybody waits."""
    fmu, some = misbehaving_fmu(tmp_path, **OPEN_MODELICA), thetas(Mode.SOUND)
    with closing(System(fmu, isolation=Isolation(time_limit=600.0))) as system:
        simulator = Simulator(system, RECORD, NAMES)
        expected, there = simulator(some), hosts_of(system)
        before = {pid: condition_of(pid).computed for pid in there}

        def interrupt() -> None:
            wait_until(lambda: all(condition_of(pid).computed > before[pid] + 0.1 for pid in there))
            os.kill(os.getpid(), signal.SIGINT)

        interrupter = threading.Thread(target=interrupt)
        with pytest.raises(KeyboardInterrupt):
            interrupter.start()
            simulator(some * [1, 1, 0] + [0, 0, Mode.LOOP])
        interrupter.join()
        assert len(there) == 3
        assert not there & {process.pid for process in processes() if process.status() != psutil.STATUS_ZOMBIE}
        assert np.array_equal(simulator(some), expected)
