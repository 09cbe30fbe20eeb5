"""Marquardt's search for the least sum of squares (1.13–1.16), with bounds, for functions that are simulations.

Each step is solved as `fmuid.estimators.steps` says; its length follows the success of the steps before (Moré). What is
particular to simulations: derivatives cost simulations, so that forward differences serve on the way and central ones
at the end; a point that fails is a point refused; and below the noise of the simulation the criterion says nothing
about a step, which is then taken for what its prediction is worth.

References
----------
D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J. SIAM 11 (2), 1963;
J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630, 1978;
D. M. Bates, D. G. Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
Technometrics 23 (2), 1981;
S. Sun, J. Nocedal, "A trust region method for noisy unconstrained optimization", Math. Program. 202, 2023.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fmuid.errors import InputError
from fmuid.estimators.steps import Step, best_step, triangle
from fmuid.sensitivity import SensitivityError

Floats = NDArray[np.float64]

# Most problems need 5 to 20 steps; the most crooked of the NIST reference problems (Bennett5) need several hundred.
MAX_ITERATIONS = 1000
# The search ends where no parameter has more than this share of its magnitude left to go: six digits ...
TOLERANCE = 1e-6
# ... nor, all together, more than this share of their standard deviations.
OFFSET_TOLERANCE = 1e-3
# A rough search, after which the problem will change anyway, ends at this share.
ROUGH_OFFSET = 0.1
# Where so little is left of the way, the Jacobian hardly changes any more: it is made by central differences, and one
# that was made here is good enough for the steps that remain.
NEAR = 0.03
# Where the criterion's fall drowns in the simulation's noise and new Jacobians bring the optimum no nearer than by this
# factor, there is nothing more to be had.
SETTLED = 0.8
# Length of the first step against the parameters themselves, both measured by D.
FIRST_RADIUS = 1.0
# MINPACK's rules for the length of the steps: what counts as success, and what follows from it.
LEAST_GAIN, POOR_GAIN, GOOD_GAIN = 1e-4, 0.25, 0.75
SHRINK_LEAST, SHRINK_MOST, GROW = 0.5, 0.1, 2.0
# After so many rejected steps in a row the forward differences are suspected, and central ones tried.
SUSPICIOUS_REJECTIONS = 6
# After so many failing simulations in a row the search feels its way along the edge of what can be simulated, with one
# parameter after the other held; after this many more it gives up.
EDGE_FAILURES, HOPELESS_FAILURES = 2, 12
# A rejected step that is half as long as the one before should miss its prediction by a quarter as much; where it is
# still more than half, and the optimum near, the miss is the noise of the simulation.
NOISY_MISS = 0.5
# The noise measured at the start is believed within this factor.
NOISE_SURPRISE = 10.0
# A step this short against the parameters changes hardly anything in double precision.
VANISHING_STEP = 1e-13
# The noise that the simulation leaves in the offset is known within about this factor.
NOISE_MARGIN = 3.0


class LeastSquares(Protocol):
    """A residual (n_rows,) as a function of theta (N,); `fmuid.problem.Criterion` is one."""

    @property
    def lower(self) -> Floats:
        """Lower bounds (N,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds (N,)."""

    @property
    def noise(self) -> float:
        """Root mean square of the noise that the residual itself has, that of the simulation."""

    def magnitudes(self, theta: Floats) -> Floats:
        """Return how large each parameter is (N,)."""

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, N), NaN rows where failed."""

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N), by forward or by central differences."""

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N,)."""


class Status(Enum):
    """How a search ended; the text says what to do about it."""

    CONVERGED = "converged"
    NOISE = "converged to the noise of the simulation: make it more accurate (step_size, its tolerance) for more digits"
    ITERATION_LIMIT = "stopped at the iteration limit: raise max_iterations or start nearer"
    STALLED = (
        "stalled: no step lowers the criterion although its slope says so; "
        "make the simulation more accurate (step_size, its tolerance) or start elsewhere"
    )
    FAILING = (
        "stopped at the edge of what can be simulated, every step that would lower the criterion fails: "
        "give bounds that keep the search where the model is sound, or start elsewhere"
    )
    INTERRUPTED = "interrupted: these are the best values so far"

    @property
    def converged(self) -> bool:
        """Whether the point reached is a minimum as far as the simulation can tell."""
        return self in (Status.CONVERGED, Status.NOISE)


