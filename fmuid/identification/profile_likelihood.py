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
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import ActiveBound, CostFunction, LeastSquares, Result, TerminationReason, check_level
from fmuid.events import ProfileStep, Progress
from fmuid.identification.conditional_optimum import ConditionalOptimum, best_near, best_with, evaluator_of


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
        The interval: infinite on a flat or failing side, the bound where it ends there, NaN without interval.
    minimum, threshold : float
        J_min, and the rise above it at the ends of the interval.
    remarks : tuple of ProfileEndNote
        Empty for an ordinary profile.
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
    evaluator = evaluator_of(problem, result)
    check_level(level)
    listed = problem.parameters.names if names is None else names
    chosen = [problem.parameters.index(name) for name in dict.fromkeys(listed)]
    function, origin = best_near(evaluator, result)
    far, scatter = reach(problem, result), _scatter(problem, result)
    thresholds, bends = result.estimates.reaches(level) ** 2 * scatter, result.std / np.sqrt(scatter)
    found: list[Profile] = []
    for k, i in enumerate(chosen):
        std, bend, end, threshold = (float(each[i]) for each in (result.std, bends, far, thresholds))
        found.append(_Profiler(function, origin, i, std, bend, end, threshold, level, k / len(chosen), progress).run())
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
    parameters = problem.parameters
    std = np.where(np.isfinite(result.std), result.std, 0.0)
    return np.maximum(
        SETTINGS.flat_magnitudes * np.maximum(np.abs(result.values), parameters.scale), SETTINGS.flat_stds * std
    )


@dataclass(eq=False)
class _Side:
    """One side of a profile, with its points in order."""

    points: list[ConditionalOptimum]
    upper: bool
    end: float = math.nan
    remarks: list[ProfileEndNote] = field(default_factory=list)
    lost: bool = False
    doubtful: bool = False


