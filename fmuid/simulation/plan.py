"""Lays down, as arrays, what the core does for one task."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fmuid.models import DEFAULT_TOLERANCE
from fmuid.simulation import core_constants as codes
from fmuid.simulation import plan_builder as operations
from fmuid.simulation.grid import grid_of
from fmuid.simulation.plan_builder import Outputs, PlanBuilder
from fmuid.simulation.simulation_plan import MOST_STEPS, GridSimulation, Integration, SimulationPlan
from fmuid.simulation.task import SimulationTask


def simulation_of(task: SimulationTask) -> GridSimulation:
    """Return the run of a task.

    Raises
    ------
    InputError
        If an FMU cannot step that way, or elements of one array vary in different ways.
    """
    return GridSimulation(plan_of(task), grid_of(task), task.experiment.output_names)


def plan_of(task: SimulationTask, add_outputs: Callable[[PlanBuilder], Outputs] = operations.outputs) -> SimulationPlan:
    """Return the plan of a task.

    Parameters
    ----------
    task : SimulationTask
    add_outputs : callable, optional
        Appends what gets the outputs; default: those of the experiment, and nothing else.

    Raises
    ------
    InputError
        If elements of one array vary in different ways.
    """
    system, to = task.system, PlanBuilder(task)
    stages = [0]

    def end_stage() -> None:
        stages.append(len(to.calls))

    parameter_slots = operations.start_values(to)
    end_stage()
    input_slots = to.transfer(list(task.targets), setting=True)
    end_stage()
    groups = operations.exchange(to)
    end_stage()
    output_slots, output_terms = add_outputs(to)
    end_stage()
    slope_slots = operations.input_slopes(to)
    end_stage()
    for component in system.components:
        if system.master == "gauss-seidel":
            operations.exchange_after(to, component)
        end_stage()
    return SimulationPlan(
        operations=tuple(to.calls),
        stages=np.array(stages, np.intp),
        groups=np.array(groups, np.intp).reshape(-1, 2),
        loops=tuple(to.loops),
        references=np.array(to.references, np.uint32),
        signals=np.array(to.signals, np.float64),
        conversions=np.array(to.conversions, np.float64).reshape(-1, 2),
        texts=tuple(to.texts),
        parameter_signals=np.array(parameter_slots, np.intp),
        input_signals=np.array(input_slots, np.intp),
        input_modes=np.array(list(task.modes.values()), np.intp),
        input_curves=_curves(task),
        derivative_signals=np.array(slope_slots, np.intp),
        output_signals=np.array(output_slots, np.intp),
        output_terms=np.array(output_terms, np.intp),
        integrations=tuple(_integration(task, name) for name in system.components),
        tolerances=np.array([model.numerics.tolerance or 0.0 for model in system.components.values()]),
        gauss_seidel=system.master == "gauss-seidel",
    )


def _integration(task: SimulationTask, component: str) -> Integration | None:
    model, system = task.system.components[component], task.system
    if model.kind != "model-exchange":
        return None
    inputs = [name for name in task.modes if system.split(name)[0] == component]
    varying = task.polynomial_rows(component)
    connected = any(connection.target[0] == component for connection in system.connections)
    return Integration(
        model.integrator,
        model.numerics.tolerance or DEFAULT_TOLERANCE,
        task.step_size or model.numerics.step_size,
        np.array(list(dict.fromkeys(system.variables[name].reference for name in varying)), np.uint32),
        np.array([task.start(name) for name in varying], np.float64),
        # with events, no step goes beyond a sample: a long one may step over what happens inside it
        autonomous=not inputs and not connected and model.fmu.description.indicators == 0,
        most_steps=model.numerics.most_steps or MOST_STEPS,
    )


def _curves(task: SimulationTask) -> tuple[tuple[int, int], ...]:
    """Return for each input which row of which component's polynomials it is."""
    numbers = {name: i for i, name in enumerate(task.system.components)}
    found = []
    for name, mode in task.modes.items():
        component = task.system.split(name)[0]
        if mode == codes.BY_STEPPER:
            found.append((numbers[component], task.polynomial_rows(component).index(name)))
        else:
            found.append((-1, -1))
    return tuple(found)
