"""Limits of processes that run FMUs: time, memory, and resources that the system refuses."""

import errno
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from fmuid import FmuidError, InputError, Isolation, Simulator
from fmuid.processes import HostExitError, ProcessEnd, ProcessStatus
from fmuid.processes.limits import COMPUTED_SHARE, Footprint, condition_of, wants_processor
from fmuid.simulation import TIME_LIMITS, codes, executor_of
from fmuid.simulation.isolation.host import HostWatchdog, end_words
from tests.support.experiments import record
from tests.support.isolated import NAMES, PROCESSES, RECORD, expected, pair, thetas, wait_until
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.quick import first

pytestmark = PROCESSES
linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")


# --- size of records and models


def test_large_record_equals_in_process(folder: Path) -> None:
    times = 1e-3 * np.arange(400_000)
    experiment, fmu = record(times, {"u": np.sign(np.sin(3 * times + 0.1))}, ["x"]), misbehaving_fmu(folder)
    alone, isolated = (Simulator(fmu, experiment, NAMES, isolation=each)([2.0, 0.5, 0.0]) for each in pair())
    assert np.array_equal(isolated, alone)
    assert np.ptp(alone) > 1


@pytest.mark.parametrize("isolation", pair(), ids=["in-process", "isolated"])
def test_library_name_that_no_file_can_have(folder: Path, tmp_path: Path, isolation: Isolation | None) -> None:
    path = tmp_path / "named.fmu"
    with zipfile.ZipFile(misbehaving_fmu(folder)) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            long = data.replace(b'modelIdentifier="misbehaving"', b'modelIdentifier="%s"' % (5000 * b"a"))
            target.writestr(name, long if name == "modelDescription.xml" else data)
    with pytest.raises(InputError, match="no binary for this platform") as caught:
        Simulator(path, RECORD, NAMES, isolation=isolation)([1.0, 1.0, 0.0])
    assert len(str(caught.value)) < 1000


# --- resources that the system refuses


