"""Whitened records: their information on all coordinates, its prior, and the score of changes.

A record linearized at coordinates x is r = J x + e. With whitened noise it has the information G = JᵀJ and the score
g = Jᵀr. Healthy records give the mean m and covariance C of x. Information and score of changes are F = (I + G C)⁻¹ G
and h = (I + G C)⁻¹ (g − G m) (docs/method/diagnosis.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy import special

from fmuid.array_types import Floats, Indices
from fmuid.data import Experiment
from fmuid.estimation import OutputNoise, output_series

# Of what a coordinate shows by itself, this share is left where nothing tells it from the others: differences leave
# about their own error squared.
LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of records by the baseline's noise; a noise model of the new record would whiten the fault away."""

    models: Mapping[str, OutputNoise]  # by output

    @classmethod
    def white(cls, variances: Mapping[str, float]) -> Whitening:
        """Return the whitening of white noise with known variances."""
        return cls({name: OutputNoise.white(variance) for name, variance in variances.items()})

    def louder(self, factors: Mapping[str, float]) -> Whitening:
        """Return the whitening of noise with variances larger by factors, by output."""
        stds = {name: self.std(name) for name in self.models}
        return Whitening(
            {name: each.of_variance(factors[name] * stds[name] ** 2) for name, each in self.models.items()}
        )

    def std(self, output: str) -> float:
        """Return the standard deviation of an output's noise."""
        return self.models[output].process.std

    @property
    def limit(self) -> float:
        """Smallest limit of innovations, in standard deviations."""
        return min((each.limit for each in self.models.values()), default=math.inf)

    @property
    def share(self) -> float:
        """Independent innovations per sample for a variance."""
        return sum(each.share for each in self.models.values()) / len(self.models)

    def independent_share(self, output: str) -> float:
        """Return the independent samples per sample for an output's variance, 1/Σρ² (Bartlett)."""
        power = np.abs(self.models[output].process.transfer(4096)) ** 2
        return float(np.mean(power) ** 2 / np.mean(power**2)) * self.models[output].share

    def __call__(self, experiment: Experiment, columns: Floats) -> Floats:
        """Return innovations (n, 1 + m) of residual and columns, in σ."""
        return np.vstack([white for _, _, white in self.of_outputs(experiment, columns)])

    def of_outputs(
        self, experiment: Experiment, columns: Floats, begins: Floats | None = None
    ) -> Iterator[tuple[str, Indices, Floats]]:
        """Yield them by output, with its name and rows; lines are fitted anew from each of `begins`, s."""
        for series in output_series([experiment], experiment.output_names):
            j = experiment.output_names.index(series.output)
            rows = np.flatnonzero(experiment.counted[:, j])
            own = [] if begins is None else np.searchsorted(experiment.times[rows], begins).tolist()
            borders = sorted({0, *own, rows.size}) if own else []
            yield series.output, rows, self.models[series.output].whiten(series, columns[rows, j], borders)


@dataclass(frozen=True, eq=False)
class InformationMatrix:
    """Information of a record on the coordinates, linearized at zero."""

    matrix: Floats  # (N, N), G = JᵀJ of the whitened Jacobian
    score: Floats  # (N,), g = Jᵀr of the whitened residual at zero
    squares: float = math.nan  # rᵀr

    @classmethod
    def of(cls, jacobian: Floats, residual: Floats) -> InformationMatrix:
        """Return the information of a whitened Jacobian (n, N) and residual (n,)."""
        return cls(jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual))

    def __add__(self, other: InformationMatrix) -> InformationMatrix:
        """Return the information of both records."""
        return InformationMatrix(self.matrix + other.matrix, self.score + other.score, self.squares + other.squares)

    def among(self, at: Sequence[int]) -> InformationMatrix:
        """Return the information on some coordinates; the others are zero."""
        return InformationMatrix(self.matrix[np.ix_(at, at)], self.score[list(at)], self.squares)

    def along(self, basis: Floats) -> InformationMatrix:
        """Return the information on directions (N, n)."""
        return InformationMatrix(basis.T @ self.matrix @ basis, basis.T @ self.score, self.squares)

    def squares_at(self, point: Floats) -> float:
        """Return the sum of squares of the residual at a point (N,)."""
        return max(0.0, float(self.squares - 2.0 * point @ self.score + point @ self.matrix @ point))

    def distance(self, off: Floats) -> float:
        """Return the effect of a move (N,), in standard deviations."""
        return math.sqrt(max(0.0, float(off @ self.matrix @ off)))

    def curvature(self, off: Floats, magnitude: Floats) -> float:
        """Return the linear model's error after a move (N,), in standard deviations."""
        return float(np.max(np.abs(off) / magnitude)) * self.distance(off)


