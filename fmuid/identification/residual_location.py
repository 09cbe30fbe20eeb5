"""Where in time the residual sits: the shortest stretch with half of its square."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.simulation import OutputFit


@dataclass(frozen=True)
class LocationSettings:
    """Numbers of a residual that sits in one place."""

    share: float = 0.5  # of the squared residual
    time: float = 0.1  # of the record, at most; white noise needs half of it
    median: float = 0.4549  # of χ² with one degree of freedom
    margin: float = 1.5  # of the time in which a transient exceeds the noise: it goes on below it
    least_samples: int = 50  # fewer have half of it in a tenth by chance


SETTINGS = LocationSettings()


@dataclass(frozen=True)
class ResidualStretch:
    """Stretch of an experiment with most of the squared residual.

    Attributes
    ----------
    experiment : str
    start, end : float
        Times, s.
    share, time_share : float
        Of the squared residual, and of the scored time.
    excess : float
        Squared residual there beyond that of the noise, in variances of the noise.
    settled : float
        Time from which the residual is noise, s, if it is large at first; else NaN.
    """

    experiment: str
    start: float
    end: float
    share: float
    time_share: float
    excess: float
    settled: float = math.nan


def squared_residual(fit: OutputFit) -> Floats:
    """Return shares (K,) of the squared residual, outputs over their medians."""
    squares = _squares(fit)
    total = float(squares.sum())
    return squares / total if 0.0 < total < np.inf else np.zeros(len(fit.times))


def _squares(fit: OutputFit) -> Floats:
    """Return summed squared residuals (K,), outputs over their medians."""
    found = np.zeros(len(fit.times))
    with np.errstate(over="ignore", invalid="ignore"):
        for error, counted in zip((fit.measured - fit.simulated).T, fit.counted.T, strict=True):
            squares = error[counted] ** 2
            scale = (float(np.median(squares)) or float(squares.mean())) if squares.size else 0.0
            if scale > 0.0:
                found[counted] += squares / scale
    return found


def residual_stretch(fit: OutputFit) -> ResidualStretch | None:
    """Return a short stretch with half of the squared residual."""
    rows = np.flatnonzero(fit.counted.any(axis=1))
    if fit.kind != "time" or rows.size < SETTINGS.least_samples:
        return None
    times, shares = fit.times[rows], squared_residual(fit)[rows]
    span = float(times[-1] - times[0])
    summed = np.concatenate([[0.0], np.cumsum(shares)])
    ends = np.searchsorted(summed, summed[:-1] + SETTINGS.share - 1e-12)  # samples begin:end have the share
    begins = np.flatnonzero((ends <= rows.size) & (ends > np.arange(rows.size)))
    if not begins.size or span <= 0.0:
        return None
    lengths = times[ends[begins] - 1] - times[begins]
    begin = int(begins[np.argmin(lengths)])
    end, length = int(ends[begin]), float(lengths.min())
    if length > SETTINGS.time * span:
        return None
    first, last = float(times[begin]), float(times[end - 1])
    squares, counted = SETTINGS.median * _squares(fit)[rows], fit.counted[rows].sum(axis=1)
    settled = math.nan
    if begin <= SETTINGS.time * rows.size:  # the sum of what exceeds twice the noise is largest where noise begins
        above = float(times[min(int(np.argmax(np.cumsum(squares - 2.0 * counted))) + 1, rows.size - 1)])
        settled = float(min(times[0] + SETTINGS.margin * (above - times[0]), times[-1]))
    excess = float((squares - counted)[begin:end].sum())
    share = float(summed[end] - summed[begin])
    return ResidualStretch(fit.experiment, first, last, share, length / span, excess, settled)
