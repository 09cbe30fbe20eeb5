"""Readings of sensors: simulations through the map of an observation.

Quantities of sensors act on simulated currents alone. Gains of voltage columns change the inputs; joints and dead times
change them by the simulated currents, which a fixed point finds: drops are small against the voltages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats, Indices, Simulations
from fmuid.data import Experiment, SensorMap
from fmuid.errors import SimulationError


@dataclass(frozen=True)
class DropSettings:
    """Fixed point of the voltages that lines lose."""

    tolerance: float = 1e-10  # of the largest current
    most: int = 60  # simulations
    mixed: int = 20  # iterates that are extrapolated


SETTINGS = DropSettings()
Simulate = Callable[[Floats, Floats | None], Simulations]
"""Simulates thetas of the model (m, N) with its own inputs, or others (K, n_inputs)."""


class AndersonMixing:
    """Extrapolation of a fixed point from its latest iterates (D. G. Anderson, J. ACM 12, 1965)."""

    def __init__(self) -> None:
        self._points: list[Floats] = []
        self._images: list[Floats] = []

    def next(self, point: Floats, image: Floats) -> Floats:
        """Return the next point after one and its image, of any shape."""
        self._points = [*self._points, point.ravel()][-SETTINGS.mixed :]
        self._images = [*self._images, image.ravel()][-SETTINGS.mixed :]
        images = np.array(self._images)
        off = images - np.array(self._points)
        weights = np.linalg.lstsq(np.diff(off, axis=0).T, off[-1], rcond=None)[0]
        return np.asarray((images[-1] - weights @ np.diff(images, axis=0)).reshape(image.shape))


@dataclass(frozen=True, eq=False)
class ObservedModel:
    """A model over an experiment with an observation."""

    experiment: Experiment
    map: SensorMap
    simulate: Simulate
    names: tuple[str, ...]  # of theta: variables of the model and quantities of the map
    fixed: Floats  # (q,), values of all quantities that are not in theta
    gains: Floats | None = None  # (n_inputs,), factors of inputs that are no voltages

    @property
    def nominal_inputs(self) -> Floats:
        """Quantities of the inputs that the experiment's own inputs have: those of the observation, without drops."""
        given = np.where(self.map.has_drop, 0.0, self.map.given.values)
        return np.asarray(given[self.map.of_inputs])

    def quantities(self, thetas: Floats) -> Floats:
        """Return all quantities (m, q) of thetas (m, N)."""
        known, found = self.map.given.names, np.tile(self.fixed, (len(thetas), 1))
        for j, name in enumerate(self.names):
            if name in known:
                found[:, known.index(name)] = thetas[:, j]
        return found

    def readings(self, thetas: Floats, own: Indices) -> Simulations:
        """Return outputs (m, K, n_outputs) of thetas (m, N); the model takes `own`."""
        values = self.quantities(thetas)
        model, errors = self.model_outputs(thetas, values, own)
        found = np.stack([self.seen(each, row) for each, row in zip(model, values, strict=True)])
        return Simulations(found, errors)

    def model_outputs(
        self, thetas: Floats, values: Floats, own: Indices
    ) -> tuple[Floats, tuple[Exception | None, ...]]:
        """Return outputs of the model (m, K, n_model); equal models with equal inputs are simulated once."""
        keys = np.hstack([thetas[:, own], values[:, self.map.of_inputs]])
        _, first, back = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        back = back.ravel()
        if (values[:, self.map.of_inputs] == self.nominal_inputs).all():
            inputs = None if self.gains is None else self.experiment.input_values * self.gains
            found = self.simulate(np.ascontiguousarray(thetas[first][:, own]), inputs)
            return found.outputs[back], tuple(found.errors[i] for i in back.tolist())
        each = [self.driven(thetas[i, own], values[i])[0] for i in first.tolist()]
        return np.concatenate([one.outputs for one in each])[back], tuple(each[i].errors[0] for i in back.tolist())

    def driven(self, theta: Floats, values: Floats, guess: Floats | None = None) -> tuple[Simulations, Floats]:
        """Simulate the model with voltages behind readings, less drops; return its inputs.

        The fixed point begins at currents (K, 2), if given.
        """
        lines, before = self.map.lines(values), guess
        if before is None or not values[self.map.has_drop].any():
            inputs = self.inputs(lines)
            found = self.simulate(theta[None], inputs)
            if found.errors[0] is not None or not values[self.map.has_drop].any():
                return found, inputs
            before = self.currents(found.outputs[0])
        mixing = AndersonMixing()  # a dead time at zero current is a large resistance: plain iteration may not settle
        for _ in range(SETTINGS.most):
            inputs = self.inputs(lines - self.map.drop(values, before))
            found = self.simulate(theta[None], inputs)
            if found.errors[0] is not None:
                return found, inputs
            now = self.currents(found.outputs[0])
            if np.abs(now - before).max() <= SETTINGS.tolerance * np.abs(now).max():
                return found, inputs
            before = mixing.next(before, now)
        sizes = zip(np.array(self.map.given.names)[self.map.has_drop], values[self.map.has_drop].tolist(), strict=True)
        text = "voltages that depend on the currents do not settle"
        error = SimulationError(self.experiment.source, np.nan, {str(name): size for name, size in sizes}, text)
        return Simulations(np.full_like(found.outputs, np.nan), (error,)), inputs

    def inputs(self, lines: Floats) -> Floats:
        """Return the inputs (K, n_inputs) with voltages of lines (K, 3)."""
        found = self.experiment.input_values * (1.0 if self.gains is None else self.gains)
        found[:, [self.experiment.input_names.index(name) for name in self.map.given.voltages]] = self.map.axes(lines)
        return found

    def currents(self, outputs: Floats) -> Floats:
        """Return the currents (K, 2) among model outputs (K, n_model)."""
        names = self.experiment.of_model.output_names
        return np.asarray(outputs[:, [names.index(name) for name in self.map.given.currents]])

    def currents_behind(self, outputs: Floats, values: Floats) -> Floats:
        """Return the currents (K, 2) behind outputs (K, n_outputs); NaN from fewer than two sensors."""
        places = [self.experiment.output_names.index(name) for name in self.map.given.current_sensors]
        return self.map.measured_axes(outputs[:, places], values)

    def seen(self, outputs: Floats, values: Floats) -> Floats:
        """Return the experiment's outputs (K, n_outputs) of model outputs (K, n_model)."""
        return self._arranged(outputs, self.map.outputs(self.currents(outputs), values))

    def _arranged(self, outputs: Floats, readings: Floats) -> Floats:
        """Return model outputs and readings as outputs (K, n_outputs)."""
        others, sensors = self.experiment.of_model.output_names, list(self.map.given.current_sensors)
        columns: Sequence[Floats] = [
            readings[:, sensors.index(name)] if name in sensors else outputs[:, others.index(name)]
            for name in self.experiment.output_names
        ]
        return np.stack(columns, axis=1)

    def between(self, outputs: Floats, values: Floats) -> Floats:
        """Return outputs (K − 1, n_outputs) of model outputs between the samples."""
        return self._arranged(outputs, self.map.between(self.currents(outputs), values))

    def changes(self, changes: Floats, values: Floats) -> Floats:
        """Return changes of outputs (m, K, n_outputs) by those of the model."""
        currents = np.stack([self.currents(each) for each in changes])
        readings = self.map.slopes(currents, values)
        return np.stack([self._arranged(*pair) for pair in zip(changes, readings, strict=True)])

    def derivatives(self, outputs: Floats, values: Floats) -> Floats:
        """Return derivatives (q, K, n_outputs) by sensors at model outputs (K, n_model)."""
        readings = self.map.derivatives(self.currents(outputs), values)
        nothing = np.zeros_like(outputs)
        return np.stack([self._arranged(nothing, each) for each in readings])
