"""Simulations that carry the sensitivities of the states to the parameters with them (docs/method.md section 3)."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from fmuid.arrays import Floats
from fmuid.data import Experiment
from fmuid.fmi import FLOAT64, Integration, Operation, Sensitivities, codes, new_reports
from fmuid.models import Component, Port, System, Value
from fmuid.simulation.executor import Workers
from fmuid.simulation.plan import PlannedRun
from fmuid.simulation.simulator import Simulator

MODEL = "model"  # the last component among its twins
# The twins of each system, so that simulators of it share their instances.
_twins: weakref.WeakKeyDictionary[System, dict[tuple[int, tuple[str, ...]], System]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class Refusal:
    """Why there are no sensitivities."""

    reason: str


def extended_by(experiment: Experiment, outputs: Sequence[str]) -> Experiment:
    """Return an experiment with the same inputs and other outputs, in the units of the FMU."""
    columns = {name: f"simulated {i}" for i, name in enumerate(outputs)}  # no name of a measured column
    return Experiment(
        experiment.frame.assign(**dict.fromkeys(columns.values(), 0.0)),
        experiment.inputs,
        columns,
        time=experiment.time,
        interpolation=experiment.interpolation,
        units={name: experiment.units[name] for name in experiment.input_names if name in experiment.units},
        name=experiment.name,
        source=experiment.source,
    )


def names_of(simulator: Simulator) -> list[str]:
    """Return the variables that the parameters of a simulator set."""
    return [name for name, *_ in simulator.targets]


class SensitivityRun(PlannedRun):
    """What two kinds of runs have in common; they differ in what gives the right-hand sides of the sensitivities.

    Parameters
    ----------
    given : Sensitivities
        Its arrays are filled in before each simulation.
    system, experiment, parameters, values, step_size
        As for `PlannedRun`.

    Attributes
    ----------
    system : System
    given : Sensitivities
    """

    def __init__(
        self,
        given: Sensitivities,
        system: System,
        experiment: Experiment,
        parameters: Sequence[str],
        values: Mapping[str, Value],
        step_size: float | None,
    ) -> None:
        self.given, self.system = given, system
        super().__init__(system, experiment, parameters, values, step_size)

    def simulate(self, workers: Workers, theta: Floats) -> Floats | Refusal:
        """Simulate theta (N,); return the outputs (K, n), or why there are none."""
        outputs = np.empty((1, self.grid.times.size, len(self.output_names)))
        reports = new_reports(1)
        with workers.lock:
            workers.run(self, theta[None], outputs, reports)
            if reports[0, 0] == codes.SENSITIVITIES:
                return Refusal("the FMU gives no directional derivatives of its outputs by parameters")
            error = workers.failure(self, theta, outputs[0], reports[0], {})
        if error is not None:
            return Refusal(f"from t = {error.time:g} s on, {error.call}")
        found: Floats = outputs[0]
        return found


class DirectionalRun(SensitivityRun):
    """A run with directional derivatives of the FMU; the outputs' sensitivities follow the outputs, by parameters."""

    @classmethod
    def of(cls, simulator: Simulator) -> Self | None:
        """Return the run of a simulator; None if its FMU has no directional derivatives that would do.

        It declares none, has arrays, or a parameter is the start of a state, which is a known already.
        """
        system, (model,) = simulator.system, simulator.system.components.values()
        description = model.fmu.description
        terms = [term for name in simulator.output_names for term in system.terms(name)]
        involved = [system.variables[system.targets(name)[0][0]] for name in (*names_of(simulator), *terms)]
        involved += [description.variables[name] for name in (*description.states, *description.derivatives)]
        scalar = all(variable.type == "Real" and not variable.array for variable in involved)
        open_to_seeds = all(system.variables[name].causality in ("parameter", "input") for name in names_of(simulator))
        if not (description.interfaces[model.kind].directional_derivatives and scalar and open_to_seeds):
            return None
        count = len(simulator.targets)
        given = Sensitivities(
            magnitudes=np.ones(count),
            initial=np.zeros((count, len(description.states))),
            references=np.array([system.variables[name].reference for name in names_of(simulator)], np.uint32),
            steps=np.zeros(count),
            twins=(),
        )
        return cls(given, system, simulator.experiment, names_of(simulator), *simulator.settings)

    def _integration(self, component: str) -> Integration | None:
        found = super()._integration(component)
        return found and found._replace(sensitivities=self.given)

    def _output_operations(self) -> tuple[list[int], list[int]]:
        slots, bounds = super()._output_operations()
        terms = [self._system.terms(name) for name in self.output_names]
        found = list(dict.fromkeys(term for some in terms for term in some))
        count, first = len(self.given.magnitudes), len(self._signals)
        size = count * len(found)
        self._signals += [0.0] * size
        self._operations.append(
            Operation(codes.SENSITIVITIES, 0, len(self._references), len(found), first, size, FLOAT64)
        )
        self._references += [self._system.variables[term].reference for term in found]
        for j in range(count):
            for some in terms:
                slots += [first + j * len(found) + found.index(term) for term in some]
                bounds.append(len(slots))
        self.output_names = self.output_names * (1 + count)
        return slots, bounds


