"""What sensors of three phases show of a machine in rotating axes: angle, sensors, joints and inverter, as settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeVar

from fmuid.data.parameters import Parameter
from fmuid.data.priors import checked_number
from fmuid.errors import InputError
from fmuid.formatting import nearest

T = TypeVar("T")
LINES = ("a", "b", "c")
KINDS = ("gain", "offset", "delay", "phase_resistance")
Quantity = float | Parameter
"""Number of the map: fixed, or a parameter to estimate."""


@dataclass(frozen=True)
class Angle:
    """Electrical angle of the rotating axes: a column, or a speed to integrate."""

    column: str | None = None
    """column of the angle, rad by default"""
    speed: str | None = None
    """column of the speed, rad/s by default"""
    pole_pairs: float = 1.0
    """factor on angle and speed; 1 for electrical ones"""
    initial: float = 0.0
    """electrical angle added, rad"""

    def __post_init__(self) -> None:
        if (self.column is None) == (self.speed is None):
            raise InputError("Give column or speed. Without an angle, the phases of sensors are indistinguishable.")
        if not checked_number(self.pole_pairs, "pole_pairs"):
            raise InputError("pole_pairs = 0 turns nothing. Give a number above 0.")


@dataclass(frozen=True)
class Sensor:
    """A sensor reads gain · x(t − delay) + offset.

    Parameters
    ----------
    gain, offset, delay : float or Parameter
        Offset in the unit of the column, delay in s; a `Parameter` is estimated.
    """

    gain: Quantity = 1.0
    offset: Quantity = 0.0
    delay: Quantity = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.gain, Parameter) and self.gain.min <= 0.0 < self.gain.start:
            object.__setattr__(self, "gain", replace(self.gain, min=1e-3 * self.gain.start))
        if not _start(self.gain):
            raise InputError("gain = 0 shows nothing. Give the reading per unit, such as 1.0.")
        for name in ("gain", "offset", "delay"):
            checked_number(_start(getattr(self, name)), name)


@dataclass(frozen=True)
class Observation:
    """Map between a machine in rotating axes and its phase sensors (docs/phase-signals.md).

    Parameters
    ----------
    angle : Angle
    currents : mapping of str to sequence of str
        Current of each axis to the sensors of lines a, b, c; "" for a line without one. Direct axis first.
    voltages : mapping of str to sequence of str
        Voltage of each axis to the columns of lines a, b, c.
    phases : "abc" or "delta"
        Windings in star, or in delta between the lines.
    isolated : bool
        The star point is not connected: currents add up to zero.
    source : "phases" or "dq"
        "dq": the table has columns of the axes, mapped back to the phases.
    sensors : mapping of str to Sensor
        By column; others are exact.
    phase_resistance : mapping of str to float or Parameter
        Series resistance of lines a, b, c, Ohm.
    dead_time_voltage : float or Parameter
        Voltage against the sign of each line current, V.

    Raises
    ------
    InputError
        If a column has two roles, or phases, sensors and lines do not fit together.

    Examples
    --------
    >>> axes = fmuid.data.Observation(fmuid.data.Angle(speed="w"), {"ids": ["ia", "ib"], "iqs": ["ia", "ib"]})
    >>> axes.names
    ('gain(ia)', 'offset(ia)', 'delay(ia)', 'gain(ib)', 'offset(ib)', 'delay(ib)')
    """

    angle: Angle
    currents: Mapping[str, Sequence[str]]
    voltages: Mapping[str, Sequence[str]] = field(default_factory=dict)
    phases: Literal["abc", "delta"] = "abc"
    isolated: bool = True
    source: Literal["phases", "dq"] = "phases"
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    phase_resistance: Mapping[str, Quantity] = field(default_factory=dict)
    dead_time_voltage: Quantity = 0.0

    def __post_init__(self) -> None:
        if self.phases not in ("abc", "delta"):
            raise InputError(f'phases: unknown value {self.phases!r}. Choose "abc" or "delta".')
        if not self.isolated:
            raise InputError("isolated = false: axes have no zero-sequence current. Only isolated windings are known.")
        lines = _lines("currents", self.currents), _lines("voltages", self.voltages) if self.voltages else ()
        if not any(lines[0]):
            raise InputError("currents: no sensor. Name the columns of lines a, b, c.")
        if lines[1] and not (len(lines[1]) == 3 and all(lines[1])):
            raise InputError("voltages: three columns are needed, of lines a, b, c.")
        if self.phases == "delta" and self.source == "phases" and not (len(lines[0]) == 3 and all(lines[0])):
            raise InputError('currents: phases = "delta" needs sensors of three lines.')
        if self.source == "dq" and len(self.current_sensors) > 2:
            raise InputError('currents: from = "dq" gives two sensors; a third would be no measurement. Name two.')
        used = [each for each in (*lines[0], *lines[1]) if each]
        used += [each for each in (self.angle.column, self.angle.speed) if each]
        for column in (each for each in used if used.count(each) > 1):
            raise InputError(f"column {column!r} has two roles. Name it once.")
        for name in self.sensors:
            if name not in (known := (*self.current_sensors, *lines[1])):
                raise InputError(f"sensors: unknown column {name!r}{nearest(name, known)}. Name a current or voltage.")
        for name, value in {**self.phase_resistance, "dead_time_voltage": self.dead_time_voltage}.items():
            checked_number(_start(value), name)
        for line in self.phase_resistance:
            if line not in LINES:
                raise InputError(f"phase_resistance: unknown phase {line!r}. Choose a, b or c.")
        if not self.voltages and any(_start(each) or isinstance(each, Parameter) for each in self._of_inverter):
            raise InputError("phase_resistance and dead_time_voltage need voltages. Name their columns.")

    @property
    def _of_inverter(self) -> list[Quantity]:
        return [*self.phase_resistance.values(), self.dead_time_voltage]

    @property
    def current_sensors(self) -> dict[str, int]:
        """Sensor to the number of its line."""
        return {name: k for k, name in enumerate(_lines("currents", self.currents)) if name}

    @property
    def voltage_columns(self) -> tuple[str, ...]:
        """Columns of lines a, b, c, or none."""
        return _lines("voltages", self.voltages) if self.voltages else ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the map reads, beside those of ``from = "dq"``."""
        angle = (self.angle.column or self.angle.speed or "",)
        return angle if self.source == "dq" else (*angle, *self.current_sensors, *self.voltage_columns)

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Numbers of the map by name: ``gain(ia)``, ``phase_resistance(a)``, ``dead_time_voltage``."""
        found: dict[str, Quantity] = {}
        for name in (*self.current_sensors, *self.voltage_columns):
            sensor = self.sensors.get(name, Sensor())
            found |= {f"gain({name})": sensor.gain, f"offset({name})": sensor.offset, f"delay({name})": sensor.delay}
        if self.voltages:
            found |= {f"phase_resistance({line})": self.phase_resistance.get(line, 0.0) for line in LINES}
            found["dead_time_voltage"] = self.dead_time_voltage
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all quantities."""
        return tuple(self.quantities)

    @property
    def values(self) -> tuple[float, ...]:
        """Values of all quantities, or their initial guesses."""
        return tuple(_start(each) for each in self.quantities.values())

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Quantities to estimate."""
        return {name: each for name, each in self.quantities.items() if isinstance(each, Parameter)}

    def unit(self, name: str, units: Mapping[str, str]) -> str:
        """Return the unit of a quantity, with the units of columns."""
        kind, _, column = name.removesuffix(")").partition("(")
        known = {"gain": "", "delay": "s", "phase_resistance": "Ohm", "dead_time_voltage": "V"}
        return known[kind] if kind in known else units.get(column, "V" if column in self.voltage_columns else "A")

    def renamed(self, names: Mapping[str, str]) -> Observation:
        """Return the map for other names of the machine's variables."""
        changed = {
            key: {names.get(name, name): columns for name, columns in getattr(self, key).items()}
            for key in ("currents", "voltages")
        }
        return replace(self, **changed)  # type: ignore[arg-type]


def is_quantity(name: str) -> bool:
    """Return True for names of map quantities, such as ``gain(ia)``."""
    kind, bracket, _ = name.partition("(")
    return name == "dead_time_voltage" or (kind in KINDS and bool(bracket) and name.endswith(")"))


def _start(quantity: Quantity) -> float:
    return quantity.start if isinstance(quantity, Parameter) else quantity


def _lines(word: str, given: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return the columns of lines a, b, c."""
    if len(given) != 2:
        raise InputError(f"{word}: {len(given)} variables. Give two, of the direct and the quadrature axis.")
    first, second = (tuple(each) for each in given.values())
    if first != second:
        raise InputError(f"{word}: both axes have the same columns. Write {list(first)} for both.")
    if len(first) > 3:
        raise InputError(f"{word}: {len(first)} columns. There are three lines, a, b, c.")
    return first
