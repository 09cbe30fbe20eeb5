"""Time scale of a recording: times in ms taken for s.

The time constants of the model are those of its response to inputs that jump to their largest values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import Experiment, usual_step
from fmuid.simulation import Simulator


@dataclass(frozen=True)
class TimeScaleSettings:
    """Numbers of the comparison."""

    longest: float = 1000.0  # time constants; a longer recording, with each step longer than one, is doubted
    shortest: float = 20.0  # recordings in a time constant; a usual one lasts ten to a hundred time constants
    moves: float = 0.2  # of the measured range; a model that moves less within the recording may be too slow
    longer: tuple[float, ...] = (10.0, 100.0, 1e3, 1e4)  # factors that prolong a recording until the model settles
    left: float = 0.37  # fraction of the way after a time constant
    settled: float = 0.3  # fraction of a simulation in which a model settles


SETTINGS = TimeScaleSettings()


class TimeScaleMismatch(Enum):
    """Mismatch of a recording and the time constants of its model."""

    TOO_LONG = "too_long"
    TOO_SHORT = "too_short"


@dataclass(frozen=True)
class TimeScaleWarning:
    """Recording whose time may be in another unit."""

    kind: TimeScaleMismatch
    source: str  # the data file
    duration: float  # of the recording, s
    step: float  # median, s
    time_constant: float  # of the model, s: the slowest if the recording is too long, else the fastest


def doubt_of_time(simulator: Simulator, theta: Sequence[float]) -> TimeScaleWarning | None:
    """Compare a recording with the time constants of its model at theta.

    None without mismatch, or if the model does not settle or cannot be simulated.
    """
    simulator = simulator.of_model
    record = simulator.experiment
    duration, step = float(record.times[-1] - record.times[0]), usual_step(record.times)
    times, values = _response(simulator, theta, duration)
    constants = _constants(times, values)
    if constants.size and np.isfinite(constants).all():
        slowest = float(constants.max())
        if duration > SETTINGS.longest * slowest and step > slowest:
            return TimeScaleWarning(TimeScaleMismatch.TOO_LONG, record.source, duration, step, slowest)
    if np.isfinite(constants).any() or not values.size or _moves(values, record):
        return None
    for factor in SETTINGS.longer:
        found = _constants(*_response(simulator, theta, factor * duration))
        if np.isfinite(found).any():
            fastest = float(np.nanmin(found))
            if fastest > SETTINGS.shortest * duration:
                return TimeScaleWarning(TimeScaleMismatch.TOO_SHORT, record.source, duration, step, fastest)
            return None
    return None


def _response(simulator: Simulator, theta: Sequence[float], duration: float) -> tuple[Floats, Floats]:
    """Return times (n,) after an input jump, and outputs (n, m)."""
    record = simulator.experiment
    after = np.concatenate([[0.0], duration * np.logspace(-7, 0, 150)])
    names = {name: f"input {k}" for k, name in enumerate(record.input_names)}
    pairs = zip(names.values(), record.input_values.T, strict=True)
    columns = {name: values[np.abs(values).argmax()] for name, values in pairs}
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
    """Return time constants of moving outputs, NaN where they do not settle."""
    found = []
    for y in values.T:
        away = np.abs(y - y[-1])
        if away.max() > 1e-6 * np.abs(y).max():
            settled = float(times[np.flatnonzero(away > SETTINGS.left * away.max())[-1] + 1])
            found.append(settled if settled < SETTINGS.settled * times[-1] else np.nan)
    return np.array(found)


def _moves(values: Floats, record: Experiment) -> bool:
    """Tell if an output moves about as much as measured."""
    if not record.measured:
        return True
    with np.errstate(over="ignore"):  # numbers beyond all measure move
        measured = np.nanstd(record.output_values, axis=0)
    return bool((np.ptp(values, axis=0) > SETTINGS.moves * measured).any())
