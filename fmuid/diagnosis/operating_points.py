"""Operating points that healthy records have seen, and records outside of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment


@dataclass(frozen=True)
class OperatingPointSettings:
    """Margins of a range that counts as seen."""

    of_range: float = 0.25  # share of the range ...
    of_size: float = 0.2  # ... or of the largest value, if larger


SETTINGS = OperatingPointSettings()


@dataclass(frozen=True)
class OutsideRange:
    """A quantity of a record outside what the healthy records have seen.

    Attributes
    ----------
    name : str
        ``mean(u)`` or ``rms(u)`` of an input, or a healthy parameter.
    value, low, high : float
        Of the record, and range of the healthy records.
    """

    name: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Coverage:
    """Healthy records of a diagnosis, and its record outside of them.

    Attributes
    ----------
    records : int
        Healthy records.
    ranges : mapping of str to (low, high)
        Their mean and rms value of each input.
    outside : tuple of OutsideRange
        Quantities of the examined record beyond a margin of these.
    """

    records: int
    ranges: Mapping[str, tuple[float, float]]
    outside: tuple[OutsideRange, ...]


@dataclass(frozen=True, eq=False)
class OperatingPoints:
    """Operating points of healthy records: inputs' means and rms values."""

    names: tuple[str, ...]
    values: Floats  # (K, m)

    @classmethod
    def of(cls, records: Sequence[Experiment]) -> OperatingPoints:
        """Return the operating points of records with the same inputs."""
        names = tuple(f"{how}({name})" for name in records[0].input_names for how in ("mean", "rms"))
        rows = []
        for each in records:
            where = [each.input_names.index(name) for name in records[0].input_names]
            values = each.input_values[:, where]
            rows.append(np.column_stack([values.mean(axis=0), np.sqrt(np.mean(values**2, axis=0))]).ravel())
        return cls(names, np.array(rows).reshape(len(rows), len(names)))

    def ranges(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each quantity."""
        low, high = self.values.min(axis=0).tolist(), self.values.max(axis=0).tolist()
        return dict(zip(self.names, zip(low, high, strict=True), strict=True))

    def coverage(self, records: Sequence[Experiment]) -> Coverage:
        """Return what the healthy records cover, beside other records."""
        outside = tuple(each for one in records for each in self.outside(one))
        return Coverage(len(self.values), self.ranges(), outside)

    def outside(self, record: Experiment) -> tuple[OutsideRange, ...]:
        """Return the quantities of a record outside the ranges and their margins."""
        found, new = [], OperatingPoints.of([record])
        own = dict(zip(new.names, new.values[0].tolist(), strict=True))
        for name, (low, high) in self.ranges().items():
            size = self.ranges()[name.replace("mean(", "rms(", 1)][1]
            margin = max(SETTINGS.of_range * (high - low), SETTINGS.of_size * size)
            if name in own and not low - margin <= own[name] <= high + margin:
                found.append(OutsideRange(name, own[name], low, high))
        return tuple(found)
