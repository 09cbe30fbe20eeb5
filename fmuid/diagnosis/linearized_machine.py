"""Outputs of a machine with all causes, and their derivatives.

Faults of several models add up: y = y_n(θ) + Σ_k [y_k(θ, f_k) − y_n(θ)].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.causes import LINE_KINDS, SENSOR_KINDS, CauseKind, ChangeParameterSet
from fmuid.estimation import parabola_slope
from fmuid.models import System
from fmuid.simulation import AS_ASKED, Refinement, Simulator, refined


class LinearizedMachine:
    """A healthy machine at fixed `values`, with fault models, over one record; errors are those of `Simulator`."""

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
        how = coordinates, experiment, refinement
        self._models = [_Model(system, values, "", *how)]
        self._models += [_Model(System.of(f.model), f.values, name, *how) for name, f in coordinates.faults.items()]

    def over(self, experiment: Experiment) -> LinearizedMachine:
        """Return the same machine, ready to simulate, over another record."""
        other = copy(self)
        other.experiment, other._last = experiment, None
        other._models = [model.over(experiment) for model in self._models]
        return other

    def linearize(self, point: Floats) -> tuple[Floats, Floats]:
        """Return outputs (K, n_outputs) and derivatives (K, n_outputs, N)."""
        if self._last is None or self._last[0] != point.tobytes():
            self._last = point.tobytes(), self._sum(point, slopes=True)
        return self._last[1]

    def outputs(self, point: Floats) -> Floats:
        """Return the outputs (K, n_outputs) at a point (N,)."""
        return self._sum(point, slopes=False)[0]

    def apart_at_zero(self) -> dict[str, Floats]:
        """Return fault models at zero fault minus healthy outputs (K, n_outputs)."""
        sound, *faulty = (model.simulate(self.coordinates.healthy[None])[0] for model in self._models)
        return {model.name: each - sound for model, each in zip(self._models[1:], faulty, strict=True)}

    def _sum(self, point: Floats, *, slopes: bool) -> tuple[Floats, Floats]:
        """Return sensor readings of all models together, and their derivatives."""
        shape = self.experiment.output_values.shape
        outputs, columns = np.zeros(shape), np.zeros((*shape, point.size))
        there = sum(model.there(point) for model in self._models)
        for model in self._models:
            # y_n is taken off once a fault; a fault that is zero gives its own columns alone
            weight = 0.0 if not model.there(point) else 1.0 if model.fault is not None else 2.0 - there
            wanted = ([*model.shared, *model.gains, *model.lines] if weight else []) + model.own if slopes else []
            if not (weight or wanted):
                continue
            own, derivatives = model.linearize(point, wanted)
            outputs += weight * own
            for i, slope in derivatives.items():
                columns[:, :, i] += slope if i in model.own else weight * slope
        return self._sensed(point, outputs, columns)

    def _sensed(self, point: Floats, outputs: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """Return what the sensors make of outputs and derivatives."""
        seen = outputs.copy()
        for j, name in enumerate(self.experiment.output_names):
            at = [next(iter(self.coordinates.of(kind, name)), None) for kind in SENSOR_KINDS]
            gain, offset, delay = (0.0 if i is None else point[i] for i in at)
            rate = _rate(self.experiment.times, outputs[:, j])
            late = outputs[:, j] - delay * rate
            seen[:, j] = (1.0 + gain) * late + offset
            columns[:, j, :] *= 1.0 + gain
            for i, column in zip(at, (late, np.ones(late.size), -(1.0 + gain) * rate), strict=True):
                if i is not None:
                    columns[:, j, i] = column
        return seen, columns


class _Model:
    """The healthy machine (name ""), or one fault model, and its coordinates."""

    def __init__(
        self,
        system: System,
        values: Mapping[str, float | int | bool | str],
        name: str,
        coordinates: ChangeParameterSet,
        experiment: Experiment,
        refinement: Refinement,
    ) -> None:
        self.name, self.fault = name, coordinates.faults.get(name)
        self.system, self.values, self.refinement = system, dict(values), refinement
        self.coordinates, self.experiment = coordinates, experiment
        self.shared = coordinates.of(CauseKind.PARAMETER)
        self.own = coordinates.of(CauseKind.FAULT, fault=name)
        lines = () if experiment.observation is None else experiment.observation.voltage_columns
        gains = coordinates.of(CauseKind.INPUT_GAIN)
        self.gains = [i for i in gains if coordinates.each[i].variable not in lines]
        self.lines = [i for i in gains if i not in self.gains]
        self.lines += [i for kind in LINE_KINDS for i in coordinates.of(kind)]
        names, own = ({}, ()) if self.fault is None else (self.fault.variable_map, self.fault.parameters)
        nominal = [coordinates.each[i].variable for i in self.shared]
        self.parameters = [*(names.get(each, each) for each in nominal), *own]
        self.parameters += [coordinates.each[i].quantity for i in self.lines]
        given = experiment.observation
        self.base = {} if given is None else dict(zip(given.names, given.values, strict=True))
        self._simulators: dict[tuple[float, ...], Simulator] = {}
        self._like: Simulator | None = None

    def over(self, experiment: Experiment) -> _Model:
        other = copy(self)
        other.experiment, other._simulators = experiment, {}
        other._like = next(iter(self._simulators.values()), self._like)
        return other

    def there(self, point: Floats) -> bool:
        """Return whether the model adds to the outputs: the healthy one, or a fault that is not zero."""
        return self.fault is None or bool(np.any(point[self.own]))

    def linearize(self, point: Floats, wanted: Sequence[int]) -> tuple[Floats, dict[int, Floats]]:
        """Return outputs (K, n_outputs), and derivatives by the coordinates wanted."""
        steps = {i: self._offsets(point, i) for i in wanted if i not in self.gains}
        points = np.tile(point, (1 + 2 * len(steps), 1))
        for k, (i, pair) in enumerate(steps.items()):
            points[1 + 2 * k : 3 + 2 * k, i] += pair
        outputs = self.simulate(points)
        off = outputs - outputs[0]
        slopes = {i: parabola_slope(off[1 + 2 * k], off[2 + 2 * k], *steps[i]) for k, i in enumerate(steps)}
        for i in self.gains:
            if i in wanted:
                step, beside = self.coordinates.each[i].step, np.tile(point, (2, 1, 1))
                beside[:, 0, i] += [-step, step]
                below, above = (self.simulate(each)[0] for each in beside)
                slopes[i] = (above - below) / (2.0 * step)
        return outputs[0], slopes

    def _offsets(self, point: Floats, i: int) -> tuple[float, float]:
        """Return the two steps of a difference, one-sided beside a bound."""
        step, (low, high) = self.coordinates.each[i].step, self.coordinates.limits(self.coordinates.each[i])
        if point[i] - step < low:
            return step, 2.0 * step
        return -step, step if point[i] + step <= high else -2.0 * step

    def simulate(self, points: Floats) -> Floats:
        """Return the outputs (m, K, n_outputs) at points with equal input gains."""
        batch = self._simulator(points[0]).many(np.array([self._theta(point) for point in points]))
        for error in batch.errors:
            if error is not None:
                raise error
        return np.asarray(batch.outputs)

    def _simulator(self, point: Floats) -> Simulator:
        gains = tuple(point[self.gains].tolist())
        if gains not in self._simulators:
            names = [self.coordinates.each[i].variable for i in self.gains]
            driven = _driven(self.experiment, dict(zip(names, gains, strict=True)))
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
        lines = [self._of_line(i, float(point[i])) for i in self.lines]
        if self.fault is None:
            return theta + lines
        own: dict[str, list[float]] = {}
        for i in self.own:
            own.setdefault(self.coordinates.each[i].variable, []).append(float(point[i]))
        values = {name: math.hypot(*each) if len(each) > 1 else each[0] for name, each in own.items()}
        values |= dict(self.fault.direction(size, own[size])[:2] for size in self.fault.located)
        return theta + [values[name] for name in self.fault.parameters] + lines

    def _of_line(self, i: int, size: float) -> float:
        """Return the quantity of the observation for a coordinate's size."""
        each = self.coordinates.each[i]
        base = self.base[each.quantity]
        # a line with more voltage than read has a sensor that reads less
        return base / (1.0 + size) if each.kind is CauseKind.INPUT_GAIN else base + size


