"""FMUs that do not bear threads, spread over processes: the same bits, several at a time, none left running."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest

from fmuid.data.experiment import Experiment
from fmuid.models.component import Isolation, Numerics
from fmuid.models.system import System
from fmuid.processes.limits import condition_of
from fmuid.simulation.executor_pool import closing, executor_of
from fmuid.simulation.isolation.isolated_executor import IsolatedExecutor, MultiProcessExecutor
from fmuid.simulation.simulator import Simulator
from tests.support.isolated import NAMES, PROCESSES, RECORD, closed_form, processes, thetas, wait_until
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.paths import FMUS

pytestmark = PROCESSES
OPEN_MODELICA: dict[str, Any] = {"tool": "OpenModelica Compiler", "canBeInstantiatedOnlyOncePerProcess": "false"}


@pytest.fixture(autouse=True)
def _three_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")


def hosts_of(system: System) -> set[int]:
    """Return the processes that a system has."""
    executor: Any = executor_of(system)
    assert isinstance(executor, MultiProcessExecutor)
    return {host.pid for part in executor._parts for host in part._keeper._hosts}


def test_it_runs_in_a_process_for_each_core_with_the_same_bits(tmp_path: Path) -> None:
    fmu, some = misbehaving_fmu(tmp_path, token="alone", **OPEN_MODELICA), thetas(Mode.SOUND)
    with closing(System(fmu, isolation=Isolation())) as system, closing(System(fmu)) as alone:
        found = Simulator(system, RECORD, NAMES)(some)
        assert np.array_equal(found, Simulator(alone, RECORD, NAMES)(some))
        assert np.abs(found[:, :, 0] - closed_form(some)).max() < 1e-14
        assert len(hosts_of(system)) == 3
    assert hosts_of(system) == set()


@pytest.mark.parametrize(
    ("said", "threads", "spread"),
    [(OPEN_MODELICA, None, True), (OPEN_MODELICA, 1, False), ({"tool": "fmuid"}, None, False)],
)
def test_who_is_spread(tmp_path: Path, said: dict[str, Any], threads: int | None, spread: bool) -> None:
    system = System(misbehaving_fmu(tmp_path, **said), isolation=Isolation(threads=threads))
    assert isinstance(executor_of(system), MultiProcessExecutor if spread else IsolatedExecutor)


@pytest.mark.parametrize("kind", ["spread", "one"])
def test_what_one_finds_stiff_is_run_again_by_all(kind: str) -> None:
    """The last theta is stiff, the first ones are not; in-process all are integrated as stiff then.

    One process alone has the first theta by itself, and the others afterwards.
    """
    times = np.linspace(0.0, 0.1, 11)
    record = Experiment(pd.DataFrame({"time": times, "u": 1.0, "i": 0.0}), ["u"], ["i"])
    some = np.array([[1.0, 0.1], [2.0, 0.1], [4.0, 0.1], [4e3, 1e-5]])
    coil = FMUS / "Coil" / "Coil.fmu"
    system, alone = (System(coil, numerics=Numerics("model-exchange")) for _ in range(2))
    made = MultiProcessExecutor if kind == "spread" else IsolatedExecutor
    simulator: Any = Simulator(system, record, ["R", "L"])
    executor = simulator._executor = made(system.components, 3, Isolation(), set())
    found = simulator(some)
    plain = Simulator(alone, record, ["R", "L"])(some[:1])
    assert np.array_equal(found, Simulator(alone, record, ["R", "L"])(some))
    assert not np.array_equal(found[:1], plain)
    executor.close()


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
