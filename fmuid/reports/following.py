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

from fmuid import files
from fmuid.diagnosis import STATE_FILE, Monitor
from fmuid.errors import InputError, SimulationError
from fmuid.reports.alarm_lines import AlarmLines
from fmuid.reports.fault_runs import MonitoredTables, MonitoringFindings
from fmuid.reports.origin import made_from, made_now
from fmuid.reports.page.write import show_results
from fmuid.reports.words.monitoring import gap_words, monitoring_sentences
from fmuid.studies import Follower, Piece, Study, monitor_of, rule_of

# It is looked so often for what is new, s.
EVERY = 1.0
# The state is written so often while there is much to examine, s, and at most for this share of the time.
WRITTEN_EVERY, SHARE = 2.0, 0.05
# Rows and alarms that are held; all of them are in the files.
KEPT_ROWS, KEPT_ALARMS = 10_000, 100
# A command that takes longer is ended, s.
COMMAND_SECONDS = 60.0
# Words of [monitoring] that may change between two runs.
NOT_IN_KEY = ("command", "limits")
# What a command finds in its environment, too.
TOLD = ("id", "event", "fault", "record", "time", "date", "words")


@dataclass(frozen=True)
class Watching:
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
    show: Callable[[Watching], None] | None = None,
    until: Callable[[Watching], bool] | None = None,
) -> MonitoringFindings:
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
        Called with a `Watching` after each look.
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
        return MonitoringFindings(running.monitor, (*written, *shown))


class _Running:
    """A monitoring in operation."""

    def __init__(self, study: Study, place: Path, folder: Path) -> None:
        self.study, self.folder, self.origin = study, folder, made_from(study)
        rule = rule_of(study)
        self.monitor = monitor_of(study, rule)
        beside = self.monitor.resume(folder, KEPT_ROWS) if files.is_file(folder / STATE_FILE) else {}
        self.key = _key(study)
        if beside.get("key", self.key) != self.key:
            raise InputError(
                f"{folder} is of a run with another study or other models ({study.path} has changed since): "
                "use the same, or another output folder"
            )
        self.tables = MonitoredTables(folder, study.experiments[0], append=bool(beside))
        followed = beside.get("followed")
        self.follower = Follower(study.experiments[0], place, rule.window, rule.transient, followed)
        self.alarms = AlarmLines(**beside.get("alarms", {"study": study.title}))
        self.waiting: list[str] = beside.get("waiting", [])  # lines of which the command was not told
        self.lines: list[str] = []
        self.remarks: list[str] = []
        self.written: Sequence[str] = ()
        self.sound, self.changed = True, False
        self._next = 0.0

    def run(self, show: Callable[[Watching], None] | None, until: Callable[[Watching], bool] | None) -> None:
        self.tell()
        while True:
            for found in self.follower.look():
                if isinstance(found, Piece):
                    self.examine(found)
                else:
                    self.remarks.append(found.text)
                if self.lines or time.monotonic() >= self._next:
                    self._shown(show, idle=False)
            watching = self._shown(show, idle=True)
            if until is not None and until(watching):
                return
            time.sleep(EVERY)

    def _shown(self, show: Callable[[Watching], None] | None, *, idle: bool) -> Watching:
        lines = tuple(self.lines)
        self.write()
        self.tell()
        watching = Watching(self.monitor, tuple(self.remarks), lines, idle)
        self.remarks = []
        if show is not None:
            show(watching)
        return watching

    def examine(self, piece: Piece) -> None:
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
            except (InputError, SimulationError) as error:
                self.follower.refused(piece)
                self.remarks.append(str(error))
        self.remarks += gap_words(self.monitor.gaps[told:])
        self.lines += self.alarms.new(self.monitor)
        self.sound = self.changed = True

    def write(self) -> None:
        """Write what is new, if anything is."""
        if not self.changed or not self.sound:
            return
        begin = time.monotonic()
        if self.study.monitoring.command:
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
        command = self.study.monitoring.command
        while self.waiting and command:
            self.remarks += _told(command, self.waiting[0], self.folder)
            del self.waiting[0]
            self._write(())


def _key(study: Study) -> str:
    """Return the digest of all that what is found depends on: the study without what is only told, and its models."""
    monitoring = {key: value for key, value in study.data.get("monitoring", {}).items() if key not in NOT_IN_KEY}
    words = {key: study.data.get(key) for key in ("model", "experiments", "parameters", "noise", "diagnosis")}
    content = json.dumps([words, monitoring], sort_keys=True, default=str).encode()
    tables = {each.table for each in study.experiments}
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
