"""Innovations of coloured noise, gaps allowed: of each sample what those before it do not foretell.

Of noise with autocorrelation ρ the best linear prediction of a sample from the last few before it, wherever they stand,
has the coefficients c = R⁻¹ r and leaves the share 1 − rᵀc of the variance, R and r the ρ between these samples and of
them with the one foretold. For an autoregression of order p on a record without gaps that is exact from the first
sample on with the last p of them, for one of order 1 with any gaps. With longer memories, or gaps, what is left is
nearly white (Vecchia's approximation).

References
----------
A. V. Vecchia, "Estimation and model identification for continuous spatial processes", J. R. Stat. Soc. B 50, 1988.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from fmuid.array_types import Floats, Indices
from fmuid.estimation.noise.autoregression import Autoregression

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# With slow noise beneath, so many more samples foretell one.
SLOW_DEPTH = 100
# The least share of the variance that is left, at least.
LEAST = 1e-9
# Matrices that are kept: the same records are made white at many points.
KEPT = 16


def innovations_matrix(model: Autoregression, places: Indices) -> csr_array:
    """Return the matrix L (n, n) that makes noise white, of the variance that the noise itself has.

    Parameters
    ----------
    model : Autoregression
    places : (n,) array of int
        Where the samples stand on the grid of their step, increasing; one after the other where two share a place.

    Returns
    -------
    csr_array
        Lower triangular; L C Lᵀ is the unit matrix, nearly, C the noise's matrix of correlations.
    """
    return _matrix(model, places.astype(np.intp).tobytes())


@lru_cache(maxsize=KEPT)
def _matrix(model: Autoregression, key: bytes) -> csr_array:
    from scipy.sparse import csr_array, eye_array  # slow to import

    places = np.frombuffer(key, dtype=np.intp)
    count, steps = places.size, np.diff(places)
    depth = model.coefficients.size * (1 if (steps == 1).all() else 2) + (SLOW_DEPTH if model.pole else 0)
    if not depth:
        return csr_array(eye_array(count))
    foretell = _Foretelling(model)
    values, columns = np.zeros((count, depth + 1)), np.arange(count)[:, None] - np.arange(depth + 1)
    for t, row in enumerate(foretell.first(places[:depth])):
        values[t, : t + 1] = row[t::-1]
    # rows whose samples before have no gap among them are all alike
    gaps = np.where(steps == 1, 0, np.arange(1, count))
    since = np.arange(count) - np.maximum.accumulate(np.concatenate([[0], gaps]))
    values[since >= depth] = foretell(np.ones(depth, dtype=np.intp))
    for t in (depth + np.flatnonzero(since[depth:] < depth)).tolist():
        values[t] = foretell(steps[t - depth : t][::-1])
    there = columns >= 0
    first = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return csr_array((values[there], columns[there], first), shape=(count, count))


class _Foretelling:
    """Rows of the matrix by the steps between a sample and those before it."""

    def __init__(self, model: Autoregression) -> None:
        size = scipy.fft.next_fast_len(2 * model.memory + 1, real=True)
        power = scipy.fft.irfft(np.abs(model.transfer(size)) ** 2, size)[: model.memory + 1]
        self._correlation = np.append(power / power[0], 0.0)
        self._correlation[0] += LEAST
        self._rows: dict[bytes, Floats] = {}

    def __call__(self, steps: Indices) -> Floats:
        """Return (1, −c) over the root of what they leave; steps (m,) lead back from each sample to the one before."""
        key = steps.tobytes()
        if key not in self._rows:
            before = np.concatenate([[0], np.cumsum(steps)])
            self._rows[key] = self.first(before[::-1])[-1][::-1]
        return self._rows[key]

    def first(self, places: Indices) -> Floats:
        """Return the rows of samples (m, m) that have no others before them: the inverse of Cholesky's factor."""
        lags = np.minimum(np.abs(places[:, None] - places), self._correlation.size - 1)
        factor = np.linalg.cholesky(self._correlation[lags])
        return np.asarray(scipy.linalg.solve_triangular(factor, np.eye(places.size), lower=True))
