"""Profile likelihood: intervals of one parameter with the best values of all others.

The profile of a parameter ψ is J_p(ψ) = min J_C over all the others (1.37), the prior's rows included. Its confidence
interval holds every ψ whose criterion exceeds the least one by no more than the quantile: with known variances
χ²₁ = z²; with estimated ones t² of their degrees of freedom, F(1, ν). The criterion takes the noise for white and bends
by 1/c², c² = [H⁻¹]_ψψ, where the estimate scatters by std² (`fmuid.estimation.noise`): the quantile is multiplied by
std²/c² (Kent). For models linear in their parameters, where J_p is the parabola J_min + ((ψ − ψ̂)/c)², the interval is
then the local one, ψ̂ ± t std.

The signed root τ(ψ) = ±√(J_p − J_min) is a straight line in the linear case and nearly one elsewhere, so that steps
and ends are found on it. Its slope needs no simulation: at the optimum of the others dJ_p/dψ = 2 (∂r/∂ψ)ᵀ r.

With a robust loss the criterion is no likelihood either, and the same factor serves (Huber and Ronchetti, "Robust
Statistics", section 13).

References
----------
D. M. Bates, D. G. Watts, "Nonlinear Regression Analysis and Its Applications", Wiley 1988, section 6.1.2 (profile t);
A. Raue et al., "Structural and practical identifiability analysis of partially observed dynamical models by exploiting
the profile likelihood", Bioinformatics 25 (15), 2009 (flat profiles);
J. T. Kent, "Robust properties of likelihood ratio tests", Biometrika 69, 1982.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import ActiveBound, CostFunction, LeastSquares, Result, TerminationReason, check_level
from fmuid.identification.conditional_optimum import ConditionalOptimum, best_near, best_with, evaluator_of
from fmuid.identification.profile_ends import EndKind, ProfileEndNote
from fmuid.progress import ProfileStep, Progress


@dataclass(frozen=True)
class ProfileSettings:
    """Numbers of the walk along a profile."""

    steps_per_side: int = 4
    """Approximate number of steps of a side, equal in τ."""
    first_step_share: float = 0.5
    """Longest first step, relative to the parameter's magnitude, ..."""
    least_step_share: float = 1e-12
    """... and shortest."""
    largest_growth: float = 2.0
    """Where the profile is flatter than expected, each step is at most so many times the one before."""
    flat_magnitudes: float = 1000.0
    """A side that has not reached the level at this distance, in magnitudes ..."""
    flat_stds: float = 10.0
    """... and standard deviations, is flat."""
    least_root_share: float = 0.03
    """Below this share of its level, τ is too small for its slope to be used."""
    step_reduction: float = 0.25
    """Where simulations fail, a step is shortened by this factor, ..."""
    most_reductions: int = 4
    """... at most so many times."""
    end_tolerance: float = 1e-3
    """An end is where τ equals its level to this relative error; one more Newton step then leaves its square."""
    end_steps: int = 12
    """Steps to an end at most."""
    lower_optimum_share: float = 0.01
    """A criterion lower than the least one by more than this share of the quantile shows a better optimum."""


SETTINGS = ProfileSettings()


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one parameter.

    Attributes
    ----------
    name : str
    value : float
        Its estimate, where the criterion is least.
    std : float
        Its local standard deviation, for comparison.
    bend : float
        What the criterion's curvature says of it: c, the same where the noise is white.
    level : float
        Of the interval.
    lower, upper : float
        The interval; infinite on a side that is flat or where it cannot be found, its bound where it ends there, NaN
        where no interval can be given. `remarks` say which.
    minimum, threshold : float
        J_min, and the rise above it at which the interval ends.
    remarks : tuple of ProfileEndNote
        On the ends; empty for an ordinary profile.
    interrupted : bool
        Whether the keyboard ended it before both ends were found.
    table : DataFrame
        The points in the order of the parameter's values: all parameters, and ``criterion``.
    """

    name: str
    value: float
    std: float
    bend: float
    level: float
    lower: float
    upper: float
    minimum: float
    threshold: float
    remarks: tuple[ProfileEndNote, ...]
    interrupted: bool
    table: pd.DataFrame

    json_layout: ClassVar = Layout(omitted={"table"})

    @property
    def values(self) -> Floats:
        """The parameter's values (n,)."""
        return self.table[self.name].to_numpy(np.float64)

    @property
    def criterion(self) -> Floats:
        """The least criterion at each of them (n,)."""
        return self.table["criterion"].to_numpy(np.float64)


