"""Monitoring of data, window by window, with alarms (docs/method/monitoring.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.data import Experiment
from fmuid.diagnosis.alarms import Alarm, RecordTime, decide_alarm, with_trend
from fmuid.diagnosis.baseline import Baseline, BaselineSource
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.causes import CauseKind, Causes
from fmuid.diagnosis.faults import Fault, checked_faults
from fmuid.diagnosis.information_matrix import ChangePrior
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.monitor_store import STATE_FILE, MonitorSnapshot, MonitorStore, damage_of
from fmuid.diagnosis.onset_tracker import OnsetTracker
from fmuid.diagnosis.rule import MODEL_ERROR, Rule
from fmuid.diagnosis.window_evaluation import MonitorReference, MonitorState, WindowEvaluation
from fmuid.diagnosis.windows import SkippedWindow, Window, WindowSums, build_up_of, part_of, split_windows, summed
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Result
from fmuid.events import Progress, WindowStep
from fmuid.models import FMU, System


@dataclass(frozen=True)
class MonitoringSettings:
    """Numbers of a monitoring."""

    batch_samples: int = 32_768  # linearized at once
    most_steps: int = 4  # linearizations of a window


SETTINGS = MonitoringSettings()


class Monitor:
    """Monitoring of records for faults, window by window.

    Parameters
    ----------
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    faults : mapping of str to Fault
    model : System, FMU or path
        The healthy machine.
    rule : Rule, optional
    causes : Causes, optional
        Beside the faults, where the baseline has healthy data.
    model_error : float
        κ, as for `fmuid.diagnosis.DiagnosisSettings`.

    Attributes
    ----------
    rule : Rule
    faults : dict of str to Fault
    gaps : tuple of SkippedWindow

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
        self.baseline, self.faults, self.system = Baseline.of(baseline), checked_faults(faults), System.of(model)
        self.rule, self.causes, self.model_error = rule or Rule(), causes or Causes(), model_error
        self.gaps: tuple[SkippedWindow, ...] = ()
        self._journal: MonitorStore | None = None
        self._against: MonitorReference | None = None
        self._machine: LinearizedMachine | None = None
        self._resumed = MonitorSnapshot()
        self._now = MonitorState(
            OnsetTracker(ChangePrior(np.zeros(0), np.zeros((0, 0))), np.zeros((0, 0))), np.zeros(0)
        )

    @single_threaded
    def add(self, record: Experiment, progress: Progress | None = None, *, grows: bool = False) -> pd.DataFrame:
        """Examine the windows of a record and return their rows; an error changes nothing.

        Parameters
        ----------
        record : Experiment
            With the healthy machine's names. Of a growing one the rows from `needed` on, with no warm-up.
        progress : callable, optional
            Called with a `fmuid.events.WindowStep` before windows are linearized.
        grows : bool
            More of the record may come; only whole windows are examined.

        Raises
        ------
        InputError
            If the record is known already, too short or does not fit the model, its transient is longer than the rule's
            warm-up, or it grows without windows or horizon in the rule.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        goes_on = self.goes_on(record.name)
        if record.name in self.records and not goes_on:
            raise InputError(f"{record.source}: {record.name!r} has been monitored already. Remove or rename it.")
        if grows and (self.rule.window is None or self.rule.horizon is None):
            said = "growing data need window_length and false_alarm_horizon in [monitoring]"
            raise InputError(f"{record.source}: {said}. Give both, in s, for example 1.0 and 86400.0.")
        against = self._comparison(record)
        before, gaps = self._now, self.gaps
        self._now = before if goes_on else before.beginning(record, self.rule.transient)
        try:
            rows = self._examined(against, record, progress, grows=grows)
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
        """First time of the last record needed when it goes on, s."""
        last = self._now.records[-1]
        return last.begin + (self.rule.window or 0.0) * last.windows - self.rule.transient

    def forget(self, rows: int, alarms: int) -> None:
        """Drop old rows, alarms and gaps; keep the records of possible onsets."""
        self._now, self.gaps = self._now.without(rows, alarms), ()

    def _comparison(self, record: Experiment) -> MonitorReference:
        if self._against is None:
            causes = self.causes if self.baseline.beside else None
            made = BaselineComparator.of(self.system, self.baseline, self.faults, causes, [record])
            watch = made.healthy.tracker()
            if self._resumed.sums and self._journal is not None:
                with damage_of(self._journal.folder / STATE_FILE):
                    watch = watch.restored(self._resumed.sums)
            point = self._resumed.sums.get("point", made.coordinates.healthy)
            self._now = replace(self._now, watch=watch, point=point)
            self._against = MonitorReference(made, self.rule, self.model_error)
        return self._against

    def _examined(
        self, against: MonitorReference, record: Experiment, progress: Progress | None, *, grows: bool
    ) -> list[dict[str, Any]]:
        """Return the rows of a record, linearizing many near windows at once."""
        begun, rows = self._now.records[-1], list[dict[str, Any]]()
        every = split_windows(record, self.rule.window, self.rule.transient, replace(begun, grows=grows))
        windows = [each for each in every if each.there]
        missing = [each for each in every if not each.there]
        if not windows and not grows and not begun.windows:
            said = "no window has samples of every output after the warm-up"
            raise InputError(f"{record.source}: {said}. Shorten the warm-up, or remove the data.")
        self.gaps += tuple(SkippedWindow(record.source, float(record.times[each.start])) for each in missing)
        self._now = self._now.cut(len(every), grows=grows)
        seconds = windows[0].end - windows[0].begin if windows else self.rule.window or 1.0
        level = self.rule.window_level(len(every) if windows else 1, seconds)
        most = max(1, SETTINGS.batch_samples * len(windows) // max(1, sum(each.stop - each.start for each in windows)))
        at, length, tries = 0, 1, 0
        if len(windows) > 1 and not begun.windows:
            # the length of the transient, and its course
            found = build_up_of(against.made, record, windows, self.rule.transient, self._now.point)
            self._now = replace(self._now, watch=self._now.watch.building_up(*found))
        while at < len(windows):
            batch = windows[at : at + length]
            if progress is not None:
                progress(WindowStep(record=record.name, number=batch[0].number, total=begun.windows + len(every)))
            taken, point, targets = 0, self._now.point, []
            for each in self._summed(against.made, record, batch):
                seen = WindowEvaluation(against, self._now, each, level)
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
        if not grows and self._now.judgement is not None:  # decided again with all data of the record
            again = decide_alarm(self._now.watch, against.coordinates, level, against.model_error)
            self._now = self._now.said(again)
        return rows

    def _summed(self, made: BaselineComparator, record: Experiment, windows: Sequence[Window]) -> list[WindowSums]:
        part = part_of(record, windows, self.rule.transient)
        self._machine = made.machine(part) if self._machine is None else self._machine.over(part)
        point, healthy = self._now.point, made.coordinates.healthy
        try:
            return list(summed(self._machine, windows, point, healthy, made.healthy.whitening))
        except SimulationError:
            if np.array_equal(point, healthy):
                raise
            self._now = replace(self._now, point=healthy)  # where it was last cannot be simulated with these inputs
            return self._summed(made, record, windows)

    @property
    def table(self) -> pd.DataFrame:
        """One row a window.

        ``record``, ``window`` (number), ``start``, ``end`` (s), ``clock`` (end, s of all data), ``samples``.
        ``significant`` is the cause of this window alone, "" without; ``probability`` is by chance, for all causes.
        ``statistic`` is D of the likeliest cause and onset so far. ``variance_ratio`` is of residual and noise;
        ``unexplained`` is true if it is significant. ``alarm`` is the name of the alarm. Healthy parameters and causes
        (``turns.dR``, ``gain(i)``) have their sizes in this window alone, and ``.std``.
        """
        return self._now.table()

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(each.name for each in self._now.records)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """Alarms in their order."""
        table, now = self.table, self._now
        return tuple(
            each if each.onset is None else with_trend(each, now.clock(each.onset.last), table, self.rule.limits)
            for each in now.alarms
        )

    @property
    def windows(self) -> int:
        """Number of examined windows."""
        return self._now.row

    def moment(self, record: str, time: float) -> RecordTime:
        """Return a time of a record with its date."""
        return next(each for each in self._now.records if each.name == record).moment(time)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Faults that no window determines."""
        table = self.table
        return tuple(
            name
            for name, fault in self.faults.items()
            if len(table) and all(np.isinf(table[f"{name}.{size}.std"]).all() for size in fault.sizes)
        )

    @property
    def basis(self) -> BaselineSource:
        """Source of the healthy machine."""
        return BaselineSource.RECORDS if self._against is None else self._against.made.healthy.basis

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column of sizes and parameters, "" without."""
        return dict(self._present.units)

    @property
    def _present(self) -> MonitorSnapshot:
        """State to resume; before the first record that of the earlier run."""
        if self._against is None:
            return self._resumed
        each, plain = self._against.coordinates.each, (CauseKind.FAULT, CauseKind.PARAMETER)
        columns = tuple(one.name for one in each if one.kind not in plain)
        sums = {"point": self._now.point, **self._now.watch.state()}
        return MonitorSnapshot(sums, {}, {one.name: one.unit for one in each if not one.second}, columns)

    def write(
        self,
        folder: str | Path,
        also: Mapping[str, Any] | None = None,
        lines: Sequence[str] = (),
        beside: Mapping[str, Any] | None = None,
    ) -> list[Path]:
        """Write ``monitoring.csv``, ``monitoring.json`` and ``monitoring.npz``, adding to those of earlier calls.

        Parameters
        ----------
        folder : path
        also : mapping, optional
            More content of the JSON file.
        lines : sequence of str
            Added to ``alarms.jsonl``.
        beside : mapping, optional
            Returned by `resume`.
        """
        if self._journal is None or self._journal.folder != Path(folder):
            self._journal = MonitorStore(Path(folder))
        present = replace(self._present, beside=beside or {})
        content = {
            "alarms": self.alarms,
            **self._same,
            "rule": self.rule,
            "sizes": {name: [f"{name}.{size}" for size in fault.sizes] for name, fault in self.faults.items()},
            "common": list(self.baseline.common),
            "beside": present.columns,
            "units": present.units,
            **(also or {}),
        }
        return self._journal.write(self._now, content, lines, self._same, present)

    @property
    def _same(self) -> dict[str, Any]:
        """Content that must be equal to go on with an earlier run."""
        common = self.baseline.common.items()
        healthy = {
            "parameters": {name: [each.start, None if each.prior is None else each.prior.std] for name, each in common},
            "faults": {name: list(fault.parameters) for name, fault in self.faults.items()},
            "records": [each.name for each in self.baseline.records],
            "shown": None if self.baseline.shown is None or self.baseline.records else self.baseline.shown.subject,
            "causes": self.causes,
        }
        return {"rule": replace(self.rule, limits={}), "healthy": healthy}

    def resume(self, folder: str | Path, rows: int | None = None) -> dict[str, Any]:
        """Continue an earlier run in a folder; return its `beside`.

        Parameters
        ----------
        folder : path
        rows : int, optional
            Last rows of the table to read; default: all.

        Raises
        ------
        InputError
            If there is none, it is damaged, or it had another rule, other faults or another healthy machine.
        """
        self._journal = MonitorStore(Path(folder))
        self._now, self._resumed = self._journal.read(self._now, self._same, rows)
        return dict(self._resumed.beside)
