"""The far side of isolation: a server that forks processes which run FMUs, and what such a process does.

``python -m fmuid.simulation.isolation.server FD`` is the server: it loads all code that simulations need, then waits at
its socket for orders to fork. It runs no FMU itself and has one thread only, so that its copies are sound and there
within milliseconds.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import logging
import mmap
import os
import pickle
import signal
import socket
import sys
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from fmuid.fmi import REPORT
from fmuid.simulation.isolation import cgroup
from fmuid.simulation.isolation.channel import Channel
from fmuid.simulation.isolation.family import adopt_orphans, children

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fmuid.fmi import Simulation
    from fmuid.simulation.in_process import InProcessExecutor

AVAILABLE = hasattr(os, "fork") and hasattr(socket, "send_fds")
"""Whether this platform can fork processes and pass files to them: Linux and macOS can."""

DOING_WORDS = 512
"""Words at the beginning of the shared memory: two for each thread, what it is doing and how often it has begun."""

ORDER_BYTES = 4096  # of an order to the server
ORPHANS_SECONDS = 2.0  # s at most to end
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux
_IOLBF = 1  # of setvbuf: lines are written when they are complete


def layout(m: int, n_theta: int, n_times: int, n_outputs: int) -> tuple[int, int, int, int]:
    """Return where reports, thetas and outputs begin in the shared memory, and its size, bytes."""
    reports = 8 * DOING_WORDS
    thetas = reports + 8 * REPORT * m
    outputs = thetas + 8 * m * n_theta
    return reports, thetas, outputs, outputs + 8 * m * n_times * n_outputs


Arrays = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]


def arrays(memory: mmap.mmap, shape: tuple[int, int, int, int]) -> Arrays:
    """Return reports (m, REPORT), thetas (m, N) and outputs (m, K, n_outputs) of shape (m, N, K, n_outputs)."""
    m, n_theta, n_times, n_outputs = shape
    reports, thetas, outputs, _ = layout(*shape)
    return (
        np.frombuffer(memory, np.intp, REPORT * m, reports).reshape(m, REPORT),
        np.frombuffer(memory, np.float64, m * n_theta, thetas).reshape(m, n_theta),
        np.frombuffer(memory, np.float64, m * n_times * n_outputs, outputs).reshape(m, n_times, n_outputs),
    )


class _Messages(logging.Handler):
    """Collects what is logged, to be said by the process that asked."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.found: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.found.append((record.name, record.levelno, record.getMessage()))


class Service:
    """Runs the FMUs of one system, as the process at the other end of a socket orders.

    Parameters
    ----------
    channel : Channel
    memory : int
        File descriptor of the shared memory.
    """

    def __init__(self, channel: Channel, memory: int) -> None:
        self._channel, self._file = channel, memory
        self._memory = mmap.mmap(-1, mmap.PAGESIZE)
        self._runs: dict[int, Simulation] = {}
        self._executor: InProcessExecutor | None = None
        self._messages = _Messages()
        logger = logging.getLogger("fmuid")
        logger.addHandler(self._messages)
        logger.propagate = False
        self._libc = ctypes.CDLL(None)

    def serve(self) -> None:
        """Carry out orders until the other side is gone."""
        orders: dict[str, Callable[..., Any]] = {
            "start": self._start,
            "know": self._know,
            "run": self._run,
            "failure": self._failure,
            "close": self._close,
            "watch": self._watch,
            "call": self._call,
        }
        while True:
            try:
                name, *arguments = self._channel.receive()
            except EOFError:
                return
            try:
                reply: tuple[str, Any] = "done", orders[name](*arguments)
            except Exception as error:  # whatever it is, the other side is waiting
                reply = "error", error
            self._libc.fflush(None)
            said, self._messages.found = self._messages.found, []
            try:
                self._channel.send((*reply, said))
            except EOFError:
                return

    def _start(self, components: dict[str, Any], limit: int, resets: bool | None) -> None:
        from fmuid.simulation.in_process import InProcessExecutor

        self._executor = InProcessExecutor(components, limit, resets)

    @property
    def _own(self) -> InProcessExecutor:
        assert self._executor is not None, "start comes first"
        return self._executor

    def _know(self, number: int, simulation: Simulation, forgotten: Sequence[int]) -> None:
        """Remember a run by its number, and forget others."""
        for each in forgotten:
            self._runs.pop(each, None)
        self._runs[number] = simulation

    def _run(
        self,
        number: int,
        shape: tuple[int, int, int, int],
        size: int,
        varying: Sequence[Sequence[Any]],
    ) -> tuple[list[int], float]:
        """Simulate; return the components that were found stiff, and the duration of the longest simulation, s."""
        simulation = self._runs[number]
        if len(self._memory) != size:
            self._memory = mmap.mmap(self._file, size)
            self._own.show_doing(np.frombuffer(self._memory, np.intp, DOING_WORDS))
        for given, new in zip(simulation.varying, varying, strict=True):
            for array, values in zip((given.magnitudes, given.initial, given.steps), new, strict=True):
                array[:] = values
        reports, thetas, outputs = arrays(self._memory, shape)
        before = [each and each.integrator for each in simulation.plan.integrations]
        self._own.run(simulation, thetas, outputs, reports)
        after = [each and each.integrator for each in simulation.plan.integrations]
        return [i for i, pair in enumerate(zip(before, after, strict=True)) if pair[0] != pair[1]], self._own.longest

    def _failure(self, number: int, *arguments: Any) -> Any:
        return self._own.failure(self._runs[number], *arguments)

    def _close(self) -> None:
        if self._executor is not None:
            self._executor.close()

    def _watch(self) -> None:
        """Let all threads of this process write what they are doing where the other side sees it."""
        from fmuid.simulation.simulation_thread import shared_words

        self._memory = mmap.mmap(self._file, 8 * DOING_WORDS)
        shared_words.append(np.frombuffer(self._memory, np.intp, DOING_WORDS))

    def _call(self, module: str, name: str, arguments: Sequence[Any]) -> Any:
        """Call a function of a module; what it logs is its own affair."""
        try:
            return getattr(importlib.import_module(module), name)(*arguments)
        finally:
            self._messages.found.clear()


