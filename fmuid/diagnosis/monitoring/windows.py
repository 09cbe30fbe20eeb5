"""A record cut into windows, each with what is simulated before it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fmuid.arrays import Floats
from fmuid.data import Experiment
from fmuid.errors import InputError

# A window begins with the sample that is nearest, to this share of a sampling interval: times are rounded decimals.
STEP_TOLERANCE = 1e-3


def cut(record: Experiment, window: float | None, transient: float) -> list[tuple[int, int, int]]:
    """Return the windows as rows of the table: where the simulation, the window and what follows it begins.

    What is left at the end of the record and shorter than a window is in none.

    Parameters
    ----------
    record : Experiment
    window : float or None
        Their length, s; None for the whole record.
    transient : float
        What is simulated before them, s.

    Raises
    ------
    InputError
        If the record is shorter than a window.
    """
    times = record.times
    if window is None:
        return [(0, 0, times.size)]
    slack = STEP_TOLERANCE * _step(times)
    count = math.floor((end_of(times, times.size) - times[0] + slack) / window)
    if count == 0:
        raise InputError(
            f"{record.source} lasts {times[-1] - times[0]:g} s, which is shorter than a window of {window:g} s: "
            "make the windows shorter, or the record longer"
        )
    edges = times[0] + window * np.arange(count + 1)
    borders = np.searchsorted(times, edges - slack)
    leads = np.searchsorted(times, edges - transient - slack)
    return [(int(leads[k]), int(borders[k]), int(borders[k + 1])) for k in range(count)]


def part_of(
    whole: Experiment, lead: int, start: int, stop: int, discard: float = 0.0, transient: float = 0.0
) -> Experiment | None:
    """Return a window with what is simulated before it; None if an output has no sample that counts.

    Parameters
    ----------
    whole : Experiment
        The record.
    lead, start, stop : int
        Where the simulation, the window and what follows it begins, as `cut` gave them.
    discard, transient : float
        The longer of both is left out at the beginning of a window with nothing before it, s.
    """
    times = whole.times
    left = max(discard, transient) if lead == start else float(times[start] - times[lead])
    there = ~np.isnan(whole.output_values[start:stop])
    if lead == start:
        there &= (times[start:stop] >= times[start] + left)[:, None]
    if stop - lead < 2 or not there.any(axis=0).all():
        return None
    names = list(dict.fromkeys(whole.columns.values()))
    frame = whole.frame.iloc[lead:stop][[whole.time, *names]]
    return replace(whole, frame=frame, discard=left)


def end_of(times: Floats, stop: int) -> float:
    """Return where the sample before row `stop` ends, s: where the next one is or would be."""
    return float(times[stop] if stop < times.size else times[-1] + _step(times))


def _step(times: Floats) -> float:
    return float(np.median(np.diff(times)))
