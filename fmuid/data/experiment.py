"""Experiments: data files with the roles of their columns."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.data_file import DECIDED, LEFT_OUT, SOURCE, UNITS, numeric_column
from fmuid.data.far_values import check_values
from fmuid.data.filters import filling_keys, missing_rows, usual_step
from fmuid.data.interpolation import HELD, as_held, interpolation_words, slopes
from fmuid.data.observation import Observation
from fmuid.data.observed_table import model_roles, observed_table
from fmuid.data.sensor_map import SensorMap
from fmuid.data.several_clocks import inputs_at_all_times
from fmuid.display_mixins import HtmlTableMixin
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.units import unit_in_name


@dataclass(frozen=True, eq=False)
class Experiment(HtmlTableMixin):
    """Measured data with roles: model inputs and measured outputs.

    Checked and copied on construction; arrays are read-only. Messages count rows from 1, without the header.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per sample, K >= 2 rows; the index may be the time.
    inputs, outputs : sequence of str, or mapping of str to str
        FMU variables, or FMU variables to columns. Inputs are finite; outputs may have missing samples (NaN).
    time : str
        Time column, s, never decreasing. A time given twice is a step. No 20 rows in a row may be missing.
    interpolation : str or mapping of str to str
        Interpolation of all inputs or of each (docs/method/simulation.md).
    warmup : float
        Initial time that is simulated but not scored, s (1.32).
    units : mapping of str to str
        FMU variable to the unit of its column, where neither FMU nor data file has it.
    values : mapping of str to float, int, bool or str
        FMU variables held at a value.
    measured : bool
        False: outputs without a column count at all times, with NaN as value.
    name : str
        Name in results.
    source : str
        Name of the data in messages. Default: their file.
    observation : Observation, optional
        Phase signals of a machine in rotating axes: outputs are the readings of the current sensors.

    Attributes
    ----------
    input_values : ndarray (K, n_inputs)
        In the units of the data; with zero-order hold from each sample on.
    output_values : ndarray (K, n_outputs)
        In the units of the data, NaN where missing.
    counted : ndarray of bool (K, n_outputs)
        Scored samples.

    Raises
    ------
    InputError
        If an argument or a sample is wrong.

    Examples
    --------
    >>> table = pd.DataFrame({"time": [0.0, 0.1, 0.2], "u": [0.0, 12.0, 12.0], "i": [0.0, 0.6, np.nan]})
    >>> fmuid.Experiment(table, inputs=["u"], outputs=["i"], interpolation="zoh")
    Experiment('experiment', 3 samples, 0 to 0.2 s, u → i)
    """

    # what a row is: a sample in time, or as in `fmuid.data.SteadyExperiment`; without annotation these are no fields
    kind, least_rows = "time", 2
    frame: pd.DataFrame
    inputs: Sequence[str] | Mapping[str, str] = ()
    outputs: Sequence[str] | Mapping[str, str] = ()
    time: str = "time"
    interpolation: str | Mapping[str, str] = "linear"
    warmup: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    measured: bool = True
    name: str = "experiment"
    source: str = ""
    observation: Observation | None = None
    input_values: Floats = field(init=False, repr=False)
    output_values: Floats = field(init=False, repr=False)
    counted: Flags = field(init=False, repr=False)

    @property
    def design(self) -> str:
        """Everything that a kind of experiments adds, as text."""
        return ""

    @property
    def made_columns(self) -> frozenset[str]:
        """Columns that are not of the data."""
        return frozenset()

    @property
    def axis(self) -> dict[str, Floats]:
        """First columns of tables of outputs, (K,) each."""
        return {"time": self.times}

    @property
    def smooth_over(self) -> Floats | None:
        """Coordinate (K,) over which outputs are smooth; None without one."""
        return self.times

    def readings(self, output: str) -> Floats:
        """Return the magnitude (K,) of each sample of an output."""
        return np.asarray(np.abs(self.output_values[:, self.output_names.index(output)]))

    @cached_property
    def times(self) -> Floats:
        """Times (K,), s."""
        return _frozen(_times(self.source, self.frame, self.time, self.least_rows))

    @cached_property
    def sensor_map(self) -> SensorMap | None:
        """Map of the observation over these data, made with them; None without one."""
        return None

    @cached_property
    def columns(self) -> dict[str, str]:
        """FMU variable to column, inputs first."""
        return _roles(self.source, "inputs", self.inputs) | _roles(self.source, "outputs", self.outputs)

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """FMU variables."""
        return tuple(self.inputs)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """FMU variables."""
        return tuple(self.outputs)

    def _interpolated(self, *words: str) -> Flags:
        given = interpolation_words(self.source, self.interpolation, _roles(self.source, "inputs", self.inputs))
        return _frozen(np.array([word in words for word in given], dtype=np.bool_))

    @cached_property
    def held(self) -> Flags:
        """Inputs with zero-order hold (n_inputs,)."""
        return self._interpolated(*HELD)

    @cached_property
    def curved(self) -> Flags:
        """Inputs with interpolation ``"pchip"`` (n_inputs,)."""
        return self._interpolated("pchip")

    @cached_property
    def input_slopes(self) -> Floats:
        """Slopes (K, n_inputs) of ``"pchip"`` inputs, data units per s; else NaN."""
        return _frozen(slopes(self.source, self.times, self.input_values, self.curved))

    def __repr__(self) -> str:
        span = f"{self.times[0]:g} to {self.times[-1]:g} s"
        roles = f"{', '.join(self.input_names)} → {', '.join(self.output_names)}"
        return f"Experiment({self.name!r}, {len(self.times)} samples, {span}, {roles})"

    def __post_init__(self) -> None:
        attributes = getattr(self.frame, "attrs", {})
        source = self.source or str(attributes.get(SOURCE, "the table"))
        inputs, outputs = _roles(source, "inputs", self.inputs), _roles(source, "outputs", self.outputs)
        for variable in (each for each in inputs if each in outputs):
            raise InputError(f"{source}: {variable!r} is both input and output. Give it one role.")
        frame = _frame(source, self.frame, self.time)
        if self.observation is not None and self.kind != "time":
            raise InputError(f"{source}: observation: rows are {self.kind}. Only samples in time have phase signals.")
        if self.observation is not None and self.time in frame.columns:
            frame, inputs, outputs = self._observed(source, frame, inputs, outputs)
        for roles in (inputs, outputs):
            roles.update({name: column_of(frame.columns, column) or column for name, column in roles.items()})
        there = outputs if self.measured else {name: c for name, c in outputs.items() if c in frame.columns}
        for role, columns in {"time": [self.time], "input": inputs.values(), "output": there.values()}.items():
            for column in columns:
                if column not in frame.columns:
                    known = frame.columns.difference([*self.made_columns], sort=False)
                    said = missing_column(role, column, known, left_out=attributes.get(LEFT_OUT))
                    raise InputError(f"{source}: {said}")
        words = interpolation_words(source, self.interpolation, inputs)
        for column in {*inputs.values(), *there.values()} if SOURCE in attributes and DECIDED not in attributes else ():
            check_values(numeric_column(frame, column, source), column, source)
        driven = dict(zip(inputs.values(), words, strict=True))
        frame = inputs_at_all_times(frame, self.time, driven if self.kind == "time" else {}, there.values(), source)
        times = _times(source, frame, self.time, self.least_rows)
        output_values = _values(source, frame, times, "output", outputs, there)
        if inputs and self.measured:
            _check_rows(source, times, inputs, words)
        input_values = as_held(_values(source, frame, times, "input", inputs, inputs), words)
        units = _units(source, self.units, inputs | outputs, frame.attrs.get(UNITS, {}))
        counted = _counted(source, times, output_values, outputs, there, self.warmup)
        self._set(source=source, frame=frame, inputs=inputs, outputs=outputs, units=units)
        self._set(times=times, input_values=input_values, output_values=output_values, counted=counted)
        _ = self.input_slopes  # which may be refused

    def _observed(
        self, source: str, frame: pd.DataFrame, inputs: dict[str, str], outputs: dict[str, str]
    ) -> tuple[pd.DataFrame, dict[str, str], dict[str, str]]:
        """Return frame and roles with the columns of an observation."""
        given, words = self.observation, self.interpolation
        assert given is not None, "asked before"
        word = words if isinstance(words, str) else words.get(next(iter(given.voltages), ""), "linear")
        if word == "zoh-next":
            raise InputError(f'{source}: interpolation: phase voltages cannot be "zoh-next". Use "zoh" or "linear".')
        found = observed_table(
            given, source, frame, _times(source, frame, self.time, self.least_rows), (inputs, outputs), word in HELD
        )
        self._set(sensor_map=found.map)
        return found.frame, found.inputs, found.outputs

    @cached_property
    def of_model(self) -> Experiment:
        """The experiment in the machine's variables: currents of the axes in place of sensors."""
        if self.observation is None or self.sensor_map is None:
            return self
        roles = {name: self.columns[name] for name in self.output_names}
        outputs, values = model_roles(self.observation, roles, self.output_values, self.sensor_map)
        frame = self.frame.assign(**dict(zip(outputs.values(), values.T, strict=True)))
        other, own = copy.copy(self), self.observation
        for name in ("columns", "output_names", "of_model"):
            vars(other).pop(name, None)
        units = {name: unit for name, unit in self.units.items() if name not in own.current_sensors}
        units |= dict.fromkeys(own.currents, "A")
        other._set(observation=None, sensor_map=None, frame=frame, outputs=outputs, units=units, warmup=0.0)
        other._set(output_values=values, counted=~np.isnan(values))
        return other

    @classmethod
    def of_arrays(cls, name: str, times: Floats, outputs: Sequence[str], values: Floats, counted: Flags) -> Self:
        """Return unchecked measurements without inputs; arrays as the attributes."""
        made, empty = cls.__new__(cls), np.empty((len(times), 0))
        frame = pd.DataFrame({"time": times} | dict(zip(outputs, values.T, strict=True)))
        made._set(frame=frame, inputs={}, outputs=dict(zip(outputs, outputs, strict=True)), units={}, values={})
        made._set(observation=None, sensor_map=None)
        made._set(name=name, source="the table", times=times, input_values=empty, output_values=values, counted=counted)
        return made

    def with_outputs(self, values: npt.ArrayLike) -> Self:
        """Return the experiment with other measurements.

        Parameters
        ----------
        values : (K, n_outputs) array
            In the units of the data, NaN where missing.

        Raises
        ------
        InputError
            If the shape differs, a value is infinite, or an output has no scored sample.
        """
        given = np.array(values, dtype=np.float64, order="C")
        if given.shape != self.output_values.shape or np.isinf(given).any():
            said = f"of shape {self.output_values.shape}, not {given.shape}"
            raise InputError(f"{self.source}: outputs must be finite or NaN, {said}.")
        taken = [self.time, *self.columns.values()]
        # a column that another variable reads, too, stays
        own = {name: self.columns[name] for name in self.output_names}
        outputs = {name: column if taken.count(column) == 1 else f"{column} as {name}" for name, column in own.items()}
        counted = _counted(self.source, self.times, given, outputs, outputs, self.warmup)
        frame = self.frame.assign(**{column: given[:, k] for k, column in enumerate(outputs.values())})
        other = copy.copy(self)
        for name in ("columns", "of_model"):
            vars(other).pop(name, None)
        other._set(frame=frame, outputs=outputs, measured=True, output_values=given, counted=counted)
        return other

    def with_inputs(self, values: Floats) -> Self:
        """Return the experiment with other inputs (K, n_inputs), unchecked; its columns stay."""
        other = copy.copy(self)
        for name in ("input_slopes", "of_model"):
            vars(other).pop(name, None)
        other._set(input_values=values)
        return other

    def with_columns(self, columns: Mapping[str, Floats]) -> Experiment:
        """Return the experiment with other values (K,) of columns."""
        return replace(self, frame=self.frame.assign(**columns))

    def _set(self, **fields: object) -> None:
        """Set fields of the frozen class; arrays become read-only."""
        for name, value in fields.items():
            object.__setattr__(self, name, _frozen(value) if isinstance(value, np.ndarray) else value)


