"""The types of arrays, named once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmuid.errors import InputError
from fmuid.formatting import bounded

Floats = NDArray[np.float64]
"""An array of double precision."""

Complexes = NDArray[np.complex128]
"""An array of complex numbers of double precision."""

Indices = NDArray[np.intp]
"""An array of indices."""

Flags = NDArray[np.bool_]
"""An array of truth values."""


def numbers(given: ArrayLike, what: str) -> Floats:
    """Return what a user gave as a new array, of any shape; an `InputError` says what must be numbers and are none."""
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers in rows of one length, not {bounded(repr(given), 60)}") from None
