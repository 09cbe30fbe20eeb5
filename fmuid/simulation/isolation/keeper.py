"""Who keeps a process for FMUs: makes it when it is needed, replaces one that has grown, and ends it with its owner."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence

import numpy as np
import psutil

from fmuid.arrays import Indices
from fmuid.models import Isolation
from fmuid.simulation.isolation.ends import End
from fmuid.simulation.isolation.process import Host

SLOWER_FACTOR = 100.0
"""How much longer than all before a simulation may take by default."""
LEAST_TIME_LIMIT = 5.0
"""The shortest default time limit, s: machines are busy at times."""
FIRST_TIME_LIMIT = 60.0
"""The default time limit before any simulation has ended, or one of more steps than all before, s."""
LEAST_MEMORY = 1e9  # bytes that a process may take by default even on a small machine
MOST_KILLS = 3  # in a row from outside; then it is not by chance

_left: list[str] = []  # what FMUs printed whose keepers are gone


class Keeper:
    """Keeps one process for FMUs, which ends with it.

    Parameters
    ----------
    settings : Isolation
    modules : sequence of str
        What the process needs to have loaded, beside what all have.
    told : set of str, optional
        What was logged, and is not to be logged again; default: all is.

    Attributes
    ----------
    longest : float
        Duration of the longest simulation so far, s.
    """

    def __init__(self, settings: Isolation, modules: Sequence[str], told: set[str] | None = None) -> None:
        self._settings, self._modules, self._told = settings, tuple(modules), told
        self._memory = 1e6 * settings.memory if settings.memory else _memory_share()
        self._hosts: list[Host] = []  # the one that there is, in a list that outlives its keeper
        self._text, self.longest = "", 0.0
        weakref.finalize(self, _shut, self._hosts)

    def host(self, begin: Callable[[Host], None]) -> Host:
        """Return the process, a new one where there is none.

        Parameters
        ----------
        begin : callable
            Gives a new process its first orders.

        Raises
        ------
        End
            If it comes to an end over them again and again.
        """
        if self._hosts and self._hosts[0].alive:
            return self._hosts[0]
        for attempt in range(MOST_KILLS):
            host = Host(self._modules, self._memory, self._told)
            try:
                begin(host)
            except End:
                if attempt + 1 == MOST_KILLS:
                    raise
            except BaseException:
                host.kill()
                raise
            else:
                break
        self._hosts[:] = [host]
        return host

    @property
    def time_limit(self) -> float:
        """How long a simulation like those before may take, s."""
        if self._settings.time_limit:
            return self._settings.time_limit
        return max(LEAST_TIME_LIMIT, SLOWER_FACTOR * self.longest) if self.longest else FIRST_TIME_LIMIT

    def bury(self) -> Indices:
        """Part with a process that has come to its end; return what its threads were doing, nothing without one."""
        if not self._hosts:
            return np.zeros(0, np.intp)
        host = self._hosts.pop()
        self._text += host.printed()
        return host.states.copy()

    def strike(self) -> None:
        """End the process while another thread waits for it, which finds it killed and cleans up."""
        for host in self._hosts[:]:
            if host.alive:
                host.strike()

    def replace(self) -> None:
        """End the process if it has simulated anything; what comes next has a new one."""
        if self._hosts and self._hosts[0].simulations:
            host = self._hosts.pop()
            host.close()
            self._text += host.printed()

    def replace_outgrown(self) -> None:
        """End the process after as many simulations as the settings say, or where it has grown."""
        if self._hosts and self._hosts[0].outgrown(self._settings.recycle):
            self.replace()

    def printed(self) -> str:
        """Return and forget what was printed."""
        text, self._text = self._text, ""
        return text + (self._hosts[0].printed() if self._hosts else "")


def left() -> list[str]:
    """Return and forget what FMUs printed whose keepers are gone."""
    found = _left[:]
    _left.clear()
    return found


def _shut(hosts: list[Host]) -> None:
    for host in hosts:
        host.close()
        _left.extend(filter(None, [host.printed()]))
    hosts.clear()


def _memory_share() -> float:
    """Return how much memory a process may take by default, bytes."""
    return max(LEAST_MEMORY, psutil.virtual_memory().total / (2 * (os.cpu_count() or 1)))
