"""Array types, and simulated outputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmuid.errors import InputError
from fmuid.formatting import bounded

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Simulations:
    """Outputs simulated for several thetas."""

    outputs: Floats  # (m, K, n_outputs) in units of the data, NaN after a failure; the caller may change it
    errors: tuple[Exception | None, ...]  # of each simulation

    @classmethod
    def of(cls, many: Callable[[Floats], Simulations], theta: ArrayLike) -> Floats:
        """Return the outputs of one theta (N,), (K, n_outputs), or of several; raise the first error."""
        thetas = np.asarray(theta, dtype=np.float64)
        found = many(np.atleast_2d(thetas))
        return found.checked()[0] if thetas.ndim < 2 else found.checked()

    def checked(self) -> Floats:
        """Return the outputs; raise the first error."""
        for error in self.errors:
            if error is not None:
                raise error
        return self.outputs


def numbers(given: ArrayLike, what: str) -> Floats:
    """Return a user's numbers as a new array; raise `InputError` for others."""
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers in rows of one length, not {bounded(repr(given), 60)}") from None
