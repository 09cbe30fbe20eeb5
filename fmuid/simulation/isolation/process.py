"""The near side of `server`: one host with its memory, watched while it works."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import mmap
import os
import signal
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import psutil

from fmuid.arrays import Indices
from fmuid.errors import FmuidError
from fmuid.fmi import codes
from fmuid.simulation.isolation import cgroup
from fmuid.simulation.isolation import server as far
from fmuid.simulation.isolation.channel import Channel, GarbledError, pass_on
from fmuid.simulation.isolation.ends import CRASHED, EXITED, GARBLED, GREW, HUNG, KILLED, REFUSED, End
from fmuid.simulation.isolation.family import Condition, Footprint, condition_of, family, numbered, wants_processor
from fmuid.simulation.isolation.fork_server import CLOSING_LIMIT, SERVER

LARGEST_GROWTH = 256e6
"""Growth of a process beyond its size after its first simulations at which it is replaced, bytes.

Far above what buffers and caches of a sound FMU take up, far below what a machine of today has for each processor.
"""

PREPARATION_LIMIT = 120.0  # s for instantiation and loading code: some FMUs read large files
LOOK_SECONDS = 0.1  # between looks whether all is well with a host that works
PRINTED_KEPT_BYTES = 1 << 16  # of what FMUs print that are kept until they are read: a thousand lines
PRINTED_LARGEST_BYTES = 1 << 20  # that may pile up in the file before it is cut
MOST_RELATIVES = 100  # processes below it, also ended ones, for which nobody there waits
MEASURE_SECONDS = 0.25  # between looks at its memory while simulations come and go
STANDSTILL_SECONDS = 0.5  # between looks at which this process has stood still, and the machine with it
COMPUTED_SHARE = 0.5  # of a time limit: what computes for less than that is not hung but waits for a processor


@dataclass
class _Progress:
    """How long a host has done the same: `limit`, `idle_limit` and `reports` as `Host.order` has them.

    Time limits are by the clock, but a busy machine is not charged to a simulation: neither the time in which this
    process stood still, nor that in which the host waited for a processor.
    """

    limit: float
    idle_limit: float | None
    reports: Indices | None
    since: float = field(default_factory=time.monotonic)
    looked: float = math.inf
    computed: float = 0.0
    state: tuple[bytes, int] | None = None

    def limit_passed(self, doing: Indices, condition: Condition) -> float | None:
        """Return the limit that has passed, s, if one has."""
        undone = 0 if self.reports is None else int((self.reports[:, 2] == codes.UNDONE).sum())
        state, now = (doing.tobytes(), undone), time.monotonic()
        self.since += max(0.0, now - self.looked - STANDSTILL_SECONDS)
        self.looked = now
        if state != self.state:
            self.state, self.since, self.computed = state, now, condition.computed
        preparing = (doing[::2] == codes.PREPARING).any() and condition.status != psutil.STATUS_STOPPED
        allowed = max(self.limit, PREPARATION_LIMIT) if preparing else self.limit
        if self.idle_limit is not None and not doing[::2].any():
            allowed = self.idle_limit
        if now - self.since <= allowed:
            return None
        waits = condition.computed - self.computed < COMPUTED_SHARE * allowed and wants_processor(condition.pid)
        return None if waits else allowed


class Host:
    """One process that runs the FMUs of one system.

    Parameters
    ----------
    modules : sequence of str
        What it needs to have loaded.
    memory_limit : float
        How much memory it may take with all that it starts, bytes (`family`).
    told : set of str, optional
        What was logged, and is not to be logged again; default: all is.

    Attributes
    ----------
    doing : (`host.DOING_WORDS`,) array of intp
        What each of its threads is doing, and how often it has begun.
    simulations : int
        How many it was given.
    records : dict of int to int
        Bytes of the large arrays of each run that it knows.
    sent : int
        Bytes of the large arrays of the last order.
    """

    def __init__(self, modules: Sequence[str], memory_limit: float, told: set[str] | None = None) -> None:
        self._owner, self._told = os.getpid(), told
        self._limit = memory_limit
        self.simulations, self.baseline, self._measured = 0, 0.0, 0.0
        self._text = ""
        with contextlib.ExitStack() as made, _refusals():
            self._file, self._printed = (_file(made, name) for name in ("memory", "printed"))
            os.set_blocking(self._printed, True)
            fcntl.fcntl(self._printed, fcntl.F_SETFL, fcntl.fcntl(self._printed, fcntl.F_GETFL) | os.O_APPEND)
            self._memory, self.doing = self._mapped(8 * far.DOING_WORDS)
            own, other = socket.socketpair()
            made.callback(own.close)
            with other:
                self.pid, self._group = SERVER.fork(modules, [other.fileno(), self._file, self._printed])
            made.pop_all()
        self._numbered = numbered(self.pid)
        self._channel, self._footprint = Channel(own, LOOK_SECONDS), Footprint(self.pid, self._group)
        self.records: dict[int, int] = {}
        self.sent = 0

    def _mapped(self, size: int) -> tuple[mmap.mmap, Indices]:
        os.ftruncate(self._file, size)
        memory = mmap.mmap(self._file, size)
        return memory, np.frombuffer(memory, np.intp, far.DOING_WORDS)

    @property
    def states(self) -> Indices:
        """What each of its threads is doing."""
        return self.doing[::2]

    def room(self, shape: tuple[int, int, int, int]) -> tuple[far.Arrays, int]:
        """Return reports, thetas and outputs in shared memory that is large enough, and its size."""
        needed = far.layout(*shape)[-1]
        if needed > len(self._memory):
            with _refusals():
                self._memory, self.doing = self._mapped(needed)
        return far.arrays(self._memory, shape), len(self._memory)

    def order(
        self,
        name: str,
        *arguments: Any,
        limit: float,
        reports: Indices | None = None,
        idle_limit: float | None = None,
    ) -> Any:
        """Give an order and return the answer.

        Parameters
        ----------
        limit : float
            How long it may take until a thread begins with something else, or one more report is done, s.
        reports : (m, codes.REPORT) array, optional
        idle_limit : float, optional
            How long it may take while all threads are idle, s; default: `limit`.

        Raises
        ------
        End
            If the host comes to an end over it; it is gone then.
        """
        look = partial(self._look, _Progress(limit, idle_limit, reports))
        try:
            self.sent = self._channel.send((name, *arguments), look)
            kind, answer, said = self._channel.receive(look)
        except EOFError:
            raise self._ended() from None
        except GarbledError:
            raise self._stopped(GARBLED, 0) from None
        except BaseException:  # half a message may be on its way
            self.kill()
            raise
        pass_on(said, self._told)
        if kind != "error":
            return answer
        if isinstance(answer, OSError | MemoryError):
            raise self._stopped(REFUSED, getattr(answer, "errno", errno.ENOMEM) or 0)
        raise answer

    def _look(self, progress: _Progress) -> None:
        """See whether all is well while it works; what is not ends it."""
        condition = condition_of(self.pid)
        if condition.status == psutil.STATUS_ZOMBIE:  # and somebody whom it forked keeps the socket open
            raise self._ended()
        over = progress.limit_passed(self.doing, condition)
        if over is not None:
            raise self._stopped(HUNG, round(1e3 * over))
        if self._footprint.exceeds(self._limit + self._given):
            raise self._stopped(GREW, round(self._limit / 1e6))
        self._cut_printed()

    @property
    def _given(self) -> float:
        """What of its memory `fmuid` itself has given it, bytes: it is not the FMU's."""
        return len(self._memory) + sum(self.records.values())

    def outgrown(self, recycle: int | None) -> bool:
        """Whether it is to be replaced: after so many simulations, or because it has grown since the first of them."""
        if recycle is not None and self.simulations >= recycle:
            return True
        now = time.monotonic()
        if self.baseline and now - self._measured < MEASURE_SECONDS:
            return False
        self._measured = now
        if not self.baseline:
            self.baseline = max(1.0, self._footprint.read() - self._given)
        grown = self._footprint.exceeds(self.baseline + LARGEST_GROWTH + self._given)
        return grown or len(family(self.pid)) > MOST_RELATIVES

    def _stopped(self, kind: int, number: int) -> End:
        self.kill()
        return End(kind, number)

    def _ended(self) -> End:
        status = SERVER.status(self.pid)
        self.kill()
        if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
            return End(KILLED, signal.SIGKILL)
        return End(CRASHED, os.WTERMSIG(status)) if os.WIFSIGNALED(status) else End(EXITED, os.WEXITSTATUS(status))

    @property
    def alive(self) -> bool:
        """Whether it can be given orders: it was made by this process (not by the one it is a fork of) and lives."""
        return self._owner == os.getpid() and self._channel.open

    def close(self) -> None:
        """Let it free its instances and end it."""
        if self.alive:
            with contextlib.suppress(End):  # it is killed below either way
                self.order("close", limit=CLOSING_LIMIT)
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

    def _cut_printed(self) -> None:
        if os.fstat(self._printed).st_size > PRINTED_LARGEST_BYTES:
            self._read_printed()


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
def _refusals() -> Iterator[None]:
    """Say in one sentence what the system refuses this process."""
    try:
        yield
    except OSError as error:
        raise FmuidError(
            f"the system refuses what the process of an FMU needs ({error.strerror}): "
            "free some of it, or have FMUs run inside this process"
        ) from error
