"""Simulated outputs of a system over an experiment, by parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Simulations
from fmuid.data import Experiment, is_quantity
from fmuid.errors import NO_EXPERIMENT, InputError, SimulationError, check_kind
from fmuid.models import FMU, Isolation, Numerics, System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import close, executor_of
from fmuid.simulation.observed import ObservedModel
from fmuid.simulation.plan_builder import converted_inputs, simulation_of
from fmuid.simulation.simulation_plan import GridSimulation, SimulationJob, SimulationPlan
from fmuid.simulation.simulation_task import Value, column_conversion, task_of


class Simulator:
    """Simulates a model over an experiment: ``simulator(theta)``.

    All simulators of one `System` share its instances. `close` or the last simulator's end frees them.
    Several thetas are spread over threads if the FMU allows it.

    Parameters
    ----------
    model : System, FMU or path
    experiment : Experiment
        Its inputs drive the model; outputs are at its times, from initialization on.
    parameters : sequence of str
        Variables set by theta, in this order.
    values : mapping of str to float, int, bool or str
        Variables held at a value; the experiment's take precedence.
    interface, integrator, tolerance : optional
        Solver settings of an FMU (`fmuid.Numerics`); a System has its own.
    step_size : float, optional
        Largest communication step and solver step, s; default: the system's, else from sample to sample.
    divisor : int
        Number of parts of each step (`fmuid.simulation.solver_refinement`).
    isolation : Isolation, optional
        Runs an FMU in a separate process; default: in this one.

    Raises
    ------
    InputError
        If a name is unknown, of the wrong causality or type, or given twice.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> simulator = fmuid.Simulator(coil.fmu, coil.experiment, parameters=["R", "L"])
    >>> simulator([4.0, 0.1]).shape
    (200, 1)
    >>> simulator([[4.0, 0.1], [5.0, 0.1]]).shape  # two thetas at once
    (2, 200, 1)
    """

    def __init__(
        self,
        model: System | FMU | str | Path,
        experiment: Experiment,
        parameters: Sequence[str] = (),
        *,
        values: Mapping[str, Value] | None = None,
        interface: str | None = None,
        integrator: str | None = None,
        tolerance: float | None = None,
        step_size: float | None = None,
        divisor: int = 1,
        isolation: Isolation | None = None,
    ) -> None:
        self.system = System.of(model, Numerics(interface, integrator, tolerance), isolation)
        check_kind(experiment, Experiment, NO_EXPERIMENT)
        check_kind(values or {}, Mapping, "values must be a mapping of variables to fixed values")
        self.experiment = experiment
        self.parameters = tuple(parameters)
        repeated = {name for name in self.parameters if self.parameters.count(name) > 1}
        if repeated:
            raise InputError(f"parameter {sorted(repeated)[0]!r} is listed twice")
        self._values, self._divisor = dict(values or {}), divisor
        self._tolerance: float | None = None
        own = [j for j, each in enumerate(self.parameters) if each in self.system.variables or not is_quantity(each)]
        self.own = np.array(own, np.intp)
        """Elements of theta that the model takes; others are quantities of an observation, here or elsewhere."""
        targets = [(each, j) for j in self.own.tolist() for each in self.system.targets(self.parameters[j])]
        self.target_names = names = [name for (name, _, _), _ in targets]
        """Variables set by theta."""
        self.columns = np.array([column for _, column in targets], np.intp)
        """Column of theta of each of these variables; its value is that times a factor plus an offset."""
        self.factors, self.offsets = np.array([each[1:] for each, _ in targets], np.float64).reshape(-1, 2).T
        held = self._held_values()
        self.settings = held, step_size
        """Held values by variables, and the largest step, s."""
        self._task = task_of(self.system, experiment.of_model, names, held, step_size, divisor)
        self._simulation = simulation_of(self._task)
        self._own_inputs: tuple[SimulationPlan, GridSimulation] | None = None
        self._executor = executor_of(self.system)
        self._conversions = self._output_conversions()
        fed = {*names, *held, *self.system.connected_inputs, *self.system.connectors}
        fed |= {target for name in experiment.input_names for target, _, _ in self.system.targets(name)}
        self.unfed_inputs = tuple(
            v.name for v in self.system.variables.values() if v.causality == "input" and v.name not in fed
        )
        """Inputs that nothing feeds: they keep their start values."""

    def _held_values(self) -> dict[str, Value]:
        """Return held values, those of connectors at their variables."""
        found: dict[str, Value] = {}
        for given, value in {**self._values, **self.experiment.values}.items():
            if is_quantity(given) and given not in self.system.variables:
                continue
            for name, factor, offset in self.system.targets(given):
                plain = isinstance(value, bool | str) or (factor, offset) == (1.0, 0.0)
                found[name] = value if plain else factor * float(value) + offset
        return found

    def target_values(self, thetas: Floats) -> Floats:
        """Return the values of `target_names` for thetas (m, N)."""
        if not self.system.connectors and self.own.size == thetas.shape[1]:
            return thetas
        return np.ascontiguousarray(thetas[:, self.columns] * self.factors + self.offsets)

    def _of_own(self, thetas: Floats) -> Floats:
        """Return values of `target_names` for the model's own thetas (m, N)."""
        whole = np.zeros((len(thetas), len(self.parameters)))
        whole[:, self.own] = thetas
        return self.target_values(whole)

    def _output_conversions(self) -> dict[int, tuple[float, float]]:
        found = {}
        experiment = self.experiment.of_model
        for j, name in enumerate(experiment.output_names):
            _, factor, offset = self.system.targets(name)[0]
            if name in experiment.units:
                of_unit, shift = column_conversion(self.system, name, experiment.units[name])
                factor, offset = factor / of_unit, (offset - shift) / of_unit
            if (factor, offset) != (1.0, 0.0):
                found[j] = factor, offset
        return found

    @property
    def stiff(self) -> frozenset[str]:
        """Components found stiff: "cvode" has replaced "rk45"."""
        begun = zip(self.system.components.items(), self._simulation.plan.integrations, strict=True)
        return frozenset(name for (name, model), now in begun if now and now.integrator != model.integrator)

    @property
    def corrects(self) -> bool:
        """Whether measurements correct the states."""
        return self._simulation.grid.gain is not None

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs, in order of the last axis."""
        return self.experiment.output_names

    def __call__(self, theta: ArrayLike) -> Floats:
        """Simulate one theta (N,) or several (m, N); return (K, n_outputs) or (m, K, n_outputs).

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        return Simulations.of(self.many, theta)

    def many(self, thetas: ArrayLike) -> Simulations:
        """Simulate several finite thetas (m, N); failures do not end the others."""
        given = np.ascontiguousarray(thetas, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.parameters):
            raise InputError(
                f"theta must have {len(self.parameters)} values ({self._names}), not the shape {given.shape}"
            )
        if not np.isfinite(given).all():
            raise InputError(f"theta must be finite ({self._names})")
        if self.observed is not None:
            return self.observed.readings(given, self.own)
        return self._simulate(self._simulation, self.target_values(given), given)

    def _simulate(self, simulation: GridSimulation, values: Floats, given: Floats) -> Simulations:
        """Simulate values of the targets (m, n); return outputs of the model."""
        job = simulation.job(values)
        with self._executor.lock:
            self._executor.run(job)
            errors = self._explain(job, given)
        return Simulations(self.in_table_units(job.outputs), errors)

    @cached_property
    def observed(self) -> ObservedModel | None:
        """The model with the map of the experiment's observation; None without one."""
        made = self.experiment.sensor_map
        if made is None:
            return None
        fixed = dict(zip(made.given.names, made.given.values, strict=True))
        fixed |= {name: float(value) for name, value in self._values.items() if name in fixed}
        return ObservedModel(
            self.experiment, made, self.driven_by, self.parameters, np.array(list(fixed.values()), np.float64)
        )

    def model_at(self, theta: Floats) -> Simulator:
        """Return `of_model` with the inputs that theta (N,) gives it: voltages behind readings, less drops."""
        if self.observed is None:
            return self
        (values,), own = self.observed.quantities(theta[None]), self.experiment.of_model
        if (values[self.observed.map.of_inputs] == self.observed.nominal_inputs).all():
            return self.of_model
        _, inputs = self.observed.driven(theta[self.own], values)
        columns = [own.columns[name] for name in own.input_names]
        return self.over(own.with_columns(dict(zip(columns, inputs.T, strict=True))))

    def seen(self, changes: Floats, theta: Floats) -> Floats:
        """Return changes of outputs (m, K, n_outputs) by the model's."""
        if self.observed is None:
            return changes
        return self.observed.changes(changes, self.observed.quantities(theta[None])[0])

    def driven_by(self, thetas: Floats, inputs: Floats | None) -> Simulations:
        """Simulate thetas (m, N) of the model, with other inputs if given."""
        if inputs is None:
            return self._simulate(self._simulation, self._of_own(thetas), thetas)
        values, slopes = converted_inputs(replace(self._task, experiment=self._task.experiment.with_inputs(inputs)))
        with self._executor.lock:
            simulation = self._driven_simulation
            simulation.grid.inputs[:] = values
            if simulation.grid.slopes is not None:
                simulation.grid.slopes[:] = slopes
            return self._simulate(simulation, self._of_own(thetas), thetas)

    @property
    def _driven_simulation(self) -> GridSimulation:
        """The simulation with inputs of its own, made once for a plan: instances stay bound to it."""
        own = self._simulation
        if self._own_inputs is None or self._own_inputs[0] is not own.plan:
            inputs, slopes = own.grid.inputs.copy(), own.grid.slopes
            grid = own.grid._replace(inputs=inputs, slopes=None if slopes is None else slopes.copy())
            self._own_inputs = own.plan, GridSimulation(own.plan, grid, own.output_names, driven=True)
        return self._own_inputs[1]

    @cached_property
    def of_model(self) -> Simulator:
        """The simulator of the model's own variables, without sensors."""
        return self if self.experiment.observation is None else self.over(self.experiment.of_model)

    def in_table_units(self, outputs: Floats) -> Floats:
        """Convert outputs (m, K, n_outputs) to the data file's units, in place."""
        for j, (factor, offset) in self._conversions.items():
            outputs[:, :, j] = factor * outputs[:, :, j] + offset
        return outputs

    def close(self) -> None:
        """Free the system's instances; later simulations make new ones."""
        close(self.system)

    def over(self, experiment: Experiment, parameters: Sequence[str] | None = None) -> Simulator:
        """Return the simulator of another experiment, or of other parameters."""
        return self._like(self.system, experiment, self._divisor, self._tolerance, parameters=parameters)

    def by(self, system: System, divisor: int, tolerance: float | None, most_steps: int | None = None) -> Simulator:
        """Return the simulator of this experiment by another system (`System.run_by`).

        Defaults of tolerance and step limit are the system's. They do not separate instances.
        """
        return self._like(system, self.experiment, divisor, tolerance, most_steps)

    def corrected(
        self, system: System, tolerance: float, gain: Floats, most_steps: int | None = None, every: int = 1
    ) -> Simulator:
        """Return the simulator whose states every n-th sample corrects; Model Exchange only.

        The gain (n_states, n_outputs) is per measured − simulated output, in units of the FMU.
        """
        other = self._like(system, self.experiment, 1, tolerance, most_steps)
        measured = self.experiment.output_values.copy()
        for j, (factor, offset) in self._conversions.items():
            measured[:, j] = (measured[:, j] - offset) / factor
        measured[np.arange(len(measured)) % every > 0] = np.nan
        other._simulation.grid = other._simulation.grid._replace(gain=np.ascontiguousarray(gain), measured=measured)
        return other

    def _like(
        self,
        system: System,
        experiment: Experiment,
        divisor: int,
        tolerance: float | None,
        most_steps: int | None = None,
        parameters: Sequence[str] | None = None,
    ) -> Simulator:
        names, step = self.parameters if parameters is None else parameters, self.settings[1]
        values = {name: value for name, value in self._values.items() if name not in names}
        other = Simulator(system, experiment, names, values=values, step_size=step, divisor=divisor)
        other._tolerance = tolerance
        if tolerance is not None:
            other._simulation.control(tolerance, most_steps)
        return other

    @property
    def output_factors(self) -> Floats:
        """Factors of outputs from FMU to data file (n_outputs,)."""
        count = len(self.experiment.of_model.output_names)
        return np.array([self._conversions.get(j, (1.0, 0.0))[0] for j in range(count)])

    @property
    def _names(self) -> str:
        return ", ".join(self.parameters) or "no parameters"

    def _explain(self, job: SimulationJob, thetas: Floats) -> tuple[SimulationError | None, ...]:
        # a sum is finite only if all its terms are; after a failure the outputs are uninitialized memory
        with np.errstate(invalid="ignore", over="ignore"):
            if (job.reports[:, 2] == codes.DONE_WELL).all() and np.isfinite(job.outputs.sum()):
                return (None,) * len(job)
            suspect = job.failed | ~np.isfinite(job.outputs.sum(axis=(1, 2)))
        errors: list[SimulationError | None] = [None] * len(job)
        names = self.parameters if thetas.shape[1] == len(self.parameters) else [self.parameters[j] for j in self.own]
        for i in np.flatnonzero(suspect):
            named = dict(zip(names, thetas[i].tolist(), strict=True))
            explain = not any(errors)  # only the first: it costs another simulation
            errors[i] = self._executor.failure(job[i : i + 1], named, explain)
            if errors[i] is not None:
                job.outputs[i] = np.nan
        return tuple(errors)
