"""Outputs of a machine with all causes, and their derivatives.

Faults of several models add up: y = y_n(θ) + Σ_k [y_k(θ, f_k) − y_n(θ)]. A model is simulated only where its fault is
not zero; otherwise it gives its own columns alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.causes import CauseKind, ChangeParameterSet
from fmuid.diagnosis.faults import Fault
from fmuid.estimation import parabola_slope
from fmuid.models import System
from fmuid.simulation import AS_ASKED, Refinement, Simulator, refined


class LinearizedMachine:
    """A healthy machine at fixed `values`, with fault models, over one record.

    The simulations are as fine (`refinement`) as those of the healthy estimates. Errors are those of `Simulator`.
    """

    def __init__(
        self,
        system: System,
        values: Mapping[str, float | int | bool | str],
        coordinates: ChangeParameterSet,
        experiment: Experiment,
        refinement: Refinement = AS_ASKED,
    ) -> None:
        self.experiment, self.coordinates = experiment, coordinates
        self._last: tuple[bytes, tuple[Floats, Floats]] | None = None
        self._models = [_Model(system, values, None, "", coordinates, refinement)]
        self._models += [
            _Model(System.of(fault.model), fault.values, fault, name, coordinates, refinement)
            for name, fault in coordinates.faults.items()
        ]

    def over(self, experiment: Experiment) -> LinearizedMachine:
        """Return the same machine, ready to simulate, over another record."""
        other = copy(self)
        other.experiment, other._models, other._last = experiment, [model.again() for model in self._models], None
        return other

    def linearize(self, point: Floats) -> tuple[Floats, Floats]:
        """Return outputs (K, n_outputs) and derivatives (K, n_outputs, N)."""
        if self._last is None or self._last[0] != point.tobytes():
            found = _Sum(self.coordinates, point, self.experiment)
            there = [model for model in self._models if model.there(point)]
            for model in self._models:
                model.add(found, alone=model not in there, several=len(there))
            self._last = point.tobytes(), found.sensed()
        return self._last[1]

    def outputs(self, point: Floats) -> Floats:
        """Return the outputs (K, n_outputs) at a point (N,)."""
        found = _Sum(self.coordinates, point, self.experiment)
        there = [model for model in self._models if model.there(point)]
        for model in there:
            model.add(found, alone=False, several=len(there), slopes=False)
        return found.sensed()[0]

    def apart_at_zero(self) -> dict[str, Floats]:
        """Return fault models at zero fault minus healthy outputs (K, n_outputs)."""
        found = _Sum(self.coordinates, self.coordinates.healthy, self.experiment)
        sound, *faulty = (model.simulate(found, found.point[None])[0] for model in self._models)
        return {model.name: each - sound for model, each in zip(self._models[1:], faulty, strict=True)}


class _Model:
    """The healthy machine, or one fault model, and its coordinates."""

    def __init__(
        self,
        system: System,
        values: Mapping[str, float | int | bool | str],
        fault: Fault | None,
        name: str,
        coordinates: ChangeParameterSet,
        refinement: Refinement,
    ) -> None:
        self.name, self.fault, self.values = name, fault, dict(values)
        self.system, self.refinement = system, refinement
        names = {} if fault is None else fault.variable_map
        self.shared = coordinates.of(CauseKind.PARAMETER)
        self.own = coordinates.of(CauseKind.FAULT, fault=name) if fault is not None else []
        self.gains = coordinates.of(CauseKind.INPUT_GAIN)
        nominal = [coordinates.each[i].variable for i in self.shared]
        self.parameters = [names.get(each, each) for each in nominal] + list(() if fault is None else fault.parameters)
        self.coordinates = coordinates
        self._simulators: dict[tuple[float, ...], Simulator] = {}
        self._like: Simulator | None = None

    def again(self) -> _Model:
        other = copy(self)
        other._simulators = {}
        other._like = next(iter(self._simulators.values()), self._like)
        return other

    def there(self, point: Floats) -> bool:
        """Return whether the model adds to the outputs: the healthy one, or a fault that is not zero."""
        return self.fault is None or bool(np.any(point[self.own]))

    def add(self, found: _Sum, *, alone: bool, several: int, slopes: bool = True) -> None:
        """Add outputs and columns to a sum of `several` models; `alone` adds the model's own columns only."""
        # y_n is taken off once a fault
        weight = 0.0 if alone else (2.0 - several if self.fault is None else 1.0)
        wanted = [] if not slopes else self.own if weight == 0.0 else [*self.shared, *self.own]
        steps = [self._offsets(found.point, i) for i in wanted]
        points = np.tile(found.point, (1 + 2 * len(wanted), 1))
        for k, (i, (low, high)) in enumerate(zip(wanted, steps, strict=True)):
            points[1 + 2 * k, i] += low
            points[2 + 2 * k, i] += high
        outputs = self.simulate(found, points)
        if weight:
            found.outputs += weight * outputs[0]
        for k, (i, (low, high)) in enumerate(zip(wanted, steps, strict=True)):
            below, above = outputs[1 + 2 * k] - outputs[0], outputs[2 + 2 * k] - outputs[0]
            slope = parabola_slope(below, above, low, high)
            found.columns[:, :, i] += slope * (1.0 if i in self.own else weight)
        for i in self.gains if weight and slopes else []:
            step, pair = self.coordinates.each[i].step, np.tile(found.point, (2, 1))
            pair[:, i] += [-step, step]
            below, above = (self.simulate(found, point[None])[0] for point in pair)
            found.columns[:, :, i] += weight * (above - below) / (2.0 * step)

    def _offsets(self, point: Floats, i: int) -> tuple[float, float]:
        """Return the two steps of a difference, one-sided beside a bound."""
        coordinate = self.coordinates.each[i]
        if self.fault is None or i not in self.own or coordinate.variable in self.fault.located:
            return -coordinate.step, coordinate.step
        parameter = self.fault.parameters[coordinate.variable]
        if point[i] - coordinate.step < parameter.min:
            return coordinate.step, 2.0 * coordinate.step
        if point[i] + coordinate.step > parameter.max:
            return -coordinate.step, -2.0 * coordinate.step
        return -coordinate.step, coordinate.step

    def simulate(self, found: _Sum, points: Floats) -> Floats:
        """Return the outputs (m, K, n_outputs) at points with equal input gains."""
        batch = self._simulator(found.experiment, points[0]).many(np.array([self._theta(point) for point in points]))
        for error in batch.errors:
            if error is not None:
                raise error
        return np.asarray(batch.outputs)

    def _simulator(self, experiment: Experiment, point: Floats) -> Simulator:
        gains = tuple(point[self.gains].tolist())
        if gains not in self._simulators:
            names = [self.coordinates.each[i].variable for i in self.gains]
            driven = _driven(experiment, dict(zip(names, gains, strict=True)))
            own = driven if self.fault is None else self.fault.renamed(driven)
            if self._like is not None:
                self._simulators[gains] = self._like.over(own)
            else:
                made = Simulator(self.system, own, self.parameters, values=self.values)
                self._simulators[gains] = refined(made, self.system, self.refinement)
        return self._simulators[gains]

    def _theta(self, point: Floats) -> list[float]:
        """Return the model's parameters at a point; a vector of the plane becomes a size with its angle."""
        theta: list[float] = point[self.shared].tolist()
        if self.fault is None:
            return theta
        own: dict[str, list[float]] = {}
        for i in self.own:
            own.setdefault(self.coordinates.each[i].variable, []).append(float(point[i]))
        values = {name: math.hypot(*each) if len(each) > 1 else each[0] for name, each in own.items()}
        values |= dict(self.fault.direction(size, own[size])[:2] for size in self.fault.located)
        return theta + [values[name] for name in self.fault.parameters]


