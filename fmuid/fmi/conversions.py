"""Hooks of the compiled master loop for values that binaries want as something else than 64-bit floating-point numbers.

(The loop itself knows only these; `fmuid.fmi.native.WIRES` lists the others.)
"""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from fmuid.fmi import codes as k
from fmuid.fmi.codes import (
    FLOAT32,
    INT8,
    INT16,
    INT32,
    INT64,
    UINT8,
    UINT16,
    UINT32,
)
from fmuid.fmi.native import (
    load_int32,
    load_real,
    load_word,
    memory,
    store_int32,
    store_real,
    store_word,
)

_load_float32, _store_float32 = memory(types.float32)
_load_int8, _store_int8 = memory(types.int8)
_load_uint8, _store_uint8 = memory(types.uint8)
_load_int16, _store_int16 = memory(types.int16)
_load_uint16, _store_uint16 = memory(types.uint16)
_load_uint32, _store_uint32 = memory(types.uint32)
_load_uint64, _store_uint64 = memory(types.uint64)


@numba.njit("void(intp, intp, intp, float64)", cache=True, nogil=True, error_model="numpy")
def pack(address, index, wire, value):  # type: ignore[no-untyped-def]
    """Store a number as the type that a binary wants; whole numbers are rounded."""
    whole = np.int64(round(value)) if wire != FLOAT32 else np.int64(0)
    if wire == FLOAT32:
        _store_float32(address, index, np.float32(value))
    elif wire == INT8:
        _store_int8(address, index, np.int8(whole))
    elif wire == UINT8:
        _store_uint8(address, index, np.uint8(whole))
    elif wire == INT16:
        _store_int16(address, index, np.int16(whole))
    elif wire == UINT16:
        _store_uint16(address, index, np.uint16(whole))
    elif wire == INT32:
        store_int32(address, index, np.int32(whole))
    elif wire == UINT32:
        _store_uint32(address, index, np.uint32(whole))
    elif wire == INT64:
        store_word(address, index, whole)
    else:
        _store_uint64(address, index, np.uint64(whole))


@numba.njit("float64(intp, intp, intp)", cache=True, nogil=True, error_model="numpy")
def unpack(address, index, wire):  # type: ignore[no-untyped-def]
    """Load a number of the type that a binary gave."""
    if wire == FLOAT32:
        return np.float64(_load_float32(address, index))
    if wire == INT8:
        return np.float64(_load_int8(address, index))
    if wire == UINT8:
        return np.float64(_load_uint8(address, index))
    if wire == INT16:
        return np.float64(_load_int16(address, index))
    if wire == UINT16:
        return np.float64(_load_uint16(address, index))
    if wire == INT32:
        return np.float64(load_int32(address, index))
    if wire == UINT32:
        return np.float64(_load_uint32(address, index))
    if wire == INT64:
        return np.float64(load_word(address, index))
    return np.float64(_load_uint64(address, index))


@numba.cfunc("int32(intp, intp)", cache=True, error_model="numpy")
def _to_wire(m, row):  # type: ignore[no-untyped-def]
    for j in range(load_word(row, k.N_VALUES)):
        value = load_real(load_word(m, k.SIGNALS), load_word(row, k.SIGNAL) + j)
        pack(load_word(row, k.VALUES), j, load_word(row, k.WIRE), value)
    return k.GO


@numba.cfunc("int32(intp, intp)", cache=True, error_model="numpy")
def _from_wire(m, row):  # type: ignore[no-untyped-def]
    for j in range(load_word(row, k.N_VALUES)):
        value = unpack(load_word(row, k.VALUES), j, load_word(row, k.WIRE))
        store_real(load_word(m, k.SIGNALS), load_word(row, k.SIGNAL) + j, value)
    return k.GO


HOOKS: dict[int, int] = {k.TO_WIRE: _to_wire.address, k.FROM_WIRE: _from_wire.address}
"""Field of the memory -> address of the hook that belongs there."""
