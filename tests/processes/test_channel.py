"""Messages between processes: any size, whoever is slow; who is gone or talks nonsense is told apart."""

import contextlib
import json
import os
import pickle
import socket
import sys
import threading
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import InputError
from fmuid.processes.channel import (
    HEADER,
    LARGE_BYTES,
    MARK,
    TOKEN_BYTES,
    Channel,
    GarbledError,
    answer_of,
    answer_parts,
    order_of,
    order_parts,
)

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


def sent(parts: Any, token: bytes = TOKEN) -> bytes:
    """Return the bytes of a message."""
    own, other = socket.socketpair()
    with own, other:
        Channel(own).send(parts, token)
        own.close()
        return b"".join(iter(lambda: other.recv(1 << 16), b""))


ANSWER = [(False, {"x": np.arange(50.0), "names": ["a", "b"], "n": 7}, [("fmuid", 30, "said")]), InputError("no")]


def test_no_spoilt_message_is_taken_for_an_answer() -> None:
    """Bytes turned, left out, put in, lengths forged: told as garbled or as cut off, with no other error."""
    whole = sent(answer_parts(ANSWER))
    rng = np.random.default_rng(8)
    for _ in range(100):
        spoilt, at, size = bytearray(whole), int(rng.integers(len(whole))), int(rng.integers(1, 9))
        way = rng.integers(4)
        if way == 0:
            spoilt[at] ^= int(rng.integers(1, 256))
        elif way == 1:
            del spoilt[at : at + size]
        elif way == 2:
            spoilt[at:at] = rng.bytes(size)
        else:  # the number of parts and their sizes
            place = int(rng.integers(HEADER.size - 8, HEADER.size + 16))
            spoilt[place : place + size] = bytes(size) if rng.random() < 0.3 else rng.bytes(size)
        if spoilt == whole:
            continue
        own, other = socket.socketpair()
        with own, other:
            own.sendall(spoilt)
            own.close()
            with pytest.raises((GarbledError, EOFError)):
                Channel(other).receive(token=TOKEN, most_bytes=1e6)


@pytest.mark.parametrize(
    "message",
    [
        b"something that a library prints",
        HEADER.pack(MARK, TOKEN, 0, 1 << 56),
        HEADER.pack(MARK, TOKEN, 0, 2) + b"\xff" * 16,
        HEADER.pack(MARK, TOKEN, 0, 1) + (1 << 40).to_bytes(8, "little"),
        sent(answer_parts(1), TOKEN[::-1]),  # the answer to another order
    ],
)
def test_no_other_message_is_taken_or_takes_memory(ends: Any, message: bytes) -> None:
    ends[1].sendall(message)
    tracemalloc.start()
    try:
        with pytest.raises(GarbledError):
            Channel(ends[0]).receive(token=TOKEN, most_bytes=1e9)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


class Effect:
    """What code does in a pickle."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("made",)


def test_no_answer_executes_code_or_raises_anything_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts with a sound checksum: a pickle, types and shapes of all kinds, texts spoilt at random."""
    monkeypatch.chdir(tmp_path)
    shapes: list[Any] = [
        ["array", "<f8", "C", 1 << 60, 1 << 60],
        ["array", "|O", "C", 1],
        ["array", "<U999999999999", "C", 1],
        ["error", "builtins", "KeyboardInterrupt"],
        ["error", "builtins", "eval", "1"],
        ["error", "os", "system", "true"],
        ["error", "builtins", "UnicodeDecodeError", "x"],
        ["dict", [["list"], 1]],
        [],
        {"a": 1},
    ]
    texts = [json.dumps(shape).encode() for shape in shapes]
    texts += [pickle.dumps(Effect()), b"[" * 100_000, b"\xff\xfe", b"1" * 10_000, b""]
    for text in texts:
        with pytest.raises(GarbledError):
            answer_of([text, bytes(8)])
    with pytest.raises(GarbledError):
        answer_of([])
    rng = np.random.default_rng(9)
    answer, *beside = answer_parts(ANSWER)
    for _ in range(100):
        spoilt = bytearray(answer)
        for at in rng.integers(len(spoilt), size=rng.integers(1, 4)):
            spoilt[at] = rng.choice(list(b'[]{}",:0123456789eE-nNaultrfis<|>\\ '))
        with contextlib.suppress(GarbledError):
            answer_of([spoilt, *beside])
    assert not list(tmp_path.iterdir())
