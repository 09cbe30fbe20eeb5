"""Operations on the data before the fit, in one order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Literal, TypeVar

import numpy as np
import pandas as pd
from annotated_types import Gt

from fmuid.array_types import Floats
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.data_file import UNITS, numeric_column
from fmuid.data.experiment import Experiment
from fmuid.data.expressions import evaluate
from fmuid.data.filters import detrended, filled, low_passed, resampled, with_missing_rows
from fmuid.data.interpolation import HELD, interpolation_words
from fmuid.data.signals import inverse_park, park_transform
from fmuid.errors import InputError
from fmuid.units import parse_unit, unit_in_name

Table = TypeVar("Table", pd.DataFrame, Experiment)
TRENDS = {"mean": 0, "linear": 1}
"""What `detrend` takes away, by the degree of the polynomial."""
FILLS = ("linear", "zoh")
"""How `fill` goes over a gap: on a straight line, or by the sample before it."""


@dataclass(frozen=True)
class ParkTransform:
    """Park transform of three phases, or its inverse (docs/method/induction-machine.md).

    Examples
    --------
    >>> phases = {"ia": [3.0, 3.0], "ib": [-1.5, -1.5], "ic": [-1.5, -1.5]}
    >>> table = pd.DataFrame({"time": [0.0, 0.1], "w": [0.0, 0.0], **phases})
    >>> axes = fmuid.data.ParkTransform(("ia", "ib", "ic"), ("id", "iq"), speed="w", pole_pairs=2)
    >>> fmuid.data.preprocess(table, fmuid.data.Preprocessing(park=(axes,)))["id"].round(3).tolist()
    [3.674, 3.674]
    """

    source: tuple[str, ...]
    """columns of three phases, or of two axes"""
    target: tuple[str, ...]
    """new columns: two axes, or three phases"""
    angle: str | None = None
    """column of the angle, rad by default; without it, speed is integrated"""
    speed: str | None = None
    """column of the speed, rad/s by default"""
    pole_pairs: Annotated[float, Gt(0)] = 1.0
    """factor on angle and speed; 1 for electrical ones"""
    initial_angle: float = 0.0
    """initial electrical angle of the integration, rad"""

    def __post_init__(self) -> None:
        if sorted((len(self.source), len(self.target))) != [2, 3]:
            raise InputError("source and target: give three phases and two axes, or the reverse.")
        if (self.angle is None) == (self.speed is None):
            raise InputError(f"axes {', '.join(self.target)} need an angle or a speed. Name one column.")


@dataclass(frozen=True)
class Preprocessing:
    """What is done with the data, in this order."""

    computed_columns: Mapping[str, str] = field(default_factory=dict)
    """computed columns, { x = "pulses * 35.1 + vir" }"""
    fill_missing: Mapping[str, Literal["linear", "zoh"]] = field(default_factory=dict)
    """inputs with missing samples to fill, { u = "zoh" }"""
    max_gap: Annotated[float, Gt(0)] | None = None
    """longest gap to fill, s; default: 20 sampling intervals"""
    park: tuple[ParkTransform, ...] = ()
    """Park transform of phases to rotating axes, or back"""
    lowpass_frequency: Annotated[float, Gt(0)] | None = None
    """cutoff frequency of a zero-phase low-pass filter, Hz"""
    start_time: float | None = None
    """s: the data are kept from there"""
    end_time: float | None = None
    """s: and up to there"""
    resample_interval: Annotated[float, Gt(0)] | None = None
    """step of time, s"""
    detrend: Literal["mean", "linear"] | Mapping[str, Literal["mean", "linear"]] | None = None
    """trend removed from inputs and outputs"""

    def __post_init__(self) -> None:
        if self.start_time is not None and self.end_time is not None and self.end_time < self.start_time:
            raise InputError(f"start_time = {self.start_time:g} is after end_time = {self.end_time:g}.")
        if self.max_gap is not None and not self.fill_missing:
            raise InputError('max_gap needs fill_missing, such as { u = "linear" }.')

    @property
    def by_rows(self) -> bool:
        """Whether each row depends on itself alone."""
        return self._asked <= {"computed_columns", "park"} and all(each.angle is not None for each in self.park)

    @property
    def _asked(self) -> set[str]:
        """Fields with a value."""
        return {each.name for each in fields(Preprocessing) if getattr(self, each.name) not in (None, {}, ())}

    def applied(
        self,
        frame: pd.DataFrame,
        time: str,
        source: str,
        signals: Iterable[str] | None = None,
        interpolation: Mapping[str, str] | None = None,
    ) -> pd.DataFrame:
        """Return a preprocessed frame; `signals` are filtered, resampled and detrended, by default all numeric ones."""
        if not self._asked:
            return frame
        work, between = _Work(frame, time, source), interpolation or {}
        work.derive(self.computed_columns)
        work.fill(self)
        for each in self.park:
            work.turn(each)
        names = work.signals(signals)
        if self.lowpass_frequency is not None:
            for column in names:
                if between.get(column) in HELD:
                    said = f'{column!r} has interpolation = "zoh"'
                    raise InputError(f"{source}: lowpass_frequency: {said}. Remove one of the two.")
            work.put(names, low_passed(work.times, work.values(names), self.lowpass_frequency, source))
        work.cut(self.start_time, self.end_time)
        if self.resample_interval is not None:
            how = [between.get(column, "linear") for column in names]
            times, values = resampled(work.times, work.values(names), how, self.resample_interval, source)
            work.frame = pd.DataFrame({time: times} | dict(zip(names, values.T, strict=True)))
        work.detrend(names, self.detrend)
        units = {column: unit for column, unit in work.units.items() if column in work.frame.columns}
        work.frame.attrs = {**frame.attrs, UNITS: units}
        return work.frame


class _Work:
    """Data in progress."""

    def __init__(self, frame: pd.DataFrame, time: str, source: str) -> None:
        self.frame, self.time, self.source = frame.copy(), time, source
        self.units: dict[str, str] = dict(frame.attrs.get(UNITS, {}))
        if time not in frame.columns:
            raise InputError(f"{source}: {missing_column('time', time, frame.columns)}")
        times = self.times
        if not (np.isfinite(times).all() and (np.diff(times) >= 0).all() and times.size > 1 and times[-1] > times[0]):
            raise InputError(f"{source}: time column {time!r} must be finite and never decrease. Sort the rows.")

    @property
    def times(self) -> Floats:
        return numeric_column(self.frame, self.time, self.source)

    def column(self, name: str) -> Floats:
        found = column_of(self.frame.columns, name)
        if found is None:
            raise InputError(f"{self.source}: {missing_column('preprocessed', name, self.frame.columns)}")
        return numeric_column(self.frame, found, self.source)

    def unit(self, name: str) -> str | None:
        column = column_of(self.frame.columns, name) or ""
        return self.units.get(column) or unit_in_name(column)

    def values(self, names: Sequence[str]) -> Floats:
        return np.column_stack([self.column(name) for name in names]) if names else np.empty((len(self.frame), 0))

    def signals(self, asked: Iterable[str] | None) -> list[str]:
        if asked is not None:
            found = dict.fromkeys(column_of(self.frame.columns, each) for each in asked)
            return [each for each in found if each is not None and each != self.time]
        names = map(str, self.frame.columns)
        return [each for each in names if each != self.time and pd.api.types.is_numeric_dtype(self.frame[each].dtype)]

    def put(self, names: Sequence[str], values: Floats) -> None:
        self.frame = self.frame.assign(**dict(zip(names, values.T, strict=True)))

    def derive(self, columns: Mapping[str, str]) -> None:
        for name, expression in columns.items():
            if name == self.time:
                raise InputError(f"{self.source}: computed_columns: time {name!r} cannot be computed. Rename it.")
            try:
                values = evaluate(expression, self.column, len(self.frame))
            except InputError as error:
                why = str(error).removeprefix(f"{self.source}: ")
                raise InputError(f"{self.source}: column {name!r}: {why}") from None
            self.put([name], np.where(np.isfinite(values), values, np.nan)[:, None])

    def fill(self, asked: Preprocessing) -> None:
        if asked.fill_missing:
            times, rows = with_missing_rows(self.times, asked.max_gap or 0.0)
            self.frame = self.frame.reset_index(drop=True).reindex(rows).reset_index(drop=True)
            self.put([self.time], times[:, None])
        within = _kept(self.times, asked.start_time, asked.end_time)
        for name, how in asked.fill_missing.items():
            if how not in FILLS:
                raise InputError(f'{self.source}: fill_missing: unknown value {how!r}. Choose "linear" or "zoh".')
            values, called = self.column(name), f"{self.source}: column {name!r}"
            found = column_of(self.frame.columns, name) or name
            self.put([found], filled(self.times, values, how, asked.max_gap, within, called)[:, None])

    def turn(self, axes: ParkTransform) -> None:
        unit = {self.unit(name) for name in axes.source}
        if len(unit) > 1:
            said = ", ".join(f"{name} in {self.unit(name) or 'no unit'}" for name in axes.source)
            raise InputError(f"{self.source}: park: units differ ({said}). Give transformed columns one unit.")
        names = [column_of(self.frame.columns, name) or name for name in axes.source]
        angle = "\0"
        frame = self.frame.assign(**{angle: self._angle(axes)})
        turned = (park_transform if len(names) == 3 else inverse_park)(frame, names, axes.target, angle)
        self.frame = turned.drop(columns=angle)
        if (shared := unit.pop()) is not None:
            self.units |= dict.fromkeys(axes.target, shared)

    def _angle(self, axes: ParkTransform) -> Floats:
        """Return the electrical angle, rad."""
        if axes.angle is not None:
            return axes.pole_pairs * self._in("rad", axes.angle)
        assert axes.speed is not None
        speed = axes.pole_pairs * self._in("rad/s", axes.speed)
        if not np.isfinite(speed).all():
            row = int(np.flatnonzero(~np.isfinite(speed))[0]) + 1
            raise InputError(f"{self.source}: speed {axes.speed!r} has no value in row {row}. Fill it to integrate it.")
        steps = np.diff(self.times) * (speed[1:] + speed[:-1]) / 2
        return np.asarray(axes.initial_angle + np.concatenate([[0.0], np.cumsum(steps)]))

    def _in(self, unit: str, name: str) -> Floats:
        """Return a column converted to a unit."""
        values, said = self.column(name), self.unit(name)
        given, wanted = parse_unit(said or unit), parse_unit(unit)
        if given is None or wanted is None or given.exponents != wanted.exponents:
            raise InputError(f"{self.source}: column {name!r} is in {said}, not convertible to {unit}.")
        return np.asarray(given.factor / wanted.factor * values)

    def cut(self, start: float | None, end: float | None) -> None:
        times = self.times
        lower, upper = _kept(times, start, end)
        kept = (times >= lower) & (times <= upper)
        if kept.sum() < 2:
            asked = "" if start is None else f"from {start:g}"
            asked += "" if end is None else f" to {end:g}"
            said = f"{asked.strip()} s leaves {kept.sum()} samples; data are from {times[0]:.6g} to {times[-1]:.6g} s"
            raise InputError(f"{self.source}: {said}. Change start_time or end_time.")
        if not kept.all():
            self.frame = self.frame[kept].reset_index(drop=True)

    def detrend(self, names: Sequence[str], asked: str | Mapping[str, str] | None) -> None:
        if asked is None:
            return
        each = asked if isinstance(asked, Mapping) else dict.fromkeys(names, asked)
        for name, how in each.items():
            if how not in TRENDS:
                raise InputError(f'{self.source}: detrend: unknown value {how!r}. Choose "mean" or "linear".')
            found = column_of(self.frame.columns, name) or name
            self.put([found], detrended(self.times, self.column(name)[:, None], TRENDS[how]))


def _kept(times: Floats, start: float | None, end: float | None) -> tuple[float, float]:
    """Return the first and last time to keep, with rounding."""
    tolerance = 1e-9 * float(times[-1] - times[0])
    return (-math.inf if start is None else start - tolerance), (math.inf if end is None else end + tolerance)


def preprocess(given: Table, preparation: Preprocessing, *, time: str = "time") -> Table:
    """Preprocess a frame or the data of an experiment.

    Parameters
    ----------
    given : DataFrame or Experiment
        Only inputs and outputs of an experiment are filtered, resampled and detrended.
    preparation : Preprocessing
        Operations.
    time : str
        Time column of a frame, s.

    Returns
    -------
    DataFrame or Experiment
        New object of the given kind.

    Raises
    ------
    InputError
        If the data do not allow an operation.

    Examples
    --------
    >>> frame = pd.DataFrame({"time": [0.0, 0.1, 0.2, 0.3], "pulses": [0.0, 2.0, 4.0, 6.0]})
    >>> how = fmuid.data.Preprocessing({"x": "pulses / 2 + 1"}, start_time=0.1, resample_interval=0.2)
    >>> fmuid.data.preprocess(frame, how)["x"].tolist()
    [2.0, 4.0]
    """
    if not isinstance(given, Experiment):
        return preparation.applied(given, time, "the frame")
    driven = {name: given.columns[name] for name in given.input_names}
    words = interpolation_words(given.source, given.interpolation, driven)
    between = dict(zip(driven.values(), words, strict=True))
    raw = () if given.observation is None else given.observation.columns
    columns = itertools.chain(given.columns.values(), raw)
    frame = preparation.applied(given.frame, given.time, given.source, columns, between)
    return replace(given, frame=frame)
