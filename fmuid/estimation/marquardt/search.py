"""Marquardt's search for the least sum of squares (1.16), with bounds, for functions that are simulations.

Each step is solved as `fmuid.estimation.marquardt.step` says, and its length limited as
`fmuid.estimation.marquardt.trust_region` says. What is particular to simulations: derivatives cost simulations, so that
forward differences serve on the way, and central ones at the end only where forward ones are not accurate enough; a
point that fails is a point refused; and where parameters run away without any gain for the fit, the search says so
instead of following them.

References
----------
D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J. SIAM 11 (2), 1963;
D. M. Bates, D. G. Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
Technometrics 23 (2), 1981.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation.finite_differences import SensitivityError
from fmuid.estimation.marquardt.outcome import TerminationReason
from fmuid.estimation.marquardt.settings import Iteration as Iteration
from fmuid.estimation.marquardt.settings import MarquardtSettings as MarquardtSettings
from fmuid.estimation.marquardt.settings import ResidualFunction
from fmuid.estimation.marquardt.settings import State as State
from fmuid.estimation.marquardt.stagnation import SLOW_SHARE, WORTHLESS_SHARE, Stagnation
from fmuid.estimation.marquardt.step import Step, best_step, triangle
from fmuid.estimation.marquardt.trust_region import NOISE_SURPRISE, TrustRegion

# The search ends where, all together, the parameters have no more than this share of their standard deviations to go.
OFFSET_TOLERANCE = 1e-3
# A rough search, after which other variances of the noise will be taken, ends where the way left changes these by no
# more than this share (it leaves offset²/dof of the sum of squares), or at this share of the standard deviations.
ROUGH_CHANGE, ROUGH_OFFSET = 5e-4, 0.1
# Where so little is left of the way, the Jacobian hardly changes any more: one that was made here is good enough for
# the steps that remain, if its differences are.
NEAR_OFFSET = 0.03
# A Jacobian that was borrowed from a point close by serves no nearer to the optimum than this.
BORROWED_OFFSET = 0.3
# Where the criterion's fall drowns in the simulation's noise and new Jacobians bring the optimum no nearer than by this
# factor, nothing more can be gained.
SETTLED_RATIO = 0.8
# After so many rejected steps in a row the forward differences are suspected, and central ones tried.
SUSPICIOUS_REJECTIONS = 6
# After so many failing simulations in a row the search feels its way along the edge of what can be simulated, with one
# parameter after the other held; after this many more it gives up.
EDGE_FAILURES, HOPELESS_FAILURES = 2, 12
# A search that no longer gains anything has converged where the linear model leaves no more than this share of the
# standard deviations to go: what makes it no better is the simulation, not the way.
IN_VAIN_OFFSET = 0.3
# Where a search is doubted, the simulation's noise is measured as far apart as the way that is left, or one standard
# deviation, along what the data determine least, but no farther than this against the parameters.
WIDEST_NOISE, CLOSEST_NOISE = 3e-3, 1e-9
# A step this short against the parameters changes hardly anything in double precision.
VANISHING_STEP = 1e-13
# The noise that the simulation leaves in the offset is known within about this factor.
NOISE_MARGIN = 3.0
# A parameter runs away where it has grown so many times, and the criterion has fallen meanwhile by less than one
# standard deviation of the parameters is worth, but no more than this share.
RUNAWAY_GROWTH, RUNAWAY_GAIN = 100.0, 0.01

Known: TypeAlias = Callable[[Floats, Floats], Floats | None]


def search(
    problem: ResidualFunction,
    state: State,
    settings: MarquardtSettings,
    *,
    rough: bool = False,
    known: Known | None = None,
) -> Iterator[Iteration]:
    """Search from a state that has residual and Jacobian; yield every step, and leave the result in the state.

    Parameters
    ----------
    problem : ResidualFunction
    state : State
        Changed in place; `outcome` is set at the end.
    settings : MarquardtSettings
    rough : bool
        End already where what is left hardly changes the variances of the noise, to go on with a changed problem.
    known : callable, optional
        Gives for theta (N,) and residual (n_rows,) the Jacobian of a point close by, where one is known. It serves
        far from the optimum; what is not rough converges by Jacobians of its own.
    """
    return _LevenbergMarquardtLoop(problem, state, settings, rough, known).run()


class _LevenbergMarquardtLoop:
    """The loop of `search` and what it remembers from step to step."""

    def __init__(
        self,
        problem: ResidualFunction,
        state: State,
        settings: MarquardtSettings,
        rough: bool,
        known: Known | None,
    ) -> None:
        self.problem, self.state, self.settings, self.rough, self.known = problem, state, settings, rough, known
        self.square = _square(state.residual)
        self.free = max(state.residual.size - state.theta.size, 1)  # degrees of freedom
        self.lengths = np.zeros(state.theta.size)
        self.accurate = False  # whether the Jacobian is good enough to find the optimum by; known near it
        self._linearise()
        self.radius = TrustRegion(settings.first_radius * self._length(problem.magnitudes(state.theta)))
        self.near = False  # whether the Jacobian was made close to the optimum, and is good enough there
        self.predicted = math.inf
        self.offset = self.fresh_offset = self.previous_offset = math.inf
        self.change = self.fresh_change = math.inf
        self.stagnation = Stagnation(self.square)
        self.seen_noise = 0.0, 1.0  # of the criterion, measured where the search was doubted, and the criterion there
        # the largest parameters so far (N,), and the criterion, when the fit last gained anything
        self.grown_from, self.gained_at = problem.magnitudes(state.theta), self.square

    def run(self) -> Iterator[Iteration]:
        """Take steps until the search ends."""
        state = self.state
        yield self._record(state.theta, self.square, math.nan, accepted=True)
        if not state.fresh:
            self._renew()
        while state.outcome is None:
            low, high = self.problem.lower - state.theta, self.problem.upper - state.theta
            newton = best_step(self.reduced, self.lengths, low, high, math.inf, self.least, self.decomposed)
            state.held = newton.held & ((low >= 0) | (high <= 0))
            self._measure(newton)
            state.outcome = self._ended()
            if state.outcome is not None:
                return
            if self._outdated():
                self._renew()
                continue
            if self.stagnation.stuck:
                self._doubt()
                continue
            state.iterations += 1
            step, theta, residual = self._try(newton, low, high)
            square = _square(residual)
            accepted = self._judge(step, theta, square)
            record = self._record(theta, square, step.damping, accepted=accepted)
            if accepted:
                self._move(theta, residual, square)
            self._watch(step)
            yield record
            if accepted and not self.near:
                self._renew_after_step()

    # --- the Jacobian

    def _linearise(self) -> None:
        """Reduce the Jacobian to a triangle, lengthen D, and note what singular values errors alone may make."""
        state = self.state
        self.reduced = state.reduced = triangle(state.jacobian, state.residual)
        columns = np.linalg.norm(self.reduced[:, :-1], axis=0)
        unit = 1.0 / self.problem.magnitudes(state.theta)
        self.lengths = np.maximum(self.lengths, np.where(columns > 0, columns, unit))
        # what its rounding makes of the reduction, too, as in the covariance
        u, self.singular, vt = np.linalg.svd(self.reduced[:, :-1] / self.lengths, full_matrices=False)
        self.decomposed = u, self.singular, vt
        rounding = np.finfo(float).eps * max(state.jacobian.shape) * float(self.singular[0])
        self.least = max(self._error(central=state.central), rounding)

    def _error(self, *, central: bool) -> float:
        """Return the singular value of J D⁻¹ that errors of a Jacobian alone may make."""
        errors = self.problem.jacobian_error(self.state.theta, self.state.residual, central=central)
        relative = errors / self.lengths
        return math.sqrt(float(relative @ relative))

    def _suffices(self) -> bool:
        """Whether forward differences are accurate enough to find the optimum by.

        At worst their errors E lie along the residual. The coordinate of the optimum along the most doubtful direction
        then moves by ‖E D⁻¹‖ ‖r‖/s, s the least singular value of J D⁻¹.
        """
        smallest = float(self.singular[-1])
        error = self._error(central=False)
        if not error < smallest:
            return False
        moved = error / smallest * math.sqrt(self.square)
        unit = float(np.min(self.lengths * self.problem.magnitudes(self.state.theta)))
        return (
            moved <= OFFSET_TOLERANCE * math.sqrt(self.square / self.free)
            and moved <= self.settings.tolerance * unit * smallest
        )

    def _close(self, offset: float) -> bool:
        """Whether the optimum is near, or nearer than the simulation's noise lets see."""
        return offset <= NEAR_OFFSET or self.predicted <= self._criterion_noise()

    def _outdated(self) -> bool:
        """Whether the Jacobian has to be made anew at the best point before the next step."""
        if self.state.borrowed:
            return self.offset <= BORROWED_OFFSET or self.radius.rejections > 0 or self.stagnation.stuck
        if self.state.fresh:
            # many simulated rejections in a row: forward differences may be what is wrong
            suspicious = self.radius.rejections > SUSPICIOUS_REJECTIONS and not self.radius.failures
            close = self.offset <= OFFSET_TOLERANCE or self.predicted <= self._criterion_noise()
            return (suspicious and not self.state.central) or (close and not self.accurate)
        return self.radius.rejections > 0 or self._remaining() != (self.offset, self.change)

    def _renew_after_step(self) -> None:
        if self.state.iterations >= self.settings.max_iterations:
            self.state.outcome = TerminationReason.ITERATION_LIMIT
        else:
            self._renew()

    def _renew(self, *, central: bool = False) -> None:
        """Make the Jacobian anew: by central differences where they are asked for, or needed and worth their price."""
        state = self.state
        close = self._close(self.offset if state.fresh else state.rate * self.fresh_offset)
        central = central or (close and not self._suffices()) or self.radius.rejections > SUSPICIOUS_REJECTIONS
        far = not (central or close or state.fresh or self.radius.rejections)
        jacobian = self.known(state.theta, state.residual) if far and self.known is not None else None
        state.borrowed = jacobian is not None
        try:
            if jacobian is None:
                jacobian = self.problem.jacobian(state.theta, state.residual, central=central)
        except SensitivityError:
            state.outcome = TerminationReason.FAILING
            return
        if not state.fresh:
            self.previous_offset = self.fresh_offset
        if state.fresh or self.radius.rejections:
            self.radius.reopen(fully=self.near)
        state.jacobian, state.reduced, state.central, state.fresh = jacobian, None, central, True
        self._linearise()

    # --- the steps

    def _try(self, newton: Step, low: Floats, high: Floats) -> tuple[Step, Floats, Floats]:
        """Simulate the step, or several where simulations fail; return the best, its theta and residual."""
        within = self._length(newton.step) <= self.radius.value
        linear = self.reduced, self.lengths, low, high, self.radius.value, self.least, self.decomposed
        steps = [newton if within else best_step(*linear)]
        if self.radius.failures >= EDGE_FAILURES:
            for i in range(low.size):
                held = np.arange(low.size) == i
                rest = np.where(held, 0.0, low), np.where(held, 0.0, high)
                step = best_step(self.reduced, self.lengths, *rest, self.radius.open, self.least)
                steps += [step] if step.step.any() else []
        moves = np.array([step.step for step in steps])
        thetas = np.clip(self.state.theta + moves, self.problem.lower, self.problem.upper)
        residuals = self.problem.residuals(thetas)
        squares = np.array([_square(residual) for residual in residuals])
        best = int(np.argmin(np.where(np.isfinite(squares), squares, np.inf)))
        return steps[best], thetas[best], residuals[best]

    def _judge(self, step: Step, theta: Floats, square: float) -> bool:
        """Set the next radius, and say whether to take the step."""
        length = self._length(step.step)
        if not math.isfinite(square):
            self.radius.fail(length)
            return False
        slope = float(self.reduced[:, -1] @ (self.reduced[:, :-1] @ step.step))
        moved = bool((theta != self.state.theta).any())
        return self.radius.judge(step, length, self.square - square, slope, self._criterion_noise(), moved=moved)

    def _move(self, theta: Floats, residual: Floats, square: float) -> None:
        self.state.theta, self.state.residual, self.square = theta, residual, square
        self.state.fresh = False
        if self.near:
            self.reduced = triangle(self.state.jacobian, residual)
        if self.gained_at - square > min(1.0 / self.free, RUNAWAY_GAIN) * self.gained_at:
            self.grown_from, self.gained_at = np.maximum(self.grown_from, np.abs(theta)), square

    # --- the doubt

    def _watch(self, step: Step) -> None:
        """Take note of what the last step has brought."""
        if not self.radius.failures:
            worth = max(self._worthless(), SLOW_SHARE * self.predicted)
            self.stagnation.note(step.predicted, self.square, worth)

    def _doubt(self) -> None:
        """Measure the simulation's noise anew, and begin afresh with steps of differences to match if it is larger."""
        state = self.state
        self.stagnation.doubt()
        noise, larger = self.problem.measure_noise(state.theta, state.residual, self._doubtful_steps())
        self.seen_noise = noise, self.square
        if larger:
            self.lengths = np.zeros(state.theta.size)  # columns that were noise are no measure
            self.radius.reopen(fully=False)
            self._renew(central=True)
            self.radius = TrustRegion(self.settings.first_radius * self._length(self.problem.magnitudes(state.theta)))
            self.stagnation = Stagnation(self.square)

    def _doubtful_steps(self) -> Floats:
        """Return the distance of points (N,) among which noise matters: along what the data determine least."""
        magnitudes = self.problem.magnitudes(self.state.theta)
        _, values, directions = np.linalg.svd(self.reduced[:, :-1] * magnitudes)
        way = math.sqrt(self.square / self.free) * max(1.0, self.offset)
        share = max(way / values[-1], CLOSEST_NOISE) if way < WIDEST_NOISE * values[-1] else WIDEST_NOISE
        return np.asarray(share * magnitudes * directions[-1])

    def _worthless(self) -> float:
        """Return what fall of the criterion is no gain: its noise, or a hundredth of a standard deviation."""
        return max(self._criterion_noise(), WORTHLESS_SHARE * self.square / self.free)

    # --- the end

    def _measure(self, newton: Step) -> None:
        """Take note of how far the optimum is and, where the Jacobian is new, of how fast it comes nearer."""
        self.predicted, self.offset = newton.predicted, self._relative_offset(newton.predicted)
        self.change = float(np.max(np.abs(newton.step) / self.problem.magnitudes(self.state.theta)))
        if self.state.fresh:
            self.fresh_offset, self.fresh_change = self.offset, self.change
            sound = not self.state.borrowed
            self.accurate = sound and (self.state.central or (self._close(self.offset) and self._suffices()))
            self.near = self.accurate and self.offset <= NEAR_OFFSET
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

    def _ended(self) -> TerminationReason | None:
        """Decide whether the search is over, before it takes another step."""
        state, rejections = self.state, self.radius.rejections
        offset, change = self._remaining()
        if self.rough and offset <= max(ROUGH_OFFSET, math.sqrt(ROUGH_CHANGE * self.free)):
            return TerminationReason.CONVERGED
        if self.accurate and offset <= OFFSET_TOLERANCE and change <= self.settings.tolerance:
            return TerminationReason.CONVERGED
        if self.accurate and self.predicted <= self._criterion_noise():
            settled = state.fresh and self.offset > SETTLED_RATIO * self.previous_offset
            if settled or offset <= NOISE_MARGIN * self._offset_noise():
                return TerminationReason.CONVERGED if self.offset <= NEAR_OFFSET else TerminationReason.ACCURACY
        if self._in_vain():
            little = self.offset <= IN_VAIN_OFFSET or self.predicted <= NOISE_SURPRISE * self._criterion_noise()
            return TerminationReason.ACCURACY if little else TerminationReason.STALLED
        if self.radius.failures >= HOPELESS_FAILURES:
            return TerminationReason.FAILING
        if rejections > SUSPICIOUS_REJECTIONS and state.central and self.near:
            return TerminationReason.CONVERGED
        size = self._length(self.problem.magnitudes(state.theta))
        if state.central and rejections and self.radius.value <= VANISHING_STEP * size:
            return (
                TerminationReason.ACCURACY
                if self.predicted <= NOISE_SURPRISE * self._criterion_noise()
                else TerminationReason.STALLED
            )
        if (np.abs(state.theta) > RUNAWAY_GROWTH * self.grown_from).any():
            return TerminationReason.RUNAWAY
        return TerminationReason.ITERATION_LIMIT if state.iterations >= self.settings.max_iterations else None

    def _in_vain(self) -> bool:
        """Whether the search gains nothing although the noise was measured anew."""
        stagnation = self.stagnation
        return stagnation.doubted and stagnation.stuck and stagnation.vain and stagnation.fall <= self._worthless()

    # --- numbers

    def _length(self, step: Floats) -> float:
        scaled = self.lengths * step
        return math.sqrt(float(scaled @ scaled))

    def _relative_offset(self, predicted: float) -> float:
        """Return sqrt(dof predicted/‖r‖²): the way left in standard deviations of the parameters (Bates and Watts)."""
        return math.sqrt(max(predicted, 0.0) * self.free / self.square) if self.square > 0 else 0.0

    def _criterion_noise(self) -> float:
        """Return the standard deviation that the simulation's noise gives to ‖r‖²."""
        noise = self.problem.noise
        by_simulation = 2.0 * noise * math.sqrt(self.square) + self.state.residual.size * noise**2
        noise, square = self.seen_noise
        return max(by_simulation, self.radius.learnt_noise, noise * math.sqrt(self.square / square))

    def _offset_noise(self) -> float:
        """Return what the simulation's noise alone leaves of the relative offset."""
        count = self.state.theta.size
        return self.problem.noise * math.sqrt(count * self.free / self.square) if self.square > 0 else math.inf

    def _record(self, theta: Floats, criterion: float, damping: float, *, accepted: bool) -> Iteration:
        moved = (theta - self.state.theta) / self.problem.magnitudes(self.state.theta)
        return Iteration(
            self.state.iterations,
            criterion,
            damping,
            accepted,
            theta,
            math.hypot(*moved.tolist()),
            self.offset,
            self.state.central,
        )


def _square(residual: Floats) -> float:
    return float(np.vdot(residual, residual))  # without a warning where it overflows: a point to reject
