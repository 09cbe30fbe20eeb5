"""Errors of line voltages: gains and offsets of their columns, joints, dead time; as changes of the axes' voltages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import LINES, SensorMap
from fmuid.identification.model_errors import Direction, ErrorKind
from fmuid.identification.output_directions import SETTINGS, rms_of


def is_estimated(kind: ErrorKind, subject: tuple[str, ...], parameters: tuple[str, ...]) -> bool:
    """Return True if a parameter is the size of this error."""
    if kind is ErrorKind.DEAD_TIME:
        return "dead_time_voltage" in parameters
    if kind is ErrorKind.JOINT:
        return any(name.startswith("phase_resistance(") for name in parameters)
    own = kind.value.removeprefix("input_").replace("advance", "delay")
    return len(subject) == 1 and f"{own}({subject[0]})" in parameters


def line_errors(made: SensorMap, currents: Floats) -> Iterator[tuple[Direction, Floats]]:
    """Yield errors of line voltages at simulated currents (K, 2).

    Their changes (K, 2) are those of the axes' voltages.
    """
    columns, names = made.given.voltage_columns, made.given.names
    lines, nominal = made.lines(np.array(made.given.values)), np.zeros(len(names))
    sensors = {line: name for name, line in made.given.current_sensors.items()}
    currents_of_lines = tuple(sensors.get(k, f"current {line}") for k, line in enumerate(LINES))
    voltage, joint = rms_of(lines), SETTINGS.joint * rms_of(lines) / rms_of(currents)

    def drop(name: str) -> Floats:
        values = nominal.copy()
        values[names.index(name)] = 1.0
        return made.axes(-made.drop(values, currents))

    for k, column in enumerate(columns):
        own = np.zeros_like(lines)
        own[:, k] = -lines[:, k]  # what a sensor reads too much the model gets too much
        yield Direction(ErrorKind.INPUT_GAIN, (column,), "", SETTINGS.share), made.axes(own)
        own[:, k] = -1.0
        yield Direction(ErrorKind.INPUT_OFFSET, (column,), "V", SETTINGS.share * voltage), made.axes(own)
    for column, line in zip(columns, LINES, strict=False):
        name = f"phase_resistance({line})"
        yield Direction(ErrorKind.JOINT, (column,), "Ohm", SETTINGS.share * joint), drop(name)
    if columns:
        subject = (*columns, *currents_of_lines)
        yield Direction(ErrorKind.DEAD_TIME, subject, "V", SETTINGS.share * voltage), drop("dead_time_voltage")
