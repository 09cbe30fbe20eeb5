"""The far side of isolation: a server that forks isolated processes.

``python -m fmuid.processes.server FD MODULE...`` loads the modules, then forks as its socket orders. It calls no
function of theirs and has one thread, so its forks are sound and fast.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import pickle
import signal
import socket
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from fmuid.processes import cgroup
from fmuid.processes.channel import TOKEN_BYTES, Channel, answer_parts
from fmuid.processes.limits import adopt_orphans, children, strike
from fmuid.processes.service import Service


def _become_host(descriptors: Sequence[int], parent: int, group: Path | None) -> None:
    import resource  # not on Windows

    channel, memory, printed = descriptors
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
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
    """Be a host and exit: nothing of the server runs on."""
    code = os.EX_OSERR
    try:
        _become_host(descriptors, parent, group)
        code = os.EX_OK
    except BaseException:
        traceback.print_exc()  # among what is printed there
    finally:
        os._exit(code)


def _write_lines_at_once() -> None:
    """Let printed lines of native code survive its crash."""
    libc = ctypes.CDLL(None)
    for name in ("stdout", "__stdoutp"):
        with contextlib.suppress(ValueError):  # a C library has one of the names
            libc.setvbuf(ctypes.c_void_p.in_dll(libc, name), None, 1, 0)  # _IOLBF: line buffering
            return


class HostForkServer:
    """Server that forks hosts as its socket orders."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._hosts: set[int] = set()
        self._group = cgroup.own()
        cgroup.sweep(self._group)  # of servers that were killed

    def serve(self) -> None:
        """Carry out orders, then end all hosts."""
        orders, answers = self._channel, Channel(self._channel)
        try:
            while True:
                data, descriptors, _, _ = socket.recv_fds(orders, 4096, 3)
                if not data:
                    return
                name, *arguments = pickle.loads(data)
                answer = self._fork(descriptors, *arguments) if name == "fork" else self._wait(*arguments)
                answers.send(answer_parts(answer), bytes(TOKEN_BYTES))
        except (EOFError, ConnectionError):  # the other side was killed
            return
        finally:
            for host in self._hosts:
                strike(host)
            self._hosts.clear()
            cgroup.sweep(self._group)
            self._end_orphans()

    def _fork(self, descriptors: Sequence[int], modules: Sequence[str]) -> tuple[int, str | None] | str:
        """Return process id and control group of a host, or a refusal."""
        for module in modules:
            with contextlib.suppress(ImportError):  # its user reports that
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
        return pid, None if group is None else str(group)

    def _wait(self, pid: int, seconds: float) -> int | None:
        """Return the status of an ended host (`os.waitpid`), else None."""
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
        """End the processes of ended hosts: children of this one; a living host adopts its own orphans."""
        until = time.monotonic() + 2.0  # s to end
        while time.monotonic() < until:
            orphans = [pid for pid in children(os.getpid()) if pid not in self._hosts]
            if not orphans:
                return
            for pid in orphans:  # their children come here next
                with contextlib.suppress(OSError):  # already gone
                    os.kill(pid, signal.SIGKILL)
                    os.waitpid(pid, os.WNOHANG)
            time.sleep(0.001)


def main(descriptor: str, *modules: str) -> None:
    """Run the server at the socket of a file descriptor."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    for module in modules:
        importlib.import_module(module)
    HostForkServer(socket.socket(fileno=int(descriptor))).serve()


if __name__ == "__main__":
    main(*sys.argv[1:])
