"""What records say of all coordinates, what is known before a new one, and what is new in it.

A record is linearised at a point of all its coordinates x, the healthy parameters and the sizes of all causes (faults,
errors of sensors, the supply): r = J x + e. With the noise whitened, all that it says is its information G = JᵀJ and
its score g = Jᵀr. What the healthy records have said is the mean m and the covariance C of x before anything is new;
then F = (I + G C)⁻¹ G and h = (I + G C)⁻¹ (g − G m) are information and score of what *is* new, with the noise, the
errors of the baseline, their correlations and the drift in its covariance: generalised least squares. Everything else
follows from F and h.

References
----------
S. M. Kay, "Fundamentals of Statistical Signal Processing, volume II: Detection Theory", 1998, chapter 6; M. Basseville,
I. V. Nikiforov, "Detection of Abrupt Changes", 1993.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.errors import InputError

# Model error is told from noise by the scatter of records from this many on: the variance of a t distribution of K − 1
# degrees of freedom, (K − 1)/(K − 3), is finite from there.
LEAST_RECORDS = 4
# Of what a coordinate shows by itself, this share is left where nothing tells it from the others: differences leave
# about their own error squared.
LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class InformationMatrix:
    """What a record says of the coordinates, linearised at zero.

    Attributes
    ----------
    matrix : (N, N) array
        G = JᵀJ of the whitened Jacobian.
    score : (N,) array
        g = Jᵀr of the whitened residual at zero.
    """

    matrix: Floats
    score: Floats

    @classmethod
    def of(cls, jacobian: Floats, residual: Floats) -> InformationMatrix:
        """Return that of a whitened Jacobian (n, N) and residual (n,)."""
        return cls(jacobian.T @ jacobian, jacobian.T @ residual)

    def __add__(self, other: InformationMatrix) -> InformationMatrix:
        """Return that of both records."""
        return InformationMatrix(self.matrix + other.matrix, self.score + other.score)


@dataclass(frozen=True, eq=False)
class ChangePrior:
    """What is known of the coordinates before a record.

    Attributes
    ----------
    mean : (N,) array
    covariance : (N, N) array
    """

    mean: Floats
    covariance: Floats

    @classmethod
    def after(cls, record: InformationMatrix, normal: Floats) -> ChangePrior:
        """Return what a healthy record leaves: m = C g, C = (G + B⁻²)⁻¹.

        Parameters
        ----------
        record : InformationMatrix
            Of all coordinates, those of the causes too: an asymmetry of a sound machine that is left out would come
            back as a fault of the next record.
        normal : (N,) array
            B, the standard deviation of what a sound machine may have of each coordinate, all positive: without it C is
            singular along directions that the record does not tell apart.
        """
        if not (np.all(np.isfinite(normal)) and np.all(normal > 0)):
            raise InputError("what is normal must be positive and finite for every coordinate of a diagnosis")
        # scaled by what is normal, so that neither units nor wide ranges spoil the solution
        scaled = record.matrix * np.outer(normal, normal) + np.eye(normal.size)
        inverse = scipy.linalg.inv(scaled, check_finite=False)
        covariance = (inverse + inverse.T) / 2.0 * np.outer(normal, normal)
        return cls(covariance @ record.score, covariance)

    @classmethod
    def after_several(cls, records: Sequence[InformationMatrix], normal: Floats) -> ChangePrior:
        """Return what healthy records at different operating points leave, the error of the healthy model included.

        What their estimates scatter beyond their noise is the model's error: the positive part of cov(m_i) − mean C_i
        in the metric of the mean C, full. It counts once more for the new record, and by (K − 1)/(K − 3) for having
        been estimated from K records. Fewer than four are pooled, and say nothing of it.
        """
        if len(records) < LEAST_RECORDS:
            pooled = records[0]
            for record in records[1:]:
                pooled = pooled + record
            return cls.after(pooled, normal)
        each = [cls.after(record, normal) for record in records]
        means = np.array([known.mean for known in each])
        inside = np.mean([known.covariance for known in each], axis=0)
        excess = _excess(np.cov(means.T), inside)
        k = len(records)
        shown = inside / k + excess * (1.0 + 1.0 / k) * (k - 1.0) / (k - 3.0)
        return cls(means.mean(axis=0), shown)

    def after_also(self, record: InformationMatrix) -> ChangePrior:
        """Return what is known after a record of the same coordinates; what is known for sure may stay so."""
        left = np.linalg.inv(np.eye(self.mean.size) + record.matrix @ self.covariance)
        covariance = self.covariance @ left
        covariance = 0.5 * (covariance + covariance.T)
        return ChangePrior(self.mean + covariance @ (record.score - record.matrix @ self.mean), covariance)

    def drifting(self, std: Floats) -> ChangePrior:
        """Return what is known where each coordinate may have drifted by a standard deviation (N,) and be sound."""
        return ChangePrior(self.mean, self.covariance + np.diag(std**2))


def _excess(scatter: Floats, inside: Floats) -> Floats:
    """Return the positive part of scatter − inside in the metric of the latter: directions that scatter more."""
    std = np.sqrt(np.diag(inside))
    scale = np.outer(std, std)
    values, vectors = scipy.linalg.eigh(scatter / scale, inside / scale)
    root = (inside / scale) @ vectors  # the inverse transpose of the vectors, which are orthonormal in that metric
    return np.asarray((root * np.maximum(values - 1.0, 0.0)) @ root.T * scale)


@dataclass(frozen=True, eq=False)
class ScoreStatistics:
    """What is new in a record, beside everything that was known.

    Attributes
    ----------
    information : (N, N) array
        F.
    score : (N,) array
        h; its covariance is F where nothing is new.
    """

    information: Floats
    score: Floats

    @classmethod
    def of(cls, record: InformationMatrix, known: ChangePrior) -> ScoreStatistics:
        """Return F = (I + G C)⁻¹ G and h = (I + G C)⁻¹ (g − G m)."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(record.matrix), np.finfo(float).tiny))
        matrix = record.matrix * np.outer(scale, scale)
        left = np.eye(scale.size) + matrix @ (known.covariance / np.outer(scale, scale))
        right = np.column_stack([matrix, scale * (record.score - record.matrix @ known.mean)])
        found = np.linalg.solve(left, right)
        information = (found[:, :-1] + found[:, :-1].T) / 2.0 / np.outer(scale, scale)
        return cls(information, found[:, -1] / scale)

    def tempered(self, factor: float) -> ScoreStatistics:
        """Return what is left of it where all variances are larger by a factor: the models' own error."""
        return ScoreStatistics(self.information / factor, self.score / factor)

    def part(self, columns: Sequence[int]) -> tuple[Floats, Floats]:
        """Return information and score of some coordinates, the others being as they were known."""
        at = list(columns)
        return self.information[at][:, at], self.score[at]


def is_determined(news: ScoreStatistics, said: InformationMatrix, columns: Sequence[int]) -> bool:
    """Return whether a record says more of some coordinates, beside all that may change, than rounding leaves."""
    information, _ = news.part(columns)
    least = LEAST * float(np.diag(said.matrix)[list(columns)].max())
    return float(np.linalg.eigvalsh(information)[0]) > least
