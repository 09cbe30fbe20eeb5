"""The executor of each system: threads of this process, or processes of its own (`fmuid.simulation.isolation`).

All simulators of a system share its instances. They are freed by `close`, or when nobody uses the system any more: an
executor knows the components but never the system, so that there is no circle to be collected first.
"""

from __future__ import annotations

import logging
import os
import threading
import weakref
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from fmuid.array_types import Floats, Indices
from fmuid.errors import SimulationError
from fmuid.models import System
from fmuid.simulation.instance_registry import in_threads
from fmuid.simulation.simulation_plan import GridSimulation

_log = logging.getLogger("fmuid.fmu")


class Executor(Protocol):
    """What simulates for one system, shared by all its simulators."""

    lock: threading.RLock

    def run(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N) into outputs (m, K, n_outputs) and reports (m, codes.REPORT)."""

    def failure(
        self,
        simulation: GridSimulation,
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


@dataclass(eq=False)
class _Use:
    """What a system in use has: executor, systems derived from it, and warnings of its FMUs, passed on once each."""

    executor: Executor | None = None
    variants: dict[Hashable, System] = field(default_factory=dict)
    told: set[str] = field(default_factory=set)


_uses: weakref.WeakKeyDictionary[System, _Use] = weakref.WeakKeyDictionary()
_making = threading.RLock()


def executor_of(system: System) -> Executor:
    """Return the executor of a system, made at the first call."""
    with _making:
        use = _uses.setdefault(system, _Use())
        if use.executor is None:
            use.executor = _executor(system, use.told)
        return use.executor


def variant_of(system: System, key: Hashable, make: Callable[[], System]) -> System:
    """Return a system derived from another, which the first call with a key makes; it is closed with that."""
    with _making:
        use = _uses.setdefault(system, _Use())
        if key not in use.variants:
            use.variants[key] = made = make()
            _uses[made] = _Use(told=use.told)
        return use.variants[key]


def close(system: System) -> None:
    """Free all instances of a system, also those of variants; a later simulation makes new ones."""
    with _making:
        use = _uses.get(system, _Use())
    for variant in use.variants.values():
        close(variant)
    if use.executor is not None:
        use.executor.close()


@contextmanager
def closing(system: System) -> Iterator[System]:
    """Close a system at the end of a block."""
    try:
        yield system
    finally:
        close(system)


def threads() -> int:
    """Return how many simulations run at a time: one for each core, or as many as ``OMP_NUM_THREADS`` says."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) > 0 else os.cpu_count() or 1


def _executor(system: System, told: set[str]) -> Executor:
    concurrent = all(in_threads(model.fmu.description, model.kind) for model in system.components.values())
    limit = threads() if concurrent else 1
    if system.isolation is not None:
        from fmuid.processes import AVAILABLE

        if AVAILABLE:
            from fmuid.simulation.isolation.isolated_executor import (
                IsolatedExecutor,  # for Linux and macOS only
                MultiProcessExecutor,
            )

            processes = min(threads(), system.isolation.threads or threads())
            if not concurrent and system.can_be_repeated and processes > 1:
                return MultiProcessExecutor(system.components, processes, system.isolation, told)
            return IsolatedExecutor(system.components, limit, system.isolation, told)
        _log.warning("FMUs run inside fmuid's own process: processes of their own need Linux or macOS")
    from fmuid.simulation.executor import InProcessExecutor  # and with it the core

    return InProcessExecutor(system.components, limit, told=told)
