"""Monitoring in operation: records as a logger writes them, alarms as lines, a command at each of them, restarts."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from subprocess import PIPE, STDOUT, TimeoutExpired
from subprocess import run as run_program

import numpy as np

from fmuid import files
from fmuid.diagnosis import ALARMS_FILE, FOUND_FILE, STATE_FILE, TABLE_FILE, DamagedStateError, Monitor, damage_of
from fmuid.errors import FmuidError, InputError
from fmuid.reports.alarm_log import AlarmLines
from fmuid.reports.diagnosis_runs import MonitoredTables, MonitoringRun
from fmuid.reports.messages.monitoring import gap_words, monitoring_sentences
from fmuid.reports.page.faults import MONITORED_FILE
from fmuid.reports.page.write import show_results
from fmuid.reports.provenance import made_from, made_now
from fmuid.runs import LogFollower, RecordUpdate, build_monitor, rule_of
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
    remarks, lines : tuple of str
        Sentences on files and commands, and lines of ``alarms.jsonl``, since the last time.
    idle : bool
        Whether everything there is has been examined.
    """

    monitor: Monitor
    remarks: tuple[str, ...]
    lines: tuple[str, ...]
    idle: bool


def run_following(
    study: Study | str | Path,
    place: str | Path,
    folder: str | Path,
    *,
    report: bool = False,
    show: Callable[[FollowStatus], None] | None = None,
    until: Callable[[FollowStatus], bool] | None = None,
) -> MonitoringRun:
    """Monitor the records of a folder, or of a file that grows, as they come in, until Ctrl-C.

    ``fmuid monitor --follow`` is this. It goes on where an earlier run into the same folder was, however that ended.

    Parameters
    ----------
    study : Study or path
    place : path
        What a logger fills.
    folder : path
        Where the files go: those of `run_monitoring`, and ``alarms.jsonl``.
    report : bool
        Whether to write ``report.html`` at the end.
    show : callable, optional
        Called with a `FollowStatus` after each look.
    until : callable, optional
        Whether to end, asked after each look.

    Raises
    ------
    InputError
        If study and models do not fit together, there is no such place, or the folder is of another run or in use.
    """
    study, target = study if isinstance(study, Study) else Study.read(study), Path(folder)
    with files.locked(target, "monitoring"):
        running = _Running(study, Path(place), target)
        with contextlib.suppress(KeyboardInterrupt):
            running.run(show, until)
        running.write()  # unless the break was in the midst of something: that is done again then
        written = [target / name for name in running.written]
        shown = show_results(target, report=report) if written else []
        return MonitoringRun(running.monitor, (*written, *shown))


class _Running:
    """A monitoring in operation."""

    def __init__(self, study: Study, place: Path, folder: Path) -> None:
        self.study, self.place, self.folder, self.origin = study, place, folder, made_from(study)
        self.key = _key(study)
        self.lines: list[str] = []
        self.remarks: list[str] = []
        self.written: Sequence[str] = ()
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
            self.alarms = AlarmLines(**beside.get("alarms", {"study": self.study.title}))
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

    def run(self, show: Callable[[FollowStatus], None] | None, until: Callable[[FollowStatus], bool] | None) -> None:
        self.tell()
        while True:
            try:
                self._look(show)
            except DamagedStateError as error:  # which shows only when the first record comes
                self._begin_anew(error)
            watching = self._shown(show, idle=True)
            if until is not None and until(watching):
                return
            time.sleep(EVERY)

    def _look(self, show: Callable[[FollowStatus], None] | None) -> None:
        """Examine what is new."""
        for found in self.follower.look():
            if isinstance(found, RecordUpdate):
                self.examine(found)
            else:
                self.remarks.append(found.text)
            if self.lines or time.monotonic() >= self._next:
                self._shown(show, idle=False)

    def _shown(self, show: Callable[[FollowStatus], None] | None, *, idle: bool) -> FollowStatus:
        lines = tuple(self.lines)
        self.write()
        self.tell()
        watching = FollowStatus(self.monitor, tuple(self.remarks), lines, idle)
        self.remarks = []
        if show is not None:
            show(watching)
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
        self.remarks += gap_words(self.monitor.gaps[told:])
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
            "alarms": asdict(self.alarms),
            "waiting": self.waiting,
        }
        also = self.origin | made_now() | {"words": monitoring_sentences(self.monitor), "experiments": self.tables.said}
        prepared = self.tables.write()
        self.written = [path.name for path in (*prepared, *self.monitor.write(self.folder, also, lines, beside))]
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
    known = {f"FMUID_{key.upper()}": str(said[key]) for key in TOLD}
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
