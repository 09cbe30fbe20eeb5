"""States of an optimization, and thresholds of its termination.

Adaptive integrators and kinks make a Jacobian promise gains that no step brings; `Stagnation` detects this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Protocol

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.estimation.search.trust_region import LinearModel, TrustRegion


class TerminationReason(Enum):
    """Termination reason; the values stand in ``result.json`` as ``outcome``."""

    CONVERGED = "converged"  # at a minimum, within the tolerance
    ACCURACY = "accuracy"  # at a minimum, as far as the simulation's accuracy shows it
    UNDETERMINED = "undetermined"  # a minimum, or a runaway, along directions that are not identifiable
    UNSETTLED = "unsettled"  # all fits converged, but the noise variances still change
    ITERATION_LIMIT = "iteration_limit"  # maximum number of steps
    RUNAWAY = "runaway"  # parameters grew by orders of magnitude without gain
    STALLED = "stalled"  # no step reduces the cost, in spite of its slope
    FAILING = "failing"  # every step that could reduce the cost fails
    INTERRUPTED = "interrupted"  # by the keyboard, at the best values so far

    @property
    def converged(self) -> bool:
        """True at a minimum with all parameters identifiable."""
        return self in (TerminationReason.CONVERGED, TerminationReason.ACCURACY)


@dataclass(frozen=True)
class StoppingSettings:
    """Thresholds of termination and of new Jacobians."""

    offset: float = 1e-3  # σ that all parameters together have to go at the end
    rough_change: float = 5e-4  # a rough search ends where the way left changes the noise variances by no more ...
    rough_offset: float = 0.1  # ... or at this share of σ
    settled_ratio: float = 0.8  # new Jacobians that bring a noisy optimum no nearer than this gain nothing more
    noise_margin: float = 3.0  # within which the noise left in the offset is known
    edge_failures: int = 2  # failures in a row after which the search tries steps with one parameter held
    hopeless_failures: int = 12  # failures in a row after which it gives up
    vanishing_step: float = 1e-13  # relative; changes hardly anything in double precision
    runaway_growth: float = 100.0  # factor by which a parameter grows that runs away ...
    runaway_gain: float = 0.01  # ... while the cost falls by a smaller share
    near: float = 0.03  # σ left where the Jacobian hardly changes any more
    borrowed: float = 0.3  # σ left; a Jacobian from a point close by serves no nearer to the optimum
    suspicious_rejections: int = 6  # in a row, after which forward differences are suspected


@dataclass(frozen=True)
class StagnationSettings:
    """Thresholds of doubt about searches that gain nothing."""

    patient_steps: int = 10  # granted before a search without gain is doubted
    worthless_share: float = 1e-4  # of the worth of one σ: a hundredth of one, squared
    slow_share: float = 1e-2  # of the fall predicted, where it matters whether the linear model can be trusted
    vain_share: float = 0.25  # of the prediction: steps that bring less are useless, not merely slow
    offset: float = 0.3  # σ left where nothing is gained: the simulation limits the accuracy, not the search
    widest_noise: float = 3e-3  # the noise of a doubted search is measured no farther apart, relative ...
    closest_noise: float = 1e-9  # ... and no closer


STOPPING, STAGNATION = StoppingSettings(), StagnationSettings()


class ResidualFunction(Protocol):
    """Residual (n_rows,) as a function of theta (N,); `noise` is the RMS of its simulation noise."""

    lower: Floats
    upper: Floats
    noise: float

    def magnitudes(self, theta: Floats) -> Floats:
        """Return the magnitudes (N,) of the parameters."""

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, N), NaN rows if failed."""

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N), by forward or by central differences."""

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N,)."""

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the noise in steps (N,); return that of ‖residual‖², and growth."""


@dataclass(frozen=True, eq=False)
class Iteration:
    """One step of the optimization; number 0 is the initial guess."""

    number: int
    criterion: float  # cost at theta, NaN if the simulation failed
    damping: float  # λ of the step, relative to D²; 0 for Gauss–Newton, NaN at the initial guess
    accepted: bool
    theta: Floats  # (N,), trial point
    step: float  # length of the step relative to the magnitudes
    offset: float  # remaining distance before the step, σ
    central: bool  # central differences


@dataclass(frozen=True)
class Way:
    """Remaining distance to the optimum, in σ (`offset`) and relative (`change`)."""

    predicted: float = math.inf  # cost reduction that the Gauss–Newton step promises
    offset: float = math.inf
    change: float = math.inf
    fresh_offset: float = math.inf  # with the newest Jacobian, at its own point ...
    fresh_change: float = math.inf
    previous_offset: float = math.inf  # ... and with the one before
    rate: float = 1.0  # convergence rate of the last Gauss–Newton steps
    accurate: bool = False  # the Jacobian suffices to find the optimum
    near: bool = False  # and was made close to it


@dataclass(frozen=True)
class Stagnation:
    """Cost reduction over the last steps."""

    first: float = 0.0  # cost at the last gain
    last: float = 0.0  # cost now
    steps: int = 0  # since the last gain or doubt
    promised: float = 0.0  # cost reduction predicted since the last gain
    patience: int = STAGNATION.patient_steps  # steps without gain before a doubt
    doubted: bool = False
    seen_noise: tuple[float, float] = (0.0, 1.0)  # noise of the cost measured in a doubt, and the cost then

    def after(self, promised: float, square: float, worth: float) -> Stagnation:
        """Return the value after a step."""
        if self.first - square > worth:
            return Stagnation(square, square, patience=self.patience, seen_noise=self.seen_noise)
        return replace(self, steps=self.steps + 1, promised=self.promised + promised, last=square)

    @property
    def stuck(self) -> bool:
        """True if patience is used up without a gain."""
        return self.steps >= self.patience

    def in_vain(self, worthless: float) -> bool:
        """Return True if the search gains nothing in spite of a doubt."""
        fall = self.first - self.last
        return self.doubted and self.stuck and fall < STAGNATION.vain_share * self.promised and fall <= worthless


@dataclass(frozen=True, eq=False)
class State:
    """State of an optimization after a step."""

    theta: Floats  # (N,), best point
    residual: Floats  # (n_rows,), there
    jacobian: Floats  # (n_rows, N), in use
    central: bool = True  # the Jacobian is by central differences
    fresh: bool = True  # the Jacobian belongs to theta
    borrowed: bool = False  # the Jacobian belongs to a neighboring cell center
    iterations: int = 0  # trial steps
    outcome: TerminationReason | None = None  # None before the end
    held: Flags = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))  # (N,), pushed against a bound
    last: Iteration | None = None
    linear: LinearModel | None = None  # by the Jacobian in use; None before the search
    region: TrustRegion = field(default_factory=lambda: TrustRegion.of(0.0))
    way: Way = Way()
    stagnation: Stagnation = Stagnation()
    gained: tuple[Floats, float] = (np.zeros(0), math.inf)  # largest parameters (N,) and cost at the last gain

    @cached_property
    def square(self) -> float:
        """Cost ‖residual‖²."""
        return square_of(self.residual)

    @property
    def free(self) -> int:
        """Degrees of freedom of the residual."""
        return max(self.residual.size - self.theta.size, 1)

    @property
    def model(self) -> LinearModel:
        """Linear model of a search that has begun."""
        assert self.linear is not None
        return self.linear

    def remaining(self) -> tuple[float, float]:
        """Return remaining σ and largest relative change.

        An old Jacobian misses the residual's curvature; the convergence rate so far stands for it.
        """
        way = self.way
        if self.fresh:
            return way.offset, way.change
        return max(way.offset, way.rate * way.fresh_offset), max(way.change, way.rate * way.fresh_change)


def square_of(residual: Floats) -> float:
    """Return ‖residual‖², without a warning if it overflows: a point to reject."""
    return float(np.vdot(residual, residual))
