"""Marquardt's search for the least sum of squares (1.16), with bounds, for functions that are simulations.

Each step is solved, and its length limited, as `fmuid.estimation.search.trust_region` says. What is particular to
simulations: derivatives cost simulations, so that forward differences serve on the way, and central ones at the end
only where forward ones are not accurate enough; a point that fails is a point refused; and where parameters run away
without any gain for the fit, the search says so instead of following them.

References
----------
D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J. SIAM 11 (2), 1963;
D. M. Bates, D. G. Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
Technometrics 23 (2), 1981.
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
from fmuid.estimation.search.stopping import STOPPING, Stagnation, Way
from fmuid.estimation.search.trust_region import REGION, Decomposed, Step, TrustRegion, best_step, triangle

Known: TypeAlias = Callable[[Floats, Floats], Floats | None]


@dataclass(frozen=True)
class MarquardtSettings:
    """The numbers that a search goes by; `fmuid.Marquardt`, which has them, documents them."""

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
    """What the search remembers from step to step.

    Attributes
    ----------
    square : float
        ‖residual‖² at the best point.
    reduced : (N+1, N+1) array
        [R q] of the Jacobian in use and the residual of the best point, as far as that is known.
    lengths : (N,) array
        The diagonal of D.
    decomposed : U, S and Vᵀ
        The singular values of R D⁻¹.
    least : float
        Those up to this one may be errors of the Jacobian alone.
    renewal : "", "at once" or "after a step"
        Whether the Jacobian is to be made anew before the next step.
    seen_noise : float, float
        Of the criterion, measured where the search was doubted, and the criterion there.
    grown_from : (N,) array
        The largest parameters so far when the fit last gained anything, ...
    gained_at : float
        ... and the criterion then.
    """

    square: float
    reduced: Floats
    lengths: Floats
    decomposed: Decomposed
    least: float
    region: TrustRegion
    way: Way
    stagnation: Stagnation
    grown_from: Floats
    gained_at: float
    renewal: str = ""
    seen_noise: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True)
class Descent:
    """Marquardt's search as settings and two functions, for `fmuid.estimation.search.loop.iterate`.

    Parameters
    ----------
    settings : MarquardtSettings
    rough : bool
        End already where what is left hardly changes the variances of the noise, to go on with a changed problem.
    known : callable, optional
        Gives for theta (N,) and residual (n_rows,) the Jacobian of a point close by, where one is known. It serves
        far from the optimum; what is not rough converges by Jacobians of its own.
    """

    settings: MarquardtSettings
    rough: bool = False
    known: Known | None = None

    def begin(self, function: ResidualFunction, state: State) -> State:
        """Return the state from which the search sets out: it has residual and Jacobian."""
        square, magnitudes = _square(state.residual), function.magnitudes(state.theta)
        none = np.zeros(state.theta.size)
        how = TrustRegion(0.0, 0.0), Way(), Stagnation.at(square), magnitudes, square
        memory = _Memory(square, none, none, (none, none, none), 0.0, *how)
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
            newton = best_step(memory.reduced, memory.lengths, low, high, math.inf, memory.least, memory.decomposed)
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
        """Whether forward differences are accurate enough to find the optimum by.

        At worst their errors E lie along the residual. The coordinate of the optimum along the most doubtful direction
        then moves by ‖E D⁻¹‖ ‖r‖/s, s the least singular value of J D⁻¹.
        """
        memory = _of(state)
        smallest = float(memory.decomposed[1][-1])
        error = _error(function, state, memory.lengths, central=False)
        if not error < smallest:
            return False
        moved = error / smallest * math.sqrt(memory.square)
        unit = float(np.min(memory.lengths * function.magnitudes(state.theta)))
        return (
            moved <= STOPPING.offset * math.sqrt(memory.square / _free(state))
            and moved <= self.settings.tolerance * unit * smallest
        )

    def _outdated(self, function: ResidualFunction, state: State) -> bool:
        """Whether the Jacobian has to be made anew at the best point before the next step."""
        memory, way = _of(state), _of(state).way
        if state.borrowed:
            return way.offset <= STOPPING.borrowed or memory.region.rejections > 0 or memory.stagnation.stuck
        if state.fresh:
            # many simulated rejections in a row: forward differences may be what is wrong
            suspicious = memory.region.rejections > STOPPING.suspicious_rejections and not memory.region.failures
            close = way.offset <= STOPPING.offset or way.predicted <= _noise(function, state)
            return (suspicious and not state.central) or (close and not way.accurate)
        return memory.region.rejections > 0 or way.remaining(state) != (way.offset, way.change)

    def _renewed(self, function: ResidualFunction, state: State, *, central: bool = False) -> State:
        """Make the Jacobian anew: by central differences where they are asked for, or needed and worth their price."""
        memory, way, region = _of(state), _of(state).way, _of(state).region
        close = _close(function, state, way.offset if state.fresh else state.rate * way.fresh_offset)
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
        if not state.fresh:
            way = replace(way, previous_offset=way.fresh_offset)
        if state.fresh or region.rejections:
            region = region.reopened(fully=memory.way.near)
        state = replace(state, jacobian=jacobian, central=central, fresh=True)
        return _linearized(function, _with(state, way=way, region=region))

    # --- the steps

    def _stepped(self, function: ResidualFunction, state: State, newton: Step) -> State:
        """Try a step, and move where it is good."""
        state = replace(state, iterations=state.iterations + 1)
        step, theta, residual = _tried(function, state, newton)
        square, memory = _square(residual), _of(state)
        region, accepted = _judged(function, state, step, theta, square)
        state = _with(state, region=region)
        state = replace(state, last=_record(function, state, theta, square, step.damping, accepted=accepted))
        if accepted:
            state = _moved(state, theta, residual, square)
        if not region.failures:
            worth = max(_worthless(function, state), STOPPING.slow_share * memory.way.predicted)
            stagnation = memory.stagnation.after(step.predicted, _of(state).square, worth)
            state = _with(state, stagnation=stagnation)
        return _with(state, renewal="after a step") if accepted and not memory.way.near else state

    # --- the doubt

    def _doubted(self, function: ResidualFunction, state: State) -> State:
        """Measure the simulation's noise anew, and begin afresh with steps of differences to match if it is larger."""
        memory = _of(state)
        noise, larger = function.measure_noise(state.theta, state.residual, _doubtful_steps(function, state))
        state = _with(state, stagnation=memory.stagnation.doubting(), seen_noise=(noise, memory.square))
        if not larger:
            return state
        # columns that were noise are no measure
        state = _with(state, lengths=np.zeros(state.theta.size), region=memory.region.reopened(fully=False))
        state = self._renewed(function, state, central=True)
        first = self.settings.first_radius * _length(_of(state), function.magnitudes(state.theta))
        return _with(state, region=TrustRegion.of(first), stagnation=Stagnation.at(memory.square))

    # --- the end

    def _measured(self, function: ResidualFunction, state: State, newton: Step) -> State:
        """Take note of how far the optimum is and, where the Jacobian is new, of how fast it comes nearer."""
        memory = _of(state)
        offset = _relative_offset(state, newton.predicted)
        change = float(np.max(np.abs(newton.step) / function.magnitudes(state.theta)))
        way = replace(memory.way, predicted=newton.predicted, offset=offset, change=change)
        state = _with(state, way=way)
        if not state.fresh:
            return state
        good = state.central or (_close(function, state, offset) and self._suffices(function, state))
        accurate = not state.borrowed and good
        near = accurate and offset <= STOPPING.near
        way = replace(way, fresh_offset=offset, fresh_change=change, accurate=accurate, near=near)
        if 0.0 < way.previous_offset < math.inf:
            state = replace(state, rate=min(offset / way.previous_offset, 1.0))
        return _with(state, way=way)

    def _ended(self, function: ResidualFunction, state: State) -> TerminationReason | None:
        """Decide whether the search is over, before it takes another step."""
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
                near = way.offset <= STOPPING.near
                return TerminationReason.CONVERGED if near else TerminationReason.ACCURACY
        drowned = way.predicted <= REGION.noise_surprise * noise
        if memory.stagnation.in_vain(_worthless(function, state)):
            little = way.offset <= STOPPING.in_vain_offset or drowned
            return TerminationReason.ACCURACY if little else TerminationReason.STALLED
        if memory.region.failures >= STOPPING.hopeless_failures:
            return TerminationReason.FAILING
        if rejections > STOPPING.suspicious_rejections and state.central and way.near:
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
    """Reduce the Jacobian to a triangle, lengthen D, and note what singular values errors alone may make."""
    memory = _of(state)
    reduced = triangle(state.jacobian, state.residual)
    columns = np.linalg.norm(reduced[:, :-1], axis=0)
    unit = 1.0 / function.magnitudes(state.theta)
    lengths = np.maximum(memory.lengths, np.where(columns > 0, columns, unit))
    # what its rounding makes of the reduction, too, as in the covariance
    u, singular, vt = np.linalg.svd(reduced[:, :-1] / lengths, full_matrices=False)
    rounding = np.finfo(float).eps * max(state.jacobian.shape) * float(singular[0])
    least = max(_error(function, state, lengths, central=state.central), rounding)
    state = _with(state, reduced=reduced, lengths=lengths, decomposed=(u, singular, vt), least=least)
    return replace(state, reduced=reduced)


