"""Monitoring: a long record, or one record after the other, window by window, and an alarm where something is new.

The machine is linearised once over many windows, where it was estimated last; each window adds its information and
score to those of all onsets (`fmuid.diagnosis.onset`), and nothing is fitted twice. What may drift, as a temperature
moves a resistance, is another number in each window. An alarm is raised where a cause explains more than chance at
the level asked for; the windows after the onset, with what was before as prior, name the cause and its size.

Each window is simulated from a little earlier on, longer than a transient, so that its unknown initial state is
forgotten and no sample is lost (docs/method.md section 5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.data import Experiment
from fmuid.diagnosis.alarm_decision import decide_alarm
from fmuid.diagnosis.alarms import Alarm, RecordTime, Rule, with_trend
from fmuid.diagnosis.baseline import Baseline, BaselineSource
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.cause_ranking import MODEL_ERROR
from fmuid.diagnosis.causes import CauseKind, Causes, ChangeParameterSet
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.information_matrix import ChangePrior
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.monitor_store import STATE_FILE, MonitorStore, Resumed, restored
from fmuid.diagnosis.onset_tracker import OnsetTracker
from fmuid.diagnosis.window_evaluation import MonitorReference, MonitorState, WindowEvaluation
from fmuid.diagnosis.windows import (
    GrowingRecord,
    SkippedWindow,
    Window,
    WindowSums,
    build_up_of,
    part_of,
    split_windows,
    summed,
)
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Result
from fmuid.models import FMU, System
from fmuid.progress import Progress, WindowStep


@dataclass(frozen=True)
class MonitoringSettings:
    """Numbers of a monitoring: samples linearized at once, and repetitions of a window's linearization at most."""

    batch_samples: int = 32_768
    most_steps: int = 4


SETTINGS = MonitoringSettings()


