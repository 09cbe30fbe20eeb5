"""Ownership of what runs a system, of which the system knows only that it can be closed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Protocol, Self, TypeVar, cast


class Closable(Protocol):
    """An object with resources to free."""

    def close(self) -> None:
        """Free the resources; a later use makes new ones."""


Made = TypeVar("Made", bound=Closable)


class Owner:
    """Owns an executor and variants of itself; a context manager that closes them.

    A system holds what runs it and knows nothing of it: `fmuid.simulation`, which stands above the models, makes the
    executor at the first simulation and puts it here. All simulators of a system thus share
    its instances, and none can free those of another's. They are freed by `close`, or when nobody uses the system any
    more: an executor knows the components but never the system, so that there is no circle to be collected first.

    Attributes
    ----------
    told : set of str
        The warnings of its FMUs that were passed on: each once, in however many threads and processes they run.
    """

    def __init__(self) -> None:
        self._executor: Closable | None = None
        self.told: set[str] = set()
        self._variants: dict[Hashable, Self] = {}
        self._making = threading.RLock()

    def executor(self, make: Callable[[Self], Made]) -> Made:
        """Return the executor, which the first call makes; all calls give the same function."""
        with self._making:
            if self._executor is None:
                self._executor = make(self)
            return cast(Made, self._executor)

    def variant(self, key: Hashable, make: Callable[[], Self]) -> Self:
        """Return a system derived from this one, which the first call with a key makes; it is closed with this one."""
        with self._making:
            if key not in self._variants:
                self._variants[key] = make()
            return self._variants[key]

    def close(self) -> None:
        """Free all instances, also those of variants; a later simulation makes new ones."""
        with self._making:
            owned = [self._executor, *self._variants.values()]
        for each in owned:
            if each is not None:
                each.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
