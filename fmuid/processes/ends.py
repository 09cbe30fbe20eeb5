"""How an isolated process came to an end."""

from __future__ import annotations

import signal
from dataclasses import dataclass

CRASHED, EXITED, HUNG, GREW, KILLED, REFUSED, GARBLED, STOPPED, FAILED = range(9)
"""Ends of a process: crashed by a signal, exited, over its time limit, over its memory limit, killed from outside,
refused by the system what it needs, ended since its answer was garbled, ended since it was stopped (SIGSTOP), ended
since code of fmuid failed in it."""


@dataclass(unsafe_hash=True)  # not frozen: who passes on an exception notes where
class HostExitError(Exception):  # no error: a report of what became of the process
    """An isolated process has come to an end while it was to work.

    Attributes
    ----------
    kind : int
        `CRASHED` and so on.
    number : int
        The signal, the exit code, the system's error number, the time limit in ms or the memory limit in MB.
    """

    kind: int
    number: int

    @property
    def signal_name(self) -> str:
        """Name of the signal, as ``SIGSEGV``."""
        try:
            return signal.Signals(self.number).name
        except ValueError:
            return f"signal {self.number}"
