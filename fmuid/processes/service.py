"""The work of an isolated process: function calls as its socket orders."""

from __future__ import annotations

import ctypes
import importlib
import logging
import mmap
import os
import sys
from logging.handlers import BufferingHandler
from operator import attrgetter
from typing import Any

from fmuid.processes.channel import Channel, answer_parts, order_of

_shared: list[int] = []  # descriptor of the memory shared with the ordering process


def shared_memory(size: int) -> mmap.mmap:
    """Return the shared memory of an isolated process; size in bytes.

    On Linux forks do not have it: native code may fork, and the child continue the order.
    """
    memory = mmap.mmap(_shared[0], size)
    if hasattr(mmap, "MADV_DONTFORK"):
        memory.madvise(mmap.MADV_DONTFORK)
    return memory


class Service:
    """Function calls as a socket orders; `memory` is a file descriptor."""

    def __init__(self, channel: Channel, memory: int) -> None:
        self._channel = channel
        _shared[:] = [memory]
        self._messages = BufferingHandler(sys.maxsize)  # for the ordering process
        self._messages.setLevel(logging.INFO)
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
            if os.getpid() != process:  # a child forked by native code
                os._exit(os.EX_SOFTWARE)
            self._libc.fflush(None)
            said = [(each.name, each.levelno, each.getMessage()) for each in self._messages.buffer]
            self._messages.flush()
            try:
                parts = answer_parts((failed, answer, said))
            except Exception as error:  # a value that cannot be sent
                parts = answer_parts((True, error, said))
            try:
                self._channel.send(parts, token)
            except EOFError:
                return

    def _called(self, module: str, name: str, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """Return whether a function failed, and its error or value."""
        try:
            return False, attrgetter(name)(importlib.import_module(module))(*arguments)
        except Exception as error:  # the other side waits for any answer
            return True, error
