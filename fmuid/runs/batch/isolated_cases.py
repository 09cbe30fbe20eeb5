"""Cases of a batch in a process of their own, identification and FMU together: nothing travels but their rows.

A case that crashes the process, ties it up or fills the memory is run again with the FMU alone in a process of its own
(`fmuid.simulation.isolation.isolated_executor`), which settles which simulation is to blame. Both ways give the same
numbers, bit for bit.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmuid.models import Isolation
from fmuid.processes import LIMITS, HostExitError
from fmuid.runs.batch.run_case import CaseOutcome, CaseRunner
from fmuid.runs.batch.study_package import CopiedFiles
from fmuid.simulation import FIRST_TIME_LIMIT, FmuHost, HostManager, executor_of, watch
from fmuid.studies import Study

# An order, which costs a third of a millisecond, is of as many cases as take so long, s. Where the process ends over
# them, they are run again one by one.
ORDER_SECONDS = 0.2

_runner: list[CaseRunner] = []  # of a process that runs cases


def open_cases(data: Mapping[str, Any], path: Path, copies: CopiedFiles | None) -> None:
    """Make this process one that runs the cases of a study."""
    _runner[:] = [CaseRunner(Study.of(data, path), copies)]


def run_cases(indices: Sequence[int]) -> tuple[list[tuple[dict[str, object], str]], float]:
    """Return row and log of cases, each with what was printed meanwhile, and the duration of the longest simulation, s.

    They are what answers between processes can have.
    """
    outcomes, position = [], 0
    for index in indices:
        outcome = _runner[0](index)
        printed, position = _printed_since(position)
        outcomes.append((outcome.row, "\n".join(filter(None, [outcome.log, printed]))))
    return outcomes, getattr(executor_of(_runner[0].study.system), "longest", 0.0)


def _printed_since(position: int) -> tuple[str, int]:
    """Return what this process has printed since a position in the file that it prints to, and the position now."""
    size = os.fstat(1).st_size
    if size == position:
        return "", size
    position = position if position < size else 0  # the other side has emptied the file
    return os.pread(1, min(size - position, LIMITS.printed_kept), position).decode("utf-8", errors="replace"), size


class IsolatedCases:
    """Runs the cases of a study as `CaseRunner` does, out of reach of what its FMUs do.

    Parameters
    ----------
    study : Study
        With a ``[batch]``.
    copies : CopiedFiles, optional
        As for `CaseRunner`.

    Raises
    ------
    InputError
        As `CaseRunner`.
    """

    def __init__(self, study: Study, copies: CopiedFiles | None = None) -> None:
        settings = study.model.isolation or Isolation()
        self._opened = study.data, study.path, copies
        self._careful = CaseRunner(replace(study, model=replace(study.model, isolation=settings)), copies)
        self._keeper = HostManager(settings, [__name__])
        self._alone = (
            settings.max_simulations_per_process is not None
        )  # how many simulations a case takes is known afterwards
        self._size = 1  # of the next order

    @property
    def columns(self) -> dict[str, str]:
        """All columns of a row in order, and their types (`CaseRunner.columns`)."""
        return self._careful.columns

    def run(self, indices: Sequence[int]) -> list[CaseOutcome]:
        """Run cases one after the other; one that fails has a row that says why."""
        found: list[CaseOutcome] = []
        while len(found) < len(indices):
            found += self._ordered(indices[len(found) : len(found) + self._size])
        return found

    def _ordered(self, indices: Sequence[int]) -> list[CaseOutcome]:
        """Run cases in one order to the process."""
        keeper, began = self._keeper, time.perf_counter()
        try:
            host = keeper.host(self._begin)
            rows, keeper.longest = host.order(run_cases, indices, limit=keeper.time_limit, computes=True)
            outcomes = [CaseOutcome(row, log) for row, log in rows]
            host.simulations += sum(int(str(outcome.row["simulations"])) for outcome in outcomes)
            keeper.replace_outgrown()
        except HostExitError:
            keeper.bury()
            self._size = 1
            if len(indices) > 1:
                keeper.printed()  # they print it again
                return [outcome for index in indices for outcome in self._ordered([index])]
            outcome = self._careful(indices[0])
            return [replace(outcome, log="\n".join(filter(None, [outcome.log, keeper.printed()])))]
        keeper.printed()  # is in the logs
        fitting = int(ORDER_SECONDS * len(indices) / max(time.perf_counter() - began, 1e-6))
        self._size = 1 if self._alone else max(1, min(fitting, 2 * len(indices)))
        return outcomes

    def _begin(self, host: FmuHost) -> None:
        host.order(watch, limit=FIRST_TIME_LIMIT)
        host.order(open_cases, *self._opened, limit=FIRST_TIME_LIMIT)
