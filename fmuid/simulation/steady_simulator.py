"""Steady states of a model at the operating points of an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.data import SteadyExperiment
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import PHASOR_FORMULAS, MachineTerminals, OperatingPhasors, System, machine_of
from fmuid.simulation.point_model import ModelOfPoints, PointModel
from fmuid.simulation.point_simulator import PointSimulator
from fmuid.simulation.simulation_task import column_conversion
from fmuid.simulation.steady_state import (
    SettledSimulation,
    SteadyIssue,
    SteadyStates,
    doubt,
    find_steady_states,
    first_issue,
    other_starts,
    steady_states_near,
)
from fmuid.units import parse_unit

REASONS = {
    SteadyIssue.NONE: "no steady state. Change the inputs or set guess",
    SteadyIssue.SEVERAL: "several steady states. Set guess near the right one",
    SteadyIssue.UNSTABLE: "the steady state is unstable. Change guess or remove the row",
    SteadyIssue.EVENT: "an event at the steady state. Remove the row",
    SteadyIssue.MOVING: "outputs do not come to rest. Remove the row",
}
"""Text of each issue, with the remedy."""
Issue = tuple[int, SteadyIssue] | None


class SteadySimulator(PointSimulator):
    """Outputs of steady states: Newton's method, else simulation until still.

    Two starts are compared, and events sought, at the first theta; stability is tested at each.
    """

    experiment: SteadyExperiment

    def _prepare(self) -> None:
        system, experiment = self.system, self.experiment
        self.formulas = tuple(name for name in self.output_names if is_formula(system, name))
        self.terminals = terminals_of(system, experiment, self.formulas)
        self.signals = [name for name in self.output_names if name not in self.formulas]
        self.signals += [] if self.terminals is None else list(self.terminals.currents)
        self._inputs = dict(zip(experiment.input_names, experiment.input_values.T, strict=True))
        self._units = {name: experiment.units[name] for name in self._inputs if name in experiment.units}
        self._is_checked = False
        for name in self.formulas:
            if PHASOR_FORMULAS[name].needs_torque:
                raise InputError(f"{experiment.source}: {name!r} needs frame. Give frequency, voltage and slip.")
        _ = self._settled  # whose simulators check all names

    @cached_property
    def _points(self) -> PointModel | None:
        if self.model is None:
            return None
        found = PointModel(self.model, self._inputs, (), self.signals, self._units)
        return found if found.is_open else None

    @cached_property
    def _settled(self) -> SettledSimulation:
        own = ModelOfPoints(self.system, self.parameters, self.held, self.experiment.source)
        made = SettledSimulation(own, self._inputs, self.signals, self._units)
        made.check()
        return made

    def _compute(self, thetas: Floats) -> tuple[Floats, list[str]]:
        """Return outputs (m, K, n_outputs) of all rows, and reasons of failures."""
        signals, issues = self._settle(thetas) if self._points is None else self._solve(self._points, thetas)
        return self._outputs(signals), [
            "" if issue is None else f"row {issue[0] + 1}: {REASONS[issue[1]]}" for issue in issues
        ]

    def issue_at(self, theta: Floats) -> tuple[int, str] | None:
        """As of `PointSimulator`: an event, else one of several steady states."""
        if self._points is None:
            return None
        found = self._found(self._points, theta[None])
        (issue,) = first_issue(found)
        issue = issue or self._doubt(self._points, theta, found, from_usual=False)
        if issue is None:
            return None
        row, reason = issue
        return row, (reason if reason is SteadyIssue.EVENT else SteadyIssue.SEVERAL).value

    def _settle(self, thetas: Floats) -> tuple[Floats, list[Issue]]:
        """Return the signals (m, K, n) of simulations, and issues."""
        found = np.full((len(thetas), len(self.experiment.times), len(self.signals)), np.nan)
        issues: list[Issue] = [None] * len(thetas)
        for i, row in np.ndindex(found.shape[:2]):
            values = self._settled.rest(row, thetas[i]) if issues[i] is None else None
            if values is not None:
                found[i, row] = values
            else:
                issues[i] = issues[i] or (row, SteadyIssue.MOVING)
        return found, issues

    def _solve(self, points: PointModel, thetas: Floats) -> tuple[Floats, list[Issue]]:
        """Return the signals (m, K, n) of steady states, and issues; the first theta without one is examined."""
        if self._usual is None:
            found, direct = self._found(points, thetas), np.zeros(len(thetas), dtype=np.bool_)
        else:
            found = steady_states_near(points, thetas, self._usual)
            is_guessed = bool(self.experiment.guess)
            direct = np.asarray(found.found.all(axis=1) & (~found.unstable.any(axis=1) | is_guessed))
            if not direct.all():
                found = found.replaced(~direct, self._found(points, thetas[~direct]))
        issues = first_issue(found)
        for i, theta in enumerate(thetas):
            if not self._is_checked and issues[i] is None:
                issues[i] = self._doubt(points, theta, found.of(slice(i, i + 1)), from_usual=bool(direct[i]))
                self._is_checked = issues[i] is None
        return found.models.outputs, issues

    def _doubt(self, points: PointModel, theta: Floats, found: SteadyStates, *, from_usual: bool) -> Issue:
        """Return an event, or other steady states if there is no guess."""
        others = [self._usual] if self._usual is not None and not from_usual else []
        guessed = bool(self.experiment.guess)
        return doubt(points, theta, found, [] if guessed else [*others, *other_starts(points, found.states[0])])

    @cached_property
    def _usual(self) -> Floats | None:
        """Steady states (K, n_x) at the FMU's own parameters: Newton begins there."""
        values = [self.system.variable(name, "parameter").start for name in self.parameters]
        if self._points is None or not all(isinstance(value, int | float) for value in values):
            return None
        thetas = np.array([values], dtype=np.float64)
        found = find_steady_states(self._points, thetas, self._starts(self._points, thetas))
        return found.states[0] if found.found.all() and not found.unstable.any() else None

    def _starts(self, points: PointModel, thetas: Floats) -> Floats:
        """Return the initial states (m, K, n_x), or those of the guess."""
        start = np.zeros((len(thetas), len(points.states)))
        for i in range(len(thetas)):
            initial = points.initial(thetas[i : i + 1])
            start[i] = 0.0 if initial is None else initial[0]
        for name, value in self.experiment.guess.items():
            if name not in points.states:
                near = nearest(name, points.states)
                raise InputError(f"{self.experiment.source}: guess: {name!r} is no state{near}.")
            start[:, points.states.index(name)] = value
        return np.repeat(start[:, None], len(self.experiment.times), axis=1)

    def _found(self, points: PointModel, thetas: Floats) -> SteadyStates:
        """Return steady states from initial states; simulate rows that are lost."""
        found = find_steady_states(points, thetas, self._starts(points, thetas))
        lost = ~found.found | (found.unstable & (not self.experiment.guess))
        for i in np.flatnonzero(lost.any(axis=1)):
            start = self._simulated(points, thetas[i], found.states[i], lost[i])
            if start is not None:
                which = np.arange(len(thetas)) == i
                found = found.replaced(which, find_steady_states(points, thetas[which], start[None]))
        return found

    def _simulated(self, points: PointModel, theta: Floats, states: Floats, lost: Flags) -> Floats | None:
        """Return states (K, n_x) with those of lost rows by simulation; None if they do not come to rest."""
        assert self.model is not None, "there are points"
        start, simulation = states.copy(), SettledSimulation(self.model, self._inputs, points.states, self._units)
        for row in np.flatnonzero(lost):
            values = simulation.rest(int(row), theta)
            if values is None:
                return None
            start[row] = values
        return start

    def _outputs(self, signals: Floats) -> Floats:
        """Return the outputs (m, K, n_outputs) of signals (m, K, n)."""
        own = dict(zip(self.signals, np.moveaxis(signals, -1, 0), strict=True))
        if self.terminals is not None:
            own |= values_of_formulas(self.formulas, self._phasors(self.terminals, own))
        values = [in_data_units(self.system, self.experiment, name, own[name]) for name in self.output_names]
        return np.stack(values, axis=-1)

    def _phasors(self, terminals: MachineTerminals, signals: Mapping[str, Floats]) -> OperatingPhasors:
        voltages = np.array([self._input(name)[None] for name in terminals.voltages])
        currents = np.array([signals[name] for name in terminals.currents])
        none = np.full(voltages.shape[-1], np.nan)
        return OperatingPhasors(terminals, voltages + 0j, currents + 0j, 1.0, none, none, np.nan, np.nan)

    def _input(self, name: str) -> Floats:
        """Return an input (K,) in units of the FMU."""
        if name not in self._inputs:
            raise InputError(f"{self.experiment.source}: formulas need the input {name!r}. Add its column.")
        factor, offset = column_conversion(self.system, name, self._units[name]) if name in self._units else (1.0, 0.0)
        return np.asarray(factor * self._inputs[name] + offset)


