"""Levenberg–Marquardt optimization of simulations (1.16) with bounds (docs/method/optimization.md).

Forward differences serve on the way, central ones near the optimum if needed. A failed simulation is a refused step.

References: Marquardt, J. SIAM 11 (2), 1963; Bates and Watts, Technometrics 23 (2), 1981.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.finite_differences import SensitivityError
from fmuid.estimation.search.loop import Iteration, ResidualFunction, State, TerminationReason
from fmuid.estimation.search.stopping import RENEWAL, STAGNATION, STOPPING, Stagnation, Way
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


@dataclass(frozen=True, eq=False)
class _Memory:
    """Private state of the optimization."""

    square: float  # ‖residual‖² at the best point
    linear: LinearModel  # by the Jacobian in use
    region: TrustRegion
    way: Way
    stagnation: Stagnation
    grown_from: Floats  # (N,), largest parameters up to the last gain of the fit ...
    gained_at: float  # ... and the cost then
    renewal: str = ""  # of the Jacobian: "", "at once" or "after a step"
    seen_noise: tuple[float, float] = (0.0, 1.0)  # noise of the cost measured in a doubt, and the cost then


@dataclass(frozen=True)
class Descent:
    """Levenberg–Marquardt method for `fmuid.estimation.search.loop.iterate`.

    Parameters
    ----------
    settings : MarquardtSettings
    rough : bool
        Stop as soon as the noise variances hardly change any more.
    known : callable, optional
        Maps theta (N,) and residual (n_rows,) to a nearby Jacobian, used far from the optimum.
    """

    settings: MarquardtSettings
    rough: bool = False
    known: Known | None = None

    def begin(self, function: ResidualFunction, state: State) -> State:
        """Return the first state."""
        square, magnitudes = _square(state.residual), function.magnitudes(state.theta)
        none = np.zeros(state.theta.size)
        how = TrustRegion(0.0, 0.0), Way(), Stagnation.at(square), magnitudes, square
        memory = _Memory(square, LinearModel(none, none), *how)
        state = _linearized(function, replace(state, memory=memory))
        region = TrustRegion.of(self.settings.first_radius * _length(_of(state), magnitudes))
        state = _with(state, region=region, renewal="" if state.fresh else "at once")
        return replace(state, last=_record(function, state, state.theta, square, math.nan, accepted=True))

    def advance(self, function: ResidualFunction, state: State) -> State:
        """Return the state after one more step, or with an outcome."""
        state = replace(state, last=None)
        if _of(state).renewal == "after a step" and state.iterations >= self.settings.max_iterations:
            return replace(state, outcome=TerminationReason.ITERATION_LIMIT)
        if _of(state).renewal:
            state = self._renewed(function, _with(state, renewal=""))
        while state.outcome is None:
            memory = _of(state)
            low, high = function.lower - state.theta, function.upper - state.theta
            newton = memory.linear.step(low, high)
            state = replace(state, held=newton.held & ((low >= 0) | (high <= 0)))
            state = self._measured(function, state, newton)
            state = replace(state, outcome=self._ended(function, state))
            if state.outcome is not None:
                break
            if self._outdated(function, state):
                state = self._renewed(function, state)
            elif _of(state).stagnation.stuck:
                state = self._doubted(function, state)
            else:
                return self._stepped(function, state, newton)
        return state

    # --- the Jacobian

    def _suffices(self, function: ResidualFunction, state: State) -> bool:
        """Return True if forward differences are accurate enough for the optimum.

        Errors E along the residual move the optimum by ‖E D⁻¹‖ ‖r‖/s, s the least singular value of J D⁻¹.
        """
        memory = _of(state)
        assert memory.linear.decomposed is not None
        smallest = float(memory.linear.decomposed[1][-1])
        error = _error(function, state, memory.linear.lengths, central=False)
        if not error < smallest:
            return False
        moved = error / smallest * math.sqrt(memory.square)
        unit = float(np.min(memory.linear.lengths * function.magnitudes(state.theta)))
        return (
            moved <= STOPPING.offset * math.sqrt(memory.square / _free(state))
            and moved <= self.settings.tolerance * unit * smallest
        )

    def _outdated(self, function: ResidualFunction, state: State) -> bool:
        """Return True if the next step needs a new Jacobian."""
        memory, way = _of(state), _of(state).way
        if state.borrowed:
            return way.offset <= RENEWAL.borrowed or memory.region.rejections > 0 or memory.stagnation.stuck
        if state.fresh:
            # many rejections without failures: suspect forward differences
            suspicious = memory.region.rejections > RENEWAL.suspicious_rejections and not memory.region.failures
            close = way.offset <= STOPPING.offset or way.predicted <= _noise(function, state)
            return (suspicious and not state.central) or (close and not way.accurate)
        return memory.region.rejections > 0 or way.remaining(state) != (way.offset, way.change)

    def _renewed(self, function: ResidualFunction, state: State, *, central: bool = False) -> State:
        """Make the Jacobian anew, by central differences if needed."""
        memory, way, region = _of(state), _of(state).way, _of(state).region
        close = _close(function, state, way.offset if state.fresh else state.rate * way.fresh_offset)
        central = central or (close and not self._suffices(function, state))
        central = central or region.rejections > RENEWAL.suspicious_rejections
        far = not (central or close or state.fresh or region.rejections)
        jacobian = self.known(state.theta, state.residual) if far and self.known is not None else None
        state = replace(state, borrowed=jacobian is not None)
        try:
            if jacobian is None:
                jacobian = function.jacobian(state.theta, state.residual, central=central)
        except SensitivityError:
            return replace(state, outcome=TerminationReason.FAILING)
        if not state.fresh:
            way = replace(way, previous_offset=way.fresh_offset)
        if state.fresh or region.rejections:
            region = region.reopened(fully=memory.way.near)
        state = replace(state, jacobian=jacobian, central=central, fresh=True)
        return _linearized(function, _with(state, way=way, region=region))

    # --- the steps

    def _stepped(self, function: ResidualFunction, state: State, newton: Step) -> State:
        """Try a step; accept it if good."""
        state = replace(state, iterations=state.iterations + 1)
        step, theta, residual = _tried(function, state, newton)
        square, memory = _square(residual), _of(state)
        region, accepted = _judged(function, state, step, theta, square)
        state = _with(state, region=region)
        state = replace(state, last=_record(function, state, theta, square, step.damping, accepted=accepted))
        if accepted:
            state = _moved(state, theta, residual, square)
        if not region.failures:
            worth = max(_worthless(function, state), STAGNATION.slow_share * memory.way.predicted)
            stagnation = memory.stagnation.after(step.predicted, _of(state).square, worth)
            state = _with(state, stagnation=stagnation)
        return _with(state, renewal="after a step") if accepted and not memory.way.near else state

    # --- the doubt

    def _doubted(self, function: ResidualFunction, state: State) -> State:
        """Measure the simulation noise; restart with suitable difference steps if larger."""
        memory = _of(state)
        noise, larger = function.measure_noise(state.theta, state.residual, _doubtful_steps(function, state))
        state = _with(state, stagnation=memory.stagnation.doubting(), seen_noise=(noise, memory.square))
        if not larger:
            return state
        # column lengths that were noise are no scale
        linear = replace(memory.linear, lengths=np.zeros(state.theta.size))
        state = _with(state, linear=linear, region=memory.region.reopened(fully=False))
        state = self._renewed(function, state, central=True)
        first = self.settings.first_radius * _length(_of(state), function.magnitudes(state.theta))
        return _with(state, region=TrustRegion.of(first), stagnation=Stagnation.at(memory.square))

    # --- the end

    def _measured(self, function: ResidualFunction, state: State, newton: Step) -> State:
        """Update distance and convergence rate."""
        memory = _of(state)
        offset = _relative_offset(state, newton.predicted)
        change = float(np.max(np.abs(newton.step) / function.magnitudes(state.theta)))
        way = replace(memory.way, predicted=newton.predicted, offset=offset, change=change)
        state = _with(state, way=way)
        if not state.fresh:
            return state
        good = state.central or (_close(function, state, offset) and self._suffices(function, state))
        accurate = not state.borrowed and good
        near = accurate and offset <= RENEWAL.near
        way = replace(way, fresh_offset=offset, fresh_change=change, accurate=accurate, near=near)
        if 0.0 < way.previous_offset < math.inf:
            state = replace(state, rate=min(offset / way.previous_offset, 1.0))
        return _with(state, way=way)

    def _ended(self, function: ResidualFunction, state: State) -> TerminationReason | None:
        """Return the termination reason, if any."""
        memory, way, noise = _of(state), _of(state).way, _noise(function, state)
        rejections = memory.region.rejections
        offset, change = way.remaining(state)
        if self.rough and offset <= max(STOPPING.rough_offset, math.sqrt(STOPPING.rough_change * _free(state))):
            return TerminationReason.CONVERGED
        if way.accurate and offset <= STOPPING.offset and change <= self.settings.tolerance:
            return TerminationReason.CONVERGED
        if way.accurate and way.predicted <= noise:
            settled = state.fresh and way.offset > STOPPING.settled_ratio * way.previous_offset
            if settled or offset <= STOPPING.noise_margin * _offset_noise(function, state):
                near = way.offset <= RENEWAL.near
                return TerminationReason.CONVERGED if near else TerminationReason.ACCURACY
        drowned = way.predicted <= REGION.noise_surprise * noise
        if memory.stagnation.in_vain(_worthless(function, state)):
            little = way.offset <= STAGNATION.offset or drowned
            return TerminationReason.ACCURACY if little else TerminationReason.STALLED
        if memory.region.failures >= STOPPING.hopeless_failures:
            return TerminationReason.FAILING
        if rejections > RENEWAL.suspicious_rejections and state.central and way.near:
            return TerminationReason.CONVERGED
        size = _length(memory, function.magnitudes(state.theta))
        if state.central and rejections and memory.region.value <= STOPPING.vanishing_step * size:
            return TerminationReason.ACCURACY if drowned else TerminationReason.STALLED
        if (np.abs(state.theta) > STOPPING.runaway_growth * memory.grown_from).any():
            return TerminationReason.RUNAWAY
        return TerminationReason.ITERATION_LIMIT if state.iterations >= self.settings.max_iterations else None


def _of(state: State) -> _Memory:
    assert isinstance(state.memory, _Memory), "of a search that has begun"
    return state.memory


def _with(state: State, **changed: object) -> State:
    return replace(state, memory=replace(_of(state), **changed))  # type: ignore[arg-type]


# --- the linear model


def _linearized(function: ResidualFunction, state: State) -> State:
    """Reduce the Jacobian to a triangle; update D and the singular-value limit."""
    memory = _of(state)
    reduced = triangle(state.jacobian, state.residual)
    columns = np.linalg.norm(reduced[:, :-1], axis=0)
    unit = 1.0 / function.magnitudes(state.theta)
    lengths = np.maximum(memory.linear.lengths, np.where(columns > 0, columns, unit))
    u, singular, vt = np.linalg.svd(reduced[:, :-1] / lengths, full_matrices=False)
    rounding = np.finfo(float).eps * max(state.jacobian.shape) * float(singular[0])
    least = max(_error(function, state, lengths, central=state.central), rounding)
    return replace(_with(state, linear=LinearModel(reduced, lengths, least, (u, singular, vt))), reduced=reduced)


def _error(function: ResidualFunction, state: State, lengths: Floats, *, central: bool) -> float:
    """Return the largest singular value of J D⁻¹ from errors alone."""
    errors = function.jacobian_error(state.theta, state.residual, central=central)
    relative = errors / lengths
    return math.sqrt(float(relative @ relative))


def _close(function: ResidualFunction, state: State, offset: float) -> bool:
    """Return True if the optimum is near, or hidden by noise."""
    return offset <= RENEWAL.near or _of(state).way.predicted <= _noise(function, state)


# --- one step


def _tried(function: ResidualFunction, state: State, newton: Step) -> tuple[Step, Floats, Floats]:
    """Simulate the step, or several after failures; return the best."""
    memory, region = _of(state), _of(state).region
    low, high = function.lower - state.theta, function.upper - state.theta
    within = _length(memory, newton.step) <= region.value
    steps = [newton if within else memory.linear.step(low, high, region.value)]
    if region.failures >= STOPPING.edge_failures:
        for i in range(low.size):
            held = np.arange(low.size) == i
            step = memory.linear.step(np.where(held, 0.0, low), np.where(held, 0.0, high), region.open)
            steps += [step] if step.step.any() else []
    moves = np.array([step.step for step in steps])
    thetas = np.clip(state.theta + moves, function.lower, function.upper)
    residuals = function.residuals(thetas)
    squares = np.array([_square(residual) for residual in residuals])
    best = int(np.argmin(np.where(np.isfinite(squares), squares, np.inf)))
    return steps[best], thetas[best], residuals[best]


def _judged(
    function: ResidualFunction, state: State, step: Step, theta: Floats, square: float
) -> tuple[TrustRegion, bool]:
    """Return the next trust region, and acceptance of the step."""
    memory = _of(state)
    length = _length(memory, step.step)
    if not math.isfinite(square):
        return memory.region.failed(length), False
    slope = float(memory.linear.reduced[:, -1] @ (memory.linear.reduced[:, :-1] @ step.step))
    moved = bool((theta != state.theta).any())
    return memory.region.judged(step, length, memory.square - square, slope, _noise(function, state), moved=moved)


def _moved(state: State, theta: Floats, residual: Floats, square: float) -> State:
    memory = _of(state)
    if memory.way.near:
        memory = replace(memory, linear=replace(memory.linear, reduced=triangle(state.jacobian, residual)))
    if memory.gained_at - square > min(1.0 / _free(state), STOPPING.runaway_gain) * memory.gained_at:
        memory = replace(memory, grown_from=np.maximum(memory.grown_from, np.abs(theta)), gained_at=square)
    memory = replace(memory, square=square)
    return replace(state, theta=theta, residual=residual, fresh=False, memory=memory)


def _doubtful_steps(function: ResidualFunction, state: State) -> Floats:
    """Return steps (N,) for the noise measurement, along the weakest direction."""
    memory, magnitudes = _of(state), function.magnitudes(state.theta)
    _, values, directions = np.linalg.svd(memory.linear.reduced[:, :-1] * magnitudes)
    way = math.sqrt(memory.square / _free(state)) * max(1.0, memory.way.offset)
    widest, closest = STAGNATION.widest_noise, STAGNATION.closest_noise
    share = max(way / values[-1], closest) if way < widest * values[-1] else widest
    return np.asarray(share * magnitudes * directions[-1])


# --- numbers


def _square(residual: Floats) -> float:
    return float(np.vdot(residual, residual))  # without a warning where it overflows: a point to reject


def _free(state: State) -> int:
    return max(state.residual.size - state.theta.size, 1)


def _length(memory: _Memory, step: Floats) -> float:
    scaled = memory.linear.lengths * step
    return math.sqrt(float(scaled @ scaled))


def _relative_offset(state: State, predicted: float) -> float:
    """Return sqrt(dof predicted/‖r‖²), the remaining distance in σ (Bates and Watts)."""
    square = _of(state).square
    return math.sqrt(max(predicted, 0.0) * _free(state) / square) if square > 0 else 0.0


def _noise(function: ResidualFunction, state: State) -> float:
    """Return the standard deviation of ‖r‖² from simulation noise."""
    memory, noise = _of(state), function.noise
    by_simulation = 2.0 * noise * math.sqrt(memory.square) + state.residual.size * noise**2
    noise, square = memory.seen_noise
    return max(by_simulation, memory.region.learnt_noise, noise * math.sqrt(memory.square / square))


def _offset_noise(function: ResidualFunction, state: State) -> float:
    """Return the relative offset from simulation noise alone."""
    count, square = state.theta.size, _of(state).square
    return function.noise * math.sqrt(count * _free(state) / square) if square > 0 else math.inf


def _worthless(function: ResidualFunction, state: State) -> float:
    """Return the largest cost reduction that is no gain."""
    return max(_noise(function, state), STAGNATION.worthless_share * _of(state).square / _free(state))


def _record(
    function: ResidualFunction, state: State, theta: Floats, criterion: float, damping: float, *, accepted: bool
) -> Iteration:
    moved = (theta - state.theta) / function.magnitudes(state.theta)
    step, offset = math.hypot(*moved.tolist()), _of(state).way.offset
    return Iteration(state.iterations, criterion, damping, accepted, theta, step, offset, state.central)