@single_threaded
def profile_likelihood(
    problem: LeastSquares,
    result: Result,
    names: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    progress: Progress | None = None,
) -> tuple[Profile, ...]:
    """Profile parameters of a problem around its result, with the result's noise variances.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    names : sequence of str, optional
        Which parameters; default all.
    level : float
        Of the intervals, between 0 and 1.
    progress : callable, optional
        Called with a `fmuid.progress.ProfileStep` after every point.

    Returns
    -------
    tuple of Profile
        One a name. Interrupted from the keyboard: those so far, the last one `interrupted`.

    Raises
    ------
    InputError
        If the result is another problem's, a name is unknown, the level is not between 0 and 1, or a robust problem's
        result was read from a file.
    SimulationError
        If the simulation fails at the result.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> [profile.name for profile in fmuid.profile_likelihood(problem, result, ["R"])]
    ['R']
    """
    evaluator = evaluator_of(problem, result)
    check_level(level)
    listed = problem.parameters.names if names is None else names
    chosen = [problem.parameters.index(name) for name in dict.fromkeys(listed)]
    criterion, origin = best_near(evaluator, result)
    far, scatter = reach(problem, result), _scatter(problem, result)
    thresholds, bends = result.reaches(level) ** 2 * scatter, result.std / np.sqrt(scatter)
    found: list[Profile] = []
    for k, i in enumerate(chosen):
        goal = _Goal(float(result.std[i]), float(bends[i]), float(far[i]), float(thresholds[i]), level)
        profiler = _Profiler(criterion, origin, i, goal, progress, k / len(chosen))
        found.append(profiler.run())
        if profiler.interrupted:
            break
    return tuple(found)


def _scatter(problem: LeastSquares, result: Result) -> Floats:
    """Return std²/c² of each parameter (N,), its variance against what the criterion's curvature says; 1 if unknown."""
    if problem.loss is None:
        bend = result.white_std**2
    elif result.local is not None:
        bend = np.sum(result.local.root**2, axis=1)
    else:
        raise InputError("the result of a robust loss cannot be profiled from its file; identify the study again")
    known = np.isfinite(result.std) & np.isfinite(bend) & (bend > 0)
    return np.asarray(np.divide(result.std**2, bend, out=np.ones(len(result.names)), where=known), dtype=np.float64)


def reach(problem: LeastSquares, result: Result) -> Floats:
    """Return the distance from its estimate up to which each parameter is followed (N,): beyond, it is undetermined."""
    parameters = problem.parameters
    std = np.where(np.isfinite(result.std), result.std, 0.0)
    return np.maximum(
        SETTINGS.flat_magnitudes * np.maximum(np.abs(result.values), parameters.scale), SETTINGS.flat_stds * std
    )


@dataclass(frozen=True)
class _Goal:
    """What is known of a profile before it is walked along, as the fields of `Profile`; `far` ends a flat side."""

    std: float
    bend: float
    far: float
    threshold: float
    level: float


@dataclass(eq=False)
class _Side:
    """One side of a profile: the points in the order in which they were found, the end, and remarks."""

    points: list[ConditionalOptimum]
    upper: bool
    end: float = math.nan
    remarks: list[ProfileEndNote] = field(default_factory=list)
    lost: bool = False
    doubtful: bool = False


