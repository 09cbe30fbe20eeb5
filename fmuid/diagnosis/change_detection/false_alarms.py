"""How often chance alone explains as much: of one onset, and of any onset of any cause as windows come.

References
----------
D. Siegmund, E. S. Venkatraman, "Using the generalized likelihood ratio statistic for sequential detection of a
change-point", Annals of Statistics 23, 1995.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.change_detection.causes import Cause

# A random walk jumps over a threshold: its factor is exp(−this · step) (Siegmund, "Sequential Analysis", 1985, p. 82).
OVERSHOOT = 0.583


def log_chance(statistics: Floats, cause: Cause) -> Floats:
    """Return the log probability that a cause explains so much where it is not there."""
    found = log_tail(statistics, len(cause.columns))
    return np.where(statistics > 0, found - (math.log(2.0) if cause.sign else 0.0), 0.0)


def log_tail(statistics: Floats, degrees: int) -> Floats:
    """Return the log probability that χ² exceeds statistics, also far out, where the probability itself is 0."""
    at = np.maximum(statistics, 0.0)
    if degrees == 1:
        return np.asarray(special.log_ndtr(-np.sqrt(at)) + math.log(2.0))
    if degrees == 2:
        return -at / 2.0
    with np.errstate(divide="ignore"):
        tail = np.log(special.chdtrc(degrees, at))
    half = degrees / 2.0
    far = -at / 2.0 + (half - 1.0) * np.log(np.maximum(at, 1.0) / 2.0) - special.gammaln(half)
    return np.where(np.isfinite(tail), tail, far)


def log_chances(statistics: Floats, causes: Sequence[Cause]) -> Floats:
    """Return the same of several causes: of statistics (T, m), one column a cause."""
    found = np.empty(statistics.shape)
    kinds = [(len(cause.columns), bool(cause.sign)) for cause in causes]
    for kind in set(kinds):
        at = [k for k, other in enumerate(kinds) if other == kind]
        found[:, at] = log_chance(statistics[:, at], causes[at[0]])
    return found


def log_limit(level: float, causes: Sequence[Cause], windows: int) -> float:
    """Return the log probability of one onset and one cause below which a window alarms by chance at a level.

    Parameters
    ----------
    level : float
        Probability that this window raises a false alarm, of any cause from any onset.
    causes : sequence of Cause
    windows : int
        Seen up to now, this one included: with the first one there is one onset.

    Notes
    -----
    D of an onset is χ²_k. As windows come, D over all onsets rises above b² for the first time at a rate of
    b² f_k(b²) ∫ x ν²(x) dx a window, x from b/√windows to b (Siegmund and Venkatraman for k = 1), beside the newest
    onset by itself.
    """
    from scipy.optimize import brentq  # slow to import

    def rate(log_p: float) -> float:
        return sum(_rate(log_p, cause, windows) for cause in causes) - level

    low, high = math.log(level) - 60.0, math.log(level) + math.log(2.0)
    return float(brentq(rate, low, high, xtol=1e-6)) if rate(high) > 0 else high


def _rate(log_p: float, cause: Cause, windows: int) -> float:
    k = len(cause.columns)
    p = math.exp(log_p)
    one_sided = 0.5 if cause.sign else 1.0
    square = float(special.chdtri(k, min(1.0, p / one_sided)))
    b = math.sqrt(square)
    density = math.exp((k / 2 - 1) * math.log(square / 2) - square / 2 - special.gammaln(k / 2)) / 2 if square else 0.0
    x = np.array([b / math.sqrt(windows), b])
    # ∫ x exp(−2 · OVERSHOOT · x) dx
    a = 2.0 * OVERSHOOT
    integral = -np.exp(-a * x) * (x / a + 1.0 / a**2)
    return p + one_sided * square * density * float(integral[1] - integral[0])
