"""NoiseModel: the one model of a residual, for covariance, tests, posterior and monitoring.

Whitening: the best linear prediction from the last samples has c = R⁻¹ r and leaves the share 1 − rᵀc of the variance,
R and r autocorrelations. This is exact without gaps, else nearly so (Vecchia, J. R. Stat. Soc. B 50, 1988).
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
    """Numbers of the whitening matrix."""

    slow_depth: int = 100  # additional samples of a prediction with low-frequency noise
    least_share: float = 1e-9  # of the variance left: close poles make R singular


SETTINGS = WhiteningSettings()


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of one output in one experiment.

    Attributes
    ----------
    series : OutputSeries
        Positions of its samples.
    process : Autoregression
        In units of the residual; shared within a pool.
    """

    series: OutputSeries
    process: Autoregression

    @classmethod
    def of(cls, series: OutputSeries, values: Floats) -> NoiseModel:
        """Return the noise of unfitted samples (n,) about their mean."""
        if not series.ordered:
            return cls(series, common_process([(series, values - values.mean())]))
        grid = series.on_grid(values - values.mean())
        return cls(series, autoregression(grid, np.isfinite(grid)))

    @property
    def correlation(self) -> Floats:
        """Autocorrelation ρ (m,), from lag 0 until it has decayed."""
        return self.process.correlation

    def whiten(self, columns: Floats) -> Floats:
        """Return innovations of samples (n,) or (n, m), by the noise's std."""
        return np.asarray(innovations_matrix(self.process, self.series.places) @ columns / self.process.std)

    @property
    def time_constant(self) -> float:
        """Time constant of the slowest non-oscillating part, s."""
        return self.series.step * self.process.time_constant

    def variance_factor(self, power: int = 1) -> float:
        """Return Σ (1 − |k|/n) ρ(k)^power over all lags, at least 1/n.

        Power 1: variance of a mean against white noise; 2: of a variance (Bartlett); 3, 4: of skewness, kurtosis.
        """
        count = self.series.rows.size
        rest = self.correlation[1:count]
        weights = 1.0 - np.arange(1, rest.size + 1) / count
        return max(1.0 + 2.0 * float(weights @ rest**power), 1.0 / count)


def common_process(parts: Sequence[tuple[OutputSeries, Floats]], variance: float | None = None) -> Autoregression:
    """Return the common process of several unfitted residuals (n,) of one output; its variance may be given."""
    if all(series.ordered for series, _ in parts):
        # a gap between records
        whole = np.concatenate([np.append(series.on_grid(values), np.nan) for series, values in parts])
        found = autoregression(whole, np.isfinite(whole))
    else:
        own = np.concatenate([values for _, values in parts])
        found = Autoregression(np.zeros(0), max(float(np.mean(own**2)), np.finfo(float).tiny), own.size)
    return found if variance is None else found.of_variance(variance)


def innovations_matrix(model: Autoregression, places: Indices) -> csr_array:
    """Return the triangular whitening matrix L (n, n) at `places` (n,): L C Lᵀ ≈ I, C the correlation matrix."""
    return _matrix(model, places.astype(np.intp).tobytes())


@lru_cache(maxsize=16)  # the same records are made white at many points
def _matrix(model: Autoregression, key: bytes) -> csr_array:
    from scipy.sparse import csr_array, eye_array  # slow to import

    places = np.frombuffer(key, dtype=np.intp)
    count, steps = places.size, np.diff(places)
    depth = model.coefficients.size * (1 if (steps == 1).all() else 2) + (SETTINGS.slow_depth if model.pole else 0)
    if not depth:
        return csr_array(eye_array(count))
    correlation, known = np.append(model.correlation, 0.0), dict[bytes, Floats]()
    correlation[0] += SETTINGS.least_share

    def first(places: Indices) -> Floats:
        """Return rows (m, m) without earlier samples: the inverse Cholesky factor."""
        lags = np.minimum(np.abs(places[:, None] - places), correlation.size - 1)
        factor = np.linalg.cholesky(correlation[lags])
        return np.asarray(scipy.linalg.solve_triangular(factor, np.eye(places.size), lower=True))

    def predict(steps: Indices) -> Floats:
        """Return (1, −c) over the root of the share left; steps lead back."""
        key, before = steps.tobytes(), np.concatenate([[0], np.cumsum(steps)])
        if key not in known:
            known[key] = first(before[::-1])[-1][::-1]
        return known[key]

    values, columns = np.zeros((count, depth + 1)), np.arange(count)[:, None] - np.arange(depth + 1)
    for t, row in enumerate(first(places[:depth])):
        values[t, : t + 1] = row[t::-1]
    # rows after samples without gaps are equal
    gaps = np.where(steps == 1, 0, np.arange(1, count))
    since = np.arange(count) - np.maximum.accumulate(np.concatenate([[0], gaps]))
    values[since >= depth] = predict(np.ones(depth, dtype=np.intp))
    for t in (depth + np.flatnonzero(since[depth:] < depth)).tolist():
        values[t] = predict(steps[t - depth : t][::-1])
    there = columns >= 0
    starts = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return csr_array((values[there], columns[there], starts), shape=(count, count))