@dataclass(frozen=True)
class Marquardt:
    """Settings of the search.

    Parameters
    ----------
    max_iterations : int
        Steps tried, accepted or not.
    tolerance : float
        Where to stop: the largest change that is left for any parameter, relative to its magnitude. What is left must
        be small against the standard deviations too (the relative offset of Bates and Watts, `OFFSET_TOLERANCE`).
    first_radius : float
        Length of the first step relative to the parameters; smaller is more careful.

    Raises
    ------
    InputError
        If a setting is not positive.
    """

    max_iterations: int = MAX_ITERATIONS
    tolerance: float = TOLERANCE
    first_radius: float = FIRST_RADIUS

    def __post_init__(self) -> None:
        for name in ("max_iterations", "tolerance", "first_radius"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(f"the setting {name} of the search must be a positive number, not {value!r}")


@dataclass(frozen=True, eq=False)
class Iteration:
    """One step of the search; the first one, number 0, is the start.

    Attributes
    ----------
    number : int
    criterion : float
        ‖residual‖² at theta, NaN where the simulation failed.
    damping : float
        λ of the step, relative to D² (0: a Gauss–Newton step, NaN at the start).
    accepted : bool
    theta : (N,) array
        The point tried.
    step : float
        Length of the step relative to the parameters' magnitudes.
    offset : float
        What was left of the way before the step, in standard deviations.
    central : bool
        Whether the step came from central differences.
    """

    number: int
    criterion: float
    damping: float
    accepted: bool
    theta: Floats
    step: float
    offset: float
    central: bool


@dataclass(eq=False)
class State:
    """What the search knows; it stays valid when the search is interrupted.

    Attributes
    ----------
    theta, residual : arrays
        The best point and the residual there.
    jacobian : (n_rows, N) array
        The one in use.
    central : bool
        Whether it is by central differences.
    fresh : bool
        Whether it was made at theta.
    iterations : int
        Steps tried so far.
    rate : float
        By which the last Gauss–Newton steps came nearer to the optimum.
    status : Status or None
        How the search ended, None while it has not.
    held : (N,) array of bool
        Parameters on a bound that the criterion would push further out.
    """

    theta: Floats
    residual: Floats
    jacobian: Floats
    central: bool = True
    fresh: bool = True
    iterations: int = 0
    rate: float = 1.0
    status: Status | None = None
    held: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


def search(problem: LeastSquares, state: State, settings: Marquardt, *, rough: bool = False) -> Iterator[Iteration]:
    """Search from a state that has residual and Jacobian; yield every step, and leave the result in the state.

    Parameters
    ----------
    problem : LeastSquares
    state : State
        Changed in place; `status` is set at the end.
    settings : Marquardt
    rough : bool
        End already where a tenth of the standard deviations is left, to go on with a changed problem.

    Yields
    ------
    Iteration
    """
    return _Search(problem, state, settings, rough).run()


class _Search:
    """The loop of `search` and what it remembers from step to step."""

    def __init__(self, problem: LeastSquares, state: State, settings: Marquardt, rough: bool) -> None:
        self.problem, self.state, self.settings, self.rough = problem, state, settings, rough
        self.reduced = triangle(state.jacobian, state.residual)
        self.lengths = self._column_lengths()
        self.radius = settings.first_radius * float(np.linalg.norm(self.lengths * problem.magnitudes(state.theta)))
        self.near = False  # whether the Jacobian was made close to the optimum
        self.rejections, self.failures = 0, 0
        self.open_radius = self.radius  # the last one before simulations began to fail
        self.missed = (0.0, math.inf)  # length of the last rejected step, and by how much it missed its prediction
        self.learnt_noise = 0.0
        self.predicted = math.inf
        self.offset = self.fresh_offset = self.previous_offset = math.inf
        self.change = self.fresh_change = math.inf

    def run(self) -> Iterator[Iteration]:
        state, problem = self.state, self.problem
        yield self._record(state.theta, _square(state.residual), math.nan, accepted=True)
        while True:
            low, high = problem.lower - state.theta, problem.upper - state.theta
            newton = best_step(self.reduced, self.lengths, low, high, least=self._least())
            state.held = newton.held & ((low >= 0) | (high <= 0))
            self._measure(newton)
            state.status = self._ended()
            if state.status is not None:
                return
            if self._outdated():
                self._renew()
                if state.status is not None:
                    return
                continue
            state.iterations += 1
            step, theta, residual = self._try(low, high)
            accepted = self._judge(step, theta, residual)
            record = self._record(theta, _square(residual), step.damping, accepted=accepted)
            if accepted:
                self._move(theta, residual)
            yield record

    def _try(self, low: Floats, high: Floats) -> tuple[Step, Floats, Floats]:
        """Simulate the step, or several where simulations fail; return the best, its theta and residual."""
        least = self._least()
        steps = [best_step(self.reduced, self.lengths, low, high, self.radius, least)]
        if self.failures >= EDGE_FAILURES:
            for i in range(low.size):
                held = np.arange(low.size) == i
                within = np.where(held, 0.0, low), np.where(held, 0.0, high)
                step = best_step(self.reduced, self.lengths, *within, self.open_radius, least)
                steps += [step] if step.step.any() else []
        moves = np.array([step.step for step in steps])
        thetas = np.clip(self.state.theta + moves, self.problem.lower, self.problem.upper)
        residuals = self.problem.residuals(thetas)
        squares = np.einsum("ij,ij->i", residuals, residuals)
        best = int(np.argmin(np.where(np.isfinite(squares), squares, np.inf)))
        return steps[best], thetas[best], residuals[best]

    def _measure(self, newton: Step) -> None:
        """Take note of how far the optimum is and, where the Jacobian is new, of how fast it comes nearer."""
        self.predicted, self.offset = newton.predicted, self._relative_offset(newton.predicted)
        self.change = float(np.max(np.abs(newton.step) / self.problem.magnitudes(self.state.theta)))
        if self.state.fresh:
            self.fresh_offset, self.fresh_change = self.offset, self.change
            self.near = self.state.central and self.offset <= NEAR
            if 0.0 < self.previous_offset < math.inf:
                self.state.rate = min(self.offset / self.previous_offset, 1.0)

    def _remaining(self) -> tuple[float, float]:
        """Return what is left of the way: in standard deviations, and the largest change relative to a magnitude.

        With a Jacobian that was made before the last step, the residual's own curvature is not seen; it is what makes
        Gauss–Newton steps converge linearly, and the rate so far tells how much it leaves.
        """
        if self.state.fresh:
            return self.offset, self.change
        rate = self.state.rate
        return max(self.offset, rate * self.fresh_offset), max(self.change, rate * self.fresh_change)

    def _ended(self) -> Status | None:
        """Decide whether the search is over, before it takes another step."""
        state = self.state
        offset, change = self._remaining()
        if self.rough and offset <= ROUGH_OFFSET:
            return Status.CONVERGED
        usable = state.central and (state.fresh or self.near)
        if usable and offset <= OFFSET_TOLERANCE and change <= self.settings.tolerance:
            return Status.CONVERGED
        if usable and self.predicted <= self._criterion_noise():
            settled = state.fresh and self.offset > SETTLED * self.previous_offset
            if settled or self.offset <= NOISE_MARGIN * self._offset_noise():
                return Status.CONVERGED if self.offset <= NEAR else Status.NOISE
        if self.failures >= HOPELESS_FAILURES:
            return Status.FAILING
        if state.central and self.rejections > SUSPICIOUS_REJECTIONS and self.near:
            return Status.CONVERGED
        size = float(np.linalg.norm(self.lengths * self.problem.magnitudes(state.theta)))
        if state.central and self.rejections and self.radius <= VANISHING_STEP * size:
            return Status.NOISE if self.predicted <= NOISE_SURPRISE * self._criterion_noise() else Status.STALLED
        return Status.ITERATION_LIMIT if state.iterations >= self.settings.max_iterations else None

    def _outdated(self) -> bool:
        """Whether the Jacobian has to be made anew at the best point before the next step."""
        if self.state.fresh:
            # many simulated rejections in a row: forward differences may be what is wrong
            suspicious = self.rejections > SUSPICIOUS_REJECTIONS and not self.failures
            return not self.state.central and (suspicious or self.offset <= OFFSET_TOLERANCE)
        return not self.near or self.rejections > 0 or self._remaining() != (self.offset, self.change)

    def _renew(self) -> None:
        """Make the Jacobian anew: by central differences where that is worth their price."""
        state = self.state
        close = self.offset <= NEAR or self.predicted <= self._criterion_noise()
        central = close or self.rejections > SUSPICIOUS_REJECTIONS
        try:
            jacobian = self.problem.jacobian(state.theta, state.residual, central=central)
        except SensitivityError:
            state.status = Status.FAILING
            return
        if not state.fresh:
            self.previous_offset = self.fresh_offset
        state.jacobian, state.central = jacobian, central
        self.reduced = triangle(jacobian, state.residual)
        if self.state.fresh or self.rejections:  # the step that was refused may be good with the better Jacobian
            self.radius = math.inf if self.near else self.radius / SHRINK_MOST**self.rejections
        self.state.fresh, self.rejections = True, 0
        self.lengths = np.maximum(self.lengths, self._column_lengths())

    def _judge(self, step: Step, theta: Floats, residual: Floats) -> bool:
        """Compare what a step did with what was predicted, set the next radius, and say whether to take it."""
        before, after = _square(self.state.residual), _square(residual)
        length = float(np.linalg.norm(self.lengths * step.step))
        if not math.isfinite(after):
            self.open_radius = self.open_radius if self.failures else self.radius
            self.radius = POOR_GAIN * min(self.radius, length)
            self.rejections, self.failures = self.rejections + 1, self.failures + 1
            return False
        self.failures = 0
        # the noise of both values on both sides (Sun and Nocedal): below it, a step is as good as predicted
        uncertain = 2.0 * self._criterion_noise()
        fall = before - after
        gain = (fall + uncertain) / (step.predicted + uncertain) if step.predicted + uncertain > 0 else 0.0
        if gain <= POOR_GAIN:
            slope = float(self.reduced[:, -1] @ (self.reduced[:, :-1] @ step.step))
            bend = -fall - 2.0 * slope
            least = -slope / bend if bend > 0 else SHRINK_LEAST  # of the parabola along the step
            shrink = min(max(least, SHRINK_MOST), SHRINK_LEAST)
            self.radius = shrink * min(self.radius, length)
        elif gain >= GOOD_GAIN or step.damping == 0.0:
            self.radius = GROW * length
        if gain >= LEAST_GAIN and (theta != self.state.theta).any():
            self.rejections, self.missed = 0, (0.0, math.inf)
            return True
        self._learn_noise(length, abs(fall - step.predicted))
        self.rejections += 1
        return False

    def _learn_noise(self, length: float, miss: float) -> None:
        """Recognise, from steps that are refused at ever shorter lengths, noise that was not seen at the start."""
        shorter, before = length <= self.missed[0] / 2.0, self.missed[1]
        if shorter and NOISY_MISS * before < miss < NOISE_SURPRISE * self._criterion_noise():
            self.learnt_noise = max(self.learnt_noise, miss)
        self.missed = length, miss

    def _move(self, theta: Floats, residual: Floats) -> None:
        self.state.theta, self.state.residual = theta, residual
        self.state.fresh = False
        self.reduced = triangle(self.state.jacobian, residual)

    def _relative_offset(self, predicted: float) -> float:
        """Return sqrt(dof predicted/‖r‖²): the way left in standard deviations of the parameters (Bates and Watts)."""
        square = _square(self.state.residual)
        free = max(self.state.residual.size - self.state.theta.size, 1)
        return math.sqrt(max(predicted, 0.0) * free / square) if square > 0 else 0.0

    def _criterion_noise(self) -> float:
        """Return the standard deviation that the simulation's noise gives to ‖r‖²."""
        noise, residual = self.problem.noise, self.state.residual
        return max(2.0 * noise * math.sqrt(_square(residual)) + residual.size * noise**2, self.learnt_noise)

    def _offset_noise(self) -> float:
        """Return what the simulation's noise alone leaves of the relative offset."""
        square, count = _square(self.state.residual), self.state.theta.size
        free = max(self.state.residual.size - count, 1)
        return self.problem.noise * math.sqrt(count * free / square) if square > 0 else math.inf

    def _least(self) -> float:
        """Return the singular value of R D⁻¹ that errors of the Jacobian alone may make."""
        state = self.state
        errors = self.problem.jacobian_error(state.theta, state.residual, central=state.central)
        return float(np.linalg.norm(errors / self.lengths))

    def _column_lengths(self) -> Floats:
        lengths = np.linalg.norm(self.reduced[:, :-1], axis=0)
        return np.where(lengths > 0, lengths, 1.0 / self.problem.magnitudes(self.state.theta))

    def _record(self, theta: Floats, criterion: float, damping: float, *, accepted: bool) -> Iteration:
        moved = (theta - self.state.theta) / self.problem.magnitudes(self.state.theta)
        return Iteration(
            self.state.iterations,
            criterion,
            damping,
            accepted,
            theta,
            float(np.linalg.norm(moved)),
            self.offset,
            self.state.central,
        )


def _square(residual: Floats) -> float:
    with np.errstate(over="ignore"):  # an overflow is a point to reject
        return float(residual @ residual)
