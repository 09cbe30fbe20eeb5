"""What each experiment brings, and whether experiments contradict each other.

All is linear about the estimates, with rows whitened by the noise of the result. The least sum of squares of all is
by T above those of an experiment alone and of the others; T/d is F(d, n) distributed (Chow, Econometrica 28, 1960), d
the parameters that both determine. A contradiction enlarges an estimated noise, so each has that of its own fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, Result
from fmuid.identification.directed_tests import whitened

PRIOR = "prior"  # name of the prior among the experiments


@dataclass(frozen=True)
class ContributionSettings:
    """Numbers of the comparison of experiments."""

    level: float = 0.01  # significance of a contradiction, of all experiments together
    rank: float = 1e-9  # smallest singular value of columns in units of σ
    least_freedom: int = 3  # degrees of freedom from which an experiment shows its own noise


SETTINGS = ContributionSettings()


@dataclass(frozen=True)
class Contribution:
    """One experiment, or the prior, among all.

    Attributes
    ----------
    experiment : str
        Its name, or "prior".
    widening : tuple of float
        Factor of each parameter's σ without it; infinite where only it determines the parameter.
    degrees : int
        Parameters, or combinations, that it and the others determine.
    probability : float
        Of a difference as large by chance; NaN where nothing can be compared.
    """

    experiment: str
    widening: tuple[float, ...]
    degrees: int
    probability: float


@dataclass(frozen=True, eq=False)
class Contributions:
    """What each experiment brings.

    Attributes
    ----------
    parts : tuple of Contribution
        Experiments in their order, then the prior; empty for one source alone.
    leverage : tuple of (K, n_outputs) arrays
        Share of each sample in its own fit, from 0 to 1; NaN where it does not count. Without rows of experiments in
        time, as the two below.
    std : tuple of (K, n_outputs) arrays
        σ of the simulated outputs by that of the estimates, in units of the data.
    noise : tuple of (K, n_outputs) arrays
        Noise level of each sample.
    """

    parts: tuple[Contribution, ...]
    leverage: tuple[Floats, ...]
    std: tuple[Floats, ...]
    noise: tuple[Floats, ...]

    @property
    def contradictions(self) -> tuple[Contribution, ...]:
        """Experiments that contradict the others, the gravest first; none of one and a prior, tested by itself."""
        if sum(each.experiment != PRIOR for each in self.parts) == 1:
            return ()
        limit = SETTINGS.level / max(1, len(self.parts))
        return tuple(sorted((e for e in self.parts if e.probability < limit), key=lambda each: each.probability))


def find_contributions(problem: LeastSquares, result: Result) -> Contributions | None:
    """Return what each experiment brings; None of one experiment in time, without covariance."""
    local, noise = result.fit.linearization, result.fit.noise
    timed = all(each.kind == "time" for each in problem.experiments)
    if local is None or noise is None or (timed and len(problem.experiments) == 1) or not np.isfinite(result.std).all():
        return None
    rows = whitened(noise, np.column_stack([local.residual, local.jacobian]))
    scale = result.std
    residual, jacobian = rows[:, 0], rows[:, 1:] * scale
    edges = np.cumsum([0, *(each.size for each in problem.kept)])
    blocks = [(residual[a:b], jacobian[a:b]) for a, b in pairwise(edges)]
    names = [each.name for each in problem.experiments]
    if len(local.prior_residual):
        blocks.append((local.prior_residual, local.prior_jacobian * scale))
        names.append(PRIOR)
    given = [not np.isnan(problem.variance[problem.groups[a:b]]).any() for a, b in pairwise(edges)]
    parts = tuple(_parts(names, blocks, [*given, True])) if len(blocks) > 1 else ()
    covariance = result.covariance / np.outer(scale, scale)
    raw = local.jacobian * scale
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", raw, covariance, raw), 0.0))
    pull = np.einsum("ij,jk,ik->i", jacobian, np.linalg.pinv(_information(blocks)), jacobian)
    levels = problem.unscaled(np.sqrt([result.fit.variance[name] for name in problem.output_names])[problem.groups])
    ends = [0 if each.kind == "time" else None for each in problem.experiments]  # rows of those without a time
    tables = [
        tuple(table[:end] for table, end in zip(problem.tables(values), ends, strict=True))
        for values in (np.clip(pull, 0.0, 1.0), spread * levels, levels)
    ]
    return Contributions(parts, *tables)


def _information(blocks: list[tuple[Floats, Floats]]) -> Floats:
    return np.asarray(sum(jacobian.T @ jacobian for _, jacobian in blocks))


def _parts(names: list[str], blocks: list[tuple[Floats, Floats]], given: list[bool]) -> Iterator[Contribution]:
    """Yield the contribution of each block of rows; the noise of some is given."""
    scaled, freedoms = [], list[float]()
    for (residual, jacobian), known in zip(blocks, given, strict=False):
        least, rank = _least(residual, jacobian)
        freedom = residual.size - rank
        shared = known or freedom < SETTINGS.least_freedom
        own = 1.0 if shared else math.sqrt(max(least / freedom, 1e-12))
        scaled.append((residual / own, jacobian / own))
        freedoms.append(math.inf if shared else float(freedom))
    together = _least(*_stacked(scaled))
    full = np.sqrt(np.diag(np.linalg.pinv(_information(blocks))))
    for k, name in enumerate(names):
        alone, without = _least(*scaled[k]), _least(*_stacked(scaled[:k] + scaled[k + 1 :]))
        degrees, least_freedom = alone[1] + without[1] - together[1], min(freedoms)
        excess, probability = max(together[0] - alone[0] - without[0], 0.0), math.nan
        if degrees > 0 and math.isinf(least_freedom):
            probability = float(special.chdtrc(degrees, excess))
        elif degrees > 0:
            probability = float(special.fdtrc(degrees, least_freedom, excess / degrees))
        others = _information(blocks[:k] + blocks[k + 1 :])
        yield Contribution(name, tuple((_std(others) / full).tolist()), degrees, probability)


def _stacked(blocks: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    residuals, jacobians = zip(*blocks, strict=True)
    return np.concatenate(residuals), np.concatenate(jacobians)


def _std(information: Floats) -> Floats:
    """Return σ (N,) of an information matrix; infinite where it lacks a parameter."""
    values, vectors = np.linalg.eigh(information)
    seen = values > SETTINGS.rank * max(float(values.max()), 1.0)
    found = np.sqrt((vectors[:, seen] ** 2 / values[seen]).sum(axis=1))
    return np.asarray(np.where((vectors[:, ~seen] ** 2).sum(axis=1) > 1e-6, np.inf, found))


def _least(residual: Floats, jacobian: Floats) -> tuple[float, int]:
    """Return the least sum of squares, and the rank."""
    u, values, _ = np.linalg.svd(jacobian, full_matrices=False)
    kept = u[:, values > SETTINGS.rank * max(float(values.max(initial=0.0)), 1.0)]
    rest = residual - kept @ (kept.T @ residual)
    return float(rest @ rest), kept.shape[1]