def residual_of(experiment: Experiment, outputs: Floats) -> Floats:
    """Return measured − simulated (K, n_outputs), 0 where no sample counts."""
    return np.where(experiment.counted, experiment.output_values - outputs, 0.0)


def residual_and_columns(machine: LinearizedMachine, point: Floats) -> Floats:
    """Return residual and columns: (K, n_outputs, 1 + N)."""
    outputs, columns = machine.linearize(point)
    residual = residual_of(machine.experiment, outputs)
    return np.concatenate([residual[:, :, None], columns], axis=2)


def _driven(experiment: Experiment, gains: Mapping[str, float]) -> Experiment:
    """Return an experiment with its inputs off by these shares."""
    off = {name: gain for name, gain in gains.items() if gain}
    if not off:
        return experiment
    frame = experiment.frame.copy(deep=False)
    inputs = {name: experiment.columns[name] for name in experiment.input_names}
    for name, gain in off.items():
        # a column of its own: another variable may read the one that is scaled
        column = f"{inputs[name]} as {name}"
        frame[column], inputs[name] = (1.0 + gain) * experiment.frame[inputs[name]], column
    frame.attrs = dict(experiment.frame.attrs)
    return replace(experiment, frame=frame, inputs=inputs)


def _rate(times: Floats, values: Floats) -> Floats:
    """Return the derivative in time (K,); at a step that of the time before."""
    distinct = np.concatenate([[True], np.diff(times) > 0])
    if np.count_nonzero(distinct) < 2:
        return np.zeros(values.size)
    rates = np.gradient(values[distinct], times[distinct])
    return np.asarray(rates[np.cumsum(distinct) - 1])
