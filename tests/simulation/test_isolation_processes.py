"""Processes that run FMUs: they end when they should, whoever ends them, and leave nothing behind."""

import contextlib
import errno
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from fmuid import Experiment, FmuidError, Isolation, SimulationError, Simulator, System
from fmuid.array_types import Floats
from fmuid.processes import SERVER, Child, HostExitError, ProcessEnd
from fmuid.processes import host as hosts
from fmuid.processes.host import ForkServer
from fmuid.simulation import FmuHost, executor_of
from fmuid.simulation.isolation import server
from tests.support import spoilt_orders
from tests.support.isolated import (
    NAMES,
    PROCESSES,
    RECORD,
    RECORD_FRAME,
    TIMES,
    U,
    computing,
    expected,
    left_behind,
    processes,
    thetas,
    wait_until,
)
from tests.support.misbehaving import Mode, lag, misbehaving_fmu

pytestmark = PROCESSES
linux = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a fork shares the memory of its parent")
ONE = Isolation(threads=1)


def simulator_of(folder: Path, isolation: Isolation = ONE, **values: float) -> Simulator:
    return Simulator(misbehaving_fmu(folder), RECORD, NAMES, values=values, isolation=isolation)


def executor_in(simulator: Simulator) -> Any:
    return executor_of(simulator.system)


# --- ends of processes


@pytest.mark.slow
def test_closed_systems_leave_nothing(folder: Path) -> None:
    def use() -> None:
        simulators = [simulator_of(folder, Isolation()) for _ in range(6)]
        for simulator in simulators:
            simulator([2.0, 0.5, 0.0])
        for simulator in simulators[::2]:
            simulator.close()  # the others go with their systems

    use()
    gc.collect()
    files, there = psutil.Process().num_fds(), len(processes())
    for _ in range(3):
        use()
    gc.collect()
    wait_until(lambda: len(processes()) <= there)
    assert psutil.Process().num_fds() == files


@pytest.mark.slow
@pytest.mark.parametrize("whom", ["leaves", "all"])
def test_processes_killed_from_outside_cost_nothing(folder: Path, whom: str) -> None:
    some = thetas(Mode.SOUND) * [1, 1, 0] + [0, 0, Mode.SLOW]
    simulator, found, over, killed = simulator_of(folder, Isolation(), amount=5.0), list[Floats](), threading.Event(), 0

    def simulate() -> None:
        while not over.is_set():
            found.append(simulator(some))

    thread = threading.Thread(target=simulate)
    thread.start()
    rng = np.random.default_rng(6)
    while thread.is_alive() and killed < 2:
        time.sleep(rng.uniform(0.2, 0.5))
        for process in processes():
            with contextlib.suppress(psutil.NoSuchProcess):  # it went with the one before
                if whom == "all" or not process.children():
                    process.kill()
                    killed += 1
    over.set()
    thread.join()
    assert killed >= 2
    assert found
    assert all(np.array_equal(each, expected(folder, some)) for each in found)


def test_process_that_ends_while_nobody_uses_it_costs_nothing(folder: Path) -> None:
    simulator, some = simulator_of(folder), thetas(Mode.SOUND)
    assert np.array_equal(simulator(some), expected(folder, some))
    host = psutil.Process(executor_in(simulator)._host().pid)
    host.send_signal(signal.SIGALRM)
    wait_until(lambda: host.status() == psutil.STATUS_ZOMBIE)
    assert np.array_equal(simulator(some), expected(folder, some))


def test_crash_is_seen_although_the_fmu_has_forked(folder: Path) -> None:
    """The process that an FMU forked holds all its files open; the crash is known at once all the same."""
    fmu = misbehaving_fmu(folder)
    system = System(components={"a": fmu, "b": fmu}, connections=[("a.x", "b.u")], isolation=Isolation())
    record = Experiment(RECORD_FRAME, {"a.u": "u"}, {"b.x": "x"}, interpolation="zoh")
    values = {"a.mode": Mode.SPAWN.value, "b.mode": Mode.SEGFAULT.value, "b.at": 2.0}
    with pytest.raises(SimulationError, match="crashed with SIGSEGV"):
        Simulator(system, record, values=values)([])


@linux
@pytest.mark.parametrize(("mode", "how"), [(Mode.SPAWN, "closed"), (Mode.ESCAPE, "closed"), (Mode.ESCAPE, "crashed")])
def test_children_end_with_their_process(folder: Path, mode: Mode, how: str) -> None:
    """Also those that have left its session."""
    simulator = simulator_of(folder)
    started = left_behind(simulator, folder, mode)
    assert [os.getsid(p.pid) == os.getsid(p.ppid()) for p in started] == [mode == Mode.SPAWN]
    if how == "closed":
        simulator.close()
    else:
        simulator.many([[1.0, 1.0, Mode.ABORT]])
    assert not psutil.wait_procs(started, timeout=600)[1]


