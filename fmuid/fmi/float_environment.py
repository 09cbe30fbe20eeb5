"""The floating-point environment of a thread: how it rounds, flushes to zero, and traps.

An FMU can change it, on purpose or because its library was linked for speed, and whoever calculates next in this thread
would get other digits. It is therefore put back after every simulation (`fmuid.fmi.kernels.simulate`) and around
everything else that an instance lives through (`kept`), by the C library's own fegetenv and fesetenv (C11, section
7.6.4): on x86 they cover the x87 unit and SSE's MXCSR, on ARM the FPCR.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ROOM = 512  # bytes for a fenv_t: 8 on ARM and Windows, 32 on x86


def _functions() -> tuple[Any, Any] | None:
    """Return fegetenv and fesetenv, where the C library can be asked for them."""
    for name in ("ucrtbase",) if os.name == "nt" else (None, "libm.so.6"):
        try:
            library = ctypes.CDLL(name)
            functions = library.fegetenv, library.fesetenv
        except (OSError, AttributeError):
            continue
        for function in functions:
            function.argtypes = [ctypes.c_void_p]
        return functions
    return None


_known = _functions()
AVAILABLE = _known is not None
RESTORING: int = ctypes.cast(_known[1], ctypes.c_void_p).value or 0 if _known else 0
"""The address of fesetenv; 0 where there is none."""


class FloatEnvironment:
    """Room for the environment of a thread.

    Attributes
    ----------
    address : int
        Where it is kept.
    """

    def __init__(self) -> None:
        self._room = (ctypes.c_double * (ROOM // 8))()
        self.address = ctypes.addressof(self._room)

    def save(self) -> None:
        """Keep the environment of this thread as it is now."""
        if _known:
            _known[0](self.address)

    def restore(self) -> None:
        """Put the environment of this thread back to what was kept."""
        if _known:
            _known[1](self.address)


@contextmanager
def kept() -> Iterator[None]:
    """Have the environment of this thread be the same afterwards."""
    environment = FloatEnvironment()
    environment.save()
    try:
        yield
    finally:
        environment.restore()
