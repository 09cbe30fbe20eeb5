"""The right-hand side of an FMU at given states: ẋ = f(x, u, θ) and y = h(x, u, θ), without integrating anything.

Values are set and the FMU is initialised once for each theta; then it is shown times, inputs and states, and its
derivatives and outputs are read. The points are the two ends of each interval between samples, under the inputs of that
interval: what is held steps at a sample, and its step belongs to both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.models import System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.forward_simulation import extended_by, initial_simulation, initial_states, names_of
from fmuid.simulation.plan_builder import grid_of, plan_of
from fmuid.simulation.simulation_plan import GridSimulation, new_reports
from fmuid.simulation.simulation_task import task_of
from fmuid.simulation.simulator import Simulator
from fmuid.simulation.solver_refinement import by_model_exchange


class RightHandSide:
    """Derivatives and outputs of a simulator's model at the ends of its experiment's intervals.

    Parameters
    ----------
    simulator : Simulator
    system : System
        That of the simulator, run by model exchange.

    Attributes
    ----------
    states : tuple of str
    nominals : (n_x,) array
        How large they are.
    """

    def __init__(self, simulator: Simulator, system: System) -> None:
        self._simulator, self._system = simulator, system
        ((component, model),) = system.components.items()
        description = model.fmu.description
        self.states = tuple(system.full_name(component, name) for name in description.states)
        nominals = [description.variables[name].nominal for name in description.states]
        self.nominals = np.array([abs(nominal or 1.0) for nominal in nominals])
        wanted = [system.full_name(component, name) for name in description.derivatives]
        outputs = [" + ".join(system.terms(name)) for name in simulator.output_names]
        names, (values, _) = names_of(simulator), simulator.settings
        task = task_of(system, extended_by(simulator.experiment, [*wanted, *outputs]), names, values, None)
        held = np.array([mode == codes.HELD for mode in task.modes.values()], dtype=np.bool_)
        grid = grid_of(task)
        ends = np.repeat(np.arange(len(grid.times)), 2)[1:-1]
        inputs = grid.inputs[ends]
        inputs[1::2, held] = inputs[::2, held]
        self._grid = grid._replace(
            times=grid.times[ends],
            substeps=np.ones(len(ends) - 1, np.intp),
            strides=np.ones(1, np.intp),
            inputs=inputs,
            slopes=None,
        )
        # nothing varies between points
        self._plan = plan_of(replace(task, modes=dict.fromkeys(task.modes, codes.HELD)))
        self._names = task.experiment.output_names
        # a derivative that was measured is there once
        self._columns = [self._names.index(name) for name in (*wanted, *outputs)]
        self._start = initial_simulation(simulator.by(system, 1, None))

    @classmethod
    def of(cls, simulator: Simulator) -> RightHandSide | None:
        """Return that of a simulator; None where its model is not a single FMU that shows its derivatives."""
        system = by_model_exchange(simulator.system)
        if system is None or len(system.components) > 1 or len(simulator.experiment.times) < 2:
            return None
        ((component, model),) = system.components.items()
        description = model.fmu.description
        for name in (*description.states, *description.derivatives):
            variable = system.variables.get(system.full_name(component, name))
            if variable is None or variable.array or variable.causality not in ("output", "local"):
                return None
        return cls(simulator, system)

    def __call__(self, states: Floats, thetas: Floats) -> tuple[Floats, Floats]:
        """Return derivatives (m, P, n_x) and outputs (m, P, n_y) at states (P, n_x) for thetas (m, N); NaN: it failed.

        P = 2 (K − 1) points: the beginning and the end of each interval. Outputs are in the units of the table.
        """
        simulation = GridSimulation(self._plan, self._grid._replace(states=np.ascontiguousarray(states)), self._names)
        executor, count = executor_of(self._system), len(self.states)
        found = np.empty((len(thetas), len(states), len(self._names)))
        reports = new_reports(len(thetas))
        with executor.lock:
            executor.run(simulation, self._simulator.target_values(thetas), found, reports)
        found[reports[:, 0] >= 0] = np.nan
        found = found[:, :, self._columns]
        return found[:, :, :count], self._simulator.in_table_units(found[:, :, count:])

    def output_slopes(self, theta: Floats) -> tuple[Floats, Floats, Floats]:
        """Return C = ∂y/∂x (n_y, n_x) at the beginning, by differences, and what it holds about.

        Returns
        -------
        slopes : (n_y, n_x) array
            Times the nominals of the states; in the units of the table.
        states : (n_x,) array
            The states at the beginning, zero where they cannot be seen.
        outputs : (K, n_y) array
            With these states at all samples.
        """
        states, _, outputs, _, slopes = self._secants(theta)
        return slopes, states, np.vstack([outputs[::2], outputs[-1:]])

    def secants(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return A = ∂f/∂x (n_x, n_x) and C = ∂y/∂x (n_y, n_x) at the beginning, in units of the nominals.

        They are differences over the nominals: what is steep near by counts with its mean slope. Outputs are in the
        units of the table.
        """
        _, base, _, derivatives, slopes = self._secants(theta)
        return (derivatives - base[:, None]) / self.nominals[:, None], slopes

    def _secants(self, theta: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return states and derivatives (n_x,) at the beginning and outputs (P, n_y) there; of states moved: f, Δy."""
        initial = self.initial(theta[None])
        states = np.zeros(len(self.states)) if initial is None else initial[0]
        points = len(self._grid.times)
        derivatives, outputs = self(np.tile(states, (points, 1)), theta[None])
        moved = states + np.diag(self.nominals)
        found = [self(np.tile(each, (points, 1)), theta[None]) for each in moved]
        rates = np.column_stack([each[0][0, 0] for each in found])
        slopes = np.column_stack([each[1][0, 0] - outputs[0, 0] for each in found])
        return states, derivatives[0, 0], outputs[0], rates, slopes

    def corrected(self, gain: Floats, tolerance: float, most_steps: int | None = None, every: int = 1) -> Simulator:
        """Return the simulator whose states a gain (n_x, n_y) corrects, in FMU units, after every so many samples."""
        return self._simulator.corrected(self._system, tolerance, gain, most_steps, every)

    def simulator(self, tolerance: float, most_steps: int) -> Simulator:
        """Return the simulator by model exchange, with a relative tolerance and so many steps between samples."""
        return self._simulator.by(self._system, 1, tolerance, most_steps)

    def initial(self, thetas: Floats) -> Floats | None:
        """Return the states at the beginning (m, n_x) for thetas (m, N), None where they cannot be seen."""
        if self._start is None:
            return None
        return initial_states(self._start, executor_of(self._system), self._simulator.target_values(thetas))