class _Profiler:
    """Makes the profile of one parameter."""

    def __init__(
        self,
        criterion: CostFunction,
        origin: ConditionalOptimum,
        index: int,
        goal: _Goal,
        progress: Progress | None,
        share: float,
    ) -> None:
        self.criterion, self.origin, self.index = criterion, origin, index
        self.goal, self.threshold = goal, goal.threshold
        self.progress, self.share = progress, share
        self.names = criterion.problem.parameters.names
        self.name = self.names[index]
        self.magnitude = float(criterion.magnitudes(origin.theta)[index])
        self.interrupted = False

    def run(self) -> Profile:
        sides = [_Side([], upper=False), _Side([], upper=True)]
        try:
            for side, direction in zip(sides, (-1.0, 1.0), strict=True):
                self._walk(side, direction)
        except KeyboardInterrupt:
            self.interrupted = True
        lower, upper = sides[0].end, sides[1].end
        if any(side.lost for side in sides):
            lower = upper = math.nan
        points = sorted([*sides[0].points, self.origin, *sides[1].points], key=self._value)
        table = pd.DataFrame([point.theta for point in points], columns=list(self.names))
        table["criterion"] = [point.criterion for point in points]
        return Profile(
            name=self.name,
            value=self._value(self.origin),
            std=self.goal.std,
            bend=self.goal.bend,
            level=self.goal.level,
            lower=lower,
            upper=upper,
            minimum=self.origin.criterion,
            threshold=self.threshold,
            remarks=tuple(remark for side in sides for remark in side.remarks),
            interrupted=self.interrupted,
            table=table,
        )

    # --- one side

    def _walk(self, side: _Side, direction: float) -> None:
        """Step away from the estimate until the level, a bound, or nowhere is reached."""
        bound = float((self.criterion.upper if direction > 0 else self.criterion.lower)[self.index])
        here, step = self.origin, self._first_step()
        while True:
            value = self._value(here)
            if value == bound:
                side.end = bound
                self._remark(side, EndKind.BOUND, here)
                return
            if abs(value - self._value(self.origin)) >= self.goal.far:
                side.end = direction * math.inf
                self._remark(side, EndKind.FLAT, here)
                return
            point = self._next(here, value, direction * step, bound)
            if point is None:
                side.end = direction * math.inf
                self._remark(side, EndKind.FAILING, here)
                return
            self._keep(side, point)
            if self._rise(point) < -SETTINGS.lower_optimum_share * self.threshold:
                side.lost = True
                self._remark(side, EndKind.LOWER, point)
                return
            if self._rise(point) >= self.threshold:
                end = self._refine(side, here, point)
                side.end = min(max(end, self.criterion.lower[self.index]), self.criterion.upper[self.index])
                self._remark_held(side, side.points[-1])
                return
            # the step asked for: shortened ones would come ever nearer to where simulations fail
            step = self._next_step(point, step)
            here = point

    def _keep(self, side: _Side, point: ConditionalOptimum) -> None:
        side.points.append(point)
        if not point.outcome.converged and not side.doubtful:
            side.doubtful = True
            self._remark(side, EndKind.NOT_CONVERGED, point, outcome=point.outcome)
        if self.progress is not None:
            step = ProfileStep(
                share=self.share,
                name=self.name,
                value=self._value(point),
                rise=self._rise(point),
                threshold=self.threshold,
            )
            self.progress(step)

    def _first_step(self) -> float:
        wanted = min(
            math.sqrt(self.threshold) * self.goal.bend / SETTINGS.steps_per_side,
            SETTINGS.first_step_share * self.magnitude,
        )
        return max(wanted, SETTINGS.least_step_share * self.magnitude)

    def _next_step(self, point: ConditionalOptimum, last: float) -> float:
        """Return the step that raises τ by its share, as its slope says, and not much longer than the last one."""
        slope, level = self._slope(point), math.sqrt(self.threshold)
        usable = slope > 0 and self._root(point) > SETTINGS.least_root_share * level
        wanted = level / SETTINGS.steps_per_side / slope if usable else math.inf
        return min(max(wanted, SETTINGS.step_reduction * last), SETTINGS.largest_growth * last)

    def _next(self, here: ConditionalOptimum, value: float, step: float, bound: float) -> ConditionalOptimum | None:
        """Return the next point, nearer where simulations fail, None where they all do."""
        for _ in range(SETTINGS.most_reductions):
            there = value + step
            there = bound if (there - bound) * step > 0 else there
            point = best_with(self.criterion, self.index, there, here)
            if point is not None:
                return point
            step *= SETTINGS.step_reduction
        return None

    # --- its end

    def _refine(self, side: _Side, inside: ConditionalOptimum, outside: ConditionalOptimum) -> float:
        """Return where τ meets its level between two points: Newton's method, bisection where that leaves them."""
        level = math.sqrt(self.threshold)
        low, high = inside, outside
        near = outside
        for _ in range(SETTINGS.end_steps):
            value = self._newton(near, level)
            if abs(self._root(near) - level) <= SETTINGS.end_tolerance * level:
                return value
            a, b = sorted((self._value(low), self._value(high)))
            if not a < value < b:
                value = 0.5 * (a + b)
            point = best_with(self.criterion, self.index, value, near)
            if point is None:
                break
            self._keep(side, point)
            low, high = (low, point) if self._rise(point) >= self.threshold else (point, high)
            near = point
        self._remark(side, EndKind.IMPRECISE, near)
        return self._value(near)

    def _newton(self, point: ConditionalOptimum, level: float) -> float:
        slope = self._slope(point)
        away = math.copysign(1.0, self._value(point) - self._value(self.origin))
        return self._value(point) + away * (level - self._root(point)) / slope if slope > 0 else math.nan

    # --- remarks

    def _remark(
        self, side: _Side, kind: EndKind, point: ConditionalOptimum, *, outcome: TerminationReason | None = None
    ) -> None:
        side.remarks.append(ProfileEndNote(kind, side.upper, self._value(point), self._rise(point), outcome))

    def _remark_held(self, side: _Side, point: ConditionalOptimum) -> None:
        for i in point.at_bounds:
            other = ActiveBound(self.names[i], float(point.theta[i]))
            value, rise = self._value(point), self._rise(point)
            side.remarks.append(ProfileEndNote(EndKind.OTHER_AT_BOUND, side.upper, value, rise, other=other))

    # --- numbers

    def _value(self, point: ConditionalOptimum) -> float:
        return float(point.theta[self.index])

    def _rise(self, point: ConditionalOptimum) -> float:
        return point.criterion - self.origin.criterion

    def _root(self, point: ConditionalOptimum) -> float:
        return math.sqrt(max(self._rise(point), 0.0))

    def _slope(self, point: ConditionalOptimum) -> float:
        """Return the slope of τ away from the estimate, dJ_p/dψ/(2τ)."""
        away = math.copysign(1.0, self._value(point) - self._value(self.origin))
        root = self._root(point)
        return away * float(point.jacobian[:, self.index] @ point.residual) / root if root > 0 else 0.0
