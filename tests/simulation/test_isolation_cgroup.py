"""Control groups of processes that run FMUs: found, made, ended as a whole and removed; without them all goes on."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from fmuid import Isolation, Simulator
from fmuid.processes import SERVER, cgroup
from fmuid.processes.limits import Footprint
from fmuid.simulation import FmuHost
from tests.support.isolated import NAMES, RECORD, expected, processes, thetas, wait_until
from tests.support.misbehaving import Mode, misbehaving_fmu

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has control groups"),
    pytest.mark.usefixtures("nothing_said"),
]
HYBRID = "31 23 0:28 / /sys/fs/cgroup rw - tmpfs tmpfs rw\n32 31 0:29 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n"


@pytest.fixture
def parent() -> Path:
    """The group of this process, below which it can make some."""
    found = cgroup.own()
    group = cgroup.make(found)
    if found is None or group is None:
        pytest.skip("no control group can be made here")
    cgroup.remove(group)
    return found


@pytest.mark.parametrize(
    ("groups", "mounts", "expected"),
    [
        ("9:name=systemd:/a\n0::/\n", f"{HYBRID}41 31 0:38 / /m/unified rw shared:1 - cgroup2 none rw\n", "/m/unified"),
        ("0::/user.slice/a b\n", "30 23 0:26 / /m\\040n rw - cgroup2 cgroup2 rw\n", "/m n/user.slice/a b"),
        ("0::/docker/x/job\n", "30 23 0:26 /docker/x /m ro - cgroup2 cgroup2 rw\n", "/m/job"),
        ("0::/elsewhere\n", "30 23 0:26 /docker/x /m rw - cgroup2 cgroup2 rw\n", None),
        ("0::/../outside\n", "30 23 0:26 / /m rw - cgroup2 cgroup2 rw\n", None),
        ("4:memory:/a\n", HYBRID, None),
        ("0::/\n", HYBRID, None),
    ],
    ids=["hybrid", "unified", "bound", "not below", "outside the namespace", "version 1", "not mounted"],
)
def test_the_group_of_a_process_is_found(tmp_path: Path, groups: str, mounts: str, expected: str | None) -> None:
    (tmp_path / "cgroup").write_text(groups)
    (tmp_path / "mountinfo").write_text(mounts)
    assert cgroup.own(tmp_path) == (None if expected is None else Path(expected))


def test_where_there_are_no_groups_nothing_is_done(tmp_path: Path) -> None:
    assert cgroup.own(tmp_path) is None
    assert cgroup.make(tmp_path) is None  # no file system of groups, or an old one: cgroup.kill is not in it
    assert cgroup.make(tmp_path / "missing") is None
    assert cgroup.make(None) is None
    for each in (cgroup.enter, cgroup.kill, cgroup.remove, cgroup.sweep):
        each(None)
    assert cgroup.memory(None) == cgroup.memory(tmp_path) == 0
    assert not list(tmp_path.iterdir())


def test_memory_that_nobody_has_mapped_counts_and_files_that_were_read_do_not(tmp_path: Path) -> None:
    (tmp_path / "memory.stat").write_text("anon 3000000000\nfile 9000000000000\nshmem 5000000000\nslab 700000000000\n")
    assert cgroup.memory(tmp_path) == 8e9
    footprint, alone = Footprint(os.getpid(), tmp_path), Footprint(os.getpid())
    assert footprint.read() == 8e9
    assert footprint.exceeds(7.9e9)
    assert not footprint.exceeds(8.1e9)
    (tmp_path / "memory.stat").write_text("anon 1\nshmem 1\n")
    assert footprint.read() == pytest.approx(alone.read(), rel=0.1)
    assert footprint.exceeds(1e6)


def members(group: Path) -> list[int]:
    """Return the process ids of those in a group."""
    return [int(line) for line in (group / "cgroup.procs").read_text().split()]


def test_a_host_has_a_group_of_its_own_until_it_ends(parent: Path) -> None:
    hosts = [FmuHost([], 1e9) for _ in range(2)]
    groups = []
    for host in hosts:
        host.order(os.getpid, limit=20.0)
        groups += [group for group in parent.glob("fmuid-*") if host.pid in members(group)]
        assert members(groups[-1]) == [host.pid]
    assert len(set(groups)) == 2
    hosts[0].close()
    hosts[1].kill()
    assert not any(group.exists() for group in groups)


@pytest.mark.slow
@pytest.mark.parametrize("then", ["closed", "next"])
def test_what_has_left_its_session_ends_though_the_server_was_killed(folder: Path, parent: Path, then: str) -> None:
    """All who would adopt it are gone with the server."""
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, isolation=Isolation(threads=1))
    some = thetas(Mode.SOUND)
    simulator(some)
    there = {process.pid for process in processes()}
    some[5, 2] = Mode.ESCAPE
    assert np.array_equal(simulator(some), expected(folder, some))
    (escaped,) = (process for process in processes() if process.pid not in there)
    (group,) = (group for group in parent.glob("fmuid-*") if escaped.pid in members(group))
    assert SERVER._process is not None
    os.kill(SERVER._process.pid, signal.SIGKILL)
    wait_until(lambda: escaped.ppid() not in there)
    assert members(group) == [escaped.pid]
    if then == "closed":
        simulator.close()
    else:
        assert np.array_equal(simulator(some[:3]), expected(folder, some[:3]))
    _, left = psutil.wait_procs([escaped], timeout=600)
    assert not left
    assert not group.exists()


OWNER = """
import os, subprocess, sys
from fmuid.processes import cgroup
group = cgroup.make(cgroup.own())
with subprocess.Popen(["sleep", "600"], preexec_fn=lambda: cgroup.enter(group), stdout=subprocess.DEVNULL) as sleeper:
    print(sleeper.pid, group, flush=True)
    sys.stdin.read()
    os._exit(0)
"""


@pytest.mark.slow
def test_groups_of_owners_that_were_killed_are_swept_and_no_others(parent: Path) -> None:
    owners = [
        subprocess.Popen([sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    try:
        said = [owner.stdout.readline().split() for owner in owners if owner.stdout]
        (gone, living), groups = (psutil.Process(int(pid)) for pid, _ in said), [Path(group) for _, group in said]
        (groups[0] / "inner").mkdir()  # whatever the FMU has made there
        owners[0].kill()
        owners[0].wait()
        assert gone.is_running()
        cgroup.sweep(parent)
        psutil.wait_procs([gone], timeout=600)
        assert not gone.is_running()
        assert [group.exists() for group in groups] == [False, True]
        assert living.is_running()
    finally:
        for owner in owners:
            owner.kill()
            owner.communicate()
        cgroup.sweep(parent)
    assert not groups[1].exists()
