"""Limits of an isolated process: memory of its family, and time.

On Linux the memory is the proportional set size (proc_pid_smaps(5)) with swap: shared pages count once. It is slow to
read, so the resident size is read first, which is never smaller. Elsewhere it is the resident size of the process.
The count of a control group is used if it is larger.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import signal
import sys
import time
from collections.abc import Hashable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import psutil

from fmuid.processes import cgroup


class ProcessEnd(IntEnum):
    """Ends of isolated processes."""

    CRASHED = 0  # a signal
    EXITED = 1
    HUNG = 2  # over the time limit
    GREW = 3  # over the memory limit
    KILLED = 4  # from outside
    REFUSED = 5  # by the system
    GARBLED = 6  # no answer
    STOPPED = 7  # by SIGSTOP
    FAILED = 8  # code of fmuid


@dataclass(unsafe_hash=True)  # not frozen: exceptions get a traceback
class HostExitError(Exception):  # no error, but a report
    """End of an isolated process during its work."""

    kind: ProcessEnd
    number: int  # signal, exit code, system error, time limit (ms) or memory limit (MB)

    @property
    def signal_name(self) -> str:
        """Name of the signal, as ``SIGSEGV``."""
        try:
            return signal.Signals(self.number).name
        except ValueError:
            return f"signal {self.number}"


def adopt_orphans() -> None:
    """Become the parent of orphans below this process (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def strike(pid: int) -> None:
    """Kill a process and its group."""
    for end in (os.kill, os.killpg):
        with contextlib.suppress(ProcessLookupError, PermissionError):  # already gone
            end(pid, signal.SIGKILL)


def children(pid: int) -> list[int]:
    """Return the children of a process, ended ones included."""
    found: list[int] = []
    for task in _listed(f"/proc/{pid}/task"):
        found += map(int, _text(f"/proc/{pid}/task/{task}/children").split())
    return found


def family(pid: int) -> list[int]:
    """Return a process and all below it."""
    found = [pid]
    for each in found:  # it grows meanwhile
        found += children(each)
    return found


@dataclass(frozen=True)
class ProcessStatus:
    """Status of a process in psutil's terms, and its CPU time, s."""

    pid: int
    status: str
    computed: float


def numbered(pid: int) -> psutil.Process | None:
    """Return the process with a number, if any; equal only for the same process: numbers are reused."""
    try:
        return psutil.Process(pid)
    except psutil.Error:
        return None


def condition_of(pid: int) -> ProcessStatus:
    """Return the status of a process; a missing one is a zombie."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            return ProcessStatus(pid, str(process.status()), times.user + times.system)
    except psutil.Error:
        return ProcessStatus(pid, psutil.STATUS_ZOMBIE, 0.0)


def wants_processor(pid: int) -> bool:
    """Return whether a thread runs or waits for a processor."""
    stats = (_text(f"/proc/{pid}/task/{task}/stat") for task in _listed(f"/proc/{pid}/task"))
    return any(stat.rpartition(")")[2].split()[:1] == ["R"] for stat in stats)


class Footprint:
    """Memory of a process and all below it, and its control group."""

    def __init__(self, pid: int, group: Path | None = None) -> None:
        self._pid, self._group = pid, group
        self._resident, self._proportional = 0.0, 0.0  # at the last reading
        self._next = 0.0

    def exceeds(self, limit: float) -> bool:
        """Return whether the memory is above a limit, bytes."""
        if cgroup.memory(self._group) > limit:
            return True
        relatives = family(self._pid)
        resident = sum(map(_resident, relatives))
        # proportional set size grows at most as much as resident size
        if self._proportional + max(0.0, resident - self._resident) <= limit:
            return False
        known = self._proportional if time.monotonic() < self._next else self._read(relatives, resident)
        return known > limit

    def read(self) -> float:
        """Return the memory, bytes."""
        relatives = family(self._pid)
        return max(cgroup.memory(self._group), self._read(relatives, sum(map(_resident, relatives))))

    def _read(self, relatives: list[int], resident: float) -> float:
        began = time.monotonic()
        self._resident, self._proportional = resident, sum(map(_proportional, relatives))
        now = time.monotonic()
        self._next = now + (now - began) / 0.1  # fraction of time for reading
        return self._proportional


def _resident(pid: int) -> float:
    """Return resident size and swap of a process, bytes."""
    if sys.platform == "linux":
        return _sum(f"/proc/{pid}/status", ("VmRSS", "VmSwap"))
    try:
        return float(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0.0


def _proportional(pid: int) -> float:
    """Return proportional set size and swap of a process, bytes."""
    return _sum(f"/proc/{pid}/smaps_rollup", ("Pss", "SwapPss")) or _resident(pid)


def _sum(path: str, names: tuple[str, ...]) -> float:
    """Return the sum of some lines of a kernel file, bytes."""
    lines = (line.partition(":") for line in _text(path).splitlines())
    return sum(1024.0 * float(rest.split()[0]) for name, _, rest in lines if name in names)


def _text(path: str) -> str:
    """Return the text of a kernel file, empty after its process."""
    try:
        with open(path, encoding="ascii", errors="replace") as file:  # noqa: PTH123  # fast: often read
            return file.read()
    except OSError:
        return ""


def _listed(path: str) -> list[str]:
    try:
        return os.listdir(path)  # noqa: PTH208
    except OSError:
        return []


STANDSTILL_SECONDS = 0.5  # s; a longer time between two looks means a suspended machine
COMPUTED_SHARE = 0.5  # Fraction of a time limit that a process must have computed; below, it waits for a processor
STOPPED_SECONDS = 2.0  # s until a stopped process (SIGSTOP) is ended: jobs resume in any order


class Watchdog:
    """Time limit of one call of an isolated process, s.

    Time is by the clock, without the time in which this process stood still or the other waited for a processor.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._since, self._looked = time.monotonic(), math.inf
        self._computed = 0.0
        self._state: tuple[Hashable, bool] | None = None

    def state(self, condition: ProcessStatus) -> Hashable:
        """Return the present activity; the limit begins anew when it changes."""
        del condition
        return None

    def allowed(self) -> float:
        """Return the time limit of the present activity, s."""
        return self.limit

    def end(self, condition: ProcessStatus) -> HostExitError | None:
        """Return the end of a process whose activity took too long."""
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
            return HostExitError(ProcessEnd.STOPPED, 0)
        waits = condition.computed - self._computed < COMPUTED_SHARE * allowed and wants_processor(condition.pid)
        return None if waits else HostExitError(ProcessEnd.HUNG, round(1e3 * allowed))
