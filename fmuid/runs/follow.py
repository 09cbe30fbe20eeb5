"""Monitoring of growing data: alarms as lines, a command at each of them, restarts."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from subprocess import PIPE, STDOUT, TimeoutExpired
from subprocess import run as run_program
from typing import Any, TypeAlias

import numpy as np

from fmuid import files
from fmuid.codec import as_json
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
from fmuid.runs.faults import build_monitor, rule_of, write_monitoring
from fmuid.runs.log_follower import LogFollower, RecordUpdate
from fmuid.runs.provenance import made_from, made_now, with_earlier
from fmuid.studies import Study

# Time between looks, s.
EVERY = 1.0
# Least time between writings of the state, s, and the most of the time that writing takes.
WRITTEN_EVERY, SHARE = 2.0, 0.05
# Rows and alarms in memory; all of them are in the files.
KEPT_ROWS, KEPT_ALARMS = 10_000, 100
# Time limit of the user's command, s.
COMMAND_SECONDS = 60.0
# Keys of [monitoring] that may change between two runs.
NOT_IN_KEY = ("alarm_command", "size_limits")
# Keys of a line that a command finds in its environment, too.
TOLD = ("id", "event", "fault", "record", "time", "date", "words")
RAISED, CHANGED, ENDED = "raised", "changed", "ended"
Say: TypeAlias = Callable[[Alarm, Mapping[str, str]], str]  # sentence of an alarm and the units of its columns


@dataclass(frozen=True)
class FollowStatus:
    """State of a running monitoring; remarks and lines are new."""

    monitor: Monitor
    remarks: tuple[str | SkippedWindow, ...]  # on files, commands and skipped windows
    lines: tuple[str, ...]  # of ``alarms.jsonl``
    idle: bool  # all data have been examined
    files: tuple[Path, ...] = ()


def followed(study: Study, place: Path, folder: Path, say: Say) -> Generator[FollowStatus, None, None]:
    """Monitor growing data: yield after each look.

    It resumes an earlier run into `folder`, however that ended. Closing the generator writes the findings. A break
    within a window leaves that out; it is done again then.
    """
    with files.locked(folder, "monitoring"):
        running = _Running(study, place, folder, say)
        try:
            yield from running.run()
        except KeyboardInterrupt:
            running.write()
            yield running.status()  # files may have been written since the last one
            raise
        finally:
            running.write()


class _Running:
    def __init__(self, study: Study, place: Path, folder: Path, say: Say) -> None:
        self.study, self.place, self.folder, self.say = study, place, folder, say
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
        """Resume the earlier run in the folder; begin where there is none."""
        rule, given = rule_of(self.study), self.study.experiments[0]
        self.monitor = build_monitor(self.study, rule)
        state = self.folder / STATE_FILE
        left = [name for name in (TABLE_FILE, ALARMS_FILE) if files.is_file(self.folder / name)]
        if left and not files.is_file(state):
            raise DamagedStateError(state, f"missing beside {left[0]}")
        beside = self.monitor.resume(self.folder, KEPT_ROWS) if files.is_file(state) else {}
        if beside.get("key", self.key) != self.key:
            raise InputError(f"{self.folder}: {self.study.path} or its models have changed. Use another output folder.")
        with damage_of(state):
            self.follower = LogFollower(given, self.place, rule.window, rule.transient, beside.get("followed"))
            self.alarms = AlarmLines(**beside.get("alarms", {"study": self.study.title}), say=self.say)
            self.waiting = [str(line) for line in beside.get("waiting", [])]  # of which the command was not told
        self.origin = made_from(self.study)
        try:
            if self.monitor.windows:
                self.origin = with_earlier(self.origin, self.folder / FOUND_FILE)
        except InputError as error:
            raise DamagedStateError(self.folder, str(error)) from None

    def _begin_anew(self, error: DamagedStateError) -> None:
        """Put damaged files of an earlier run aside; begin anew."""
        aside = next(path for k in count(1) if not files.exists(path := self.folder / f"earlier-{k}"))
        aside.mkdir()
        for name in (STATE_FILE, TABLE_FILE, FOUND_FILE, ALARMS_FILE):
            if files.exists(self.folder / name):
                (self.folder / name).replace(aside / name)
        self.remarks.append(
            f"{error.path}: earlier run not resumable ({error.why}). Moved to {aside}; all records are examined again."
        )
        self.sound, self.changed = True, False
        self._resume()

    def run(self) -> Iterator[FollowStatus]:
        self.tell()
        while True:
            try:
                for found in self.follower.look():
                    if isinstance(found, RecordUpdate):
                        self.examine(found)
                    else:
                        self.remarks.append(found)
                    if self.lines or time.monotonic() >= self._next:
                        yield self._watching(idle=False)
            except DamagedStateError as error:  # which shows only when the first record comes
                self._begin_anew(error)
            yield self._watching(idle=True)
            time.sleep(EVERY)

    def _watching(self, *, idle: bool) -> FollowStatus:
        lines = tuple(self.lines)
        self.write()
        self.tell()
        watching = self.status(lines, idle=idle)
        self.remarks = []
        return watching

    def status(self, lines: tuple[str, ...] = (), *, idle: bool = False) -> FollowStatus:
        """Return the state as it is now."""
        return FollowStatus(self.monitor, tuple(self.remarks), lines, idle, self.written)

    def examine(self, piece: RecordUpdate) -> None:
        """Examine a piece; errors in it are remarks."""
        self.sound = False  # until both know of it
        name, told = piece.record.name, len(self.monitor.gaps)
        if name in self.monitor.records and not self.monitor.goes_on(name):
            self.follower.refused(piece)  # of an earlier run without --follow
        else:
            try:
                self.monitor.add(piece.record, grows=piece.grows)
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
        """Write new findings, if any."""
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
        beside = {"key": self.key, "followed": self.follower.state, "alarms": self.alarms.state}
        origin = replace(self.origin, date=made_now().date)
        beside |= {"waiting": self.waiting}
        self.written = write_monitoring(self.monitor, self.folder, origin, lines, beside).files
        self.changed = False

    def tell(self) -> None:
        """Run the user's command for each new line; a break in it repeats the line."""
        command = self.study.monitoring.alarm_command
        while self.waiting and command:
            self.remarks += _told(command, self.waiting[0], self.folder)
            del self.waiting[0]
            self._write(())