def residual_of(experiment: Experiment, outputs: Floats) -> Floats:
    """Return measured − simulated (K, n_outputs), 0 where no sample counts."""
    return np.where(experiment.counted, experiment.output_values - outputs, 0.0)


def residual_and_columns(machine: LinearizedMachine, point: Floats, origin: Floats | None = None) -> Floats:
    """Return residual and columns (K, n_outputs, 1 + N) at a point (N,).

    The residual is relative to an origin (N,) where given.
    """
    outputs, columns = machine.linearize(point)
    residual = residual_of(machine.experiment, outputs)
    if origin is not None:
        residual = residual + columns @ (point - origin)
    return np.concatenate([residual[:, :, None], columns], axis=2)


def _driven(experiment: Experiment, gains: Mapping[str, float]) -> Experiment:
    """Return an experiment with its inputs off by these shares."""
    off = {name: gain for name, gain in gains.items() if gain}
    if not off:
        return experiment
    inputs = experiment.inputs
    assert isinstance(inputs, Mapping)  # an Experiment makes it so
    frame = experiment.frame.copy(deep=False)
    columns = dict(inputs)
    for name, gain in off.items():
        # a column of its own: another variable may read the one that is scaled
        columns[name] = f"{inputs[name]} as {name}"
        frame[columns[name]] = (1.0 + gain) * experiment.frame[inputs[name]]
    frame.attrs = dict(experiment.frame.attrs)
    return replace(experiment, frame=frame, inputs=columns, units=dict(experiment.units))


class _Sum:
    """Sum of the models' outputs and columns."""

    def __init__(self, coordinates: ChangeParameterSet, point: Floats, experiment: Experiment) -> None:
        self.coordinates, self.point, self.experiment = coordinates, point, experiment
        shape = experiment.output_values.shape
        self.outputs: Floats = np.zeros(shape)
        self.columns: Floats = np.zeros((*shape, point.size))

    def sensed(self) -> tuple[Floats, Floats]:
        """Return sensor readings and their derivatives."""
        outputs, columns = self.outputs.copy(), self.columns.copy()
        for j, name in enumerate(self.experiment.output_names):
            kinds = (CauseKind.GAIN, CauseKind.OFFSET, CauseKind.DELAY)
            at = [next(iter(self.coordinates.of(kind, name)), None) for kind in kinds]
            gain, offset, delay = (0.0 if i is None else self.point[i] for i in at)
            rate = _rate(self.experiment.times, self.outputs[:, j])
            late = self.outputs[:, j] - delay * rate
            outputs[:, j] = (1.0 + gain) * late + offset
            columns[:, j, :] *= 1.0 + gain
            for i, column in zip(at, (late, np.ones(late.size), -(1.0 + gain) * rate), strict=True):
                if i is not None:
                    columns[:, j, i] = column
        return outputs, columns


def _rate(times: Floats, values: Floats) -> Floats:
    """Return the derivative in time (K,); at a step that of the time before."""
    distinct = np.concatenate([[True], np.diff(times) > 0])
    if np.count_nonzero(distinct) < 2:
        return np.zeros(values.size)
    rates = np.gradient(values[distinct], times[distinct])
    return np.asarray(rates[np.cumsum(distinct) - 1])
