"""A record cut into windows, each with what is simulated before it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.data import Experiment
from fmuid.errors import InputError

# A window begins with the sample that is nearest, to this share of a sampling interval: times are rounded decimals.
STEP_TOLERANCE = 1e-3


@dataclass(frozen=True)
class GrowingRecord:
    """A record that is cut piece by piece, as it grows.

    Attributes
    ----------
    begin : float
        Of its time, s.
    counts : float
        From when on samples count, s.
    windows : int
        Which it was cut into so far.
    grows : bool
        Whether more of it may come.
    """

    begin: float
    counts: float
    windows: int = 0
    grows: bool = False


@dataclass(frozen=True)
class Window:
    """A window of a record.

    Attributes
    ----------
    number : int
        From 0 on.
    lead, start, stop : int
        Rows where the simulation, the window and what follows it begins.
    begin, end : float
        s; `end` is where the next window begins.
    slack : float
        By which samples may lie before `begin` and belong to it, s: times are rounded decimals.
    there : bool
        Whether every output has a sample that counts.
    """

    number: int
    lead: int
    start: int
    stop: int
    begin: float
    end: float
    slack: float
    there: bool


@dataclass(frozen=True)
class SkippedWindow:
    """A window of a record in which no sample of some output counts.

    Attributes
    ----------
    source : str
        Of the record.
    time : float
        Where the window begins, s.
    """

    source: str
    time: float


def split_windows(record: Experiment, window: float | None, transient: float, begun: GrowingRecord) -> list[Window]:
    """Return the windows of a record, or the next ones of a piece of it.

    What is left at the end of the record and shorter than a window is in none.

    Parameters
    ----------
    record : Experiment
    window : float or None
        Their length, s; None for the whole record.
    transient : float
        What is simulated before them, s.
    begun : GrowingRecord

    Raises
    ------
    InputError
        If the record is shorter than a window.
    """
    times = record.times
    step = float(np.median(np.diff(times)))
    slack, last = STEP_TOLERANCE * step, float(times[-1]) + step
    counted = record.counted & (times >= begun.counts)[:, None]
    before = np.vstack([np.zeros(counted.shape[1]), np.cumsum(counted, axis=0)])

    def made(number: int, lead: int, start: int, stop: int) -> Window:
        there = bool((before[stop] > before[start]).all()) and stop - lead > 1
        end = float(times[stop]) if stop < times.size else last
        return Window(number, lead, start, stop, float(times[start]), end, slack, there)

    if window is None:
        return [made(0, 0, 0, times.size)]
    count = math.floor((last - begun.begin + slack) / window) - begun.windows
    if count <= 0 and (begun.grows or begun.windows):
        return []
    if count <= 0:
        raise InputError(
            f"{record.source} lasts {times[-1] - times[0]:g} s, which is shorter than a window of {window:g} s: "
            "make the windows shorter, or the record longer"
        )
    edges = begun.begin + window * np.arange(begun.windows, begun.windows + count + 1)
    borders = np.searchsorted(times, edges - slack)
    leads = np.searchsorted(times, edges - transient - slack)
    rows = zip(leads.tolist(), borders.tolist(), borders[1:].tolist(), strict=False)
    return [made(begun.windows + k, lead, start, stop) for k, (lead, start, stop) in enumerate(rows)]


def part_of(whole: Experiment, windows: Sequence[Window], transient: float) -> Experiment:
    """Return successive windows of a record with what is simulated before them, which does not count."""
    times, lead = whole.times, windows[0].lead
    from_begin = lead == windows[0].start
    left = max(whole.discard, transient) if from_begin else float(times[windows[0].start] - times[lead])
    # with all columns: a fault may have inputs that the healthy machine has not
    return replace(whole, frame=whole.frame.iloc[lead : windows[-1].stop], discard=left)
