"""The near side of isolation: fork server and hosts."""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import logging
import mmap
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import psutil

from fmuid.errors import FmuidError
from fmuid.processes import cgroup
from fmuid.processes.channel import TOKEN_BYTES, Channel, GarbledError, answer_of, order_parts
from fmuid.processes.children import MEMORY_KEPT, Child
from fmuid.processes.limits import (
    Footprint,
    HostExitError,
    ProcessEnd,
    Watchdog,
    condition_of,
    family,
    numbered,
    strike,
)


@dataclass(frozen=True)
class HostLimits:
    """Times and sizes of isolated processes and of their server."""

    closing: float = 2.0  # s for freeing instances before a kill
    starts: int = 6  # attempts: the server may be killed while it loads
    ending: float = 2.0  # s for the end of a process after it closed its socket
    answer: float = 120.0  # s for an answer of the server, which may load code
    look: float = 0.1  # s between checks of a process that owes an answer
    growth: float = 256e6
    """Bytes beyond the size after the first call at which a process is replaced: far above the caches of sound code."""
    measure: float = 0.25  # s between checks of its memory
    printed_kept: int = 1 << 16  # bytes of unread output that are kept: 1000 lines
    printed_largest: int = 1 << 20  # bytes of output in the file before it is cut
    relatives: int = 100  # processes below it, ended ones included


LIMITS = HostLimits()

Value = TypeVar("Value")


