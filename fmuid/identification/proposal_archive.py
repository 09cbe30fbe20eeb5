"""Independent proposals for a Markov chain from its own past, in the shape of its samples.

A mixture of Student's t distributions, one around each of some hundred earlier samples, with the covariance of that
sample's nearest neighbours: it follows a posterior that is bent, or in several pieces, which no covariance of the whole
describes. Made anew as the chain grows, ever more seldom, so that the chain forgets how it was made (Roberts and
Rosenthal).

References
----------
G. O. Roberts, J. S. Rosenthal, "Coupling and ergodicity of adaptive Markov chain Monte Carlo algorithms", J. Appl.
Prob. 44 (2), 2007; G. H. Givens, A. E. Raftery, "Local adaptive importance sampling for multivariate densities with
strong nonlinear relationships", J. Am. Stat. Assoc. 91, 1996 (kernels with the covariance of their neighbours).
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

    points: int = 500
    """Samples of the past that are kept, ..."""
    neighbours: int = 20
    """... and neighbours of each that say the covariance there."""
    freedom: float = 5.0
    """Degrees of freedom of the kernels: tails heavier than the posterior's."""
    least_share: float = 1e-6
    """Of the whole variance is added to that of the neighbours, which may lie in a plane."""


SETTINGS = ArchiveSettings()


class Archive:
    """Proposals around earlier samples.

    Parameters
    ----------
    samples : (n, N) array
        The chain's, of which some are taken.
    """

    def __init__(self, samples: Floats) -> None:
        chosen = np.linspace(0, len(samples) - 1, min(SETTINGS.points, len(samples))).astype(np.intp)
        self.points = np.unique(samples[chosen], axis=0)
        count = self.points.shape[1]
        whole = np.linalg.cholesky(np.atleast_2d(np.cov(self.points.T)))
        flat = np.linalg.solve(whole, (self.points - self.points.mean(axis=0)).T).T
        _, near = KDTree(flat).query(flat, min(max(SETTINGS.neighbours, 2 * count + 2), len(flat)))
        around = flat[near] - flat[near].mean(axis=1, keepdims=True)
        local = np.einsum("nki,nkj->nij", around, around) / (near.shape[1] - 1) + SETTINGS.least_share * np.eye(count)
        self._roots = whole @ np.linalg.cholesky(local)
        self._inverses = np.linalg.inv(self._roots)
        self._logs = np.log(np.abs(np.diagonal(self._roots, axis1=1, axis2=2))).sum(axis=1)

    @classmethod
    def of(cls, samples: Floats) -> Archive | None:
        """Return the archive of some samples, None where they lie in a plane or are too few."""
        try:
            found = cls(samples)
        except np.linalg.LinAlgError:
            return None
        return found if len(found.points) > 2 * SETTINGS.neighbours else None

    def log_density(self, thetas: Floats) -> Floats:
        """Return the logarithm of the density of proposals at thetas (m, N), without its constant (m,)."""
        away = np.einsum("nij,mnj->mni", self._inverses, thetas[:, None] - self.points)
        power = -0.5 * (SETTINGS.freedom + thetas.shape[1])
        kernels = power * np.log1p(np.sum(away**2, axis=2) / SETTINGS.freedom) - self._logs
        return np.asarray(logsumexp(kernels, axis=1), dtype=np.float64)

    def propose(self, thetas: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
        """Return proposals in place of thetas (m, N), with the log of the ratio of their densities there and here."""
        which = random.randint(len(self.points), size=len(thetas))
        draws = random.standard_normal(thetas.shape)
        draws /= np.sqrt(random.chisquare(SETTINGS.freedom, (len(thetas), 1)) / SETTINGS.freedom)
        proposed = self.points[which] + np.einsum("nij,nj->ni", self._roots[which], draws)
        return proposed, self.log_density(thetas) - self.log_density(proposed)
