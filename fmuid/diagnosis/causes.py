"""Causes: columns in output space with a prior.

Sensors act on an output y as (1 + g) y(t − d) + o. Each size of a fault is a cause of its own; with its angle it is a
vector of the plane.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated

import numpy as np
from annotated_types import Gt

from fmuid.array_types import Flags, Floats
from fmuid.data import LINES, Experiment, Parameter, usual_step
from fmuid.diagnosis.faults import VARIANT, Fault
from fmuid.errors import InputError
from fmuid.models import System


@dataclass(frozen=True)
class CauseSettings:
    """Numbers of causes."""

    probability: float = 0.01  # of a cause before any measurement: one record in a hundred
    sound_share: float = 0.1  # of its nominal that a fault's size may have in a sound machine
    difference_step: float = 1e-3  # of derivatives, as a share of a coordinate's magnitude
    scatter_share: float = 0.02  # of healthy_std, between operating points before any healthy record ...
    parameter_scatter: float = 2e-3  # ... of a healthy parameter, as a share of its magnitude
    open: float = 1e3  # magnitudes of a healthy parameter before any record: any record tells more
    null_steps: int = 2  # linearizations at the estimate without causes, ...
    close: float = 0.03  # ... until the error of the linear model is below this, in standard deviations
    free: float = 1e3  # sizes of a named cause, of which none is unlikely then
    farthest: float = 0.3  # magnitudes of a coordinate in one of them, but for faults


SETTINGS = CauseSettings()


@dataclass(frozen=True)
class Cause:
    """Something that may be new in a record."""

    name: str
    columns: tuple[int, ...]  # its coordinates: one, or two for a size with its angle
    size: float  # standard deviation of its size where it is there (slab), in the coordinates' unit
    sign: int = 0  # 1 or -1 for a size of one sign only
    probability: float = SETTINGS.probability  # before any measurement
    modelled: bool = True  # its signature is that of a fault model, which may be wrong
    heavy: bool = False  # may be far larger than usual: all but healthy parameters


class CauseKind(Enum):
    """Kind of a cause."""

    FAULT = "fault"
    DETAIL = "detail"  # of a fault, unknown within a grid; no cause
    PARAMETER = "parameter"
    GAIN = "gain"
    OFFSET = "offset"
    DELAY = "delay"
    INPUT_GAIN = "input gain"
    JOINT = "joint"  # resistance in series with a line, from the simulated current
    DEAD_TIME = "dead time"  # voltage against the sign of each line current
    NOISE = "noise"  # standard deviation of an output's noise; beside healthy records, and no coordinate

    @property
    def is_share(self) -> bool:
        """True if the size is a share."""
        return self in (CauseKind.GAIN, CauseKind.INPUT_GAIN, CauseKind.NOISE)


SENSOR_KINDS = (CauseKind.GAIN, CauseKind.OFFSET, CauseKind.DELAY)
LINE_KINDS = (CauseKind.JOINT, CauseKind.DEAD_TIME)


@dataclass(frozen=True)
class CauseScale:
    """Standard deviations of a sensor, supply or parameter error.

    Raises
    ------
    InputError
        If one of them is not positive.
    """

    healthy_std: Annotated[float, Gt(0)]
    """σ of the error of a healthy machine"""
    change_std: Annotated[float, Gt(0)]
    """σ of a change of interest"""

    def __post_init__(self) -> None:
        for value in (self.healthy_std, self.change_std):
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"healthy_std and change_std must be finite and above 0, not {value!r}")


@dataclass(frozen=True)
class Causes:
    """Possible changes beside the faults; None (in a study: false) leaves one out."""

    sensor_gain: CauseScale | None = field(default_factory=lambda: CauseScale(0.03, 0.03))
    """of each sensor, as a fraction of the reading"""
    sensor_offset: CauseScale | None = field(default_factory=lambda: CauseScale(0.5, 0.5))
    """of each sensor, in standard deviations of its noise"""
    sensor_delay: CauseScale | None = field(default_factory=lambda: CauseScale(0.2, 0.2))
    """of each sensor, in sampling intervals"""
    input_gain: CauseScale | None = field(default_factory=lambda: CauseScale(0.02, 0.02))
    """of each input or line voltage, as a fraction"""
    parameter_drift: CauseScale | None = field(default_factory=lambda: CauseScale(1.0, 0.1))
    """of each parameter beyond std_factor, as a fraction; healthy_std is not used"""
    joint: CauseScale | None = field(default_factory=lambda: CauseScale(0.002, 0.02))
    """of each line's resistance, as a fraction of line voltage over current; with an observation"""
    dead_time: CauseScale | None = field(default_factory=lambda: CauseScale(0.02, 0.01))
    """of an inverter, as a fraction of the line voltage; with an observation"""


