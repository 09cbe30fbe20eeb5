"""The map of an observation over one table: voltages of lines to axes, currents of axes to sensor readings.

Star: i = Tᵀ P(θ) i_dq, u_dq = P(−θ) T u with the Concordia matrix T; delta: T D in its place, D the differences of
lines (docs/phase-signals.md). A sensor reads g i(t − d) + o; a line takes R i + U sign(i) off its voltage.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.data.observation import LINES, Observation
from fmuid.data.signals import T23

DIFFERENCES: Floats = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [-1.0, 0.0, 1.0]])
"""Voltages of windings ab, bc, ca in delta from those of lines."""


@dataclass(frozen=True)
class SignSettings:
    """Sign of a current."""

    width: float = 0.02  # of the largest current: where the sign changes


SIGN = SignSettings()


@dataclass(frozen=True, eq=False)
class SensorMap:
    """An observation with the angle of a table.

    Attributes
    ----------
    given : Observation
    times : (K,) array
        s.
    angle : (K,) array
        Electrical angle, rad.
    voltages : (K, 3) array
        Readings of the line voltages; no columns without voltages.
    held : bool
        Voltages have zero-order hold.
    """

    given: Observation
    times: Floats
    angle: Floats
    voltages: Floats
    held: bool = False

    @cached_property
    def windings(self) -> Floats:
        """Axes at rest from lines (2, 3); its transpose gives lines' currents."""
        return T23 @ DIFFERENCES if self.given.phases == "delta" else T23

    @cached_property
    def sensed(self) -> Floats:
        """Currents at rest to those of the sensors (n_sensors, 2)."""
        return np.asarray(self.windings.T[list(self.given.current_sensors.values())])

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.given.names)}

    def value(self, values: Floats, kind: str, column: str = "") -> float:
        """Return a quantity of values (q,); 0 where there is none."""
        place = self._places.get(f"{kind}({column})" if column else kind)
        return 0.0 if place is None else float(values[place])

    # --- voltages

    @property
    def has_drop(self) -> Flags:
        """Quantities that drop a voltage of the current (q,)."""
        return np.array([name.startswith(("phase_resistance", "dead_time")) for name in self.given.names], bool)

    @property
    def is_delay(self) -> Flags:
        """Quantities that are delays (q,)."""
        return np.array([name.startswith("delay(") for name in self.given.names], bool)

    @cached_property
    def of_inputs(self) -> Flags:
        """Quantities that change the inputs (q,): of voltage columns and drops."""
        columns = self.given.voltage_columns
        own = [name.removesuffix(")").partition("(")[2] in columns for name in self.given.names]
        return np.array(own, bool) | self.has_drop

    def lines(self, values: Floats) -> Floats:
        """Return the voltages of the lines (K, 3) behind their readings."""
        found = np.empty_like(self.voltages)
        for k, name in enumerate(self.given.voltage_columns):
            gain, offset, delay = (self.value(values, kind, name) for kind in ("gain", "offset", "delay"))
            found[:, k] = (shifted(self.times, self.voltages[:, k], -delay) - offset) / gain
        return found

    def drop(self, values: Floats, currents: Floats) -> Floats:
        """Return voltage drops (K, 3) of currents of the axes (K, 2)."""
        lines = turned(currents, self.angle) @ self.windings
        resistances = [self.value(values, "phase_resistance", line) for line in LINES]
        width = max(SIGN.width * float(np.abs(lines).max(initial=0.0)), 1e-300)
        return lines * resistances + self.value(values, "dead_time_voltage") * np.tanh(lines / width)

    def axes(self, lines: Floats) -> Floats:
        """Return line voltages (K, 3) in the axes (K, 2); held ones by their mean over each interval."""
        if not self.held or self.given.source == "dq":
            return turned(lines @ self.windings.T, -self.angle)
        half = 0.5 * np.diff(self.angle, append=self.angle[-1:])
        mean = np.sinc(half / np.pi)[:, None]
        return mean * turned(lines @ self.windings.T, -(self.angle + half))

    # --- currents

    def outputs(self, currents: Floats, values: Floats) -> Floats:
        """Return the readings (K, n_sensors) of currents of the axes (K, 2)."""
        return self._readings(currents, values) + [
            self.value(values, "offset", name) for name in self.given.current_sensors
        ]

    @cached_property
    def half_angle(self) -> Floats:
        """Angle (K − 1,) between the samples."""
        found = self.angle[:-1] + 0.5 * np.diff(self.angle)
        apart = np.diff(self.times) > 0.0
        found[apart] = _spline(self.times, self.angle)(self.times[:-1] + 0.5 * np.diff(self.times))[apart]
        return found

    def between(self, currents: Floats, values: Floats) -> Floats:
        """Return readings (K − 1, n_sensors) between the samples, without delays."""
        lines = turned(currents, self.half_angle) @ self.sensed.T
        names = self.given.current_sensors
        gains, offsets = (np.array([self.value(values, kind, name) for name in names]) for kind in ("gain", "offset"))
        return np.asarray(lines * gains + offsets)

    def slopes(self, changes: Floats, values: Floats) -> Floats:
        """Return changes of readings (m, K, n_sensors) by currents (m, K, 2)."""
        return np.array([self._readings(change, values) for change in changes]).reshape(
            len(changes), len(self.times), len(self.sensed)
        )

    def derivatives(self, currents: Floats, values: Floats) -> Floats:
        """Return derivatives of readings (q, K, n_sensors) by quantities of the sensors; zero for those of inputs."""
        found = np.zeros((len(values), len(self.times), len(self.sensed)))
        for j, name in enumerate(self.given.current_sensors):
            gain, delay = (self.value(values, kind, name) for kind in ("gain", "delay"))
            late, rates = self._late(currents, delay), self._rates(currents, delay)
            # d/dt of P(θ) i is P(θ) (di/dt + θ' J i)
            moving = rates[:, :2] + rates[:, 2:] * np.column_stack([-late[:, 1], late[:, 0]])
            reading, rate = (turned(each, late[:, 2]) @ self.sensed[j] for each in (late[:, :2], moving))
            for kind, column in (("gain", reading), ("offset", np.ones_like(reading)), ("delay", -gain * rate)):
                found[self._places[f"{kind}({name})"], :, j] = column
        return found

    def _readings(self, currents: Floats, values: Floats) -> Floats:
        """Return readings (K, n_sensors) without offsets."""
        found = np.empty((len(self.times), len(self.sensed)))
        for j, name in enumerate(self.given.current_sensors):
            late = self._late(currents, self.value(values, "delay", name))
            found[:, j] = self.value(values, "gain", name) * (turned(late[:, :2], late[:, 2]) @ self.sensed[j])
        return found

    def _late(self, currents: Floats, delay: float) -> Floats:
        """Return delayed currents and angle (K, 3), constant beyond the ends."""
        now = np.column_stack([currents, self.angle])
        return shifted(self.times, now, delay)

    def _rates(self, currents: Floats, delay: float) -> Floats:
        """Return the rates of `_late`."""
        asked = self.times - delay
        within = (asked >= self.times[0]) & (asked <= self.times[-1])
        rates = _spline(self.times, np.column_stack([currents, self.angle]))(asked, 1)
        return np.where(within[:, None], rates, 0.0)

    def measured_axes(self, readings: Floats, values: Floats) -> Floats:
        """Return currents of the axes (K, 2) behind readings (K, n_sensors); NaN from fewer than two sensors."""
        if len(self.sensed) < 2:
            return np.full((len(self.times), 2), np.nan)
        exact = np.empty_like(readings)
        for j, name in enumerate(self.given.current_sensors):
            gain, offset = (self.value(values, kind, name) for kind in ("gain", "offset"))
            exact[:, j] = (readings[:, j] - offset) / gain
        return turned(exact @ np.linalg.pinv(self.sensed).T, -self.angle)


def turned(vectors: Floats, angle: Floats) -> Floats:
    """Return P(angle) x of each row (K, 2)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack(
        [
            cosine * vectors[..., 0] - sine * vectors[..., 1],
            sine * vectors[..., 0] + cosine * vectors[..., 1],
        ],
        axis=-1,
    )


def shifted(times: Floats, values: Floats, delay: float) -> Floats:
    """Return values (K, ...) a delay before, by cubic splines; constant beyond the ends."""
    if not delay:
        return values
    return np.asarray(_spline(times, values)(np.clip(times - delay, times[0], times[-1])))


def _spline(times: Floats, values: Floats) -> Any:
    from scipy.interpolate import CubicSpline

    first = np.concatenate([[True], np.diff(times) > 0.0])  # a step has two samples
    return CubicSpline(times[first], values[first])
