"""Steady states: all derivatives of the states are zero, or outputs are still.

Newton steps while they contract, else linearly implicit Euler steps, which follow the transient into its own steady
state (pseudo-transient continuation: Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 6.4); all rows
at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.simulation.point_model import ModelOfPoints, PointModel, StateSpace
from fmuid.simulation.simulator import Simulator


@dataclass(frozen=True)
class NewtonSettings:
    """Numbers of the search for steady states."""

    most_iterations: int = 60
    other_iterations: int = 25  # from the second starts: rows that are not there by then rarely arrive
    tolerance: float = 1e-9  # last step, relative to state or nominal value; the next would be its square
    contraction: float = 0.5  # largest correction of a step, relative to it (Newton-Mysovskikh)
    change: tuple[float, float] = (0.1, 100.0)  # of the time step, at once
    longest: float = 1e8  # time step over the first; a longer one is a Newton step
    least_step: float = 1e-6  # time step over the first: shorter ones lead nowhere
    singular: float = 1e-12  # smallest singular value of A in nominal values
    rest: float = 1e-9  # rate that no step changes, over the largest of its terms
    same: float = 1e-6  # relative difference of two solutions that are one
    unstable: float = 1e-6  # real part of an eigenvalue over the largest magnitude
    away: float = 3.0  # second start, in nominal values from the first


SETTINGS = NewtonSettings()


class SteadyIssue(Enum):
    """Reason why a row has no steady state."""

    NONE = "none"  # no iteration ends at one
    SEVERAL = "several"  # two starts end at different stable ones
    UNSTABLE = "unstable"
    EVENT = "event"  # there is an event at the point
    MOVING = "moving"  # the simulation does not come to rest


@dataclass(frozen=True, eq=False)
class SteadyStates:
    """Steady states (K, n_x) of one theta, with linear models."""

    states: Floats
    models: StateSpace
    found: Flags


def find_steady_states(model: PointModel, theta: Floats, start: Floats) -> SteadyStates:
    """Return the steady states from start (K, n_x); rows that end at none begin again at a neighbor's solution."""
    found = settle(model, theta, start)
    if found.found.any() and not found.found.all():
        near = np.flatnonzero(found.found)
        nearest = near[np.abs(np.arange(len(start))[:, None] - near).argmin(axis=1)]
        return settle(model, theta, np.where(found.found[:, None], found.states, found.states[nearest]))
    return found


def settle(
    model: PointModel,
    theta: Floats,
    start: Floats,
    *,
    by_newton: bool = False,
    most_iterations: int = SETTINGS.most_iterations,
) -> SteadyStates:
    """Iterate all rows, each with its own time step; `by_newton`, rows are lost where Newton does not contract."""
    thetas, states = theta[None], start.copy()
    models = model.at(states, thetas)
    scale = np.maximum(np.abs(states), model.nominals)
    first = _first_time_step(models, scale)
    step, last = np.full(len(states), np.inf), first
    done, lost = np.zeros((2, len(states)), dtype=np.bool_)
    for _ in range(most_iterations):
        system = _ImplicitStep(models, scale, step)
        moves = system.solve(models.rates[0])
        sizes = _norm(moves / scale)
        newton, small = np.isinf(step), sizes <= SETTINGS.tolerance
        done |= newton & small
        lost |= ~np.isfinite(models.rates[0]).all(axis=1) | (step < SETTINGS.least_step * first)
        moving = ~done & ~lost
        if not moving.any():
            break
        trial = np.where(moving[:, None] & np.isfinite(moves), states + moves, states)
        others = model.at(trial, thetas)
        correction = system.solve(others.rates[0] - moves / step[:, None])
        contraction = _norm(correction / scale) / np.maximum(sizes, 1e-300)
        better = moving & ((contraction <= SETTINGS.contraction) | (small & ~newton))
        lost |= by_newton & moving & ~better
        change = np.clip(0.5 * SETTINGS.contraction / np.maximum(contraction, 1e-9), *SETTINGS.change)
        longer = np.where(small | (step * change > SETTINGS.longest * first), np.inf, step * change)
        last = np.where(better & ~newton, step, np.where(newton, last, np.fmin(change, 0.5) * step))
        step = np.where(better, longer, np.where(moving, last, step))
        states = np.where(better[:, None], trial, states)
        models = _chosen(better, others, models)
        scale = np.maximum(np.abs(states), model.nominals)
    moves = np.where(done[:, None], np.nan_to_num(moves), 0.0)  # small: their squares are nothing
    outputs = models.outputs + (models.c[0] @ moves[..., None])[None, ..., 0]
    return SteadyStates(states + moves, replace(models, outputs=outputs), done)


