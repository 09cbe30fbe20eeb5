"""Outputs of a machine with all causes, and their derivatives.

Faults of several models add up: y = y_n(θ) + Σ_k [y_k(θ, f_k) − y_n(θ)].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment, shifted
from fmuid.diagnosis.causes import LINE_KINDS, SENSOR_KINDS, CauseKind, ChangeParameterSet
from fmuid.diagnosis.voltage_drops import VoltageDrops
from fmuid.estimation import parabola_slope
from fmuid.models import System
from fmuid.simulation import AS_ASKED, ObservedModel, Refinement, Simulator, refined


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
        self._known: dict[bytes, tuple[Floats, Floats]] = {}
        how = coordinates, experiment, refinement
        self._models = [_Model(system, values, "", *how)]
        self._models += [_Model(System.of(f.model), f.values, name, *how) for name, f in coordinates.faults.items()]

    def over(self, experiment: Experiment) -> LinearizedMachine:
        """Return the same machine, ready to simulate, over another record."""
        other = copy(self)
        other.experiment, other._known = experiment, {}
        other._models = [model.over(experiment) for model in self._models]
        return other

    def linearize(self, point: Floats) -> tuple[Floats, Floats]:
        """Return outputs (K, n_outputs) and derivatives (K, n_outputs, N)."""
        at = point.tobytes()
        if at not in self._known:
            self._known[at] = self._sum(point, slopes=True)
        return self._known[at]

    def outputs(self, point: Floats) -> Floats:
        """Return the outputs (K, n_outputs) at a point (N,)."""
        known = self._known.get(point.tobytes())
        return self._sum(point, slopes=False)[0] if known is None else known[0]

    def in_axes(self, outputs: Floats) -> Floats:
        """Return model outputs (K, n_model) behind sensors' (K, n_outputs)."""
        observed = self._models[0].simulator.observed
        if observed is None:
            return outputs
        names, given = self.experiment.output_names, observed.map.given
        axes = np.nan_to_num(observed.currents_behind(outputs, np.array(given.values)))  # unknown ones are zero
        behind = dict(zip(given.currents, axes.T, strict=True))
        own = self.experiment.of_model.output_names
        return np.column_stack([behind[each] if each in behind else outputs[:, names.index(each)] for each in own])

    def sensed(self, slopes: Floats) -> Floats:
        """Return changes (K, n_outputs, m) of sensors by outputs' (K, n_model, m)."""
        observed = self._models[0].simulator.observed
        if observed is None:
            return slopes
        return np.moveaxis(observed.changes(np.moveaxis(slopes, 2, 0), np.array(observed.map.given.values)), 0, 2)

    def apart_at_zero(self) -> dict[str, Floats]:
        """Return fault models at zero fault minus healthy outputs (K, n_outputs)."""
        sound, *faulty = (model.simulate(self.coordinates.healthy[None])[0] for model in self._models)
        return {model.name: each - sound for model, each in zip(self._models[1:], faulty, strict=True)}

    def _sum(self, point: Floats, *, slopes: bool) -> tuple[Floats, Floats]:
        """Return sensor readings of all models together, and their derivatives."""
        shape = self.experiment.output_values.shape
        outputs, columns = np.zeros(shape), np.zeros((*shape, point.size))
        there = sum(model.there(point) for model in self._models)
        currents: Floats | None = None  # of the machine without faults
        for model in self._models:
            # y_n is taken off once a fault; a fault that is zero gives its own columns alone
            weight = 0.0 if not model.there(point) else 1.0 if model.fault is not None else 2.0 - there
            wanted = ([*model.shared, *model.gains, *model.lines] if weight else []) + model.own if slopes else []
            wanted = [*wanted, *model.details] if wanted and model.fault is not None and weight else wanted
            if not (weight or wanted):
                continue
            is_sound = model.fault is None or not model.there(point)
            own, derivatives, found = model.linearize(point, wanted, currents if is_sound else None)
            currents = found if is_sound else currents
            outputs += weight * own
            for i, slope in derivatives.items():
                columns[:, :, i] += slope if i in (*model.own, *model.details) else weight * slope
        return self._sensed(point, outputs, columns)

    def _sensed(self, point: Floats, outputs: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """Return what the sensors make of outputs and derivatives."""
        seen = outputs.copy()
        for j, name in enumerate(self.experiment.output_names):
            at = [next(iter(self.coordinates.of(kind, name)), None) for kind in SENSOR_KINDS]
            gain, offset, delay = (0.0 if i is None else point[i] for i in at)
            late, slopes = (shifted(self.experiment.times, each[:, j], delay) for each in (outputs, columns))
            rate = _rate(self.experiment.times, late)
            seen[:, j] = (1.0 + gain) * late + offset
            columns[:, j, :] = (1.0 + gain) * slopes
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
        self.details = coordinates.of(CauseKind.DETAIL, fault=name) if name else []
        lines = () if experiment.observation is None else experiment.observation.voltage_columns
        gains = coordinates.of(CauseKind.INPUT_GAIN)
        self.gains = [i for i in gains if coordinates.each[i].variable not in lines]
        self.lines = [i for i in gains if i not in self.gains]
        self.lines += [i for kind in LINE_KINDS for i in coordinates.of(kind)]
        names, own = ({}, ()) if self.fault is None else (self.fault.variable_map, self.fault.parameters)
        nominal = [coordinates.each[i].variable for i in self.shared]
        self.parameters = [*(names.get(each, each) for each in nominal), *own]
        self.parameters += [coordinates.each[i].quantity for i in self.lines]
        details = [coordinates.each[i].variable for i in self.details]
        self.parameters += details
        self.values = {name: value for name, value in self.values.items() if name not in details}
        given = experiment.observation
        self.base = {} if given is None else dict(zip(given.names, given.values, strict=True))
        self._like: Simulator | None = None

    def over(self, experiment: Experiment) -> _Model:
        other = copy(self)
        other.experiment, other._like = experiment, other.__dict__.pop("simulator", self._like)
        return other

    @cached_property
    def simulator(self) -> Simulator:
        own = self.experiment if self.fault is None else self.fault.renamed(self.experiment)
        if self._like is not None:
            return self._like.over(own)
        return refined(Simulator(self.system, own, self.parameters, values=self.values), self.system, self.refinement)

    def input_gains(self, point: Floats) -> Floats | None:
        """Return factors of the inputs (n_inputs,); None for ones."""
        if not point[self.gains].any():
            return None
        names = [self.coordinates.each[i].variable for i in self.gains]
        names = names if self.fault is None else list(self.fault.own_names(dict.fromkeys(names)))
        own = self.simulator.experiment.input_names
        gains = np.ones(len(own))
        gains[[own.index(name) for name in names]] += point[self.gains]
        return gains

    def there(self, point: Floats) -> bool:
        """Return whether the model adds to the outputs: the healthy one, or a fault that is not zero."""
        return self.fault is None or bool(np.any(point[self.own]))

    def linearize(
        self, point: Floats, wanted: Sequence[int], currents: Floats | None
    ) -> tuple[Floats, dict[int, Floats], Floats | None]:
        """Return outputs, derivatives by the coordinates wanted, and an observation's currents.

        All have K rows. A guess of the currents spares simulations.
        """
        steps = {i: self._offsets(point, i) for i in wanted}
        observed = self.simulator.observed
        if observed is not None and observed.map.given.voltages:
            return self._observed(replace(observed, gains=self.input_gains(point)), point, steps, currents)
        inner = {i: pair for i, pair in steps.items() if i not in self.gains}
        outputs = self.simulate(_moved(point, inner))
        slopes = _slopes(outputs[0], outputs[1:], inner)
        for i, pair in ((i, steps[i]) for i in self.gains if i in steps):
            moved = np.concatenate([self.simulate(each[None]) for each in _moved(point, {i: pair})[1:]])
            slopes |= _slopes(outputs[0], moved, {i: pair})
        return outputs[0], slopes, None

    def _observed(
        self,
        observed: ObservedModel,
        point: Floats,
        steps: Mapping[int, tuple[float, float]],
        guess: Floats | None,
    ) -> tuple[Floats, dict[int, Floats], Floats]:
        """Linearize around one fixed point of the drops; derivatives first at its drops, then by their change."""
        own, theta = self.simulator.own, np.array(self._theta(point))
        (values,) = observed.quantities(theta[None])
        found, inputs = observed.driven(theta[own], values, guess)
        base = found.checked()[0]
        currents = observed.currents(base)
        outer = {i: pair for i, pair in steps.items() if i in self.lines or i in self.gains}
        inner = {i: pair for i, pair in steps.items() if i not in outer}
        slopes: dict[int, Floats] = {}
        if inner:
            thetas = np.array([self._theta(each) for each in _moved(point, inner)[1:]])
            slopes |= _slopes(base, observed.simulate(np.ascontiguousarray(thetas[:, own]), inputs).checked(), inner)
        for i, pair in outer.items():
            moved = [self._inputs(observed, each, currents) for each in _moved(point, {i: pair})[1:]]
            each = np.concatenate([observed.simulate(theta[None, own], one).checked() for one in moved])
            slopes |= _slopes(base, each, {i: pair})
        if values[observed.map.has_drop].any():
            drops = VoltageDrops(observed, theta[own], values, base, inputs)
            slopes = {i: drops.closed(slope) for i, slope in slopes.items()}
        whole = observed.changes(np.stack([np.zeros_like(base), *slopes.values()]), values)[1:]
        return observed.seen(base, values), dict(zip(slopes, whole, strict=True)), currents

    def _inputs(self, observed: ObservedModel, moved: Floats, currents: Floats) -> Floats:
        """Return the inputs at a moved point, with unchanged drops."""
        (values,) = observed.quantities(np.array(self._theta(moved))[None])
        driven = replace(observed, gains=self.input_gains(moved))
        return driven.inputs(observed.map.lines(values) - observed.map.drop(values, currents))

    def _offsets(self, point: Floats, i: int) -> tuple[float, float]:
        """Return the two steps of a difference, one-sided beside a bound."""
        step, (low, high) = self.coordinates.each[i].step, self.coordinates.limits(self.coordinates.each[i])
        if point[i] - step < low:
            return step, 2.0 * step
        return -step, step if point[i] + step <= high else -2.0 * step

    def simulate(self, points: Floats) -> Floats:
        """Return the outputs (m, K, n_outputs) at points with equal input gains."""
        thetas, gains = np.array([self._theta(point) for point in points]), self.input_gains(points[0])
        if gains is None:
            return self.simulator.many(thetas).checked()
        if self.simulator.observed is not None:
            return replace(self.simulator.observed, gains=gains).readings(thetas, self.simulator.own).checked()
        return self.simulator.driven_by(thetas, self.simulator.experiment.input_values * gains).checked()

    def _theta(self, point: Floats) -> list[float]:
        """Return the model's parameters at a point; a vector of the plane becomes a size with its angle."""
        theta: list[float] = point[self.shared].tolist()
        lines = [self._of_line(i, float(point[i])) for i in self.lines] + [float(point[i]) for i in self.details]
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


def _moved(point: Floats, steps: Mapping[int, tuple[float, float]]) -> Floats:
    """Return a point and two beside it for each coordinate."""
    points = np.tile(point, (1 + 2 * len(steps), 1))
    for k, (i, pair) in enumerate(steps.items()):
        points[1 + 2 * k : 3 + 2 * k, i] += pair
    return points


def _slopes(base: Floats, moved: Floats, steps: Mapping[int, tuple[float, float]]) -> dict[int, Floats]:
    """Return derivatives by outputs at a point and beside it."""
    off = moved - base
    return {i: parabola_slope(off[2 * k], off[2 * k + 1], *pair) for k, (i, pair) in enumerate(steps.items())}


def residual_of(experiment: Experiment, outputs: Floats) -> Floats:
    """Return measured − simulated (K, n_outputs), 0 where no sample counts."""
    return np.where(experiment.counted, experiment.output_values - outputs, 0.0)


def residual_and_columns(machine: LinearizedMachine, point: Floats) -> Floats:
    """Return residual and columns: (K, n_outputs, 1 + N)."""
    outputs, columns = machine.linearize(point)
    residual = residual_of(machine.experiment, outputs)
    return np.concatenate([residual[:, :, None], columns], axis=2)


def _rate(times: Floats, values: Floats) -> Floats:
    """Return the derivative in time (K,); at a step that of the time before."""
    distinct = np.concatenate([[True], np.diff(times) > 0])
    if np.count_nonzero(distinct) < 2:
        return np.zeros(values.size)
    rates = np.gradient(values[distinct], times[distinct])
    return np.asarray(rates[np.cumsum(distinct) - 1])
