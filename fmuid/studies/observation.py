"""The section ``[experiments.observation]`` of a study file: phase signals of a machine in rotating axes."""

from __future__ import annotations

from typing import Annotated, Literal

from fmuid.data import Angle, Normal, Observation, Parameter, Sensor
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import Settings, StudySection, entry


class EstimatedSection(StudySection):
    """Quantity to estimate with the parameters."""

    start: kinds.Finite = entry(..., "initial guess, and mean of the prior")
    prior_std: kinds.Positive | None = entry(None, "σ of the prior, in its unit; default: no prior", 0.02)

    @property
    def parameter(self) -> Parameter:
        """Parameter of the problem."""
        if self.prior_std is None and not self.start:
            raise self.error("start = 0 needs prior_std, its scale.")
        prior = None if self.prior_std is None else Normal(self.start, self.prior_std)
        return Parameter(self.start, nominal=abs(self.start) or self.prior_std, prior=prior)


Quantity = Annotated[kinds.Finite | EstimatedSection, kinds.BY_SHAPE]


class SensorSection(StudySection):
    """Sensor that reads gain · x(t − delay) + offset."""

    gain: Quantity = entry(1.0, "reading per unit, or { start = 1.0, prior_std = 0.02 } to estimate it", 1.0)
    offset: Quantity = entry(0.0, "reading at zero, in the unit of the column", 0.0)
    delay: Quantity = entry(0.0, "delay, s", 0.0)

    @property
    def sensor(self) -> Sensor:
        """Sensor of the map."""
        quantities = [_quantity(each) for each in (self.gain, self.offset, self.delay)]
        with self.place.located():
            return Sensor(*quantities)


Lines = Annotated[
    dict[str, list[str]],
    kinds.ValueKind('two variables with columns of lines a, b, c, { ids = ["ia", "ib"], iqs = ["ia", "ib"] }'),
]


class ObservationSection(StudySection):
    """Phase signals of a machine whose FMU has rotating axes."""

    phases: Annotated[Literal["abc", "delta"], kinds.one_of(("abc", "delta"))] = entry(
        "abc", "windings in star, or in delta between the lines"
    )
    isolated: kinds.Flag = entry(True, "no conductor at the star point: currents add up to zero")
    source: Annotated[Literal["phases", "dq"], kinds.one_of(("phases", "dq"))] = entry(
        "phases", '"dq": the table has columns of the axes, mapped back to phases', alias="from"
    )
    angle: Annotated[Angle, Settings()] | None = entry(
        None, 'electrical angle, { speed = "w", pole_pairs = 2 } or { column = "theta" }'
    )
    currents: Lines = entry(..., "current of each axis = sensors of lines a, b, c")
    voltages: Lines = entry({}, "voltage of each axis = columns of lines a, b, c")
    sensors: Annotated[dict[str, SensorSection], kinds.Entries("{ column = sensor }")] = entry(
        {}, "errors of sensors; others are exact"
    )
    phase_resistance: Annotated[dict[str, Quantity], kinds.Entries("{ phase = Ohm }")] = entry(
        {}, "series resistance of lines a, b, c, Ohm"
    )
    dead_time_voltage: Quantity = entry(0.0, "voltage against the sign of each current, V", 0.0)

    @property
    def observation(self) -> Observation:
        """Map of the experiment."""
        if self.angle is None:
            raise self.error("missing key 'angle'. Without an angle, the phases of sensors are indistinguishable.")
        sensors = {name: each.sensor for name, each in self.sensors.items()}
        resistances = {name: _quantity(each) for name, each in self.phase_resistance.items()}
        windings, dead_time = (self.phases, self.isolated, self.source), _quantity(self.dead_time_voltage)
        with self.place.located():
            return Observation(self.angle, self.currents, self.voltages, *windings, sensors, resistances, dead_time)


def _quantity(given: float | EstimatedSection) -> float | Parameter:
    return given.parameter if isinstance(given, EstimatedSection) else given
