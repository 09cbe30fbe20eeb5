"""Work in a thread of which only the newest matters."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Asked = TypeVar("Asked")


class Newest(Generic[Asked]):
    """Does what it was asked for last: what is asked for while it works replaces what waits.

    Parameters
    ----------
    work : callable
        Called in the thread with what was asked for; it raises nothing.
    """

    def __init__(self, work: Callable[[Asked], object]) -> None:
        self._work, self._waiting, self._closed = work, list[Asked](), False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, what: Asked) -> None:
        """Have something done as soon as what is being done is."""
        with self._changed:
            self._waiting[:] = [what]
            self._changed.notify()

    def close(self) -> None:
        """Do nothing more."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                what = self._waiting.pop()
            self._work(what)
