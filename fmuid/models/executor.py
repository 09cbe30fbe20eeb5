"""Who runs the FMUs of a system, as far as the system knows, and that the system owns it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Mapping
from typing import Protocol, Self

from fmuid.arrays import Floats, Indices
from fmuid.errors import SimulationError
from fmuid.fmi import Simulation


class Executor(Protocol):
    """What simulates for one system, shared by all its simulators."""

    lock: threading.RLock

    def run(self, simulation: Simulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N) into outputs (m, K, n_outputs) and reports (m, codes.REPORT)."""

    def failure(
        self,
        simulation: Simulation,
        theta: Floats,
        outputs: Floats,
        report: Indices,
        parameters: Mapping[str, float],
        explain: bool = False,
    ) -> SimulationError | None:
        """Return what outputs and report of one simulation say as an error; None where it succeeded."""

    def printed(self) -> str:
        """Return and forget what the FMUs printed."""

    def cancel(self) -> None:
        """Have simulations that other threads run here fail, at the end of the system's use."""

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""


class Owner:
    """Owns an executor and variants of itself; a context manager that closes them.

    A system holds what runs it, of which it knows the `Executor` protocol only: `fmuid.simulation`, which stands above
    the models, makes the executor at the first simulation and puts it here. All simulators of a system thus share
    its instances, and none can free those of another's. They are freed by `close`, or when nobody uses the system any
    more: an executor knows the components but never the system, so that there is no circle to be collected first.

    Attributes
    ----------
    told : set of str
        The warnings of its FMUs that were passed on: each once, in however many threads and processes they run.
    """

    def __init__(self) -> None:
        self._executor: Executor | None = None
        self.told: set[str] = set()
        self._variants: dict[Hashable, Self] = {}
        self._making = threading.RLock()

    def executor(self, make: Callable[[Self], Executor]) -> Executor:
        """Return the executor, which the first call makes."""
        with self._making:
            if self._executor is None:
                self._executor = make(self)
            return self._executor

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
