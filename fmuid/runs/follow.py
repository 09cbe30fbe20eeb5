"""Monitoring in operation: records as a logger writes them, alarms as lines, a command at each of them, restarts."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from subprocess import PIPE, STDOUT, TimeoutExpired
from subprocess import run as run_program

import numpy as np

from fmuid import files
from fmuid.diagnosis import (
    ALARMS_FILE,
    FOUND_FILE,
    STATE_FILE,
    TABLE_FILE,
    Alarm,
    DamagedStateError,
    Monitor,
    SkippedWindow,
    damage_of,
)
from fmuid.errors import FmuidError, InputError
from fmuid.runs.alarm_log import AlarmLines
from fmuid.runs.faults import MonitoredTables, build_monitor, findings_of, rule_of
from fmuid.runs.folder import MONITORED_FILE
from fmuid.runs.log_following.follower import LogFollower, RecordUpdate
from fmuid.runs.provenance import made_from, made_now
from fmuid.studies import Study

# It is looked so often for what is new, s.
EVERY = 1.0
# The state is written so often while there is much to examine, s, and at most for this share of the time.
WRITTEN_EVERY, SHARE = 2.0, 0.05
# Rows and alarms that are held; all of them are in the files.
KEPT_ROWS, KEPT_ALARMS = 10_000, 100
# A command that takes longer is ended, s.
COMMAND_SECONDS = 60.0
# Words of [monitoring] that may change between two runs.
NOT_IN_KEY = ("alarm_command", "size_limits")
# What a command finds in its environment, too.
TOLD = ("id", "event", "fault", "record", "time", "date", "words")


@dataclass(frozen=True)
class FollowStatus:
    """How far it is.

    Attributes
    ----------
    monitor : Monitor
    remarks : tuple of str or Gap
        On files and commands, and windows that are left out, since the last time.
    lines : tuple of str
        Of ``alarms.jsonl``, likewise.
    idle : bool
        Whether everything there is has been examined.
    files : tuple of Path
        Those that were written.
    """

    monitor: Monitor
    remarks: tuple[str | SkippedWindow, ...]
    lines: tuple[str, ...]
    idle: bool
    files: tuple[Path, ...] = ()


def followed(
    study: Study,
    place: Path,
    folder: Path,
    say: Callable[[Alarm, Mapping[str, str]], str],
) -> Generator[FollowStatus, None, None]:
    """Monitor the records of a folder, or of a file that grows, as they come in: yield after each look.

    It goes on where an earlier run into the same folder was, however that ended. Who has enough closes the generator:
    what is found by then is written. A break in the midst of a window leaves that out; it is done again then.

    Parameters
    ----------
    study : Study
    place : Path
        What a logger fills.
    folder : Path
        Where the files go: those of `monitored`, and ``alarms.jsonl``.
    say : callable
        Makes the sentence of an alarm and the units of its columns, for ``alarms.jsonl`` and the user's command.

    Raises
    ------
    InputError
        If study and models do not fit together, there is no such place, or the folder is of another run or in use.
    """
    with files.locked(folder, "monitoring"):
        running = _Running(study, place, folder, say)
        try:
            yield from running.run()
        finally:
            running.write()


class _Running:
    """A monitoring in operation."""

    def __init__(self, study: Study, place: Path, folder: Path, say: Callable[[Alarm, Mapping[str, str]], str]) -> None:
        self.study, self.place, self.folder, self.origin, self.say = study, place, folder, made_from(study), say
        self.key = _key(study)
        self.lines: list[str] = []
        self.remarks: list[str | SkippedWindow] = []
        self.written: tuple[Path, ...] = ()
        self.sound, self.changed = True, False
        self._next = 0.0
        try:
            self._resume()
        except DamagedStateError as error:
            self._begin_anew(error)

    def _resume(self) -> None:
        """Go on where the earlier run in the folder was; begin where there is none, or it has examined no window."""
        rule, given = rule_of(self.study), self.study.experiments[0]
        self.monitor = build_monitor(self.study, rule)
        state = self.folder / STATE_FILE
        left = [name for name in (TABLE_FILE, ALARMS_FILE) if files.is_file(self.folder / name)]
        if left and not files.is_file(state):
            raise DamagedStateError(state, f"it is missing beside {left[0]}")
        beside = self.monitor.resume(self.folder, KEPT_ROWS) if files.is_file(state) else {}
        if beside.get("key", self.key) != self.key:
            raise InputError(
                f"{self.folder} is of a run with another study or other models ({self.study.path} has changed since): "
                "use the same, or another output folder"
            )
        with damage_of(state):
            self.follower = LogFollower(given, self.place, rule.window, rule.transient, beside.get("followed"))
            self.alarms = AlarmLines(**beside.get("alarms", {"study": self.study.title}), say=self.say)
            self.waiting = [str(line) for line in beside.get("waiting", [])]  # of which the command was not told
        try:
            self.tables = MonitoredTables(self.folder, given, append=bool(self.monitor.windows))
        except InputError as error:
            raise DamagedStateError(self.folder, str(error)) from None

    def _begin_anew(self, error: DamagedStateError) -> None:
        """Begin anew where the files of an earlier run are damaged, which are put aside."""
        aside = _put_aside(self.folder)
        self.remarks.append(
            f"{error.path}: the earlier run cannot be resumed ({error.why}); its files are in {aside}, and all records "
            "are examined anew"
        )
        self.sound, self.changed = True, False
        self._resume()

    def run(self) -> Iterator[FollowStatus]:
        self.tell()
        while True:
            try:
                yield from self._look()
            except DamagedStateError as error:  # which shows only when the first record comes
                self._begin_anew(error)
            yield self._watching(idle=True)
            time.sleep(EVERY)

    def _look(self) -> Iterator[FollowStatus]:
        """Examine what is new."""
        for found in self.follower.look():
            if isinstance(found, RecordUpdate):
                self.examine(found)
            else:
                self.remarks.append(found.text)
            if self.lines or time.monotonic() >= self._next:
                yield self._watching(idle=False)

    def _watching(self, *, idle: bool) -> FollowStatus:
        lines = tuple(self.lines)
        self.write()
        self.tell()
        watching = FollowStatus(self.monitor, tuple(self.remarks), lines, idle, self.written)
        self.remarks = []
        return watching

    def examine(self, piece: RecordUpdate) -> None:
        """Examine a piece; what is wrong with it is said, and what follows goes on."""
        self.sound = False  # until both know of it
        name, told = piece.record.name, len(self.monitor.gaps)
        if name in self.monitor.records and not self.monitor.goes_on(name):
            self.follower.refused(piece)  # of an earlier run without --follow
        else:
            try:
                self.monitor.add(piece.record, grows=piece.grows)
                self.tables.add(piece.record, piece.raw)
                self.follower.taken(piece, self.monitor.needed)
            except DamagedStateError:
                raise
            except (FmuidError, ArithmeticError, np.linalg.LinAlgError) as error:
                self.follower.refused(piece)
                known = isinstance(error, InputError)  # which names the record
                self.remarks.append(str(error) if known else f"{piece.record.source}: {error}")
        self.remarks += self.monitor.gaps[told:]
        self.lines += self.alarms.new(self.monitor)
        self.sound = self.changed = True

    def write(self) -> None:
        """Write what is new, if anything is."""
        if not self.changed or not self.sound:
            return
        begin = time.monotonic()
        if self.study.monitoring.alarm_command:
            self.waiting += self.lines
        self._write(self.lines)
        self.lines = []
        self.monitor.forget(KEPT_ROWS, KEPT_ALARMS)
        self._next = time.monotonic() + max(WRITTEN_EVERY, (time.monotonic() - begin) / SHARE)

    def _write(self, lines: Sequence[str]) -> None:
        beside = {
            "key": self.key,
            "followed": self.follower.state,
            "alarms": self.alarms.state,
            "waiting": self.waiting,
        }
        origin = replace(self.origin, date=made_now().date)
        self.written = self.tables.write(findings_of(self.monitor), self.monitor, origin, lines, beside).files
        self.changed = False

    def tell(self) -> None:
        """Run the user's command for each line that it has not been told; a line is told again after a break in it."""
        command = self.study.monitoring.alarm_command
        while self.waiting and command:
            self.remarks += _told(command, self.waiting[0], self.folder)
            del self.waiting[0]
            self._write(())


