"""Messages between processes over a socket that is watched meanwhile, however large they are.

A message is a header, the sizes of its parts, and the parts (`fmuid.processes.messages`): each goes from the memory
that has it into memory that is there for it, so that time and memory grow in proportion to what is sent. An answer
repeats the token of its order, and a checksum covers all parts: what anybody else writes into the socket is not taken
for an answer, nor is the answer to an earlier order.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import zlib
from collections.abc import Callable, Sequence

from fmuid.processes.messages import GarbledError, Part

HEADER = struct.Struct("<8s8sIQ")
"""The mark of a message, its token, the checksum and number of its parts, whose sizes follow (``<Q``)."""
MARK = b"fmuid\x00\x02\n"
TOKEN_BYTES = 8

Look = Callable[[], None]


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

    def send(self, parts: Sequence[Part], token: bytes, look: Look | None = None) -> None:
        """Send a message.

        Parameters
        ----------
        parts : sequence of bytes-like
        token : (`TOKEN_BYTES`,) bytes
            Of an order: a new one; of an answer: that of the order.
        look : callable, optional
            Called every now and then while the other side takes nothing; what it raises ends the sending.

        Raises
        ------
        EOFError
            If the other side is gone.
        """
        sizes = struct.pack(f"<{len(parts)}Q", *(memoryview(part).nbytes for part in parts))
        head = HEADER.pack(MARK, token, _checksum([sizes, *parts]), len(parts)) + sizes
        for part in (head, *parts):
            self._send(memoryview(part), look)

    def receive(
        self, look: Look | None = None, token: bytes | None = None, most_bytes: float = math.inf
    ) -> tuple[bytes, list[bytearray]]:
        """Return the token and the parts of the next message.

        Parameters
        ----------
        look : callable, optional
            Called every now and then while nothing comes; what it raises ends the waiting.
        token : bytes, optional
            The token that the message must have; default: any.
        most_bytes : float, optional
            The size of the largest message.

        Raises
        ------
        EOFError
            If the other side is gone.
        GarbledError
            If what comes is no such message.
        """
        mark, found, checksum, count = HEADER.unpack(self._receive(HEADER.size, look))
        if mark != MARK or token not in (None, found) or 8 * count > most_bytes:
            raise GarbledError
        try:
            sizes = self._receive(8 * count, look)
            each = struct.unpack(f"<{count}Q", sizes)
            if sum(each) > most_bytes:
                raise GarbledError
            parts = [self._receive(size, look) for size in each]
        except (MemoryError, OverflowError, struct.error):
            raise GarbledError from None
        if _checksum([sizes, *parts]) != checksum:
            raise GarbledError
        return found, parts

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


def _checksum(parts: Sequence[Part]) -> int:
    found = 0
    for part in parts:
        found = zlib.crc32(part, found)
    return found
