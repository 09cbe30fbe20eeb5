"""FMUs that write into the connection, fork into it, or stop processes: one simulation is lost at most, none waits."""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from fmuid.models.component import Isolation
from fmuid.processes import HUNG, STOPPED, HostExitError, ProcessStatus
from fmuid.processes.host import SERVER
from fmuid.processes.limits import condition_of, family
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.isolation import server
from fmuid.simulation.isolation.host import AT_REST_SECONDS, HostWatchdog
from fmuid.simulation.simulator import Simulator
from tests.support import spoilt_orders
from tests.support.isolated import (
    NAMES,
    PROCESSES,
    RECORD,
    check_costs_only_its_own,
    expected,
    processes,
    thetas,
    wait_until,
)
from tests.support.misbehaving import Mode, Where, misbehaving_fmu
from tests.support.quick import first

pytestmark = PROCESSES


def is_zombie(pid: int) -> bool:
    """Whether a process has ended."""
    return condition_of(pid).status == psutil.STATUS_ZOMBIE


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a fork shares the memory of its parent")
@pytest.mark.parametrize("where", first(1, [Where.STEP, Where.INITIALIZATION, Where.RESET]))
def test_a_fork_that_comes_back_costs_none(folder: Path, where: Where) -> None:
    """It neither answers in place of its parent nor goes on with an order that is over."""
    values = {"where": where, "amount": 200.0}
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values=values, isolation=Isolation(threads=1))
    executor: Any = executor_of(simulator.system)
    some = thetas(Mode.RETURN_TWICE)
    for _ in range(2):
        assert np.array_equal(simulator(some), expected(folder, some))
        host = executor._host()
        there = host._memory[:] = bytes(len(host._memory))
        forks = family(host.pid)[1:]
        assert forks
        for fork in forks:
            wait_until(partial(is_zombie, fork))
        assert host._memory[:] == there
    assert executor._host() is host


def test_a_forged_message_costs_one_simulation(folder: Path) -> None:
    """What was simulated until then is in the memory that both sides share."""
    words = "it corrupted the connection to its process"
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(Mode.FORGE), words, Isolation(time_limit=600.0))


def test_an_fmu_that_stops_its_server_costs_none(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither simulations now nor those that come afterwards, and no process is left."""
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    there = {process.pid for process in processes()}
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(time_limit=600.0, threads=1))
    for seed in (1, 2):
        some = thetas(Mode.STOP_PARENT, seed)
        assert np.array_equal(simulator(some), expected(folder, some))
    simulator.close()
    server = SERVER._process
    assert {process.pid for process in processes()} <= there | {server.pid if server is not None else 0}


@pytest.mark.slow
def test_an_fmu_that_stops_its_process_costs_one_simulation(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    words = "its process was stopped (SIGSTOP) and did not continue"
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(Mode.STOP), words, Isolation(time_limit=600.0))


class Clock:
    """What a watchdog sees of a process, by a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, watchdog: HostWatchdog) -> None:
        self.now, self.computed, self._watchdog = 100.0, 1.0, watchdog
        monkeypatch.setattr("fmuid.processes.limits.time.monotonic", lambda: self.now)

    def end_after(self, seconds: float, status: str, share: float = 0.0) -> HostExitError | None:
        """Return the end that is seen within some seconds of a process that computes for a share of them."""
        until = self.now + seconds
        while self.now < until:
            self.now, self.computed = self.now + 0.1, self.computed + 0.1 * share
            end = self._watchdog.end(ProcessStatus(os.getpid(), status, self.computed))
            if end is not None:
                return end
        return None


def test_a_process_at_rest_that_owes_an_answer_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """A case of a batch calculates for hours between simulations; one that does not even calculate has no end."""
    monkeypatch.setattr("fmuid.processes.limits.wants_processor", lambda _: False)
    doing = np.full(4, codes.IDLE)
    clock = Clock(monkeypatch, HostWatchdog(1.0, doing, computes=True))
    assert clock.end_after(3600.0, psutil.STATUS_RUNNING, share=0.05) is None
    assert clock.end_after(0.9 * AT_REST_SECONDS, psutil.STATUS_SLEEPING) is None
    assert clock.end_after(0.2 * AT_REST_SECONDS, psutil.STATUS_SLEEPING) == HostExitError(
        HUNG, round(1e3 * AT_REST_SECONDS)
    )


def test_a_process_that_is_stopped_for_a_moment_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch, HostWatchdog(600.0, np.full(4, codes.SIMULATING)))
    for _ in range(5):
        assert clock.end_after(1.5, psutil.STATUS_STOPPED) is None
        assert clock.end_after(1.5, psutil.STATUS_RUNNING, share=1.0) is None
    assert clock.end_after(2.5, psutil.STATUS_STOPPED) == HostExitError(STOPPED, 0)


def test_code_that_fails_beside_an_fmu_costs_the_simulation(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(server, "run", spoilt_orders.run)
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    some = thetas(Mode.SOUND)
    some[:, 0] = np.minimum(some[:, 0], 2.5)
    some[5, 0] = 2 * spoilt_orders.MOST_GAIN
    found = simulator.many(some)
    good = [i for i in range(len(some)) if i != 5]
    assert [error is None for error in found.errors] == [i != 5 for i in range(len(some))]
    assert "code of fmuid failed in its process" in str(found.errors[5])
    assert np.array_equal(found.outputs[good], expected(folder, some)[good])
    assert [record.getMessage() for record in caplog.records] == [
        "code of fmuid failed in the process of an FMU: TypeError: 'NoneType' object is not callable"
    ]
