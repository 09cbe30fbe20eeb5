"""FMUs whose instances cannot share one process are kept apart; those that disturb each other have new processes."""

import gc
import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import (
    FMU,
    Component,
    Experiment,
    InputError,
    Isolation,
    Numerics,
    Parameter,
    Problem,
    Simulator,
    System,
    identify,
)
from fmuid.models import KINDS, SolverConfiguration
from fmuid.reports.topics.solver_check import run_words
from fmuid.simulation import closing
from fmuid.simulation.executor_pool import threads
from fmuid.simulation.instance_registry import in_threads
from tests.support.experiments import record
from tests.support.isolated import NAMES, PROCESSES, RECORD, closed_form, thetas
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.quick import first
from tests.support.stepping import LAG, stepping_fmu

SAYS_SO: dict[str, Any] = {"canBeInstantiatedOnlyOncePerProcess": "false"}
OPEN_MODELICA: dict[str, Any] = {"tool": "OpenModelica Compiler OpenModelica v1.26.0 (64-bit)", **SAYS_SO}
ACCURACY = {"co-simulation": 1e-14, "model-exchange": 1e-5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sharing")


def check(simulator: Simulator) -> None:
    """Check that simulations come out right."""
    kind = simulator.system.components[""].kind
    some = thetas(Mode.SOUND)
    found = simulator.many(some)
    assert found.errors == (None,) * len(some)
    assert np.abs(found.outputs[:, :, 0] - closed_form(some)).max() < ACCURACY[kind]


@pytest.fixture(autouse=True)
def _four_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "4")


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({}, False),
        (SAYS_SO, True),
        ({"tool": "fmuid"}, True),
        ({"tool": "Reference FMUs (v0.0.39)"}, True),
        ({"tool": "Some Tool 2.0"}, False),
        ({"tool": "Some Tool 2.0", **SAYS_SO}, True),
        (OPEN_MODELICA, False),
        ({"canBeInstantiatedOnlyOncePerProcess": "true"}, False),
        ({"tool": "fmuid", "canBeInstantiatedOnlyOncePerProcess": "true"}, False),
        ({"tool": "fmuid", "needsExecutionTool": "true"}, False),
    ],
)
@pytest.mark.parametrize("version", first(1, [3, 2]))
def test_threads_are_for_fmus_that_are_known_to_bear_them(
    tmp_path: Path, said: dict[str, Any], expected: bool, version: int
) -> None:
    description = FMU(misbehaving_fmu(tmp_path, version=version, **said)).description
    assert [in_threads(description, kind) for kind in KINDS] == [expected] * 2


def test_the_fmu_of_these_tests_does_not_bear_threads(folder: Path) -> None:
    """With the word of an FMU that it does, it fails: what these tests show is not for nothing."""
    assert threads() == 4
    fmu = misbehaving_fmu(folder, token="alone", **SAYS_SO)
    simulator = Simulator(fmu, RECORD, NAMES)
    try:
        assert any(simulator.many(np.repeat(thetas(Mode.SOUND), 4, axis=0)).errors)
    except InputError as error:  # threads that disturb the repeated first simulation look like memory outside instances
        assert "outside its instances" in str(error)


@pytest.mark.slow
def test_no_instance_is_freed_while_another_lives(folder: Path) -> None:
    fmu = misbehaving_fmu(folder, token="alone in a crowd")
    first, second = (Simulator(fmu, RECORD, NAMES) for _ in range(2))
    check(first)
    check(second)
    first.close()
    check(second)
    check(first)
    del second
    gc.collect()
    check(first)


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("co-simulation",) * 4, KINDS * 2], ids=["one interface", "both"])
def test_systems_in_threads_wait_for_each_other(folder: Path, kinds: tuple[str, ...]) -> None:
    """Threads of the user's own, as those of a worker of a cluster, each with a system of the same FMU."""
    fmu, failed = misbehaving_fmu(folder, token="alone in threads of others"), list[BaseException]()
    together = threading.Barrier(len(kinds))

    def run(kind: str) -> None:
        try:
            simulator = Simulator(fmu, RECORD, NAMES, interface=kind)
            together.wait()
            for _ in range(3):
                check(simulator)
        except BaseException as error:
            failed.append(error)

    running = [threading.Thread(target=run, args=(kind,)) for kind in kinds]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()
    assert not failed


