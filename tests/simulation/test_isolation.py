"""FMUs in processes of their own: whatever an FMU does costs one simulation, and all others are those in-process."""

from __future__ import annotations

import gc
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest
from numpy.typing import NDArray

from fmuid.array_types import Floats
from fmuid.data.experiment import Experiment
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.models.component import Isolation, Numerics
from fmuid.models.system import System
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.isolation.host import FmuHost
from fmuid.simulation.sensitivities import derivatives_of
from fmuid.simulation.simulator import Simulator
from tests.support.isolated import (
    BAD,
    NAMES,
    PROCESSES,
    RECORD,
    RECORD_FRAME,
    check_costs_only_its_own,
    expected,
    thetas,
)
from tests.support.misbehaving import Mode, Where, misbehaving_fmu
from tests.support.paths import FMUS
from tests.support.quick import first

pytestmark = PROCESSES


CRASHES = {
    Mode.SEGFAULT: "its process crashed with SIGSEGV",
    Mode.ABORT: "its process crashed with SIGABRT",
    Mode.ILLEGAL: "its process crashed with SIGILL",
    Mode.DIVISION: "its process crashed with SIGFPE",
    Mode.DOUBLE_FREE: "its process crashed with SIGABRT",
    Mode.STACK: "its process crashed with SIG",  # SIGSEGV or SIGBUS
    Mode.EXIT_0: "ended its process with exit code 0",
    Mode.EXIT_3: "ended its process with exit code 3",
    Mode.KILL: "SIGKILL",
}
HANGS = (Mode.LOOP, Mode.SLEEP, Mode.STUBBORN)
STATUSES = {
    Mode.RETURN_ERROR: "returned fmi2Error",
    Mode.RETURN_FATAL: "returned fmi2Fatal",
    Mode.RETURN_DISCARD: "returned fmi2Discard",
    Mode.RETURN_NONSENSE: "returned the illegal status 17",
    Mode.NOT_A_NUMBER: "output 'x' is not finite",
}


@pytest.mark.parametrize("mode", first(3, CRASHES))
def test_a_crash_costs_one_simulation(folder: Path, mode: Mode) -> None:
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(mode), CRASHES[mode], Isolation(time_limit=600.0))


@pytest.mark.parametrize("isolation", [None, Isolation(threads=1)], ids=["in-process", "isolated"])
@pytest.mark.parametrize("mode", STATUSES)
def test_a_reset_that_fails_is_not_charged_to_the_next(folder: Path, mode: Mode, isolation: Isolation | None) -> None:
    """A simulation whose instance cannot be reset after it has succeeded, and so does the one after it."""
    some = thetas(mode)
    values = {"where": float(Where.RESET)}
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values=values, isolation=isolation)
    simulator(some[:3])  # by now a reset is known to work
    assert np.array_equal(simulator(some), expected(folder, some))


@pytest.mark.slow
@pytest.mark.parametrize("mode", HANGS)
def test_a_hang_costs_one_simulation(folder: Path, mode: Mode) -> None:
    words = "did not end within 1 s and was stopped"
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(mode), words, Isolation(time_limit=1.0))


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "amount"), [(Mode.RUNAWAY, 0), (Mode.LEAK, 60)])
def test_runaway_memory_costs_one_simulation(folder: Path, mode: Mode, amount: float) -> None:
    words = "its process took more than 300 MB and was stopped"
    isolation = Isolation(time_limit=600.0, memory_limit_mb=300.0)
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(mode), words, isolation, amount=amount)


@pytest.mark.parametrize("mode", STATUSES)
def test_a_failing_status_says_the_same_as_in_process(folder: Path, mode: Mode) -> None:
    """All modes misbehave where they should: these, in-process too, which is also where the others' words come from."""
    fmu, some = misbehaving_fmu(folder), thetas(mode)
    check_costs_only_its_own(fmu, some, STATUSES[mode], Isolation())
    alone = Simulator(fmu, RECORD, NAMES, values={"at": 0.95}).many(some)
    isolated = Simulator(fmu, RECORD, NAMES, values={"at": 0.95}, isolation=Isolation()).many(some)
    assert [str(error) for error in isolated.errors] == [str(error) for error in alone.errors]
    assert np.array_equal(isolated.outputs, alone.outputs, equal_nan=True)


