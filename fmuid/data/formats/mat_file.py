"""Whether a MAT file of version 5 has the structure that it must have, before SciPy reads it.

SciPy's compiled reader (1.17) does not check the types of elements: a damaged file can crash the process. The format is
that of "MAT-File Format" (The MathWorks), chapter 1: elements, each with a tag that gives its type and length.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

DEEPEST_NESTING = 50
"""Cells and structures inside each other; SciPy's reader is recursive."""
LARGEST_VARIABLE = 2**32
"""Bytes of a compressed variable: its length is a 32-bit number."""

_HEADER = 128
_UINT32, _MATRIX, _COMPRESSED = 6, 14, 15
_NUMBERS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}  # miINT8 ... miUTF32
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _NUMERIC, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, range(6, 16), 16, 17
_COMPLEX = 0x800
_ORDERS = {b"IM": "<", b"MI": ">"}

_Element = tuple[int, memoryview]
"""Type and content."""


def check_mat(path: Path) -> None:
    """Check the elements of a MAT file; one of another version is left to its reader.

    Raises
    ------
    ValueError
        If an element is invalid; the message says what is wrong.
    OSError
        If the file cannot be read.
    """
    content = path.read_bytes()
    order = _ORDERS.get(content[126:128])
    if order is None or content[125 if order == "<" else 124] != 1:
        return
    for kind, body in _elements(memoryview(content)[_HEADER:], order):
        if kind == _COMPRESSED:
            for each in _elements(_decompressed(body), order):
                _check_array(each, order)
        else:
            _check_array((kind, body), order)


def _check_array(given: _Element, order: str, depth: int = 0) -> None:
    """Check that the number and types of an array's elements agree with its class, dimensions and flags."""
    kind, body = given
    if kind == _MATRIX and depth and not body:
        return  # an empty cell
    elements = _elements(body, order)
    if (
        kind != _MATRIX
        or depth > DEEPEST_NESTING
        or not elements
        or (elements[0][0], len(elements[0][1])) != (_UINT32, 8)
    ):
        raise ValueError("a variable in it is no array")
    (flags,) = struct.unpack_from(order + "I", elements[0][1])
    numbers, arrays = _expected(flags, elements, order)
    kinds = [kind for kind, _ in elements[1:]]
    if len(kinds) != numbers + arrays or not _NUMBERS.issuperset(kinds[:numbers]):
        raise ValueError("an array in it has not the elements that belong to it")
    for each in elements[1 + numbers :]:
        _check_array(each, order, depth + 1)


def _expected(flags: int, elements: list[_Element], order: str) -> tuple[int, int]:
    """Return the numbers of numeric elements (with dimensions and name) and of arrays that follow the flags."""
    array_class, parts = flags & 0xFF, 2 if flags & _COMPLEX else 1
    if array_class == _CHAR:
        return 3, 0
    if array_class in _NUMERIC or array_class == _SPARSE:
        return 2 + parts + 2 * (array_class == _SPARSE), 0
    if array_class == _FUNCTION:
        return 2, 1
    if array_class == _OPAQUE:
        return 3, 1
    count = math.prod(_integers(elements, 1, order))
    if array_class == _CELL:
        return 2, count
    if array_class not in (_STRUCT, _OBJECT):
        raise ValueError(f"an array in it is of the unknown class {array_class}")
    fields = 3 + (array_class == _OBJECT)  # the element with the length of field names, before the names
    (length, *_) = *_integers(elements, fields, order), 0
    names = len(elements[fields + 1][1]) if len(elements) > fields + 1 else 0
    return fields + 1, count * (names // length) if length > 0 else -1


def _integers(elements: list[_Element], place: int, order: str) -> tuple[int, ...]:
    """Return the content of an element as integers, empty if it is missing; dimensions are never negative."""
    content = elements[place][1] if place < len(elements) else b""
    found = struct.unpack(f"{order}{len(content) // 4}i", content[: len(content) // 4 * 4])
    if min(found, default=0) < 0:
        raise ValueError("an array in it has a negative dimension")
    return found


def _elements(data: memoryview, order: str) -> list[_Element]:
    """Return the sequence of elements in some data."""
    found, place = [], 0
    while place + 8 <= len(data):
        kind, length = struct.unpack_from(order + "II", data, place)
        begin, end = place + 8, place + 8 + length
        if kind >> 16:  # a small element: two bytes each for length and type, and up to four of content
            begin, end = place + 4, place + 4 + (kind >> 16)
            kind, length = kind & 0xFFFF, 0
        if end > max(len(data), begin) or end - begin > max(length, 4):
            raise ValueError("it ends too early")
        found.append((kind, data[begin:end]))
        place += 8 + (length if kind == _COMPRESSED else -(-length // 8) * 8)
    return found


def _decompressed(data: memoryview) -> memoryview:
    reader = zlib.decompressobj()
    try:
        content = reader.decompress(data, LARGEST_VARIABLE)
    except zlib.error as error:
        raise ValueError(f"a variable in it cannot be decompressed: {error}") from None
    if reader.unconsumed_tail:
        raise ValueError("a variable in it is larger than a MAT file can have")
    return memoryview(content)
