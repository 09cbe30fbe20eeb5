"""FMUs in processes of their own: large records and models, what the system refuses, memory of whole families."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest

from fmuid.data.experiment import Experiment
from fmuid.errors import FmuidError, InputError
from fmuid.models.component import Isolation
from fmuid.processes.limits import REFUSED, Footprint, HostExitError, family
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.isolation.host import end_words
from fmuid.simulation.simulator import Simulator
from tests.support.isolated import (
    NAMES,
    PROCESSES,
    RECORD,
    check_costs_only_its_own,
    expected,
    left_behind,
    thetas,
)
from tests.support.misbehaving import Mode, misbehaving_fmu

pytestmark = PROCESSES


def test_a_million_rows_are_those_in_process(folder: Path) -> None:
    times = 1e-3 * np.arange(1_000_000)
    frame = pd.DataFrame({"time": times, "u": np.sign(np.sin(3 * times + 0.1)), "x": 0.0})
    record = Experiment(frame, ["u"], ["x"], interpolation="zoh")
    fmu = misbehaving_fmu(folder)
    alone, isolated = (Simulator(fmu, record, NAMES, isolation=each)([2.0, 0.5, 0.0]) for each in (None, Isolation()))
    assert np.array_equal(isolated, alone)
    assert np.ptp(alone) > 1


@pytest.mark.slow
def test_a_record_longer_than_all_before_has_the_time_of_a_first_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the short ones took says little about it."""
    monkeypatch.setattr("fmuid.simulation.isolation.host.LEAST_TIME_LIMIT", 0.2)
    monkeypatch.setattr("fmuid.simulation.isolation.host.SLOWER_FACTOR", 1.0)
    times = 0.1 * np.arange(400)
    long = Experiment(pd.DataFrame({"time": times, "u": 1.0, "x": 0.0}), ["u"], ["x"], interpolation="zoh")
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values={"amount": 2.0}, isolation=Isolation())
    simulator([2.0, 0.5, 0.0])
    assert simulator.over(long)([2.0, 0.5, Mode.SLOW])[-1] == pytest.approx(2.0)


@pytest.mark.slow
def test_twenty_thousand_parameters_cost_no_process(folder: Path) -> None:
    simulator = Simulator(misbehaving_fmu(folder, extra=20_000), RECORD, NAMES, isolation=Isolation(threads=1))
    some = thetas(Mode.SOUND)[:2]
    assert np.array_equal(simulator(some), expected(folder, some))


@pytest.mark.parametrize("isolation", [None, Isolation()], ids=["in-process", "isolated"])
def test_a_library_whose_name_no_file_can_have_is_one_sentence(
    folder: Path, tmp_path: Path, isolation: Isolation | None
) -> None:
    path = tmp_path / "named.fmu"
    with zipfile.ZipFile(misbehaving_fmu(folder)) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            long = data.replace(b'modelIdentifier="misbehaving"', b'modelIdentifier="%s"' % (5000 * b"a"))
            target.writestr(name, long if name == "modelDescription.xml" else data)
    with pytest.raises(InputError, match=r"has no binary for this platform .* has no aaaa") as caught:
        Simulator(path, RECORD, NAMES, isolation=isolation)([1.0, 1.0, 0.0])
    assert len(str(caught.value)) < 1000


# --- what the system refuses, and what an FMU spoils


