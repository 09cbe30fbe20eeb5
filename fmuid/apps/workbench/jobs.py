"""Commands of the workbench: processes that outlive their page."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from fmuid.events import EVENTS, Event, of_line
from fmuid.processes import Child

SECOND_REQUEST, LAST_REQUEST = 20.0, 40.0  # s from a request to end to a second request, and to a kill
_INTERRUPT = getattr(signal, "CTRL_BREAK_EVENT", signal.SIGTERM)  # background commands of a shell ignore Ctrl-C


def command_text(words: Sequence[str]) -> str:
    """Return a command as typed in a shell."""
    return shlex.join(["fmuid", *words])


class Job:
    """Command of a study that writes into a folder; `begun`, `ended`, `asked` (to end) are times, s, 0 for not yet."""

    def __init__(self, study: Path, folder: Path, words: Sequence[str]) -> None:
        self.study, self.folder, self.words = study.resolve(), folder, tuple(words)
        self._place = tempfile.TemporaryDirectory(prefix="fmuid-open-")
        self._events, self._printed = Path(self._place.name, "events"), Path(self._place.name, "printed")
        self.begun, self.ended, self.asked = time.monotonic(), 0.0, 0.0
        with self._printed.open("wb") as printed:
            self._child = Child(
                "fmuid",
                *self.words,
                environment={EVENTS: str(self._events), "COLUMNS": "100"},
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.STDOUT,
                cwd=study.parent,
            )

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        if self._child.running:
            return True
        self.ended = self.ended or time.monotonic()
        return False

    @property
    def code(self) -> int | None:
        """Exit code; None while it runs."""
        return self._child.wait(0.0)

    @property
    def seconds(self) -> float:
        """Run time, s."""
        return (time.monotonic() if self.running else self.ended) - self.begun

    def cancel(self) -> None:
        """Ask it to end; it saves its results so far."""
        if self.running:
            self.asked = self.asked or time.monotonic()
            with contextlib.suppress(OSError):  # it just ended
                os.kill(self._child.pid, _INTERRUPT)

    def insist(self) -> None:
        """Ask again, and finally end it, long after `cancel`."""
        waited = time.monotonic() - self.asked if self.asked else 0.0
        if waited > LAST_REQUEST:
            self._child.end()
        elif waited > SECOND_REQUEST:
            self.cancel()

    def events(self, position: int = 0) -> tuple[list[Event], int]:
        """Return the events after a file position, and the next position."""
        try:
            with self._events.open("rb") as file:
                file.seek(position)
                text = file.read()
        except OSError:  # none is written yet
            return [], position
        whole = text[: text.rfind(b"\n") + 1]
        return [of_line(line) for line in whole.decode("utf-8").splitlines()], position + len(whole)

    def printed(self) -> str:
        """Return its output."""
        with contextlib.suppress(OSError):  # its folder is gone
            return self._printed.read_text(encoding="utf-8", errors="replace")
        return ""

    def close(self, patience: float) -> None:
        """Wait for its end, or force it; remove its progress files."""
        if self._child.wait(patience) is None:
            self._child.end()
        self._place.cleanup()


class Jobs:
    """Commands of a workbench; at most one runs per results folder."""

    def __init__(self) -> None:
        self._lock, self._jobs = threading.Lock(), dict[Path, Job]()

    def begin(self, study: Path, folder: Path, words: Sequence[str]) -> Job:
        """Start a command, or return the running one of that folder."""
        with self._lock:
            there = self._jobs.get(folder.resolve())
            if there is not None:
                if there.running:
                    return there
                there.close(0.0)
            found = self._jobs[folder.resolve()] = Job(study, folder, words)
            return found

    def of(self, folder: Path) -> Job | None:
        """Return the last command of a results folder."""
        return self._jobs.get(folder.resolve())

    def running(self) -> list[Job]:
        """Return the running commands."""
        return [job for job in list(self._jobs.values()) if job.running]

    def close(self) -> None:
        """Interrupt all commands and wait: they save their results."""
        for job in self.running():
            job.cancel()
        end = time.monotonic() + LAST_REQUEST
        for job in self._jobs.values():
            job.close(max(0.0, end - time.monotonic()))
