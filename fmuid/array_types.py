"""Array types."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmuid.errors import InputError
from fmuid.formatting import bounded

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


def numbers(given: ArrayLike, what: str) -> Floats:
    """Return a user's numbers as a new array; raise `InputError` for others."""
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers in rows of one length, not {bounded(repr(given), 60)}") from None
