"""Who keeps an isolated process: makes it when it is needed, replaces one that has grown, ends it with its owner."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import psutil

from fmuid.processes.ends import HostExitError
from fmuid.processes.host import HostProcess

LEAST_MEMORY = 1e9  # bytes that a process may take by default even on a small machine
MOST_KILLS = 3  # in a row from outside; then it is not by chance

Host = TypeVar("Host", bound=HostProcess)


class HostKeeper(Generic[Host]):
    """Keeps one isolated process, which ends with it.

    Parameters
    ----------
    make : callable
        Makes one that may take so much memory, bytes.
    memory : float, optional
        What it may take, MB; default: a share of the machine's.
    left : list of str, optional
        What it has printed that nobody asked for joins these, when the keeper goes.
    """

    def __init__(
        self, make: Callable[[float], Host], memory: float | None = None, left: list[str] | None = None
    ) -> None:
        self._make = make
        self._memory = 1e6 * memory if memory else _memory_share()
        self._hosts: list[Host] = []  # the one that there is, in a list that outlives its keeper
        self._text = ""
        weakref.finalize(self, _shut, self._hosts, left)

    def host(self, begin: Callable[[Host], None] = lambda _: None) -> Host:
        """Return the process, a new one where there is none.

        Parameters
        ----------
        begin : callable, optional
            Gives a new process its first orders.

        Raises
        ------
        End
            If it comes to an end over them again and again.
        """
        if self._hosts and self._hosts[0].alive:
            if not self._hosts[0].gone:
                return self._hosts[0]
            self._hosts[0].kill()
            self.bury()
        for attempt in range(MOST_KILLS):
            host = self._make(self._memory)
            try:
                begin(host)
            except HostExitError:
                if attempt + 1 == MOST_KILLS:
                    raise
            except BaseException:
                host.kill()
                raise
            else:
                break
        self._hosts[:] = [host]
        return host

    def bury(self) -> Host | None:
        """Part with a process that has come to its end; return it."""
        if not self._hosts:
            return None
        host = self._hosts.pop()
        self._text += host.printed()
        return host

    def strike(self) -> None:
        """End the process while another thread waits for it, which finds it killed and cleans up."""
        for host in self._hosts[:]:
            if host.alive:
                host.strike()

    def replace(self) -> None:
        """End the process; what comes next has a new one."""
        if self._hosts:
            self._hosts[0].close()
            self.bury()

    def replace_outgrown(self) -> None:
        """End the process where it has grown."""
        if self._hosts and self._hosts[0].outgrown():
            self.replace()

    def printed(self) -> str:
        """Return and forget what was printed."""
        text, self._text = self._text, ""
        return text + (self._hosts[0].printed() if self._hosts else "")


def _shut(hosts: list[Any], left: list[str] | None) -> None:
    for host in hosts:
        host.close()
        if left is not None:
            left.extend(filter(None, [host.printed()]))
    hosts.clear()


def _memory_share() -> float:
    """Return how much memory a process may take by default, bytes."""
    return max(LEAST_MEMORY, psutil.virtual_memory().total / (2 * (os.cpu_count() or 1)))
