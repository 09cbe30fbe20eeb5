"""Levenberg–Marquardt optimization of simulations (1.16) with bounds (docs/method/optimization.md).

Forward differences serve on the way, central ones near the optimum if needed. A failed simulation is a refused step.

References: Marquardt, J. SIAM 11 (2), 1963; Bates and Watts, Technometrics 23 (2), 1981.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.finite_differences import SensitivityError
from fmuid.estimation.search.state import (
    STAGNATION,
    STOPPING,
    Iteration,
    ResidualFunction,
    Stagnation,
    State,
    TerminationReason,
    Way,
    square_of,
)
from fmuid.estimation.search.trust_region import REGION, LinearModel, Step, TrustRegion, triangle

Known: TypeAlias = Callable[[Floats, Floats], Floats | None]


@dataclass(frozen=True)
class MarquardtSettings:
    """Settings of an optimization; documented in `fmuid.Marquardt`."""

    max_iterations: int = 1000  # most problems need 5 to 20; the most crooked of NIST (Bennett5) several hundred
    tolerance: float = 1e-6  # share of a parameter's magnitude that is left: six digits
    first_radius: float = 1.0  # length of the first step against the parameters themselves, both measured by D

    def __post_init__(self) -> None:
        for name in ("max_iterations", "tolerance", "first_radius"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(f"the setting {name} of the search must be a positive number, not {value!r}")


@dataclass(frozen=True)
class Descent:
    """Levenberg–Marquardt method for `iterate`."""

    settings: MarquardtSettings
    rough: bool = False  # stop as soon as the noise variances hardly change any more
    known: Known | None = None  # maps theta (N,) and residual (n_rows,) to a nearby Jacobian, used far from the optimum

    def begin(self, function: ResidualFunction, state: State) -> State:
        """Return the first state."""
        square, magnitudes = state.square, function.magnitudes(state.theta)
        way, stagnation = Way(rate=state.way.rate), Stagnation(square, square)
        state = replace(state, linear=None, way=way, stagnation=stagnation, gained=(magnitudes, square))
        state = _linearized(function, state)
        region = TrustRegion.of(self.settings.first_radius * state.model.length(magnitudes))
        state = replace(state, region=region)
        return replace(state, last=_record(function, state, state.theta, square, math.nan, accepted=True))

    def advance(self, function: ResidualFunction, state: State) -> State:
        """Return the state after one more step, or with an outcome."""
        state = replace(state, last=None)
        if not (state.fresh or state.way.near):
            stepped = state.way.predicted < math.inf  # an earlier search may have ended at the limit, converged
            if stepped and state.iterations >= self.settings.max_iterations:
                return replace(state, outcome=TerminationReason.ITERATION_LIMIT)
            state = self._renewed(function, state)
        while state.outcome is None:
            low, high = function.lower - state.theta, function.upper - state.theta
            newton = state.model.step(low, high)
            state = replace(state, held=newton.held & ((low >= 0) | (high <= 0)))
            state = self._measured(function, state, newton)
            state = replace(state, outcome=self._ended(function, state))
            if state.outcome is not None:
                break
            if self._outdated(function, state):
                state = self._renewed(function, state)
            elif state.stagnation.stuck:
                state = self._doubted(function, state)
            else:
                return _stepped(function, state, newton)
        return state

    # --- the Jacobian

    def _suffices(self, function: ResidualFunction, state: State) -> bool:
        """Return True if forward differences are accurate enough for the optimum.

        Errors E along the residual move the optimum by ‖E D⁻¹‖ ‖r‖/s, s the least singular value of J D⁻¹.
        """
        lengths, decomposed = state.model.lengths, state.model.decomposed
        assert decomposed is not None
        smallest = float(decomposed[1][-1])
        error = _error(function, state, lengths, central=False)
        if not error < smallest:
            return False
        moved = error / smallest * math.sqrt(state.square)
        unit = float(np.min(lengths * function.magnitudes(state.theta)))
        return (
            moved <= STOPPING.offset * math.sqrt(state.square / state.free)
            and moved <= self.settings.tolerance * unit * smallest
        )

    def _outdated(self, function: ResidualFunction, state: State) -> bool:
        """Return True if the next step needs a new Jacobian."""
        region, way = state.region, state.way
        if state.borrowed:
            return way.offset <= STOPPING.borrowed or region.rejections > 0 or state.stagnation.stuck
        if state.fresh:
            # many rejections without failures: suspect forward differences
            suspicious = region.rejections > STOPPING.suspicious_rejections and not region.failures
            close = way.offset <= STOPPING.offset or way.predicted <= _noise(function, state)
            return (suspicious and not state.central) or (close and not way.accurate)
        return region.rejections > 0 or state.remaining() != (way.offset, way.change)

    def _renewed(self, function: ResidualFunction, state: State, *, central: bool = False) -> State:
        """Make the Jacobian anew, by central differences if needed."""
        way, region = state.way, state.region
        close = _close(function, state, way.offset if state.fresh else way.rate * way.fresh_offset)
        central = central or (close and not self._suffices(function, state))
        central = central or region.rejections > STOPPING.suspicious_rejections
        far = not (central or close or state.fresh or region.rejections)
        jacobian = self.known(state.theta, state.residual) if far and self.known is not None else None
        state = replace(state, borrowed=jacobian is not None)
        try:
            if jacobian is None:
                jacobian = function.jacobian(state.theta, state.residual, central=central)
        except SensitivityError:
            return replace(state, outcome=TerminationReason.FAILING)
        if state.fresh or region.rejections:
            region = region.reopened(fully=way.near)
        if not state.fresh:
            way = replace(way, previous_offset=way.fresh_offset)
        return _linearized(
            function, replace(state, jacobian=jacobian, central=central, fresh=True, way=way, region=region)
        )

    def _doubted(self, function: ResidualFunction, state: State) -> State:
        """Measure the simulation noise; restart with suitable difference steps if larger."""
        noise, larger = function.measure_noise(state.theta, state.residual, _doubtful_steps(function, state))
        stagnation = replace(
            state.stagnation,
            steps=0,
            doubted=True,
            patience=2 * state.stagnation.patience,
            seen_noise=(noise, state.square),
        )
        state = replace(state, stagnation=stagnation)
        if not larger:
            return state
        # column lengths that were noise are no scale
        linear = replace(state.model, lengths=np.zeros(state.theta.size))
        state = replace(state, linear=linear, region=state.region.reopened(fully=False))
        state = self._renewed(function, state, central=True)
        first = self.settings.first_radius * state.model.length(function.magnitudes(state.theta))
        stagnation = Stagnation(state.square, state.square, seen_noise=stagnation.seen_noise)
        return replace(state, region=TrustRegion.of(first), stagnation=stagnation)

    # --- the end

    def _measured(self, function: ResidualFunction, state: State, newton: Step) -> State:
        """Update distance and convergence rate."""
        offset = math.sqrt(max(newton.predicted, 0.0) * state.free / state.square) if state.square > 0 else 0.0
        change = float(np.max(np.abs(newton.step) / function.magnitudes(state.theta)))
        way = replace(state.way, predicted=newton.predicted, offset=offset, change=change)
        state = replace(state, way=way)
        if not state.fresh:
            return state
        good = state.central or (_close(function, state, offset) and self._suffices(function, state))
        accurate = not state.borrowed and good
        near = accurate and offset <= STOPPING.near
        rate = min(offset / way.previous_offset, 1.0) if 0.0 < way.previous_offset < math.inf else way.rate
        way = replace(way, fresh_offset=offset, fresh_change=change, rate=rate, accurate=accurate, near=near)
        return replace(state, way=way)

    def _ended(self, function: ResidualFunction, state: State) -> TerminationReason | None:
        """Return the termination reason, if any."""
        way, region, noise = state.way, state.region, _noise(function, state)
        offset, change = state.remaining()
        if self.rough and offset <= max(STOPPING.rough_offset, math.sqrt(STOPPING.rough_change * state.free)):
            return TerminationReason.CONVERGED
        if way.accurate and offset <= STOPPING.offset and change <= self.settings.tolerance:
            return TerminationReason.CONVERGED
        if way.accurate and way.predicted <= noise:
            settled = state.fresh and way.offset > STOPPING.settled_ratio * way.previous_offset
            if settled or offset <= STOPPING.noise_margin * _offset_noise(function, state):
                near = way.offset <= STOPPING.near
                return TerminationReason.CONVERGED if near else TerminationReason.ACCURACY
        drowned = way.predicted <= REGION.noise_surprise * noise
        if state.stagnation.in_vain(_worthless(function, state)):
            little = way.offset <= STAGNATION.offset or drowned
            return TerminationReason.ACCURACY if little else TerminationReason.STALLED
        if region.failures >= STOPPING.hopeless_failures:
            return TerminationReason.FAILING
        if region.rejections > STOPPING.suspicious_rejections and state.central and way.near:
            return TerminationReason.CONVERGED
        size = state.model.length(function.magnitudes(state.theta))
        if state.central and region.rejections and region.value <= STOPPING.vanishing_step * size:
            return TerminationReason.ACCURACY if drowned else TerminationReason.STALLED
        if (np.abs(state.theta) > STOPPING.runaway_growth * state.gained[0]).any():
            return TerminationReason.RUNAWAY
        return TerminationReason.ITERATION_LIMIT if state.iterations >= self.settings.max_iterations else None


def iterate(search: Descent, function: ResidualFunction, state: State) -> Iterator[State]:
    """Yield all states from a given one on; the last has an outcome."""
    state = search.begin(function, state)
    yield state
    while state.outcome is None:
        state = search.advance(function, state)
        yield state


def last_state(search: Descent, function: ResidualFunction, state: State) -> State:
    """Optimize from a state; return the last one."""
    for each in iterate(search, function, state):
        state = each
    return state


def _linearized(function: ResidualFunction, state: State) -> State:
    """Reduce the Jacobian to a triangle; update D and the singular-value limit."""
    reduced = triangle(state.jacobian, state.residual)
    columns = np.linalg.norm(reduced[:, :-1], axis=0)
    unit = 1.0 / function.magnitudes(state.theta)
    before = np.zeros(unit.size) if state.linear is None else state.linear.lengths
    lengths = np.maximum(before, np.where(columns > 0, columns, unit))
    u, singular, vt = np.linalg.svd(reduced[:, :-1] / lengths, full_matrices=False)
    rounding = np.finfo(float).eps * max(state.jacobian.shape) * float(singular[0])
    least = max(_error(function, state, lengths, central=state.central), rounding)
    return replace(state, linear=LinearModel(reduced, lengths, least, (u, singular, vt)))


def _error(function: ResidualFunction, state: State, lengths: Floats, *, central: bool) -> float:
    """Return the largest singular value of J D⁻¹ from errors alone."""
    errors = function.jacobian_error(state.theta, state.residual, central=central)
    relative = errors / lengths
    return math.sqrt(float(relative @ relative))


def _close(function: ResidualFunction, state: State, offset: float) -> bool:
    """Return True if the optimum is near, or hidden by noise."""
    return offset <= STOPPING.near or state.way.predicted <= _noise(function, state)


# --- one step


def _stepped(function: ResidualFunction, state: State, newton: Step) -> State:
    """Try a step; accept it if good."""
    state = replace(state, iterations=state.iterations + 1)
    step, theta, residual = _tried(function, state, newton)
    square, length = square_of(residual), state.model.length(step.step)
    if math.isfinite(square):
        reduced = state.model.reduced
        slope = float(reduced[:, -1] @ (reduced[:, :-1] @ step.step))
        moved = bool((theta != state.theta).any())
        fall, noise = state.square - square, _noise(function, state)
        region, accepted = state.region.judged(step, length, fall, slope, noise, moved=moved)
    else:
        region, accepted = state.region.failed(length), False
    state = replace(state, region=region)
    state = replace(state, last=_record(function, state, theta, square, step.damping, accepted=accepted))
    predicted = state.way.predicted
    if accepted:
        state = _moved(state, theta, residual, square)
    if not region.failures:
        worth = max(_worthless(function, state), STAGNATION.slow_share * predicted)
        state = replace(state, stagnation=state.stagnation.after(step.predicted, state.square, worth))
    return state


def _tried(function: ResidualFunction, state: State, newton: Step) -> tuple[Step, Floats, Floats]:
    """Simulate the step, or several after failures; return the best."""
    linear, region = state.model, state.region
    low, high = function.lower - state.theta, function.upper - state.theta
    within = linear.length(newton.step) <= region.value
    steps = [newton if within else linear.step(low, high, region.value)]
    if region.failures >= STOPPING.edge_failures:
        for i in range(low.size):
            held = np.arange(low.size) == i
            step = linear.step(np.where(held, 0.0, low), np.where(held, 0.0, high), region.open)
            steps += [step] if step.step.any() else []
    moves = np.array([step.step for step in steps])
    thetas = np.clip(state.theta + moves, function.lower, function.upper)
    residuals = function.residuals(thetas)
    squares = np.array([square_of(residual) for residual in residuals])
    best = int(np.argmin(np.where(np.isfinite(squares), squares, np.inf)))
    return steps[best], thetas[best], residuals[best]


def _moved(state: State, theta: Floats, residual: Floats, square: float) -> State:
    linear, (largest, cost) = state.model, state.gained
    if state.way.near:
        linear = replace(linear, reduced=triangle(state.jacobian, residual))
    if cost - square > min(1.0 / state.free, STOPPING.runaway_gain) * cost:
        largest, cost = np.maximum(largest, np.abs(theta)), square
    return replace(state, theta=theta, residual=residual, fresh=False, linear=linear, gained=(largest, cost))


def _doubtful_steps(function: ResidualFunction, state: State) -> Floats:
    """Return steps (N,) for the noise measurement, along the weakest direction."""
    magnitudes = function.magnitudes(state.theta)
    _, values, directions = np.linalg.svd(state.model.reduced[:, :-1] * magnitudes)
    way = math.sqrt(state.square / state.free) * max(1.0, state.way.offset)
    widest, closest = STAGNATION.widest_noise, STAGNATION.closest_noise
    share = max(way / values[-1], closest) if way < widest * values[-1] else widest
    return np.asarray(share * magnitudes * directions[-1])


# --- numbers


def _noise(function: ResidualFunction, state: State) -> float:
    """Return the standard deviation of ‖r‖² from simulation noise."""
    noise, (seen, square) = function.noise, state.stagnation.seen_noise
    by_simulation = 2.0 * noise * math.sqrt(state.square) + state.residual.size * noise**2
    return max(by_simulation, state.region.learnt_noise, seen * math.sqrt(state.square / square))


def _offset_noise(function: ResidualFunction, state: State) -> float:
    """Return the relative offset from simulation noise alone."""
    count, square = state.theta.size, state.square
    return function.noise * math.sqrt(count * state.free / square) if square > 0 else math.inf


def _worthless(function: ResidualFunction, state: State) -> float:
    """Return the largest cost reduction that is no gain."""
    return max(_noise(function, state), STAGNATION.worthless_share * state.square / state.free)


def _record(
    function: ResidualFunction, state: State, theta: Floats, criterion: float, damping: float, *, accepted: bool
) -> Iteration:
    moved = (theta - state.theta) / function.magnitudes(state.theta)
    step = math.hypot(*moved.tolist())
    return Iteration(state.iterations, criterion, damping, accepted, theta, step, state.way.offset, state.central)
