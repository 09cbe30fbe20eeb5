"""Profile likelihoods: intervals of one parameter with the best values of all others.

J_p(ψ) = min J_C over the others (1.37). The interval ends where J_p exceeds its least value by the quantile t² or z²,
times std²/c² for colored noise and robust losses (Kent, Biometrika 69, 1982; c: curvature of J_C). Steps and ends are
found on the signed root τ = ±√(J_p − J_min), nearly a straight line; its slope needs no simulation, since
dJ_p/dψ = 2 (∂r/∂ψ)ᵀ r at the optimum of the others (Bates and Watts, "Nonlinear Regression", 1988, section 6.1.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import ActiveBound, CostFunction, LeastSquares, Result, TerminationReason, check_level
from fmuid.events import ProfileStep, Progress
from fmuid.identification.acquisition_delay import delayed
from fmuid.identification.conditional_optimum import ConditionalOptimum, best_near, best_with


@dataclass(frozen=True)
class ProfileSettings:
    """Numbers of the walk along a profile."""

    steps_per_side: int = 4  # about so many, equal in τ
    first_step_share: float = 0.5  # longest first step, relative to the parameter's magnitude, ...
    least_step_share: float = 1e-12  # ... and shortest
    largest_growth: float = 2.0  # of a step over the one before, where the profile is flatter than expected
    flat_magnitudes: float = 1000.0  # distance from the estimate, in magnitudes ...
    flat_stds: float = 10.0  # ... and σ, beyond which a side without end is flat
    least_root_share: float = 0.03  # of the level; below, τ is too small for its slope to be used
    step_reduction: float = 0.25  # factor after a failed simulation, ...
    most_reductions: int = 4  # ... at most so many times
    end_tolerance: float = 1e-3  # relative, of τ; one more Newton step leaves its square
    end_steps: int = 12  # to an end at most
    lower_optimum_share: float = 0.01  # of the quantile; a cost lower by more shows a better optimum


SETTINGS = ProfileSettings()


class EndKind(Enum):
    """Events at an end of a profile."""

    BOUND = "bound"  # the parameter's own bound
    FLAT = "flat"  # no end: the cost does not rise
    FAILING = "failing"  # unknown: simulations fail beyond
    NOT_CONVERGED = "not_converged"  # a search for the other parameters did not converge
    IMPRECISE = "imprecise"  # of low precision
    LOWER = "lower"  # no end: the cost is lower than at the estimate
    OTHER_AT_BOUND = "other_at_bound"  # another parameter is at its bound


@dataclass(frozen=True)
class ProfileEndNote:
    """A note on one end of a profile.

    Attributes
    ----------
    kind : EndKind
    upper : bool
        Which end.
    value, rise : float
        Parameter value there, and the cost above its least value.
    outcome : TerminationReason or None
        Of the search for the others, where it did not converge.
    other : ActiveBound or None
        The other parameter at its bound.
    """

    kind: EndKind
    upper: bool
    value: float
    rise: float
    outcome: TerminationReason | None = None
    other: ActiveBound | None = None


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile of one parameter.

    Attributes
    ----------
    name : str
    value, std : float
        Estimate and its local standard deviation.
    bend : float
        The standard deviation by the curvature of the cost; `std` for white noise.
    level : float
        Confidence level of the interval.
    lower, upper : float
        The interval: infinite on a flat or failing side, NaN without interval.
    minimum, threshold : float
        J_min, and the rise above it at the ends of the interval.
    remarks : tuple of ProfileEndNote
    interrupted : bool
    table : DataFrame
        The points by the parameter's value: all parameters, and ``cost``.
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
        """Values of the parameter (n,)."""
        return self.table[self.name].to_numpy(np.float64)

    @property
    def cost(self) -> Floats:
        """Least cost at each of them (n,)."""
        return self.table["cost"].to_numpy(np.float64)


@single_threaded
def profile_likelihood(
    problem: LeastSquares,
    result: Result,
    names: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    progress: Progress | None = None,
) -> tuple[Profile, ...]:
    """Compute profile likelihoods around a result, with its noise variances.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    names : sequence of str, optional
        Parameters; default all.
    level : float
        Confidence level, between 0 and 1.
    progress : callable, optional
        Called with a `fmuid.events.ProfileStep` after every point.

    Returns
    -------
    tuple of Profile
        After an interruption those so far, the last one `interrupted`.

    Raises
    ------
    InputError
        If the result is of another problem or a robust one read from a file, or a name or the level is wrong.
    SimulationError
        If the simulation fails at the result.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> [profile.name for profile in fmuid.profile_likelihood(problem, result, ["R"])]
    ['R']
    """
    listed = result.names if names is None else names
    check_level(level)
    evaluator, result = delayed(problem, result)
    problem = evaluator.problem
    chosen = [problem.parameters.index(name) for name in dict.fromkeys(listed)]
    function, origin = best_near(evaluator, result)
    far, scatter = reach(problem, result), _scatter(problem, result)
    thresholds, bends = result.estimates.reaches(level) ** 2 * scatter, result.std / np.sqrt(scatter)
    found: list[Profile] = []
    for k, i in enumerate(chosen):
        std, bend, end, threshold = (float(each[i]) for each in (result.std, bends, far, thresholds))
        walk = _Profiler(function, i, origin, bend, end, threshold, k / len(chosen), progress)
        found.append(walk.profile(std, level))
        if found[-1].interrupted:
            break
    return tuple(found)


def _scatter(problem: LeastSquares, result: Result) -> Floats:
    """Return std²/c² of each parameter (N,), 1 where unknown."""
    if problem.loss is None:
        bend = result.estimates.std_white_noise**2
    elif result.fit.linearization is not None:
        bend = np.sum(result.fit.linearization.root**2, axis=1)
    else:
        raise InputError("a result with robust loss from a file has no profile. Identify the study again.")
    known = np.isfinite(result.std) & np.isfinite(bend) & (bend > 0)
    return np.asarray(np.divide(result.std**2, bend, out=np.ones(len(result.names)), where=known), dtype=np.float64)


def reach(problem: LeastSquares, result: Result) -> Floats:
    """Return the distance of flat sides from each estimate (N,)."""
    std = np.where(np.isfinite(result.std), result.std, 0.0)
    magnitudes = np.maximum(np.abs(result.values), problem.parameters.scale)
    return np.maximum(SETTINGS.flat_magnitudes * magnitudes, SETTINGS.flat_stds * std)


class _Point(NamedTuple):
    """A value of the parameter with the best others; J_p − J_min, τ and dτ/dψ away from the estimate."""

    optimum: ConditionalOptimum
    value: float
    rise: float
    root: float = 0.0
    slope: float = 0.0


@dataclass(eq=False)
class _Side:
    """One side of a profile, with its points in order."""

    upper: bool
    end: float = math.nan
    points: list[_Point] = field(default_factory=list)
    remarks: list[ProfileEndNote] = field(default_factory=list)

    @property
    def direction(self) -> float:
        return 1.0 if self.upper else -1.0

    def has(self, kind: EndKind) -> bool:
        return any(each.kind is kind for each in self.remarks)

    def note(self, kind: EndKind, point: _Point, **more: Any) -> None:
        self.remarks.append(ProfileEndNote(kind, self.upper, point.value, point.rise, **more))


@dataclass(frozen=True, eq=False)
class _Profiler:
    """Walk along one profile; beyond `far` a side is flat."""

    function: CostFunction
    index: int
    origin: ConditionalOptimum
    bend: float
    far: float
    threshold: float
    share: float
    progress: Progress | None

    @property
    def names(self) -> tuple[str, ...]:
        return self.function.problem.parameters.names

    @property
    def level(self) -> float:
        """τ at the ends."""
        return math.sqrt(self.threshold)

    @property
    def start(self) -> _Point:
        return _Point(self.origin, float(self.origin.theta[self.index]), 0.0)

    def profile(self, std: float, level: float) -> Profile:
        start, interrupted = self.start, False
        sides = [_Side(upper=False), _Side(upper=True)]
        try:
            for side in sides:
                self._walk(side)
        except KeyboardInterrupt:
            interrupted = True
        lower, upper = (math.nan if any(each.has(EndKind.LOWER) for each in sides) else side.end for side in sides)
        points = sorted([*sides[0].points, start, *sides[1].points], key=lambda point: point.value)
        table = pd.DataFrame([point.optimum.theta for point in points], columns=list(self.names))
        table["cost"] = [point.optimum.cost for point in points]
        return Profile(
            self.names[self.index],
            start.value,
            std,
            self.bend,
            level,
            lower,
            upper,
            self.origin.cost,
            self.threshold,
            tuple(remark for side in sides for remark in side.remarks),
            interrupted,
            table,
        )

    def _walk(self, side: _Side) -> None:
        """Step away from the estimate to the level or a bound."""
        lower, upper = (float(each[self.index]) for each in (self.function.lower, self.function.upper))
        bound = upper if side.upper else lower
        magnitude, here = float(self.function.magnitudes(self.origin.theta)[self.index]), self.start
        step = min(self.level * self.bend / SETTINGS.steps_per_side, SETTINGS.first_step_share * magnitude)
        step = max(step, SETTINGS.least_step_share * magnitude)
        while True:
            if here.value == bound:
                side.end = bound
                return side.note(EndKind.BOUND, here)
            if abs(here.value - self.start.value) >= self.far:
                side.end = side.direction * math.inf
                return side.note(EndKind.FLAT, here)
            point = self._next(side, here, step, bound)
            if point is None:
                side.end = side.direction * math.inf
                return side.note(EndKind.FAILING, here)
            if point.rise < -SETTINGS.lower_optimum_share * self.threshold:
                return side.note(EndKind.LOWER, point)
            if point.rise >= self.threshold:
                side.end = min(max(self._refine(side, here, point), lower), upper)
                last = side.points[-1]
                for i in last.optimum.at_bounds:
                    other = ActiveBound(self.names[i], float(last.optimum.theta[i]))
                    side.note(EndKind.OTHER_AT_BOUND, last, other=other)
                return None
            # the step asked for: shortened ones would come ever nearer to where simulations fail
            here, step = point, self._next_step(point, step)

    def _at(self, side: _Side, value: float, near: _Point) -> _Point | None:
        """Return the point at a value, found from another one; None where simulations fail."""
        found = best_with(self.function, self.index, value, near.optimum)
        if found is None:
            return None
        value, rise = float(found.theta[self.index]), found.cost - self.origin.cost
        root, away = math.sqrt(max(rise, 0.0)), math.copysign(1.0, value - self.start.value)
        slope = away * float(found.jacobian[:, self.index] @ found.residual) / root if root > 0 else 0.0
        point = _Point(found, value, rise, root, slope)
        side.points.append(point)
        if not found.outcome.converged and not side.has(EndKind.NOT_CONVERGED):
            side.note(EndKind.NOT_CONVERGED, point, outcome=found.outcome)
        if self.progress is not None:
            name, threshold = self.names[self.index], self.threshold
            self.progress(ProfileStep(share=self.share, name=name, value=value, rise=rise, threshold=threshold))
        return point

    def _next_step(self, point: _Point, last: float) -> float:
        """Return the step for the next rise of τ, limited."""
        usable = point.slope > 0 and point.root > SETTINGS.least_root_share * self.level
        wanted = self.level / SETTINGS.steps_per_side / point.slope if usable else math.inf
        return min(max(wanted, SETTINGS.step_reduction * last), SETTINGS.largest_growth * last)

    def _next(self, side: _Side, here: _Point, step: float, bound: float) -> _Point | None:
        """Return the next point, nearer after failures; None if all fail."""
        for _ in range(SETTINGS.most_reductions):
            there = here.value + side.direction * step
            point = self._at(side, min(there, bound) if side.upper else max(there, bound), here)
            if point is not None:
                return point
            step *= SETTINGS.step_reduction
        return None

    def _refine(self, side: _Side, inside: _Point, outside: _Point) -> float:
        """Return the end between two points, by Newton's method or bisection."""
        near = outside
        for _ in range(SETTINGS.end_steps):
            value = near.value + side.direction * (self.level - near.root) / near.slope if near.slope > 0 else math.nan
            if abs(near.root - self.level) <= SETTINGS.end_tolerance * self.level:
                return value
            a, b = sorted((inside.value, outside.value))
            point = self._at(side, value if a < value < b else 0.5 * (a + b), near)
            if point is None:
                break
            inside, outside = (inside, point) if point.rise >= self.threshold else (point, outside)
            near = point
        side.note(EndKind.IMPRECISE, near)
        return near.value
