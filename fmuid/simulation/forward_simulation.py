"""Simulations with sensitivities of the states (docs/method/sensitivities.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.errors import SensitivityUnavailableError
from fmuid.models import STIFF_INTEGRATOR, Component, Port, System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import executor_of, variant_of
from fmuid.simulation.plan_builder import grid_of, outputs_with_sensitivities, plan_of, simulation_of
from fmuid.simulation.simulation_plan import GridSimulation, Sensitivities, SimulationPlan
from fmuid.simulation.simulation_task import SimulationTask, task_of
from fmuid.simulation.simulator import Simulator


def extended_by(experiment: Experiment, outputs: Sequence[str]) -> Experiment:
    """Return an experiment with other outputs, in units of the FMU."""
    columns = {name: f"simulated {i}" for i, name in enumerate(outputs)}  # no name of a measured column
    return Experiment(
        experiment.frame,
        experiment.inputs,
        columns,
        time=experiment.time,
        interpolation=experiment.interpolation,
        units={name: experiment.units[name] for name in experiment.input_names if name in experiment.units},
        measured=False,
        name=experiment.name,
        source=experiment.source,
    )


@dataclass(frozen=True)
class SensitivitySimulation:
    """A simulation with sensitivities; `given` is filled in before each run."""

    simulation: GridSimulation
    system: System
    given: Sensitivities

    def simulate(self, theta: Floats) -> Floats:
        """Simulate theta (N,); return outputs (K, n), or raise SensitivityUnavailableError."""
        executor = executor_of(self.system)
        job = self.simulation.job(theta[None])
        with executor.lock:
            executor.run(job)
            if job.reports[0, 0] == codes.SENSITIVITIES:
                raise SensitivityUnavailableError("the FMU has no directional derivatives of its outputs")
            error = executor.failure(job, {})
        if error is not None:
            raise SensitivityUnavailableError(f"from t = {error.time:g} s on, {error.call}")
        found: Floats = job.outputs[0]
        return found


def directional_simulation(simulator: Simulator) -> SensitivitySimulation | None:
    """Return the simulation with the FMU's directional derivatives; None if they do not suffice."""
    system, names = simulator.system, simulator.target_names
    if not gives_derivatives(system, simulator.output_names, names):
        return None
    states = next(iter(system.components.values())).fmu.description.states
    task = task_of(system, simulator.experiment, names, *simulator.settings)
    plan, given = plan_by_seeds(task, names, len(states))
    simulation = GridSimulation(plan, grid_of(task), simulator.output_names * (1 + len(names)))
    return SensitivitySimulation(simulation, system, given)


def plan_by_seeds(task: SimulationTask, seeds: Sequence[str], n_states: int) -> tuple[SimulationPlan, Sensitivities]:
    """Return a plan with directional derivatives by seeds, and its sensitivities."""
    given = Sensitivities.of([task.system.variables[name].reference for name in seeds], n_states)
    return carrying(plan_of(task, partial(outputs_with_sensitivities, count=len(seeds))), given), given


def gives_derivatives(system: System, outputs: Sequence[str], seeds: Sequence[str]) -> bool:
    """Return whether the only FMU states directional derivatives; neither of arrays nor by start values of states."""
    model, *others = system.components.values()
    if others:
        return False
    description, terms = model.fmu.description, [term for name in outputs for term in system.terms(name)]
    involved = [system.variables[system.targets(name)[0][0]] for name in (*seeds, *terms)]
    involved += [description.variables[name] for name in (*description.states, *description.derivatives)]
    scalar = all(variable.type == "Real" and not variable.array for variable in involved)
    open_to_seeds = all(system.variables[name].causality in ("parameter", "input") for name in seeds)
    return description.interfaces[model.kind].directional_derivatives and scalar and open_to_seeds


def carrying(plan: SimulationPlan, given: Sensitivities) -> SimulationPlan:
    """Return a plan with sensitivities of its last component; others are twins."""
    *twins, last = plan.integrations
    followers = [each and each._replace(follows=True) for each in twins]
    return plan._replace(integrations=(*followers, last and last._replace(sensitivities=given)))


def initial_simulation(simulator: Simulator) -> GridSimulation | None:
    """Return the initialization of a system with its states as outputs; None if these are hidden."""
    system, states = simulator.system, simulator.system.states
    if any(system.variables[name].causality not in ("output", "local") for name in states):
        return None
    experiment = extended_by(simulator.experiment, states)
    simulation = simulation_of(task_of(system, experiment, simulator.target_names, *simulator.settings))
    grid = simulation.grid
    slopes = None if grid.slopes is None else grid.slopes[:1]
    simulation.grid = grid._replace(
        times=grid.times[:1], substeps=grid.substeps[:0], inputs=grid.inputs[:1], slopes=slopes
    )
    return simulation


def initial_states(simulation: GridSimulation, system: System, thetas: Floats) -> Floats | None:
    """Return the initial states (m, n_states); None after a failure."""
    executor, job = executor_of(system), simulation.job(thetas)
    with executor.lock:
        executor.run(job)
    found: Floats = job.outputs[:, 0]
    return None if job.failed.any() or not np.isfinite(found).all() else found


def twin_simulation(simulator: Simulator) -> SensitivitySimulation:
    """Return the simulation of the model and one twin per parameter; it has all their parameters and outputs."""
    system, (model,) = simulator.system, simulator.system.components.values()
    count = len(simulator.target_names)
    inputs = simulator.experiment.input_names
    twins = variant_of(system, ("twins", count, inputs), lambda: _twins(system, count, inputs))

    def inner(name: str) -> str:
        return system.split(name)[1]

    names, (values, step_size) = list(twins.components), simulator.settings
    terms = [[inner(term) for term in system.terms(name)] for name in simulator.output_names]
    given = Sensitivities.of([0] * count, len(model.fmu.description.states), tuple(range(count)))
    outputs = [" + ".join(f"{name}.{term}" for term in some) for name in names for some in terms]
    task = task_of(
        twins,
        extended_by(simulator.experiment, outputs),
        [f"{name}.{inner(parameter)}" for name in names for parameter in simulator.target_names],
        {f"{name}.{inner(v)}": value for name in names for v, value in values.items()},
        step_size,
    )
    task = replace(task, steps=dict.fromkeys(task.steps))  # as for a single FMU: its integrator steps as it likes
    simulation = simulation_of(task)
    for component in range(count + 1) if simulator.stiff else ():
        simulation.integrate(component, STIFF_INTEGRATOR)
    simulation.plan = carrying(simulation.plan, given)
    return SensitivitySimulation(simulation, twins, given)


def _twins(system: System, count: int, inputs: tuple[str, ...]) -> System:
    (model,) = system.components.values()
    names = [*(f"twin{j + 1}" for j in range(count)), "model"]

    def ports(given: str) -> list[Port]:
        return [
            (f"{name}.{system.split(v)[1]}", factor, offset)
            for name in names
            for v, factor, offset in system.targets(given)
        ]

    return System(
        components={name: Component(model.fmu, model.numerics) for name in names},
        connectors={name: ports(name) for name in inputs},
        values={f"{name}.{system.split(v)[1]}": value for name in names for v, value in system.values.items()},
        isolation=system.isolation,
    )
