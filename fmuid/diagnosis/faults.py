"""Fault models: parameters of the healthy and the faulty machine (1.63–1.67)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, TypeVar, cast

import numpy as np
from annotated_types import Gt

from fmuid.data import Experiment, Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.formatting import nearest, of_one_experiment
from fmuid.models import FMU, System

T = TypeVar("T")
VARIANT = "\n"  # between the name of a fault and the number of its variant


@dataclass(frozen=True)
class FaultAngle:
    """A circular parameter that locates a fault.

    Raises
    ------
    InputError
        If the period is not positive.

    Examples
    --------
    >>> fmuid.diagnosis.FaultAngle("size", period=2 * np.pi / 3)
    FaultAngle(magnitude='size', period=2.0943951023931953)
    """

    magnitude: str
    """fault parameter with the size of this fault"""
    period: Annotated[float, Gt(0)] = 2.0 * math.pi
    """period of the angle, in the unit of the FMU variable"""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0):
            raise InputError(f"the period of an angle must be finite and above 0, not {self.period!r}")


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault model and its fault parameters.

    Parameters
    ----------
    model : System, FMU or path
        At zero fault it is the healthy machine.
    parameters : mapping of str to Parameter
        Zero without a fault, without prior. A bound at zero gives the size one sign.
    variable_map : mapping of str to str
        Healthy names of parameters, inputs and outputs to this model's; outputs may be sums,
        ``machine.i + fault.i``, and a connector of the system sets several variables.
    angles : mapping of str to FaultAngle, or sequence of str
        Angles. In a list they belong to the only size, with the period of their bounds, 2π without.
    values : mapping
        Fixed variables of this model.
    inputs : mapping of str to str
        Inputs of this model alone, and their columns.
    nuisance : mapping of str to sequence of float
        Possible values of details that no record shows beside the size. A diagnosis averages over them.

    Raises
    ------
    InputError
        If there are no parameters, one excludes zero, has a prior or is one per experiment, or an angle is unknown or
        has no size.

    Examples
    --------
    >>> coil = fmuid.datasets.faulty_coil()
    >>> fmuid.Fault(coil.fmu, {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": 0.025}).sizes
    ('dR',)
    """

    model: System | FMU | str | Path
    parameters: Mapping[str, Parameter]
    variable_map: Mapping[str, str] = field(default_factory=dict)
    angles: Mapping[str, FaultAngle] | Sequence[str] = ()
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    nuisance: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError("the fault has no parameters. Give at least one, with its nominal.")
        for name, parameter in self.parameters.items():
            if not isinstance(parameter, Parameter):
                raise InputError(f"the fault parameter {name!r} must be a Parameter(...), not {parameter!r}")
            if parameter.prior is not None:
                raise InputError(f"the fault parameter {name!r} has a prior. Remove it.")
            if parameter.per_experiment:
                raise InputError(f"the fault parameter {name!r} is one per experiment. Diagnose each experiment alone.")
        for name in self.angles:
            if name not in self.parameters:
                raise InputError(f"unknown angle {name!r}{nearest(name, self.parameters)}")
        for name, values in self.nuisance.items():
            if name in self.parameters or not (len(values) and np.isfinite(values).all()):
                raise InputError(f"nuisance.{name}: needs finite values of a variable that is no fault parameter")
        middle = {name: sorted(values)[len(values) // 2] for name, values in self.nuisance.items()}
        object.__setattr__(self, "values", {**self.values, **middle})
        object.__setattr__(self, "angles", self._angles())
        for name in self.sizes:
            if not self.parameters[name].min <= 0.0 <= self.parameters[name].max:
                raise InputError(f"the bounds of the fault parameter {name!r} exclude 0. Widen them.")

    def _angles(self) -> dict[str, FaultAngle]:
        sizes, found = self.sizes, dict[str, FaultAngle]()
        for name in self.angles:
            width = self.parameters[name].max - self.parameters[name].min
            if isinstance(self.angles, Mapping):
                angle = self.angles[name]
            elif len(sizes) == 1:
                angle = FaultAngle(sizes[0], width) if math.isfinite(width) else FaultAngle(sizes[0])
            else:
                clear = " or ".join(sizes) or "none"
                raise InputError(f"the angle {name!r} has no clear size ({clear}). Give its magnitude.")
            if angle.magnitude not in sizes:
                near = nearest(angle.magnitude, sizes)
                raise InputError(f"unknown size {angle.magnitude!r} of the angle {name!r}{near}")
            if angle.magnitude in (other.magnitude for other in found.values()):
                raise InputError(f"the size {angle.magnitude!r} has two angles. Give one.")
            found[name] = angle
        return found

    @property
    def sizes(self) -> tuple[str, ...]:
        """Parameters that are no angles."""
        return tuple(name for name in self.parameters if name not in self.angles)

    @property
    def angle_of(self) -> Mapping[str, FaultAngle]:
        """Angles by parameter."""
        return cast(Mapping[str, FaultAngle], self.angles)  # made so

    @property
    def located(self) -> dict[str, str]:
        """Angle of each size that has one."""
        return {angle.magnitude: name for name, angle in self.angle_of.items()}

    def direction(self, size: str, vector: Sequence[float]) -> tuple[str, float, float]:
        """Return angle name and value of a vector, and period / 2π."""
        name = self.located[size]
        (x, y), turn = vector, self.angle_of[name].period / (2.0 * math.pi)
        return name, math.atan2(y, x) % (2.0 * math.pi) * turn, turn

    @property
    def searched(self) -> dict[str, Parameter]:
        """Parameters of a fit: angles have no bounds."""
        angles = ((name, self.parameters[name]) for name in self.angles)
        free = {name: Parameter(p.start, nominal=p.nominal or 1.0) for name, p in angles}
        return {**self.parameters, **free}

    @property
    def zero(self) -> dict[str, float]:
        """Parameter values without a fault; angles at their initial guess."""
        return {name: p.start if name in self.angles else 0.0 for name, p in self.parameters.items()}

    def check_beside(self, common: Iterable[str], columns: Iterable[str]) -> None:
        """Check parameters and names against the healthy machine's parameters and columns."""
        healthy = list(common)
        mapped = {self.variable_map.get(each, each) for each in healthy}
        for name in (each for each in self.parameters if each in mapped):
            said = f"the parameter {name!r} belongs to the fault and the healthy machine"
            raise InputError(f"{said}. Rename or remove one.")
        known = {*healthy, *columns}
        for name in self.variable_map:
            if name not in known:
                near = nearest(name, known)
                raise InputError(f"variable_map: unknown variable {name!r} of the healthy machine{near}")

    def own_names(self, given: Mapping[str, T]) -> dict[str, T]:
        """Return values of healthy variables under this model's names."""
        return {self.variable_map.get(name, name): value for name, value in given.items()}

    def renamed(self, experiment: Experiment) -> Experiment:
        """Return an experiment with this model's names of inputs and outputs."""
        observation, words = experiment.observation, experiment.interpolation
        axes = () if observation is None else (*observation.currents, *observation.voltages)
        if not self.inputs and not set(self.variable_map) & {*experiment.input_names, *experiment.output_names, *axes}:
            return experiment
        return replace(
            experiment,
            inputs=self.own_names({name: experiment.columns[name] for name in experiment.input_names})
            | dict(self.inputs),
            outputs=self.own_names({name: experiment.columns[name] for name in experiment.output_names}),
            interpolation=self.own_names(words) if isinstance(words, Mapping) else words,
            units=self.own_names(experiment.units),
            observation=None if observation is None else observation.renamed(self.variable_map),
        )


def with_variants(faults: Mapping[str, Fault]) -> dict[str, Fault]:
    """Return faults and their variants; their names have `VARIANT` and a number."""
    found = dict(faults)
    for name, fault in faults.items():
        grid = (dict(zip(fault.nuisance, each, strict=True)) for each in itertools.product(*fault.nuisance.values()))
        others = (each for each in grid if each.items() - fault.values.items())
        for k, each in enumerate(others):
            found[f"{name}{VARIANT}{k}"] = replace(fault, values={**fault.values, **each}, nuisance={})
    return found


def checked_faults(faults: Mapping[str, Fault]) -> dict[str, Fault]:
    """Return the faults; an `InputError` if there is none."""
    if not faults:
        raise InputError("no fault given. Give at least one fault model with its parameters.")
    return dict(faults)


def common_mode(
    healthy: Result,
    std_factor: float | Mapping[str, float] = 1.0,
    parameters: Mapping[str, Parameter] | None = None,
    held: Iterable[str] = (),
) -> dict[str, Parameter]:
    """Return the nominal parameters with the healthy estimates as prior; none of one experiment or `held`."""
    given, held = dict(parameters or {}), set(held)
    known = [name for name in healthy.names if not of_one_experiment(name) and name not in held]
    if not known:
        said = f"the healthy result has no free parameter of this machine, only {', '.join(healthy.names)}"
        raise InputError(f"{said}. Give the result of a healthy identification.")
    factors = std_factor if isinstance(std_factor, Mapping) else dict.fromkeys(known, std_factor)
    for name in factors:
        if name not in known:
            raise InputError(f"std_factor: unknown parameter {name!r} of the healthy result{nearest(name, known)}")
    found = {name: _nominal(name, healthy, factors.get(name, 1.0), given.get(name)) for name in known}
    return found | {name: parameter for name, parameter in given.items() if name not in found}


def _nominal(name: str, healthy: Result, factor: float, own: Parameter | None) -> Parameter:
    if own is not None and own.prior is not None:
        raise InputError(f"{name!r} has two priors: its own and the healthy result's. Remove one.")
    free = factor == math.inf
    normal = healthy.normal(name, inflate=1.0 if free else factor)
    nominal = (None if own is None else own.nominal) or max(abs(normal.mean), normal.std)
    low, high = (-math.inf, math.inf) if own is None else (own.min, own.max)
    try:
        return Parameter(normal.mean, low, high, nominal, None if free else Normal(normal.mean, normal.std))
    except InputError as error:
        raise InputError(f"{name!r} of the healthy result: {error}") from None
