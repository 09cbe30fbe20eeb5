"""Sensitivities of a simulator's outputs that the model gives (method.md section 3): outputs of the FMU."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fmuid.errors import InputError
from fmuid.experiment import Experiment
from fmuid.simulator import Simulator

Floats = NDArray[np.float64]


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
    raise InputError('sensitivity = "forward" is not available')


class FmuSensitivities:
    """Sensitivities that the FMU outputs, as ``sens.R.i`` for the derivative of the output i by the parameter R.

    `fmuid export --sensitivities` makes such FMUs. In a system they are ``component.sens.R.i``, and exist within a
    component only; where other components would change with the parameter, they are not the whole derivative.

    Parameters
    ----------
    simulator : Simulator

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
        names = [
            " + ".join(f"sens.{p}.{term}" for term in system.terms(y))
            for p in simulator.parameters
            for y in experiment.output_names
        ]
        for name in (term for name in names for term in system.terms(name)):
            if name not in system.variables:
                raise InputError(
                    f'{system.label} has no output {name!r}, the sensitivity that sensitivity = "fmu" needs; export '
                    f'it with --sensitivities, or use "finite-difference"'
                )
        frame = experiment.frame.assign(**dict.fromkeys(names, 0.0))
        self._shape = len(simulator.parameters), len(experiment.output_names)
        units = {name: experiment.units[name] for name in experiment.input_names if name in experiment.units}
        extended = Experiment(
            frame,
            experiment.inputs,
            names,
            time=experiment.time,
            interpolation=experiment.interpolation,
            units=units,
            name=experiment.name,
            source=experiment.source,
        )
        self._simulator = simulator.over(extended)
        self._factors = simulator.output_factors

    def __call__(self, theta: Floats) -> Floats:
        """Return the derivatives (N, K, n_outputs)."""
        found = self._simulator(theta).reshape(-1, *self._shape)
        return np.moveaxis(found, 1, 0) * self._factors
