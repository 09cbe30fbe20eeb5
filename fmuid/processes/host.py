"""The near side of `service`: one isolated process with its memory, watched while it works."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import mmap
import os
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import psutil

from fmuid.errors import FmuidError
from fmuid.processes import cgroup
from fmuid.processes.channel import TOKEN_BYTES, Channel
from fmuid.processes.ends import CRASHED, EXITED, GARBLED, GREW, KILLED, HostExitError
from fmuid.processes.family import Footprint, condition_of, family, numbered
from fmuid.processes.fork_server import SERVER
from fmuid.processes.messages import GarbledError, answer_of, order_parts
from fmuid.processes.watchdog import Watchdog

LARGEST_GROWTH = 256e6
"""Growth of a process beyond its size after its first call at which it is replaced, bytes.

Far above what buffers and caches of sound code take up, far below what a machine of today has for each processor.
"""

LOOK_SECONDS = 0.1  # between looks whether all is well with a process that works
PRINTED_KEPT_BYTES = 1 << 16  # of what it prints that are kept until they are read: a thousand lines
PRINTED_LARGEST_BYTES = 1 << 20  # that may pile up in the file before it is cut
MOST_RELATIVES = 100  # processes below it, also ended ones, for which nobody there waits
MEASURE_SECONDS = 0.25  # between looks at its memory while calls come and go

Value = TypeVar("Value")


class HostProcess:
    """One isolated process.

    Parameters
    ----------
    modules : sequence of str
        What it needs to have loaded.
    memory_limit : float
        How much memory it may take with all that it starts, bytes (`family`).
    told : set of str, optional
        What was logged, and is not to be logged again; default: nothing that it logs is.

    Attributes
    ----------
    pid : int
    sent : int
        Bytes of the large arrays of the last order.
    """

    def __init__(self, modules: Sequence[str], memory_limit: float, told: set[str] | None = None) -> None:
        self._owner, self._told = os.getpid(), told
        self._limit = memory_limit
        self._baseline, self._measured = 0.0, 0.0
        self._text = ""
        with contextlib.ExitStack() as made, refusals():
            self._file, self._printed = (_file(made, name) for name in ("memory", "printed"))
            os.set_blocking(self._printed, True)
            fcntl.fcntl(self._printed, fcntl.F_SETFL, fcntl.fcntl(self._printed, fcntl.F_GETFL) | os.O_APPEND)
            self._memory = self.share(mmap.PAGESIZE)
            own, other = socket.socketpair()
            made.callback(own.close)
            with other:
                self.pid, self._group = SERVER.fork(modules, [other.fileno(), self._file, self._printed])
            made.pop_all()
        self._numbered = numbered(self.pid)
        self._channel, self._footprint = Channel(own, LOOK_SECONDS), Footprint(self.pid, self._group)
        self.sent = 0

    def share(self, size: int) -> mmap.mmap:
        """Return the memory that both sides share, of a new size in bytes."""
        with refusals():
            os.ftruncate(self._file, size)
            self._memory = mmap.mmap(self._file, size)
        return self._memory

    def call(self, function: Callable[..., Value], *arguments: Any, watchdog: Watchdog) -> Value:
        """Have it call a function; return the value.

        Parameters
        ----------
        function : callable
            A function of a module, which the process imports by its name.
        arguments
            What can be pickled.
        watchdog : Watchdog
            How long it may take.

        Returns
        -------
        object
            The value of the function, of types that answers have (`fmuid.processes.messages.answer_parts`).

        Raises
        ------
        End
            If the process comes to an end over it; it is gone then.
        Exception
            What the function raises.
        """
        look, token = partial(self._look, watchdog), os.urandom(TOKEN_BYTES)
        try:
            order = order_parts((function.__module__, function.__qualname__, arguments))
            self.sent = sum(memoryview(part).nbytes for part in order[1:])
            self._channel.send(order, token, look)
            _, parts = self._channel.receive(look, token, self._limit)
            failed, answer, said = _reply(answer_of(parts))
        except EOFError:
            raise self._ended() from None
        except GarbledError:
            raise self.stopped(HostExitError(GARBLED, 0)) from None
        except BaseException:  # half a message may be on its way
            self.kill()
            raise
        self.pass_on(said)
        if failed:
            raise self.failure(answer)
        value: Value = answer
        return value

    def _look(self, watchdog: Watchdog) -> None:
        """See whether all is well while it works; what is not ends it."""
        condition = condition_of(self.pid)
        if condition.status == psutil.STATUS_ZOMBIE:  # and somebody whom it forked keeps the socket open
            raise self._ended()
        end = watchdog.end(condition)
        if end is not None:
            raise self.stopped(end)
        if self._footprint.exceeds(self._limit + self.given):
            raise self.stopped(HostExitError(GREW, round(self._limit / 1e6)))
        if os.fstat(self._printed).st_size > PRINTED_LARGEST_BYTES:
            self._read_printed()

    @property
    def given(self) -> float:
        """What of its memory `fmuid` itself has given it, bytes: the called code does not answer for that."""
        return float(len(self._memory))

    def outgrown(self) -> bool:
        """Whether it is to be replaced, because it has grown since the first time that this was asked."""
        now = time.monotonic()
        if self._baseline and now - self._measured < MEASURE_SECONDS:
            return False
        self._measured = now
        if not self._baseline:
            self._baseline = max(1.0, self._footprint.read() - self.given)
        grown = self._footprint.exceeds(self._baseline + LARGEST_GROWTH + self.given)
        return grown or len(family(self.pid)) > MOST_RELATIVES

    def stopped(self, end: HostExitError) -> HostExitError:
        """Kill it; return how it came to its end."""
        self.kill()
        return end

    def _ended(self) -> HostExitError:
        status = SERVER.status(self.pid)
        self.kill()
        if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
            return HostExitError(KILLED, signal.SIGKILL)
        return (
            HostExitError(CRASHED, os.WTERMSIG(status))
            if os.WIFSIGNALED(status)
            else HostExitError(EXITED, os.WEXITSTATUS(status))
        )

    @property
    def alive(self) -> bool:
        """Whether it can be given orders: it was made by this process (not by the one it is a fork of) and lives."""
        return self._owner == os.getpid() and self._channel.open

    def close(self) -> None:
        """End it when it is at rest."""
        self.kill()

    def strike(self) -> None:
        """Kill it with whatever it has started itself, but nobody else who has its number by now.

        That can be where the server was killed and the host with it: nobody keeps its number then.
        """
        if numbered(self.pid) not in (self._numbered, None):
            return
        for end in (os.kill, os.killpg):
            with contextlib.suppress(ProcessLookupError, PermissionError):  # gone meanwhile
                end(self.pid, signal.SIGKILL)

    def kill(self) -> None:
        """End it at once; what was printed can be read still."""
        if not self.alive:
            return
        self.strike()
        cgroup.kill(self._group)  # also what the server, if it was killed, can no longer end
        self._channel.close()
        SERVER.status(self.pid)
        cgroup.remove(self._group)
        self._read_printed()
        os.close(self._file)
        os.close(self._printed)

    def printed(self) -> str:
        """Return and forget what was printed."""
        if self.alive:
            self._read_printed()
        text, self._text = self._text, ""
        return text

    def _read_printed(self) -> None:
        size = os.fstat(self._printed).st_size
        if not size:
            return
        data = os.pread(self._printed, PRINTED_KEPT_BYTES, 0)
        os.ftruncate(self._printed, 0)
        lost = "" if size <= PRINTED_KEPT_BYTES else f"\n[{size - PRINTED_KEPT_BYTES} bytes more]\n"
        room = max(0, PRINTED_KEPT_BYTES - len(self._text))
        self._text += (data.decode("utf-8", errors="replace") + lost)[:room]

    def failure(self, error: Exception) -> Exception:
        """Return what a call raises whose function has raised an error."""
        return error

    def pass_on(self, said: list[tuple[str, int, str]]) -> None:
        """Log what was logged on the other side, each text once."""
        for logger, level, text in said if self._told is not None else ():
            if self._told is not None and text not in self._told:
                self._told.add(text)
                logging.getLogger(logger).log(level, "%s", text)


def _reply(answer: Any) -> tuple[bool, Any, list[tuple[str, int, str]]]:
    """Check the form of an answer: whether the function failed, its error or value, and what was logged."""
    try:
        failed, value, said = answer
        sound = [(str(logger), int(level), str(text)) for logger, level, text in said]
    except (TypeError, ValueError):
        raise GarbledError from None
    if type(failed) is not bool or (failed and not isinstance(value, Exception)):
        raise GarbledError
    return failed, value, sound


def _file(made: contextlib.ExitStack, name: str) -> int:
    """Return the descriptor of a file in memory that goes with the processes that hold it."""
    if hasattr(os, "memfd_create"):
        found = os.memfd_create(f"fmuid-{name}")
    else:
        with tempfile.TemporaryFile() as file:
            found = os.dup(file.fileno())
    made.callback(os.close, found)
    return found


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Say in one sentence what the system refuses this process."""
    try:
        yield
    except OSError as error:
        raise FmuidError(
            f"the system refuses what an isolated process needs ({error.strerror}): "
            "free some of it, or have FMUs run inside this process"
        ) from error
