"""Messages between processes over a socket that is watched meanwhile, however large they are.

Orders are pickles, answers are data that execute no code. Native code of somebody else runs in the process that
answers, and can write anything into its connection. An answer is therefore JSON text for the structure and raw memory
for arrays. Reading one makes plain values, arrays of plain types and errors of Python and fmuid; everything else is
garbled.

A message is a header, the sizes of its parts, and the parts: each goes from the memory that has it into memory that is
there for it, so that time and memory grow in proportion to what is sent. An answer repeats the token of its order, and
a checksum covers all parts: what anybody else writes into the socket is no answer, nor is the answer to an earlier
order.
"""

from __future__ import annotations

import builtins
import contextlib
import json
import math
import pickle
import re
import select
import socket
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from typing import Any, Literal

from fmuid import errors

LARGE_BYTES = 1 << 16
"""Arrays of an order of so many bytes or more travel beside its pickle."""
Part = bytes | bytearray | memoryview

_DTYPE = re.compile(r"[<>|=][biufcSUmM]\d+(\[\w+\])?")
_ERRORS = {module.__name__: module for module in (builtins, errors)}


class GarbledError(Exception):
    """What came is no message: something else has written to the socket."""


def order_parts(order: object) -> list[Part]:
    """Return the parts of a message: a pickle, and the memory of each large array as it is."""
    beside: list[Part] = []

    def keep_small(buffer: pickle.PickleBuffer) -> bool:
        raw = buffer.raw()
        if raw.nbytes >= LARGE_BYTES:
            beside.append(raw)
        return raw.nbytes < LARGE_BYTES

    return [pickle.dumps(order, pickle.HIGHEST_PROTOCOL, buffer_callback=keep_small), *beside]


def order_of(parts: Sequence[Part]) -> Any:
    """Return the order that a message of the process above holds."""
    data, *beside = parts
    return pickle.loads(data, buffers=beside)


def answer_parts(answer: object) -> list[Part]:
    """Return the parts of a message: a text, and the memory of each array.

    An answer is made of None, bool, int, float, str, bytes, datetime, arrays of numbers, texts and times, and lists,
    tuples, dicts and errors of them. An error of another package becomes the nearest base among Python's own.

    Raises
    ------
    TypeError
        If something else is in it.
    """
    beside: list[Part] = []
    return [json.dumps(_plain(answer, beside)).encode(), *beside]


def answer_of(parts: Sequence[Part]) -> Any:
    """Return the answer that a message holds.

    Raises
    ------
    GarbledError
        If it holds none.
    """
    try:
        text, *beside = parts
        left = iter(beside)
        found = _value(json.loads(bytes(text)), left)
        if next(left, None) is None:
            return found
    except Exception:  # whatever it is that was written there
        raise GarbledError from None
    raise GarbledError


def _plain(value: Any, beside: list[Part]) -> Any:
    """Return what JSON has for a value; arrays and bytes join those beside, in order."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple):
        return ["list" if isinstance(value, list) else "tuple", *(_plain(each, beside) for each in value)]
    if isinstance(value, dict):
        return ["dict", *([_plain(key, beside), _plain(each, beside)] for key, each in value.items())]
    if isinstance(value, Exception):
        return _plain_error(value)
    if isinstance(value, bytes):
        beside.append(value)
        return ["bytes"]
    if type(value) is datetime:
        return ["datetime", value.isoformat()]
    return _plain_array(value, beside)


def _plain_array(value: Any, beside: list[Part]) -> Any:
    import numpy as np  # most processes that answer have it loaded; a server has not

    if isinstance(value, np.generic) and value.dtype.kind in "biufcSU":
        return _plain(value.item(), beside)
    if not isinstance(value, np.ndarray) or not _DTYPE.fullmatch(value.dtype.str):
        raise TypeError(f"a {type(value).__name__} cannot be sent between processes")
    order: Literal["C", "F"] = "F" if value.flags.fnc else "C"
    flat = np.ascontiguousarray(value.reshape(-1, order=order))  # the same memory, unless it has gaps
    beside.append(flat.view(np.uint8).data if flat.size else b"")
    return ["array", value.dtype.str, order, *value.shape]


def _plain_error(error: Exception) -> list[Any]:
    for kind in type(error).__mro__:
        if kind.__module__ in _ERRORS and issubclass(kind, Exception):
            arguments = error.__reduce__()[1] if kind is type(error) else (str(error),)
            beside: list[Part] = []
            try:
                plain = [_plain(each, beside) for each in arguments]
            except TypeError:
                continue
            if not beside:
                return ["error", kind.__module__, kind.__name__, *plain]
    return ["error", "builtins", "Exception", str(error)]


def _value(plain: Any, beside: Iterator[Part]) -> Any:
    """Return the value that JSON has so; raise whatever there is if there is none."""
    if not isinstance(plain, list):
        if isinstance(plain, dict):
            raise TypeError
        return plain
    kind, *rest = plain
    if kind in ("list", "tuple"):
        found = [_value(each, beside) for each in rest]
        return found if kind == "list" else tuple(found)
    if kind == "dict":
        return {_value(key, beside): _value(each, beside) for key, each in rest}
    if kind == "bytes":
        return bytes(next(beside))
    if kind == "datetime":
        return datetime.fromisoformat(*rest)
    return _array(rest, next(beside)) if kind == "array" else _error(kind, rest, beside)


def _array(rest: list[Any], memory: Part) -> Any:
    import numpy as np

    dtype, order, *shape = rest
    if not _DTYPE.fullmatch(dtype):
        raise TypeError
    return np.frombuffer(memory, dtype).reshape(shape, order=order)


def _error(kind: str, rest: list[Any], beside: Iterator[Part]) -> Exception:
    module, name, *arguments = rest
    found = getattr(_ERRORS[module], name)
    if kind != "error" or not issubclass(found, Exception):
        raise TypeError
    error: Exception = found(*(_value(each, beside) for each in arguments))
    return error


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
    def at_end(self) -> bool:
        """Whether the other side is gone, as far as it shows without waiting."""
        with contextlib.suppress(BlockingIOError):
            try:
                return not self._end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
            except ConnectionError:
                return True
        return False

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