def _frozen(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    values.setflags(write=False)
    return values


def _roles(source: str, word: str, given: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Return FMU variables to columns."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f'{source}: {word} = {given!r} is no list. Give names, such as ["u", "w"].')
    roles: dict[str, str] = {}
    for variable, column in given.items() if isinstance(given, Mapping) else zip(given, given, strict=True):
        if not isinstance(variable, str) or not isinstance(column, str):
            raise InputError(f"{source}: {word}: {variable!r} = {column!r} is no name. Name variables and columns.")
        if variable in roles:
            raise InputError(f"{source}: {word}: {variable!r} is given twice. Remove one.")
        roles[variable] = column
    return roles


def _frame(source: str, given: pd.DataFrame, time: str) -> pd.DataFrame:
    """Return a copy of the frame with the time as a column."""
    if not isinstance(given, pd.DataFrame):
        raise InputError(f"{source}: type {type(given).__name__}. Give a pandas DataFrame.")
    frame = given.copy()
    if time not in frame.columns and frame.index.name == time:
        frame = frame.reset_index()
    twice = frame.columns[frame.columns.duplicated()]
    if len(twice):
        raise InputError(f"{source}: column {twice[0]!r} occurs twice. Rename or remove one.")
    return frame


def _times(source: str, frame: pd.DataFrame, time: str, least: int) -> Floats:
    """Return the checked time column."""
    times = np.array(numeric_column(frame, time, source))
    column = f"{source}: time column {time!r}"
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        raise InputError(f"{column}: {times[bad[0]]} in row {bad[0] + 1}. Give every row a time in seconds.")
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0)
    if back.size:
        before, after = times[back[0] : back[0] + 2]
        said = f"row {back[0] + 2} goes back from {before:.9g} s to {after:.9g} s"
        again = after <= times[: back[0] + 1].min()  # sorted rows of two runs would alternate
        raise InputError(f"{column}: {said}. {'Split the data there' if again else 'Sort the rows or split the data'}.")
    thrice = np.flatnonzero((steps[:-1] == 0) & (steps[1:] == 0))
    if thrice.size:
        said = f"{times[thrice[0]]:.9g} s more than twice from row {thrice[0] + 1}"
        raise InputError(f"{column}: {said}. Keep the rows before and after the step.")
    if times.size < least or (times.size > 1 and times[0] == times[-1]):
        raise InputError(f"{column}: fewer than two different times. Give longer data.")
    return times


def _check_rows(source: str, times: Floats, inputs: Mapping[str, str], words: Sequence[str]) -> None:
    """Refuse long gaps of rows: inputs are unknown there."""
    for row in missing_rows(times)[:1].tolist():
        begin, end = times[row : row + 2]
        how = zip(map(json.dumps, inputs.values()), words, strict=True)
        fill = ", ".join(f'{name} = "{"zoh" if word in HELD else "linear"}"' for name, word in how)
        said = (
            f"rows missing from {begin:.9g} s (row {row + 1}) to {end:.9g} s; usual interval {usual_step(times):.3g} s"
        )
        remedy = f"preprocess = {{ fill_missing = {{ {fill} }}, max_gap = {end - begin:.9g} }}"
        raise InputError(f"{source}: {said}. Cut the data or set {remedy}.")


def _values(
    source: str, frame: pd.DataFrame, times: Floats, role: str, columns: Mapping[str, str], there: Mapping[str, str]
) -> Floats:
    """Return columns (K, n); NaN where absent."""
    values = np.full((times.size, len(columns)), np.nan)
    for k, (variable, column) in enumerate(columns.items()):
        if variable not in there:
            continue
        values[:, k] = numeric_column(frame, column, source)
        bad = np.flatnonzero(~np.isfinite(values[:, k]) if role == "input" else np.isinf(values[:, k]))
        if bad.size:
            row = bad[0]
            found = "has no value" if np.isnan(values[row, k]) else f"is {values[row, k]}"
            remedy = f"Fill the gap, {filling_keys(times, values[:, k], column)}, or cut the data there."
            remedy = remedy if role == "input" else "Leave missing cells empty."
            if np.isnan(values[:, k]).all():
                raise InputError(f"{source}: {role} column {column!r} is empty. Write values, also of formulas.")
            said = f"{role} column {column!r} {found} in row {row + 1} (t = {times[row]:.9g} s)"
            raise InputError(f"{source}: {said}. {remedy}")
    return values


def _counted(
    source: str, times: Floats, values: Floats, outputs: Mapping[str, str], measured: Mapping[str, str], warmup: float
) -> Flags:
    """Return scored samples; each output must have one."""
    if isinstance(warmup, bool) or not isinstance(warmup, int | float) or not 0 <= warmup < np.inf:
        raise InputError(f"{source}: warmup = {warmup!r} is no duration. Give seconds, zero or more.")
    there = ~np.isnan(values) | np.array([name not in measured for name in outputs], dtype=np.bool_)
    late = times >= times[0] + warmup - 1e-9 * (times[-1] - times[0])  # times are rounded decimals
    counted: Flags = there & late[:, np.newaxis]
    for k, column in enumerate(outputs.values()):
        if not there[:, k].any():
            raise InputError(f"{source}: output column {column!r} has no sample. Remove it from the outputs.")
        if not counted[:, k].any():
            said = f"warmup = {warmup:.9g} s leaves no sample of {column!r}"
            last = f"its last is at {times[there[:, k]][-1]:.9g} s"
            raise InputError(f"{source}: {said}; {last}. Make warmup shorter.")
    return counted


def _units(
    source: str, given: Mapping[str, str], columns: Mapping[str, str], said: Mapping[str, str]
) -> dict[str, str]:
    """Return units by variable, given ones first."""
    for variable, unit in given.items():
        if variable not in columns:
            why = f"{variable!r} is no input or output{nearest(str(variable), columns)}"
            raise InputError(f"{source}: units: {why}. Name inputs and outputs only.")
        if not isinstance(unit, str):
            raise InputError(f'{source}: units: {variable} = {unit!r} is no text. Write it as "rad/s".')
    found = {variable: said.get(column) or unit_in_name(column, variable) for variable, column in columns.items()}
    return {variable: unit for variable, unit in found.items() if unit} | dict(given)
