"""Since when: what each onset of a cause explains, as a step or as a ramp, and the set that holds the true one.

References
----------
D. Siegmund, "Confidence sets in change-point problems", Int. Statistical Review 56, 1988.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import special

from fmuid.arrays import Floats
from fmuid.diagnosis.evidence.causes import Cause

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
    """What the onsets of one cause explain.

    Attributes
    ----------
    cause : Cause
    shape : Shape
    clock : (T,) array
        When they begin, s of all that was seen.
    widths : (T,) array
        How long after it no other onset is looked at, s.
    information : (T, c, c) array
        Of its size (a step), or of its rise in a second (a ramp).
    score : (T, c) array
    """

    cause: Cause
    shape: Shape
    clock: Floats
    widths: Floats
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

    def log_evidence(self, rise: float) -> Floats:
        """Return the log Bayes factor of each onset against nothing new (T,).

        Parameters
        ----------
        rise : float
            The time in which a ramp reaches the cause's size, s.
        """
        slab = self.cause.size / (rise if self.shape is Shape.RAMP else 1.0)
        precision = self.information + np.eye(self.score.shape[1]) / slab**2
        mean = np.linalg.solve(precision, self.score[..., None])[..., 0]
        found = 0.5 * np.einsum("tc,tc->t", self.score, mean) - 0.5 * np.linalg.slogdet(precision * slab**2)[1]
        if self.cause.sign:
            std = 1.0 / np.sqrt(precision[:, 0, 0])
            found = found + math.log(2.0) + special.log_ndtr(self.cause.sign * mean[:, 0] / std)
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Dated:
    """When a cause began, by a flat prior over the time.

    Attributes
    ----------
    clock : float
        The most likely onset, s of all that was seen.
    between : (float, float)
        The smallest set that holds the onset with 95 %, from its first to its last time.
    size : (c,) array
        Mean over the onsets.
    covariance : (c, c) array
        Of the size, the spread over the onsets included.
    log_evidence : float
        Of the cause, whenever it began, against nothing new.
    """

    clock: float
    between: tuple[float, float]
    size: Floats
    covariance: Floats
    log_evidence: float


def dated(onsets: Onsets, rise: float) -> Dated:
    """Return when a cause began; `rise` as for `Onsets.log_evidence`."""
    evidence = onsets.log_evidence(rise)
    weights = np.exp(evidence - evidence.max()) * onsets.widths
    total = float(weights.sum())
    weights /= total
    order = np.argsort(-weights, kind="stable")
    within = order[: int(np.searchsorted(np.cumsum(weights[order]), SET)) + 1]
    sizes = onsets.sizes
    size = weights @ sizes
    off = sizes - size
    covariance = np.einsum("t,tij->ij", weights, onsets.covariances + off[:, :, None] * off[:, None, :])
    # between two onsets lies any time; the columns, which have no transient after an onset, see it up to a block late
    first, last = within.min(), within.max()
    low = onsets.clock[first] - (onsets.widths[first - 1] if first else 0.0)
    return Dated(
        float(onsets.clock[int(np.argmax(evidence))]),
        (float(low), float(onsets.clock[last] + onsets.widths[last])),
        size,
        covariance,
        float(evidence.max()) + math.log(total / float(onsets.widths.sum())),
    )
