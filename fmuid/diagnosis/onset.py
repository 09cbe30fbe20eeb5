"""Onset likelihood of a cause, and the confidence set of its time.

After a change the visible share of a column J is w(a) = 1 − ρ(a) C(a). There ρ is the remaining state difference after
a lag a, C the autocorrelation of J.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.causes import Cause


@dataclass(frozen=True)
class OnsetSettings:
    """Numbers of the dating of onsets."""

    over: float = 0.05  # share of a state difference at the end of a transient
    lags: int = 64  # at which a transient is kept
    confidence: float = 0.95  # of the set of onsets
    nothing: float = 1e-12  # information of an onset, over that of the best one, without which its size is arbitrary
    alike: float = 1e-9  # difference in log evidence of onsets with the same samples after them; the first is taken


SETTINGS = OnsetSettings()


@dataclass(frozen=True, eq=False)
class ChangeTransient:
    """Visible share of a change over time."""

    lags: Floats = field(default_factory=lambda: np.zeros(1))  # (L,), from 0 on, s
    shown: Floats = field(default_factory=lambda: np.zeros(1))  # (L,), integral of the share to these lags, s

    @classmethod
    def of(cls, left: Floats, columns: Floats, step: float) -> ChangeTransient:
        """Return the transient of squared state differences (M,) and columns (K, c)."""
        envelope = np.maximum.accumulate(left[::-1])[::-1]
        power = np.sum(columns**2, axis=0)
        if not envelope[0] > 0 or not power.any():
            return cls()
        ratio = np.sqrt(envelope / envelope[0])
        end = min(int(np.count_nonzero(ratio > SETTINGS.over)), ratio.size - 1, len(columns) - 1)
        rows = np.unique(np.linspace(0, end, SETTINGS.lags).round().astype(int))
        pairs = np.array([np.sum(columns[: len(columns) - k] * columns[k:], axis=0) for k in rows])
        alike = np.mean(pairs[:, power > 0] / power[power > 0], axis=1)
        share, lags = np.clip(1.0 - ratio[rows] * alike, 0.0, 1.0), step * rows
        return cls(lags, np.append(0.0, np.cumsum(0.5 * (share[1:] + share[:-1]) * np.diff(lags))))

    @property
    def lasts(self) -> float:
        """Length, s."""
        return float(self.lags[-1])

    def shares(self, clock: Floats, edges: Floats) -> Floats:
        """Return the mean share in blocks (T, B) after changes (T,)."""
        late = np.maximum(edges - clock[:, None], 0.0)
        shown = np.interp(late, self.lags, self.shown) + np.maximum(late - self.lasts, 0.0)
        return np.asarray(np.diff(shown, axis=1) / np.diff(edges))


class OnsetShape(Enum):
    """Course of a change."""

    STEP = "step"
    RAMP = "ramp"


@dataclass(frozen=True, eq=False)
class OnsetLikelihood:
    """Statistics of the onsets of one cause."""

    cause: Cause
    shape: OnsetShape
    clock: Floats  # (T,), begin, s of all data
    widths: Floats  # (T,), time to the next onset, s
    information: Floats  # (T, c, c), of the size (step), or of its rise in a second (ramp)
    score: Floats  # (T, c)

    @property
    def sizes(self) -> Floats:
        """Most likely size for each onset (T, c), of either sign."""
        return np.asarray(np.linalg.solve(self._certain, self.score[..., None])[..., 0])

    @property
    def _certain(self) -> Floats:
        """Information, regular where an onset has seen nothing of its cause."""
        floor = SETTINGS.nothing * float(np.einsum("tii->t", self.information).max()) + np.finfo(float).tiny
        return np.asarray(self.information + floor * np.eye(self.score.shape[1]))

    @property
    def statistics(self) -> Floats:
        """D of each onset (T,), zero for a wrong sign."""
        found = np.einsum("tc,tc->t", self.score, self.sizes)
        return np.where(self.cause.sign * self.score[:, 0] < 0, 0.0, found) if self.cause.sign else found

    def log_evidence(self, rise: float) -> Floats:
        """Return the log Bayes factor of each onset (T,) against none; ramps reach the cause's size in `rise`, s."""
        slab = self.cause.size / (rise if self.shape is OnsetShape.RAMP else 1.0)
        precision = self.information + np.eye(self.score.shape[1]) / slab**2
        mean = np.linalg.solve(precision, self.score[..., None])[..., 0]
        found = 0.5 * np.einsum("tc,tc->t", self.score, mean) - 0.5 * np.linalg.slogdet(precision * slab**2)[1]
        if self.cause.sign:
            std = 1.0 / np.sqrt(precision[:, 0, 0])
            found = found + math.log(2.0) + special.log_ndtr(self.cause.sign * mean[:, 0] / std)
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class OnsetEstimate:
    """Begin and shape of a cause, with a flat prior over time."""

    cause: Cause
    shape: OnsetShape  # the likelier one
    clock: float  # most likely onset of this shape, s of all data
    between: tuple[float, float]  # first and last time of the smallest 95 % set of onsets of any shape
    log_evidence: float  # of the cause at any time, against no change


def estimate_onset(onsets: Sequence[OnsetLikelihood], rise: float) -> OnsetEstimate:
    """Return the onset of a cause from its likelihoods in each shape; `rise` as for `OnsetLikelihood.log_evidence`."""
    first = onsets[0]
    evidence = np.array([each.log_evidence(rise) for each in onsets])
    weights = np.exp(evidence - evidence.max()) * first.widths
    best = int(np.argmax(weights.sum(axis=1)))
    total = float(weights.sum())
    share = weights.sum(axis=0) / total
    order = np.argsort(-share, kind="stable")
    within = order[: int(np.searchsorted(np.cumsum(share[order]), SETTINGS.confidence)) + 1]
    low, high = within.min(), within.max()
    # between two onsets lies any time
    since = first.clock[low] - (first.widths[low - 1] if low else 0.0)
    return OnsetEstimate(
        first.cause,
        onsets[best].shape,
        float(first.clock[int(np.argmax(evidence[best] >= evidence[best].max() - SETTINGS.alike))]),
        (float(since), float(first.clock[high] + first.widths[high])),
        float(evidence.max()) + math.log(total / (len(onsets) * float(first.widths.sum()))),
    )
