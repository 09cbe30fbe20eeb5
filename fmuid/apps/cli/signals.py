"""What comes from outside a command: Ctrl-C, SIGTERM, SIGHUP; closed pipes and terminals; a full disk.

Signals all mean to keep what there is and stop; the first is answered. No lost output ends a command.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, TextIO

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


# Nobody reads any more: a pipe whose reader has ended, a terminal that was closed.
_UNREAD = (errno.EPIPE, errno.EIO, errno.EBADF)


class Output:
    """A stream that raises no error; after the first one, what is written goes nowhere.

    Parameters
    ----------
    stream : TextIO or None
        None where the process was started without it.

    Attributes
    ----------
    lost : OSError or None
        Why something is missing from it that somebody would have read.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream: TextIO = open(os.devnull, "w", encoding="utf-8") if stream is None else stream  # noqa: PTH123, SIM115
        self.lost: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._leave(error)
        return len(text)

    def flush(self) -> None:
        """Write what waits."""
        try:
            self._stream.flush()
        except OSError as error:
            self._leave(error)

    def _leave(self, error: OSError) -> None:
        """Have the rest go nowhere, also what waits in the stream until the process ends."""
        if error.errno not in _UNREAD:
            self.lost = self.lost or error
        with contextlib.suppress(OSError, ValueError):  # a stream without a descriptor
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextlib.contextmanager
def guarded() -> Iterator[Output]:
    """Guard standard output and error, and provide the former."""
    before = sys.stdout, sys.stderr
    output, errors = Output(before[0]), Output(before[1])
    sys.stdout, sys.stderr = output, errors
    try:
        yield output
    finally:
        output.flush()
        errors.flush()
        sys.stdout, sys.stderr = before


def open_descriptors() -> None:
    """Open the standard descriptors that are closed, or a file would take their place and get what is printed."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest that is free, which is this one