@pytest.mark.parametrize("count", first(1, [12, 6000]), ids=["threads", "memory"])
def test_process_without_resources_costs_no_simulation(folder: Path, count: int) -> None:
    """An FMU has forbidden it to take more: another thread, more shared memory. The next one can do it all."""
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=2))
    some = np.tile(thetas(Mode.SOUND), (count // 12, 1))
    assert np.array_equal(simulator([[2.0, 0.5, Mode.LIMIT]]), expected(folder, np.array([[2.0, 0.5, 0.0]])))
    assert np.array_equal(simulator(some), expected(folder, some))


def test_processes_that_never_get_resources_do_what_they_can(folder: Path) -> None:
    """No more memory from the moment the library is loaded: each process still does one simulation."""
    measuring = sys.modules.get("coverage")
    if measuring is not None and measuring.Coverage.current() is not None:
        pytest.skip("measuring coverage takes memory, too")
    some = np.tile(thetas(Mode.SOUND)[:2], (600, 1))
    simulator = Simulator(misbehaving_fmu(folder, at_loading=Mode.LIMIT), RECORD, NAMES, isolation=Isolation(threads=1))
    for each in (some[:2], some):
        assert np.array_equal(simulator(each), expected(folder, each))


def test_resources_refused_to_this_process_are_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation())
    simulator([2.0, 0.5, 0.0])
    simulator.close()
    files = psutil.Process().num_fds()

    def refuse(*_: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("fmuid.processes.host.socket.socketpair", refuse)
    with pytest.raises(FmuidError, match="Too many open files"):
        simulator([2.0, 0.5, 0.0])
    assert psutil.Process().num_fds() == files
    assert end_words(HostExitError(ProcessEnd.REFUSED, errno.ENOMEM)).endswith("resources (Cannot allocate memory)")
    assert end_words(HostExitError(ProcessEnd.REFUSED, 0)).endswith("resources")


# --- memory


@linux
@pytest.mark.slow
def test_memory_given_by_fmuid_does_not_count(folder: Path) -> None:
    """Record and outputs take 56 MB: more than the limit leaves above what the process takes without them."""
    experiment = record(1e-3 * np.arange(1_000_000), {"u": 1.0}, ["x"])
    simulator = Simulator(misbehaving_fmu(folder), experiment, NAMES, isolation=Isolation(threads=1))
    some = [[2.0, 0.5, 0.0]] * 4
    before = simulator(some)
    executor: Any = executor_of(simulator.system)
    host = executor._host()
    host._limit = Footprint(host.pid).read() - 56e6 + 25e6
    assert np.array_equal(simulator(some), before)
    assert executor._host() is host


# --- time: by the clock, but a busy machine is not charged to a simulation

LIMIT = 10.0


class Watched:
    """A host under a watchdog, by a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, state: int = codes.SIMULATING, wants: bool = False) -> None:
        self.now, self.computed = 100.0, 3.0
        monkeypatch.setattr("fmuid.processes.limits.time.monotonic", lambda: self.now)
        monkeypatch.setattr("fmuid.processes.limits.wants_processor", lambda _: wants)
        self.watchdog = HostWatchdog(LIMIT, np.array([state, 1]), computes=state == codes.IDLE)
        self.end_after(0.0)

    def end_after(
        self, seconds: float, share: float = 0.0, status: str = psutil.STATUS_RUNNING, every: float = 0.05
    ) -> HostExitError | None:
        """Return the end within some seconds of a process that computes for a share of them."""
        until = self.now + seconds
        while True:
            passed = min(every, until - self.now)
            self.now, self.computed = self.now + passed, self.computed + share * passed
            end = self.watchdog.end(ProcessStatus(1, status, self.computed))
            if end is not None or until - self.now < 1e-9:
                return end


OVER = HostExitError(ProcessEnd.HUNG, round(1e3 * LIMIT))


@pytest.mark.parametrize("wants", [False, True], ids=["waits for something else", "computes"])
def test_limit_is_by_the_clock(monkeypatch: pytest.MonkeyPatch, wants: bool) -> None:
    watched = Watched(monkeypatch, wants=wants)
    assert watched.end_after(0.99 * LIMIT, 0.9 * wants) is None
    assert watched.end_after(0.02 * LIMIT, 0.9 * wants) == OVER


def test_waiting_for_a_processor_is_not_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, wants=True)
    assert watched.end_after(10 * LIMIT, 0.09 * COMPUTED_SHARE) is None
    assert watched.end_after(3 * LIMIT, 0.09 * COMPUTED_SHARE) == OVER


def test_process_at_rest_that_owes_an_answer_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """A case of a batch calculates for hours between simulations; one that does not even calculate has no end."""
    watched = Watched(monkeypatch, codes.IDLE)
    assert watched.end_after(602.0, 0.05, every=0.1) is None
    assert watched.end_after(0.9 * TIME_LIMITS.at_rest, 0.0, psutil.STATUS_SLEEPING, 0.1) is None
    end = watched.end_after(0.2 * TIME_LIMITS.at_rest, 0.0, psutil.STATUS_SLEEPING, 0.1)
    assert end == HostExitError(ProcessEnd.HUNG, round(1e3 * TIME_LIMITS.at_rest))


@linux
@pytest.mark.parametrize(("code", "wants"), [("while True: pass", True), ("input()", False)])
def test_wants_processor(code: str, wants: bool) -> None:
    code = f"import threading; threading.Thread(target=lambda: exec({code!r})).start()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as process:
        try:
            wait_until(lambda: wants_processor(process.pid) == wants)
            if wants:
                wait_until(lambda: condition_of(process.pid).computed > 0.1)
                assert wants_processor(process.pid)
        finally:
            process.kill()
    assert condition_of(process.pid) == ProcessStatus(process.pid, psutil.STATUS_ZOMBIE, 0.0)
    assert not wants_processor(process.pid)
    assert condition_of(os.getpid()).computed > 0.0
