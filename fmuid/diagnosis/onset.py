"""Since when: what each onset of a cause explains, as a step or as a ramp, and the set that holds the true one.

A machine's outputs forget the state they had before a change: the columns J of a cause that has always been there
become, of a change at t₀, J − Φ S(t₀), whose second part dies out. Its projection on J is the share of the change that
shows by then, w(a) = 1 − ρ(a) C(a), with ρ what of a difference in the state is left after a lag a, and C the
autocorrelation of J; of a first-order lag under white excitation 1 − exp(−2a/τ), under constant excitation
1 − exp(−a/τ).

References
----------
D. Siegmund, "Confidence sets in change-point problems", Int. Statistical Review 56, 1988.
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
    """Numbers of the dating of onsets.

    Attributes
    ----------
    over : float
        What is left of a difference in the state when it is over.
    lags : int
        At which a transient is kept.
    confidence : float
        The probability that the true onset lies within the stated set.
    nothing : float
        Information of an onset, against that of the most telling one, below which its size is anything.
    alike : float
        Onsets whose log evidence differs by less have the same samples after them: the first one is said.
    """

    over: float = 0.05
    lags: int = 64
    confidence: float = 0.95
    nothing: float = 1e-12
    alike: float = 1e-9


SETTINGS = OnsetSettings()


@dataclass(frozen=True, eq=False)
class ChangeTransient:
    """How much of a change shows.

    Attributes
    ----------
    lags : (L,) array
        From 0 on, s.
    shown : (L,) array
        The integral of the share that shows from the change to these lags, s.
    """

    lags: Floats = field(default_factory=lambda: np.zeros(1))
    shown: Floats = field(default_factory=lambda: np.zeros(1))

    @classmethod
    def of(cls, left: Floats, columns: Floats, step: float) -> ChangeTransient:
        """Return that of a machine.

        Parameters
        ----------
        left : (M,) array
            Mean square of what is left of differences in the state, sample by sample from where they were made.
        columns : (K, c) array
            Of what takes time to show, sample by sample.
        step : float
            Between samples, s.
        """
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
        """After which all shows, s."""
        return float(self.lags[-1])

    def shares(self, clock: Floats, edges: Floats) -> Floats:
        """Return the mean share that shows in blocks (T, B), after changes at some times (T,)."""
        late = np.maximum(edges - clock[:, None], 0.0)
        shown = np.interp(late, self.lags, self.shown) + np.maximum(late - self.lasts, 0.0)
        return np.asarray(np.diff(shown, axis=1) / np.diff(edges))


class OnsetShape(Enum):
    """How a cause comes."""

    STEP = "step"
    RAMP = "ramp"


@dataclass(frozen=True, eq=False)
class OnsetLikelihood:
    """What the onsets of one cause explain.

    Attributes
    ----------
    cause : Cause
    shape : OnsetShape
    clock : (T,) array
        When they begin, s of all that was seen.
    widths : (T,) array
        How long after it no other onset is looked at, s.
    information : (T, c, c) array
        Of its size (a step), or of its rise in a second (a ramp).
    score : (T, c) array
    """

    cause: Cause
    shape: OnsetShape
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
        floor = SETTINGS.nothing * float(np.einsum("tii->t", self.information).max()) + np.finfo(float).tiny
        return np.asarray(self.information + floor * np.eye(self.score.shape[1]))

    @property
    def statistics(self) -> Floats:
        """D of each onset (T,), zero where its sign is wrong."""
        found = np.einsum("tc,tc->t", self.score, self.sizes)
        return np.where(self.cause.sign * self.score[:, 0] < 0, 0.0, found) if self.cause.sign else found

    def log_evidence(self, rise: float) -> Floats:
        """Return the log Bayes factor of each onset against nothing new (T,).

        Parameters
        ----------
        rise : float
            The time in which a ramp reaches the cause's size, s.
        """
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
    """When a cause began and how, by a flat prior over the time.

    Attributes
    ----------
    cause : Cause
    shape : OnsetShape
        The likelier one.
    clock : float
        The most likely onset of this shape, s of all that was seen.
    between : (float, float)
        The smallest set that holds the onset with 95 %, whatever its shape, from its first to its last time.
    log_evidence : float
        Of the cause, whenever it began, against nothing new.
    """

    cause: Cause
    shape: OnsetShape
    clock: float
    between: tuple[float, float]
    log_evidence: float


def estimate_onset(onsets: Sequence[OnsetLikelihood], rise: float) -> OnsetEstimate:
    """Return when a cause began, by the same onsets in each shape; `rise` as for `OnsetLikelihood.log_evidence`."""
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
