"""Cases of a batch in a process of their own, identification and FMU together: nothing travels but their rows.

A case that crashes the process, ties it up or fills the memory is run again with the FMU alone in a process of its own
(`fmuid.simulation.isolation.isolated`), where it is settled which simulation is to blame. Both ways give the same
numbers, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmuid.batches.run_case import CaseOutcome, CaseRunner
from fmuid.models import Isolation
from fmuid.simulation import FIRST_LIMIT, End, Host, default_limit, memory_share, workers_of
from fmuid.studies import Study

_runner: list[CaseRunner] = []  # of a process that runs cases


def open_cases(data: Mapping[str, Any], path: Path) -> None:
    """Make this process one that runs the cases of a study."""
    _runner[:] = [CaseRunner(Study.of(data, path))]


def run_case(index: int) -> tuple[CaseOutcome, float]:
    """Run a case; return also how long the longest simulation took so far, s."""
    outcome = _runner[0](index)
    return outcome, getattr(workers_of(_runner[0].study.system), "longest", 0.0)


class IsolatedCases:
    """Runs the cases of a study as `CaseRunner` does, out of reach of what its FMUs do.

    Parameters
    ----------
    study : Study
        With a ``[batch]``.

    Raises
    ------
    InputError
        As `CaseRunner`.
    """

    def __init__(self, study: Study) -> None:
        self._study, self._settings = study, study.model.isolation or Isolation()
        self._careful = CaseRunner(replace(study, model=replace(study.model, isolation=self._settings)))
        self._memory = 1e6 * self._settings.memory if self._settings.memory else memory_share()
        self._host: Host | None = None
        self._longest = 0.0

    @property
    def columns(self) -> dict[str, str]:
        """All columns of a row in order, and their types (`CaseRunner.columns`)."""
        return self._careful.columns

    def __call__(self, index: int) -> CaseOutcome:
        """Run a case; one that fails has a row that says why."""
        outcome: CaseOutcome
        limit, printed = self._settings.time_limit or default_limit(self._longest), ""
        try:
            host = self._ready()
            outcome, self._longest = host.order(
                "call", __name__, "run_case", (index,), limit=limit, idle_limit=math.inf
            )
            host.simulations += int(str(outcome.row["simulations"]))
            if host.outgrown(self._settings.recycle):
                self.close()
            printed = host.printed()
        except End:
            printed = self._host.printed() if self._host is not None else ""
            self._host = None
            outcome = self._careful(index)
        return replace(outcome, log="\n".join(filter(None, [outcome.log, printed])))

    def _ready(self) -> Host:
        """Return the process, a new one where there is none."""
        if self._host is not None and self._host.alive:
            return self._host
        host = self._host = Host(["fmuid.batches.isolated_cases"], self._memory)
        host.order("watch", limit=FIRST_LIMIT)
        host.order("call", __name__, "open_cases", (self._study.data, self._study.path), limit=FIRST_LIMIT)
        return host

    def close(self) -> None:
        """End the process; a later case makes a new one."""
        if self._host is not None:
            self._host.close()
        self._host = None
