"""Scrambled Sobol sequences: the points of `scipy.stats.qmc.Sobol` bit for bit, without the import of scipy.stats.

Direction numbers of Joe and Kuo; scrambled by a random linear map and a digital shift (Matoušek). Importing
scipy.stats takes longer than many an identification. Sequences of more dimensions than the table has come from it.

References
----------
S. Joe, F. Y. Kuo, "Constructing Sobol sequences with better two-dimensional projections", SIAM Journal on Scientific
Computing 30 (5), 2008;
J. Matoušek, "On the L2-discrepancy for anchored boxes", Journal of Complexity 14, 1998.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats

BITS = 30
"""Of each coordinate."""
# The bits of a primitive polynomial, and the initial direction numbers, of each dimension from the second one on.
_TABLE = """
    3 1; 7 1 3; 11 1 3 1; 13 1 1 1; 19 1 1 3 3; 25 1 3 5 13; 37 1 1 5 5 17; 41 1 1 5 5 5; 47 1 1 7 11 19;
    55 1 1 5 1 1; 59 1 1 1 3 11; 61 1 3 5 5 31; 67 1 3 3 9 7 49; 91 1 1 1 15 21 21; 97 1 3 1 13 27 49;
    103 1 1 1 15 7 5; 109 1 3 1 15 13 25; 115 1 1 5 5 19 61; 131 1 3 7 11 23 15 103; 137 1 3 7 13 13 15 69;
    143 1 1 3 13 7 35 63; 145 1 3 5 9 1 25 53; 157 1 3 1 13 9 35 107; 167 1 3 1 5 27 61 31; 171 1 1 5 11 19 41 61;
    185 1 3 5 3 3 13 69; 191 1 1 7 13 1 19 1; 193 1 3 7 5 13 19 59; 203 1 1 3 9 25 29 41; 211 1 3 5 13 23 1 55;
    213 1 3 7 3 13 59 17; 229 1 3 1 3 5 53 69; 239 1 1 5 5 23 33 13; 241 1 1 7 7 1 61 123; 247 1 1 7 9 13 61 49;
    253 1 3 3 5 3 55 33; 285 1 3 1 15 31 13 49 245; 299 1 3 5 15 31 59 63 97; 301 1 3 1 11 11 11 77 249
"""
_ROWS = [[int(number) for number in row.split()] for row in _TABLE.split(";")]
# scipy.stats.qmc has more.
MAX_DIMENSIONS = 1 + len(_ROWS)


def sobol_points(dimensions: int, count: int, seed: int | np.random.Generator) -> Floats:
    """Return the first points of a scrambled Sobol sequence.

    Parameters
    ----------
    dimensions, count : int
    seed : int or numpy.random.Generator
        Of the scrambling.

    Returns
    -------
    (count, dimensions) array
        Points of the unit cube.
    """
    if dimensions > MAX_DIMENSIONS:
        from scipy.stats import qmc  # slow to import

        whole = qmc.Sobol(dimensions, seed=seed).random_base2((count - 1).bit_length())
        return np.asarray(whole[:count], dtype=np.float64)
    rng = seed.spawn(1)[0] if isinstance(seed, np.random.Generator) else np.random.default_rng(seed)
    shift, directions = _scrambled(_directions(dimensions), rng)
    # in the order of Gray's code a point differs from the one before by one direction: that of the lowest bit that is 0
    counts = np.arange(count - 1)
    lowest = np.round(np.log2((counts + 1) & ~counts)).astype(np.intp)
    changes = np.vstack([shift, directions[:, lowest].T])
    return np.bitwise_xor.accumulate(changes, axis=0) * 2.0**-BITS


def _directions(dimensions: int) -> NDArray[np.uint32]:
    """Return the direction numbers (dimensions, BITS), scaled to integers of `BITS` bits."""
    found = np.ones((dimensions, BITS), dtype=np.uint32)
    for own, (polynomial, *initial) in zip(found[1:], _ROWS, strict=False):
        degree = len(initial)
        own[:degree] = initial
        for j in range(degree, BITS):
            value = own[j - degree]
            for k in range(1, degree + 1):
                if polynomial >> (degree - k) & 1:
                    value = value ^ own[j - k] << np.uint32(k)
            own[j] = value
    return found << np.arange(BITS, dtype=np.uint32)[::-1]


def _scrambled(
    directions: NDArray[np.uint32], rng: np.random.Generator
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return a random shift (dimensions,), and the directions after a random map of their bits."""
    dimensions, powers = len(directions), np.uint32(2) ** np.arange(BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ powers
    lower = np.tril(rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32))
    lower[:, np.arange(BITS), np.arange(BITS)] = 1
    bits = directions[:, :, None] >> np.arange(BITS, dtype=np.uint32)[::-1] & 1  # the highest first
    return shift, (bits @ lower.transpose(0, 2, 1) & 1) @ powers[::-1]
