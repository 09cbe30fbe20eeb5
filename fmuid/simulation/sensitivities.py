"""Sensitivities of a simulator's outputs by the model (docs/method.md section 3): forward, or its own outputs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError, SensitivityUnavailableError
from fmuid.models import DEFAULT_TOLERANCE
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.forward_simulation import (
    SensitivityRefusal,
    SensitivitySimulation,
    directional_simulation,
    extended_by,
    initial_simulation,
    initial_states,
    twin_simulation,
)
from fmuid.simulation.simulator import Simulator


def derivatives_of(simulator: Simulator, sensitivity: str) -> Callable[[Floats], Floats]:
    """Return theta (N,) -> the derivatives (N, K, n_outputs) of a simulator's outputs, in the units of its table.

    Parameters
    ----------
    simulator : Simulator
    sensitivity : "forward" or "fmu"
        Integrated with the model, or outputs of the FMU.

    Raises
    ------
    InputError
        If the model has no such sensitivities.
    """
    if sensitivity == "fmu":
        return FmuSensitivities(simulator)
    return ForwardSensitivities(simulator)


class FmuSensitivities:
    """Sensitivities that the FMU outputs, as ``sens.R.i`` for the derivative of the output i by the parameter R.

    `fmuid export --sensitivities` makes such FMUs. They go with a single FMU: in a system other components would change
    with the parameter, and they would not be the whole derivative.

    Raises
    ------
    InputError
        If one of them is missing, or the model is a system of several components.
    """

    def __init__(self, simulator: Simulator) -> None:
        system, experiment = simulator.system, simulator.experiment
        if len(system.components) > 1:
            raise InputError(
                'sensitivity = "fmu" goes with a single FMU: coupled ones change each other; use "finite-difference"'
            )
        wanted = [
            " + ".join(f"sens.{p}.{term}" for term in system.terms(y))
            for p in simulator.parameters
            for y in experiment.output_names
        ]
        for name in (term for each in wanted for term in system.terms(each)):
            if name not in system.variables:
                raise InputError(
                    f'{system.label} has no output {name!r}, the sensitivity that sensitivity = "fmu" needs; export '
                    f'it with --sensitivities, or use "finite-difference"'
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
    """Steps of differences, as shares of a parameter, and what a check of derivatives allows.

    One comparison with differences of whole simulations shows whether an FMU's directional derivatives know of its
    parameters: FMI 2.0 does not promise it.
    """

    check: float = 1e-3
    """Of differences of whole simulations."""
    allowed: float = 0.1
    """Share of the change by which the two may differ, ..."""
    rounding: float = 1e-6
    """... and of an output: what the integration leaves in it."""
    central: float = 2.0**-17
    """Of initial states."""
    twin: float = 2.0**-26
    """Of right-hand sides, one-sided."""
    twin_tolerance: float = 1e-7
    """The differences' rounding, which must not make an integrator shorten its steps."""


STEPS = SensitivitySteps()


