"""Steady states: all derivatives of the states are zero, or outputs are still.

Newton steps while they contract, else linearly implicit Euler steps, which follow the transient into its own steady
state (pseudo-transient continuation: Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 6.4); all rows
at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.models import Phasors
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
    """Steady states (m, K, n_x) of thetas, with linear models."""

    states: Floats
    models: StateSpace
    found: Flags  # (m, K)

    @cached_property
    def unstable(self) -> Flags:
        """Whether a state of each row (m, K) grows."""
        values = _eigenvalues(self.models)
        largest = np.abs(values).max(axis=-1, initial=0.0)
        return np.asarray((values.real > SETTINGS.unstable * largest[..., None]).any(axis=-1))

    def of(self, which: slice | Flags) -> SteadyStates:
        """Return the steady states of some thetas (m,)."""
        return SteadyStates(self.states[which], self.models.of(which), self.found[which])

    def replaced(self, which: Flags, other: SteadyStates) -> SteadyStates:
        """Return them with those of `other` for some thetas (m,)."""
        states, found = self.states.copy(), self.found.copy()
        states[which], found[which] = other.states, other.found
        return SteadyStates(states, self.models.replaced(which, other.models), found)


def find_steady_states(model: PointModel, thetas: Floats, start: Floats) -> SteadyStates:
    """Return the steady states from start (m, K, n_x).

    Rows that end at none begin again at a neighbor's solution.
    """
    found = settle(model, thetas, start)
    again = np.asarray(found.found.any(axis=1) & ~found.found.all(axis=1))
    if again.any():
        start = found.states[again]
        for states, there in zip(start, found.found[again], strict=True):
            near = np.flatnonzero(there)
            nearest = near[np.abs(np.arange(len(states))[:, None] - near).argmin(axis=1)]
            states[~there] = states[nearest[~there]]
        return found.replaced(again, settle(model, thetas[again], start))
    return found


def steady_states_near(model: PointModel, thetas: Floats, near: Floats) -> SteadyStates:
    """Return the steady states by Newton steps from near (K, n_x).

    Thetas whose steps do not contract have rows that are not found.
    """
    states, last = np.repeat(near[None], len(thetas), axis=0), np.full((len(thetas), len(near)), np.inf)
    while True:
        models = model.at(states, thetas)
        scale = np.maximum(np.abs(states), model.nominals)
        moves = _ImplicitStep(models, scale, np.inf).solve(models.rates)
        sizes = _norm(moves)
        done = sizes <= SETTINGS.tolerance
        alive = np.asarray((done | (sizes <= SETTINGS.contraction * last)).all(axis=1))
        if done[alive].all():
            return _moved(states, models, moves * scale, done)
        states = states + np.where(alive[:, None, None], moves * scale, 0.0)
        last = np.where(alive[:, None], sizes, 0.0)


def settle(
    model: PointModel, thetas: Floats, start: Floats, most_iterations: int = SETTINGS.most_iterations
) -> SteadyStates:
    """Iterate from start (m, K, n_x), each row with its time step."""
    states = np.array(np.broadcast_to(start, (len(thetas), *start.shape[-2:])))
    models = model.at(states, thetas)
    scale = np.maximum(np.abs(states), model.nominals)
    first = _first_time_step(models, scale)
    step, last = np.full(first.shape, np.inf), first
    done, lost = np.zeros((2, *first.shape), dtype=np.bool_)
    for _ in range(most_iterations):
        system = _ImplicitStep(models, scale, step)
        moves = system.solve(models.rates)
        sizes = _norm(moves)
        newton, small = np.isinf(step), sizes <= SETTINGS.tolerance
        done |= newton & small
        lost |= ~np.isfinite(models.rates).all(axis=-1) | (step < SETTINGS.least_step * first)
        moving = ~(done | lost)
        if not moving.any():
            break
        goes = moving & np.isfinite(sizes)
        trial = np.where(goes[..., None], states + moves * scale, states)
        others = model.at(trial, thetas)
        correction = system.solve(others.rates - moves * scale / step[..., None])
        contraction = _norm(correction) / np.maximum(sizes, 1e-300)
        better = (contraction <= SETTINGS.contraction) | (small & ~newton)
        worse = moving & ~better
        change = 0.5 * SETTINGS.contraction / np.maximum(contraction, 1e-9)
        change = np.minimum(np.maximum(change, SETTINGS.change[0]), SETTINGS.change[1])
        longer = np.where(small | (step * change > SETTINGS.longest * first), np.inf, step * change)
        last = np.where(better & ~newton, step, np.where(newton, last, np.fmin(change, 0.5) * step))
        step = np.where(worse, last, np.where(moving, longer, step))
        if worse.any():
            trial = np.where(worse[..., None], states, trial)
            others = others.replaced(worse, models.of(worse))
        states, models = trial, others  # rows at rest have the same models
        scale = np.maximum(np.abs(states), model.nominals)
    return _moved(states, models, moves * scale, done)


def _moved(states: Floats, models: StateSpace, moves: Floats, done: Flags) -> SteadyStates:
    """Return the steady states after the last moves, whose squares are nothing."""
    moves = np.where(done[..., None], moves, 0.0)
    outputs = models.outputs + (models.c @ moves[..., None])[..., 0]
    return SteadyStates(states + moves, replace(models, outputs=outputs), done)


def _first_time_step(models: StateSpace, scale: Floats) -> Floats:
    """Return time steps (m, K) within which little changes."""
    scaled = np.abs(models.a * scale[..., None, :] / scale[..., None]).sum(axis=-1)
    rates = np.abs(models.rates) / scale
    return np.asarray(1.0 / np.maximum(np.nan_to_num(np.maximum(scaled, rates)).max(axis=-1, initial=0.0), 1e-300))


def is_at_rest(models: StateSpace, scale: Floats) -> Flags:
    """Return whether all rates are zero, but for rounding."""
    rows = np.abs(models.a * scale[:, None]).max(axis=3)
    return np.asarray((np.abs(models.rates) <= SETTINGS.rest * rows).all(axis=(1, 2)))


class _ImplicitStep:
    """Linearly implicit Euler steps of all rows; of infinite time, Newton steps, the shortest where A is singular."""

    def __init__(self, models: StateSpace, scale: Floats, step: Floats | float) -> None:
        matrices = (np.eye(scale.shape[-1]) / np.asarray(step)[..., None, None] - models.a) * scale[..., None, :]
        rows = np.abs(matrices).max(axis=-1, initial=0.0)
        self._unknown = ~np.isfinite(rows).all(axis=-1)
        if self._unknown.any():
            matrices[self._unknown], rows[self._unknown] = np.eye(scale.shape[-1]), 1.0
        self._unit = np.where(rows > 0.0, rows, 1.0)
        self._allowed = np.where(rows > 0.0, SETTINGS.rest, 0.0)
        self._matrices = matrices / self._unit[..., None]
        self._inverses = _inverses(self._matrices)

    def solve(self, rates: Floats) -> Floats:
        """Return the steps (m, K, n_x) for rates, relative to the scale.

        NaN where none reaches them.
        """
        right = rates / self._unit
        found = (self._inverses @ right[..., None])[..., 0]
        rest = np.abs((self._matrices @ found[..., None])[..., 0] - right)
        unreached = self._unknown | ~(rest <= self._allowed).all(axis=-1)
        return np.where(unreached[..., None], np.nan, found)


def _inverses(matrices: Floats) -> Floats:
    """Return inverses (..., n, n), pseudo-inverses of singular matrices."""
    try:
        found = np.linalg.inv(matrices)
        singular = ~(np.abs(found).max(axis=(-2, -1), initial=0.0) * SETTINGS.singular < 1.0)
    except np.linalg.LinAlgError:
        found, singular = np.empty_like(matrices), np.ones(matrices.shape[:-2], dtype=np.bool_)
    if singular.any():
        found[singular] = np.linalg.pinv(matrices[singular], rcond=SETTINGS.singular)
    return np.asarray(found)


def _norm(steps: Floats) -> Floats:
    return np.asarray(np.abs(steps).max(axis=-1, initial=0.0))


def _eigenvalues(models: StateSpace) -> Phasors:
    return np.asarray(np.linalg.eigvals(np.nan_to_num(models.a)))


def first_issue(found: SteadyStates) -> list[tuple[int, SteadyIssue] | None]:
    """Return the first unusable row of each theta, and the reason."""
    tests = (~found.found, SteadyIssue.NONE), (found.unstable, SteadyIssue.UNSTABLE)
    return [
        next(((int(rows[i].argmax()), issue) for rows, issue in tests if rows[i].any()), None)
        for i in range(len(found.states))
    ]


def doubt(
    model: PointModel, theta: Floats, found: SteadyStates, starts: Sequence[Floats]
) -> tuple[int, SteadyIssue] | None:
    """Return the first row with an event, or another steady state."""
    events = model.events(found.states[0], theta)
    if events.any():
        return int(events.argmax()), SteadyIssue.EVENT
    others = _differs(model, theta, found, starts) if starts else np.zeros(0, dtype=np.bool_)
    return (int(others.argmax()), SteadyIssue.SEVERAL) if others.any() else None


def other_starts(model: PointModel, states: Floats) -> list[Floats]:
    """Return starts far on both sides of steady states (K, n_x)."""
    far = SETTINGS.away * np.maximum(np.abs(states), model.nominals)
    return [states + far, states - far]


def _differs(model: PointModel, theta: Floats, found: SteadyStates, starts: Sequence[Floats]) -> Flags:
    """Return whether each row (K,) has another stable steady state, from starts."""
    scale = np.maximum(np.abs(found.states), model.nominals)
    thetas = np.tile(theta, (len(starts), 1))
    other = settle(model, thetas, np.stack(starts), SETTINGS.other_iterations)
    apart = other.found & (_norm((other.states - found.states) / scale) > SETTINGS.same)
    return np.asarray((apart & (_eigenvalues(other.models).real < 0.0).all(axis=-1)).any(axis=0))


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
