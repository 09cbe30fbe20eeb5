"""Values that many problems share, by content."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TypeVar, cast

import numpy as np

Item = TypeVar("Item")


class Cache:
    """Values shared by many problems; the least recently used are dropped first.

    Each value is a pure function of its key, so the order of the problems does not matter.

    Parameters
    ----------
    memory : int
        Maximum size of the arrays, bytes.
    problems : int
        Expected number of problems with one layout (`LeastSquares.layout`).

    Examples
    --------
    >>> coil, cache = fmuid.datasets.coil(), fmuid.Cache(problems=20)
    >>> fmuid.identify(fmuid.estimation.Evaluator(coil.problem(), cache)).converged
    True
    """

    def __init__(self, memory: int = 256_000_000, problems: int = 1) -> None:
        self.memory, self.problems = memory, problems
        self._kept: OrderedDict[tuple[str, Hashable], object] = OrderedDict()
        self._size = 0

    def get(self, shelf: str, key: Hashable, make: Callable[[], Item]) -> Item:
        """Return the value of a key; make it if it is missing."""
        place = shelf, key
        if place in self._kept:
            self._kept.move_to_end(place)
            return cast(Item, self._kept[place])
        value = make()
        self._kept[place] = value
        self._size += _bytes(value)
        while self._size > self.memory and self._kept:
            self._size -= _bytes(self._kept.popitem(last=False)[1])
        return value


def _bytes(value: object) -> int:
    if isinstance(value, tuple):
        return sum(map(_bytes, value))
    return value.nbytes if isinstance(value, np.ndarray) else 0
