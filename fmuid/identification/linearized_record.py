"""A record linearized along its simulation: ẋ = A x + B_u u + B_p p + …, from the right-hand side, without integration.

Each interval has constant A and a forcing that is linear in time: x⁺ = E x + h φ₁ g₀ + h φ₂ (g₁ − g₀), E = exp(A h),
φ₁, φ₂ the functions of exponential integrators (Hochbruck and Ostermann, Acta Numerica 19, 2010, eq. 2.10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.simulation import RightHandSide, Simulator


@dataclass(frozen=True)
class LinearizationSettings:
    """Numbers of the linearization."""

    relative_step: float = 1e-4  # of differences: rounding and curvature are both small
    most_states: int = 30  # each costs a pass over the record
    taylor_terms: int = 6  # of φ₂ at arguments below 1/8: 1e-9


SETTINGS = LinearizationSettings()


@dataclass(frozen=True, eq=False)
class StateForcing:
    """Change of rates and outputs, and jumps of the state."""

    rates: Floats  # (P, n_x) at P = 2 (K − 1) points: begin and end of each interval
    outputs: Floats | None = None  # (K, n_y), direct change of the outputs at the samples
    begin: Floats | None = None  # (K − 1, n_x), jumps of the state at the begin of each interval
    end: Floats | None = None  # (K − 1, n_x), jumps at its end
    initial: Floats | None = None  # (n_x,), change of the initial state


@dataclass(frozen=True, eq=False)
class DiscreteStateSpace:
    """Steps of a linearized record: x⁺ = E x + G g, y = C x."""

    transition: Floats  # (n_x, n_x), E
    by_rate: Floats  # (n_x, n_x), G: change of the states by rates held for a step, s
    observed: Floats  # (n_y, n_x), C


class LinearizedRecord:
    """A simulated experiment with its derivatives by states, parameters and inputs.

    At both ends of each interval, P = 2 (K − 1) points: `rates` ẋ (P, n_x), `ends` y (P, n_y), `observed` ∂y/∂x,
    `by_parameter` and `by_input` ∂ẋ/∂θ and ∂ẋ/∂u (N or n_u, P, n_x), `outputs_by_…` likewise. `outputs` (K, n_y) and
    `trajectory` (K, n_x) are at samples.
    """

    def __init__(self, simulator: Simulator, side: RightHandSide, theta: Floats, trajectory: Floats) -> None:
        experiment = simulator.experiment
        self.experiment, self.times, self.theta = experiment, experiment.times, theta
        self.states, self.trajectory = side.states, trajectory
        ends, step = both_ends(trajectory), SETTINGS.relative_step
        thetas = np.vstack([theta, theta + np.diag(step * np.maximum(np.abs(theta), 1e-12))])
        moved_theta = np.diag(thetas[1:] - theta)
        rates, outputs = side(ends, thetas)
        initial = side.initial(thetas)
        self.initial_by_parameter = np.zeros((len(theta), trajectory.shape[1]))
        if initial is not None:
            self.initial_by_parameter = (initial[1:] - initial[0]) / moved_theta[:, None]
        self.rates, self.ends = rates[0], outputs[0]
        self.outputs = np.vstack([outputs[0][::2], outputs[0][-1:]])
        self.by_parameter = (rates[1:] - rates[0]) / moved_theta[:, None, None]
        self.outputs_by_parameter = (outputs[1:] - outputs[0]) / moved_theta[:, None, None]
        sizes = step * np.maximum(np.abs(trajectory).max(axis=0), 1e-9 * side.nominals)
        moved = [side(ends + size * axis, theta[None]) for size, axis in zip(sizes, np.eye(len(sizes)), strict=True)]
        self._by_state = np.stack([(each[0][0] - rates[0]) / h for each, h in zip(moved, sizes, strict=True)], axis=2)
        self.observed = np.stack([(each[1][0] - outputs[0]) / h for each, h in zip(moved, sizes, strict=True)], axis=2)
        count = len(experiment.input_names)
        self.by_input, self.outputs_by_input = np.zeros((count, *rates[0].shape)), np.zeros((count, *outputs[0].shape))
        for j in range(count):
            self.by_input[j], self.outputs_by_input[j] = self._by_input(simulator, ends, j)

    @classmethod
    def of(cls, simulator: Simulator, theta: Floats) -> LinearizedRecord | None:
        """Return the record of theta (N,); None where the model shows no derivatives, or has too many states."""
        side = RightHandSide.of(simulator)
        if side is None or not 0 < len(side.states) <= SETTINGS.most_states or (np.diff(side.times) <= 0.0).any():
            return None
        trajectory = side.trajectory(theta)
        if trajectory is None:
            return None
        record = cls(simulator, side, theta, trajectory)
        arrays = record.rates, record._by_state, record.by_parameter, record.by_input
        return record if all(np.isfinite(each).all() for each in arrays) else None

    def _by_input(self, simulator: Simulator, ends: Floats, column: int) -> tuple[Floats, Floats]:
        """Return ∂ẋ/∂u and ∂y/∂u of one input, in units of the data."""
        values = self.experiment.input_values[:, column]
        step = 10.0 * SETTINGS.relative_step * max(float(np.abs(values).max()), 1e-9)
        side = RightHandSide.of(simulator.over(with_input(self.experiment, column, values + step)))
        assert side is not None, "it shows its derivatives"
        rates, outputs = side(ends, self.theta[None])
        return (rates[0] - self.rates) / step, (outputs[0] - self.ends) / step

    @cached_property
    def _steps(self) -> tuple[Floats, Floats, Floats]:
        """E, h φ₁ and h φ₂ (K − 1, n_x, n_x); one each where all intervals are alike."""
        h = np.diff(self.times)[:, None, None]
        matrices = 0.5 * (self._by_state[::2] + self._by_state[1::2]) * h
        spread = np.ptp(matrices, axis=0)
        if (spread <= 1e-6 * np.abs(matrices).max()).all() and np.ptp(h) <= 1e-6 * h.max():
            matrices, h = matrices[:1], h[:1]
        e, one, two = exponentials(matrices)
        return e, h * one, h * two

    @property
    def state_space(self) -> DiscreteStateSpace:
        """Mean matrices of its steps."""
        transition, by_rate = (each.mean(axis=0) for each in self._steps[:2])
        return DiscreteStateSpace(transition, by_rate, self.observed.mean(axis=0))

    def response(self, forcings: list[StateForcing]) -> Floats:
        """Return the change of the outputs (m, K, n_y) by each forcing."""
        e, one, two = self._steps
        count, width = len(self.times), len(forcings)
        rates = np.stack([each.rates for each in forcings], axis=2)
        first, last = rates[::2], rates[1::2]
        gain = one @ first + two @ (last - first)
        for k, each in enumerate(forcings):
            if each.begin is not None:
                gain[:, :, k] += np.einsum(
                    "...ij,...j->...i", np.broadcast_to(e, (count - 1, *e.shape[1:])), each.begin
                )
            if each.end is not None:
                gain[:, :, k] += each.end
        state = np.zeros((count, len(self.states), width))
        for k, each in enumerate(forcings):
            if each.initial is not None:
                state[0, :, k] = each.initial
        now, alike = state[0], len(e) == 1
        for k in range(count - 1):
            now = (e[0] if alike else e[k]) @ now + gain[k]
            state[k + 1] = now
        observed = np.concatenate([self.observed[::2], self.observed[-1:]]) @ state
        found = np.moveaxis(observed, 2, 0)
        for k, each in enumerate(forcings):
            if each.outputs is not None:
                found[k] += each.outputs
        return np.ascontiguousarray(found)

    @cached_property
    def sensitivities(self) -> Floats:
        """Return ∂y/∂θ (N, K, n_y) of the linearized model."""
        rows = zip(self.by_parameter, self.outputs_by_parameter, self.initial_by_parameter, strict=True)
        return self.response([StateForcing(f, self.at_samples(y), initial=x) for f, y, x in rows])

    def at_samples(self, ends: Floats) -> Floats:
        """Return values (K, …) at the samples from those at both ends (P, …): the begin of each interval."""
        return np.concatenate([ends[::2], ends[-1:]])

    @cached_property
    def half_samples(self) -> Floats:
        """Outputs (K − 1, n_y) at half samples, by cubic interpolation."""
        h = np.diff(self.times)[:, None]
        slopes = np.einsum("pij,pj->pi", self.observed, self.rates)
        for j, each in enumerate(self.outputs_by_input):
            slopes += each * self.input_slopes[:, j, None]
        begin, end = self.ends[::2], self.ends[1::2]
        return np.asarray(0.5 * (begin + end) + h / 8.0 * (slopes[::2] - slopes[1::2]))

    @cached_property
    def input_slopes(self) -> Floats:
        """Slopes of the inputs (P, n_u), zero of held ones."""
        rise = np.diff(self.experiment.input_values, axis=0) / np.diff(self.times)[:, None]
        return np.repeat(np.where(self.experiment.held, 0.0, rise), 2, axis=0)

    @cached_property
    def input_ends(self) -> Floats:
        """Inputs at both ends of each interval (P, n_u)."""
        found = both_ends(self.experiment.input_values)
        found[1::2, self.experiment.held] = found[::2, self.experiment.held]
        return found


def both_ends(states: Floats) -> Floats:
    """Return the states at both ends of each interval."""
    return np.repeat(states, 2, axis=0)[1:-1]


def with_input(experiment: Experiment, column: int, values: Floats) -> Experiment:
    """Return an experiment with other values (K,) of an input."""
    name = experiment.input_names[column]
    own = f"{experiment.columns[name]} changed"
    inputs = {each: own if each == name else experiment.columns[each] for each in experiment.input_names}
    return replace(experiment, frame=experiment.frame.assign(**{own: values}), inputs=inputs)


def exponentials(matrices: Floats) -> tuple[Floats, Floats, Floats]:
    """Return exp, φ₁ and φ₂ of matrices (m, n, n)."""
    size = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(max(size, 1e-300)))) + 3)
    small, one = matrices / 2.0**squarings, np.eye(matrices.shape[1])
    two = 0.5 * one + 0.0 * small
    term = 0.5 * one + 0.0 * small
    for k in range(1, SETTINGS.taylor_terms + 1):
        term = term @ small / (k + 2)
        two = two + term
    first = one + small @ two
    e = one + small @ first
    for _ in range(squarings):
        two = 0.25 * (first @ first + 2.0 * two)
        first = 0.5 * (e @ first + first)
        e = e @ e
    return e, first, two
