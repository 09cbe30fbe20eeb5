"""The processes that run FMUs: they end when they should, whoever ends them, and nothing of them is left."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import shutil
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

import fmuid
from fmuid.array_types import Floats
from fmuid.data.experiment import Experiment
from fmuid.errors import FmuidError, SimulationError
from fmuid.models.component import Isolation
from fmuid.models.system import System
from fmuid.processes import MEMORY_KEPT, Child
from fmuid.processes import host as hosts
from fmuid.processes.channel import Channel, Look
from fmuid.processes.host import SERVER, ForkServer
from fmuid.processes.limits import KILLED, HostExitError
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.isolation.host import FmuHost
from fmuid.simulation.simulator import Simulator
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


@pytest.mark.slow
def test_nothing_is_left_of_closed_systems(folder: Path) -> None:
    def use() -> None:
        simulators = [Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation()) for _ in range(6)]
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
def test_a_process_killed_from_outside_costs_nothing(folder: Path, whom: str) -> None:
    some = thetas(Mode.SOUND) * [1, 1, 0] + [0, 0, Mode.SLOW]
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values={"amount": 5.0}, isolation=Isolation())
    found: list[Floats] = []
    over, killed = threading.Event(), 0

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


def test_a_process_that_ends_while_nobody_uses_it_costs_nothing(folder: Path) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    some = thetas(Mode.SOUND)
    assert np.array_equal(simulator(some), expected(folder, some))
    executor: Any = executor_of(simulator.system)
    host = psutil.Process(executor._host().pid)
    host.send_signal(signal.SIGALRM)
    wait_until(lambda: host.status() == psutil.STATUS_ZOMBIE)
    assert np.array_equal(simulator(some), expected(folder, some))


def test_a_crash_is_seen_although_the_fmu_has_forked(folder: Path) -> None:
    """The process that an FMU forked holds all its files open; the crash is known at once all the same."""
    fmu = misbehaving_fmu(folder)
    system = System(
        components={"forks": fmu, "crashes": fmu}, connections=[("forks.x", "crashes.u")], isolation=Isolation()
    )
    record = Experiment(RECORD_FRAME, {"forks.u": "u"}, {"crashes.x": "x"}, interpolation="zoh")
    values = {"forks.mode": Mode.SPAWN.value, "crashes.mode": Mode.SEGFAULT.value, "crashes.at": 2.0}
    with pytest.raises(SimulationError, match=r"crashed with SIGSEGV"):
        Simulator(system, record, values=values)([])


def test_what_the_fmu_has_forked_ends_with_its_process(folder: Path) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    spawned = left_behind(simulator, folder, Mode.SPAWN)
    assert spawned
    simulator.close()
    _, left = psutil.wait_procs(spawned, timeout=600)
    assert not left


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
@pytest.mark.parametrize(
    ("name", "mode"),
    [
        ("SIGKILL", Mode.STUBBORN),
        ("SIGTERM", Mode.LOOP),
        pytest.param("SIGINT", Mode.LOOP, marks=pytest.mark.slow),  # as Ctrl-C in a terminal, of the commands' tests
    ],
)
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
            _, left = psutil.wait_procs(there, timeout=600)
            assert not left
        finally:
            process.kill()
    assert process.returncode == -signal.Signals[name]
    assert ("KeyboardInterrupt" in said) == (name == "SIGINT")


def called_pid(host: FmuHost) -> int:
    """Return the process id of a host as it says itself."""
    return int(host.order(os.getpid, limit=20.0))


def test_memory_is_kept_whatever_the_starter_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask starts workers with a threshold at which each array is mapped anew."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    server = ForkServer()
    monkeypatch.setattr("fmuid.processes.host.SERVER", server)
    host = FmuHost([], 1e9)
    found = {name: str(host.order(os.getenv, name, limit=20.0)) for name in MEMORY_KEPT}
    host.close()
    server.stop()
    assert found == MEMORY_KEPT
    assert int(found["MALLOC_TRIM_THRESHOLD_"]) > int(found["MALLOC_MMAP_THRESHOLD_"]) > 10**7


@pytest.mark.slow
@pytest.mark.parametrize("question", ["fork", "wait"])
def test_an_interruption_leaves_no_answer_for_the_next(monkeypatch: pytest.MonkeyPatch, question: str) -> None:
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


def test_garbage_that_is_collected_in_the_middle_of_a_question_asks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system whose host is closed by the collector, in the thread that forks another."""
    garbage, receive = FmuHost([], 1e9), Channel.receive

    def collect(channel: Channel, look: Look | None = None) -> object:
        monkeypatch.undo()
        garbage.kill()
        return receive(channel, look)

    monkeypatch.setattr("fmuid.processes.host.Channel.receive", collect)
    host = FmuHost([], 1e9)
    assert called_pid(host) == host.pid
    host.close()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["file", "stdin"])