def _first_time_step(models: StateSpace, scale: Floats) -> Floats:
    """Return a time step (K,) within which rates and states change little."""
    scaled = np.abs(models.a[0] * scale[:, None] / scale[:, :, None]).sum(axis=2)
    rates = np.abs(models.rates[0]) / scale
    return np.asarray(1.0 / np.maximum(np.nan_to_num(np.maximum(scaled, rates)).max(axis=1, initial=0.0), 1e-300))


def is_at_rest(models: StateSpace, scale: Floats) -> Flags:
    """Return whether all rates are zero, but for rounding."""
    rows = np.abs(models.a * scale[:, None]).max(axis=3)
    return np.asarray((np.abs(models.rates) <= SETTINGS.rest * rows).all(axis=(1, 2)))


class _ImplicitStep:
    """Linearly implicit Euler steps of all rows; of infinite time, Newton steps, the shortest where A is singular."""

    def __init__(self, models: StateSpace, scale: Floats, step: Floats) -> None:
        scaled = models.a[0] * scale[:, None] / scale[:, :, None]
        self.scale, self.well = scale, np.isfinite(scaled).all(axis=(1, 2))
        matrices = np.eye(scale.shape[1]) / step[:, None, None] - np.where(self.well[:, None, None], scaled, 0.0)
        self.rows = np.abs(matrices).max(axis=2, initial=0.0)
        self.unit = np.where(self.rows > 0.0, self.rows, 1.0)
        self.matrices = matrices / self.unit[..., None]
        self.inverses = _inverses(self.matrices)

    def solve(self, rates: Floats) -> Floats:
        """Return the steps (K, n_x) for rates; NaN where none reaches them."""
        well = self.well & np.isfinite(rates).all(axis=1)
        right = np.where(well[:, None], rates, 0.0) / (self.scale * self.unit)
        found = (self.inverses @ right[..., None])[..., 0]
        rest = np.abs((self.matrices @ found[..., None])[..., 0] - right)
        reached = well & (rest <= np.where(self.rows > 0.0, SETTINGS.rest, 0.0)).all(axis=1)
        return np.where(reached[:, None], found * self.scale, np.nan)


def _inverses(matrices: Floats) -> Floats:
    """Return inverses (K, n, n), pseudo-inverses of singular matrices."""
    try:
        found = np.linalg.inv(matrices)
        largest = np.abs(found).max(axis=(1, 2), initial=0.0)
        singular = ~(largest * SETTINGS.singular < 1.0)
    except np.linalg.LinAlgError:
        found, singular = np.empty_like(matrices), np.ones(len(matrices), dtype=np.bool_)
    if singular.any():
        found[singular] = np.linalg.pinv(matrices[singular], rcond=SETTINGS.singular)
    return np.asarray(found)


def _chosen(which: Flags, new: StateSpace, old: StateSpace) -> StateSpace:
    """Return the new models of some rows (K,), else the old ones."""
    if which.all():
        return new
    parts = [
        np.where(which.reshape(1, -1, *[1] * (one.ndim - 2)), one, other)
        for one, other in zip(vars(new).values(), vars(old).values(), strict=True)
    ]
    return StateSpace(*parts)


