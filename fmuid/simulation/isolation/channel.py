"""Messages between processes over a socket that is watched meanwhile, however large they are.

A message is a header, a pickle, and beside it the memory of each large array as it is: it goes from the array into
memory that is there for it, so that time and memory grow in proportion to what is sent.
"""

from __future__ import annotations

import logging
import pickle
import select
import socket
import struct
from collections.abc import Callable, Iterable
from typing import Any

LARGE_BYTES = 1 << 16
"""Arrays of so many bytes or more travel beside the pickle."""
HEADER = struct.Struct("<8sQQ")
"""The mark of a message, the bytes of its pickle, and the number of arrays beside it, whose bytes follow (``<Q``)."""
MARK = b"fmuid\x00\x01\n"

Look = Callable[[], None]


class GarbledError(Exception):
    """What came is no message: something else has written to the socket."""


class Channel:
    """One end of a socket that carries messages.

    Parameters
    ----------
    end : socket
        Blocking, as sockets are made.
    look_every : float, optional
        How often what watches an exchange is called while nothing moves, s.
    """

    def __init__(self, end: socket.socket, look_every: float | None = None) -> None:
        self._end = end
        self._every = None if look_every is None else 1e3 * look_every

    def send(self, message: object, look: Look | None = None) -> int:
        """Send a message; return how many bytes of it travelled beside the pickle.

        Parameters
        ----------
        message : object
        look : callable, optional
            Called every now and then while the other side takes nothing; what it raises ends the sending.

        Raises
        ------
        EOFError
            If the other side is gone.
        """
        beside: list[memoryview] = []

        def keep_small(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            if raw.nbytes >= LARGE_BYTES:
                beside.append(raw)
            return raw.nbytes < LARGE_BYTES

        data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL, buffer_callback=keep_small)
        sizes = struct.pack(f"<{len(beside)}Q", *(each.nbytes for each in beside))
        head = HEADER.pack(MARK, len(data), len(beside)) + sizes
        for part in (memoryview(head), memoryview(data), *beside):
            self._send(part, look)
        return sum(each.nbytes for each in beside)

    def receive(self, look: Look | None = None) -> Any:
        """Return the next message.

        Parameters
        ----------
        look : callable, optional
            Called every now and then while nothing comes; what it raises ends the waiting.

        Raises
        ------
        EOFError
            If the other side is gone.
        GarbledError
            If what comes is no message.
        """
        mark, length, count = HEADER.unpack(self._receive(HEADER.size, look))
        if mark != MARK:
            raise GarbledError
        sizes = struct.unpack(f"<{count}Q", self._receive(8 * count, look))
        data, *beside = [self._receive(size, look) for size in (length, *sizes)]
        return pickle.loads(data, buffers=beside)

    def _send(self, left: memoryview, look: Look | None) -> None:
        while left:
            try:
                left = left[self._end.send(left, socket.MSG_DONTWAIT) :]
            except BlockingIOError:
                self._wait(select.POLLOUT, look)
            except OSError as error:
                raise EOFError from error

    def _receive(self, size: int, look: Look | None) -> bytearray:
        data = bytearray(size)
        left = memoryview(data)
        while left:
            try:
                count = self._end.recv_into(left, 0, socket.MSG_DONTWAIT)
            except BlockingIOError:
                self._wait(select.POLLIN, look)
                continue
            except OSError as error:
                raise EOFError from error
            if not count:
                raise EOFError
            left = left[count:]
        return data

    def _wait(self, event: int, look: Look | None) -> None:
        """Wait until the socket can go on."""
        poller = select.poll()
        poller.register(self._end, event)
        while not poller.poll(self._every if look is not None else None):
            if look is not None:
                look()

    @property
    def open(self) -> bool:
        """Whether this end has not been closed."""
        return self._end.fileno() >= 0

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def pass_on(said: Iterable[tuple[str, int, str]], told: set[str] | None) -> None:
    """Log what was logged on the other side: logger, level and text; but nothing that is in a set, which it joins."""
    for logger, level, text in said:
        if told is None or text not in told:
            logging.getLogger(logger).log(level, "%s", text)
        if told is not None:
            told.add(text)
