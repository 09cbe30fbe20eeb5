"""Starting point from the weak form of the equations, without simulation.

It needs one Model Exchange FMU. Noise in the states biases it, most for time constants below the sampling interval: it
gives a starting point, never a result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Flags, Floats, Indices
from fmuid.data import Noise, Parameter
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Evaluator, LeastSquares, Marquardt, WeakForm, second_difference_noise, sobol_points
from fmuid.identification.measured_states import MeasuredStates, both_ends, states_from_outputs
from fmuid.identification.problem import Problem
from fmuid.simulation import RightHandSide


@dataclass(frozen=True)
class WeakFormSettings:
    """Numbers of the search by the weak form."""

    reach: float = 300.0  # factor that bounds a parameter from the starting point
    iterations: int = 50
    poor: float = 15.0  # noise levels; a larger residual may be a local optimum, and other points are tried ...
    points: int = 2  # ... until it is halved
    change: float = 0.01  # of the magnitudes, to find acting parameters
    first_samples: int = 3  # whose median is the first state


SETTINGS = WeakFormSettings()
SECOND = Marquardt(max_iterations=12)


def equation_start(problem: Problem, start: Floats) -> tuple[Floats, float] | None:
    """Return a starting point (N,) and the relative residual of the equations."""
    try:
        records = [_WeakRecord.of(problem, index, start) for index in range(len(problem.experiments))]
        found = _fitted(problem, [each for each in records if each is not None], start)
    except FmuidError:  # a start is not worth an error: the search itself reports defects of the model
        return None
    return None if found is None else (_with_initial_states(problem, records, found[0]), found[1])


@dataclass(frozen=True, eq=False)
class _WeakRecord:
    """Right-hand side, windows, states and outputs of one experiment."""

    side: RightHandSide
    columns: Indices
    windows: WeakForm
    states: MeasuredStates
    slopes: Floats
    noise: Floats

    @classmethod
    def of(cls, problem: Problem, index: int, start: Floats) -> _WeakRecord | None:
        simulator, experiment = problem.simulators[index], problem.experiments[index]
        side = RightHandSide.of(simulator)
        if side is None:
            raise InputError("the model has no accessible right-hand side.")
        times, values = experiment.times, experiment.output_values
        there = ~np.isnan(values)
        if (there.sum(axis=0) < SETTINGS.first_samples).any():
            return None
        filled = np.column_stack(
            [np.interp(times, times[own], column[own]) for own, column in zip(there.T, values.T, strict=True)]
        )
        noise = np.array([second_difference_noise(times, column) for column in values.T])
        _, columns = problem.parameters.for_experiment(index)
        states, slopes = states_from_outputs(side, start[columns], times, filled)
        own = slopes.any(axis=1)
        scale = np.maximum(noise, 1e-9 * np.nanstd(values, axis=0))
        if not scale.all():  # an output that never changes tells no slopes
            return None
        return cls(side, columns, WeakForm(times, there[:, own]), states, slopes[own], scale[own])

    def residuals(self, thetas: Floats) -> Floats:
        """Return the whitened residuals (m, n), NaN where f fails."""
        found = []
        for states, rates in self.states(np.ascontiguousarray(thetas[:, self.columns])):
            outputs, slopes = states @ self.slopes.T, rates @ self.slopes.T
            found.append(self.windows.residual(outputs, slopes[::2], slopes[1::2]) / self.noise / self.windows.noise)
        return np.array(found).reshape(len(thetas), -1)


class _Scaled:
    """Residuals of all experiments over logarithms, or shares, of the acting parameters."""

    def __init__(self, records: list[_WeakRecord], start: Floats, acting: Indices, scale: Floats) -> None:
        self.records, self.start, self.acting = records, start, acting
        self._scale, self._logs = scale[acting], start[acting] != 0.0

    def thetas(self, given: Floats) -> Floats:
        """Return the parameters (m, N) of searched values (m, n_acting)."""
        found = np.tile(self.start, (len(given), 1))
        logs = self._logs
        with np.errstate(over="ignore"):
            found[:, self.acting[logs]] *= np.exp(given[:, logs])
        found[:, self.acting[~logs]] = given[:, ~logs] * self._scale[~logs]
        return found

    def __call__(self, given: Floats) -> Floats:
        """Return the residuals (n,) at searched values (n_acting,)."""
        thetas = self.thetas(given[None])
        return np.concatenate([record.residuals(thetas)[0] for record in self.records])

    def points(self, lower: Floats, upper: Floats) -> Floats:
        """Return points (n_points, n_acting) between bounds; shares stay at their start."""
        units = sobol_points(lower.size, SETTINGS.points, seed=0)
        return np.where(self._logs, lower + units * (upper - lower), 0.0)

    def parameters(self, lower: Floats, upper: Floats) -> dict[str, Parameter]:
        """Return the searched values as parameters within bounds (N,) and reach."""
        found = {}
        for j, (i, log) in enumerate(zip(self.acting.tolist(), self._logs.tolist(), strict=True)):
            value, scale = float(self.start[i]), float(self._scale[j])
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.array([lower[i], upper[i]]) / (value if log else scale)
                ends = np.sort(np.log(np.maximum(ends, 0.0)) if log else ends)
            farthest = np.log(SETTINGS.reach) if log else SETTINGS.reach
            found[f"p{i}"] = Parameter(0.0, max(float(ends[0]), -farthest), min(float(ends[1]), farthest), nominal=1.0)
        return found


def _fitted(problem: Problem, records: list[_WeakRecord], start: Floats) -> tuple[Floats, float] | None:
    """Return the parameters (N,) of the weak form, and its relative residual."""
    if not records:
        return None
    every = np.arange(start.size)
    moved = np.vstack([start, start + np.diag(SETTINGS.change * problem.parameters.magnitudes(start))])
    moved = np.clip(moved, problem.parameters.lower, problem.parameters.upper)
    still = moved[1:] == start  # at the upper bound
    moved[1:][still.all(axis=1)] -= np.diag(SETTINGS.change * problem.parameters.magnitudes(start))[still.all(axis=1)]
    values = np.concatenate([record.residuals(moved) for record in records], axis=1)
    if not np.isfinite(values[0]).all():
        return None
    acting = every[(np.abs(values[1:] - values[0]) > 0.0).any(axis=1)]
    size = values.shape[1]
    if not acting.size or size <= acting.size:
        return None
    scaled = _Scaled(records, start, acting, problem.parameters.scale)
    given = scaled.parameters(problem.parameters.lower, problem.parameters.upper)
    search = Evaluator(LeastSquares.from_function(scaled, np.zeros(size), given, noise=Noise(1.0)))
    lower, upper = search.problem.parameters.lower, search.problem.parameters.upper
    found = Marquardt(max_iterations=SETTINGS.iterations).search(search)
    enough = max(0.5 * size * SETTINGS.poor**2, found.fit.cost / 4.0)
    for theta in scaled.points(lower, upper):
        if found.fit.cost <= enough:
            break
        found = min(found, SECOND.search(search, None, theta), key=lambda each: each.fit.cost)
    return scaled.thetas(found.values[None])[0], math.sqrt(2.0 * found.fit.cost / size)


def _with_initial_states(problem: Problem, records: list[_WeakRecord | None], theta: Floats) -> Floats:
    """Fit parameters of initial states alone to the first measured states."""
    parameters, found = problem.parameters, theta.copy()
    for record in records:
        if record is None:
            continue
        columns = record.columns
        moved = found[columns] + np.vstack([np.zeros(columns.size), np.diag(parameters.scale[columns])])
        states = record.side.initial(moved)
        if states is None or not np.isfinite(states).all():
            continue
        slopes = (states[1:] - states[0]).T / record.side.nominals[:, None]
        free = (np.abs(slopes) > 0.0).any(axis=0) & ~_acts(record, moved)
        if not free.any():
            continue
        ((known, _),) = record.states(found[None, columns])
        first = np.median(known[: SETTINGS.first_samples], axis=0)
        step = np.linalg.lstsq(slopes[:, free], (first - states[0]) / record.side.nominals, rcond=1e-8)[0]
        where = columns[free]
        found[where] = np.clip(
            found[where] + step * parameters.scale[where], parameters.lower[where], parameters.upper[where]
        )
    return found


def _acts(record: _WeakRecord, moved: Floats) -> Flags:
    """Return flags of the parameters that act on f."""
    slopes, _ = record.side(both_ends(record.states.told), moved)
    with np.errstate(invalid="ignore"):
        return np.asarray(~(slopes[1:] == slopes[0]).all(axis=(1, 2)), dtype=np.bool_)
