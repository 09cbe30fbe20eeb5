"""An isolated process: made when needed, replaced when grown, ended with its owner."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import psutil

from fmuid.processes.children import AVAILABLE
from fmuid.processes.limits import HostExitError, Watchdog

if TYPE_CHECKING:
    from fmuid.processes.host import HostProcess

MOST_KILLS = 3  # in a row from outside: more are not by chance

Host = TypeVar("Host", bound="HostProcess")
Value = TypeVar("Value")


class HostKeeper(Generic[Host]):
    """Owner of one isolated process.

    `make` takes a memory limit in bytes; `memory` is in MB (default: a fraction of the machine's). Text that nobody
    read joins `left` at the end.
    """

    def __init__(
        self, make: Callable[[float], Host], memory: float | None = None, left: list[str] | None = None
    ) -> None:
        self._make = make
        fraction = psutil.virtual_memory().total / (2 * (os.cpu_count() or 1))
        self._memory = 1e6 * memory if memory else max(1e9, fraction)  # bytes
        self._hosts: list[Host] = []  # at most one, in a list that outlives the keeper
        self._text = ""
        weakref.finalize(self, _shut, self._hosts, left)

    def host(self, begin: Callable[[Host], None] = lambda _: None) -> Host:
        """Return the process; `begin` gives a new one its first orders.

        Raises `HostExitError` if it ends over them again and again.
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
        """Forget a process that has ended, and return it."""
        if not self._hosts:
            return None
        host = self._hosts.pop()
        self._text += host.printed()
        return host

    def strike(self) -> None:
        """Kill the process; the thread that waits for it cleans up."""
        for host in self._hosts[:]:
            if host.alive:
                host.strike()

    def replace(self) -> None:
        """End the process; the next use starts a new one."""
        if self._hosts:
            self._hosts[0].close()
            self.bury()

    def replace_outgrown(self) -> None:
        """End the process if it has grown."""
        if self._hosts and self._hosts[0].outgrown():
            self.replace()

    def printed(self) -> str:
        """Return and forget the printed text."""
        text, self._text = self._text, ""
        return text + (self._hosts[0].printed() if self._hosts else "")


def _shut(hosts: list[Any], left: list[str] | None) -> None:
    for host in hosts:
        host.close()
        if left is not None:
            left.extend(filter(None, [host.printed()]))
    hosts.clear()


class IsolatedCaller:
    """Function calls in one isolated process, or in this one without `AVAILABLE`.

    The process starts with the first call. Times are in s, memory is in MB (default: half of the machine's).
    """

    def __init__(self, time_limit: float, memory: float | None = None) -> None:
        self._time_limit, self._memory = time_limit, memory
        self._lock = threading.Lock()
        self._told: set[str] = set()
        self._keeper: HostKeeper[HostProcess] | None = None

    def call(self, function: Callable[..., Value], *arguments: Any, time_limit: float | None = None) -> Value:
        """Call a function of a module, and return its value.

        Arguments are pickled; the value is of the types of `channel.answer_parts`. A lost process raises
        `HostExitError`; the next call has a new one.
        """
        if not AVAILABLE:
            return function(*arguments)
        limit = time_limit or self._time_limit
        with self._lock:
            keeper = self._keeper = self._keeper or self._new_keeper()
            value = keeper.host().call(function, *arguments, watchdog=Watchdog(limit))
            keeper.replace_outgrown()
            keeper.printed()  # nobody reads messages of libraries about damaged files
            return value

    def _new_keeper(self) -> HostKeeper[HostProcess]:
        from fmuid.processes.host import HostProcess  # Linux and macOS only

        memory = self._memory or psutil.virtual_memory().total / 2e6
        return HostKeeper(lambda limit: HostProcess((), limit, self._told), memory)
