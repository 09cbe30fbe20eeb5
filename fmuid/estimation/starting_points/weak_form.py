"""The weak form of ẋ = f(x, u, θ): what integrals over windows say of the parameters without differentiating data.

With a weight w that vanishes at both ends of a window, ∫ w f dt + ∫ w′ x dt = 0 by parts. Here w = 4 z (1 − z) with z
from 0 to 1 along the window, and the integrals are trapezoids: measured states and f at both ends of each interval
enter them linearly, so that noise is averaged and no derivative of the data is needed, at any sampling times.

References
----------
M. Shinbrot, "On the analysis of linear and nonlinear dynamical systems from transient-response data", NACA TN 3288,
1954 (modulating functions).
"""

from __future__ import annotations

import numpy as np
import scipy

from fmuid.array_types import Flags, Floats
from fmuid.errors import InputError

WINDOW = 10
"""Intervals of a window; each begins in the middle of the one before."""
# Samples of each state that a window must have: what is interpolated over a hole says nothing.
LEAST_SAMPLES = 3


class WeakForm:
    """The windows of one record.

    Parameters
    ----------
    times : (K,) array
        Never decreasing, s.
    there : (K, n_x) array of bool
        Where each state was measured.

    Attributes
    ----------
    shape : tuple of int
        Windows and states.

    Raises
    ------
    InputError
        If the record has no window with enough samples.
    """

    def __init__(self, times: Floats, there: Flags) -> None:
        last = len(times) - 1
        firsts = np.arange(0, max(last - WINDOW, 0) + 1, WINDOW // 2)
        lasts = np.minimum(firsts + WINDOW, last)
        counts = np.pad(there.cumsum(axis=0), ((1, 0), (0, 0)))  # samples before each time
        known = (counts[lasts + 1] - counts[firsts] >= LEAST_SAMPLES).all(axis=1) & (times[lasts] > times[firsts])
        firsts = firsts[known] if last >= WINDOW else firsts[:0]
        if not firsts.size:
            raise InputError("the record has no window with enough samples")
        self.shape = firsts.size, there.shape[1]
        inside = firsts[:, None] + np.arange(WINDOW + 1)
        z = (times[inside] - times[firsts][:, None]) / (times[firsts + WINDOW] - times[firsts])[:, None]
        weight = 4.0 * z * (1.0 - z)
        half = 0.5 * np.diff(times[inside], axis=1)
        rows = np.repeat(np.arange(firsts.size), WINDOW)
        left, right = inside[:, :-1].ravel(), inside[:, 1:].ravel()
        slope = 0.5 * np.diff(weight, axis=1).ravel()
        of_samples, of_intervals = (firsts.size, last + 1), (firsts.size, last)
        self._states = scipy.sparse.csr_array((slope, (rows, left)), of_samples)
        self._states = self._states + scipy.sparse.csr_array((slope, (rows, right)), of_samples)
        self._begins = scipy.sparse.csr_array(((half * weight[:, :-1]).ravel(), (rows, left)), of_intervals)
        self._ends = scipy.sparse.csr_array(((half * weight[:, 1:]).ravel(), (rows, left)), of_intervals)
        self.noise = np.sqrt(np.asarray((self._states**2).sum(axis=1))).reshape(-1, 1)
        """Standard deviation of each window's residual for white noise of variance 1 on the states (windows, 1)."""

    def residual(self, states: Floats, begins: Floats, ends: Floats) -> Floats:
        """Return ∫ w′ x + ∫ w f of each window and state (windows, n_x).

        Parameters
        ----------
        states : (K, n_x) array
            Holes filled.
        begins, ends : (K − 1, n_x) arrays
            f at the beginning and the end of each interval, under that interval's inputs.
        """
        return np.asarray(self._states @ states + self._begins @ begins + self._ends @ ends, dtype=np.float64)
