"""How a process that runs FMUs came to an end, and that in words."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass

CRASHED, EXITED, HUNG, GREW, KILLED, REFUSED, GARBLED = range(7)
"""How a host came to an end: by a signal, by itself, stopped for time, stopped for memory, killed from outside, stopped
since the system refused it what it needs, stopped since something other than its answer came from it."""


@dataclass(frozen=True)
class End(Exception):  # noqa: N818  # no error: a report of what became of the process
    """A host has come to an end while it was to work.

    Attributes
    ----------
    kind : int
        `CRASHED` and so on.
    number : int
        The signal, the exit code, the system's error number, the time limit in ms or the memory limit in MB; of the
        limits only those that were given, since the others depend on the machine and on what ran before, and the same
        failure is to read the same.
    """

    kind: int
    number: int

    def words(self) -> str:
        """Return the end as a sentence goes on after the simulation."""
        if self.kind == EXITED:
            return f"it ended its process with exit code {self.number}"
        if self.kind == REFUSED:
            why = f" ({os.strerror(self.number)})" if self.number else ""
            return f"the system refused its process what it needs to go on{why}"
        if self.kind == GARBLED:
            return "it wrote into the connection of its process with fmuid"
        if self.kind == HUNG:
            limit = f"{self.number / 1e3:.4g} s" if self.number else "the default time limit (isolation.time_limit)"
            return f"it did not end within {limit} and was stopped"
        if self.kind == GREW:
            limit = f"{self.number} MB" if self.number else "the default share of the memory (isolation.memory)"
            return f"its process took more than {limit} and was stopped"
        try:
            name = signal.Signals(self.number).name
        except ValueError:
            name = f"signal {self.number}"
        if self.kind == KILLED:
            return f"its process was killed again and again with {name}, from outside or for want of memory"
        return f"its process crashed with {name}"
