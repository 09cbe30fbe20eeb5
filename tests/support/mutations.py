"""Damage to binary files: bits, blocks and ends, in a packed file also inside its members."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from random import Random

_LARGEST_BLOCK = 64  # bytes
_EXTREMES = (b"\xff" * 8, b"\x00" * 8, b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\x00" * 7 + b"\x80")


def _block(rng: Random, data: bytes) -> slice:
    first = rng.randrange(len(data))
    return slice(first, min(len(data), first + rng.randint(1, _LARGEST_BLOCK)))


def _flipped(rng: Random, data: bytes) -> bytes:
    found = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8])):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def _truncated(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data))]


def _zeroed(rng: Random, data: bytes) -> bytes:
    place = _block(rng, data)
    return data[: place.start] + bytes(place.stop - place.start) + data[place.stop :]


def _inserted(rng: Random, data: bytes) -> bytes:
    place = _block(rng, data)
    return data[: place.start] + rng.randbytes(place.stop - place.start) + data[place.start :]


def _removed(rng: Random, data: bytes) -> bytes:
    place = _block(rng, data)
    return data[: place.start] + data[place.stop :]


def _swapped(rng: Random, data: bytes) -> bytes:
    a, b = sorted([_block(rng, data), _block(rng, data)], key=lambda place: place.start)
    if a.stop > b.start:
        return _flipped(rng, data)
    return data[: a.start] + data[b] + data[a.stop : b.start] + data[a] + data[b.stop :]


def _extreme(rng: Random, data: bytes) -> bytes:
    first, value = rng.randrange(len(data)), rng.choice(_EXTREMES)[: rng.choice([1, 2, 4, 8])]
    return (data[:first] + value + data[first + len(value) :])[: len(data)]


_WAYS: tuple[Callable[[Random, bytes], bytes], ...] = (
    _flipped,
    _flipped,
    _truncated,
    _zeroed,
    _inserted,
    _removed,
    _swapped,
    _extreme,
)


def mutated(rng: Random, data: bytes) -> bytes:
    """Return damaged data; of a packed file every other time with a damaged member, packed anew."""
    if data[:2] == b"PK" and rng.random() < 0.5:
        return _repacked(rng, data)
    return rng.choice(_WAYS)(rng, data)


def _repacked(rng: Random, data: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice([name for name, content in files.items() if content])
    files[name] = rng.choice(_WAYS)(rng, files[name])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for each, content in files.items():
            archive.writestr(each, content)
    return buffer.getvalue()
