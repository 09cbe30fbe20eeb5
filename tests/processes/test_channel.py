"""Messages between processes: any size, whoever is slow; who is gone or talks nonsense is told apart."""

from __future__ import annotations

import socket
import sys
import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest

from fmuid.processes.channel import HEADER, MARK, TOKEN_BYTES, Channel
from fmuid.processes.messages import LARGE_BYTES, GarbledError, answer_of, answer_parts, order_of, order_parts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork")
TOKEN = bytes(range(TOKEN_BYTES))


@pytest.fixture
def ends() -> Any:
    own, other = socket.socketpair()
    with own, other:
        yield own, other


def exchanged(ends: tuple[socket.socket, socket.socket], parts: Any, looks: int = 0) -> Any:
    """Return the parts of a message as they come out, its receiver late by some looks."""
    own, other = (Channel(each, 0.01) for each in ends)
    looked = threading.Semaphore(0)
    sender = threading.Thread(target=lambda: own.send(parts, TOKEN, looked.release))
    sender.start()
    for _ in range(looks):
        looked.acquire()
    _, received = other.receive()
    sender.join()
    return received


@pytest.mark.parametrize("kind", ["order", "answer"])
def test_what_is_larger_than_the_socket_takes_arrives(ends: Any, kind: str) -> None:
    """Though the receiver is late: looks pass, and end nothing. Arrays come out as they were, and can be written."""
    rng = np.random.default_rng(1)
    message: dict[str, Any] = {
        "large": rng.normal(size=(100_000, 3)),
        "turned": np.asfortranarray(rng.normal(size=(300, 400))),
        "small": rng.normal(size=7),
        "text": "x" * 3_000_000,
        "strided": rng.normal(size=200_000)[::2],
    }
    parts, read = (order_parts(message), order_of) if kind == "order" else (answer_parts(message), answer_of)
    received = read(exchanged(ends, parts, looks=5))
    assert received["text"] == message["text"]
    for name in ("large", "turned", "small", "strided"):
        assert np.array_equal(received[name], message[name])
        assert received[name].flags.writeable
    assert received["turned"].flags.f_contiguous
    if kind == "order":
        assert sum(len(part) for part in parts[1:]) == 8 * (300_000 + 120_000)


@pytest.mark.parametrize("kind", ["order", "answer"])
def test_large_arrays_are_there_once(ends: Any, kind: str) -> None:
    """Neither side makes a copy of them on the way."""
    array = np.ones(5_000_000)
    write, read = (order_parts, order_of) if kind == "order" else (answer_parts, answer_of)
    tracemalloc.start()
    try:
        received = read(exchanged(ends, write([array, array[: LARGE_BYTES // 8]])))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert np.array_equal(received[0], array)
    assert peak < array.nbytes + 2_000_000


@pytest.mark.parametrize("way", ["send", "receive"])
def test_what_looks_can_end_it(ends: Any, way: str) -> None:
    channel = Channel(ends[0], 0.01)

    def look() -> None:
        raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        channel.send([bytes(8_000_000)], TOKEN, look) if way == "send" else channel.receive(look)


def test_an_end_in_the_middle_is_one(ends: Any) -> None:
    own, other = ends
    other.sendall(HEADER.pack(MARK, TOKEN, 0, 1000) + b"half of it")
    other.close()
    with pytest.raises(EOFError):
        Channel(own).receive()
    with pytest.raises(EOFError):
        Channel(own).send([bytes(8_000_000)], TOKEN)


def test_what_is_no_message_is_not_taken_for_one(ends: Any) -> None:
    ends[1].sendall(b"something that a library prints")
    with pytest.raises(GarbledError):
        Channel(ends[0]).receive()