def name_of(kind: CauseKind, variable: str, fault: str) -> str:
    """Return the name of a cause: ``stator.eta_a``, ``gain(ids)``, ``Rs``."""
    if kind in (CauseKind.FAULT, CauseKind.DETAIL):
        return f"{fault}.{variable}"
    if kind is CauseKind.DEAD_TIME:
        return "dead time"
    return variable if kind is CauseKind.PARAMETER else f"{kind.value}({variable})"


@dataclass(frozen=True)
class ChangeParameter:
    """One number of the machine, its sensors or its supply."""

    kind: CauseKind
    variable: str  # in the healthy machine's names; a fault's own in its model's
    unit: str
    step: float  # of derivatives
    normal: float  # standard deviation in a sound machine; of healthy parameters more than any record leaves
    fault: str = ""  # of a fault parameter, with its variant
    second: bool = False  # second component of a vector of the plane

    @property
    def name(self) -> str:
        """Name of its cause."""
        return name_of(self.kind, self.variable, self.fault_name)

    @property
    def fault_name(self) -> str:
        """Name of the fault without its variant."""
        return self.fault.partition(VARIANT)[0]

    @property
    def quantity(self) -> str:
        """Quantity of the observation behind an error of a line."""
        kinds = {CauseKind.INPUT_GAIN: "gain", CauseKind.JOINT: "phase_resistance"}
        return "dead_time_voltage" if self.kind is CauseKind.DEAD_TIME else f"{kinds[self.kind]}({self.variable})"


@dataclass(frozen=True, eq=False)
class ChangeParameterSet:
    """Coordinates of a machine, healthy parameters first, and their causes."""

    each: tuple[ChangeParameter, ...]
    causes: tuple[Cause, ...]
    healthy: Floats  # (N,), parameters of the healthy machine, middles of details, zero for all else
    faults: Mapping[str, Fault] = field(default_factory=dict)

    @property
    def by_name(self) -> dict[str, tuple[Cause, ...]]:
        """Causes by name; the variants of a fault share one."""
        found: dict[str, tuple[Cause, ...]] = {}
        for cause in self.causes:
            found[cause.name] = (*found.get(cause.name, ()), cause)
        return found

    @property
    def normal(self) -> Floats:
        """Standard deviation of each coordinate in a sound machine (N,)."""
        return np.array([each.normal for each in self.each])

    @property
    def scatter(self) -> Floats:
        """Scatter of each coordinate between operating points, before any record (N,)."""
        shares = {
            CauseKind.PARAMETER: SETTINGS.parameter_scatter / SETTINGS.open,
            CauseKind.FAULT: SETTINGS.sound_share,
        }
        return np.array([shares.get(each.kind, SETTINGS.scatter_share) * each.normal for each in self.each])

    @property
    def magnitude(self) -> Floats:
        """Change of each coordinate (N,) that makes its linear model wrong."""
        known = {CauseKind.OFFSET: math.inf, CauseKind.DELAY: math.inf, CauseKind.GAIN: 1.0, CauseKind.INPUT_GAIN: 1.0}
        return np.array([known.get(each.kind, each.step / SETTINGS.difference_step) for each in self.each])

    def toward(self, start: Floats, target: Floats) -> Floats:
        """Return a point toward a target, no farther than linear models hold; faults may be far."""
        healthy = np.array([each.kind is not CauseKind.FAULT for each in self.each])
        far = float(np.max(healthy * np.abs(target - start) / self.magnitude))
        return start + min(1.0, SETTINGS.farthest / max(far, SETTINGS.farthest)) * (target - start)

    def limits(self, of: ChangeParameter) -> tuple[float, float]:
        """Return the bounds of a size; a vector of the plane has none."""
        if of.kind is CauseKind.DETAIL:
            grid = self.faults[of.fault].nuisance[of.variable]
            return min(grid), max(grid)
        if not of.fault or of.variable in self.faults[of.fault].located:
            return -math.inf, math.inf
        parameter = self.faults[of.fault].parameters[of.variable]
        return parameter.min, parameter.max

    @property
    def slow(self) -> Flags:
        """True for coordinates whose changes build up (N,): all but those of sensors."""
        return np.array([each.kind not in SENSOR_KINDS for each in self.each], bool)

    def base(self, cause: Cause) -> Cause:
        """Return the variant of a cause that has its details as coordinates; others as they are."""
        by_name = self.by_name[cause.name]
        return next(each for each in by_name if VARIANT not in self.each[each.columns[0]].fault)

    def free(self, causes: Iterable[Cause]) -> Floats:
        """Return standard deviations (N,) that leave causes free."""
        std = np.zeros(len(self.each))
        for cause in causes:
            std[list(cause.columns)] = SETTINGS.free * cause.size
        return std

    def without_faults(self, point: Floats, but: Collection[int] = ()) -> Floats:
        """Return a point (N,) without faults and details, but some coordinates."""
        hidden = [each.kind in (CauseKind.FAULT, CauseKind.DETAIL) and i not in but for i, each in enumerate(self.each)]
        return np.where(hidden, self.healthy, point)

    @property
    def details(self) -> list[int]:
        """Coordinates of all faults' details."""
        return [i for i, each in enumerate(self.each) if each.kind is CauseKind.DETAIL]

    def of(self, kind: CauseKind, variable: str | None = None, fault: str = "") -> list[int]:
        """Return the indices of the coordinates of a kind, a variable (default: all) and a fault."""
        return [
            i
            for i, each in enumerate(self.each)
            if each.kind is kind and variable in (None, each.variable) and each.fault == fault
        ]