def _error(function: ResidualFunction, state: State, lengths: Floats, *, central: bool) -> float:
    """Return the singular value of J D⁻¹ that errors of a Jacobian alone may make."""
    errors = function.jacobian_error(state.theta, state.residual, central=central)
    relative = errors / lengths
    return math.sqrt(float(relative @ relative))


def _close(function: ResidualFunction, state: State, offset: float) -> bool:
    """Whether the optimum is near, or nearer than the simulation's noise lets see."""
    return offset <= STOPPING.near or _of(state).way.predicted <= _noise(function, state)


# --- one step


def _tried(function: ResidualFunction, state: State, newton: Step) -> tuple[Step, Floats, Floats]:
    """Simulate the step, or several where simulations fail; return the best, its theta and residual."""
    memory, region = _of(state), _of(state).region
    low, high = function.lower - state.theta, function.upper - state.theta
    within = _length(memory, newton.step) <= region.value
    linear = memory.reduced, memory.lengths, low, high, region.value, memory.least, memory.decomposed
    steps = [newton if within else best_step(*linear)]
    if region.failures >= STOPPING.edge_failures:
        for i in range(low.size):
            held = np.arange(low.size) == i
            rest = np.where(held, 0.0, low), np.where(held, 0.0, high)
            step = best_step(memory.reduced, memory.lengths, *rest, region.open, memory.least)
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
    """Return the next trust region, and whether to take the step."""
    memory = _of(state)
    length = _length(memory, step.step)
    if not math.isfinite(square):
        return memory.region.failed(length), False
    slope = float(memory.reduced[:, -1] @ (memory.reduced[:, :-1] @ step.step))
    moved = bool((theta != state.theta).any())
    return memory.region.judged(step, length, memory.square - square, slope, _noise(function, state), moved=moved)


