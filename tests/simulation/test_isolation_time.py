"""Time limits of processes that run FMUs: by the clock, but a busy machine is not charged to a simulation."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import psutil
import pytest

from fmuid.processes.limits import (
    COMPUTED_SHARE,
    HUNG,
    STANDSTILL_SECONDS,
    HostExitError,
    ProcessStatus,
    condition_of,
    wants_processor,
)
from fmuid.simulation import codes
from fmuid.simulation.isolation.host import HostWatchdog
from tests.support.isolated import wait_until

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork")

LIMIT = 10.0
DOING = np.array([codes.SIMULATING, 1])


class Watched:
    """A host that is looked at by a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, wants: bool) -> None:
        self.now = 100.0
        monkeypatch.setattr("fmuid.processes.limits.time.monotonic", lambda: self.now)
        monkeypatch.setattr("fmuid.processes.limits.wants_processor", lambda _: wants)
        self.watchdog = HostWatchdog(LIMIT, DOING)
        self.passed(0.0, 3.0)

    def passed(self, seconds: float, computed: float, every: float = 0.05) -> bool:
        """Return whether the limit has passed after some more seconds with looks, by when the host has computed."""
        until = self.now + seconds
        while True:
            self.now = min(self.now + every, until)
            end = self.watchdog.end(ProcessStatus(1, psutil.STATUS_RUNNING, computed))
            if end is not None or self.now == until:
                return end == HostExitError(HUNG, round(1e3 * LIMIT))


@pytest.mark.parametrize("wants", [False, True], ids=["waits for something else", "computes"])
def test_the_limit_is_by_the_clock(monkeypatch: pytest.MonkeyPatch, wants: bool) -> None:
    watched = Watched(monkeypatch, wants)
    assert not watched.passed(0.99 * LIMIT, 3.0)
    assert watched.passed(0.02 * LIMIT, 3.0 + (0.9 * LIMIT if wants else 0.0))


def test_what_waits_for_a_processor_is_not_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, True)
    assert not watched.passed(10 * LIMIT, 3.0 + 0.9 * COMPUTED_SHARE * LIMIT)
    assert watched.passed(0.1, 3.0 + 1.1 * COMPUTED_SHARE * LIMIT)


def test_the_time_in_which_nobody_looked_is_not_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the machine stood still, the process that looks and the one that is looked at."""
    watched = Watched(monkeypatch, False)
    assert not watched.passed(10 * LIMIT, 3.0, every=10 * LIMIT)
    assert not watched.passed(LIMIT - 2 * STANDSTILL_SECONDS, 3.0)
    assert watched.passed(2 * STANDSTILL_SECONDS, 3.0)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
@pytest.mark.parametrize(("code", "wants"), [("while True: pass", True), ("input()", False)])
def test_who_wants_a_processor(code: str, wants: bool) -> None:
    code = f"import threading; threading.Thread(target=lambda: exec({code!r})).start()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as process:
        try:
            wait_until(lambda: wants_processor(process.pid) == wants)
            if wants:
                wait_until(lambda: condition_of(process.pid).computed > 0.5)
                assert wants_processor(process.pid)
        finally:
            process.kill()
    assert condition_of(process.pid) == ProcessStatus(process.pid, psutil.STATUS_ZOMBIE, 0.0)
    assert not wants_processor(process.pid)
    assert condition_of(os.getpid()).computed > 0.0
