"""Standard output and error that end no command: a closed pipe, a closed terminal or a full disk behind them."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO

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