class ForkServer:
    """Server of this process (`fmuid.processes.server`), started at its first use."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._channel: socket.socket | None = None
        self._process: Child | None = None
        self._owner, self._loaded, self._asking = 0, False, False

    def start(self, *modules: str) -> socket.socket:
        """Start the server if there is none; it loads its modules meanwhile."""
        with self._lock:
            if self._channel is not None and self._owner == os.getpid():
                return self._channel
            self._owner, self._loaded = os.getpid(), False
            self._channel, other = socket.socketpair()
            self._process = Child(
                "fmuid.processes.server",
                str(other.fileno()),
                *modules,
                stdin=subprocess.DEVNULL,  # its socket is its lifeline
                pass_fds=[other.fileno()],
                environment={"OPENBLAS_NUM_THREADS": "1", **MEMORY_KEPT},
            )
            other.close()
            return self._channel

    def fork(self, modules: Sequence[str], descriptors: Sequence[int]) -> tuple[int, Path | None]:
        """Return process id and control group of a new host."""
        for _ in range(LIMITS.starts):
            with self._lock:
                try:
                    found = self._ask("fork", list(modules), descriptors=descriptors)
                except (EOFError, ConnectionError):
                    continue  # killed or stopped from outside: try again
                self._loaded = True
                if isinstance(found, str):
                    raise FmuidError(f"no isolated process can be made: {found}")
                pid, group = found
                return pid, group and Path(group)
        raise FmuidError(
            f"{sys.executable} -m fmuid.processes.server, which starts isolated processes, ends again "
            "and again as soon as it begins: have FMUs run inside this process"
        )

    def status(self, pid: int) -> int | None:
        """Return the exit status of a host; None if unknown."""
        with self._lock:
            if self._channel is None or self._asking:  # called by garbage collection during another order
                return None
            try:
                status: int | None = self._ask("wait", pid, LIMITS.ending)
            except (EOFError, ConnectionError):
                return None
            return status

    def _ask(self, *order: object, descriptors: Sequence[int] = ()) -> Any:
        """Give an order and return the answer; an interruption or a long silence ends the server with all hosts."""
        self._asking = True
        try:
            channel = self.start()
            socket.send_fds(channel, [pickle.dumps(order)], list(descriptors))
            _, parts = Channel(channel, LIMITS.look).receive(partial(self._look, Watchdog(LIMITS.answer)))
            return answer_of(parts)
        except GarbledError as error:
            self.stop(0.0)
            raise EOFError from error
        except BaseException:
            self.stop()
            raise
        finally:
            self._asking = False

    def _look(self, watchdog: Watchdog) -> None:
        """End a server that does not answer."""
        assert self._process is not None, "it owes an answer"
        condition = condition_of(self._process.pid)
        if condition.status == psutil.STATUS_ZOMBIE or watchdog.end(condition) is not None:
            self.stop(0.0)
            raise EOFError

    def stop(self, patience: float = LIMITS.closing) -> None:
        """End the server and all hosts."""
        with self._lock:
            if self._channel is not None:
                self._channel.close()
            if self._process is not None and self._owner == os.getpid():
                self._process.end(patience if self._loaded else 0.0)
            self._channel = self._process = None


SERVER = ForkServer()
atexit.register(SERVER.stop)


class HostProcess:
    """One isolated process with the given modules loaded.

    `memory_limit` is in bytes, for its whole `family`. Texts in `told` are not logged again; without `told`, none is.
    `sent` is the size of the large arrays of the last order, bytes.
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
        self._channel, self._footprint = Channel(own, LIMITS.look), Footprint(self.pid, self._group)
        self.sent = 0

    def share(self, size: int) -> mmap.mmap:
        """Return the shared memory, of a new size in bytes."""
        with refusals():
            os.ftruncate(self._file, size)
            self._memory = mmap.mmap(self._file, size)
        return self._memory

    def call(self, function: Callable[..., Value], *arguments: Any, watchdog: Watchdog) -> Value:
        """Call a function of a module in the process.

        Arguments are pickled; the value is of the types of `channel.answer_parts`. Errors: `HostExitError` if the
        process ends, and those of the function.
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
            raise self.stopped(HostExitError(ProcessEnd.GARBLED, 0)) from None
        except BaseException:  # half a message may be sent
            self.kill()
            raise
        self.pass_on(said)
        if failed:
            raise self.failure(answer)
        value: Value = answer
        return value

    def _look(self, watchdog: Watchdog) -> None:
        """End the process if it is over a limit."""
        condition = condition_of(self.pid)
        if condition.status == psutil.STATUS_ZOMBIE:  # a process that it forked keeps the socket open
            raise self._ended()
        end = watchdog.end(condition)
        if end is not None:
            raise self.stopped(end)
        if self._footprint.exceeds(self._limit + self.given):
            raise self.stopped(HostExitError(ProcessEnd.GREW, round(self._limit / 1e6)))
        if os.fstat(self._printed).st_size > LIMITS.printed_largest:
            self._read_printed()

    @property
    def given(self) -> float:
        """Memory that `fmuid` itself has given it, bytes; it does not count."""
        return float(len(self._memory))

    def outgrown(self) -> bool:
        """Return whether it has grown too much since the first look."""
        now = time.monotonic()
        if self._baseline and now - self._measured < LIMITS.measure:
            return False
        self._measured = now
        if not self._baseline:
            self._baseline = max(1.0, self._footprint.read() - self.given)
        grown = self._footprint.exceeds(self._baseline + LIMITS.growth + self.given)
        return grown or len(family(self.pid)) > LIMITS.relatives

    def stopped(self, end: HostExitError) -> HostExitError:
        """Kill it, and return its end."""
        self.kill()
        return end

    def _ended(self) -> HostExitError:
        status = SERVER.status(self.pid)
        self.kill()
        code = -signal.SIGKILL if status is None else os.waitstatus_to_exitcode(status)
        if code >= 0:
            return HostExitError(ProcessEnd.EXITED, code)
        return HostExitError(ProcessEnd.KILLED if -code == signal.SIGKILL else ProcessEnd.CRASHED, -code)

    @property
    def alive(self) -> bool:
        """Whether this process made it, not a parent, and it is open."""
        return self._owner == os.getpid() and self._channel.open

    @property
    def gone(self) -> bool:
        """Whether it has ended since its last call."""
        return self._channel.at_end

    def close(self) -> None:
        """End it between two calls."""
        self.kill()

    def strike(self) -> None:
        """Kill it and its group, unless another process has its number; so after the server was killed."""
        if numbered(self.pid) in (self._numbered, None):
            strike(self.pid)

    def kill(self) -> None:
        """End it at once; its printed text stays readable."""
        if not self.alive:
            return
        self.strike()
        cgroup.kill(self._group)  # a killed server cannot end these
        self._channel.close()
        SERVER.status(self.pid)
        cgroup.remove(self._group)
        self._read_printed()
        os.close(self._file)
        os.close(self._printed)

    def printed(self) -> str:
        """Return and forget the printed text."""
        if self.alive:
            self._read_printed()
        text, self._text = self._text, ""
        return text

    def _read_printed(self) -> None:
        size = os.fstat(self._printed).st_size
        if not size:
            return
        data = os.pread(self._printed, LIMITS.printed_kept, 0)
        os.ftruncate(self._printed, 0)
        lost = "" if size <= LIMITS.printed_kept else f"\n[{size - LIMITS.printed_kept} bytes more]\n"
        room = max(0, LIMITS.printed_kept - len(self._text))
        self._text += (data.decode("utf-8", errors="replace") + lost)[:room]

    def failure(self, error: Exception) -> Exception:
        """Return the error to raise for an error of the called function."""
        return error

    def pass_on(self, said: list[tuple[str, int, str]]) -> None:
        """Log messages of the other side, each text once."""
        for logger, level, text in said:
            if self._told is not None and text not in self._told:
                self._told.add(text)
                logging.getLogger(logger).log(level, "%s", text)


def _reply(answer: Any) -> tuple[bool, Any, list[tuple[str, int, str]]]:
    """Return failure flag, error or value, and log of an answer, checked."""
    try:
        failed, value, said = answer
        sound = [(str(logger), int(level), str(text)) for logger, level, text in said]
    except (TypeError, ValueError):
        raise GarbledError from None
    if type(failed) is not bool or (failed and not isinstance(value, Exception)):
        raise GarbledError
    return failed, value, sound


def _file(made: contextlib.ExitStack, name: str) -> int:
    """Return the descriptor of a file in memory."""
    if hasattr(os, "memfd_create"):
        found = os.memfd_create(f"fmuid-{name}")
    else:
        with tempfile.TemporaryFile() as file:
            found = os.dup(file.fileno())
    made.callback(os.close, found)
    return found


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Raise a refusal of the system as one sentence."""
    try:
        yield
    except OSError as error:
        raise FmuidError(
            f"the system refuses what an isolated process needs ({error.strerror}): "
            "free some of it, or have FMUs run inside this process"
        ) from error
