"""When a search ends: what is left of the way, and what it gained over its last steps, against what they promised.

A simulation need not be as smooth as it is accurate: an adaptive integrator jumps, and min and max in the equations
have kinks. There a Jacobian promises falls of the criterion that no step brings, however short; the search would go on
until its iterations are used up, although nothing is left to be gained.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from fmuid.estimation.search.loop import State


@dataclass(frozen=True)
class StoppingSettings:
    """Numbers by which a search ends, is doubted, or makes its Jacobian anew."""

    offset: float = 1e-3  # standard deviations that all parameters together have to go at the end
    rough_change: float = 5e-4  # a rough search ends where the way left changes the noise variances by no more ...
    rough_offset: float = 0.1  # ... or at this share of the standard deviations
    near: float = 0.03  # standard deviations left where the Jacobian hardly changes any more
    borrowed: float = 0.3  # a Jacobian from a point close by serves no nearer to the optimum
    settled_ratio: float = 0.8  # new Jacobians that bring a noisy optimum no nearer than this gain nothing more
    suspicious_rejections: int = 6  # rejected steps in a row after which forward differences are suspected
    edge_failures: int = 2  # failures in a row after which the search feels its way with one parameter held
    hopeless_failures: int = 12  # failures in a row after which it gives up
    in_vain_offset: float = 0.3  # left where nothing is gained: the simulation makes it no better, not the way
    widest_noise: float = 3e-3  # the noise of a doubted search is measured no farther apart, relative ...
    closest_noise: float = 1e-9  # ... and no closer
    vanishing_step: float = 1e-13  # relative; changes hardly anything in double precision
    noise_margin: float = 3.0  # within which the noise left in the offset is known
    runaway_growth: float = 100.0  # factor by which a parameter grows that runs away ...
    runaway_gain: float = 0.01  # ... while the criterion falls by a smaller share
    patient_steps: int = 10  # granted before a search without gain is doubted
    worthless_share: float = 1e-4  # of what one standard deviation is worth: a hundredth of one, squared
    slow_share: float = 1e-2  # of the fall predicted, where it matters whether the linear model can be trusted
    vain_share: float = 0.25  # of what they promised: steps that bring less are useless, not merely slow


STOPPING = StoppingSettings()


@dataclass(frozen=True)
class Way:
    """What is left of the way to the optimum, in standard deviations (`offset`) and magnitudes (`change`).

    Attributes
    ----------
    predicted : float
        The fall of the criterion that the Gauss–Newton step promises.
    fresh_offset, fresh_change, previous_offset : float
        With the last Jacobian that was made where it serves, and with the one before.
    accurate : bool
        Whether the Jacobian is good enough to find the optimum by; known near it.
    near : bool
        Whether it was made close to the optimum, too.
    """

    predicted: float = math.inf
    offset: float = math.inf
    change: float = math.inf
    fresh_offset: float = math.inf
    fresh_change: float = math.inf
    previous_offset: float = math.inf
    accurate: bool = False
    near: bool = False

    def remaining(self, state: State) -> tuple[float, float]:
        """Return what is left: in standard deviations, and the largest change relative to a magnitude.

        With a Jacobian that was made before the last step, the residual's own curvature is not seen; it is what makes
        Gauss–Newton steps converge linearly, and the rate so far tells how much it leaves.
        """
        if state.fresh:
            return self.offset, self.change
        rate = state.rate
        return max(self.offset, rate * self.fresh_offset), max(self.change, rate * self.fresh_change)


@dataclass(frozen=True)
class Stagnation:
    """The gain of the last steps.

    Attributes
    ----------
    first, last : float
        The criterion at the last gain, and now.
    steps : int
        Since then, or since the search was doubted.
    promised : float
        The fall that the steps since the last gain promised.
    patience : int
        Steps without gain after which the search is doubted.
    doubted : bool
        Whether it was already doubted since its last gain.
    """

    first: float
    last: float
    steps: int = 0
    promised: float = 0.0
    patience: int = STOPPING.patient_steps
    doubted: bool = False

    @classmethod
    def at(cls, square: float, patience: int = STOPPING.patient_steps) -> Stagnation:
        """Return the beginning at a criterion."""
        return cls(square, square, patience=patience)

    def after(self, promised: float, square: float, worth: float) -> Stagnation:
        """Return it after a step: what fall it promised, the criterion after it, and what fall counts as a gain."""
        after = replace(self, steps=self.steps + 1, promised=self.promised + promised, last=square)
        return Stagnation.at(square, self.patience) if after.fall > worth else after

    def doubting(self) -> Stagnation:
        """Return it with as many steps granted again, and next time twice as many."""
        return replace(self, steps=0, doubted=True, patience=2 * self.patience)

    @property
    def fall(self) -> float:
        """How much the criterion has fallen since the last gain."""
        return self.first - self.last

    @property
    def stuck(self) -> bool:
        """Whether the search has used up its patience without a gain."""
        return self.steps >= self.patience

    def in_vain(self, worthless: float) -> bool:
        """Whether the search gains nothing although it was doubted."""
        vain = self.fall < STOPPING.vain_share * self.promised
        return self.doubted and self.stuck and vain and self.fall <= worthless
