"""Messages of any size between processes over a watched socket.

Orders are pickles. Answers execute no code: native code in the answering process can write anything into its
socket. An answer is JSON text and raw memory of arrays. It has plain values, arrays, and errors of Python and fmuid.

A message is a header, the sizes of its parts, and the parts. An answer repeats the token of its order, and a
checksum covers all parts. Anything else is garbled.
"""

from __future__ import annotations

import builtins
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
from functools import reduce
from typing import Any, Literal

from fmuid import errors

LARGE_BYTES = 1 << 16  # bytes; larger arrays of an order are sent beside its pickle
Part = bytes | bytearray | memoryview

_DTYPE = re.compile(r"[<>|=][biufcSUmM]\d+(\[\w+\])?")
_ERRORS = {module.__name__: module for module in (builtins, errors)}


class GarbledError(Exception):
    """Something other than a message was written to the socket."""


def order_parts(order: object) -> list[Part]:
    """Return a pickle, and the memory of each large array."""
    beside: list[Part] = []

    def keep_small(buffer: pickle.PickleBuffer) -> bool:
        raw = buffer.raw()
        if raw.nbytes >= LARGE_BYTES:
            beside.append(raw)
        return raw.nbytes < LARGE_BYTES

    return [pickle.dumps(order, pickle.HIGHEST_PROTOCOL, buffer_callback=keep_small), *beside]


def order_of(parts: Sequence[Part]) -> Any:
    """Return the order of a message of `order_parts`."""
    data, *beside = parts
    return pickle.loads(data, buffers=beside)


def answer_parts(answer: object) -> list[Part]:
    """Return a text, and the memory of each array; a TypeError of other types than `_plain` takes."""
    beside: list[Part] = []
    return [json.dumps(_plain(answer, beside)).encode(), *beside]


def answer_of(parts: Sequence[Part]) -> Any:
    """Return the answer of a message; raise `GarbledError` if there is none."""
    try:
        text, *beside = parts
        left = iter(beside)
        found = _value(json.loads(bytes(text)), left)
        if next(left, None) is None:
            return found
    except Exception:  # any bytes may be there
        raise GarbledError from None
    raise GarbledError


def _plain(value: Any, beside: list[Part]) -> Any:
    """Return plain values, containers, arrays and errors of them as JSON; arrays and bytes join `beside`, in order."""
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
    import numpy as np  # mostly loaded already, but not in a server

    if isinstance(value, np.generic) and value.dtype.kind in "biufcSU":
        return _plain(value.item(), beside)
    if not isinstance(value, np.ndarray) or not _DTYPE.fullmatch(value.dtype.str):
        raise TypeError(f"a {type(value).__name__} cannot be sent between processes")
    order: Literal["C", "F"] = "F" if value.flags.fnc else "C"
    flat = np.ascontiguousarray(value.reshape(-1, order=order))  # a copy only if it has gaps
    beside.append(flat.view(np.uint8).data if flat.size else b"")
    return ["array", value.dtype.str, order, *value.shape]


def _plain_error(error: Exception) -> list[Any]:
    """Return an error, or its nearest base in Python."""
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
    """Return the value of `_plain`'s JSON; raise any error otherwise."""
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


HEADER = struct.Struct("<8s8sIQ")  # Mark, token, checksum, number of parts; the sizes of parts follow (``<Q``)
MARK = b"fmuid\x00\x02\n"
TOKEN_BYTES = 8

Look = Callable[[], None]


class Channel:
    """One end of a blocking socket that carries messages.

    While nothing moves, an exchange calls `look` every `look_every` s, which may raise.
    """

    def __init__(self, end: socket.socket, look_every: float | None = None) -> None:
        self._end = end
        self._every = None if look_every is None else 1e3 * look_every

    def send(self, parts: Sequence[Part], token: bytes, look: Look | None = None) -> None:
        """Send a message; raise EOFError if the other side is gone. An answer has the token of its order."""
        sizes = struct.pack(f"<{len(parts)}Q", *(memoryview(part).nbytes for part in parts))
        head = HEADER.pack(MARK, token, _checksum([sizes, *parts]), len(parts)) + sizes
        for part in (head, *parts):
            left = memoryview(part)
            while left:
                try:
                    left = left[self._end.send(left, socket.MSG_DONTWAIT) :]
                except BlockingIOError:
                    self._wait(select.POLLOUT, look)
                except OSError as error:
                    raise EOFError from error

    def receive(
        self, look: Look | None = None, token: bytes | None = None, most_bytes: float = math.inf
    ) -> tuple[bytes, list[bytearray]]:
        """Return token and parts of the next message; GarbledError for another one, EOFError without other side."""
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
        poller = select.poll()
        poller.register(self._end, event)
        while not poller.poll(self._every if look is not None else None):
            if look is not None:
                look()

    @property
    def at_end(self) -> bool:
        """Whether the other side is gone, found out without waiting."""
        try:
            return not self._end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except OSError as error:
            return not isinstance(error, BlockingIOError)

    @property
    def open(self) -> bool:
        """Whether this end is open."""
        return self._end.fileno() >= 0

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def _checksum(parts: Sequence[Part]) -> int:
    return reduce(lambda found, part: zlib.crc32(part, found), parts, 0)