@pytest.mark.parametrize("count", [12, 6000], ids=["threads", "memory"])
def test_a_process_that_is_refused_what_it_needs_costs_no_simulation(folder: Path, count: int) -> None:
    """One that an FMU has forbidden to take more: another thread, more shared memory. The next one can do it all."""
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=2))
    some = np.tile(thetas(Mode.SOUND), (count // 12, 1))
    assert np.array_equal(simulator([[2.0, 0.5, Mode.LIMIT]]), expected(folder, np.array([[2.0, 0.5, 0.0]])))
    assert np.array_equal(simulator(some), expected(folder, some))


def test_processes_that_are_refused_what_they_need_every_time_do_what_they_can(folder: Path) -> None:
    """No more memory from the moment the library is loaded: each process still does one simulation."""
    measuring = sys.modules.get("coverage")
    if measuring is not None and measuring.Coverage.current() is not None:
        pytest.skip("what counts the lines that are run takes memory, too")
    some = np.tile(thetas(Mode.SOUND)[:2], (600, 1))
    fmu = misbehaving_fmu(folder, at_loading=Mode.LIMIT)
    simulator = Simulator(fmu, RECORD, NAMES, isolation=Isolation(threads=1))
    assert np.array_equal(simulator(some[:2]), expected(folder, some[:2]))
    assert np.array_equal(simulator(some), expected(folder, some))


def test_what_the_system_refuses_this_process_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation())
    simulator([2.0, 0.5, 0.0])
    simulator.close()
    files = psutil.Process().num_fds()

    def refuse(*_: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("fmuid.processes.host.socket.socketpair", refuse)
    with pytest.raises(FmuidError, match=r"the system refuses what .* \(Too many open files\)"):
        simulator([2.0, 0.5, 0.0])
    assert psutil.Process().num_fds() == files


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (
            HostExitError(REFUSED, errno.ENOMEM),
            "its process lacks system resources (Cannot allocate memory)",
        ),
        (HostExitError(REFUSED, 0), "its process lacks system resources"),
    ],
)
def test_words_of_an_end(end: HostExitError, words: str) -> None:
    assert end_words(end) == words


def test_what_is_written_into_the_connection_is_told(folder: Path) -> None:
    words = "it corrupted the connection to its process"
    check_costs_only_its_own(misbehaving_fmu(folder), thetas(Mode.GARBLE), words, Isolation(time_limit=600.0))


# --- memory and relatives

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")


@linux
@pytest.mark.slow
@pytest.mark.parametrize("mode", [Mode.SHARE, Mode.BROOD])
def test_memory_that_is_shared_or_that_of_children_counts(folder: Path, mode: Mode) -> None:
    words = "its process took more than 300 MB and was stopped"
    check_costs_only_its_own(
        misbehaving_fmu(folder), thetas(mode), words, Isolation(time_limit=600.0, memory_limit_mb=300.0)
    )


@pytest.mark.slow
@linux
def test_what_fmuid_itself_gives_a_process_does_not_count(folder: Path) -> None:
    """Record and outputs take 56 MB: more than the limit leaves above what the process takes without them."""
    times = 1e-3 * np.arange(1_000_000)
    frame = pd.DataFrame({"time": times, "u": 1.0, "x": 0.0})
    record = Experiment(frame, ["u"], ["x"], interpolation="zoh")
    simulator = Simulator(misbehaving_fmu(folder), record, NAMES, isolation=Isolation(threads=1))
    some = [[2.0, 0.5, 0.0]] * 4
    before = simulator(some)
    executor: Any = executor_of(simulator.system)
    host = executor._host()
    host._limit = Footprint(host.pid).read() - 56e6 + 25e6
    assert np.array_equal(simulator(some), before)
    assert executor._host() is host


@linux
@pytest.mark.parametrize("how", ["closed", "crashed"])
def test_what_has_left_its_session_ends_too(folder: Path, how: str) -> None:
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    escaped = left_behind(simulator, folder, Mode.ESCAPE)
    assert [os.getsid(process.pid) == os.getsid(process.ppid()) for process in escaped] == [False]
    if how == "closed":
        simulator.close()
    else:
        simulator.many([[1.0, 1.0, Mode.ABORT]])
    _, left = psutil.wait_procs(escaped, timeout=600)
    assert not left


@linux
def test_what_is_shared_counts_once(tmp_path: Path) -> None:
    """Four processes that share 200 MB take 200 MB, of which each seems to have all."""
    script = tmp_path / "share.py"
    script.write_text(
        "import mmap, os, signal\nroom = mmap.mmap(-1, 200 << 20)\nfor i in range(0, 200 << 20, 4096): room[i] = 1\n"
        "for i in range(3):\n    if os.fork() == 0:\n        sum(room[i] for i in range(0, 200 << 20, 4096))\n"
        "        os.write(1, b'there'); signal.pause()\nos.write(1, b'there')\nsignal.pause()\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, start_new_session=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.read(20) == 4 * b"there"
            assert len(family(process.pid)) == 4
            footprint = Footprint(process.pid)
            assert 200 < footprint.read() / 2**20 < 260
            assert footprint.exceeds(200 << 20)
            assert not footprint.exceeds(260 << 20)
        finally:
            os.killpg(process.pid, signal.SIGKILL)
