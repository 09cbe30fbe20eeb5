"""Proposals from a chain's own past.

A mixture of Student's t around earlier samples, each with the covariance of its nearest neighbors, follows bent and
multimodal posteriors (Givens and Raftery, J. Am. Stat. Assoc. 91, 1996). It is renewed ever more seldom: the chain
forgets it (Roberts and Rosenthal, J. Appl. Prob. 44, 2007).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.special import logsumexp

from fmuid.array_types import Floats


@dataclass(frozen=True)
class ArchiveSettings:
    """Numbers of the proposals."""

    poor_acceptance: float = 0.3  # share of accepted moves below which the past proposes better, ...
    share: float = 0.7  # ... in so many of the moves
    points: int = 500  # samples of the past that are kept, ...
    neighbors: int = 20  # ... and neighbors of each, for the covariance there
    freedom: float = 5.0  # degrees of freedom of the kernels: tails heavier than the posterior's
    least_share: float = 1e-6  # of the whole variance, added to that of neighbors in a plane


ARCHIVE_SETTINGS = ArchiveSettings()


def student(random: np.random.RandomState, shape: tuple[int, ...], freedom: float) -> Floats:
    """Draw rows of a multivariate Student's t."""
    draws = random.standard_normal(shape)
    return np.asarray(draws / np.sqrt(random.chisquare(freedom, (shape[0], 1)) / freedom))


class Archive:
    """Proposals around some of the samples (n, N) of a chain."""

    def __init__(self, samples: Floats) -> None:
        chosen = np.linspace(0, len(samples) - 1, min(ARCHIVE_SETTINGS.points, len(samples))).astype(np.intp)
        self.points = np.unique(samples[chosen], axis=0)
        count = self.points.shape[1]
        whole = np.linalg.cholesky(np.atleast_2d(np.cov(self.points.T)))
        flat = np.linalg.solve(whole, (self.points - self.points.mean(axis=0)).T).T
        _, near = KDTree(flat).query(flat, min(max(ARCHIVE_SETTINGS.neighbors, 2 * count + 2), len(flat)))
        around = flat[near] - flat[near].mean(axis=1, keepdims=True)
        local = np.einsum("nki,nkj->nij", around, around) / (near.shape[1] - 1)
        local += ARCHIVE_SETTINGS.least_share * np.eye(count)
        self._roots = whole @ np.linalg.cholesky(local)
        self._inverses = np.linalg.inv(self._roots)
        self._logs = np.log(np.abs(np.diagonal(self._roots, axis1=1, axis2=2))).sum(axis=1)

    @classmethod
    def of(cls, samples: Floats) -> Archive | None:
        """Return the archive of samples, None if too few or degenerate."""
        try:
            found = cls(samples)
        except np.linalg.LinAlgError:
            return None
        return found if len(found.points) > 2 * ARCHIVE_SETTINGS.neighbors else None

    def log_density(self, thetas: Floats) -> Floats:
        """Return the log density of proposals at thetas (m, N)."""
        away = np.einsum("nij,mnj->mni", self._inverses, thetas[:, None] - self.points)
        power = -0.5 * (ARCHIVE_SETTINGS.freedom + thetas.shape[1])
        kernels = power * np.log1p(np.sum(away**2, axis=2) / ARCHIVE_SETTINGS.freedom) - self._logs
        return np.asarray(logsumexp(kernels, axis=1), dtype=np.float64)

    def propose(self, thetas: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
        """Return proposals for thetas (m, N), and the log density ratio."""
        which = random.randint(len(self.points), size=len(thetas))
        draws = student(random, thetas.shape, ARCHIVE_SETTINGS.freedom)
        proposed = self.points[which] + np.einsum("nij,nj->ni", self._roots[which], draws)
        return proposed, self.log_density(thetas) - self.log_density(proposed)
