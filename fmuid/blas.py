"""Linear algebra in one thread: threads slow down small products."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cache, wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Given = ParamSpec("Given")
Found = TypeVar("Found")


@cache
def _libraries() -> ThreadpoolController:
    """Return the controller of all BLAS libraries; NumPy and SciPy bring one each."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _let_go() -> None:
    """Let any thread change the limit next.

    Otherwise OpenBLAS obeys only the thread that changed it last.
    """
    from threadpoolctl import OpenBLASController

    OpenBLASController.clear_controlling_thread()


class _OneThread:
    """Context that limits BLAS to one thread, shared by all threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entered = 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._entered:
                self._limit = _libraries().limit(limits=1, user_api="blas")
                _let_go()
            self._entered += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._entered -= 1
            if not self._entered:
                self._limit.restore_original_limits()
                _let_go()


ONE_THREAD = _OneThread()
"""Context with one thread of BLAS, for results that do not depend on the machine.

The limit is that of the process, from the first entry to the last exit."""


def single_threaded(function: Callable[Given, Found]) -> Callable[Given, Found]:
    """Decorate a function to run with one thread of BLAS (`ONE_THREAD`)."""

    @wraps(function)
    def inside(*given: Given.args, **words: Given.kwargs) -> Found:
        with ONE_THREAD:
            return function(*given, **words)

    return inside
