"""Who runs the FMUs of a system: workers in this process, or in one of their own (`fmuid.simulation.isolation`)."""

from __future__ import annotations

import logging
import os
import threading
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from fmuid.arrays import Floats
from fmuid.errors import SimulationError
from fmuid.models import System
from fmuid.simulation.isolation.server import AVAILABLE

if TYPE_CHECKING:
    from fmuid.fmi import Run

_log = logging.getLogger("fmuid.fmu")


class Workers(Protocol):
    """What simulates for one system, shared by all its simulators (`fmuid.simulation.in_process.InProcess`)."""

    lock: threading.RLock

    def run(self, run: Run, thetas: Floats, outputs: Floats, reports: NDArray[np.intp]) -> None:
        """Simulate all thetas (m, N) into outputs (m, K, n_outputs) and reports (m, codes.REPORT)."""

    def failure(
        self,
        run: Run,
        theta: Floats,
        outputs: Floats,
        report: NDArray[np.intp],
        parameters: Mapping[str, float],
        explain: bool = False,
    ) -> SimulationError | None:
        """Return what outputs and report of one simulation say as an error; None where it succeeded."""

    def printed(self) -> str:
        """Return and forget what the FMUs printed."""

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""


# Workers know the components but not the system, so that an entry goes, and frees its instances, with its system.
_workers: weakref.WeakKeyDictionary[System, Workers] = weakref.WeakKeyDictionary()
_making = threading.Lock()


def workers_of(system: System) -> Workers:
    """Return the workers of a system, made at the first call."""
    with _making:
        if system not in _workers:
            _workers[system] = _made_for(system)
        return _workers[system]


def threads() -> int:
    """Return how many simulations run at a time: one for each core, or as many as ``OMP_NUM_THREADS`` says."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) > 0 else os.cpu_count() or 1


def _made_for(system: System) -> Workers:
    limit = threads() if system.can_run_in_threads else 1
    if system.isolation is not None:
        if AVAILABLE:
            from fmuid.simulation.isolation.isolated import IsolatedWorkers  # for Linux and macOS only

            return IsolatedWorkers(system.components, limit, system.isolation)
        _log.warning("FMUs run inside fmuid's own process: processes of their own need Linux or macOS")
    from fmuid.simulation.in_process import InProcess  # and with it FMPy

    return InProcess(system.components, limit)