@dataclass(frozen=True, eq=False)
class ChangePrior:
    """Distribution of the coordinates before a record."""

    mean: Floats  # (N,)
    covariance: Floats  # (N, N)

    @classmethod
    def after(cls, record: InformationMatrix, normal: Floats) -> ChangePrior:
        """Return the distribution after a healthy record: m = C g, C = (G + B⁻²)⁻¹; B is `normal` (N,)."""
        # scaled by what is normal, so that neither units nor wide ranges spoil the solution
        scaled = record.matrix * np.outer(normal, normal) + np.eye(normal.size)
        inverse = scipy.linalg.inv(scaled, check_finite=False)
        covariance = (inverse + inverse.T) / 2.0 * np.outer(normal, normal)
        return cls(covariance @ record.score, covariance)

    def after_also(self, record: InformationMatrix) -> ChangePrior:
        """Return the distribution after one more record; certain coordinates stay so."""
        left = np.linalg.inv(np.eye(self.mean.size) + record.matrix @ self.covariance)
        covariance = self.covariance @ left
        covariance = 0.5 * (covariance + covariance.T)
        return ChangePrior(self.mean + covariance @ (record.score - record.matrix @ self.mean), covariance)

    def drifting(self, std: Floats) -> ChangePrior:
        """Return the distribution after drift with a standard deviation (N,)."""
        return self.scattering(np.diag(std**2))

    def scattering(self, covariance: Floats) -> ChangePrior:
        """Return the distribution with one more independent change."""
        return ChangePrior(self.mean, self.covariance + covariance)


@dataclass(frozen=True, eq=False)
class ScoreStatistics:
    """Information and score of changes in a record."""

    information: Floats  # (N, N), F
    score: Floats  # (N,), h; its covariance is F without changes
    excess: Floats | None = None  # (N, N), part of the prior's covariance that is known from few records ...
    freedom: float = math.inf  # ... with these degrees of freedom
    squares: float = math.nan  # χ² of the record without changes

    @classmethod
    def of(cls, record: InformationMatrix, known: ChangePrior) -> ScoreStatistics:
        """Return F and h of a record with G and g."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(record.matrix), np.finfo(float).tiny))
        matrix = record.matrix * np.outer(scale, scale)
        left = np.eye(scale.size) + matrix @ (known.covariance / np.outer(scale, scale))
        right = np.column_stack([matrix, scale * (record.score - record.matrix @ known.mean)])
        found = np.linalg.solve(left, right)
        information = (found[:, :-1] + found[:, :-1].T) / 2.0 / np.outer(scale, scale)
        score, mean, own = found[:, -1] / scale, known.mean, record.score - record.matrix @ known.mean
        squares = record.squares - float(mean @ (record.score + own) + own @ known.covariance @ score)
        return cls(information, score, squares=squares)

    def tempered(self, factor: float) -> ScoreStatistics:
        """Return the statistics for variances larger by a factor: the models' error."""
        information, score, squares = self.information / factor, self.score / factor, self.squares / factor
        return replace(self, information=information, score=score, squares=squares)

    def tail(self, statistic: float, columns: Sequence[int]) -> float:
        """Return the probability of a larger statistic of some coordinates by chance: χ², or F."""
        count, freedom = len(columns), self.freedom_of(columns)
        if freedom > 1e7:
            return float(special.chdtrc(count, statistic))
        return float(special.fdtrc(count, freedom, statistic / count))

    def freedom_of(self, columns: Sequence[int]) -> float:
        """Return the degrees of freedom of the variance of some coordinates (Satterthwaite)."""
        if self.excess is None:
            return math.inf
        along, (own, _) = self.information[:, list(columns)], self.part(columns)
        share = float(np.trace(np.linalg.solve(own, along.T @ self.excess @ along))) / len(columns)
        return self.freedom / max(share, 1e-3) ** 2

    def part(self, columns: Sequence[int]) -> tuple[Floats, Floats]:
        """Return information and score of some coordinates, the others unchanged."""
        at = list(columns)
        return self.information[at][:, at], self.score[at]


def square_root(covariance: Floats) -> Floats:
    """Return a root L (N, r) of a covariance LLᵀ (N, N)."""
    std = np.sqrt(np.diag(covariance))
    there = np.flatnonzero(std)
    values, vectors = np.linalg.eigh(covariance[np.ix_(there, there)] / np.outer(std[there], std[there]))
    root = np.zeros((std.size, there.size))
    root[there] = std[there, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def is_determined(news: ScoreStatistics, said: InformationMatrix, columns: Sequence[int]) -> bool:
    """Return whether a record determines some coordinates by more than rounding."""
    information, _ = news.part(columns)
    least = LEAST * float(np.diag(said.matrix)[list(columns)].max())
    return float(np.linalg.eigvalsh(information)[0]) > least
