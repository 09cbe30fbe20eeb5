"""Commands that the workbench runs: processes of their own, which write what they would from a terminal.

A command tells each event of its progress in a file (`fmuid.progress.EVENTS`). It goes on when a page is closed, and to
its end when the workbench is killed.
"""

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

from fmuid.processes import Child
from fmuid.progress import EVENTS, Event, of_line

# Seconds after which a command that was asked to end is asked once more, and ended without more ado. Between them it
# writes what it has.
SECOND_REQUEST, LAST_REQUEST = 20.0, 40.0
_INTERRUPT = getattr(signal, "CTRL_BREAK_EVENT", signal.SIGTERM)  # Ctrl-C is ignored by what a shell runs behind


def command_text(words: Sequence[str]) -> str:
    """Return a command as it is typed in a shell."""
    return shlex.join(["fmuid", *words])


class Job:
    """A command that runs, or has run.

    Parameters
    ----------
    study : Path
        Its study file.
    folder : Path
        Where its files go.
    words : sequence of str
        Of the command, after ``fmuid``.

    Attributes
    ----------
    begun : float
        When, in seconds of `time.monotonic`.
    """

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
        """Its exit code; None while it runs."""
        return self._child.wait(0.0)

    @property
    def seconds(self) -> float:
        """How long it has been running, or did."""
        return (time.monotonic() if self.running else self.ended) - self.begun

    def cancel(self) -> None:
        """Ask it to end: it writes what it has found so far."""
        if self.running:
            self.asked = self.asked or time.monotonic()
            with contextlib.suppress(OSError):  # it has just ended
                os.kill(self._child.pid, _INTERRUPT)

    def insist(self) -> None:
        """End it if it was asked to long ago."""
        waited = time.monotonic() - self.asked if self.asked else 0.0
        if waited > LAST_REQUEST:
            self._child.end()
        elif waited > SECOND_REQUEST:
            self.cancel()

    def events(self, position: int = 0) -> tuple[list[Event], int]:
        """Return the events after a position in its file, and the position after them."""
        try:
            with self._events.open("rb") as file:
                file.seek(position)
                text = file.read()
        except OSError:  # it has written none yet
            return [], position
        whole = text[: text.rfind(b"\n") + 1]
        return [of_line(line) for line in whole.decode("utf-8").splitlines()], position + len(whole)

    def printed(self) -> str:
        """Return what it has printed."""
        with contextlib.suppress(OSError):  # its folder is gone
            return self._printed.read_text(encoding="utf-8", errors="replace")
        return ""

    def close(self, patience: float) -> None:
        """Wait for its end, and see to it; its files of progress are removed."""
        if self._child.wait(patience) is None:
            self._child.end()
        self._place.cleanup()


class Jobs:
    """All that a workbench has begun; at most one that runs for a folder of results."""

    def __init__(self) -> None:
        self._lock, self._jobs = threading.Lock(), dict[Path, Job]()

    def begin(self, study: Path, folder: Path, words: Sequence[str]) -> Job:
        """Begin a command, or return the one that is running in that folder already."""
        with self._lock:
            there = self._jobs.get(folder.resolve())
            if there is not None:
                if there.running:
                    return there
                there.close(0.0)
            found = self._jobs[folder.resolve()] = Job(study, folder, words)
            return found

    def of(self, folder: Path) -> Job | None:
        """Return the last command that was begun for a folder of results."""
        return self._jobs.get(folder.resolve())

    def running(self) -> list[Job]:
        """Return those that have not ended."""
        return [job for job in list(self._jobs.values()) if job.running]

    def close(self) -> None:
        """Interrupt all, so that they save what they have, and wait for them."""
        for job in self.running():
            job.cancel()
        end = time.monotonic() + LAST_REQUEST
        for job in self._jobs.values():
            job.close(max(0.0, end - time.monotonic()))