def _become_host(descriptors: Sequence[int], parent: int, group: Path | None) -> None:
    """Turn this fork of the server into a host, until its other side is gone."""
    import resource  # not on Windows

    channel, memory, printed = descriptors
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != parent:
            return
    cgroup.enter(group)
    adopt_orphans()
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nothing = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((nothing, 0), (printed, 1), (printed, 2)):
        os.dup2(source, target)
    _write_lines_at_once()
    Service(Channel(socket.socket(fileno=channel)), memory).serve()


def _live_as_host(descriptors: Sequence[int], parent: int, group: Path | None) -> NoReturn:
    """Be a host and end as one, whatever happens: nothing of the server is carried on."""
    code = os.EX_OSERR
    try:
        _become_host(descriptors, parent, group)
        code = os.EX_OK
    except BaseException:
        traceback.print_exc()  # among what the FMU prints
    finally:
        os._exit(code)


def _write_lines_at_once() -> None:
    """Let what FMUs print be there when they crash."""
    libc = ctypes.CDLL(None)
    for name in ("stdout", "__stdoutp"):
        with contextlib.suppress(ValueError):  # each C library has one of the two names
            libc.setvbuf(ctypes.c_void_p.in_dll(libc, name), None, _IOLBF, 0)
            return


class Server:
    """Forks hosts, as the process at the other end of a socket orders."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._hosts: set[int] = set()
        self._group = cgroup.own()
        cgroup.sweep(self._group)  # of servers that were killed

    def serve(self) -> None:
        """Carry out orders until the other side is gone; then no host is left."""
        orders, answers = self._channel, Channel(self._channel)
        try:
            while True:
                data, descriptors, _, _ = socket.recv_fds(orders, ORDER_BYTES, 3)
                if not data:
                    return
                name, *arguments = pickle.loads(data)
                answers.send(self._fork(descriptors, *arguments) if name == "fork" else self._wait(*arguments))
        except (EOFError, ConnectionError):  # the other side was killed
            return
        finally:
            for host in self._hosts:
                for end in (os.kill, os.killpg):
                    with contextlib.suppress(OSError):  # gone meanwhile
                        end(host, signal.SIGKILL)
            self._hosts.clear()
            cgroup.sweep(self._group)
            self._end_orphans()

    def _fork(self, descriptors: Sequence[int], modules: Sequence[str]) -> tuple[int, Path | None] | str:
        """Return process id and control group of a new host, or why there cannot be one."""
        for module in modules:
            with contextlib.suppress(ImportError):  # who needs it says so
                importlib.import_module(module)
        server, group = os.getpid(), cgroup.make(self._group)
        try:
            pid = os.fork()
            if pid == 0:
                self._channel.close()
                _live_as_host(descriptors, server, group)
        except OSError as error:
            cgroup.remove(group)
            return str(error.strerror)
        finally:
            for descriptor in descriptors:
                os.close(descriptor)
        self._hosts.add(pid)
        return pid, group

    def _wait(self, pid: int, seconds: float) -> int | None:
        """Return the status of a host that has ended, as `os.waitpid` gives it; None if it has not, or is unknown."""
        until = time.monotonic() + seconds
        while pid in self._hosts:
            found, status = os.waitpid(pid, os.WNOHANG)
            if found:
                self._hosts.discard(pid)
                self._end_orphans()
                return status
            if time.monotonic() > until:
                return None
            time.sleep(0.001)
        return None

    def _end_orphans(self) -> None:
        """End what hosts that are gone have started: it has come to be below this process, and is no host.

        A host that lives adopts what is below itself.
        """
        until = time.monotonic() + ORPHANS_SECONDS
        while time.monotonic() < until:
            orphans = [pid for pid in children(os.getpid()) if pid not in self._hosts]
            if not orphans:
                return
            for pid in orphans:  # whose own children come here in their turn
                with contextlib.suppress(OSError):  # gone meanwhile
                    os.kill(pid, signal.SIGKILL)
                    os.waitpid(pid, os.WNOHANG)
            time.sleep(0.001)


def main(arguments: Sequence[str]) -> None:
    """Be the server at the socket with the given file descriptor."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    importlib.import_module("fmuid.simulation.in_process")
    Server(socket.socket(fileno=int(arguments[0]))).serve()


if __name__ == "__main__":
    main(sys.argv[1:])
