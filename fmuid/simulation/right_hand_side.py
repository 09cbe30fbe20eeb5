"""Right-hand side of an FMU without integration: ẋ = f(x, u, θ), y = h(x, u, θ).

Each theta has one initialization; then times, inputs and states are set, derivatives and outputs are read.
The points are both ends of each sampling interval with its inputs: a held input's step belongs to both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.models import System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import executor_of
from fmuid.simulation.forward_simulation import extended_by, initial_simulation, initial_states, plan_by_seeds
from fmuid.simulation.plan_builder import grid_of, plan_of
from fmuid.simulation.simulation_plan import GridSimulation
from fmuid.simulation.simulation_task import task_of
from fmuid.simulation.simulator import Simulator
from fmuid.simulation.solver_refinement import by_model_exchange


class RightHandSide:
    """Derivatives and outputs of a model at the ends of sampling intervals; its `system` runs by Model Exchange.

    With `by_rows` its points are the rows. With `seeds`, states and inputs, the FMU gives directional derivatives, too.
    """

    def __init__(
        self, simulator: Simulator, system: System, *, by_rows: bool = False, seeds: Sequence[str] = ()
    ) -> None:
        self._simulator, self.system, self._seeds = simulator, system, len(seeds)
        self.states = system.states
        nominals = [system.variables[name].nominal for name in self.states]
        self.nominals = np.array([abs(nominal or 1.0) for nominal in nominals])
        wanted = list(system.derivatives)
        outputs = [" + ".join(system.terms(name)) for name in simulator.output_names]
        names, (values, _) = simulator.target_names, simulator.settings
        task = task_of(system, extended_by(simulator.experiment, [*wanted, *outputs]), names, values, None)
        held = np.array([mode == codes.HELD for mode in task.modes.values()], dtype=np.bool_)
        grid = grid_of(task)
        rows = np.arange(len(grid.times))
        ends = rows if by_rows else np.repeat(rows, 2)[1:-1]
        inputs = grid.inputs[ends]
        if not by_rows:
            inputs[1::2, held] = inputs[::2, held]
        self._points = grid._replace(
            times=grid.times[ends],
            substeps=np.ones(len(ends) - 1, np.intp),
            strides=np.ones(len(system.components), np.intp),
            inputs=inputs,
            slopes=None,
            states=len(self.states),
        )
        # nothing varies between points
        task, found = replace(task, modes=dict.fromkeys(task.modes, codes.HELD)), task.experiment.output_names
        plan = plan_by_seeds(task, seeds, len(self.states))[0] if seeds else plan_of(task)
        self._simulation = GridSimulation(plan, self._points, found * (1 + len(seeds)))
        # a derivative that was measured is there once
        columns = [found.index(name) for name in (*wanted, *outputs)]
        self._columns = slice(None) if columns == list(range(len(found))) else columns

    @cached_property
    def _start(self) -> GridSimulation | None:
        return initial_simulation(self._simulator.by(self.system, 1, None))

    @classmethod
    def of(cls, simulator: Simulator, *, by_rows: bool = False, seeds: Sequence[str] = ()) -> RightHandSide | None:
        """Return a simulator's right-hand side; None unless all FMUs show their derivatives.

        Of several, each has continuous states: others act once per communication step. Seeds are for one FMU.
        """
        simulator, system = simulator.of_model, by_model_exchange(simulator.system)
        if system is None or len(simulator.experiment.times) < 2:
            return None
        if len(system.components) > 1 and not all(map(system.integrates, system.components)):
            return None
        for name in (*system.states, *system.derivatives):
            variable = system.variables.get(name)
            if variable is None or variable.array or variable.causality not in ("output", "local"):
                return None
        return cls(simulator, system, by_rows=by_rows, seeds=seeds)

    def __call__(self, states: Floats, thetas: Floats) -> tuple[Floats, Floats]:
        """Return derivatives (m, P, n_x) and outputs (m, P, n_y); in units of the data file; NaN after a failure.

        States are (P, n_x), or (m, P, n_x); P = 2 (K − 1) points: begin and end of each interval, or P = K rows.
        """
        found, count = self._at(states, thetas)[:, :, 0], len(self.states)
        return found[:, :, :count], self._simulator.in_table_units(found[:, :, count:])

    def linear(self, states: Floats, thetas: Floats) -> tuple[Floats, Floats]:
        """Return values (m, P, n) of [f, h], and derivatives by seeds.

        The derivatives are (m, P, n, n_seeds), n = n_x + n_y. In units of the FMU; NaN after a failure.
        """
        found = self._at(states, thetas)
        return found[:, :, 0], np.swapaxes(found[:, :, 1:], 2, 3)

    def _at(self, states: Floats, thetas: Floats) -> Floats:
        """Return values and derivatives of the FMU, (m, P, 1 + n_seeds, n)."""
        executor, values = executor_of(self.system), self._simulator.target_values(thetas)
        count = values.shape[1]
        given = np.empty((len(values), count + states.shape[-2] * states.shape[-1]))
        given[:, :count] = values
        given[:, count:] = states.reshape(-1, given.shape[1] - count)
        job = self._simulation.job(given)
        with executor.lock:
            executor.run(job)
        job.outputs[job.failed] = np.nan
        return job.outputs.reshape(*job.outputs.shape[:2], 1 + self._seeds, -1)[..., self._columns]

    @property
    def times(self) -> Floats:
        """Times of the samples (K,), s."""
        return self._simulator.experiment.times

    def trajectory(self, theta: Floats) -> Floats | None:
        """Simulate theta (N,); return the states (K, n_x), None after a failure."""
        found = self._simulator.over(extended_by(self._simulator.experiment, self.states)).many(theta[None])
        return None if found.errors[0] is not None else found.outputs[0]

    def output_slopes(self, theta: Floats) -> tuple[Floats, Floats, Floats]:
        """Return C = ∂y/∂x at the beginning (n_y, n_x); initial states (n_x,), outputs (K, n_y) with these states.

        C is by differences over the states' nominals and times these. Hidden states are zero.
        """
        states, _, outputs, _, slopes = self._secants(theta)
        return slopes, states, np.vstack([outputs[::2], outputs[-1:]])

    def secants(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return A = ∂f/∂x (n_x, n_x) and C = ∂y/∂x (n_y, n_x); at the beginning, by the states' nominals."""
        _, base, _, derivatives, slopes = self._secants(theta)
        return (derivatives - base[:, None]) / self.nominals[:, None], slopes

    def _secants(self, theta: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return initial states, f, y, and f, Δy of moved states."""
        initial = self.initial(theta[None])
        states = np.zeros(len(self.states)) if initial is None else initial[0]
        points = len(self._points.times)
        derivatives, outputs = self(np.tile(states, (points, 1)), theta[None])
        moved = states + np.diag(self.nominals)
        found = [self(np.tile(each, (points, 1)), theta[None]) for each in moved]
        rates = np.column_stack([each[0][0, 0] for each in found])
        slopes = np.column_stack([each[1][0, 0] - outputs[0, 0] for each in found])
        return states, derivatives[0, 0], outputs[0], rates, slopes

    def corrected(self, gain: Floats, tolerance: float, most_steps: int | None = None, every: int = 1) -> Simulator:
        """Return the simulator with states corrected by a gain (n_x, n_y)."""
        return self._simulator.corrected(self.system, tolerance, gain, most_steps, every)

    def simulator(self, tolerance: float, most_steps: int) -> Simulator:
        """Return the simulator by Model Exchange with a tolerance and step limit."""
        return self._simulator.by(self.system, 1, tolerance, most_steps)

    def initial(self, thetas: Floats) -> Floats | None:
        """Return the initial states (m, n_x) of thetas (m, N); None if hidden."""
        if self._start is None:
            return None
        return initial_states(self._start, self.system, self._simulator.target_values(thetas))