def test_a_script_needs_no_guard_and_warns_of_nothing(folder: Path, tmp_path: Path, how: str) -> None:
    """A user's script without ``if __name__ == "__main__"``, warnings as errors, threads running; and from stdin."""
    text = SCRIPT.replace(
        "simulator = ", "threading.Thread(target=threading.Event().wait, daemon=True).start()\nsimulator = "
    )
    (tmp_path / "script.py").write_text(text)
    command = [sys.executable, "-W", "error", "script.py" if how == "file" else "-", str(misbehaving_fmu(folder)), "0"]
    run = subprocess.run(
        command, input=text if how == "stdin" else "", capture_output=True, text=True, cwd=tmp_path, timeout=600
    )
    assert run.stderr == ""
    assert float(run.stdout) == pytest.approx(lag(TIMES, U, 2.0, 1.0)[-1], abs=1e-14)
    assert run.returncode == 0


def test_the_default_is_in_process(folder: Path) -> None:
    there = {process.pid for process in processes()}
    fmuid.Simulator(misbehaving_fmu(folder), RECORD, ["gain"])([2.0])
    assert {process.pid for process in processes()} <= there


@pytest.mark.slow
@pytest.mark.parametrize("how", ["closed", "killed", "struck"])
def test_who_has_the_number_of_a_host_by_now_is_left_alone(how: str) -> None:
    """A host that went with its server, which nobody asks about for long; process numbers come round."""
    host = FmuHost([], 1e9)
    gone = psutil.Process(host.pid)
    server = SERVER._process
    assert server is not None
    psutil.Process(server.pid).kill()
    wait_until(lambda: not gone.is_running())
    with subprocess.Popen(["sleep", "600"], start_new_session=True) as stranger:
        try:
            host.pid = stranger.pid
            {"closed": host.close, "killed": host.kill, "struck": host.strike}[how]()
            wait_until(lambda: psutil.Process(stranger.pid).status() == psutil.STATUS_SLEEPING)  # not stopped
            assert stranger.poll() is None
        finally:
            stranger.kill()
    host.kill()


def test_a_server_that_ends_as_soon_as_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence after some starts, not a loop."""
    monkeypatch.setattr(hosts, "LIMITS", replace(hosts.LIMITS, starts=2))
    monkeypatch.setattr(hosts, "Child", lambda _module, *words, **options: Child("keyword", *words, **options))
    server = ForkServer()
    with pytest.raises(FmuidError, match=r"processes\.server, .* ends again and again .*: have FMUs run inside this"):
        server.fork([], [])
    assert server.status(1) is None


def test_a_system_that_makes_no_more_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = os.strerror(errno.EAGAIN)
    monkeypatch.setattr(ForkServer, "_ask", lambda *_words, **_options: answer)
    with pytest.raises(FmuidError, match=f"^no isolated process can be made: {answer}$"):
        ForkServer().fork([], [])


def test_a_host_that_never_begins(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def order(host: FmuHost, *_words: object, **_options: object) -> None:
        host.kill()
        raise HostExitError(KILLED, signal.SIGKILL)

    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    monkeypatch.setattr(FmuHost, "order", order)
    with pytest.raises(FmuidError, match=r"its process ends repeatedly"):
        simulator([2.0, 0.5, 0.0])


def test_simulations_that_were_cancelled_are_not_taken_up(folder: Path) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    executor: Any = executor_of(simulator.system)
    executor.cancel()
    with pytest.raises(FmuidError, match=r"\.fmu: simulations cancelled$"):
        executor._host()


def test_a_path_is_that_of_the_folder_where_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coil = fmuid.datasets.coil()
    shutil.copy(coil.fmu, tmp_path / "Mine.fmu")
    values = [parameter.start for parameter in coil.parameters.values()]
    first = fmuid.Simulator(coil.fmu, coil.experiment, list(coil.parameters), isolation=Isolation())(values)
    monkeypatch.chdir(tmp_path)
    mine = fmuid.Simulator("Mine.fmu", coil.experiment, list(coil.parameters), isolation=Isolation())
    monkeypatch.chdir(tmp_path.parent)
    assert np.array_equal(mine(values), first)