SCRIPT = """
import sys, threading
import numpy as np, pandas as pd, fmuid
fmu, mode, *more = sys.argv[1:]
times = np.arange(40) * 0.1
frame = pd.DataFrame({"time": times, "u": np.sign(np.sin(3 * times + 0.1)), "x": 0.0})
record = fmuid.Experiment(frame, ["u"], ["x"], interpolation="zoh")
simulator = fmuid.Simulator(fmu, record, ["gain", "mode"], isolation=fmuid.Isolation())
print(simulator([2.0, 0.0])[-1, 0], flush=True)
simulator(np.tile([2.0, float(mode)], (4, 1)))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), [("SIGKILL", Mode.STUBBORN), ("SIGTERM", Mode.LOOP), ("SIGINT", Mode.LOOP)])
def test_no_process_is_left_when_fmuid_ends(folder: Path, name: str, mode: Mode) -> None:
    command = [sys.executable, "-c", SCRIPT, str(misbehaving_fmu(folder)), str(int(mode))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert float(process.stdout.readline()) == pytest.approx(lag(TIMES, U, 2.0, 1.0)[-1], abs=1e-14)
            wait_until(lambda: computing(process.pid) or process.poll() is not None)
            there = psutil.Process(process.pid).children(recursive=True)
            assert there
            process.send_signal(signal.Signals[name])
            _, said = process.communicate(timeout=600)
            assert not psutil.wait_procs(there, timeout=600)[1]
        finally:
            process.kill()
    assert process.returncode == -signal.Signals[name]
    assert ("KeyboardInterrupt" in said) == (name == "SIGINT")


# --- FMUs that fork, write into the connection, or stop processes


def test_fmu_that_stops_its_server_costs_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither now nor afterwards, and no process is left."""
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    there = {process.pid for process in processes()}
    simulator = simulator_of(folder, Isolation(time_limit=600.0, threads=1))
    for seed in (1, 2):
        some = thetas(Mode.STOP_PARENT, seed)
        assert np.array_equal(simulator(some), expected(folder, some))
    simulator.close()
    assert {process.pid for process in processes()} <= there | {SERVER._process.pid if SERVER._process else 0}


def test_failing_code_beside_an_fmu_costs_the_simulation(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(server, "run", spoilt_orders.run)
    simulator, some = simulator_of(folder), thetas(Mode.SOUND)
    some[:, 0] = np.minimum(some[:, 0], 2.5)
    some[5, 0] = 2 * spoilt_orders.MOST_GAIN
    found, good = simulator.many(some), np.arange(len(some)) != 5
    assert [error is None for error in found.errors] == good.tolist()
    assert "code of fmuid failed in its process" in str(found.errors[5])
    assert np.array_equal(found.outputs[good], expected(folder, some)[good])
    (said,) = caplog.records
    assert "code of fmuid failed in the process of an FMU: TypeError" in said.getMessage()


# --- the server that forks them


def called_pid(host: FmuHost) -> int:
    """Return the process id of a host as it says itself."""
    return int(host.order(os.getpid, limit=20.0))


@pytest.mark.slow
@pytest.mark.parametrize("question", ["fork", "wait"])
def test_interruption_leaves_no_answer_for_the_next(monkeypatch: pytest.MonkeyPatch, question: str) -> None:
    """Ctrl-C after the server has its order and before its answer is read."""
    host = FmuHost([], 1e9)
    assert called_pid(host) == host.pid

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as changed:
        changed.setattr("fmuid.processes.host.Channel.receive", interrupt)
        with pytest.raises(KeyboardInterrupt):
            FmuHost([], 1e9) if question == "fork" else SERVER.status(host.pid)
    others = [FmuHost([], 1e9) for _ in range(2)]
    assert [called_pid(other) for other in others] == [other.pid for other in others]
    for each in (host, *others):
        each.close()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["close", "kill", "strike"])
def test_stranger_with_the_number_of_a_host_is_left_alone(how: str) -> None:
    """A host that went with its server, which nobody asks about for long; process numbers come round."""
    host = FmuHost([], 1e9)
    gone = psutil.Process(host.pid)
    assert SERVER._process is not None
    psutil.Process(SERVER._process.pid).kill()
    wait_until(lambda: not gone.is_running())
    with subprocess.Popen(["sleep", "600"], start_new_session=True) as stranger:
        try:
            host.pid = stranger.pid
            getattr(host, how)()
            wait_until(lambda: psutil.Process(stranger.pid).status() == psutil.STATUS_SLEEPING)  # not stopped
            assert stranger.poll() is None
        finally:
            stranger.kill()
    host.kill()


def test_server_that_ends_or_refuses_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hosts, "LIMITS", replace(hosts.LIMITS, starts=2))
    monkeypatch.setattr(hosts, "Child", lambda _module, *words, **options: Child("keyword", *words, **options))
    own = ForkServer()
    with pytest.raises(FmuidError, match=r"processes\.server"):
        own.fork([], [])
    assert own.status(1) is None
    monkeypatch.setattr(ForkServer, "_ask", lambda *_words, **_options: os.strerror(errno.EAGAIN))
    with pytest.raises(FmuidError, match=os.strerror(errno.EAGAIN)):
        ForkServer().fork([], [])


def test_host_that_never_begins_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def order(host: FmuHost, *_words: object, **_options: object) -> None:
        host.kill()
        raise HostExitError(ProcessEnd.KILLED, signal.SIGKILL)

    simulator = simulator_of(folder)
    monkeypatch.setattr(FmuHost, "order", order)
    with pytest.raises(FmuidError, match=r"\.fmu: its process ends repeatedly"):
        simulator([2.0, 0.5, 0.0])