class InitialRun(PlannedRun):
    """The initialisation alone; its outputs are the states."""

    def states(self, workers: Workers, thetas: Floats) -> Floats | None:
        """Return the initial states (m, n_states) of thetas (m, N), None if an initialisation fails."""
        outputs = np.empty((len(thetas), 1, len(self.output_names)))
        reports = new_reports(len(thetas))
        with workers.lock:
            workers.run(self, thetas, outputs, reports)
        found = outputs[:, 0]
        return None if (reports[:, 0] >= 0).any() or not np.isfinite(found).all() else found


def initial_run(simulator: Simulator) -> InitialRun | None:
    """Return the run that initialises a simulator's FMU, None if its states are not open to view."""
    system, ((component, model),) = simulator.system, simulator.system.components.items()
    states = [system.full_name(component, name) for name in model.fmu.description.states]
    if any(system.variables[name].causality not in ("output", "local") for name in states):
        return None
    experiment = extended_by(simulator.experiment, states)
    run = InitialRun(system, experiment, names_of(simulator), *simulator.settings)
    grid = run.grid
    run.grid = grid._replace(times=grid.times[:1], substeps=grid.substeps[:0], inputs=grid.inputs[:1])
    return run


class TwinRun(SensitivityRun):
    """A run of a system that has an FMU N + 1 times: with each parameter a little changed, and last as it is.

    Its parameters and outputs are those of all components in turn.
    """

    @classmethod
    def of(cls, simulator: Simulator) -> Self:
        """Return the run of a simulator."""
        system, (model,) = simulator.system, simulator.system.components.values()
        count = len(simulator.targets)
        names = [*(f"twin{j + 1}" for j in range(count)), MODEL]
        inputs = simulator.experiment.input_names

        def inner(name: str) -> str:
            return system.split(name)[1]

        def ports(given: str) -> list[Port]:
            return [
                (f"{name}.{inner(v)}", factor, offset) for name in names for v, factor, offset in system.targets(given)
            ]

        experiment, (values, step_size) = simulator.experiment, simulator.settings
        terms = [[inner(term) for term in system.terms(name)] for name in experiment.output_names]
        given = Sensitivities(
            magnitudes=np.ones(count),
            initial=np.zeros((count, len(model.fmu.description.states))),
            references=np.zeros(count, np.uint32),
            steps=np.ones(count),
            twins=tuple(range(count)),
        )
        known = _twins.setdefault(system, {})
        twins = known.get((count, inputs))
        if twins is None:
            twins = known[count, inputs] = System(
                components={name: Component(model.fmu, model.numerics) for name in names},
                connectors={name: ports(name) for name in inputs},
                values={f"{name}.{inner(v)}": value for name in names for v, value in system.values.items()},
                isolation=system.isolation,
            )
        for component in twins.components.values():
            component.stiff = model.stiff
        return cls(
            given,
            twins,
            extended_by(
                experiment, [" + ".join(f"{name}.{term}" for term in some) for name in names for some in terms]
            ),
            [f"{name}.{inner(parameter)}" for name in names for parameter in names_of(simulator)],
            {f"{name}.{inner(v)}": value for name in names for v, value in values.items()},
            step_size,
        )

    def _component_steps(self, step_size: float | None) -> dict[str, float | None]:  # noqa: ARG002
        return dict.fromkeys(self._system.components)  # as for a single FMU: its integrator steps as it likes

    def _integration(self, component: str) -> Integration | None:
        found = super()._integration(component)
        if component == MODEL:
            return found and found._replace(sensitivities=self.given)
        return found and found._replace(follows=True)