class Monitor:
    """Watches records for faults, window by window.

    Parameters
    ----------
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    faults : mapping of str to Fault
    model : System, FMU or path
        The healthy machine.
    rule : Rule, optional
    causes : Causes, optional
        What is looked at beside the faults, where the baseline has healthy records.
    model_error : float
        κ, as for `fmuid.DiagnosisSettings`.

    Attributes
    ----------
    rule : Rule
    faults : dict of str to Fault
    gaps : tuple of SkippedWindow
        Windows that are left out, those that are held (`forget`).

    Raises
    ------
    InputError
        If there is no fault, or the healthy result does not fit the model.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> monitor = fmuid.Monitor(fmuid.identify(coil.problem()), {"turns": turns}, coil.fmu)  # a record is a window
    >>> _ = monitor.add(test.experiment)
    >>> [alarm.fault for alarm in monitor.alarms]
    ['turns']
    """

    def __init__(
        self,
        baseline: Baseline | Result | str | Path,
        faults: Mapping[str, Fault],
        model: System | FMU | str | Path,
        rule: Rule | None = None,
        causes: Causes | None = None,
        model_error: float = MODEL_ERROR,
    ) -> None:
        if not faults:
            raise InputError("there is no fault to look for: give at least one fault model with its parameters")
        self.baseline, self.faults, self.system = Baseline.of(baseline), dict(faults), System.of(model)
        self.rule, self.causes, self.model_error = rule or Rule(), causes or Causes(), model_error
        self.gaps: tuple[SkippedWindow, ...] = ()
        self._journal: MonitorStore | None = None
        self._made: BaselineComparator | None = None
        self._machine: LinearizedMachine | None = None
        self._resumed = Resumed()
        self._now = MonitorState(OnsetTracker(ChangePrior(np.zeros(0), np.zeros((0, 0))), np.zeros(0)), np.zeros(0))

    @single_threaded
    def add(self, record: Experiment, progress: Progress | None = None, *, grows: bool = False) -> pd.DataFrame:
        """Examine the windows of a record and return their rows; what goes wrong leaves everything as it was.

        Parameters
        ----------
        record : Experiment
            With the healthy machine's names; what it discards is left out at its beginning. Of a record that grows
            the rows from `needed` on, or more of them, which are under the same name and discard nothing.
        progress : callable, optional
            Called with a `fmuid.progress.WindowStep` before windows are linearised.
        grows : bool
            Whether more of it may come: then only windows that are whole by now are examined.

        Raises
        ------
        InputError
            If a record of this name is there already, it is shorter than a window, has other inputs or outputs than
            the model, or its transient lasts longer than the rule says; if it grows and the rule has no windows or no
            horizon.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        goes_on = self.goes_on(record.name)
        if record.name in self.records and not goes_on:
            raise InputError(
                f"{record.source}: a record named {record.name!r} has been monitored already: leave it out or rename it"
            )
        if grows and (self.rule.window is None or self.rule.horizon is None):
            raise InputError(
                f"{record.source} grows, and nobody knows how long it gets: say in [monitoring] how long a window is "
                "and in which time the level of false alarms holds, as in window = 1.0 and horizon = 86400.0"
            )
        made = self._comparison(record)
        before, gaps = self._now, self.gaps
        self._now = before if goes_on else before.beginning(record, self.rule.transient)
        try:
            rows = self._examined(made, record, progress, grows=grows)
        except BaseException:
            self._now, self.gaps = before, gaps
            raise
        self._now = replace(self._now, tables=(*before.tables, pd.DataFrame(rows)) if rows else before.tables)
        return pd.DataFrame(rows)

    def goes_on(self, name: str) -> bool:
        """Return whether a record of this name has begun and grows."""
        last = self._now.records[-1:]
        return bool(last) and last[0].name == name and last[0].grows

    @property
    def needed(self) -> float:
        """The time of the last record from which on its rows are needed when it goes on, s."""
        last = self._now.records[-1]
        return last.begin + (self.rule.window or 0.0) * last.windows - self.rule.transient

    def forget(self, rows: int, alarms: int) -> None:
        """Keep so many rows and alarms, the latest, no gaps, and of records those in which an onset may lie."""
        self._now, self.gaps = self._now.without(rows, alarms), ()

    def _comparison(self, record: Experiment) -> BaselineComparator:
        if self._made is None:
            made = BaselineComparator.of(self.system, self.baseline, self.faults, self.causes, [record])
            watch = OnsetTracker(made.healthy.known, made.healthy.drift)
            if self._resumed.sums and self._journal is not None:
                watch = restored(watch, self._resumed.sums, self._journal.folder / STATE_FILE)
            point = self._resumed.sums.get("point", made.coordinates.healthy)
            self._made, self._now = made, replace(self._now, watch=watch, point=point)
            self._against = MonitorReference(made, self.rule, self.model_error)
        return self._made

    # --- the windows of a record

    def _examined(
        self, made: BaselineComparator, record: Experiment, progress: Progress | None, *, grows: bool
    ) -> list[dict[str, Any]]:
        """Return the rows of a record, linearising as many windows at once as are near each other."""
        begun = self._now.records[-1]
        own = GrowingRecord(begun.begin, begun.counts, begun.windows, grows)
        every = split_windows(record, self.rule.window, self.rule.transient, own)
        windows = [each for each in every if each.there]
        missing = [each for each in every if not each.there]
        if not windows and not grows and not begun.windows:
            raise InputError(
                f"{record.source} leaves no window in which every output has a sample that counts: make the transient "
                "or what the study discards shorter, or leave the record out"
            )
        self.gaps += tuple(SkippedWindow(record.source, float(record.times[each.start])) for each in missing)
        self._now = self._now.cut(len(every), grows=grows)
        if not windows:
            if not grows:
                self._finish(made, self.rule.window_level(1, self.rule.window or 1.0))
            return []
        most = max(1, SETTINGS.batch_samples * len(windows) // sum(each.stop - each.start for each in windows))
        level = self.rule.window_level(len(every), windows[0].end - windows[0].begin)
        rows: list[dict[str, Any]] = []
        at, length, tries = 0, 1, 0
        if len(windows) > 1 and not begun.windows:
            self._compare_starts(made, record, windows)
        while at < len(windows):
            batch = windows[at : at + length]
            if progress is not None:
                progress(WindowStep(record=record.name, number=batch[0].number, total=begun.windows + len(every)))
            taken, point, targets = 0, self._now.point, []
            for each in self._summed(made, record, batch):
                seen = WindowEvaluation(self._against, self._now, each, level)
                point = seen.target
                if (taken or tries < SETTINGS.most_steps) and seen.far:
                    break
                rows.append(seen.row())
                targets.append(point)
                self._now, taken = seen.taken(), taken + 1
            tries = 0 if taken else tries + 1
            # the next ones where these were on the whole, or where the one was that lies elsewhere
            self._now = replace(self._now, point=np.mean(targets, axis=0) if taken == len(batch) else point)
            at, length = at + taken, min(2 * length, most) if taken == len(batch) else 1
        if not grows:
            self._finish(made, level)
        return rows

    def _summed(self, made: BaselineComparator, record: Experiment, windows: Sequence[Window]) -> list[WindowSums]:
        part = part_of(record, windows, self.rule.transient)
        self._machine = made.machine(part) if self._machine is None else self._machine.over(part)
        point, healthy = self._now.point, made.coordinates.healthy
        try:
            return list(summed(self._machine, part, windows, point, healthy, made.healthy.whitening))
        except SimulationError:
            if np.array_equal(point, healthy):
                raise
            self._now = replace(self._now, point=healthy)  # where it was last cannot be simulated with these inputs
            return list(summed(self._machine, part, windows, healthy, healthy, made.healthy.whitening))

    def _compare_starts(self, made: BaselineComparator, record: Experiment, windows: Sequence[Window]) -> None:
        """Check that the transient is over in time, and see how it passes."""
        found, slow = build_up_of(made, record, windows, self.rule.transient, self._now.point)
        self._now = replace(self._now, watch=self._now.watch.building_up(found, slow))

    def _finish(self, made: BaselineComparator, level: float) -> None:
        """Judge an alarm that lasts to the end of a record by all that was seen."""
        now = self._now
        if now.judgement is not None:
            self._now = now.said(
                decide_alarm(now.watch, made.coordinates, self.faults, level, self._against.model_error)
            )

    # --- what was found

    @property
    def table(self) -> pd.DataFrame:
        """One row a window.

        ``record``, ``window`` (its number), ``start``, ``end`` (s), ``clock`` (its end by the clock of all records, s),
        ``samples``; ``significant``: the cause that this window by itself shows, "" without; its ``probability`` by
        chance, for all causes together; ``statistic``: D of the cause and onset that all windows up to this one make
        likeliest; ``variance_ratio`` of residual and noise; ``unexplained``: it is larger; ``alarm``: what is new,
        "" without. For each cause its size in this window alone, what was known before as prior, with ``.std``:
        ``turns.dR``, ``gain(i)``; and the healthy parameters with theirs.
        """
        return self._now.table()

    @property
    def records(self) -> tuple[str, ...]:
        """The names of the records."""
        return tuple(each.name for each in self._now.records)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The alarms, in their order."""
        table, now = self.table, self._now
        return tuple(
            each if each.onset is None else with_trend(each, now.clock(each.onset.last), table, self.rule.limits)
            for each in now.alarms
        )

    @property
    def windows(self) -> int:
        """How many were examined."""
        return self._now.row

    def moment(self, record: str, time: float) -> RecordTime:
        """Return a time of one of the records that are held, with its date."""
        return next(each for each in self._now.records if each.name == record).moment_at(time)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The faults that no window determines."""
        table = self.table
        return tuple(
            name
            for name, fault in self.faults.items()
            if len(table) and all(np.isinf(table[f"{name}.{size}.std"]).all() for size in fault.sizes)
        )

    @property
    def coordinates(self) -> ChangeParameterSet | None:
        """All that may differ between the records; None before the first one."""
        return None if self._made is None else self._made.coordinates

    @property
    def basis(self) -> BaselineSource:
        """Where the healthy machine is from."""
        return BaselineSource.RECORDS if self._made is None else self._made.basis

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column of sizes and parameters, "" without."""
        if self.coordinates is None:
            return dict(self._resumed.units)
        return {one.name: one.unit for one in self.coordinates.each if not one.second}

    @property
    def beside(self) -> tuple[str, ...]:
        """The columns of the causes beside the faults, but for the parameters."""
        if self.coordinates is None:
            return self._resumed.columns
        plain = (CauseKind.FAULT, CauseKind.PARAMETER)
        return tuple(one.name for one in self.coordinates.each if one.kind not in plain)

    # --- files

    def write(
        self,
        folder: str | Path,
        also: Mapping[str, Any] | None = None,
        lines: Sequence[str] = (),
        beside: Mapping[str, Any] | None = None,
    ) -> list[Path]:
        """Write ``monitoring.csv``, ``monitoring.json`` and ``monitoring.npz``, which `resume` needs.

        What was written into the same folder before is added to; a break leaves what was written last.

        Parameters
        ----------
        folder : path
        also : mapping, optional
            What else the JSON file is to say.
        lines : sequence of str
            That ``alarms.jsonl`` gets.
        beside : mapping, optional
            What `resume` is to return.
        """
        if self._journal is None or self._journal.folder != Path(folder):
            self._journal = MonitorStore(Path(folder))
        content = {
            "alarms": self.alarms,
            **self._same,
            "rule": self.rule,
            "sizes": {name: [f"{name}.{size}" for size in fault.sizes] for name, fault in self.faults.items()},
            "common": list(self.baseline.common),
            "beside": self.beside,
            "units": self.units,
            **(also or {}),
        }
        kept = Resumed(self._sums, beside or {}, self.units, self.beside)
        return self._journal.write(self._now, content, lines, self._same, kept)

    @property
    def _sums(self) -> Mapping[str, Any]:
        """What onsets need; before the first record those of the earlier run."""
        own = {"point": self._now.point, **self._now.watch.state()}
        return self._resumed.sums if self._made is None else own

    @property
    def _same(self) -> dict[str, Any]:
        """What must be the same to go on with an earlier run."""
        common = {
            name: [each.start, None if each.prior is None else each.prior.std]
            for name, each in self.baseline.common.items()
        }
        healthy = {
            "parameters": common,
            "faults": {name: list(fault.parameters) for name, fault in self.faults.items()},
            "records": [each.name for each in self.baseline.records],
            "shown": None if self.baseline.shown is None or self.baseline.records else self.baseline.shown.subject,
            "causes": self.causes,
        }
        return {"rule": replace(self.rule, limits={}), "healthy": healthy}

    def resume(self, folder: str | Path, rows: int | None = None) -> dict[str, Any]:
        """Go on where an earlier run ended, whose files are in a folder; return what was written beside.

        Parameters
        ----------
        folder : path
        rows : int, optional
            Of the table, that are read again, the last ones; default: all.

        Raises
        ------
        InputError
            If there is none, it is damaged, or it had another rule, other faults or another healthy machine.
        """
        self._journal = MonitorStore(Path(folder))
        self._now, self._resumed = self._journal.read(self._now, self._same, rows)
        return dict(self._resumed.beside)
