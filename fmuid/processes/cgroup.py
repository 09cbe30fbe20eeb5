"""Control groups of isolated processes, on Linux with cgroups(7), version 2.

A process cannot leave its group by a new session or a lost parent, and a group is killed as a whole. Without
groups (None), everything works without them.
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


def own(process: Path = Path("/proc/self")) -> Path | None:
    """Return the folder of this process's group (proc_pid_cgroup(5), proc_pid_mountinfo(5))."""
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
    """Return a new group below one, named after this process; None if refused."""
    if parent is None:
        return None
    with contextlib.suppress(OSError):  # not permitted: processes are found by their parents
        group = Path(tempfile.mkdtemp(prefix=f"fmuid-{_namespace()}-{os.getpid()}-", dir=parent))
        if (group / "cgroup.kill").exists():  # Linux 5.14
            return group
        group.rmdir()
    return None


def enter(group: Path | None) -> None:
    """Put this process and all that it starts into a group."""
    _write(group, "cgroup.procs", "0")


def kill(group: Path | None) -> None:
    """Kill all processes of a group and of those below it."""
    _write(group, "cgroup.kill", "1")


def remove(group: Path | None) -> None:
    """Remove a group and those below it once their processes have ended."""
    until = time.monotonic() + 1.0  # s until all processes have ended
    while group is not None and group.exists():
        try:
            for folder, _, _ in os.walk(group, topdown=False):
                Path(folder).rmdir()
        except OSError as error:
            if error.errno != errno.EBUSY or time.monotonic() > until:
                return
            time.sleep(0.001)


def sweep(parent: Path | None) -> None:
    """End the groups of this process and of this user's ended ones."""
    if parent is None:
        return
    for group in parent.glob("fmuid-*"):
        with contextlib.suppress(OSError):  # another process sweeps too
            # process ids of other namespaces mean nothing here
            found = re.fullmatch(rf"fmuid-{_namespace()}-(\d+)-\w+", group.name)
            if found is None or group.stat().st_uid != os.geteuid():
                continue
            if int(found[1]) == os.getpid() or not psutil.pid_exists(int(found[1])):
                kill(group)
                remove(group)


def memory(group: Path | None) -> float:
    """Return the memory of a group without that of files, bytes; 0 where it is not counted."""
    try:
        words = (group / "memory.stat").read_text().split() if group else []
    except OSError:
        return 0.0
    counts = dict(zip(words[::2], words[1::2], strict=False))
    return float(counts.get("anon", 0)) + float(counts.get("shmem", 0))


def _write(group: Path | None, name: str, text: str) -> None:
    if group is not None:
        with contextlib.suppress(OSError):  # groups are optional
            (group / name).write_text(text)


def _namespace() -> int:
    return Path("/proc/self/ns/pid").stat().st_ino


def _plain(field: bytes) -> bytes:
    """Return a field of mountinfo with its octal escapes replaced."""
    return re.sub(rb"\\(\d{3})", lambda found: bytes([int(found[1], 8)]), field)
