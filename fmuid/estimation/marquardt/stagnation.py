"""When a search no longer gets anywhere: what it gained over its last steps, against what they promised.

A simulation need not be as smooth as it is accurate: an adaptive integrator jumps, and min and max in the equations
have kinks. There a Jacobian promises falls of the criterion that no step brings, however short; the search would go on
until its iterations are used up, although nothing is left to be gained.
"""

from __future__ import annotations

# Steps that are granted before a search without gain is doubted.
PATIENT_STEPS = 10
# What is not a gain: this share of what one standard deviation of the parameters is worth (1 % of one, squared) ...
WORTHLESS_SHARE = 1e-4
# ... and, where it only matters whether the linear model can be trusted, this share of the fall that it predicts.
SLOW_SHARE = 1e-2
# Steps that bring less than this share of what they promised are useless, not merely slow.
VAIN_SHARE = 0.25


class Stagnation:
    """The gain of the last steps.

    Attributes
    ----------
    patience : int
        Steps without gain after which the search is doubted.
    doubted : bool
        Whether it was already doubted since its last gain.
    """

    def __init__(self, square: float) -> None:
        self.patience = PATIENT_STEPS
        self.begin(square)

    def begin(self, square: float) -> None:
        """Begin to watch at a criterion."""
        self._first = self._last = square
        self._steps, self._promised, self.doubted = 0, 0.0, False

    def note(self, promised: float, square: float, worth: float) -> None:
        """Take note of a step: what fall it promised, the criterion after it, and what fall counts as a gain."""
        self._steps, self._promised, self._last = self._steps + 1, self._promised + promised, square
        if self.fall > worth:
            self.begin(square)

    @property
    def fall(self) -> float:
        """How much the criterion has fallen since the last gain."""
        return self._first - self._last

    @property
    def stuck(self) -> bool:
        """Whether the search has used up its patience without a gain."""
        return self._steps >= self.patience

    @property
    def vain(self) -> bool:
        """Whether the steps since the last gain have brought next to nothing of what they promised."""
        return self.fall < VAIN_SHARE * self._promised

    def doubt(self) -> None:
        """Grant as many steps again, and next time twice as many."""
        self._steps, self.doubted = 0, True
        self.patience *= 2