@dataclass(frozen=True)
class SignalScale:
    """Sizes of signals; usual sizes of causes are shares of them."""

    noise: Mapping[str, float]  # standard deviation of each output's noise
    lines: tuple[float, float] | None = None  # `line_scale` of the baseline; default: of the experiment


def coordinates_of(
    system: System,
    nominal: Mapping[str, Parameter],
    faults: Mapping[str, Fault],
    experiment: Experiment,
    scale: SignalScale,
    causes: Causes,
) -> ChangeParameterSet:
    """Return the coordinates of a machine over an experiment."""
    each, found, healthy = list[ChangeParameter](), list[Cause](), list[float]()
    made = [*_of_machine(system, nominal, causes), *_of_faults(faults)]
    made += [*_of_sensors(system, experiment, scale.noise, causes), *_of_inputs(experiment, causes)]
    made += _of_lines(experiment, causes, scale.lines or line_scale(experiment))
    for asked in made:
        of, size = asked.of, asked.size
        if of.kind in (CauseKind.INPUT_GAIN, *LINE_KINDS) and of.quantity in nominal:
            continue  # a parameter of the machine
        new = [of, replace(of, second=True)] if asked.plane else [of]
        if size is not None:
            columns = tuple(range(len(each), len(each) + len(new)))
            is_fault, heavy = of.kind is CauseKind.FAULT, of.kind is not CauseKind.PARAMETER
            found.append(Cause(of.name, columns, size, asked.sign, SETTINGS.probability, is_fault, heavy))
        each.extend(new)
        healthy.extend([asked.start] * len(new))
    return ChangeParameterSet(tuple(each), tuple(found), np.array(healthy), faults)


@dataclass(frozen=True)
class _Coordinate:
    """One coordinate, or two of a plane, and its cause's size."""

    of: ChangeParameter
    size: float | None
    start: float = 0.0
    sign: int = 0
    plane: bool = False


def _of_machine(system: System, nominal: Mapping[str, Parameter], causes: Causes) -> Iterator[_Coordinate]:
    drift = causes.parameter_drift
    for name, parameter in nominal.items():
        magnitude, unit = parameter.nominal or abs(parameter.start) or 1.0, system.unit(name) or ""
        step, normal = SETTINGS.difference_step * magnitude, SETTINGS.open * magnitude
        of = ChangeParameter(CauseKind.PARAMETER, name, unit, step, normal)
        yield _Coordinate(of, None if drift is None else drift.change_std * magnitude, parameter.start)