def test_one_system_cannot_have_both_interfaces(folder: Path) -> None:
    fmu = misbehaving_fmu(folder, token="alone", tool="Some Tool")
    parts = {kind[:2]: Component(fmu, Numerics(interface=kind)) for kind in KINDS}
    experiment = type(RECORD)(RECORD.frame, {"co.u": "u"}, {"mo.x": "x"})
    with pytest.raises(InputError, match=r"can crash FMUs of Some Tool.*one interface"):
        Simulator(System(components=parts), experiment)([])


pytestmark = PROCESSES
# --- an FMU that keeps something outside its instances, by which each simulation changes the ones after it

MEMORY = 1e-3  # added to the input after each simulation


def experiment() -> Experiment:
    """Return a record of x' = u - 3 x in closed form, u held."""
    step, n, k = 0.01, 100, 3.0
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    x = np.zeros(n)
    for i in range(n - 1):
        x[i + 1] = u[i] / k + (x[i] - u[i] / k) * np.exp(-k * step)
    return record(step * np.arange(n), {"u": u}, {"x": x + 1e-3 * rng.standard_normal(n)})


def test_each_simulation_has_a_new_process(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Outputs are those of the same FMU without the memory, bit for bit, also where several go at a time."""
    thetas = [[1.0], [2.0], [1.0]]
    expected = Simulator(stepping_fmu(folder, LAG, order=4), experiment(), ["k"])(thetas)
    with closing(System(stepping_fmu(folder, LAG, order=4, memory=MEMORY), isolation=Isolation())) as system:
        simulator = Simulator(system, experiment(), ["k"])
        with caplog.at_level(logging.WARNING, "fmuid.fmu"):
            np.testing.assert_array_equal(simulator(thetas), expected)
            np.testing.assert_array_equal(simulator([1.0]), expected[0])
    (record,) = caplog.records
    assert "keeps data outside its instances; each simulation uses a new process" in record.getMessage()


@pytest.mark.slow
def test_identify_by_new_processes(folder: Path) -> None:
    """The cost never rises over accepted steps, the estimate is that of the FMU without memory, the result says how."""
    found = []
    for memory in (0.0, MEMORY):
        with closing(System(stepping_fmu(folder, LAG, order=4, memory=memory), isolation=Isolation())) as system:
            problem = Problem(system, experiment(), {"k": Parameter(1.0, min=0.1, max=10.0)})
            found.append(identify(problem, solver_check="off", restart=False))
    plain, result = found
    assert result.values[0] == plain.values[0]
    trace = result.trace
    for _, costs in trace[trace["accepted"]].groupby("round")["cost"]:
        assert (np.diff(costs) <= 0.0).all()
    assert [each.setup.models[""]["run"]["new_processes"] for each in found] == [False, True]
    assert run_words(SolverConfiguration(**result.setup.models[""]["run"])).endswith(
        "in a new process for each simulation"
    )


def test_one_simulation_in_a_process(folder: Path) -> None:
    """Without new processes it is refused, at once where several simulations were asked for."""
    path, sentence = (
        stepping_fmu(folder, LAG, order=4, memory=2 * MEMORY),
        r"outside its instances, so only one simulation is possible",
    )
    with pytest.raises(InputError, match=sentence):
        Simulator(path, experiment(), ["k"])([[1.0], [2.0]])
    with pytest.raises(InputError, match=sentence):
        identify(Problem(path, experiment(), {"k": Parameter(1.0, min=0.1, max=10.0)}))


def test_outputs_at_random_are_refused(folder: Path) -> None:
    """What differs from process to process no process mends."""
    path = stepping_fmu(folder, LAG, order=4, memory=MEMORY, seed="getpid()")
    with closing(System(path, isolation=Isolation())) as system:
        simulator = Simulator(system, experiment(), ["k"])
        with pytest.raises(InputError, match=r"outputs differ between simulations .* also in new processes"):
            simulator([1.0])
