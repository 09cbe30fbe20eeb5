"""Ctrl-C, SIGTERM, SIGHUP save the results; closed pipes, terminals and full disks do not end a command."""

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

_ONE_REQUEST = 1.0  # s; `timeout` and some schedulers signal both a process and its group
# From schedulers and closed terminals: nobody waits for further work.
_ENDING = (signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
_SIGNALS = (signal.SIGINT, *_ENDING)


class _Interruption:
    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Reset the state."""
        self.answer, self.stopping = "", False
        self._last = -_ONE_REQUEST

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Answer a signal and raise KeyboardInterrupt."""
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
    """Handle Ctrl-C, SIGTERM and SIGHUP, except signals that were ignored before."""
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
    """Print an answer after ``interrupted: `` at the first signal."""
    _interruption.answer = answer
    try:
        yield
    finally:
        _interruption.answer = ""


def stopping() -> bool:
    """Return whether SIGTERM or SIGHUP came: they skip all later work."""
    return _interruption.stopping


def _say(sentence: str) -> None:
    try:
        print(sentence, file=sys.stderr, flush=True)
    except RuntimeError:  # the signal came during another write
        with contextlib.suppress(OSError):
            os.write(2, f"{sentence}\n".encode())


_UNREAD = (errno.EPIPE, errno.EIO, errno.EBADF)  # No reader: a closed pipe or terminal


class Output:
    """Stream that drops text after its first error; `lost` is the error that cost a reader text."""

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
        """Write buffered text."""
        try:
            self._stream.flush()
        except OSError as error:
            self._leave(error)

    def _leave(self, error: OSError) -> None:
        """Drop all later text, buffered text included."""
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
    """Open closed standard descriptors: a file would get the printed text."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free one, this one
