"""The noise of measurements from the data alone, by second differences: an upper bound for what moves slowly."""

from __future__ import annotations

import numpy as np

from fmuid.array_types import Floats

# The median of |e| of a normal e of variance 1, inverted.
ROBUST = 1.4826
LEAST_SAMPLES = 5


def second_difference_noise(times: Floats, values: Floats) -> float:
    """Return the standard deviation of the noise of one output, NaN where there are too few samples.

    Each sample is compared with the straight line through its neighbours; the median of what is left is not moved by a
    few steps. What curves within three samples counts as noise: an upper bound.

    Parameters
    ----------
    times : (K,) array
        Never decreasing.
    values : (K,) array
        NaN where a sample is missing.
    """
    there = np.flatnonzero(~np.isnan(values))
    if there.size < LEAST_SAMPLES:
        return float("nan")
    t, y = times[there], values[there]
    whole = t[2:] - t[:-2]
    moved = whole > 0
    share = (t[1:-1] - t[:-2])[moved] / whole[moved]
    line = (1.0 - share) * y[:-2][moved] + share * y[2:][moved]
    error = (y[1:-1][moved] - line) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    return ROBUST * float(np.median(np.abs(error))) if error.size else float("nan")
