"""Since when: the likelihood of all onsets of a cause from running sums, as a step or a ramp.

A step of a cause from block k on has the columns J_c 1[t ≥ t_k], a ramp J_c (t − t_k)₊. With the sums over the blocks
after k of JᵀJ, t JᵀJ, t² JᵀJ and of the score, each onset costs a few products of small matrices and no simulation.
Nothing is forgotten: all other coordinates are estimated over the whole record, together with what was known of them.

References
----------
A. S. Willsky, H. L. Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", IEEE Trans. Automatic Control 21, 1976; D. Siegmund, "Confidence sets in change-point problems", Int.
Statistical Review 56, 1988.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from fmuid.arrays import Floats, Indices
from fmuid.diagnosis.evidence.causes import Cause
from fmuid.diagnosis.evidence.information import Information, Known

# The probability that the true onset lies within the stated set.
SET = 0.95
# Information of an onset, against that of the most telling one, below which its size is anything.
NOTHING = 1e-12


class Shape(Enum):
    """How a cause comes."""

    STEP = "step"
    RAMP = "ramp"


@dataclass(frozen=True, eq=False)
class Onsets:
    """What the onsets of one cause explain, seen at the end of some block.

    Attributes
    ----------
    cause : Cause
    shape : Shape
    blocks : (T,) array of int
        The onsets looked at: the cause is there from the begin of these blocks on.
    information : (T, c, c) array
        Of its size (a step), or of its rise in a block's length (a ramp).
    score : (T, c) array
    """

    cause: Cause
    shape: Shape
    blocks: Indices
    information: Floats
    score: Floats

    @property
    def sizes(self) -> Floats:
        """The most likely size for each onset (T, c), whatever its sign."""
        return np.asarray(np.linalg.solve(self._certain, self.score[..., None])[..., 0])

    @property
    def _certain(self) -> Floats:
        """The information, kept from being singular where an onset has seen nothing of its cause yet."""
        floor = NOTHING * float(np.einsum("tii->t", self.information).max()) + np.finfo(float).tiny
        return np.asarray(self.information + floor * np.eye(self.score.shape[1]))

    @property
    def statistics(self) -> Floats:
        """D of each onset (T,), zero where its sign is wrong."""
        found = np.einsum("tc,tc->t", self.score, self.sizes)
        return np.where(self.cause.sign * self.score[:, 0] < 0, 0.0, found) if self.cause.sign else found

    @property
    def covariances(self) -> Floats:
        """Of these sizes (T, c, c)."""
        return np.asarray(np.linalg.inv(self._certain))

    def log_evidence(self, blocks: float = 1.0) -> Floats:
        """Return the log Bayes factor of each onset against nothing new (T,).

        Parameters
        ----------
        blocks : float
            In which a ramp reaches the cause's size.
        """
        slab = self.cause.size / (blocks if self.shape is Shape.RAMP else 1.0)
        precision = self.information + np.eye(self.score.shape[1]) / slab**2
        mean = np.linalg.solve(precision, self.score[..., None])[..., 0]
        gain = 0.5 * np.einsum("tc,tc->t", self.score, mean)
        return np.asarray(gain - 0.5 * np.linalg.slogdet(precision * slab**2)[1])


@dataclass(frozen=True, eq=False)
class Dated:
    """When a cause began, by a flat prior over the onsets looked at.

    Attributes
    ----------
    block : int
        The most likely onset.
    blocks : tuple of int
        First and last of the smallest set that holds the onset with 95 %.
    size : (c,) array
        Mean over the onsets.
    covariance : (c, c) array
        Of the size, the spread over the onsets included.
    log_evidence : float
        Of the cause, whenever it began, against nothing new.
    """

    block: int
    blocks: tuple[int, int]
    size: Floats
    covariance: Floats
    log_evidence: float


def dated(onsets: Onsets, blocks: float = 1.0) -> Dated:
    """Return when a cause began; `blocks` as for `Onsets.log_evidence`."""
    evidence = onsets.log_evidence(blocks)
    weights = np.exp(evidence - evidence.max())
    total = float(weights.sum())
    weights /= total
    order = np.argsort(-weights, kind="stable")
    within = order[: int(np.searchsorted(np.cumsum(weights[order]), SET)) + 1]
    sizes = onsets.sizes
    size = weights @ sizes
    off = sizes - size
    covariance = np.einsum("t,tij->ij", weights, onsets.covariances + off[:, :, None] * off[:, None, :])
    at = onsets.blocks
    return Dated(
        int(at[order[0]]),
        (int(at[within.min()]), int(at[within.max()])),
        size,
        covariance,
        float(evidence.max()) + math.log(total / evidence.size),
    )


class RunningSums:
    """Sums of information and score over the blocks of a linearised record, from its begin.

    Parameters
    ----------
    matrices : (B, N, N) array
        Information of each block.
    scores : (B, N) array
    """

    def __init__(self, matrices: Floats, scores: Floats) -> None:
        middle = np.arange(len(scores)) + 0.5
        self.blocks = len(scores)
        self._matrices = [_summed(matrices * middle[:, None, None] ** power) for power in range(3)]
        self._scores = [_summed(scores * middle[:, None] ** power) for power in range(2)]

    @classmethod
    def of(cls, jacobian: Floats, residual: Floats, length: int) -> RunningSums:
        """Return those of a whitened record in blocks of `length` rows; the rest that fills no block is left out.

        Parameters
        ----------
        jacobian : (n, N) array
        residual : (n,) array
        length : int
        """
        count = len(residual) // length
        rows = jacobian[: count * length].reshape(count, length, -1)
        rest = residual[: count * length].reshape(count, length)
        return cls(np.einsum("bij,bik->bjk", rows, rows, optimize=True), np.einsum("bij,bi->bj", rows, rest))

    def between(self, first: int, end: int) -> Information:
        """Return what blocks first to end − 1 say."""
        (matrices, *_), (scores, _) = self._matrices, self._scores
        return Information(matrices[end] - matrices[first], scores[end] - scores[first])

    def onsets(
        self, known: Known, cause: Cause, end: int, shape: Shape = Shape.STEP, at: Sequence[int] | Indices | None = None
    ) -> Onsets:
        """Return what each onset of a cause explains at the end of block end − 1.

        Parameters
        ----------
        known : Known
            Before the record, of all coordinates; the cause's column in it is what of it is no news.
        cause : Cause
        end : int
            Blocks seen.
        shape : Shape
        at : sequence of int, optional
            The onsets looked at; default: every block.
        """
        blocks = np.arange(end) if at is None else np.asarray(at, dtype=np.intp)
        columns = list(cause.columns)
        whole, beside, score = self._after(blocks, end, shape)
        prior = np.linalg.inv(known.covariance)
        total = self.between(0, end)
        covariance = np.linalg.inv(total.matrix + prior)
        estimate = covariance @ (total.score + prior @ known.mean)
        mixed = beside[:, columns, :]
        information = whole[:, columns, :][:, :, columns] - np.einsum("tci,ij,tdj->tcd", mixed, covariance, mixed)
        return Onsets(cause, shape, blocks, information, score[:, columns] - mixed @ estimate)

    def _after(self, blocks: Indices, end: int, shape: Shape) -> tuple[Floats, Floats, Floats]:
        """Return the cause's own information, that shared with the coordinates, and its score, for each onset."""
        zero, one, two = (sums[end] - sums[blocks] for sums in self._matrices)
        score, later = (sums[end] - sums[blocks] for sums in self._scores)
        if shape is Shape.STEP:
            return zero, zero, score
        k = blocks[:, None, None].astype(np.float64)
        beside = one - k * zero
        return two - 2.0 * k * one + k**2 * zero, beside, later - k[:, :, 0] * score


