"""Ctrl-C, SIGTERM and SIGHUP on the command line: all mean to keep what there is and stop; the first is answered."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from types import FrameType

# One request comes as several signals: `timeout` and some schedulers send to a process and to its group.
_ONE_REQUEST = 1.0  # s
# SIGTERM comes from schedulers, SIGHUP from a terminal that is closed: nobody is there to wait for what follows.
_ENDING = (signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
_SIGNALS = (signal.SIGINT, *_ENDING)


class _Interruption:
    """What has been asked for by signals, and what is answered."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Forget what was asked for."""
        self.answer, self.stopping = "", False
        self._last = -_ONE_REQUEST

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: answer, and raise KeyboardInterrupt for whoever keeps what there is."""
        now = time.monotonic()
        if now - self._last < _ONE_REQUEST or (self.stopping and number in _ENDING):
            return
        self.stopping = self.stopping or number in _ENDING
        self._last = now
        if self.answer:
            _say(f"interrupted: {self.answer}")
            self.answer = ""
        raise KeyboardInterrupt


_interruption = _Interruption()


@contextlib.contextmanager
def handled() -> Iterator[None]:
    """Handle Ctrl-C, SIGTERM and SIGHUP; signals that the process was started to ignore stay ignored."""
    _interruption.begin()
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _interruption.handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _interruption.begin()


@contextlib.contextmanager
def answering(answer: str) -> Iterator[None]:
    """Have the first signal answered by what is still done then, as it is read after ``interrupted: ``."""
    _interruption.answer = answer
    try:
        yield
    finally:
        _interruption.answer = ""


def stopping() -> bool:
    """Return whether SIGTERM or SIGHUP has come: it leaves out all that follows, Ctrl-C only what is being done."""
    return _interruption.stopping


def _say(sentence: str) -> None:
    try:
        print(sentence, file=sys.stderr, flush=True)
    except RuntimeError:  # the signal came while something else was being written there
        with contextlib.suppress(OSError):
            os.write(2, f"{sentence}\n".encode())
