"""Whether a record lasts as long as what its model does: times in ms that are taken for s make it 1000 times longer.

The model's time constants are read off its response to inputs that jump to the largest values of the record and stay
there, from its start on: after which time an output stays within 37 % of its way to where it ends, which is the time
constant where there is one. An output that does not settle tells nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.simulation import Simulator

TOO_LONG = 1000.0
"""A record that lasts so many time constants, with each step longer than one, is doubted ..."""
TOO_SHORT = 20.0
"""... and one of which so many go into a time constant: a thousandth of a usual record, of some ten to a hundred."""
MOVES = 0.2
"""Only where the model moves within the record by less than this share of what was measured it may be too short."""
LONGER = (10.0, 100.0, 1e3, 1e4)
"""By how much a record is prolonged to see where a model settles that hardly moves in it."""
_LEFT, _SETTLED = 0.37, 0.3
"""Share of the way that is left after a time constant, and share of a simulation in which what settles does so."""
_DECADES, _POINTS = 7, 150


class TimeScaleMismatch(Enum):
    """What a record is against the time constants of its model."""

    TOO_LONG = "too_long"
    TOO_SHORT = "too_short"


@dataclass(frozen=True)
class TimeScaleWarning:
    """A record whose time is perhaps in another unit.

    Attributes
    ----------
    kind : TimeScaleMismatch
    source : str
        The table.
    duration, step : float
        Of the record, s; the step is the median one.
    time_constant : float
        Of the model, s: the slowest that its outputs show where the record is too long, else the fastest.
    """

    kind: TimeScaleMismatch
    source: str
    duration: float
    step: float
    time_constant: float


def doubt_of_time(simulator: Simulator, theta: Sequence[float]) -> TimeScaleWarning | None:
    """Compare a record with the time constants of its model, by one simulation, or a few where hardly anything moves.

    Parameters
    ----------
    simulator : Simulator
        Of the record.
    theta : sequence of float
        Its parameters.

    Returns
    -------
    TimeScaleWarning or None
        None where the record is of the model's time scale, or where the model does not settle or cannot be simulated.
    """
    record = simulator.experiment
    duration, step = float(record.times[-1] - record.times[0]), float(np.median(np.diff(record.times)))
    times, values = _response(simulator, theta, duration)
    constants = _constants(times, values)
    if constants.size and np.isfinite(constants).all():
        slowest = float(constants.max())
        if duration > TOO_LONG * slowest and step > slowest:
            return TimeScaleWarning(TimeScaleMismatch.TOO_LONG, record.source, duration, step, slowest)
    if np.isfinite(constants).any() or not values.size or _moves(values, record):
        return None
    for factor in LONGER:
        found = _constants(*_response(simulator, theta, factor * duration))
        if np.isfinite(found).any():
            fastest = float(np.nanmin(found))
            if fastest > TOO_SHORT * duration:
                return TimeScaleWarning(TimeScaleMismatch.TOO_SHORT, record.source, duration, step, fastest)
            return None
    return None


def _response(simulator: Simulator, theta: Sequence[float], duration: float) -> tuple[Floats, Floats]:
    """Return times (n,) after a jump of the inputs, closest at first, and outputs (n, m), none where that fails."""
    record = simulator.experiment
    after = np.concatenate([[0.0], duration * np.logspace(-_DECADES, 0, _POINTS)])
    largest = np.abs(record.input_values).argmax(axis=0) if record.input_names else np.zeros(0, dtype=np.intp)
    names = {name: f"input {k}" for k, name in enumerate(record.input_names)}
    columns = {names[name]: record.input_values[largest[k], k] for k, name in enumerate(record.input_names)}
    jump = Experiment(
        pd.DataFrame({"time": record.times[0] + after, **columns}),
        names,
        list(record.output_names),
        interpolation="zoh",
        units=dict(record.units),
        values=record.values,
        measured=False,
        source=record.source,
    )
    found = simulator.over(jump).many([list(theta)])
    return after, np.empty((0, 0)) if found.errors[0] is not None else found.outputs[0]


def _constants(times: Floats, values: Floats) -> Floats:
    """Return the time constant of each output that moves, NaN where it does not settle."""
    found = []
    for y in values.T:
        away = np.abs(y - y[-1])
        if away.max() > 1e-6 * np.abs(y).max():
            settled = float(times[np.flatnonzero(away > _LEFT * away.max())[-1] + 1])
            found.append(settled if settled < _SETTLED * times[-1] else np.nan)
    return np.array(found)


def _moves(values: Floats, record: Experiment) -> bool:
    """Return whether an output moves in a simulation about as much as it was measured to."""
    if not record.measured:
        return True
    with np.errstate(over="ignore"):  # numbers beyond all measure move
        measured = np.nanstd(record.output_values, axis=0)
    return bool((np.ptp(values, axis=0) > MOVES * measured).any())
