"""Who runs the FMUs of a system: threads of this process, or of one of its own (`fmuid.simulation.isolation`)."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
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


def executor_of(system: System) -> Executor:
    """Return the executor of a system, made at the first call."""
    return system.executor(_made_for)


def threads() -> int:
    """Return how many simulations run at a time: one for each core, or as many as ``OMP_NUM_THREADS`` says."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) > 0 else os.cpu_count() or 1


def _made_for(system: System) -> Executor:
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
                return MultiProcessExecutor(system.components, processes, system.isolation, system.told)
            return IsolatedExecutor(system.components, limit, system.isolation, system.told)
        _log.warning("FMUs run inside fmuid's own process: processes of their own need Linux or macOS")
    from fmuid.simulation.in_process import InProcessExecutor  # and with it the core

    return InProcessExecutor(system.components, limit, told=system.told)
