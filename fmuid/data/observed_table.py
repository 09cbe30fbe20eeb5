"""Tables of phase signals as experiments of a machine in rotating axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.data_file import UNITS, numeric_column
from fmuid.data.observation import Observation
from fmuid.data.sensor_map import SensorMap, turned
from fmuid.errors import InputError
from fmuid.units import parse_unit, unit_in_name


@dataclass(frozen=True)
class ObservedTable:
    """A frame with columns of axes and sensors, roles, and map."""

    frame: pd.DataFrame
    inputs: dict[str, str]
    outputs: dict[str, str]
    map: SensorMap


@dataclass(frozen=True)
class _Columns:
    """Columns of a table by name, converted to a unit."""

    source: str
    frame: pd.DataFrame

    def unit(self, name: str) -> str | None:
        """Return the unit of a column, None if unknown."""
        column = column_of(self.frame.columns, name) or name
        return self.frame.attrs.get(UNITS, {}).get(column) or unit_in_name(column)

    def values(self, name: str, unit: str, role: str) -> Floats:
        """Return a column (K,) in a unit."""
        column = column_of(self.frame.columns, name)
        if column is None:
            raise InputError(f"{self.source}: {missing_column(role, name, self.frame.columns)}")
        values = numeric_column(self.frame, column, self.source)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size and role != "output":
            raise InputError(f"{self.source}: column {name!r} has no value in row {bad[0] + 1}. Fill it.")
        said = self.unit(name)
        given, wanted = parse_unit(said or unit), parse_unit(unit)
        if given is None or wanted is None or given.exponents != wanted.exponents:
            raise InputError(f"{self.source}: column {name!r} is in {said}, not convertible to {unit}.")
        return np.asarray(given.factor / wanted.factor * values)


def observed_table(
    given: Observation,
    source: str,
    frame: pd.DataFrame,
    times: Floats,
    roles: tuple[Mapping[str, str], ...],
    held: bool,
) -> ObservedTable:
    """Return a table with the columns of the axes.

    Parameters
    ----------
    given : Observation
    source : str
        Name of the table in messages.
    frame : pandas.DataFrame
    times : (K,) array
        s.
    roles : pair of mappings of str to str
        Inputs and outputs: FMU variables, or sensors, to columns.
    held : bool
        Voltages have zero-order hold.
    """
    inputs, outputs = dict(roles[0]), dict(roles[1])
    columns = _Columns(source, frame)
    angle = _angle(given, columns, times)
    made = SensorMap(given, times, angle, np.empty((len(times), 0)), held)
    added, units = dict[str, Floats](), dict[str, str]()
    if given.source == "dq":
        axes = [outputs.pop(name, name) for name in given.currents]
        if all(column_of(frame.columns, name) is not None for name in axes):
            values = np.column_stack([columns.values(name, "A", "output") for name in axes])
            names = {sensor: f"{sensor} of {', '.join(axes)}" for sensor in given.current_sensors}
            added |= dict(zip(names.values(), made.outputs(values, np.array(given.values)).T, strict=True))
            outputs |= {sensor: outputs.get(sensor, column) for sensor, column in names.items()}
        if given.voltages:
            axes = [inputs.setdefault(name, name) for name in given.voltages]
            values = np.column_stack([columns.values(name, "V", "input") for name in axes])
            lines = turned(values, angle) @ np.linalg.pinv(made.windings).T
            made = replace(made, voltages=lines)
    else:
        _refuse_both(source, given, inputs, outputs)
        if given.voltages:
            lines = np.column_stack([columns.values(name, "V", "input") for name in given.voltage_columns])
            made = replace(made, voltages=lines)
            axes = axis_columns(given)
            units |= dict.fromkeys(axes, "V")
            added |= dict(zip(axes, made.axes(made.lines(np.array(given.values))).T, strict=True))
            inputs |= dict(zip(given.voltages, axes, strict=True))
        for sensor in (each for each in given.current_sensors if column_of(frame.columns, each) is not None):
            if columns.unit(sensor) not in (None, "A"):
                raise InputError(f"{source}: sensor {sensor!r} is in {columns.unit(sensor)}. Convert its column to A.")
    outputs |= {sensor: outputs.get(sensor, sensor) for sensor in given.current_sensors}
    units |= {outputs[sensor]: "A" for sensor in given.current_sensors}
    found = frame.assign(**added)
    found.attrs = {**frame.attrs, UNITS: {**frame.attrs.get(UNITS, {}), **units}}
    return ObservedTable(found, inputs, outputs, made)


def axis_columns(given: Observation) -> list[str]:
    """Return the names of the columns of both axes' voltages."""
    return [f"{axis} of {', '.join(given.voltage_columns)}" for axis in "dq"]


def _refuse_both(source: str, given: Observation, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> None:
    """Refuse variables of the map with another column."""
    pairs = zip(given.voltages, axis_columns(given), strict=False)
    taken = [name for name, column in pairs if inputs.get(name, column) != column]
    for name in [*taken, *(each for each in given.currents if each in outputs)]:
        raise InputError(f"{source}: {name!r} has a column and comes from the phases, too. Remove one.")


def _angle(given: Observation, columns: _Columns, times: Floats) -> Floats:
    """Return the electrical angle (K,), rad."""
    how = given.angle
    if how.column is not None:
        return np.asarray(how.initial + how.pole_pairs * np.unwrap(columns.values(how.column, "rad", "angle")))
    assert how.speed is not None
    speed = how.pole_pairs * columns.values(how.speed, "rad/s", "speed")
    steps = np.diff(times) * (speed[1:] + speed[:-1]) / 2
    return np.asarray(how.initial + np.concatenate([[0.0], np.cumsum(steps)]))


def model_roles(
    given: Observation, outputs: Mapping[str, str], output_values: Floats, made: SensorMap
) -> tuple[dict[str, str], Floats]:
    """Return the machine's outputs with columns, and their values (K, n): currents of the axes from the sensors."""
    names = list(outputs)
    others = [name for name in names if name not in given.current_sensors]
    readings = output_values[:, [names.index(each) for each in given.current_sensors]]
    axes = made.measured_axes(readings, np.array(given.values))
    found = {name: outputs[name] for name in others} | {name: f"{name} of sensors" for name in given.currents}
    return found, np.column_stack([output_values[:, [names.index(each) for each in others]], axes])
