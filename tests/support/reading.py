"""Readers that never return, for the reader process."""

import os
import signal
import time
from typing import Any


def crash(*_: object) -> dict[str, Any]:
    """End the process by a signal, as a library does that reads memory which it has not."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return hang()


def hang(*_: object) -> dict[str, Any]:
    """Compute for ever."""
    until = time.monotonic() + 600.0
    while time.monotonic() < until:
        pass
    return {}


def grow(*_: object) -> dict[str, Any]:
    """Take memory, a megabyte after the other."""
    held = []
    for _each in range(100_000):
        held.append(b"1" * (1 << 20))
        time.sleep(1e-3)
    return {}


def kill(*_: object) -> dict[str, Any]:
    """End the process as the system does where memory is short."""
    os.kill(os.getpid(), signal.SIGKILL)
    return hang()


def refuse(*_: object) -> dict[str, Any]:
    """Raise what a library raises."""
    raise MemoryError