def _of_faults(faults: Mapping[str, Fault]) -> Iterator[_Coordinate]:
    for name, fault in faults.items():
        own = System.of(fault.model)
        for size in fault.sizes:
            parameter = fault.parameters[size]
            magnitude, plane = parameter.nominal or 1.0, size in fault.located
            step, normal = SETTINGS.difference_step * magnitude, SETTINGS.sound_share * magnitude
            of = ChangeParameter(CauseKind.FAULT, size, own.unit(size) or "", step, normal, name)
            sign = 0 if plane else 1 if parameter.min == 0.0 else -1 if parameter.max == 0.0 else 0
            yield _Coordinate(of, magnitude, sign=sign, plane=plane)
        for detail, grid in fault.nuisance.items():
            middle = float(fault.values[detail])
            spread = float(np.sqrt(np.mean((np.array(grid) - middle) ** 2)))
            step = SETTINGS.difference_step * (max(grid) - min(grid) or abs(middle) or 1.0)
            yield _Coordinate(ChangeParameter(CauseKind.DETAIL, detail, "", step, spread, name), None, middle)


def _of_sensors(
    system: System, experiment: Experiment, noise: Mapping[str, float], causes: Causes
) -> Iterator[_Coordinate]:
    step = usual_step(experiment.times) or 1.0
    for output in experiment.output_names:
        unit = system.unit(output) or "" if "+" not in output else ""
        for kind, width, scale, its_unit in (
            (CauseKind.GAIN, causes.sensor_gain, 1.0, ""),
            (CauseKind.OFFSET, causes.sensor_offset, noise[output], unit),
            (CauseKind.DELAY, causes.sensor_delay, step, "s"),
        ):
            if width is not None:
                of = ChangeParameter(kind, output, its_unit, math.nan, width.healthy_std * scale)
                yield _Coordinate(of, width.change_std * scale)


def _of_inputs(experiment: Experiment, causes: Causes) -> Iterator[_Coordinate]:
    """Yield gains of inputs; of a sensor map, those of its voltage columns."""
    made, width = experiment.sensor_map, causes.input_gain
    driven = dict(zip(experiment.input_names, experiment.input_values.T, strict=True))
    if made is not None:
        driven = {name: values for name, values in driven.items() if name not in made.given.voltages}
        driven |= dict(zip(made.given.voltage_columns, made.voltages.T, strict=False))
    for name, values in driven.items() if width is not None else ():
        assert width is not None, "asked before"
        if values.any():
            of = ChangeParameter(CauseKind.INPUT_GAIN, name, "", SETTINGS.difference_step, width.healthy_std)
            yield _Coordinate(of, width.change_std)


def line_scale(experiment: Experiment) -> tuple[float, float]:
    """Return the rms line voltage and current of a sensor map; 0 without."""
    made = experiment.sensor_map
    if made is None or not made.given.voltages:
        return 0.0, 0.0
    read = experiment.output_values[:, [experiment.output_names.index(each) for each in made.given.current_sensors]]
    known = read[np.isfinite(read)]
    current = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
    return float(np.sqrt(np.mean(made.voltages**2))), current


def _of_lines(experiment: Experiment, causes: Causes, scale: tuple[float, float]) -> Iterator[_Coordinate]:
    """Yield joints and dead time of a sensor map with voltages."""
    made, (voltage, current) = experiment.sensor_map, scale
    if made is None or not made.given.voltages:
        return
    # without a current, no joint has a usual size
    for kind, lines, size, unit, given in (
        (CauseKind.JOINT, LINES if current else (), voltage / (current or 1.0), "Ohm", causes.joint),
        (CauseKind.DEAD_TIME, ("",), voltage, "V", causes.dead_time),
    ):
        for name in lines if given is not None else ():
            assert given is not None, "asked before"
            step = SETTINGS.difference_step * size
            yield _Coordinate(
                ChangeParameter(kind, name, unit, step, given.healthy_std * size), given.change_std * size
            )
