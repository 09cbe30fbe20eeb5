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

from fmuid.batches.parcel import Copies
from fmuid.batches.run_case import CaseOutcome, CaseRunner
from fmuid.models import Isolation
from fmuid.simulation import FIRST_LIMIT, End, Host, Keeper, executor_of
from fmuid.studies import Study

_runner: list[CaseRunner] = []  # of a process that runs cases


def open_cases(data: Mapping[str, Any], path: Path, copies: Copies | None) -> None:
    """Make this process one that runs the cases of a study."""
    _runner[:] = [CaseRunner(Study.of(data, path), copies)]


def run_case(index: int) -> tuple[CaseOutcome, float]:
    """Run a case; return also how long the longest simulation took so far, s."""
    outcome = _runner[0](index)
    return outcome, getattr(executor_of(_runner[0].study.system), "longest", 0.0)


class IsolatedCases:
    """Runs the cases of a study as `CaseRunner` does, out of reach of what its FMUs do.

    Parameters
    ----------
    study : Study
        With a ``[batch]``.
    copies : Copies, optional
        As for `CaseRunner`.

    Raises
    ------
    InputError
        As `CaseRunner`.
    """

    def __init__(self, study: Study, copies: Copies | None = None) -> None:
        settings = study.model.isolation or Isolation()
        self._opened = study.data, study.path, copies
        self._careful = CaseRunner(replace(study, model=replace(study.model, isolation=settings)), copies)
        self._keeper = Keeper(settings, [__name__])

    @property
    def columns(self) -> dict[str, str]:
        """All columns of a row in order, and their types (`CaseRunner.columns`)."""
        return self._careful.columns

    def __call__(self, index: int) -> CaseOutcome:
        """Run a case; one that fails has a row that says why."""
        outcome: CaseOutcome
        keeper = self._keeper
        try:
            host = keeper.host(self._begin)
            outcome, keeper.longest = host.order(
                "call", __name__, "run_case", (index,), limit=keeper.time_limit, idle_limit=math.inf
            )
            host.simulations += int(str(outcome.row["simulations"]))
            keeper.replace_outgrown()
        except End:
            keeper.bury()
            outcome = self._careful(index)
        return replace(outcome, log="\n".join(filter(None, [outcome.log, keeper.printed()])))

    def _begin(self, host: Host) -> None:
        host.order("watch", limit=FIRST_LIMIT)
        host.order("call", __name__, "open_cases", self._opened, limit=FIRST_LIMIT)
