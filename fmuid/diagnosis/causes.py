"""Causes: all that may differ between two records of a machine, as columns in output space with a prior.

A cause is a parameter, a size of a fault, a sensor or the supply. Every sensor has a gain, an offset and a delay, which
need no model: they act on the output y as (1 + g) y(t − d) + o. Every input has a gain. Each size of a fault is a cause
of its own, so that a fault in one of three phases is not three at once; a size with its angle is a vector of the plane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

import numpy as np
from annotated_types import Gt

from fmuid.array_types import Flags, Floats
from fmuid.data import Experiment, Parameter
from fmuid.diagnosis.faults import Fault
from fmuid.errors import InputError
from fmuid.models import System


@dataclass(frozen=True)
class CauseSettings:
    """Numbers of causes.

    Attributes
    ----------
    probability : float
        Of a cause before anything is measured, where nothing else is said: one record in a hundred.
    sound_share : float
        What a fault's size may be in a sound machine, as a share of its nominal.
    difference_step : float
        Derivatives are taken over this share of a coordinate's magnitude.
    open : float
        What of a healthy parameter is open before any record, in its magnitudes: so much that any record says
        more.
    """

    probability: float = 0.01
    sound_share: float = 0.1
    difference_step: float = 1e-3
    open: float = 1e3


SETTINGS = CauseSettings()


@dataclass(frozen=True)
class Cause:
    """Something that may be new in a record.

    Parameters
    ----------
    name : str
    columns : tuple of int
        Its coordinates: one, or two for a vector of the plane (a size with its angle).
    size : float
        Standard deviation of its size where it is there (slab), in the coordinates' unit.
    sign : int
        1 or −1 where its size can only have this sign, 0 where either.
    probability : float
        That it is there, before anything is measured.
    modelled : bool
        Whether its signature is that of a fault model, which may be wrong; what sensors, supply and the healthy
        parameters do is known.

    Raises
    ------
    InputError
        If it has no coordinates, its size is not positive, a sign goes with several, or the probability is none.
    """

    name: str
    columns: tuple[int, ...]
    size: float
    sign: int = 0
    probability: float = SETTINGS.probability
    modelled: bool = True

    def __post_init__(self) -> None:
        if not self.columns:
            raise InputError(f"the cause {self.name!r} has no coordinate: name at least one")
        if not (math.isfinite(self.size) and self.size > 0):
            raise InputError(f"the size of the cause {self.name!r} must be positive and finite, not {self.size!r}")
        if self.sign not in (-1, 0, 1) or (self.sign and len(self.columns) > 1):
            raise InputError(f"the sign of the cause {self.name!r} must be 1 or -1 for one coordinate, or 0")
        if not 0 < self.probability < 1:
            raise InputError(f"the probability of the cause {self.name!r} must lie between 0 and 1")


class CauseKind(Enum):
    """What a cause is a cause of."""

    FAULT = "fault"
    PARAMETER = "parameter"
    GAIN = "gain"
    OFFSET = "offset"
    DELAY = "delay"
    INPUT_GAIN = "input gain"

    @property
    def is_share(self) -> bool:
        """Whether its size is a share."""
        return self in (CauseKind.GAIN, CauseKind.INPUT_GAIN)


@dataclass(frozen=True)
class CauseScale:
    """How far something may be off.

    Raises
    ------
    InputError
        If one of them is not positive.
    """

    healthy_std: Annotated[float, Gt(0)]
    """standard deviation of what a sound machine may have at all times"""
    change_std: Annotated[float, Gt(0)]
    """standard deviation of a change that is worth naming"""

    def __post_init__(self) -> None:
        for value in (self.healthy_std, self.change_std):
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"what is normal and what is worth naming must be positive, not {value!r}")


@dataclass(frozen=True)
class Causes:
    """What may have changed beside the faults, where there are healthy records; None, or false, leaves one out."""

    sensor_gain: CauseScale | None = field(default_factory=lambda: CauseScale(0.03, 0.03))
    """of each sensor, as a fraction of the reading"""
    sensor_offset: CauseScale | None = field(default_factory=lambda: CauseScale(0.5, 0.5))
    """of each sensor, in standard deviations of its noise"""
    sensor_delay: CauseScale | None = field(default_factory=lambda: CauseScale(0.2, 0.2))
    """of each sensor, in sampling intervals"""
    input_gain: CauseScale | None = field(default_factory=lambda: CauseScale(0.02, 0.02))
    """of each input, as a fraction: a supply whose phases differ"""
    parameter_drift: CauseScale | None = field(default_factory=lambda: CauseScale(1.0, 0.1))
    """of each parameter beyond std_factor, as a fraction of its value; what is normal is known from the healthy
    record"""


def name_of(kind: CauseKind, variable: str, fault: str) -> str:
    """Return what a cause is called: ``stator.eta_a``, ``gain(ids)``, ``Rs``."""
    if kind is CauseKind.FAULT:
        return f"{fault}.{variable}"
    return variable if kind is CauseKind.PARAMETER else f"{kind.value}({variable})"


@dataclass(frozen=True)
class ChangeParameter:
    """One number of the machine and what is around it.

    Attributes
    ----------
    kind : CauseKind
    variable : str
        Parameter, fault parameter, output or input, by the healthy machine's names (a fault's own by its model's).
    fault : str
        The hypothesis of a fault parameter, "" otherwise.
    unit : str
        "" without.
    step : float
        Over which derivatives are taken.
    normal : float
        What a sound machine may have of it; of the healthy parameters more than any record leaves open.
    second : bool
        Whether it is the second component of a vector of the plane.
    """

    kind: CauseKind
    variable: str
    unit: str
    step: float
    normal: float
    fault: str = ""
    second: bool = False

    @property
    def name(self) -> str:
        """Of the cause that it is."""
        return name_of(self.kind, self.variable, self.fault)


@dataclass(frozen=True, eq=False)
class ChangeParameterSet:
    """The coordinates of a machine, and the causes that they make.

    Attributes
    ----------
    each : tuple of ChangeParameter
        Healthy parameters first.
    causes : tuple of Cause
    healthy : (N,) array
        The healthy machine: its parameters, and zero for all else.
    """

    each: tuple[ChangeParameter, ...]
    causes: tuple[Cause, ...]
    healthy: Floats

    @property
    def normal(self) -> Floats:
        """What a sound machine may have of each (N,)."""
        return np.array([coordinate.normal for coordinate in self.each])

    @property
    def slow(self) -> Flags:
        """Which are of the machine (N,), whose changes build up, not of a sensor."""
        sensors = (CauseKind.GAIN, CauseKind.OFFSET, CauseKind.DELAY)
        return np.array([coordinate.kind not in sensors for coordinate in self.each], bool)

    def of(self, kind: CauseKind, variable: str | None = None, fault: str = "") -> list[int]:
        """Return the places of the coordinates of a kind, of one variable or of all, of one fault."""
        return [
            i
            for i, each in enumerate(self.each)
            if each.kind is kind and variable in (None, each.variable) and each.fault == fault
        ]


def coordinates_of(
    system: System,
    nominal: Mapping[str, Parameter],
    faults: Mapping[str, Fault],
    experiment: Experiment,
    noise: Mapping[str, float],
    causes: Causes,
) -> ChangeParameterSet:
    """Return the coordinates of a machine.

    Parameters
    ----------
    system : System
        The healthy machine.
    nominal : mapping of str to Parameter
        Its parameters, each starting at the healthy value.
    faults : mapping of str to Fault
    experiment : Experiment
        A record: its inputs and outputs, and its sampling step.
    noise : mapping of str to float
        Standard deviation of each output's noise.
    causes : Causes
        What else is taken into account.
    """
    made = _Made()
    for name, parameter in nominal.items():
        magnitude = parameter.nominal or abs(parameter.start) or 1.0
        of = ChangeParameter(
            CauseKind.PARAMETER,
            name,
            system.unit(name) or "",
            SETTINGS.difference_step * magnitude,
            SETTINGS.open * magnitude,
        )
        made.add(
            of,
            parameter.start,
            None if causes.parameter_drift is None else causes.parameter_drift.change_std * magnitude,
        )
    for name, fault in faults.items():
        _add_fault(made, name, fault)
    step = float(np.median(np.diff(experiment.times))) or 1.0
    for output in experiment.output_names:
        unit = system.unit(output) or "" if "+" not in output else ""
        for kind, range_, scale, own in (
            (CauseKind.GAIN, causes.sensor_gain, 1.0, ""),
            (CauseKind.OFFSET, causes.sensor_offset, noise[output], unit),
            (CauseKind.DELAY, causes.sensor_delay, step, "s"),
        ):
            if range_ is not None:
                made.add(
                    ChangeParameter(kind, output, own, math.nan, range_.healthy_std * scale),
                    0.0,
                    range_.change_std * scale,
                )
    if causes.input_gain is not None:
        for name in experiment.input_names:
            if np.any(experiment.input_values[:, experiment.input_names.index(name)]):
                healthy = causes.input_gain.healthy_std
                of = ChangeParameter(CauseKind.INPUT_GAIN, name, "", SETTINGS.difference_step, healthy)
                made.add(of, 0.0, causes.input_gain.change_std)
    return ChangeParameterSet(tuple(made.each), tuple(made.causes), np.array(made.healthy))


class _Made:
    """Coordinates and causes as they come."""

    def __init__(self) -> None:
        self.each: list[ChangeParameter] = []
        self.causes: list[Cause] = []
        self.healthy: list[float] = []

    def add(
        self, of: ChangeParameter | Sequence[ChangeParameter], healthy: float, size: float | None, sign: int = 0
    ) -> None:
        """Add a coordinate, or the two of a plane, and the cause that they are unless their size is None."""
        new = [of] if isinstance(of, ChangeParameter) else list(of)
        columns = tuple(range(len(self.each), len(self.each) + len(new)))
        self.each += new
        self.healthy += [healthy] * len(new)
        if size is not None:
            self.causes.append(Cause(new[0].name, columns, size, sign, modelled=new[0].kind is CauseKind.FAULT))


def _add_fault(made: _Made, name: str, fault: Fault) -> None:
    system = System.of(fault.model)
    for size in fault.sizes:
        parameter = fault.parameters[size]
        magnitude = parameter.nominal or 1.0
        unit = system.unit(size) or ""
        step, normal = SETTINGS.difference_step * magnitude, SETTINGS.sound_share * magnitude
        first = ChangeParameter(CauseKind.FAULT, size, unit, step, normal, name)
        if size in fault.located:
            made.add(
                [first, ChangeParameter(CauseKind.FAULT, size, unit, step, normal, name, second=True)], 0.0, magnitude
            )
        else:
            sign = 1 if parameter.min == 0.0 else -1 if parameter.max == 0.0 else 0
            made.add(first, 0.0, magnitude, sign)