def _put_aside(folder: Path) -> Path:
    """Move the files of an earlier run into a folder of their own, and return that."""
    number = 1
    while files.exists(folder / f"earlier-{number}"):
        number += 1
    aside = folder / f"earlier-{number}"
    aside.mkdir()
    for name in (STATE_FILE, TABLE_FILE, FOUND_FILE, ALARMS_FILE, MONITORED_FILE):
        if files.exists(folder / name):
            (folder / name).replace(aside / name)
    return aside


def _key(study: Study) -> str:
    """Return the digest of all that what is found depends on: the study without what is only told, and its models.

    What is kept beside the healthy result is compared by its content (`Monitor.resume`).
    """
    monitoring = {key: value for key, value in study.data.get("monitoring", {}).items() if key not in NOT_IN_KEY}
    words = {key: study.data.get(key) for key in ("model", "experiments", "parameters", "noise", "diagnosis")}
    content = json.dumps([words, monitoring], sort_keys=True, default=str).encode()
    tables = {*(each.data for each in study.experiments), study.fault_search.kept}
    for path in study.files():
        content += b"" if path in tables else hashlib.sha256(path.read_bytes()).digest()
    return hashlib.sha256(content).hexdigest()


def _told(command: Sequence[str], line: str, folder: Path) -> list[str]:
    """Run a command with a line on its standard input; return what went wrong."""
    said = json.loads(line)
    known = {f"FMUID_{key.upper()}": str(said.get(key, "")) for key in TOLD}
    try:
        done = run_program(
            list(command), input=line + "\n", env=os.environ | known | {"FMUID_FOLDER": str(folder)}, check=False,
            text=True, encoding="utf-8", errors="replace", stdout=PIPE, stderr=STDOUT,
            timeout=COMMAND_SECONDS,
        )  # fmt: skip
    except TimeoutExpired:
        return [f"the command {command[0]!r} took more than {COMMAND_SECONDS:g} s at alarm {said['id']} and was ended"]
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        return [f"[monitoring] command: {command[0]!r} cannot be run: {why}; give a program and its arguments"]
    if done.returncode:
        last = (done.stdout.strip().splitlines() or ["without a word"])[-1]
        return [f"the command {command[0]!r} failed at alarm {said['id']} (exit code {done.returncode}): {last}"]
    return []
