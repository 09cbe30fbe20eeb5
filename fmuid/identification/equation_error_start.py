"""Starting point from the weak form of the equations, without simulation.

It needs one Model Exchange FMU. Noise in the states biases it, most for time constants below the sampling interval: it
gives a starting point, never a result.

Measured states: x = x₀ + C⁺ (y* − y₀). With x = x* + N z and C N = 0, the unmeasured z obey ż = N⁺ f(x* + N z, u, θ).
Newton's method solves the trapezoidal rule over all intervals at once, at a cost that does not grow with stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from fmuid.array_types import Flags, Floats, Indices
from fmuid.data import Noise, Parameter
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Evaluator, LeastSquares, Marquardt, WeakForm, second_difference_noise, sobol_points
from fmuid.identification.linearized_record import both_ends
from fmuid.identification.problem import Problem
from fmuid.simulation import RightHandSide, Simulator


@dataclass(frozen=True)
class WeakFormSettings:
    """Numbers of the search by the weak form."""

    reach: float = 300.0  # factor that bounds a parameter from the starting point
    iterations: int = 50
    poor: float = 15.0  # noise levels; a larger residual may be a local optimum, and other points are tried ...
    points: int = 2  # ... until it is halved
    change: float = 0.01  # of the magnitudes, to find acting parameters
    first_samples: int = 3  # whose median is the first state
    independent: float = 1e-6  # least singular value of ∂y/∂x of a measured direction, relative to the largest
    most_unmeasured: int = 8  # directions; each costs an evaluation a step
    most_steps: int = 5  # of Newton's method, ...
    settled: float = 1e-6  # ... their end, ...
    difference: float = 1e-3  # ... and differences, in units of the nominals


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
        simulator, experiment = problem.simulators[index], problem.experiments[index].of_model
        if not isinstance(simulator, Simulator):  # of steady states: there are no slopes
            return None
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
        self._scale, self.logs = scale[acting], start[acting] != 0.0

    def thetas(self, given: Floats) -> Floats:
        """Return the parameters (m, N) of searched values (m, n_acting)."""
        found, logs = np.tile(self.start, (len(given), 1)), self.logs
        with np.errstate(over="ignore"):
            found[:, self.acting[logs]] *= np.exp(given[:, logs])
        found[:, self.acting[~logs]] = given[:, ~logs] * self._scale[~logs]
        return found

    def __call__(self, given: Floats) -> Floats:
        """Return the residuals (n,) at searched values (n_acting,)."""
        thetas = self.thetas(given[None])
        return np.concatenate([record.residuals(thetas)[0] for record in self.records])

    def parameters(self, lower: Floats, upper: Floats) -> dict[str, Parameter]:
        """Return the searched values as parameters within bounds (N,) and reach."""
        found = {}
        for i, scale, log in zip(self.acting.tolist(), self._scale.tolist(), self.logs.tolist(), strict=True):
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.array([lower[i], upper[i]]) / (float(self.start[i]) if log else scale)
                ends = np.sort(np.log(np.maximum(ends, 0.0)) if log else ends)
            farthest = np.log(SETTINGS.reach) if log else SETTINGS.reach
            found[f"p{i}"] = Parameter(0.0, max(float(ends[0]), -farthest), min(float(ends[1]), farthest), nominal=1.0)
        return found


def _fitted(problem: Problem, records: list[_WeakRecord], start: Floats) -> tuple[Floats, float] | None:
    """Return the parameters (N,) of the weak form, and its relative residual."""
    if not records:
        return None
    parameters = problem.parameters
    change = np.diag(SETTINGS.change * parameters.magnitudes(start))
    moved = np.clip(np.vstack([start, start + change]), parameters.lower, parameters.upper)
    still = (moved[1:] == start).all(axis=1)  # at the upper bound
    moved[1:][still] -= change[still]
    values = np.concatenate([record.residuals(moved) for record in records], axis=1)
    if not np.isfinite(values[0]).all():
        return None
    acting = np.flatnonzero((np.abs(values[1:] - values[0]) > 0.0).any(axis=1))
    size = values.shape[1]
    if not acting.size or size <= acting.size:
        return None
    scaled = _Scaled(records, start, acting, parameters.scale)
    given = scaled.parameters(parameters.lower, parameters.upper)
    search = Evaluator(LeastSquares.from_function(scaled, np.zeros(size), given, noise=Noise(1.0)))
    lower, upper = search.problem.parameters.lower, search.problem.parameters.upper
    found = Marquardt(max_iterations=SETTINGS.iterations).search(search)
    enough = max(0.5 * size * SETTINGS.poor**2, found.fit.cost / 4.0)
    units = sobol_points(acting.size, SETTINGS.points, seed=0)
    for theta in np.where(scaled.logs, lower + units * (upper - lower), 0.0):  # shares stay at their start
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
        at = columns[free]
        found[at] = np.clip(found[at] + step * parameters.scale[at], parameters.lower[at], parameters.upper[at])
    return found


def _acts(record: _WeakRecord, moved: Floats) -> Flags:
    """Return flags of the parameters that act on f."""
    slopes, _ = record.side(both_ends(record.states.told), moved)
    with np.errstate(invalid="ignore"):
        return np.asarray(~(slopes[1:] == slopes[0]).all(axis=(1, 2)), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class MeasuredStates:
    """States of one experiment for any parameters."""

    side: RightHandSide
    intervals: Floats  # (K − 1, 1), between the samples, s
    told: Floats  # (K, n_x), from the outputs
    unseen: Floats  # (n_x, n_z), N, directions that change no output, of the length of the nominals

    def __call__(self, thetas: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield states (K, n_x) of each theta; derivatives (2 (K − 1), n_x) at both ends of each interval."""
        if not self.unseen.size:
            yield from ((self.told, rates) for rates in self.side(both_ends(self.told), thetas)[0])
            return
        inverse = np.asarray(np.linalg.pinv(self.unseen), dtype=np.float64)
        first = self.side.initial(thetas)
        begins = np.zeros((len(thetas), len(inverse))) if first is None else (first - self.told[0]) @ inverse.T
        for theta, begin in zip(thetas, begins, strict=True):
            yield self._followed(theta[None], begin, inverse)

    def _followed(self, theta: Floats, begin: Floats, inverse: Floats) -> tuple[Floats, Floats]:
        """Return states and derivatives, from unmeasured states at the start (n_z,)."""
        unmeasured = np.tile(begin, (len(self.told), 1))
        half = 0.5 * self.intervals
        for step in range(SETTINGS.most_steps + 1):
            states = self.told + unmeasured @ self.unseen.T
            ends = both_ends(states)
            rates = self.side(ends, theta)[0][0]
            own = rates @ inverse.T
            defect = half * (own[::2] + own[1::2]) - np.diff(unmeasured, axis=0)
            size = max(1.0, float(np.abs(unmeasured).max()))
            if (
                step == SETTINGS.most_steps
                or not np.isfinite(defect).all()
                or np.abs(defect).max() <= SETTINGS.settled * size
            ):
                break
            moved = [self.side(ends + SETTINGS.difference * each, theta)[0][0] for each in self.unseen.T]
            slopes = np.stack([(each - rates) @ inverse.T for each in moved], axis=2) / SETTINGS.difference
            unmeasured[1:] += _marched(half[:, :, None] * slopes[::2], half[:, :, None] * slopes[1::2], defect)
        return states, rates


