"""Limits of an isolated process: the memory that it takes with all processes below it, and its time.

On Linux the memory is their proportional set size (proc_pid_smaps(5)), in which a page that several processes share is
counted once in all, be it a library, memory that was there before a fork, or memory that is shared on purpose; and what
of them was swapped out. Reading it costs a walk over all pages, so that it is only done where the resident size, which
is never smaller, does not settle the question. Elsewhere it is the resident size of the process itself. Where the
process has a control group that counts memory, and that count is larger, it is that.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
import time
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import psutil

from fmuid.processes import cgroup
from fmuid.processes.ends import HUNG, STOPPED, HostExitError

SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux
MEASURING_SHARE = 0.1  # of all time, that reading the proportional set size may take, at most


def adopt_orphans() -> None:
    """Become the parent of all processes below this one whose own parents end (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SUBREAPER, 1, 0, 0, 0)


def children(pid: int) -> list[int]:
    """Return the children of a process, also those that have ended and were not waited for; none where nobody knows."""
    found: list[int] = []
    for task in _listed(f"/proc/{pid}/task"):
        found += map(int, _text(f"/proc/{pid}/task/{task}/children").split())
    return found


def family(pid: int) -> list[int]:
    """Return a process and all below it."""
    found = [pid]
    for each in found:  # which grows meanwhile
        found += children(each)
    return found


@dataclass(frozen=True)
class ProcessStatus:
    """What the system says of a process: `pid`, its status as psutil names it, and the CPU time that it has had, s."""

    pid: int
    status: str
    computed: float


def numbered(pid: int) -> psutil.Process | None:
    """Return who has a number: equal only if it is the same process, since numbers are given anew; None: nobody."""
    try:
        return psutil.Process(pid)
    except psutil.Error:
        return None


def condition_of(pid: int) -> ProcessStatus:
    """Return the condition of a process, that of a zombie where there is none."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            return ProcessStatus(pid, str(process.status()), times.user + times.system)
    except psutil.Error:
        return ProcessStatus(pid, psutil.STATUS_ZOMBIE, 0.0)


def wants_processor(pid: int) -> bool:
    """Whether any thread of a process runs or would, if it had a processor; False where nobody knows."""
    stats = (_text(f"/proc/{pid}/task/{task}/stat") for task in _listed(f"/proc/{pid}/task"))
    return any(stat.rpartition(")")[2].split()[:1] == ["R"] for stat in stats)


class Footprint:
    """The memory of a process and all below it.

    Parameters
    ----------
    pid : int
    group : Path, optional
        Its control group (`fmuid.processes.limits`).
    """

    def __init__(self, pid: int, group: Path | None = None) -> None:
        self._pid, self._group = pid, group
        self._resident, self._proportional = 0.0, 0.0  # when both were last read
        self._next = 0.0

    def exceeds(self, limit: float) -> bool:
        """Whether it is more than a limit, bytes.

        Proportional set size does not grow by more than resident size, which is therefore read first.
        """
        if cgroup.memory(self._group) > limit:
            return True
        relatives = family(self._pid)
        resident = sum(map(_resident, relatives))
        if self._proportional + max(0.0, resident - self._resident) <= limit:
            return False
        known = self._proportional if time.monotonic() < self._next else self._read(relatives, resident)
        return known > limit

    def read(self) -> float:
        """Return it, bytes."""
        relatives = family(self._pid)
        return max(cgroup.memory(self._group), self._read(relatives, sum(map(_resident, relatives))))

    def _read(self, relatives: list[int], resident: float) -> float:
        began = time.monotonic()
        self._resident, self._proportional = resident, sum(map(_proportional, relatives))
        now = time.monotonic()
        self._next = now + (now - began) / MEASURING_SHARE
        return self._proportional


def _resident(pid: int) -> float:
    """Return the resident size of a process and what of it was swapped out, bytes."""
    if sys.platform == "linux":
        return _sum(f"/proc/{pid}/status", ("VmRSS", "VmSwap"))
    try:
        return float(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0.0


def _proportional(pid: int) -> float:
    """Return the proportional set size of a process and what of it was swapped out, bytes."""
    return _sum(f"/proc/{pid}/smaps_rollup", ("Pss", "SwapPss")) or _resident(pid)


def _sum(path: str, names: tuple[str, ...]) -> float:
    """Return the sum of some lines of a file of the kernel, as ``Pss:   212 kB``, in bytes."""
    lines = (line.partition(":") for line in _text(path).splitlines())
    return sum(1024.0 * float(rest.split()[0]) for name, _, rest in lines if name in names)


def _text(path: str) -> str:
    """Return what a file of the kernel says: nothing where its process has ended."""
    try:
        with open(path, encoding="ascii", errors="replace") as file:  # noqa: PTH123  # a few of these every 50 ms
            return file.read()
    except OSError:
        return ""


def _listed(path: str) -> list[str]:
    try:
        return os.listdir(path)  # noqa: PTH208
    except OSError:
        return []


STANDSTILL_SECONDS = 0.5
"""Time between two looks above which this process has stood still, and the machine with it, s."""
COMPUTED_SHARE = 0.5
"""Fraction of a time limit that a process must have computed while it wants a processor; before, it only waits."""
STOPPED_SECONDS = 2.0
"""Time after which a stopped process (SIGSTOP) is ended, s: suspended jobs continue in any order."""


class Watchdog:
    """Watches over one call of an isolated process.

    Time limits are by the clock, but a busy machine is not charged to the process: neither the time in which this
    process stood still, nor that in which the other waited for a processor.

    Parameters
    ----------
    limit : float
        How long it may do the same, s.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._since, self._looked = time.monotonic(), math.inf
        self._computed = 0.0
        self._state: tuple[Hashable, bool] | None = None

    def state(self, condition: ProcessStatus) -> Hashable:
        """Return what it is doing: the limit begins anew where that has changed."""
        del condition
        return None

    def allowed(self) -> float:
        """Return how long it may do what it is doing, s."""
        return self.limit

    def end(self, condition: ProcessStatus) -> HostExitError | None:
        """Return the end of a process that has done the same for too long."""
        stopped, now = condition.status == psutil.STATUS_STOPPED, time.monotonic()
        state = self.state(condition), stopped
        self._since += max(0.0, now - self._looked - STANDSTILL_SECONDS)
        self._looked = now
        if state != self._state:
            self._state, self._since, self._computed = state, now, condition.computed
        allowed = STOPPED_SECONDS if stopped else self.allowed()
        if now - self._since <= allowed:
            return None
        if stopped:
            return HostExitError(STOPPED, 0)
        waits = condition.computed - self._computed < COMPUTED_SHARE * allowed and wants_processor(condition.pid)
        return None if waits else HostExitError(HUNG, round(1e3 * allowed))
