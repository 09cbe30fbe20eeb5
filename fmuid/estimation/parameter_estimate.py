"""The estimate of one parameter, as a number that knows how sure it is."""

from __future__ import annotations

import math

from fmuid.data import Normal
from fmuid.formatting import has_unit, with_std


class ParameterEstimate(float):
    """The estimate of one parameter, ``result["Rs"]``.

    It is a number, its value: it calculates, compares, is formatted and written as one. What is calculated from it is a
    plain number. In a notebook it shows its standard deviation and unit.

    Attributes
    ----------
    name : str
    std : float
        Standard deviation, infinite where the parameter is not determined, NaN where nothing is known of it.
    interval : (float, float)
        Lower and upper end of the 95 % confidence interval; `fmuid.Result.intervals` has those of other levels.
    unit : str or None
        As the FMU declares it.
    start : float
        Where the search began.
    prior : Normal or None
    """

    def __new__(
        cls,
        value: float,
        *,
        name: str = "",
        std: float = math.nan,
        interval: tuple[float, float] = (math.nan, math.nan),
        unit: str | None = None,
        start: float = math.nan,
        prior: Normal | None = None,
    ) -> ParameterEstimate:
        """Return the number, which carries the rest."""
        made = super().__new__(cls, value)
        made.name, made.std, made.interval = name, std, interval
        made.unit, made.start, made.prior = unit, start, prior
        return made

    name: str
    std: float
    interval: tuple[float, float]
    unit: str | None
    start: float
    prior: Normal | None

    @property
    def value(self) -> float:
        """The plain number."""
        return float(self)

    def __repr__(self) -> str:
        sure = f"{self.value:.2g} ± ?" if self.std == math.inf else with_std(self.value, self.std)
        return f"{self.name} = {sure}" + (f" {self.unit}" if has_unit(self.unit) else "")

    __str__ = float.__repr__  # what is made for files of numbers stays a number
