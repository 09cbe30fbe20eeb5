"""The executor of each system: threads, or separate processes (`fmuid.simulation.isolation`).

All simulators of a system share its instances. `close` or the system's end frees them.
An executor knows the components but not the system: there is no circle to collect.
"""

from __future__ import annotations

import logging
import os
import threading
import weakref
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from fmuid.models import System
from fmuid.simulation.instance_registry import in_threads

if TYPE_CHECKING:
    from fmuid.simulation.executor import InProcessExecutor
    from fmuid.simulation.isolation.isolated_executor import IsolatedExecutor, MultiProcessExecutor

    Executor: TypeAlias = InProcessExecutor | IsolatedExecutor | MultiProcessExecutor

_log = logging.getLogger("fmuid.fmu")


@dataclass(eq=False)
class _Use:
    """Executor, variants and passed-on warnings of a system in use."""

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
    """Return a variant of a system, made at a key's first call."""
    with _making:
        use = _uses.setdefault(system, _Use())
        if key not in use.variants:
            use.variants[key] = made = make()
            _uses[made] = _Use(told=use.told)
        return use.variants[key]


def close(system: System) -> None:
    """Free all instances of a system and its variants, for now."""
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
    """Return the number of parallel simulations: ``OMP_NUM_THREADS``, else cores."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) > 0 else os.cpu_count() or 1


def _executor(system: System, told: set[str]) -> Executor:
    concurrent = all(in_threads(model.fmu.description, model.kind) for model in system.components.values())
    limit = threads() if concurrent else 1
    if system.isolation is not None:
        from fmuid.processes import AVAILABLE

        if AVAILABLE:
            # for Linux and macOS only
            from fmuid.simulation.isolation.isolated_executor import IsolatedExecutor, MultiProcessExecutor

            processes = min(threads(), system.isolation.threads or threads())
            if not concurrent and system.can_be_repeated and processes > 1:
                return MultiProcessExecutor(system.components, processes, system.isolation, told)
            return IsolatedExecutor(system.components, limit, system.isolation, told)
        _log.warning("FMUs run inside fmuid's process: process isolation needs Linux or macOS")
    from fmuid.simulation.executor import InProcessExecutor  # and with it the core

    return InProcessExecutor(system.components, limit, told)
