"""The estimates of an identification, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.codec import Layout
from fmuid.data import Normal
from fmuid.errors import InputError
from fmuid.estimation.covariance import ActiveBound, check_level
from fmuid.formatting import has_unit, with_std

# Magnitude of a correlation above which two intervals must not be read one by one.
STRONG_CORRELATION = 0.95


class ParameterEstimate(float):
    """The estimate of one parameter, ``result["Rs"]``: a number with its uncertainty.

    Results of arithmetic are plain numbers.

    Attributes
    ----------
    name : str
    std : float
        Standard deviation; infinite if the parameter is not identifiable, NaN if unknown.
    interval : (float, float)
        95 % confidence interval.
    unit : str or None
        As the FMU declares it.
    start : float
        Initial guess.
    prior : Normal or None
    """

    name: str
    std: float
    interval: tuple[float, float]
    unit: str | None
    start: float
    prior: Normal | None

    @property
    def value(self) -> float:
        """The plain number."""
        return float(self)

    def __repr__(self) -> str:
        value = f"{self.value:.2g} ± ?" if self.std == math.inf else with_std(self.value, self.std)
        return f"{self.name} = {value}" + (f" {self.unit}" if has_unit(self.unit) else "")

    __str__ = float.__repr__  # JSON and CSV writers get a number


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of N parameters and their covariance.

    Attributes
    ----------
    names : tuple of str
    values, start : (N,) arrays
    lower, upper : (N,) arrays
        Bounds; infinite where there are none.
    prior_mean, prior_std : (N,) arrays
        NaN where there is no prior.
    covariance : (N, N) array
        Local covariance under the noise model of the residuals (docs/method/covariance.md). Infinite variances: not
        identifiable; all NaN: the search stalled.
    covariance_white_noise : (N, N) array
        The same under white noise (1.31).
    variance_dof : (N,) array
        Degrees of freedom of each variance; infinite if the variance is known.
    units : mapping of str to str
        Only of parameters that have one.
    at_bounds : tuple of ActiveBound
        Estimates that the data push against a bound.
    """

    names: tuple[str, ...]
    values: Floats
    start: Floats
    lower: Floats
    upper: Floats
    prior_mean: Floats
    prior_std: Floats
    covariance: Floats
    covariance_white_noise: Floats
    variance_dof: Floats
    units: Mapping[str, str] = field(default_factory=dict)
    at_bounds: tuple[ActiveBound, ...] = ()

    json_layout: ClassVar = Layout(
        rows={
            "parameters": {
                **{"value": "values", "std": "std", "std_white_noise": "std_white_noise"},
                **{"variance_dof": "variance_dof", "start": "start", "lower": "lower", "upper": "upper"},
                **{"prior_mean": "prior_mean", "prior_std": "prior_std", "prior_z_score": "prior_z_score"},
                "unit": "units",
            }
        },
        parts={"covariance": {"names": "names", "matrix": "covariance", "white_noise": "covariance_white_noise"}},
    )

    def __post_init__(self) -> None:
        count = len(self.names)
        if any(each.shape != (count, count) for each in (self.covariance, self.covariance_white_noise)):
            raise ValueError(f"a covariance is not of {count} parameters")
        if any((np.diag(each) < 0).any() for each in (self.covariance, self.covariance_white_noise)):
            raise ValueError("a variance is negative")

    def index(self, name: str) -> int:
        """Return the position of a parameter; `InputError` if it is unknown."""
        if name not in self.names:
            raise InputError(f"the result has no parameter {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def estimate(self, name: str) -> ParameterEstimate:
        """Return one estimate; `InputError` if the parameter is unknown."""
        i = self.index(name)
        lower, upper = self.intervals().to_numpy(np.float64)[i].tolist()
        found = ParameterEstimate(self.values[i])
        found.name, found.std, found.interval = name, float(self.std[i]), (lower, upper)
        found.unit, found.start = self.units.get(name), float(self.start[i])
        mean, std = float(self.prior_mean[i]), float(self.prior_std[i])
        found.prior = None if math.isnan(mean) else Normal(mean, std)
        return found

    @property
    def std(self) -> Floats:
        """Standard deviations (N,); infinite if not identifiable."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_white_noise(self) -> Floats:
        """Standard deviations (N,) under white noise."""
        return np.sqrt(np.diag(self.covariance_white_noise))

    @property
    def colored_noise_factor(self) -> Floats:
        """Factor (N,) of colored noise on each standard deviation; NaN if unknown."""
        white = self.std_white_noise
        known = np.isfinite(self.std) & np.isfinite(white) & (white > 0)
        return np.asarray(np.divide(self.std, white, out=np.full(len(self.names), np.nan), where=known))

    @property
    def prior_z_score(self) -> Floats:
        """Distance (N,) from the prior mean in prior standard deviations; NaN without prior."""
        return (self.values - self.prior_mean) / self.prior_std

    def quantiles(self, level: float) -> Floats:
        """Return half the width (N,) of intervals, σ (Student's t)."""
        return self._student(np.full(len(self.names), 0.5 + level / 2.0))

    def reaches(self, level: float) -> Floats:
        """Return the same as `quantiles`, one-sided for estimates at a bound."""
        held = [bound.name for bound in self.at_bounds]
        tail = np.where([name in held for name in self.names], max(level, 0.5), 0.5 + level / 2.0)
        return self._student(tail)

    def _student(self, tail: Floats) -> Floats:
        exact = np.isinf(self.variance_dof)
        student = special.stdtrit(np.where(exact, 1.0, self.variance_dof), tail)
        return np.asarray(np.where(exact, special.ndtri(tail), student), dtype=np.float64)

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return confidence intervals, columns ``lower`` and ``upper``; see `Result.intervals`."""
        check_level(level)
        half = self.reaches(level) * self.std
        lower, upper = np.maximum(self.values - half, self.lower), np.minimum(self.values + half, self.upper)
        return pd.DataFrame({"lower": lower, "upper": upper}, index=list(self.names))

    def test_scale(self, names: Sequence[str]) -> float:
        """Return the factor of colored noise on a likelihood-ratio statistic.

        The largest eigenvalue of [H⁻¹]⁻¹V; 1 for white noise. It bounds the weighted sum of χ² variables (Kent, 1982).
        """
        white_std = self.std_white_noise
        known = np.isfinite(self.std) & np.isfinite(white_std)
        at = [i for i in map(self.index, names) if known[i]]
        if not at:
            return 1.0
        white, colored = (each[np.ix_(at, at)] for each in (self.covariance_white_noise, self.covariance))
        unit = np.outer(white_std[at], white_std[at])
        ratio = np.linalg.lstsq(white / unit, colored / unit, rcond=None)[0]
        return float(np.max(np.linalg.eigvals(ratio).real))

    def test_dof(self, names: Sequence[str]) -> float:
        """Return the degrees of freedom of a test of parameters: their harmonic mean."""
        inverse = float(np.mean(1.0 / self.variance_dof[[self.index(name) for name in names]]))
        return 1.0 / inverse if inverse > 0.0 else math.inf

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlation matrix (N, N); NaN for parameters that are not identifiable."""
        std = np.where(np.isfinite(self.std) & (self.std > 0), self.std, np.nan)
        return pd.DataFrame(self.covariance / np.outer(std, std), index=list(self.names), columns=list(self.names))

    @property
    def strong_correlations(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters with |correlation| above 0.95, strongest first."""
        matrix = self.correlation.to_numpy()
        every = combinations(range(len(self.names)), 2)
        pairs = [(self.names[i], self.names[j], float(matrix[i, j])) for i, j in every]
        return tuple(sorted((p for p in pairs if abs(p[2]) > STRONG_CORRELATION), key=lambda pair: -abs(pair[2])))
