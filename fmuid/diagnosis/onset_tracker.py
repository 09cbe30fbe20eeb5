"""Likelihood of all onsets of all causes, updated window by window (docs/method/monitoring.md).

A step from t_k on has the columns J_c w(t − t_k) (`ChangeTransient`), a ramp J_c (t − t_k)₊. Drift is another number in
each window and is eliminated there; all else is constant. Older onsets are kept farther apart.

References: A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21, 1976; T. L. Lai, "Sequential changepoint
detection", J. Royal Statistical Society B 57, 1995.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.information_matrix import LEAST, ChangePrior, InformationMatrix, ScoreStatistics, square_root
from fmuid.diagnosis.onset import ChangeTransient, OnsetLikelihood, OnsetShape


@dataclass(frozen=True)
class TrackerSettings:
    """Onsets kept."""

    fine: int = 12  # last windows with onsets within them
    most: int = 256  # begins of windows; beyond, every second one of the older half goes


SETTINGS = TrackerSettings()


@dataclass(frozen=True, eq=False)
class Blocks:
    """Sums of a window by block."""

    edges: Floats  # (B + 1,), begins of the blocks and the end of the last one, s of all data
    matrices: Floats  # (B, N, N), information
    scores: Floats  # (B, N)


# Rows of an onset: its place, the sums before its window, and its own sums as a step and as a ramp (`_parts`).
_KEPT = ("clock", "window", "begins", "before", "step", "ramp")


class OnsetTracker:
    """All onsets of a monitored machine.

    A change with covariance `drift` (N, N) is sound in any window. Its part `scatter` has a Wishart law of `freedom`.
    """

    def __init__(
        self, known: ChangePrior, drift: Floats, scatter: Floats | None = None, freedom: float = math.inf
    ) -> None:
        self.known, self._drift, self._root = known.scattering(drift), drift, square_root(drift)
        self._scatter, self._freedom = scatter, freedom
        n = len(drift)
        self.build_up, self.slow = ChangeTransient(), np.zeros(n, bool)
        self._least = np.zeros(n)
        self.windows, self.end = 0, 0.0
        self.pinned = (math.inf, -math.inf)
        self._total, self._score = np.zeros((n, n)), np.zeros(n)
        sums = np.zeros((0, n * n + n)), *[np.zeros((0, 2 * n * n + n))] * 2
        places = np.zeros(0), np.zeros(0, int), np.zeros(0, bool)
        self._of: dict[str, Any] = dict(zip(_KEPT, (*places, *sums), strict=True))

    def copy(self) -> OnsetTracker:
        """Return an independent tracker."""
        other = copy(self)
        other._of = dict(self._of)  # arrays are replaced, never changed
        return other

    def building_up(self, build_up: ChangeTransient, slow: Flags) -> OnsetTracker:
        """Return a tracker whose next windows have a build-up of changes."""
        other = self.copy()
        other.build_up, other.slow = build_up, slow
        return other

    def add(self, window: Blocks) -> None:
        """Add a window, later than all before."""
        kept, count = np.flatnonzero(self._kept()), len(window.scores)
        clock = self._of["clock"][kept]
        recent = int(np.searchsorted(clock, window.edges[0] - self.build_up.lasts, side="right"))
        own = _Window(window, self._root, self.slow, self.build_up, clock[recent:])
        before = np.append(self._total, self._score)
        places = (window.edges[:-1], self.windows, np.arange(count) == 0, before, own.steps, own.ramps)
        for name, new in zip(_KEPT, places, strict=True):
            self._of[name] = _followed(self._of[name], kept, count, new)
        self._of["step"][:recent] += own.step
        self._of["step"][recent : kept.size] += own.recent
        self._of["ramp"][: kept.size] += own.rising(clock)
        self._least = self._least + LEAST * np.diag(own.whole)
        self._total = self._total + own.matrix
        self._score = self._score + own.score
        self.windows, self.end = self.windows + 1, float(window.edges[-1])

    def _kept(self) -> Flags:
        """Return the onsets to keep with one more window."""
        begins, window = self._of["begins"], self._of["window"]
        clock, (low, high) = self._of["clock"], self.pinned
        kept = begins | (window > self.windows - SETTINGS.fine) | ((low <= clock) & (clock <= high))
        at = np.flatnonzero(begins)
        if at.size + 1 > SETTINGS.most:
            # the first one stays: what has been wrong from the begin on
            kept[at[1 : (at.size + 1) // 2 : 2]] = False
        return np.asarray(kept)

    def clocks(self) -> Floats:
        """Return the begins of the onsets (T,), s of all data."""
        return np.asarray(self._of["clock"])

    # --- what the onsets explain

    def _news(self, at: Any, shape: OnsetShape = OnsetShape.STEP) -> tuple[Floats, Floats]:
        """Return F (T, N, N) and h (T, N) beside drift."""
        after = self.known.after_also(InformationMatrix(self._total, self._score))
        own, shared, score = _parts(self._of[shape.value][at], self._score.size)
        mixed = np.swapaxes(shared, 1, 2)
        information = own - mixed @ after.covariance @ shared + np.diag(self._least)
        score, rise = score - mixed @ after.mean, 1.0 if shape is OnsetShape.STEP else self.end
        along = information @ (self._root / rise)
        inside = np.swapaxes(along, 1, 2) @ (self._root / rise) + np.eye(self._root.shape[1])
        share = np.swapaxes(np.linalg.solve(inside, np.swapaxes(along, 1, 2)), 1, 2)
        drawn = (score @ (self._root / rise))[..., None]
        return information - share @ np.swapaxes(along, 1, 2), score - (share @ drawn)[..., 0]

    def statistics(self, causes: Sequence[Cause]) -> tuple[Floats, Floats]:
        """Return D and degrees of freedom (T, m) of steps at windows."""
        at = np.flatnonzero(self._of["begins"])
        information, score = self._news(at)
        found = statistics_of(information, score, causes)
        if self._scatter is None:
            return found, np.full(found.shape, math.inf)
        # of the variance of a size: scatter of the windows before, after, and of the step
        number = self._of["window"][at]
        parts = 1.0 + 1.0 / np.maximum(number, 1) + 1.0 / (self.windows - number)
        own = np.einsum("tii->ti", information)
        share = np.einsum("tij,jk,tki->ti", information, self._scatter, information, optimize=True) / own
        share = np.clip(share * parts[:, None], 1e-3, 1.0)
        return found, self._freedom / np.column_stack([share[:, list(c.columns)].mean(axis=1) for c in causes]) ** 2

    def onsets(self, causes: Sequence[Cause], shape: OnsetShape) -> list[OnsetLikelihood]:
        """Return the likelihood of all onsets of each cause."""
        information, score = self._news(slice(None), shape)
        clock = self._of["clock"]
        widths = np.diff(np.append(clock, self.end))
        columns = [(cause, list(cause.columns)) for cause in causes]
        return [
            OnsetLikelihood(cause, shape, clock, widths, information[:, at][:, :, at], score[:, at])
            for cause, at in columns
        ]

    def news(self, clock: float) -> ScoreStatistics:
        """Return the changes as steps from the onset nearest to a time."""
        at = int(np.argmin(np.abs(self._of["clock"] - clock)))
        information, score = self._news([at])
        return ScoreStatistics(information[0], score[0])

    def apart(self, low: float, high: float) -> tuple[ScoreStatistics, float] | None:
        """Return changes after `high` against windows before `low`, and their begin; None without a later window.

        The cause is there in a part of the windows in between. The last one counts as whole if none is later.
        """
        clock, begins = self._of["clock"], self._of["begins"]
        slack = 1e-6 * max(1.0, abs(self.end))
        late = np.flatnonzero(begins & (clock >= high - slack))
        early = np.flatnonzero(begins & (clock <= low + slack))
        if not late.size:
            late = np.flatnonzero(begins & (clock >= low - slack))[-1:]
        if not late.size:
            return None
        first, last = late[0], early[-1] if early.size else np.flatnonzero(begins)[0]
        n = self._score.size
        before = [self._of["before"][k] for k in (last, first)]
        early_on, until = (InformationMatrix(each[: n * n].reshape(n, n), each[n * n :]) for each in before)
        after = InformationMatrix(self._total - until.matrix, self._score - until.score)
        return ScoreStatistics.of(after, self.known.after_also(early_on).scattering(self._drift)), float(clock[first])

    def restarted(self, low: float) -> OnsetTracker:
        """Return a tracker for later windows, its prior from those before `low`."""
        none, n = 0.0 * self._drift, self._score.size
        other = OnsetTracker(self.known, none, self._scatter, self._freedom)
        early = np.flatnonzero(self._of["begins"] & (self._of["clock"] <= low))
        if early.size:
            before = self._of["before"][early[-1]]
            record = InformationMatrix(before[: n * n].reshape(n, n), before[n * n :])
            other.known = self.known.after_also(record).scattering(self._drift)
        other._drift, other._root = self._drift, self._root
        other.build_up, other.slow, other.end = self.build_up, self.slow, self.end
        return other

    # --- files

    def state(self) -> dict[str, Any]:
        """Return the arrays for `restored`."""
        return {
            **self._of,
            "total": self._total,
            "score": self._score,
            "seen": np.array([self.windows, self.end, *self.pinned]),
            "least": self._least,
            "lags": self.build_up.lags,
            "shown": self.build_up.shown,
            "slow": self.slow,
            "mean": self.known.mean,
            "covariance": self.known.covariance,
        }

    def restored(self, state: Mapping[str, Any]) -> OnsetTracker:
        """Return the tracker of a state, of the same coordinates."""
        for name, own in self.state().items():
            free = name in (*_KEPT, "lags", "shown")  # there are as many as there are
            if state[name].dtype.kind != own.dtype.kind or state[name].shape[free:] != own.shape[free:]:
                raise ValueError(f"{name!r} has other coordinates")
        other = self.copy()
        other._of = {name: state[name] for name in _KEPT}
        other._total, other._score, other._least = state["total"], state["score"], state["least"]
        other.build_up, other.slow = ChangeTransient(state["lags"], state["shown"]), state["slow"]
        other.known = ChangePrior(state["mean"], state["covariance"])
        windows, other.end, *pinned = state["seen"].tolist()
        other.windows, other.pinned = int(windows), (pinned[0], pinned[1])
        return other


def statistics_of(information: Floats, score: Floats, causes: Sequence[Cause]) -> Floats:
    """Return D of each cause alone (T, m); 0 for a wrong sign."""
    found = np.empty((len(score), len(causes)))
    single = [k for k, cause in enumerate(causes) if len(cause.columns) == 1]
    at = [causes[k].columns[0] for k in single]
    signs = np.array([causes[k].sign for k in single])
    own, mine = information[:, at, at], score[:, at]
    known = (own > 0) & (signs * mine >= 0)
    found[:, single] = np.where(known, mine**2 / np.where(own > 0, own, 1.0), 0.0)
    for k in set(range(len(causes))) - set(single):
        columns, none = list(causes[k].columns), np.zeros(len(score))
        part = information[:, columns][:, :, columns]
        found[:, k] = OnsetLikelihood(causes[k], OnsetShape.STEP, none, none, part, score[:, columns]).statistics
    return found


class _Window:
    """Sums of a window without drift, which L(I + LᵀGL)⁻¹Lᵀ takes out; `recent` (R,) are onsets still building up.

    `whole` (N, N) is with drift. `step` (visible steps) has 2 N² + N numbers, as each row of `recent` (R), `steps` and
    `ramps` (B, onsets at its blocks).
    """

    def __init__(self, window: Blocks, root: Floats, slow: Flags, build_up: ChangeTransient, recent: Floats) -> None:
        count, n = window.scores.shape
        self._edges = edges = window.edges
        flat = np.hstack([window.matrices.reshape(count, n * n), window.scores])
        middle, at = 0.5 * (edges[1:] + edges[:-1]), np.concatenate([recent, edges[:-1]])
        late, ramp = middle - edges[0], np.maximum(middle - edges[:-1, None], 0.0)
        after = (edges[1:] > at[:, None]).astype(np.float64)
        plain = np.vstack([np.ones((1, count)), late[None], late[None] ** 2, ramp, ramp**2, after]) @ flat
        matrices, scores = plain[:, : n * n].reshape(-1, n, n), plain[:, n * n :]
        rise, square, step = slice(3, 3 + count), slice(3 + count, 3 + 2 * count), slice(3 + 2 * count, None)
        own, shared, score = matrices[step], matrices[step], scores[step]
        if build_up.lasts and slow.any():
            part = build_up.shares(at, edges)
            found = np.vstack([part, part**2]) @ flat
            mixed, both = found[: at.size, : n * n].reshape(-1, n, n), found[at.size :, : n * n].reshape(-1, n, n)
            own = np.where(slow[:, None] & slow, both, np.where(slow[:, None] | slow, mixed, own))
            shared, score = np.where(slow, mixed, shared), np.where(slow, found[: at.size, n * n :], score)
        self.whole, self._whole_score, self._once = matrices[0], scores[0], matrices[1]
        taken = root @ np.linalg.solve(np.eye(root.shape[1]) + root.T @ self.whole @ root, root.T)
        self._taken = 0.5 * (taken + taken.T)
        sums = self._without(
            np.concatenate([matrices[:1], matrices[2:3], matrices[square], own]),
            np.concatenate([matrices[:2], matrices[rise], shared]),
            np.concatenate([scores[:2], scores[rise], score]),
        )
        first = 2 + count + recent.size
        self.step, self._ramp, self.ramps = sums[0], sums[1], sums[2 : 2 + count]
        self.recent, self.steps = sums[2 + count : first], sums[first:]
        _, (self.matrix,), (self.score,) = _parts(sums[:1], n)

    def _without(self, own: Floats, shared: Floats, score: Floats) -> Floats:
        """Return rows of own and shared information and score, without drift."""
        drawn, mixed = self._taken @ shared, np.swapaxes(shared, -1, -2)
        parts = (own - mixed @ drawn, shared - self.whole @ drawn, score - mixed @ (self._taken @ self._whole_score))
        return np.hstack([each.reshape(len(score), -1) for each in parts])

    def rising(self, clock: Floats) -> Floats:
        """Return the window's addition to the sums of earlier ramps (T,)."""
        before = self._edges[0] - clock
        # of onsets so long before, all is a polynomial of that time
        mixed = self._once @ self._taken @ self.whole
        square = mixed.size
        linear = np.append(2.0 * self._once - mixed - mixed.T, self.step[square:])
        quadratic = np.append(self.step[:square], np.zeros(self.step.size - square))
        return np.asarray(
            np.column_stack([np.ones(clock.size), before, before**2]) @ np.stack([self._ramp, linear, quadratic])
        )


def _parts(sums: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """Return the parts of rows of sums: own and shared information (T, N, N), and scores (T, N)."""
    own, shared = (sums[:, k * n * n : (k + 1) * n * n].reshape(-1, n, n) for k in range(2))
    return own, shared, sums[:, 2 * n * n :]


def _followed(values: Any, kept: Indices, count: int, new: Any) -> Any:
    """Return some rows, followed by others."""
    found = np.empty((kept.size + count, *values.shape[1:]), values.dtype)
    np.take(values, kept, axis=0, out=found[: kept.size], mode="clip")  # without a copy in between
    found[kept.size :] = new
    return found