@pytest.mark.parametrize("version", first(1, [2, 3]))
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("where", [Where.STEP, Where.INITIALIZATION, Where.GETTING])
def test_in_every_interface_and_call(folder: Path, version: int, kind: str, where: Where) -> None:
    fmu = misbehaving_fmu(folder, version=version)
    words = CRASHES[Mode.SEGFAULT]
    check_costs_only_its_own(fmu, thetas(Mode.SEGFAULT), words, Isolation(), numerics=Numerics(kind), where=where)


@pytest.mark.slow
def test_a_hang_between_samples_of_model_exchange(folder: Path) -> None:
    numerics = Numerics("model-exchange", "cvode")
    words = "did not end within 1 s"
    check_costs_only_its_own(
        misbehaving_fmu(folder), thetas(Mode.LOOP), words, Isolation(time_limit=1.0), numerics=numerics
    )


def test_an_fmu_that_closes_all_files_of_its_process_costs_none(folder: Path) -> None:
    """Thetas and outputs are in memory that both sides share; what is left undone goes to a new process."""
    some = thetas(Mode.CLOSE)
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(time_limit=600.0))
    assert np.array_equal(simulator(some), expected(folder, some))
    assert np.array_equal(simulator(some), expected(folder, some))


@pytest.mark.parametrize("where", [Where.RESET, Where.FREEING])
def test_a_crash_after_a_simulation_costs_none(folder: Path, where: Where) -> None:
    """Whether it is only some instances that crash when they are reset or freed, or all of them."""
    some = thetas(Mode.SEGFAULT)
    for each in (some, some * [1, 1, 0] + [0, 0, Mode.SEGFAULT]):
        simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values={"where": where}, isolation=Isolation())
        found = simulator.many(each)
        simulator.close()
        assert found.errors == (None,) * len(each)
        assert np.abs(found.outputs - expected(folder, each)).max() < 1e-14


