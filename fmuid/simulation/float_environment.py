"""The floating-point environment of a thread: how it rounds, flushes to zero, and traps.

An FMU can change it, on purpose or because its library was linked for speed, and whoever calculates next in this thread
would get other digits. The core puts it back after every simulation; here it is put back around everything else that an
instance lives through, by the C library's own fegetenv and fesetenv (C11, section 7.6.4): on x86 they cover the x87
unit and SSE's MXCSR, on ARM the FPCR.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

from fmuid.simulation.native import core


@contextmanager
def kept() -> Iterator[None]:
    """Have the environment of this thread be the same afterwards."""
    library = core()
    room = ctypes.create_string_buffer(library.environment_size())
    library.environment_keep(room)
    try:
        yield
    finally:
        library.environment_restore(room)