def is_formula(system: System, name: str) -> bool:
    """Return whether an output is a formula, not a variable."""
    return name in PHASOR_FORMULAS and name not in system.variables


def terminals_of(system: System, experiment: SteadyExperiment, formulas: Sequence[str]) -> MachineTerminals | None:
    """Return the terminals that formulas need; an `InputError` without a declaration."""
    if not formulas and experiment.supply is None:
        return None
    declared = machine_of(system)
    if declared is None:
        what = repr(formulas[0]) if formulas else "frame"
        place = f"{system.label.removesuffix('.fmu')}.nameplate.toml"
        raise InputError(f"{experiment.source}: {what} needs terminals. Declare them in {place} beside the FMU.")
    return declared.terminals


def values_of_formulas(names: Sequence[str], phasors: OperatingPhasors) -> dict[str, Floats]:
    """Return the values (m, K) of formulas."""
    return {name: PHASOR_FORMULAS[name].value(phasors) for name in names}


def in_data_units(system: System, experiment: SteadyExperiment, name: str, values: Floats) -> Floats:
    """Return an output (K,) in the unit of the data."""
    unit = experiment.units.get(name)
    if unit is None:
        return values
    if is_formula(system, name):
        factor = unit_factor(PHASOR_FORMULAS[name].unit, unit, f"{experiment.source}: output {name!r}")
        return values * factor
    factor, offset = column_conversion(system, name, unit)
    return np.asarray((values - offset) / factor)


def unit_factor(own: str, other: str, what: str) -> float:
    """Return the factor from one unit to another; an `InputError` if they do not convert."""
    one, two = parse_unit({"var": "V*A"}.get(own, own)), parse_unit({"var": "V*A"}.get(other, other))
    if one is None or two is None or one.exponents != two.exponents:
        raise InputError(f"{what}: unit {other!r} does not convert from {own!r}. Correct the header or set units.")
    return one.factor / two.factor
