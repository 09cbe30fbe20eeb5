"""A cause of what is new in a record: which coordinates it moves, how far it may, and how likely it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fmuid.errors import InputError

# What a cause is taken to be worth before anything is measured, where nothing else is said: one record in a hundred.
USUAL_PROBABILITY = 0.01


@dataclass(frozen=True)
class Cause:
    """Something that may be new in a record.

    Parameters
    ----------
    name : str
    columns : tuple of int
        Its coordinates: one, or two for a vector of the plane (a size with its angle).
    size : float
        Standard deviation of its size where it is there (slab), in the coordinates' unit.
    sign : int
        1 or −1 where its size can only have this sign, 0 where either.
    probability : float
        That it is there, before anything is measured.
    modelled : bool
        Whether its signature is that of a fault model, which may be wrong; what sensors, supply and the healthy
        parameters do is known.

    Raises
    ------
    InputError
        If it has no coordinates, its size is not positive, a sign goes with several, or the probability is none.
    """

    name: str
    columns: tuple[int, ...]
    size: float
    sign: int = 0
    probability: float = USUAL_PROBABILITY
    modelled: bool = True

    def __post_init__(self) -> None:
        if not self.columns:
            raise InputError(f"the cause {self.name!r} has no coordinate: name at least one")
        if not (math.isfinite(self.size) and self.size > 0):
            raise InputError(f"the size of the cause {self.name!r} must be positive and finite, not {self.size!r}")
        if self.sign not in (-1, 0, 1) or (self.sign and len(self.columns) > 1):
            raise InputError(f"the sign of the cause {self.name!r} must be 1 or -1 for one coordinate, or 0")
        if not 0 < self.probability < 1:
            raise InputError(f"the probability of the cause {self.name!r} must lie between 0 and 1")
