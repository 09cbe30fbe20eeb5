"""The near side of the server that forks hosts: one a process, started when it is first needed."""

from __future__ import annotations

import atexit
import os
import pickle
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from fmuid.errors import FmuidError
from fmuid.processes.channel import Channel
from fmuid.processes.children import MEMORY_KEPT, Child
from fmuid.processes.family import condition_of
from fmuid.processes.messages import GarbledError, answer_of
from fmuid.processes.watchdog import Watchdog

CLOSING_LIMIT = 2.0  # s for freeing instances, after which the process is killed: nothing of it is needed any more
MOST_STARTS = 6  # of the server, which may be killed from outside while it loads
ENDING_LIMIT = 2.0  # s that a process which has closed its socket may take to end
ANSWER_LIMIT = 120.0  # s that the server may take for an answer: it may have code to load
LOOK_SECONDS = 0.1  # between looks whether the server does well while it owes an answer


class ForkServer:
    """The server of this process (`fmuid.processes.server.HostForkServer`), started when it is first needed."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._channel: socket.socket | None = None
        self._process: Child | None = None
        self._owner, self._loaded, self._asking = 0, False, False

    def start(self, *modules: str) -> socket.socket:
        """Start the server where there is none; it loads its code, and these modules, while this process goes on."""
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
        """Return process id and control group of a new host that has loaded the modules and got the descriptors."""
        for _ in range(MOST_STARTS):
            with self._lock:
                try:
                    found = self._ask("fork", list(modules), descriptors=descriptors)
                except (EOFError, ConnectionError):
                    continue  # somebody has killed or stopped it: once more
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
        """Return the status with which a host ended, None if it has not or nobody knows."""
        with self._lock:
            if self._channel is None or self._asking:  # by a collection of garbage in the middle of another question
                return None
            try:
                status: int | None = self._ask("wait", pid, ENDING_LIMIT)
            except (EOFError, ConnectionError):
                return None
            return status

    def _ask(self, *order: object, descriptors: Sequence[int] = ()) -> Any:
        """Give an order and return the answer; whatever interrupts that ends the server, or the next took the answer.

        So does a server that owes an answer for too long, or was stopped: native code can stop it, as its parent. All
        hosts end with it, which costs no call: there will be new ones.
        """
        self._asking = True
        try:
            channel = self.start()
            socket.send_fds(channel, [pickle.dumps(order)], list(descriptors))
            _, parts = Channel(channel, LOOK_SECONDS).receive(partial(self._look, Watchdog(ANSWER_LIMIT)))
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
        """See whether the server does well; one that does not is ended."""
        assert self._process is not None, "it owes an answer"
        condition = condition_of(self._process.pid)
        if condition.status == psutil.STATUS_ZOMBIE or watchdog.end(condition) is not None:
            self.stop(0.0)
            raise EOFError

    def stop(self, patience: float = CLOSING_LIMIT) -> None:
        """End the server, and with it all hosts."""
        with self._lock:
            if self._channel is not None:
                self._channel.close()
            if self._process is not None and self._owner == os.getpid():
                self._process.end(patience if self._loaded else 0.0)
            self._channel = self._process = None


SERVER = ForkServer()
atexit.register(SERVER.stop)
