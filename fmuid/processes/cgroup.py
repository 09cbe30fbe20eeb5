"""A control group of its own for each host, where Linux gives one (cgroups(7), version 2).

A process cannot leave its group by leaving its session or losing its parent, and a group is ended as a whole, also when
nobody is left who would adopt orphans. Groups are made below the one that this process is in, and nothing is switched
on there. Where there is none, or the system refuses one, there is no group (None), and everything goes without.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import tempfile
import time
from pathlib import Path

import psutil

REMOVAL_SECONDS = 1.0  # s at most; a group can be removed when all in it have ended


def own(process: Path = Path("/proc/self")) -> Path | None:
    """Return the folder of the group that this process is in (proc_pid_cgroup(5), proc_pid_mountinfo(5))."""
    try:
        groups, mounts = ((process / name).read_bytes() for name in ("cgroup", "mountinfo"))
    except OSError:
        return None
    group = next((Path(os.fsdecode(line[3:])) for line in groups.splitlines() if line.startswith(b"0::")), None)
    for line in mounts.splitlines():
        mount, _, source = line.partition(b" - ")
        if group is not None and ".." not in group.parts and source.startswith(b"cgroup2 "):
            root, point = (Path(os.fsdecode(_plain(field))) for field in mount.split()[3:5])
            if group.is_relative_to(root):
                return point / group.relative_to(root)
    return None


def make(parent: Path | None) -> Path | None:
    """Return a new group below one, named with this process, which is to sweep it; None where there can be none."""
    if parent is None:
        return None
    with contextlib.suppress(OSError):  # without the right to make groups, processes are found by their parents
        group = Path(tempfile.mkdtemp(prefix=f"fmuid-{_namespace()}-{os.getpid()}-", dir=parent))
        if (group / "cgroup.kill").exists():  # Linux 5.14
            return group
        group.rmdir()
    return None


def enter(group: Path | None) -> None:
    """Put this process into a group, with all that it will start."""
    _write(group, "cgroup.procs", "0")


def kill(group: Path | None) -> None:
    """Kill all processes of a group and of those below it."""
    _write(group, "cgroup.kill", "1")


def remove(group: Path | None) -> None:
    """Remove a group whose processes have ended, or do so within a moment, and those below it."""
    until = time.monotonic() + REMOVAL_SECONDS
    while group is not None and group.exists():
        try:
            for folder, _, _ in os.walk(group, topdown=False):
                Path(folder).rmdir()
        except OSError as error:
            if error.errno != errno.EBUSY or time.monotonic() > until:
                return
            time.sleep(0.001)


def sweep(parent: Path | None) -> None:
    """End all groups below one that this process has made, or others of this user that live no more."""
    if parent is None:
        return
    for group in parent.glob("fmuid-*"):
        with contextlib.suppress(OSError):  # another process sweeps too
            # process ids of another namespace say nothing here
            found = re.fullmatch(rf"fmuid-{_namespace()}-(\d+)-\w+", group.name)
            if found is None or group.stat().st_uid != os.geteuid():
                continue
            if int(found[1]) == os.getpid() or not psutil.pid_exists(int(found[1])):
                kill(group)
                remove(group)


def memory(group: Path | None) -> float:
    """Return the memory of a group that no file on a disk has, mapped or not, bytes; 0 where it is not counted.

    That is ``anon`` and ``shmem`` of its memory controller, without what was swapped out.
    """
    if group is None:
        return 0.0
    try:
        words = (group / "memory.stat").read_text().split()
    except OSError:
        return 0.0
    counts = dict(zip(words[::2], words[1::2], strict=False))
    return float(counts.get("anon", 0)) + float(counts.get("shmem", 0))


def _write(group: Path | None, name: str, text: str) -> None:
    if group is not None:
        with contextlib.suppress(OSError):  # groups are an extra (`make`)
            (group / name).write_text(text)


def _namespace() -> int:
    return Path("/proc/self/ns/pid").stat().st_ino


def _plain(field: bytes) -> bytes:
    r"""Return a field of mountinfo in which blanks and the like are written as ``\040``."""
    return re.sub(rb"\\(\d{3})", lambda found: bytes([int(found[1], 8)]), field)
