"""How much of a change in a machine shows some time after it: its outputs forget the state they had before.

The columns J of a cause that has always been there become, of a change at t₀, J − Φ S(t₀): what the state's
sensitivities at t₀ leave of them dies out. Its projection on J is the share of the change that shows by then,
w(a) = 1 − ρ(a) C(a), with ρ what of a difference in the state is left after a lag a, and C the autocorrelation of J; of
a first-order lag under white excitation 1 − exp(−2a/τ), under constant excitation 1 − exp(−a/τ).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fmuid.array_types import Floats

# Of a difference in the state, what is left when it is over.
OVER = 0.05
# So many lags.
LAGS = 64


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
        end = min(int(np.count_nonzero(ratio > OVER)), ratio.size - 1, len(columns) - 1)
        rows = np.unique(np.linspace(0, end, LAGS).round().astype(int))
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
