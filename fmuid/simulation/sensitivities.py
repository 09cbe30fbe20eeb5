"""Sensitivities of outputs by the model (docs/method/sensitivities.md)."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError, SensitivityUnavailableError
from fmuid.models import DEFAULT_TOLERANCE
from fmuid.simulation.forward_simulation import (
    SensitivitySimulation,
    directional_simulation,
    extended_by,
    initial_simulation,
    initial_states,
    twin_simulation,
)
from fmuid.simulation.simulator import Simulator


def derivatives_of(simulator: Simulator, sensitivity: str) -> Callable[[Floats], Floats]:
    """Return a function theta (N,) → derivatives (N, K, n_outputs) of the outputs.

    The sensitivities are integrated with the model, "forward", or outputs of the FMU, "fmu"; else an `InputError`.
    """
    kind = FmuSensitivities if sensitivity == "fmu" else ForwardSensitivities
    return kind(simulator) if simulator.observed is None else ObservedSensitivities(simulator, kind)


class ObservedSensitivities:
    """Sensitivities of sensor readings: the model's through the map, those of sensors in closed form.

    Quantities that change the inputs have differences, and so has the model while voltages depend on its currents.
    """

    def __init__(self, simulator: Simulator, kind: Callable[[Simulator], Callable[[Floats], Floats]]) -> None:
        assert simulator.observed is not None, "an observation was asked for"
        self._simulator, self._observed = simulator, simulator.observed
        own = [simulator.parameters[j] for j in simulator.own]
        self._model = simulator.of_model.over(simulator.experiment.of_model, own)
        self._derivatives = kind(self._model) if own else None
        self.by_differences = bool(getattr(self._derivatives, "by_differences", False))

    def __call__(self, theta: Floats) -> Floats:
        """Return the derivatives (N, K, n_outputs)."""
        observed, own = self._observed, self._simulator.own
        known, (values,) = observed.map.given.names, observed.quantities(theta[None])
        if values[observed.map.of_inputs].tolist() != observed.nominal_inputs.tolist():
            return self._differences(theta, range(theta.size))
        found = np.zeros((theta.size, *self._simulator.experiment.output_values.shape))
        outputs = self._model(theta[own])
        if self._derivatives is not None:
            found[own] = observed.changes(self._derivatives(theta[own]), values)
        by_sensor = observed.derivatives(outputs, values)
        for j, name in enumerate(self._simulator.parameters):
            if name in known:
                found[j] = by_sensor[known.index(name)]
        moved = [j for j, name in enumerate(self._simulator.parameters) if name in known]
        moved = [j for j in moved if observed.map.of_inputs[known.index(self._simulator.parameters[j])]]
        found[moved] = self._differences(theta, moved)[moved] if moved else 0.0
        return found

    def _differences(self, theta: Floats, columns: Iterable[int]) -> Floats:
        """Return central differences (N, K, n_outputs) of some columns."""
        listed = list(columns)
        found = np.zeros((theta.size, *self._simulator.experiment.output_values.shape))
        steps = STEPS.observed * np.maximum(np.abs(theta), 1e-3)
        moved = np.diag(steps)[listed]
        above, below = np.split(self._simulator(np.vstack([theta + moved, theta - moved])), 2)
        found[listed] = (above - below) / (2.0 * steps[listed, None, None])
        return found


class FmuSensitivities:
    """Sensitivities as outputs of one FMU (`fmuid export --sensitivities`): ``sens.R.i`` is ∂i/∂R."""

    def __init__(self, simulator: Simulator) -> None:
        system, experiment = simulator.system, simulator.experiment
        if len(system.components) > 1:
            raise InputError('jacobian: "fmu" needs a single FMU, not coupled ones. Use "finite-difference".')
        wanted = [
            " + ".join(f"sens.{p}.{term}" for term in system.terms(y))
            for p in simulator.parameters
            for y in experiment.output_names
        ]
        for name in (term for each in wanted for term in system.terms(each)):
            if name not in system.variables:
                raise InputError(
                    f'{system.label}: jacobian = "fmu" needs the output {name!r}. Export '
                    f'the FMU with --sensitivities, or use "finite-difference".'
                )
        extended = extended_by(experiment, wanted)
        self._shape = len(simulator.parameters), len(experiment.output_names)
        self._simulator = simulator.over(extended)
        self._factors = simulator.output_factors

    def __call__(self, theta: Floats) -> Floats:
        """Return the derivatives (N, K, n_outputs)."""
        found = self._simulator(theta).reshape(-1, *self._shape)
        return np.moveaxis(found, 1, 0) * self._factors


@dataclass(frozen=True)
class SensitivitySteps:
    """Relative steps of differences, and limits of a derivative check."""

    # of differences of whole simulations, once: FMI 2.0 does not promise directional derivatives by parameters
    check: float = 1e-3
    allowed: float = 0.1  # share of the change by which the two may differ, ...
    rounding: float = 1e-6  # ... and of an output: what the integration leaves in it
    observed: float = 1e-4  # of voltages behind their readings
    central: float = 2.0**-17  # of initial states
    twin: float = 2.0**-26  # of right-hand sides, one-sided
    twin_tolerance: float = 1e-7  # the differences' rounding, which must not make an integrator shorten its steps


STEPS = SensitivitySteps()


class ForwardSensitivities:
    """Sensitivities integrated with one Model Exchange FMU (1.26, 1.27).

    Their right-hand sides are the FMU's directional derivatives, else differences between the model and twins.
    """

    def __init__(self, simulator: Simulator) -> None:
        components = list(simulator.system.components.values())
        if len(components) > 1:
            raise InputError('jacobian: "forward" needs a single FMU, not coupled ones. Use "finite-difference".')
        (model,) = components
        if model.kind != "model-exchange":
            offered = "model-exchange" in model.fmu.description.interfaces
            remedy = 'Set interface = "model-exchange", or use' if offered else "Use"
            raise InputError(
                f'{model.fmu.path}: jacobian = "forward" needs Model Exchange. {remedy} jacobian = "finite-difference".'
            )
        self._simulator, self._model = simulator, model
        variables = [simulator.system.variables[name] for name in simulator.target_names]
        self._nominal = np.array([abs(variable.nominal or 1.0) for variable in variables])
        self._directional = directional_simulation(simulator)
        self._initial = initial_simulation(simulator) if self._directional else None
        self._checked = False
        self._twins: SensitivitySimulation | None = None
        self._lock = threading.RLock()  # the arrays of a run hold one theta

    @property
    def by_differences(self) -> bool:
        """Whether the right-hand sides are differences."""
        return self._directional is None

    def __call__(self, theta: Floats) -> Floats:
        """Return the derivatives (N, K, n_outputs), or a `SensitivityUnavailableError`."""
        with self._lock:
            return self._derivatives(theta)

    def _derivatives(self, theta: Floats) -> Floats:
        columns, factors = self._simulator.columns, self._simulator.factors
        values = self._simulator.target_values(theta[None])[0]
        magnitudes = np.where(values != 0.0, np.abs(values), self._nominal)
        found = None
        if self._directional is not None:
            found = self._by_directional_derivatives(self._directional, values, magnitudes)
        if found is None:
            self._directional = None
            found = self._by_twins(values, magnitudes)
        gathered = np.zeros((theta.size, *found.shape[1:]))
        for column, factor, each in zip(columns.tolist(), factors.tolist(), found, strict=True):
            gathered[column] += factor * each
        gathered *= self._simulator.output_factors
        if self._directional is not None and not self._checked:
            self._checked = True
            nominals = np.ones(theta.size)
            nominals[columns] = self._nominal / np.abs(factors)
            if not self._agrees(gathered, theta, nominals):
                self._directional = None
                return self._derivatives(theta)
        return gathered

    def _by_directional_derivatives(
        self, simulation: SensitivitySimulation, values: Floats, magnitudes: Floats
    ) -> Floats | None:
        """Return derivatives by variables, in FMU units; None without them."""
        initial = self._initial_sensitivities(values, magnitudes)
        if initial is None:
            return None
        simulation.given.magnitudes[:], simulation.given.initial[:] = magnitudes, initial
        try:
            outputs = simulation.simulate(values)
        except SensitivityUnavailableError:
            return None
        n = len(self._simulator.output_names)
        return np.moveaxis(outputs[:, n:].reshape(len(outputs), values.size, n), 1, 0)

    def _initial_sensitivities(self, values: Floats, magnitudes: Floats) -> Floats | None:
        """Return derivatives (N, n_states) of the initial states, by central differences."""
        if self._initial is None:
            return None
        steps = np.diag(STEPS.central * magnitudes)
        changed = np.concatenate([values + steps, values - steps])
        states = initial_states(self._initial, self._simulator.system, changed)
        if states is None:
            return None
        n = values.size
        found: Floats = (states[:n] - states[n:]) / (np.diag(changed[:n]) - np.diag(changed[n:]))[:, None]
        return found

    def _agrees(self, found: Floats, theta: Floats, nominals: Floats) -> bool:
        """Return whether differences of simulations agree; failed ones do."""
        steps = STEPS.check * np.where(theta != 0.0, np.abs(theta), nominals)
        outputs = self._simulator.many(np.concatenate([theta[None], theta + np.diag(steps)])).outputs
        change = outputs[1:] - outputs[0]
        error, size = change - found * steps[:, None, None], np.abs(outputs[0]).max(axis=0)
        return not bool((_rms(error) > STEPS.allowed * _rms(change) + STEPS.rounding * size).any())

    def _by_twins(self, values: Floats, magnitudes: Floats) -> Floats:
        if not self._simulator.system.can_be_repeated:
            name = self._model.fmu.path.name
            raise SensitivityUnavailableError(f"{name} can be instantiated only once; twins need several instances")
        if self._twins is None:
            self._twins = twin_simulation(self._simulator)
        simulation, changed = self._twins, values + STEPS.twin * magnitudes
        tolerance = self._model.numerics.tolerance or DEFAULT_TOLERANCE
        simulation.given.magnitudes[:] = magnitudes * min(1.0, tolerance / STEPS.twin_tolerance)
        simulation.given.steps[:] = changed - values
        several = np.tile(values, (values.size + 1, 1))
        np.fill_diagonal(several, changed)
        outputs = simulation.simulate(several.ravel())
        split = np.moveaxis(outputs.reshape(len(outputs), values.size + 1, -1), 1, 0)
        found: Floats = (split[:-1] - split[-1]) / simulation.given.steps[:, None, None]
        return found


def _rms(values: Floats) -> Floats:
    found: Floats = np.sqrt(np.mean(values**2, axis=1))
    return found
