"""The simulated outputs of a system over an experiment, as a function of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Indices
from fmuid.data import Experiment
from fmuid.errors import NO_EXPERIMENT, InputError, SimulationError, check_kind
from fmuid.models import FMU, Isolation, Numerics, System
from fmuid.simulation import codes
from fmuid.simulation.executor_pool import close, executor_of
from fmuid.simulation.plan_builder import simulation_of
from fmuid.simulation.simulation_plan import new_reports
from fmuid.simulation.simulation_task import task_of
from fmuid.simulation.variable_checks import Value, column_conversion


@dataclass(frozen=True)
class Simulations:
    """Simulations of several thetas.

    Attributes
    ----------
    outputs : (m, K, n_outputs) array
        In the units of the experiment's columns; NaN where the simulation failed.
    errors : tuple of SimulationError or None
        One for each theta.
    """

    outputs: Floats
    errors: tuple[SimulationError | None, ...]


class Simulator:
    """Simulate a model over an experiment: ``simulator(theta)``.

    The instances are kept and shared by all simulators of one `System`, and freed with the last of them or by `close`;
    several thetas are spread over several instances in threads where the FMU allows it.

    Parameters
    ----------
    model : System, FMU or path
    experiment : Experiment
        Its inputs drive the model, and the outputs are given at its times, the first at initialisation.
    parameters : sequence of str
        The variables that theta sets, in this order.
    values : mapping of str to float, int, bool or str
        Variables held at a value; those of the experiment go before them.
    interface, integrator, tolerance : optional
        How an FMU is run (`fmuid.Numerics`); a System says it itself.
    step_size : float, optional
        Largest communication step, s, of all components, and largest step of an integrator; default: what the system
        says, else from sample to sample.
    divisor : int
        What each step of components that integrate is divided by (`fmuid.simulation.solver_refinement`).
    isolation : Isolation, optional
        Runs an FMU in a process of its own; default: in this one, which an FMU that crashes takes with it.

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
        check_kind(values or {}, Mapping, "values must be a mapping of variables to what they are held at")
        self.experiment = experiment
        self.parameters = tuple(parameters)
        repeated = {name for name in self.parameters if self.parameters.count(name) > 1}
        if repeated:
            raise InputError(f"parameter {sorted(repeated)[0]!r} is given twice")
        self._given, self._divisor = (dict(values or {}), step_size), divisor
        self._tolerance: float | None = None
        self._targets = [
            (name, column, factor, offset)
            for column, parameter in enumerate(self.parameters)
            for name, factor, offset in self.system.targets(parameter)
        ]
        names = [name for name, *_ in self._targets]
        self._simulation = simulation_of(
            task_of(self.system, experiment, names, self._target_values(), step_size, divisor)
        )
        self._executor = executor_of(self.system)
        self._conversions = self._output_conversions()
        fed = {*names, *self._target_values(), *self.system.connected_inputs, *self.system.connectors}
        fed |= {target for name in experiment.input_names for target, _, _ in self.system.targets(name)}
        self.unfed_inputs = tuple(
            v.name for v in self.system.variables.values() if v.causality == "input" and v.name not in fed
        )
        """Inputs that nothing feeds: they keep their start values."""

    def _target_values(self) -> dict[str, Value]:
        """Return the values held, those of connectors of the system at the variables behind them."""
        found: dict[str, Value] = {}
        for given, value in {**self._given[0], **self.experiment.values}.items():
            for name, factor, offset in self.system.targets(given):
                plain = isinstance(value, bool | str) or (factor, offset) == (1.0, 0.0)
                found[name] = value if plain else factor * float(value) + offset
        return found

    @property
    def targets(self) -> tuple[tuple[str, int, float, float], ...]:
        """The variables that theta sets: name, and factor times which element of theta plus offset it is."""
        return tuple(self._targets)

    @property
    def settings(self) -> tuple[dict[str, Value], float | None]:
        """The variables held at a value, and the largest step, s."""
        return self._target_values(), self._given[1]

    def target_values(self, thetas: Floats) -> Floats:
        """Return the values of all variables (`targets`) that thetas (m, N) set."""
        if len(self._targets) == len(self.parameters) and not self.system.connectors:
            return thetas
        columns = np.array([column for _, column, _, _ in self._targets], np.intp)
        factors, offsets = np.array([each[2:] for each in self._targets], np.float64).reshape(-1, 2).T
        return np.ascontiguousarray(thetas[:, columns] * factors + offsets)

    def _output_conversions(self) -> dict[int, tuple[float, float]]:
        """Return for each output that differs from what the FMU gives: factor and offset."""
        found = {}
        for j, name in enumerate(self.experiment.output_names):
            _, factor, offset = self.system.targets(name)[0]
            if name in self.experiment.units:
                of_unit, shift = column_conversion(self.system, name, self.experiment.units[name])
                factor, offset = factor / of_unit, (offset - shift) / of_unit
            if (factor, offset) != (1.0, 0.0):
                found[j] = factor, offset
        return found

    @property
    def stiff(self) -> frozenset[str]:
        """The components that "rk45", where nobody asked for it, has found stiff: "cvode" has taken its place."""
        begun = zip(self.system.components.items(), self._simulation.plan.integrations, strict=True)
        return frozenset(name for (name, model), now in begun if now and now.integrator != model.integrator)

    @property
    def corrects(self) -> bool:
        """Whether measurements correct the states at the samples."""
        return self._simulation.grid.gain is not None

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs, in the order of the last axis."""
        return self.experiment.output_names

    def __call__(self, theta: ArrayLike) -> Floats:
        """Simulate one theta (N,) or several (m, N).

        Returns
        -------
        (K, n_outputs) or (m, K, n_outputs) array

        Raises
        ------
        SimulationError
            If a simulation fails; it names FMU, time, parameter values, and what the FMU said.
        """
        thetas = np.asarray(theta, dtype=np.float64)
        found = self.many(np.atleast_2d(thetas))
        for error in found.errors:
            if error is not None:
                raise error
        return found.outputs[0] if thetas.ndim < 2 else found.outputs

    def many(self, thetas: ArrayLike) -> Simulations:
        """Simulate several thetas (m, N); a failed one does not end the others.

        Raises
        ------
        InputError
            If thetas has another shape or is not finite.
        """
        given = np.ascontiguousarray(thetas, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.parameters):
            raise InputError(
                f"theta must have {len(self.parameters)} values (one each for {self._names}); "
                f"its shape is {given.shape}"
            )
        if not np.isfinite(given).all():
            raise InputError(f"theta must be finite; one of the values for {self._names} is not")
        outputs = np.empty((len(given), self._simulation.grid.times.size, len(self.output_names)))
        reports = new_reports(len(given))
        with self._executor.lock:
            self._executor.run(self._simulation, self.target_values(given), outputs, reports)
            errors = self._explain(given, outputs, reports)
        self.in_table_units(outputs)
        return Simulations(outputs, errors)

    def in_table_units(self, outputs: Floats) -> Floats:
        """Convert what the FMU gives (m, K, n_outputs) to the units of the experiment's columns, in place."""
        for j, (factor, offset) in self._conversions.items():
            outputs[:, :, j] = factor * outputs[:, :, j] + offset
        return outputs

    def close(self) -> None:
        """Free the instances of the system, which all its simulators share; a later simulation makes new ones."""
        close(self.system)

    def over(self, experiment: Experiment) -> Simulator:
        """Return the simulator of another experiment with the same model, parameters and values."""
        return self._like(self.system, experiment, self._divisor, self._tolerance)

    def by(self, system: System, divisor: int, tolerance: float | None, most_steps: int | None = None) -> Simulator:
        """Return the simulator of the same experiment by another way to run the system (`fmuid.System.run_by`).

        Parameters
        ----------
        system : System
        divisor : int
            As for `Simulator`.
        tolerance : float, optional
            Of model exchange; default: what the system says. Simulators of one system share its instances whatever it
            is.
        most_steps : int, optional
            As for `fmuid.Numerics`; default: what the system says.
        """
        return self._like(system, self.experiment, divisor, tolerance, most_steps)

    def corrected(
        self, system: System, tolerance: float, gain: Floats, most_steps: int | None = None, every: int = 1
    ) -> Simulator:
        """Return the simulator of the same experiment whose states the measurements correct after samples.

        Parameters
        ----------
        system : System
            This one, a single FMU, run by model exchange.
        tolerance : float
        gain : (n_states, n_outputs) array
            States move by it times measured less simulated outputs, in the units of the FMU.
        most_steps : int, optional
        every : int
            The first of so many samples corrects.
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
    ) -> Simulator:
        values, step_size = self._given
        other = Simulator(system, experiment, self.parameters, values=values, step_size=step_size, divisor=divisor)
        if tolerance is not None:
            other._tolerance = tolerance
            other._simulation.control(tolerance, most_steps)
        return other

    @property
    def output_factors(self) -> Floats:
        """What a change of each output in the unit of the FMU is in that of the table (n_outputs,)."""
        return np.array([self._conversions.get(j, (1.0, 0.0))[0] for j in range(len(self.output_names))])

    @property
    def _names(self) -> str:
        return ", ".join(self.parameters) or "no parameters"

    def _explain(self, thetas: Floats, outputs: Floats, reports: Indices) -> tuple[SimulationError | None, ...]:
        # a sum is finite only where all its terms are; only then is a closer look needed. After a failure the rest of
        # the outputs is whatever the memory held
        with np.errstate(invalid="ignore", over="ignore"):
            if (reports[:, 2] == codes.DONE_WELL).all() and np.isfinite(outputs.sum()):
                return (None,) * len(thetas)
            suspect = (reports[:, 0] >= 0) | ~np.isfinite(outputs.sum(axis=(1, 2)))
        errors: list[SimulationError | None] = [None] * len(thetas)
        for i in np.flatnonzero(suspect):
            named = dict(zip(self.parameters, thetas[i].tolist(), strict=True))
            theta = self.target_values(thetas[i : i + 1])[0]
            # what the FMU says costs another simulation: for the first failure
            explain = not any(errors)
            errors[i] = self._executor.failure(self._simulation, theta, outputs[i], reports[i], named, explain)
            if errors[i] is not None:
                outputs[i] = np.nan
        return tuple(errors)
