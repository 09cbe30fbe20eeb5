"""Termination and its thresholds.

Adaptive integrators and kinks make a Jacobian promise gains that no step brings; `Stagnation` detects this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from fmuid.estimation.search.loop import State


@dataclass(frozen=True)
class StoppingSettings:
    """Thresholds of termination."""

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


@dataclass(frozen=True)
class RenewalSettings:
    """Thresholds of new Jacobians."""

    near: float = 0.03  # σ left where the Jacobian hardly changes any more
    borrowed: float = 0.3  # σ left; a Jacobian from a point close by serves no nearer to the optimum
    suspicious_rejections: int = 6  # in a row, after which forward differences are suspected


@dataclass(frozen=True)
class StagnationSettings:
    """Thresholds of doubt, and of searches that gain nothing."""

    patient_steps: int = 10  # granted before a search without gain is doubted
    worthless_share: float = 1e-4  # of the worth of one σ: a hundredth of one, squared
    slow_share: float = 1e-2  # of the fall predicted, where it matters whether the linear model can be trusted
    vain_share: float = 0.25  # of the prediction: steps that bring less are useless, not merely slow
    offset: float = 0.3  # σ left where nothing is gained: the simulation limits the accuracy, not the search
    widest_noise: float = 3e-3  # the noise of a doubted search is measured no farther apart, relative ...
    closest_noise: float = 1e-9  # ... and no closer


STOPPING, RENEWAL, STAGNATION = StoppingSettings(), RenewalSettings(), StagnationSettings()


@dataclass(frozen=True)
class Way:
    """Remaining distance to the optimum, in σ (`offset`) and relative (`change`)."""

    predicted: float = math.inf  # cost reduction that the Gauss–Newton step promises
    offset: float = math.inf
    change: float = math.inf
    fresh_offset: float = math.inf  # with the newest Jacobian, at its own point ...
    fresh_change: float = math.inf
    previous_offset: float = math.inf  # ... and with the one before
    accurate: bool = False  # the Jacobian suffices to find the optimum
    near: bool = False  # and was made close to it

    def remaining(self, state: State) -> tuple[float, float]:
        """Return remaining σ and largest relative change.

        An old Jacobian misses the residual's curvature; the convergence rate so far stands for it.
        """
        if state.fresh:
            return self.offset, self.change
        rate = state.rate
        return max(self.offset, rate * self.fresh_offset), max(self.change, rate * self.fresh_change)


@dataclass(frozen=True)
class Stagnation:
    """Cost reduction over the last steps."""

    first: float  # cost at the last gain
    last: float  # cost now
    steps: int = 0  # since the last gain or doubt
    promised: float = 0.0  # cost reduction predicted since the last gain
    patience: int = STAGNATION.patient_steps  # steps without gain before a doubt
    doubted: bool = False

    @classmethod
    def at(cls, square: float, patience: int = STAGNATION.patient_steps) -> Stagnation:
        """Return the initial value at a cost."""
        return cls(square, square, patience=patience)

    def after(self, promised: float, square: float, worth: float) -> Stagnation:
        """Return the value after a step."""
        after = replace(self, steps=self.steps + 1, promised=self.promised + promised, last=square)
        return Stagnation.at(square, self.patience) if after.fall > worth else after

    def doubting(self) -> Stagnation:
        """Return the value after a doubt; patience doubles."""
        return replace(self, steps=0, doubted=True, patience=2 * self.patience)

    @property
    def fall(self) -> float:
        """Cost reduction since the last gain."""
        return self.first - self.last

    @property
    def stuck(self) -> bool:
        """True if patience is used up without a gain."""
        return self.steps >= self.patience

    def in_vain(self, worthless: float) -> bool:
        """Return True if the search gains nothing in spite of a doubt."""
        vain = self.fall < STAGNATION.vain_share * self.promised
        return self.doubted and self.stuck and vain and self.fall <= worthless