def _marched(begins: Floats, ends: Floats, defect: Floats) -> Floats:
    """Return δ of (I − E_k) δ_k = (I + B_k) δ_{k−1} + d_k."""
    size, one = defect.shape[1], np.eye(defect.shape[1])
    bands = np.zeros((3 * size - 1, defect.size))
    for i, j in np.ndindex(size, size):
        bands[size - 1 + i - j, j::size] = one[i, j] - ends[:, i, j]
        bands[2 * size - 1 + i - j, j:-size:size] = -one[i, j] - begins[1:, i, j]
    try:
        found = scipy.linalg.solve_banded((2 * size - 1, size - 1), bands, defect.ravel(), check_finite=False)
    except np.linalg.LinAlgError:
        return np.full(defect.shape, np.nan)
    return np.asarray(found.reshape(defect.shape), dtype=np.float64)


def states_from_outputs(
    side: RightHandSide, theta: Floats, times: Floats, outputs: Floats
) -> tuple[MeasuredStates, Floats]:
    """Return the states by outputs (K, n_y), and C = ∂y/∂x (n_y, n_x)."""
    slopes, base, at = side.output_slopes(theta)
    if not np.isfinite(at).all() or not np.isfinite(slopes).all():
        raise InputError("the outputs are not available.")
    sizes = np.maximum(np.std(outputs, axis=0), 1e-300)
    _, values, directions = np.linalg.svd(slopes / sizes[:, None])
    count = int((values > SETTINGS.independent * values.max(initial=0.0)).sum())
    if not count or len(directions) - count > SETTINGS.most_unmeasured:
        raise InputError("the outputs do not determine the states.")
    seen = directions[:count] / side.nominals
    gain = side.nominals[:, None] * np.linalg.pinv(slopes / sizes[:, None], rcond=SETTINGS.independent) / sizes
    told = (base @ seen.T) @ (directions[:count] * side.nominals) + (outputs - at) @ gain.T
    unseen = side.nominals[:, None] * directions[count:].T
    return MeasuredStates(side, np.diff(times)[:, None], told, unseen), slopes / side.nominals