def _moved(state: State, theta: Floats, residual: Floats, square: float) -> State:
    memory = _of(state)
    if memory.way.near:
        memory = replace(memory, reduced=triangle(state.jacobian, residual))
    if memory.gained_at - square > min(1.0 / _free(state), STOPPING.runaway_gain) * memory.gained_at:
        memory = replace(memory, grown_from=np.maximum(memory.grown_from, np.abs(theta)), gained_at=square)
    memory = replace(memory, square=square)
    return replace(state, theta=theta, residual=residual, fresh=False, memory=memory)


def _doubtful_steps(function: ResidualFunction, state: State) -> Floats:
    """Return the distance of points (N,) among which noise matters: along what the data determine least."""
    memory, magnitudes = _of(state), function.magnitudes(state.theta)
    _, values, directions = np.linalg.svd(memory.reduced[:, :-1] * magnitudes)
    way = math.sqrt(memory.square / _free(state)) * max(1.0, memory.way.offset)
    widest, closest = STOPPING.widest_noise, STOPPING.closest_noise
    share = max(way / values[-1], closest) if way < widest * values[-1] else widest
    return np.asarray(share * magnitudes * directions[-1])


# --- numbers


def _square(residual: Floats) -> float:
    return float(np.vdot(residual, residual))  # without a warning where it overflows: a point to reject


def _free(state: State) -> int:
    """Return the degrees of freedom."""
    return max(state.residual.size - state.theta.size, 1)


def _length(memory: _Memory, step: Floats) -> float:
    scaled = memory.lengths * step
    return math.sqrt(float(scaled @ scaled))


def _relative_offset(state: State, predicted: float) -> float:
    """Return sqrt(dof predicted/‖r‖²): the way left in standard deviations of the parameters (Bates and Watts)."""
    square = _of(state).square
    return math.sqrt(max(predicted, 0.0) * _free(state) / square) if square > 0 else 0.0


def _noise(function: ResidualFunction, state: State) -> float:
    """Return the standard deviation that the simulation's noise gives to ‖r‖²."""
    memory, noise = _of(state), function.noise
    by_simulation = 2.0 * noise * math.sqrt(memory.square) + state.residual.size * noise**2
    noise, square = memory.seen_noise
    return max(by_simulation, memory.region.learnt_noise, noise * math.sqrt(memory.square / square))


def _offset_noise(function: ResidualFunction, state: State) -> float:
    """Return what the simulation's noise alone leaves of the relative offset."""
    count, square = state.theta.size, _of(state).square
    return function.noise * math.sqrt(count * _free(state) / square) if square > 0 else math.inf


def _worthless(function: ResidualFunction, state: State) -> float:
    """Return what fall of the criterion is no gain: its noise, or a hundredth of a standard deviation."""
    return max(_noise(function, state), STOPPING.worthless_share * _of(state).square / _free(state))


def _record(
    function: ResidualFunction, state: State, theta: Floats, criterion: float, damping: float, *, accepted: bool
) -> Iteration:
    moved = (theta - state.theta) / function.magnitudes(state.theta)
    step, offset = math.hypot(*moved.tolist()), _of(state).way.offset
    return Iteration(state.iterations, criterion, damping, accepted, theta, step, offset, state.central)
