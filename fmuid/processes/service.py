"""What an isolated process does: it calls functions as the process at the other end of its socket orders."""

from __future__ import annotations

import ctypes
import importlib
import logging
import mmap
import os
from operator import attrgetter
from typing import Any

from fmuid.processes.channel import Channel, answer_parts, order_of

_shared: list[int] = []  # descriptor of the file that this process shares with the one that gives it orders


def shared_memory(size: int) -> mmap.mmap:
    """Return the memory that this isolated process shares with the one that gives it orders, of a size in bytes.

    On Linux no fork of this process has it: native code may fork, and its child come back and go on with the order.
    """
    memory = mmap.mmap(_shared[0], size)
    if hasattr(mmap, "MADV_DONTFORK"):
        memory.madvise(mmap.MADV_DONTFORK)
    return memory


class _Messages(logging.Handler):
    """Collects what is logged, to be said by the process that asked."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.found: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.found.append((record.name, record.levelno, record.getMessage()))


class Service:
    """Calls functions, as the process at the other end of a socket orders.

    Parameters
    ----------
    channel : Channel
    memory : int
        File descriptor of the shared memory.
    """

    def __init__(self, channel: Channel, memory: int) -> None:
        self._channel = channel
        _shared[:] = [memory]
        self._messages = _Messages()
        logger = logging.getLogger("fmuid")
        logger.addHandler(self._messages)
        logger.propagate = False
        self._libc = ctypes.CDLL(None)

    def serve(self) -> None:
        """Carry out orders until the other side is gone."""
        process = os.getpid()
        while True:
            try:
                token, order = self._channel.receive()
            except EOFError:
                return
            failed, answer = self._called(*order_of(order))
            if (
                os.getpid() != process
            ):  # native code has forked, and its child came back here: it is no isolated process
                os._exit(os.EX_SOFTWARE)
            self._libc.fflush(None)
            said, self._messages.found = self._messages.found, []
            try:
                self._channel.send(self._parts(failed, answer, said), token)
            except EOFError:
                return

    def _called(self, module: str, name: str, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """Call a function; return whether it failed, and its error or its value."""
        try:
            return False, attrgetter(name)(importlib.import_module(module))(*arguments)
        except Exception as error:  # whatever it is, the other side is waiting
            return True, error

    def _parts(self, failed: bool, answer: Any, said: Any) -> Any:
        try:
            return answer_parts((failed, answer, said))
        except Exception as error:  # a value that cannot be sent
            return answer_parts((True, error, said))
