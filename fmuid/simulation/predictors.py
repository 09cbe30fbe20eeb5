"""The predictor of each kind of experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from fmuid.data import Experiment, FrequencyExperiment, SteadyExperiment
from fmuid.errors import NO_EXPERIMENT, check_kind
from fmuid.models import PHASOR_FORMULAS, System
from fmuid.simulation.frequency_simulator import FrequencySimulator, response_unit
from fmuid.simulation.phasor_simulator import PhasorSimulator
from fmuid.simulation.point_simulator import PointSimulator
from fmuid.simulation.simulation_task import Value, column_conversion
from fmuid.simulation.simulator import Simulator
from fmuid.simulation.solver_refinement import Refinement, refined
from fmuid.simulation.steady_simulator import SteadySimulator, is_formula, unit_factor

AnySimulator: TypeAlias = Simulator | PointSimulator


def simulator_of(
    system: System,
    experiment: Experiment,
    parameters: Sequence[str] = (),
    values: Mapping[str, Value] | None = None,
    step_size: float | None = None,
) -> AnySimulator:
    """Return the predictor of an experiment, by its kind.

    `InputError`: as of `Simulator`, or the model has no such operating points.
    """
    check_kind(experiment, Experiment, NO_EXPERIMENT)
    if isinstance(experiment, FrequencyExperiment):
        return FrequencySimulator(system, experiment, parameters, values=values)
    if isinstance(experiment, SteadyExperiment):
        kind = SteadySimulator if experiment.supply is None else PhasorSimulator
        return kind(system, experiment, parameters, values=values)
    return Simulator(system, experiment, parameters, values=values, step_size=step_size)


def finer_simulator(simulator: AnySimulator, system: System, refinement: Refinement) -> AnySimulator:
    """Return a simulator with a solver refinement (`refined`); operating points have none."""
    return refined(simulator, system, refinement) if isinstance(simulator, Simulator) else simulator


def output_unit(system: System, experiment: Experiment, name: str) -> str | None:
    """Return the unit of an output in the data."""
    if name in experiment.units:
        return experiment.units[name]
    if isinstance(experiment, FrequencyExperiment):
        return response_unit(system, experiment, name)
    if isinstance(experiment, SteadyExperiment) and is_formula(system, name):
        return PHASOR_FORMULAS[name].unit or None
    return system.unit(name)


def output_factor(system: System, name: str, unit: str) -> float:
    """Return the factor from a unit to that of an output."""
    if is_formula(system, name):
        return unit_factor(unit, PHASOR_FORMULAS[name].unit, f"output {name!r}")
    if system.terms(name)[0] not in system.variables:  # a sensor, whose reading is its own
        return 1.0
    return column_conversion(system, name, unit)[0]
