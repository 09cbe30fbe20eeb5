"""How long an isolated process has done the same, and when that is too long."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable

import psutil

from fmuid.processes.ends import HUNG, STOPPED, HostExitError
from fmuid.processes.family import ProcessStatus, wants_processor

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