def _key(study: Study) -> str:
    """Return the digest of all inputs that findings depend on; `Monitor.resume` compares the baseline."""
    monitoring = {key: value for key, value in study.data.get("monitoring", {}).items() if key not in NOT_IN_KEY}
    words = {key: study.data.get(key) for key in ("model", "experiments", "parameters", "noise", "diagnosis")}
    content = json.dumps([words, monitoring], sort_keys=True, default=str).encode()
    tables = {*(each.data for each in study.experiments), study.fault_search.kept}
    for path in study.files():
        content += b"" if path in tables else hashlib.sha256(path.read_bytes()).digest()
    return hashlib.sha256(content).hexdigest()


def _told(command: Sequence[str], line: str, folder: Path) -> list[str]:
    """Run a command with a line on its standard input; return errors."""
    said = json.loads(line)
    known = {f"FMUID_{key.upper()}": str(said.get(key, "")) for key in TOLD}
    try:
        done = run_program(
            list(command), input=line + "\n", env=os.environ | known | {"FMUID_FOLDER": str(folder)}, check=False,
            text=True, encoding="utf-8", errors="replace", stdout=PIPE, stderr=STDOUT, timeout=COMMAND_SECONDS,
        )  # fmt: skip
    except TimeoutExpired:
        return [f"alarm_command {command[0]!r} exceeded {COMMAND_SECONDS:g} s at alarm {said['id']} and was ended"]
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        return [f"monitoring.alarm_command: {command[0]!r} failed to start: {why}. Give a program and its arguments."]
    if done.returncode:
        last = (done.stdout.strip().splitlines() or ["without a word"])[-1]
        return [f"alarm_command {command[0]!r} failed at alarm {said['id']} (exit code {done.returncode}): {last}"]
    return []


@dataclass
class AlarmLines:
    """Lines of ``alarms.jsonl``: an alarm is raised, changed, or has ended."""

    study: str
    say: Say
    count: int = 0  # number of the last alarm
    first: int = -1  # row of the table where it began, -1 before any
    fault: str = ""  # its fault, "" once it has ended

    @property
    def state(self) -> dict[str, Any]:
        """Fields that another run needs to go on."""
        return {"study": self.study, "count": self.count, "first": self.first, "fault": self.fault}

    def new(self, monitor: Monitor) -> Iterator[str]:
        """Yield the new lines after windows were examined."""
        for alarm in monitor.alarms if monitor.windows else ():
            if alarm.first > self.first:
                self.count, self.first, self.fault = self.count + 1, alarm.first, alarm.fault
                yield self._line(RAISED, monitor, alarm)
            elif alarm.first == self.first and self.fault and alarm.fault != self.fault:
                self.fault = alarm.fault
                yield self._line(CHANGED, monitor, alarm)
            if alarm.first == self.first and self.fault and alarm.last < monitor.windows - 1:
                self.fault = ""
                yield self._line(ENDED, monitor, alarm)

    def _line(self, event: str, monitor: Monitor, alarm: Alarm) -> str:
        table, row = monitor.table, alarm.first if event == RAISED else alarm.last
        end, statistic = (table[name].to_numpy(np.float64)[row - table.index[0]] for name in ("end", "statistic"))
        at = monitor.moment(str(table["record"][row]), float(end))
        explained = []
        for each in alarm.explanations:
            changes = [
                {"name": change.label, "kind": change.kind, "value": change.value, "std": change.std}
                | {"interval": change.interval(), "unit": change.unit}
                for change in each.changes
            ]
            explained.append({"odds": each.odds, "changes": changes})
        told = {"id": self.count, "event": event, "fault": alarm.fault}
        told |= {"record": at.record, "time": at.time, "date": at.date, "statistic": float(statistic)}
        told |= {"explanations": explained, "onset": alarm.onset, "trend": alarm.trend}
        told |= {"words": self.say(alarm, monitor.units), "study": self.study, "written": made_now().date}
        return json.dumps(as_json(told), ensure_ascii=False)
