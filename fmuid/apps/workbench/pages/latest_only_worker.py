"""Work in a thread of which only the newest matters."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Asked = TypeVar("Asked")


class LatestOnlyWorker(Generic[Asked]):
    """Does what it was asked for last: what is asked for while it works replaces what waits.

    Parameters
    ----------
    work : callable
        Called in the thread with what was asked for; it raises nothing.
    interrupt : callable, optional
        Called in another thread to have `work` return early.
    release : callable, optional
        Called in the thread at its end.
    """

    def __init__(
        self,
        work: Callable[[Asked], object],
        interrupt: Callable[[], object] = lambda: None,
        release: Callable[[], object] = lambda: None,
    ) -> None:
        self._work, self._interrupt, self._release = work, interrupt, release
        self._waiting, self._is_working, self._closed = list[Asked](), False, False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, what: Asked) -> None:
        """Have something done as soon as what is being done is."""
        with self._changed:
            self._waiting[:] = [what]
            self._changed.notify()

    def close(self) -> None:
        """End the work and the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
            if self._is_working:
                self._interrupt()

    def _run(self) -> None:
        while (what := self._next()) is not None:
            self._work(what[0])
        self._release()

    def _next(self) -> tuple[Asked] | None:
        """Wait for what is asked for next; None at the end."""
        with self._changed:
            self._is_working = False
            self._changed.wait_for(lambda: self._waiting or self._closed)
            self._is_working = not self._closed
            return None if self._closed else (self._waiting.pop(),)