@pytest.mark.parametrize("how", [{"token": f"at-instantiation-{Mode.SEGFAULT:d}"}, {"at_loading": Mode.SEGFAULT}])
def test_a_crash_before_there_is_an_instance_is_one_sentence(folder: Path, how: dict[str, Any]) -> None:
    fmu = misbehaving_fmu(folder, **how)
    with pytest.raises(FmuidError) as caught:
        Simulator(fmu, RECORD, NAMES, isolation=Isolation())([1.0, 1.0, 0.0])
    assert str(fmu) in str(caught.value)
    assert "its process crashed with SIGSEGV" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_default_time_limit_follows_the_simulations_before(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An FMU that hangs after good simulations, of milliseconds, is stopped after seconds: here half of one."""
    monkeypatch.setattr("fmuid.simulation.isolation.host.LEAST_TIME_LIMIT", 0.5)
    monkeypatch.setattr("fmuid.simulation.isolation.host.SLOWER_FACTOR", 1.0)
    monkeypatch.setattr("fmuid.simulation.isolation.host.FIRST_TIME_LIMIT", 1e6)
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation())
    simulator([1.0, 1.0, 0.0])
    with pytest.raises(SimulationError, match=r"did not end within the default time limit .* and was stopped"):
        simulator([1.0, 1.0, Mode.LOOP])


@pytest.mark.parametrize(
    ("word", "value"), [("time_limit", 0.0), ("memory_limit_mb", -1.0), ("max_simulations_per_process", 0)]
)
def test_wrong_settings_are_one_sentence(word: str, value: float) -> None:
    with pytest.raises(InputError, match=word):
        Isolation(**{word: value})  # type: ignore[arg-type]


# --- what the FMU prints


def test_what_the_fmu_prints_is_kept_apart(folder: Path) -> None:
    """Lines, half lines, and the last words before a crash; the fixture above sees to it that none comes out here."""
    system = System(misbehaving_fmu(folder), isolation=Isolation())
    simulator = Simulator(system, RECORD, NAMES)
    for mode, words in ((Mode.SPEAK, "the FMU says on {}: gain"), (Mode.MUTTER, "no line of {}")):
        assert np.array_equal(simulator([[2.0, 0.5, mode]]), expected(folder, np.array([[2.0, 0.5, 0.0]])))
        said = executor_of(system).printed()
        assert words.format("stdout") in said
        assert words.format("stderr") in said
        assert executor_of(system).printed() == ""
    with pytest.raises(SimulationError, match="SIGABRT"):
        simulator([2.0, 0.5, Mode.DOUBLE_FREE])
    if sys.platform == "linux":
        assert "double free" in executor_of(system).printed()


def test_what_is_printed_before_a_crash_is_there(folder: Path) -> None:
    fmu = misbehaving_fmu(folder)
    system = System(
        components={"speaks": fmu, "crashes": fmu}, connections=[("speaks.x", "crashes.u")], isolation=Isolation()
    )
    record = Experiment(RECORD_FRAME, {"speaks.u": "u"}, {"crashes.x": "x"}, interpolation="zoh")
    values = {"speaks.mode": Mode.SPEAK.value, "crashes.mode": Mode.SEGFAULT.value, "crashes.at": 2.0}
    with pytest.raises(SimulationError, match=r"crashed with SIGSEGV"):
        Simulator(system, record, values=values)([])
    assert "the FMU says on stdout" in executor_of(system).printed()


def test_ten_megabytes_of_print_neither_block_nor_fill_the_memory(folder: Path) -> None:
    system = System(misbehaving_fmu(folder), isolation=Isolation())
    some = thetas(Mode.CHATTER)[:4]
    assert np.array_equal(Simulator(system, RECORD, NAMES, values={"amount": 10.0})(some), expected(folder, some))
    said = executor_of(system).printed()
    assert "a line on std" in said
    assert len(said) < 2_000_000


def test_a_library_that_prints_when_it_is_loaded(folder: Path) -> None:
    system = System(misbehaving_fmu(folder, at_loading=Mode.SPEAK), isolation=Isolation())
    Simulator(system, RECORD, NAMES)([2.0, 0.5, 0.0])
    assert "the FMU says on stdout" in executor_of(system).printed()


# --- memory


@pytest.mark.slow
def test_recycling_bounds_the_memory_of_an_fmu_that_leaks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """8 MB a simulation, 60 simulations: a process that is replaced every ten has 80 MB of it before its end."""
    simulator, plain = (
        Simulator(misbehaving_fmu(folder), RECORD, NAMES, values={"amount": 8.0}, isolation=isolation)
        for isolation in (Isolation(max_simulations_per_process=10, threads=1), Isolation(threads=1))
    )
    sizes, close = list[tuple[int, float]](), FmuHost.close

    def weighed(host: FmuHost) -> None:
        sizes.append((host.simulations, psutil.Process(host.pid).memory_info().rss / 1e6))
        close(host)

    monkeypatch.setattr(FmuHost, "close", weighed)
    some = np.tile([2.0, 0.5, Mode.LEAK_ONCE], (60, 1))
    gc.collect()  # what other tests have left is not counted
    sizes.clear()
    plain(some[:1] * [1.0, 1.0, 0.0])
    plain.close()
    assert np.array_equal(simulator(some), expected(folder, some))
    (one, without), *leaked = sizes
    assert [one, *(simulations for simulations, _ in leaked)] == [1] + 6 * [10]
    assert all(9 * 8 <= size - without < 160 for _, size in leaked)


def test_an_fmu_that_leaks_slowly_is_not_blamed(folder: Path) -> None:
    """No single simulation takes more than the limit; all together they do, and go on in new processes."""
    some = np.tile([2.0, 0.5, Mode.LEAK_ONCE], (60, 1))
    simulator = Simulator(
        misbehaving_fmu(folder), RECORD, NAMES, values={"amount": 20.0}, isolation=Isolation(memory_limit_mb=400.0)
    )
    assert np.array_equal(simulator(some), expected(folder, some))


# --- the same numbers as in-process


def test_coupled_systems_and_forward_sensitivities_bit_for_bit() -> None:
    machine = FMUS / "InductionMachine" / "InductionMachine.fmu"
    times: Floats = np.linspace(0.0, 299 * 7e-4, 300)
    frame = pd.DataFrame(
        {"time": times, "uds": 100 * np.cos(300 * times), "uqs": 100 * np.sin(300 * times), "w": 150.0}
    ).assign(ids=0.0, iqs=0.0)
    record = Experiment(frame, ["uds", "uqs", "w"], ["ids", "iqs"])
    some = np.random.default_rng(3).uniform([8.0, 3.0, 0.4, 0.07], [11.0, 5.0, 0.5, 0.09], (5, 4))
    for integrator in ("rk45", "cvode"):
        found = []
        for isolation in (None, Isolation()):
            system = System(machine, numerics=Numerics("model-exchange", integrator), isolation=isolation)
            simulator = Simulator(system, record, ("Rs", "Rr", "Lm", "Lf"))
            found.append((simulator(some), derivatives_of(simulator, "forward")(some[0])))
        assert np.array_equal(found[0][0], found[1][0])
        assert np.array_equal(found[0][1], found[1][1])
        assert np.abs(found[0][1]).max() > 0


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_two_coupled_fmus_bit_for_bit(folder: Path, master: str) -> None:
    coil = FMUS / "Coil" / "Coil.fmu"
    record = Experiment(RECORD_FRAME, {"coil.u": "u"}, {"lag.x": "x"})
    found = []
    for isolation in (None, Isolation()):
        system = System(
            components={"coil": coil, "lag": misbehaving_fmu(folder)},
            connections=[("coil.i", "lag.u", 1.0, 0.0)],
            numerics=Numerics(step_size=0.01),
            master=master,
            isolation=isolation,
        )
        simulator = Simulator(system, record, ("coil.R", "coil.L", "lag.T"))
        found.append(simulator(np.random.default_rng(4).uniform([2.0, 0.1, 0.2], [5.0, 0.5, 1.0], (9, 3))))
    assert np.array_equal(found[0], found[1])


def test_an_fmu_with_state_of_the_whole_process(folder: Path) -> None:
    """It may be instantiated once in a process: two systems of it cannot be in this one, but each in its own."""
    fmu = misbehaving_fmu(folder, token="shared", canBeInstantiatedOnlyOncePerProcess="true")
    some = thetas(Mode.SOUND)
    simulators = [Simulator(System(fmu, isolation=Isolation()), RECORD, NAMES) for _ in range(2)]
    for _ in range(2):
        for simulator in simulators:
            assert np.array_equal(simulator(some), expected(folder, some))
    alone = [Simulator(System(fmu), RECORD, NAMES) for _ in range(2)]
    assert np.array_equal(alone[0](some), expected(folder, some))
    with pytest.raises(InputError, match="only once in a process"):
        alone[1](some)


def test_threads_call_simulators_at_the_same_time(folder: Path) -> None:
    """Four threads, three systems, one of them shared, one that crashes now and then."""
    fmu = misbehaving_fmu(folder)
    shared, crashing, own = (Simulator(fmu, RECORD, NAMES, isolation=Isolation()) for _ in range(3))
    some, bad = thetas(Mode.SOUND), thetas(Mode.ABORT)
    good = np.setdiff1d(np.arange(len(bad)), BAD)
    found: list[bool] = []

    def work(simulator: Simulator, each: Floats, rows: NDArray[np.intp]) -> None:
        for _ in range(4):
            outputs = simulator.many(each).outputs
            found.append(np.array_equal(outputs[rows], expected(folder, each)[rows]))

    every = np.arange(len(some))
    jobs = [(shared, some, every), (shared, some, every), (crashing, bad, good), (own, some, every)]
    threads = [threading.Thread(target=work, args=job) for job in jobs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [True] * 16
