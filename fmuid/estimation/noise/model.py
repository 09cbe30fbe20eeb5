"""The noise of one output in one experiment: one model for covariance, tests, posterior, whitening and monitoring.

The process is an autoregression, with weak slow noise beneath or without (`fmuid.estimation.noise.autoregression`). All
that is asked of the noise follows from it: its autocorrelation ρ, by how much a mean or a variance of its samples
scatters more than that of white noise, and the matrix that makes it white.

Of noise with autocorrelation ρ the best linear prediction of a sample from the last few before it, wherever they stand,
has the coefficients c = R⁻¹ r and leaves the share 1 − rᵀc of the variance, R and r the ρ between these samples and of
them with the one predicted. For an autoregression of order p on a record without gaps that is exact from the first
sample on with the last p of them, for one of order 1 with any gaps. With longer memories, or gaps, what is left is
nearly white (Vecchia's approximation).

References
----------
M. S. Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", Supplement to
the J. of the Royal Statistical Society 8 (1), 1946 (variances of correlations and of a variance);
Z. A. Lomnicki, "Tests for departure from normality in the case of linear stochastic processes", Metrika 4, 1961;
A. V. Vecchia, "Estimation and model identification for continuous spatial processes", J. R. Stat. Soc. B 50, 1988.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from fmuid.array_types import Floats, Indices
from fmuid.estimation.noise.autoregression import Autoregression, autoregression
from fmuid.estimation.noise.output_series import OutputSeries

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class WhiteningSettings:
    """Numbers of the matrix that makes noise white."""

    slow_depth: int = 100
    """With slow noise beneath, so many more samples predict one."""
    least_share: float = 1e-9
    """The least share of the variance that is left: close poles make R singular."""


SETTINGS = WhiteningSettings()


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The noise of one output in one experiment.

    Attributes
    ----------
    series : OutputSeries
        Where its samples stand.
    process : Autoregression
        In units of the residual that it was fitted to; experiments that share a pool share it.
    """

    series: OutputSeries
    process: Autoregression

    @classmethod
    def of(cls, series: OutputSeries, values: Floats) -> NoiseModel:
        """Return the noise of samples (n,) about their mean, of which no fit has taken anything."""
        grid = series.on_grid(values - values.mean())
        return cls(series, autoregression(grid, np.isfinite(grid)))

    @property
    def correlation(self) -> Floats:
        """The autocorrelation ρ (m,), from lag 0 to where it has decayed."""
        return self.process.correlation

    def whiten(self, columns: Floats) -> Floats:
        """Return the innovations of samples (n,) or columns of them (n, m), in units of the noise's std."""
        return np.asarray(innovations_matrix(self.process, self.series.places) @ columns / self.process.std)

    @property
    def time_constant(self) -> float:
        """In how many seconds the slowest part that does not oscillate falls to 1/e."""
        return self.series.step * self.process.time_constant

    def variance_factor(self, power: int = 1) -> float:
        """Return Σ (1 − |k|/n) ρ(k)^power over all lags of both signs, of n samples; not less than 1/n.

        Power 1: by so much the variance of a mean is larger than that of white noise, the integrated correlation time
        in samples. Power 2: likewise of a variance (Bartlett); powers 3 and 4: of skewness and kurtosis (Lomnicki).
        """
        count = self.series.rows.size
        rest = self.correlation[1:count]
        weights = 1.0 - np.arange(1, rest.size + 1) / count
        return max(1.0 + 2.0 * float(weights @ rest**power), 1.0 / count)


def common_process(parts: Sequence[tuple[OutputSeries, Floats]], variance: float | None = None) -> Autoregression:
    """Return the process that several residuals of one output have in common, none of them fitted.

    Parameters
    ----------
    parts : sequence of (OutputSeries, (n,) array)
    variance : float, optional
        Of the noise, where it is given: the process keeps the residuals' correlation.
    """
    # a gap between records
    whole = np.concatenate([np.append(series.on_grid(values), np.nan) for series, values in parts])
    found = autoregression(whole, np.isfinite(whole))
    return found if variance is None else found.of_variance(variance)


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


@lru_cache(maxsize=16)  # the same records are made white at many points
def _matrix(model: Autoregression, key: bytes) -> csr_array:
    from scipy.sparse import csr_array, eye_array  # slow to import

    places = np.frombuffer(key, dtype=np.intp)
    count, steps = places.size, np.diff(places)
    depth = model.coefficients.size * (1 if (steps == 1).all() else 2) + (SETTINGS.slow_depth if model.pole else 0)
    if not depth:
        return csr_array(eye_array(count))
    predict = _Prediction(model)
    values, columns = np.zeros((count, depth + 1)), np.arange(count)[:, None] - np.arange(depth + 1)
    for t, row in enumerate(predict.first(places[:depth])):
        values[t, : t + 1] = row[t::-1]
    # rows whose samples before have no gap among them are all alike
    gaps = np.where(steps == 1, 0, np.arange(1, count))
    since = np.arange(count) - np.maximum.accumulate(np.concatenate([[0], gaps]))
    values[since >= depth] = predict(np.ones(depth, dtype=np.intp))
    for t in (depth + np.flatnonzero(since[depth:] < depth)).tolist():
        values[t] = predict(steps[t - depth : t][::-1])
    there = columns >= 0
    first = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return csr_array((values[there], columns[there], first), shape=(count, count))


class _Prediction:
    """Rows of the matrix by the steps between a sample and those before it."""

    def __init__(self, model: Autoregression) -> None:
        self._correlation = np.append(model.correlation, 0.0)
        self._correlation[0] += SETTINGS.least_share
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