@dataclass(frozen=True, eq=False)
class _Profiler:
    """Walk along one profile; beyond `far` a side is flat."""

    function: CostFunction
    origin: ConditionalOptimum
    index: int
    std: float
    bend: float
    far: float
    threshold: float
    level: float
    share: float
    progress: Progress | None

    @property
    def names(self) -> tuple[str, ...]:
        return self.function.problem.parameters.names

    def run(self) -> Profile:
        sides, interrupted = [_Side([], upper=False), _Side([], upper=True)], False
        try:
            for side, direction in zip(sides, (-1.0, 1.0), strict=True):
                self._walk(side, direction)
        except KeyboardInterrupt:
            interrupted = True
        is_lost = any(side.lost for side in sides)
        lower, upper = (math.nan if is_lost else side.end for side in sides)
        points = sorted([*sides[0].points, self.origin, *sides[1].points], key=self._value)
        table = pd.DataFrame([point.theta for point in points], columns=list(self.names))
        table["cost"] = [point.cost for point in points]
        return Profile(
            name=self.names[self.index],
            value=self._value(self.origin),
            std=self.std,
            bend=self.bend,
            level=self.level,
            lower=lower,
            upper=upper,
            minimum=self.origin.cost,
            threshold=self.threshold,
            remarks=tuple(remark for side in sides for remark in side.remarks),
            interrupted=interrupted,
            table=table,
        )

    def _walk(self, side: _Side, direction: float) -> None:
        """Step away from the estimate to the level or a bound."""
        lower, upper = (float(each[self.index]) for each in (self.function.lower, self.function.upper))
        bound = upper if direction > 0 else lower
        here, step = self.origin, self._first_step()
        while True:
            value, point, kind = self._value(here), None, EndKind.FLAT
            if value == bound:
                side.end, kind = bound, EndKind.BOUND
            elif abs(value - self._value(self.origin)) >= self.far:
                side.end = direction * math.inf
            else:
                point = self._next(here, value, direction * step, bound)
                if point is None:
                    side.end, kind = direction * math.inf, EndKind.FAILING
            if point is None:
                self._remark(side, kind, here)
                return
            self._keep(side, point)
            if self._rise(point) < -SETTINGS.lower_optimum_share * self.threshold:
                side.lost = True
                self._remark(side, EndKind.LOWER, point)
                return
            if self._rise(point) >= self.threshold:
                side.end = min(max(self._refine(side, here, point), lower), upper)
                last = side.points[-1]
                for i in last.at_bounds:
                    other = ActiveBound(self.names[i], float(last.theta[i]))
                    self._remark(side, EndKind.OTHER_AT_BOUND, last, other=other)
                return
            # the step asked for: shortened ones would come ever nearer to where simulations fail
            here, step = point, self._next_step(point, step)

    def _keep(self, side: _Side, point: ConditionalOptimum) -> None:
        side.points.append(point)
        if not point.outcome.converged and not side.doubtful:
            side.doubtful = True
            self._remark(side, EndKind.NOT_CONVERGED, point, outcome=point.outcome)
        if self.progress is not None:
            name, value, rise = self.names[self.index], self._value(point), self._rise(point)
            self.progress(ProfileStep(share=self.share, name=name, value=value, rise=rise, threshold=self.threshold))

    def _first_step(self) -> float:
        magnitude = float(self.function.magnitudes(self.origin.theta)[self.index])
        wanted = min(
            math.sqrt(self.threshold) * self.bend / SETTINGS.steps_per_side, SETTINGS.first_step_share * magnitude
        )
        return max(wanted, SETTINGS.least_step_share * magnitude)

    def _next_step(self, point: ConditionalOptimum, last: float) -> float:
        """Return the step for the next rise of τ, limited."""
        slope, level = self._slope(point), math.sqrt(self.threshold)
        usable = slope > 0 and self._root(point) > SETTINGS.least_root_share * level
        wanted = level / SETTINGS.steps_per_side / slope if usable else math.inf
        return min(max(wanted, SETTINGS.step_reduction * last), SETTINGS.largest_growth * last)

    def _next(self, here: ConditionalOptimum, value: float, step: float, bound: float) -> ConditionalOptimum | None:
        """Return the next point, nearer after failures; None if all fail."""
        for _ in range(SETTINGS.most_reductions):
            there = value + step
            there = bound if (there - bound) * step > 0 else there
            point = best_with(self.function, self.index, there, here)
            if point is not None:
                return point
            step *= SETTINGS.step_reduction
        return None

    def _refine(self, side: _Side, inside: ConditionalOptimum, outside: ConditionalOptimum) -> float:
        """Return the end between two points, by Newton's method or bisection."""
        level = math.sqrt(self.threshold)
        low, high, near = inside, outside, outside
        for _ in range(SETTINGS.end_steps):
            value = self._newton(near, level)
            if abs(self._root(near) - level) <= SETTINGS.end_tolerance * level:
                return value
            a, b = sorted((self._value(low), self._value(high)))
            if not a < value < b:
                value = 0.5 * (a + b)
            point = best_with(self.function, self.index, value, near)
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

    def _remark(self, side: _Side, kind: EndKind, point: ConditionalOptimum, **more: Any) -> None:
        side.remarks.append(ProfileEndNote(kind, side.upper, self._value(point), self._rise(point), **more))

    def _value(self, point: ConditionalOptimum) -> float:
        return float(point.theta[self.index])

    def _rise(self, point: ConditionalOptimum) -> float:
        return point.cost - self.origin.cost

    def _root(self, point: ConditionalOptimum) -> float:
        return math.sqrt(max(self._rise(point), 0.0))

    def _slope(self, point: ConditionalOptimum) -> float:
        """Return the slope of τ away from the estimate, dJ_p/dψ/(2τ)."""
        away = math.copysign(1.0, self._value(point) - self._value(self.origin))
        root = self._root(point)
        return away * float(point.jacobian[:, self.index] @ point.residual) / root if root > 0 else 0.0
