"""The box of a global search, seen as the unit cube."""

from __future__ import annotations

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import ParameterSet
from fmuid.errors import InputError

# Without bounds, the prior says how far to look: beyond this many of its standard deviations nothing is believed.
PRIOR_STDS = 5.0
# A positive range whose ends differ by this factor is searched by orders of magnitude.
DECADE = 10.0


def spans_decades(lower: float, upper: float) -> bool:
    """Whether a range is positive and its ends differ by a factor of ten or more: to be divided logarithmically."""
    return lower > 0 and upper >= DECADE * lower


class Box:
    """The box to search, seen as the unit cube.

    Ranges that are positive and span a decade or more are divided logarithmically: between 0.05 and 2 as many points
    lie below 0.3 as above.

    Parameters
    ----------
    parameters : ParameterSet
        A parameter without a finite bound is searched within 5 standard deviations of its prior on that side.

    Attributes
    ----------
    lower, upper : (N,) arrays
    logarithmic : (N,) array of bool

    Raises
    ------
    InputError
        If a parameter has neither bounds nor a prior.
    """

    def __init__(self, parameters: ParameterSet) -> None:
        reach = PRIOR_STDS * parameters.prior_std
        self.lower = np.where(np.isfinite(parameters.lower), parameters.lower, parameters.prior_mean - reach)
        self.upper = np.where(np.isfinite(parameters.upper), parameters.upper, parameters.prior_mean + reach)
        for word, side in (("min", self.lower), ("max", self.upper)):
            for i in np.flatnonzero(np.isnan(side)):
                raise InputError(
                    f"a global search needs a bounded box, and parameter {parameters.names[i]!r} has no {word}: "
                    "give it min and max, or a prior"
                )
        pairs = zip(self.lower, self.upper, strict=True)
        self.logarithmic = np.array([spans_decades(low, high) for low, high in pairs])
        self._low, self._high = self._scaled(self.lower), self._scaled(self.upper)

    def thetas(self, units: Floats) -> Floats:
        """Return the parameters (m, N) at points of the unit cube (m, N)."""
        scaled = self._low + units * (self._high - self._low)
        scaled[:, self.logarithmic] = np.exp(scaled[:, self.logarithmic])
        return np.clip(scaled, self.lower, self.upper)  # exp(log(x)) is not always x

    def units(self, thetas: Floats) -> Floats:
        """Return where parameters (m, N) lie in the unit cube; those outside the box on its faces."""
        scaled = self._scaled(np.clip(thetas, self.lower, self.upper))
        return np.asarray((scaled - self._low) / (self._high - self._low), dtype=np.float64)

    def _scaled(self, values: Floats) -> Floats:
        scaled = np.array(values, dtype=np.float64)
        scaled[..., self.logarithmic] = np.log(scaled[..., self.logarithmic])
        return scaled