def _norm(steps: Floats) -> Floats:
    return np.asarray(np.abs(steps).max(axis=1, initial=0.0))


def first_issue(
    model: PointModel, theta: Floats, found: SteadyStates, *, first: bool, starts: Sequence[Floats]
) -> tuple[int, SteadyIssue] | None:
    """Return the first row without a usable steady state, and the reason.

    At the `first` theta, events are sought, and other steady states from `starts`.
    """
    tests = [(~found.found, SteadyIssue.NONE), (is_unstable(found.models), SteadyIssue.UNSTABLE)]
    if first:
        tests.append((model.events(found.states, theta), SteadyIssue.EVENT))
        tests += [(_differs(model, theta, found, start), SteadyIssue.SEVERAL) for start in starts]
    return next(((int(rows.argmax()), issue) for rows, issue in tests if rows.any()), None)


def is_unstable(models: StateSpace) -> Flags:
    """Return whether a state of each row (K,) grows."""
    values = np.linalg.eigvals(np.nan_to_num(models.a[0]))
    largest = np.abs(values).max(axis=1, initial=0.0)
    return np.asarray((values.real > SETTINGS.unstable * largest[:, None]).any(axis=1))


def other_starts(model: PointModel, states: Floats) -> list[Floats]:
    """Return starts far on both sides of steady states (K, n_x)."""
    far = SETTINGS.away * np.maximum(np.abs(states), model.nominals)
    return [states + far, states - far]


def _differs(model: PointModel, theta: Floats, found: SteadyStates, start: Floats) -> Flags:
    """Return whether each row (K,) has another stable steady state, from start."""
    scale = np.maximum(np.abs(found.states), model.nominals)
    other = settle(model, theta, start, most_iterations=SETTINGS.other_iterations)
    apart = other.found & (_norm((other.states - found.states) / scale) > SETTINGS.same)
    real = np.linalg.eigvals(np.nan_to_num(other.models.a[0])).real
    return np.asarray(apart & (real < 0.0).all(axis=1))


@dataclass(frozen=True)
class SettlingSettings:
    """Numbers of the wait for rest."""

    first: float = 1.0  # s: duration of the first simulation; each later one is four times as long
    most: float = 1e5  # s
    samples: int = 41
    last_share: float = 0.25  # of the simulation, in which outputs are still
    still: float = 1e-7  # change, relative to the largest value


SETTLING = SettlingSettings()


class SettledSimulation:
    """Outputs after constant inputs (K,) in `units`, a row each."""

    def __init__(
        self, model: ModelOfPoints, inputs: Mapping[str, Floats], outputs: Sequence[str], units: Mapping[str, str]
    ) -> None:
        self.model, self.inputs, self.outputs, self.units = model, inputs, tuple(outputs), units

    def check(self) -> None:
        """Check all names (`InputError`)."""
        self._simulator(0, SETTLING.first)

    def rest(self, row: int, theta: Floats) -> Floats | None:
        """Return the outputs (n_outputs,) of a row at rest; None if they do not come to rest."""
        duration = SETTLING.first
        while duration <= SETTLING.most:
            found = self._simulator(row, duration).many(theta[None])
            if found.errors[0] is not None:
                return None
            values = found.outputs[0]
            late = values[int((1.0 - SETTLING.last_share) * len(values)) :]
            if (np.ptp(late, axis=0) <= SETTLING.still * np.abs(values).max(axis=0) + 1e-300).all():
                return np.asarray(values[-1])
            duration *= 4.0
        return None

    def _simulator(self, row: int, duration: float) -> Simulator:
        times = np.linspace(0.0, duration, SETTLING.samples)
        columns = {name: np.full(times.size, each[row]) for name, each in self.inputs.items()}
        return self.model.simulator(columns, self.outputs, self.units, times)
