"""Who keeps a process for FMUs: how long its simulations may take, and after how many of them it is replaced."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fmuid.array_types import Indices
from fmuid.models import Isolation
from fmuid.processes import HostKeeper
from fmuid.simulation.isolation.host import FmuHost

SLOWER_FACTOR = 100.0
"""How much longer than all before a simulation may take by default."""
LEAST_TIME_LIMIT = 5.0
"""The shortest default time limit, s: machines are busy at times."""
FIRST_TIME_LIMIT = 60.0
"""The default time limit before any simulation has ended, or one of more steps than all before, s."""

_left: list[str] = []  # what FMUs printed whose keepers are gone


class HostManager(HostKeeper[FmuHost]):
    """Keeps one process for FMUs, which ends with it.

    Parameters
    ----------
    settings : Isolation
    modules : sequence of str
        What the process needs to have loaded.
    told : set of str, optional
        What was logged, and is not to be logged again; default: nothing that it logs is.

    Attributes
    ----------
    longest : float
        Duration of the longest simulation so far, s.
    """

    def __init__(self, settings: Isolation, modules: Sequence[str], told: set[str] | None = None) -> None:
        super().__init__(lambda memory: FmuHost(modules, memory, told), settings.memory, _left)
        self._settings, self.longest = settings, 0.0

    @property
    def time_limit(self) -> float:
        """How long a simulation like those before may take, s."""
        if self._settings.time_limit:
            return self._settings.time_limit
        return max(LEAST_TIME_LIMIT, SLOWER_FACTOR * self.longest) if self.longest else FIRST_TIME_LIMIT

    def states_at_end(self) -> Indices:
        """Part with a process that has come to its end; return what its threads were doing, nothing without one."""
        host = self.bury()
        return np.zeros(0, np.intp) if host is None else host.states.copy()

    def replace(self) -> None:
        """End the process if it has simulated anything; what comes next has a new one."""
        if self._hosts and self._hosts[0].simulations:
            super().replace()

    def close(self) -> None:
        """End the process."""
        super().replace()

    def replace_outgrown(self) -> None:
        """End the process after as many simulations as the settings say, or where it has grown."""
        recycle = self._settings.recycle
        if self._hosts and recycle is not None and self._hosts[0].simulations >= recycle:
            self.replace()
        else:
            super().replace_outgrown()


def left() -> list[str]:
    """Return and forget what FMUs printed whose keepers are gone."""
    found = _left[:]
    _left.clear()
    return found
