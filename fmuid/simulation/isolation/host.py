"""Near side of process isolation: one watched process of FMUs, its keeper."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from fmuid.array_types import Indices
from fmuid.errors import FmuidError
from fmuid.models import Isolation
from fmuid.processes import LIMITS, HostExitError, HostKeeper, HostProcess, ProcessEnd, ProcessStatus, Watchdog
from fmuid.simulation import codes
from fmuid.simulation.isolation import server


def end_words(end: HostExitError) -> str:
    """Return the end of a process as a clause; only given limits are named: defaults vary (`number` is 0)."""
    number = end.number
    seconds = f"{number / 1e3:.4g} s" if number else "the default time limit (isolation.time_limit)"
    size = f"{number} MB" if number else "the default memory limit (isolation.memory_limit_mb)"
    return {
        ProcessEnd.CRASHED: f"its process crashed with {end.signal_name}",
        ProcessEnd.EXITED: f"it ended its process with exit code {number}",
        ProcessEnd.HUNG: f"it did not end within {seconds} and was stopped",
        ProcessEnd.GREW: f"its process took more than {size} and was stopped",
        ProcessEnd.KILLED: f"its process was killed repeatedly with {end.signal_name}, from outside or for lack of "
        "memory",
        ProcessEnd.REFUSED: f"its process lacks system resources{f' ({os.strerror(number)})' if number else ''}",
        ProcessEnd.GARBLED: "it corrupted the connection to its process",
        ProcessEnd.STOPPED: "its process was stopped (SIGSTOP) and did not continue",
        ProcessEnd.FAILED: "code of fmuid failed in its process",
    }[end.kind]


@dataclass(frozen=True)
class TimeLimits:
    """Time limits of processes that run FMUs, s."""

    first: float = 60.0  # default of a simulation before any has ended, or of one with more steps than all before ...
    per_step: float = 1e-4  # ... and for each of its communication steps: far more than one takes, but of a slow model
    least: float = 5.0  # lower limit of the default: machines are busy at times
    slower: float = 100.0  # default: this multiple of the longest simulation
    preparation: float = 120.0  # instantiation and loading of code: some FMUs read large files
    at_rest: float = 60.0  # without simulation and CPU time, until a process that owes an answer is ended


TIME_LIMITS = TimeLimits()

Value = TypeVar("Value")


class HostWatchdog(Watchdog):
    """Watches one order: `limit`, s, until a thread does something else, or one more of the `reports` is done.

    A process that `computes` may calculate for any time while no thread simulates.
    """

    def __init__(self, limit: float, doing: Indices, reports: Indices | None = None, computes: bool = False) -> None:
        super().__init__(limit)
        self._doing, self._reports, self._computes = doing, reports, computes

    @property
    def _at_rest(self) -> bool:
        return self._computes and not self._doing[::2].any()

    def state(self, condition: ProcessStatus) -> Hashable:
        """Return states of threads, number of open reports, and CPU time, s."""
        undone = 0 if self._reports is None else int((self._reports[:, 2] == codes.UNDONE).sum())
        return self._doing.tobytes(), undone, int(condition.computed) if self._at_rest else 0

    def allowed(self) -> float:
        """Return the time limit of the current state, s."""
        if self._at_rest:
            return TIME_LIMITS.at_rest
        preparing = (self._doing[::2] == codes.PREPARING).any()
        return max(self.limit, TIME_LIMITS.preparation) if preparing else self.limit


class FmuHost(HostProcess):
    """One process that runs the FMUs of one system; parameters as of `fmuid.processes.HostProcess`."""

    doing: Indices  # state and number of beginnings of each thread (`server.DOING_WORDS`,)
    simulations: int  # number of given simulations
    records: dict[int, int]  # bytes of the large arrays of each known run

    def __init__(self, modules: Sequence[str], memory_limit: float, told: set[str] | None = None) -> None:
        super().__init__(modules, memory_limit, told)
        self.simulations, self.records = 0, {}
        self._show(8 * server.DOING_WORDS)

    def _show(self, size: int) -> None:
        self.doing = np.frombuffer(self.share(size), np.intp, server.DOING_WORDS)

    def room(self, shape: tuple[int, int, int, int]) -> tuple[server.Arrays, int]:
        """Return reports, thetas and outputs in shared memory, and its size."""
        needed = server.layout(*shape)[-1]
        if needed > len(self._memory):
            self._show(needed)
        return server.arrays(self._memory, shape), len(self._memory)

    def order(
        self,
        function: Callable[..., Value],
        *arguments: Any,
        limit: float,
        reports: Indices | None = None,
        computes: bool = False,
    ) -> Value:
        """Call a function in the process under a `HostWatchdog`; a `HostExitError` if it ends or fails."""
        return self.call(function, *arguments, watchdog=HostWatchdog(limit, self.doing, reports, computes))

    def failure(self, error: Exception) -> Exception:
        """Return an FMU's error in words, else the end of its process."""
        if isinstance(error, FmuidError):
            return error
        if isinstance(error, OSError | MemoryError):
            return self.stopped(HostExitError(ProcessEnd.REFUSED, getattr(error, "errno", errno.ENOMEM) or 0))
        words = f"code of fmuid failed in the process of an FMU: {type(error).__name__}: {error}"
        self.pass_on([("fmuid.fmu", logging.WARNING, words)])
        return self.stopped(HostExitError(ProcessEnd.FAILED, 0))

    @property
    def given(self) -> float:
        """Its memory that belongs to `fmuid`, not to the FMU, bytes."""
        return super().given + sum(self.records.values())

    def close(self) -> None:
        """Let it free its instances, and end it."""
        if self.alive:
            with contextlib.suppress(HostExitError):  # it is killed below either way
                self.order(server.close, limit=LIMITS.closing)
            self.kill()


_left: list[str] = []  # what FMUs printed whose keepers are gone


class HostManager(HostKeeper[FmuHost]):
    """Keeps one process for FMUs, and ends it; parameters as of `FmuHost`."""

    longest: float  # duration of the longest simulation, s

    def __init__(self, settings: Isolation, modules: Sequence[str], told: set[str] | None = None) -> None:
        super().__init__(lambda memory: FmuHost(modules, memory, told), settings.memory_limit_mb, _left)
        self._settings, self.longest = settings, 0.0

    @property
    def time_limit(self) -> float:
        """Time limit of a simulation like earlier ones, s."""
        if self._settings.time_limit:
            return self._settings.time_limit
        return max(TIME_LIMITS.least, TIME_LIMITS.slower * self.longest) if self.longest else TIME_LIMITS.first

    def replace(self) -> None:
        """End the process if it has simulated."""
        if self._hosts and self._hosts[0].simulations:
            super().replace()

    def close(self) -> None:
        """End the process."""
        super().replace()

    def replace_outgrown(self) -> None:
        """End the process after too many simulations, or grown too large."""
        recycle = self._settings.max_simulations_per_process
        if self._hosts and recycle is not None and self._hosts[0].simulations >= recycle:
            self.replace()
        else:
            super().replace_outgrown()


def left() -> list[str]:
    """Return and forget printed text of FMUs without keeper."""
    found = _left[:]
    _left.clear()
    return found
