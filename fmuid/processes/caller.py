"""Functions called in an isolated process: a crash, a hang or runaway memory costs one call."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

from fmuid.processes.children import AVAILABLE
from fmuid.processes.limits import Watchdog

Value = TypeVar("Value")


class IsolatedCaller:
    """Calls functions in one isolated process, which begins with the first call and ends with this one.

    Where the platform has no such processes (`AVAILABLE`), functions are called in this one.

    Parameters
    ----------
    time_limit : float
        How long a call may take, s.
    memory : float, optional
        What the process may take, MB; default: half of the machine's, since one call works at a time.
    """

    def __init__(self, time_limit: float, memory: float | None = None) -> None:
        self._time_limit, self._memory = time_limit, memory
        self._lock = threading.Lock()
        self._told: set[str] = set()
        self._keeper: Any = None

    def call(self, function: Callable[..., Value], *arguments: Any, time_limit: float | None = None) -> Value:
        """Call a function of a module, which the process imports by its name; return the value.

        Parameters
        ----------
        function : callable
        arguments
            What can be pickled.
        time_limit : float, optional
            How long this call may take, s; default: as every call.

        Returns
        -------
        object
            Of types that answers have: numbers, texts, datetimes, arrays of them, lists, tuples and dicts.

        Raises
        ------
        End
            If the process was lost over it; the next call has a new one.
        Exception
            What the function raises: an error of Python or fmuid, of other packages the nearest base among these.
        """
        if not AVAILABLE:
            return function(*arguments)
        limit = time_limit or self._time_limit
        with self._lock:
            keeper = self._keeper = self._keeper or self._kept()
            value: Value = keeper.host().call(function, *arguments, watchdog=Watchdog(limit))
            keeper.replace_outgrown()
            keeper.printed()  # what libraries print about damaged files is nobody's news
            return value

    def _kept(self) -> Any:
        import psutil

        from fmuid.processes.host import HostProcess  # for Linux and macOS only
        from fmuid.processes.keeper import HostKeeper

        memory = self._memory or psutil.virtual_memory().total / 2e6
        return HostKeeper(lambda limit: HostProcess((), limit, self._told), memory)