class ForwardSensitivities:
    """Sensitivities integrated with a model-exchange FMU (1.26, 1.27).

    The right-hand sides of the sensitivities are the FMU's directional derivatives along states and parameter, if it
    has such; else differences between the model and twins of it, one a parameter, that are kept in step with it. The
    twins serve from then on, too, where an event changes the states or their derivatives.

    Raises
    ------
    InputError
        If the model is not one FMU that runs by model exchange.
    """

    def __init__(self, simulator: Simulator) -> None:
        components = list(simulator.system.components.values())
        if len(components) > 1:
            raise InputError(
                'sensitivity = "forward" goes with a single FMU: coupled ones change each other; '
                'use "finite-difference"'
            )
        (model,) = components
        if model.kind != "model-exchange":
            offered = "model-exchange" in model.fmu.description.interfaces
            remedy = 'give interface = "model-exchange", or ' if offered else ""
            raise InputError(
                f'{model.fmu.path} runs as co-simulation, inside which sensitivity = "forward" cannot see; {remedy}'
                f'use sensitivity = "finite-difference"'
            )
        self._simulator, self._model = simulator, model
        variables = [simulator.system.variables[name] for name, *_ in simulator.targets]
        self._nominal = np.array([abs(variable.nominal or 1.0) for variable in variables])
        self._directional = directional_simulation(simulator)
        self._initial = initial_simulation(simulator) if self._directional else None
        self._checked = False
        self._twins: SensitivitySimulation | None = None
        self._lock = threading.RLock()  # the arrays of a run hold one theta

    @property
    def by_differences(self) -> bool:
        """Whether the right-hand sides are differences, not directional derivatives of the FMU."""
        return self._directional is None

    def __call__(self, theta: Floats) -> Floats:
        """Return the derivatives (N, K, n_outputs).

        Raises
        ------
        SensitivityUnavailableError
            If the FMU can be instantiated only once and twins are needed, an event cannot be gone through, or the
            simulation fails.
        """
        with self._lock:
            return self._derivatives(theta)

    def _derivatives(self, theta: Floats) -> Floats:
        targets = self._simulator.targets
        columns = np.array([column for _, column, _, _ in targets], np.intp)
        factors, offsets = np.array([each[2:] for each in targets], np.float64).reshape(-1, 2).T
        values = factors * theta[columns] + offsets
        magnitudes = np.where(values != 0.0, np.abs(values), self._nominal)
        found: Floats | SensitivityRefusal | None = None
        if self._directional is not None:
            found = self._by_directional_derivatives(self._directional, values, magnitudes)
        if found is None:
            self._directional = None
            found = self._by_twins(values, magnitudes)
        if isinstance(found, SensitivityRefusal):
            raise SensitivityUnavailableError(found.reason)
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
        """Return the derivatives by variables, in the units of the FMU, None if the FMU does not give them."""
        initial = self._initial_sensitivities(values, magnitudes)
        if initial is None:
            return None
        simulation.given.magnitudes[:], simulation.given.initial[:] = magnitudes, initial
        outputs = simulation.simulate(executor_of(self._simulator.system), values)
        if isinstance(outputs, SensitivityRefusal):
            return None
        n = len(self._simulator.output_names)
        return np.moveaxis(outputs[:, n:].reshape(len(outputs), values.size, n), 1, 0)

    def _initial_sensitivities(self, values: Floats, magnitudes: Floats) -> Floats | None:
        """Return the derivatives (N, n_states) of the initial states, by central differences of initialisations."""
        if self._initial is None:
            return None
        steps = np.diag(STEPS.central * magnitudes)
        changed = np.concatenate([values + steps, values - steps])
        states = initial_states(self._initial, executor_of(self._simulator.system), changed)
        if states is None:
            return None
        n = values.size
        found: Floats = (states[:n] - states[n:]) / (np.diag(changed[:n]) - np.diag(changed[n:]))[:, None]
        return found

    def _agrees(self, found: Floats, theta: Floats, nominals: Floats) -> bool:
        """Return whether differences of whole simulations say much the same; those that fail say nothing."""
        steps = STEPS.check * np.where(theta != 0.0, np.abs(theta), nominals)
        outputs = self._simulator.many(np.concatenate([theta[None], theta + np.diag(steps)])).outputs
        change = outputs[1:] - outputs[0]
        error, size = change - found * steps[:, None, None], np.abs(outputs[0]).max(axis=0)
        return not bool((_rms(error) > STEPS.allowed * _rms(change) + STEPS.rounding * size).any())

    def _by_twins(self, values: Floats, magnitudes: Floats) -> Floats | SensitivityRefusal:
        if not self._simulator.system.can_be_repeated:
            name = self._model.fmu.path.name
            return SensitivityRefusal(f"{name} can be instantiated only once, and differences need twins of it")
        if self._twins is None:
            self._twins = twin_simulation(self._simulator)
        simulation, changed = self._twins, values + STEPS.twin * magnitudes
        tolerance = self._model.numerics.tolerance or DEFAULT_TOLERANCE
        simulation.given.magnitudes[:] = magnitudes * min(1.0, tolerance / STEPS.twin_tolerance)
        simulation.given.steps[:] = changed - values
        several = np.tile(values, (values.size + 1, 1))
        np.fill_diagonal(several, changed)
        outputs = simulation.simulate(executor_of(simulation.system), several.ravel())
        if isinstance(outputs, SensitivityRefusal):
            return outputs
        split = np.moveaxis(outputs.reshape(len(outputs), values.size + 1, -1), 1, 0)
        found: Floats = (split[:-1] - split[-1]) / simulation.given.steps[:, None, None]
        return found


def _rms(values: Floats) -> Floats:
    """Return the root of the mean square over the samples of (N, K, n_outputs)."""
    found: Floats = np.sqrt(np.mean(values**2, axis=1))
    return found