def _summed(blocks: Floats) -> Floats:
    """Return the sums of the first 0 to B of some blocks (B + 1, ...)."""
    return np.concatenate([np.zeros((1, *blocks.shape[1:])), np.cumsum(blocks, axis=0)])


def largest_by_chance(
    matrices: Floats, known: Known, causes: Sequence[Cause], ends: Sequence[int], draws: int, seed: int = 0
) -> Floats:
    """Return the largest D over all onsets, causes and looks of records in which nothing is new (draws,), sorted.

    Scores are drawn from their law, which the information of the blocks tells: nothing is simulated.

    Parameters
    ----------
    matrices : (B, N, N) array
        Information of each block.
    known : Known
    causes : sequence of Cause
    ends : sequence of int
        After how many blocks the record is looked at.
    draws, seed : int
    """
    random = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(matrices)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    spread = np.linalg.cholesky(known.covariance)
    found = np.zeros(draws)
    for draw in range(draws):
        truth = known.mean + spread @ random.standard_normal(known.mean.size)
        noise = random.standard_normal(roots.shape[:2])
        scores = matrices @ truth + np.einsum("bij,bj->bi", roots, noise)
        sums = RunningSums(matrices, scores)
        found[draw] = max(float(sums.onsets(known, cause, end).statistics.max()) for end in ends for cause in causes)
    return np.sort(found)
