"""Simulations that carry the sensitivities of the states to the parameters with them (docs/method.md section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.models import STIFF_INTEGRATOR, Component, Port, System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import Executor, variant_of
from fmuid.simulation.plan_builder import grid_of, outputs_with_sensitivities, plan_of, simulation_of
from fmuid.simulation.simulation_plan import GridSimulation, Sensitivities, SimulationPlan, new_reports
from fmuid.simulation.simulation_task import task_of
from fmuid.simulation.simulator import Simulator


@dataclass(frozen=True)
class SensitivityRefusal:
    """Why there are no sensitivities."""

    reason: str


def extended_by(experiment: Experiment, outputs: Sequence[str]) -> Experiment:
    """Return an experiment with the same inputs and other outputs, in the units of the FMU."""
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


def names_of(simulator: Simulator) -> list[str]:
    """Return the variables that the parameters of a simulator set."""
    return [name for name, *_ in simulator.targets]


@dataclass(frozen=True)
class SensitivitySimulation:
    """A run whose outputs carry sensitivities with them.

    Attributes
    ----------
    simulation : GridSimulation
    system : System
        What it runs.
    given : Sensitivities
        Its arrays are filled in before each simulation.
    """

    simulation: GridSimulation
    system: System
    given: Sensitivities

    def simulate(self, executor: Executor, theta: Floats) -> Floats | SensitivityRefusal:
        """Simulate theta (N,); return the outputs (K, n), or why there are none."""
        outputs = np.empty((1, self.simulation.grid.times.size, len(self.simulation.output_names)))
        reports = new_reports(1)
        with executor.lock:
            executor.run(self.simulation, theta[None], outputs, reports)
            if reports[0, 0] == codes.SENSITIVITIES:
                return SensitivityRefusal("the FMU gives no directional derivatives of its outputs by parameters")
            error = executor.failure(self.simulation, theta, outputs[0], reports[0], {})
        if error is not None:
            return SensitivityRefusal(f"from t = {error.time:g} s on, {error.call}")
        found: Floats = outputs[0]
        return found


def directional_simulation(simulator: Simulator) -> SensitivitySimulation | None:
    """Return the run with directional derivatives of the FMU; the outputs' sensitivities follow them, by parameters.

    None if the FMU has no directional derivatives that would do: it declares none, has arrays, or a parameter is the
    start of a state, which is a known already.
    """
    system, (model,) = simulator.system, simulator.system.components.values()
    description, names = model.fmu.description, names_of(simulator)
    terms = [term for name in simulator.output_names for term in system.terms(name)]
    involved = [system.variables[system.targets(name)[0][0]] for name in (*names, *terms)]
    involved += [description.variables[name] for name in (*description.states, *description.derivatives)]
    scalar = all(variable.type == "Real" and not variable.array for variable in involved)
    open_to_seeds = all(system.variables[name].causality in ("parameter", "input") for name in names)
    if not (description.interfaces[model.kind].directional_derivatives and scalar and open_to_seeds):
        return None
    count = len(names)
    given = Sensitivities(
        magnitudes=np.ones(count),
        initial=np.zeros((count, len(description.states))),
        references=np.array([system.variables[name].reference for name in names], np.uint32),
        steps=np.zeros(count),
        twins=(),
    )
    task = task_of(system, simulator.experiment, names, *simulator.settings)
    plan = plan_of(task, partial(outputs_with_sensitivities, count=count))
    simulation = GridSimulation(carrying(plan, given), grid_of(task), simulator.output_names * (1 + count))
    return SensitivitySimulation(simulation, system, given)


def carrying(plan: SimulationPlan, given: Sensitivities) -> SimulationPlan:
    """Return a plan whose last component is integrated with its sensitivities, and any before follow it as twins."""
    *twins, last = plan.integrations
    followers = [each and each._replace(follows=True) for each in twins]
    return plan._replace(integrations=(*followers, last and last._replace(sensitivities=given)))


def initial_simulation(simulator: Simulator) -> GridSimulation | None:
    """Return the run that initialises a simulator's FMU, and whose outputs are the states.

    None if the states are not open to view.
    """
    system, ((component, model),) = simulator.system, simulator.system.components.items()
    states = [system.full_name(component, name) for name in model.fmu.description.states]
    if any(system.variables[name].causality not in ("output", "local") for name in states):
        return None
    experiment = extended_by(simulator.experiment, states)
    simulation = simulation_of(task_of(system, experiment, names_of(simulator), *simulator.settings))
    grid = simulation.grid
    simulation.grid = grid._replace(times=grid.times[:1], substeps=grid.substeps[:0], inputs=grid.inputs[:1])
    return simulation


def initial_states(simulation: GridSimulation, executor: Executor, thetas: Floats) -> Floats | None:
    """Return the initial states (m, n_states) of thetas (m, N), None if an initialisation fails."""
    outputs = np.empty((len(thetas), 1, len(simulation.output_names)))
    reports = new_reports(len(thetas))
    with executor.lock:
        executor.run(simulation, thetas, outputs, reports)
    found = outputs[:, 0]
    return None if (reports[:, 0] >= 0).any() or not np.isfinite(found).all() else found


def twin_simulation(simulator: Simulator) -> SensitivitySimulation:
    """Return the run of a system that has an FMU N + 1 times: with each parameter a little changed, and last as it is.

    Its parameters and outputs are those of all components in turn.
    """
    system, (model,) = simulator.system, simulator.system.components.values()
    count = len(simulator.targets)
    twins = _twins_of(system, count, simulator.experiment.input_names)

    def inner(name: str) -> str:
        return system.split(name)[1]

    names, (values, step_size) = list(twins.components), simulator.settings
    terms = [[inner(term) for term in system.terms(name)] for name in simulator.output_names]
    given = Sensitivities(
        magnitudes=np.ones(count),
        initial=np.zeros((count, len(model.fmu.description.states))),
        references=np.zeros(count, np.uint32),
        steps=np.ones(count),
        twins=tuple(range(count)),
    )
    task = task_of(
        twins,
        extended_by(
            simulator.experiment,
            [" + ".join(f"{name}.{term}" for term in some) for name in names for some in terms],
        ),
        [f"{name}.{inner(parameter)}" for name in names for parameter in names_of(simulator)],
        {f"{name}.{inner(v)}": value for name in names for v, value in values.items()},
        step_size,
    )
    task = replace(task, steps=dict.fromkeys(task.steps))  # as for a single FMU: its integrator steps as it likes
    simulation = simulation_of(task)
    for component in range(count + 1) if simulator.stiff else ():
        simulation.integrate(component, STIFF_INTEGRATOR)
    simulation.plan = carrying(simulation.plan, given)
    return SensitivitySimulation(simulation, twins, given)


def _twins_of(system: System, count: int, inputs: tuple[str, ...]) -> System:
    """Return the system of a number of twins and the model itself, which all simulators of a system share."""
    return variant_of(system, ("twins", count, inputs), lambda: _new_twins(system, count, inputs))


def _new_twins(system: System, count: int, inputs: tuple[str, ...]) -> System:
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
