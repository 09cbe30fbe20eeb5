"""Commands as processes that are interrupted."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fmuid.apps.cli import main

OTHERS = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
SIGNALS = [signal.SIGINT, *(pytest.param(each, marks=pytest.mark.slow) for each in OTHERS)]


def command(*words: str | Path) -> int:
    """Run a command as a process does, and return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    return int(str(ended.value.code))


def killing(number: int, when: Callable[..., bool], what: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that sends a signal to this process before the first call for which `when` holds."""
    sent: list[int] = []

    def function(*arguments: Any, **words: Any) -> Any:
        if not sent and when(*arguments):
            sent.append(number)
            os.kill(os.getpid(), number)
        return what(*arguments, **words)

    return function
