"""The near side of `orders`: one process that runs FMUs, with its arrays, watched while it works."""

from __future__ import annotations

import contextlib
import errno
import logging
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

from fmuid.array_types import Indices
from fmuid.errors import FmuidError
from fmuid.processes import CLOSING_LIMIT, FAILED, REFUSED, HostExitError, HostProcess, ProcessStatus, Watchdog
from fmuid.simulation import core_constants as codes
from fmuid.simulation.isolation import orders

PREPARATION_LIMIT = 120.0  # s for instantiation and loading code: some FMUs read large files
AT_REST_SECONDS = 60.0
"""Time without a simulation and without CPU time after which a process that owes an answer does not answer, s."""

Value = TypeVar("Value")


class HostWatchdog(Watchdog):
    """Watches over one order to a process that runs FMUs.

    Parameters
    ----------
    limit : float
        How long it may take until a thread begins with something else, or one more report is done, s.
    doing : (`orders.DOING_WORDS`,) array of intp
    reports : (m, codes.REPORT) array, optional
    computes : bool
        Whether it may calculate for any time while no thread simulates.
    """

    def __init__(self, limit: float, doing: Indices, reports: Indices | None = None, computes: bool = False) -> None:
        super().__init__(limit)
        self._doing, self._reports, self._computes = doing, reports, computes

    @property
    def _at_rest(self) -> bool:
        return self._computes and not self._doing[::2].any()

    def state(self, condition: ProcessStatus) -> Hashable:
        """Return what all threads are doing, how many reports are left, and CPU time where that counts, s."""
        undone = 0 if self._reports is None else int((self._reports[:, 2] == codes.UNDONE).sum())
        return self._doing.tobytes(), undone, int(condition.computed) if self._at_rest else 0

    def allowed(self) -> float:
        """Return how long it may do what it is doing, s."""
        if self._at_rest:
            return AT_REST_SECONDS
        preparing = (self._doing[::2] == codes.PREPARING).any()
        return max(self.limit, PREPARATION_LIMIT) if preparing else self.limit


class FmuHost(HostProcess):
    """One process that runs the FMUs of one system.

    Parameters
    ----------
    modules : sequence of str
        What it needs to have loaded.
    memory_limit : float
        How much memory it may take with all that it starts, bytes.
    told : set of str, optional
        What was logged, and is not to be logged again; default: nothing that it logs is.

    Attributes
    ----------
    doing : (`orders.DOING_WORDS`,) array of intp
        What each of its threads is doing, and how often it has begun.
    simulations : int
        How many it was given.
    records : dict of int to int
        Bytes of the large arrays of each run that it knows.
    """

    def __init__(self, modules: Sequence[str], memory_limit: float, told: set[str] | None = None) -> None:
        super().__init__(modules, memory_limit, told)
        self.simulations = 0
        self.records: dict[int, int] = {}
        self._show(8 * orders.DOING_WORDS)

    def _show(self, size: int) -> None:
        self.doing: Indices = np.frombuffer(self.share(size), np.intp, orders.DOING_WORDS)

    @property
    def states(self) -> Indices:
        """What each of its threads is doing."""
        return self.doing[::2]

    def room(self, shape: tuple[int, int, int, int]) -> tuple[orders.Arrays, int]:
        """Return reports, thetas and outputs in shared memory that is large enough, and its size."""
        needed = orders.layout(*shape)[-1]
        if needed > len(self._memory):
            self._show(needed)
        return orders.arrays(self._memory, shape), len(self._memory)

    def order(
        self,
        function: Callable[..., Value],
        *arguments: Any,
        limit: float,
        reports: Indices | None = None,
        computes: bool = False,
    ) -> Value:
        """Give an order (`HostProcess.call`) under the limits of a `HostWatchdog`; return the answer.

        Raises
        ------
        End
            If the process comes to an end over it, also since the system refuses it what it needs or code of fmuid
            fails in it; it is gone then.
        """
        return self.call(function, *arguments, watchdog=HostWatchdog(limit, self.doing, reports, computes))

    def failure(self, error: Exception) -> Exception:
        """Return its end unless it says something in words: code beside an FMU fails where that spoils its memory."""
        if isinstance(error, FmuidError):
            return error
        if isinstance(error, OSError | MemoryError):
            return self.stopped(HostExitError(REFUSED, getattr(error, "errno", errno.ENOMEM) or 0))
        words = f"code of fmuid failed in the process of an FMU: {type(error).__name__}: {error}"
        self.pass_on([("fmuid.fmu", logging.WARNING, words)])
        return self.stopped(HostExitError(FAILED, 0))

    @property
    def given(self) -> float:
        """What of its memory `fmuid` itself has given it, bytes: it is not the FMU's."""
        return super().given + sum(self.records.values())

    def close(self) -> None:
        """Let it free its instances and end it."""
        if self.alive:
            with contextlib.suppress(HostExitError):  # it is killed below either way
                self.order(orders.close, limit=CLOSING_LIMIT)
            self.kill()
