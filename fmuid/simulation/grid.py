"""The experiment as the core walks it."""

from __future__ import annotations

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.simulation import core_constants as codes
from fmuid.simulation.simulation_plan import TimeGrid
from fmuid.simulation.task import SimulationTask
from fmuid.simulation.variable_checks import column_conversion

# Substeps of a sampling interval where an input is linear in between but the FMU can only hold it. Each substep
# holds the value at its middle, an error of second order in the substep: a hundredth of that of one whole step.
LINEAR_SUBSTEPS = 10
# Steps that differ by less, relatively, count as equal: sampling times are rounded, often to single precision. A second
# substep where the table says 1.00002 ms instead of 1 ms would double a sampled controller's rate.
STEP_TOLERANCE = 1e-3


def grid_of(task: SimulationTask) -> TimeGrid:
    """Return the grid of a task: steps no longer than they may be, else from sample to sample.

    Where inputs are linear in between and their FMU cannot interpolate, `LINEAR_SUBSTEPS` to a sampling interval.

    Raises
    ------
    InputError
        If an FMU cannot step that way.
    """
    intervals = np.diff(task.experiment.times)
    steps = [step for step in task.steps.values() if step is not None]
    strides = np.ones(len(task.steps), np.intp)
    curved = {name for name, each in task.targets.items() if task.experiment.curved[each.column]}
    if steps:
        smallest = min(steps)
        substeps = np.ceil(intervals / smallest * (1 - STEP_TOLERANCE))
        strides[:] = [max(1, round((step or smallest) / smallest)) for step in task.steps.values()]
    else:
        coarse = any(
            mode == codes.BY_MIDPOINT or (mode == codes.BY_DERIVATIVE and name in curved)
            for name, mode in task.modes.items()
        )
        substeps = np.full(intervals.shape, LINEAR_SUBSTEPS if coarse else 1)
    substeps = np.maximum(substeps, 1).astype(np.intp) * task.divisor
    strides *= [1 if task.system.integrates(component) else task.divisor for component in task.steps]
    _check_steps(task, intervals / substeps)
    inputs, slopes = _converted_inputs(task)
    return TimeGrid(np.array(task.experiment.times), substeps, strides, inputs, slopes if curved else None)


def _check_steps(task: SimulationTask, steps: Floats) -> None:
    """Refuse unequal steps where an FMU declares that it cannot take them."""
    taken = steps[steps > 0]
    if taken.size == 0 or np.ptp(taken) <= STEP_TOLERANCE * taken.max():
        return
    for model in task.system.components.values():
        interface = model.fmu.description.interfaces[model.kind]
        if model.kind == "co-simulation" and not interface.variable_step:
            raise InputError(
                f"{model.fmu.path.name} needs communication steps of one length, and {task.experiment.source} "
                f"is sampled irregularly ({taken.min():g} s to {taken.max():g} s); resample the table"
            )


def _converted_inputs(task: SimulationTask) -> tuple[Floats, Floats]:
    """Return the inputs, and their slopes at the samples, in the units of the FMU."""
    experiment = task.experiment
    columns = [each.column for each in task.targets.values()]
    inputs = np.array(experiment.input_values[:, columns], np.float64, order="C")
    slopes = np.array(experiment.input_slopes[:, columns], np.float64, order="C")
    for j, each in enumerate(task.targets.values()):
        name = experiment.input_names[each.column]
        factor, offset = 1.0, 0.0
        if name in experiment.units:
            factor, offset = column_conversion(task.system, name, experiment.units[name])
        inputs[:, j] = each.factor * (factor * inputs[:, j] + offset) + each.offset
        slopes[:, j] *= factor * each.factor
    return inputs, slopes
