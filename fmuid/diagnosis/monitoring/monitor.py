"""Monitoring: a long record, or one record after the other, window by window, and an alarm where something is new.

The machine is linearised once over many windows, where it was estimated last; each window adds its information and
score to those of all onsets (`fmuid.diagnosis.evidence.onset`), and nothing is fitted twice. What may drift, as a
temperature moves a resistance, is another number in each window. There is an alarm where a cause from some window on
explains more than chance would in any window at the level asked for; then the windows after the onset, with what was
before as prior, say which cause it is and how large.

Each window is simulated from a little earlier on, longer than a transient, so that its unknown initial state is
forgotten and no sample is lost (docs/method.md section 5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.comparison import Juxtaposition
from fmuid.diagnosis.coordinates import CauseKind, Causes, Coordinates
from fmuid.diagnosis.evidence.information import Known
from fmuid.diagnosis.evidence.naming import MODEL_ERROR
from fmuid.diagnosis.evidence.watch import Watch
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.linearisation import Machine
from fmuid.diagnosis.monitoring import state
from fmuid.diagnosis.monitoring.alarms import Alarm, Rule, Trend
from fmuid.diagnosis.monitoring.judging import judged
from fmuid.diagnosis.monitoring.seeing import Against, Now, Seen
from fmuid.diagnosis.monitoring.sums import WindowSums, summed
from fmuid.diagnosis.monitoring.windows import Window, cut, part_of
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Result
from fmuid.fmi import FMU
from fmuid.models import System
from fmuid.progress import Progress, WindowStep

# Simulations from an early and from a late start agree after the transient to this share of the noise's deviation.
TRANSIENT_SHARE = 0.2
# So many samples are linearised at once.
BATCH_SAMPLES = 32_768
# A window is linearised again, where it was estimated, at most so often.
MOST_STEPS = 4


@dataclass(frozen=True)
class Gap:
    """A window of a record in which no sample of some output counts.

    Attributes
    ----------
    source : str
        Of the record.
    time : float
        Where the window begins, s.
    """

    source: str
    time: float


class Monitor:
    """Watches records for faults, window by window.

    Parameters
    ----------
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    hypotheses : mapping of str to Fault
    nominal_model : System, FMU or path
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
    gaps : tuple of Gap
        Windows that are left out.

    Raises
    ------
    InputError
        If there is no hypothesis, or the healthy result does not fit the model.

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
        hypotheses: Mapping[str, Fault],
        nominal_model: System | FMU | str | Path,
        rule: Rule | None = None,
        causes: Causes | None = None,
        model_error: float = MODEL_ERROR,
    ) -> None:
        if not hypotheses:
            raise InputError("there is no fault to look for: give at least one fault model with its parameters")
        self.baseline, self.faults, self.system = Baseline.of(baseline), dict(hypotheses), System.of(nominal_model)
        self.rule, self.causes, self.model_error = rule or Rule(), causes or Causes(), model_error
        self.gaps: tuple[Gap, ...] = ()
        self._made: Juxtaposition | None = None
        self._machine: Machine | None = None
        self._resumed: Mapping[str, Any] = {}
        self._now = Now(Watch(Known(np.zeros(0), np.zeros((0, 0))), np.zeros(0)), np.zeros(0))

    def add(self, record: Experiment, progress: Progress | None = None) -> pd.DataFrame:
        """Examine the windows of a record and return their rows; what goes wrong leaves everything as it was.

        Parameters
        ----------
        record : Experiment
            With the healthy machine's names; what it discards is left out at its beginning.
        progress : callable, optional
            Called with a `fmuid.progress.WindowStep` before windows are linearised.

        Raises
        ------
        InputError
            If a record of this name is there already, it is shorter than a window, has other inputs or outputs than
            the model, or its transient lasts longer than the rule says.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        if record.name in self.records:
            raise InputError(
                f"{record.source}: a record named {record.name!r} has been monitored already: leave it out or rename it"
            )
        made = self._comparison(record)
        before = self._now
        self._now = before.beginning(record)
        try:
            rows = self._examined(made, record, progress)
        except BaseException:
            self._now = before
            raise
        self._now = replace(self._now, tables=(*before.tables, pd.DataFrame(rows)))
        return self._now.tables[-1]

    def _comparison(self, record: Experiment) -> Juxtaposition:
        if self._made is None:
            made = Juxtaposition.of(self.system, self.baseline, self.faults, self.causes, [record])
            watch = Watch(made.healthy.known, made.healthy.drift)
            if self._resumed:
                watch = state.restored(watch, self._resumed)
            point = self._resumed.get("point", made.coordinates.healthy)
            self._made, self._now = made, replace(self._now, watch=watch, point=point)
            self._against = Against(made, self.rule, self.model_error)
        return self._made

    # --- the windows of a record

    def _examined(self, made: Juxtaposition, record: Experiment, progress: Progress | None) -> list[dict[str, Any]]:
        """Return the rows of a record, linearising as many windows at once as are near each other."""
        every = cut(record, self.rule.window, self.rule.transient)
        windows = [each for each in every if each.there]
        if not windows:
            raise InputError(
                f"{record.source} leaves no window in which every output has a sample that counts: make the transient "
                "or what the study discards shorter, or leave the record out"
            )
        most = max(1, BATCH_SAMPLES * len(windows) // sum(each.stop - each.start for each in windows))
        level = self.rule.window_level(len(every), windows[0].end - windows[0].begin)
        rows: list[dict[str, Any]] = []
        at, length, tries = 0, 1, 0
        if len(windows) > 1:
            self._check_transient(made, record, windows)
        while at < len(windows):
            batch = windows[at : at + length]
            if progress is not None:
                progress(WindowStep(record=record.name, number=batch[0].number, total=len(every)))
            taken, point, targets = 0, self._now.point, []
            for each in self._summed(made, record, batch):
                seen = Seen(self._against, self._now, each, level)
                point = seen.target
                if (taken or tries < MOST_STEPS) and seen.far:
                    break
                rows.append(seen.row())
                targets.append(point)
                self._now, taken = seen.taken(), taken + 1
            tries = 0 if taken else tries + 1
            # the next ones where these were on the whole, or where the one was that lies elsewhere
            self._now = replace(self._now, point=np.mean(targets, axis=0) if taken == len(batch) else point)
            at, length = at + taken, min(2 * length, most) if taken == len(batch) else 1
        missing = [each for each in every if not each.there]
        self.gaps += tuple(Gap(record.source, float(record.times[each.start])) for each in missing)
        self._finish(made, level)
        return rows

    def _summed(self, made: Juxtaposition, record: Experiment, windows: Sequence[Window]) -> list[WindowSums]:
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

    def _check_transient(self, made: Juxtaposition, record: Experiment, windows: Sequence[Window]) -> None:
        """Compare the simulation from a little before the second window with that from the beginning of the record."""
        late, early = (part_of(record, each, self.rule.transient) for each in (windows[1:2], windows[:2]))
        point = self._now.point
        outputs = [made.machine(part).outputs(point)[-late.times.size :] for part in (late, early)]
        std = np.array([made.healthy.whitening.std(name) for name in record.output_names])
        off = (np.abs(outputs[0] - outputs[1]) / std)[late.counted]
        if off.max(initial=0.0) > TRANSIENT_SHARE:
            raise InputError(
                f"{record.source}: the transient lasts longer than {self.rule.transient:g} s: what a simulation "
                f"starts from still shows then, by {off.max():.2g} standard deviations of the noise; "
                "give a longer transient, and windows longer than that"
            )

    def _finish(self, made: Juxtaposition, level: float) -> None:
        """Judge an alarm that lasts to the end of a record by all that was seen."""
        now = self._now
        if now.judgement is not None:
            self._now = now.said(judged(now.watch, made.coordinates, self.faults, level, self.model_error))

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
        return pd.concat(self._now.tables, ignore_index=True) if self._now.tables else pd.DataFrame()

    @property
    def records(self) -> tuple[str, ...]:
        """The names of the records."""
        return tuple(each.name for each in self._now.records)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The alarms, in their order."""
        return tuple(self._with_trend(each) for each in self._now.alarms)

    def _with_trend(self, alarm: Alarm) -> Alarm:
        if not alarm.explanations or alarm.onset is None:
            return alarm
        column = alarm.explanations[0].changes[0].label
        rows = self.table.iloc[: alarm.last + 1]
        since = self._now.clock(alarm.onset.last)
        begin = rows["clock"] - (rows["end"] - rows["start"])
        rows = rows[(begin >= since - 1e-6 * abs(since)).to_numpy(bool)]
        if rows.empty:
            return alarm
        values, stds, clock = (rows[name].to_numpy(np.float64) for name in (column, f"{column}.std", "clock"))
        return replace(alarm, trend=Trend.of(column, clock, values, stds, self.rule.limits.get(column, math.nan)))

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
    def coordinates(self) -> Coordinates | None:
        """All that may differ between the records; None before the first one."""
        return None if self._made is None else self._made.coordinates

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column of sizes and parameters, "" without."""
        each = () if self.coordinates is None else self.coordinates.each
        return {one.name: one.unit for one in each if not one.second}

    @property
    def beside(self) -> tuple[str, ...]:
        """The columns of the causes beside the faults, but for the parameters."""
        each = () if self.coordinates is None else self.coordinates.each
        plain = (CauseKind.FAULT, CauseKind.PARAMETER)
        return tuple(one.name for one in each if one.kind not in plain)

    # --- files

    def write(self, folder: str | Path, also: Mapping[str, Any] | None = None) -> list[Path]:
        """Write ``monitoring.csv``, ``monitoring.json`` and ``monitoring.npz``, which `resume` needs.

        Parameters
        ----------
        folder : path
        also : mapping, optional
            What else the JSON file is to say.
        """
        content = {
            "alarms": self.alarms,
            **self._same,
            "sizes": {name: [f"{name}.{size}" for size in fault.sizes] for name, fault in self.faults.items()},
            "common": list(self.baseline.common),
            "beside": self.beside,
            "units": self.units,
            **(also or {}),
        }
        return state.write(Path(folder), self._now, self.table, content)

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
            "causes": self.causes,
        }
        return {"rule": self.rule, "healthy": healthy}

    def resume(self, folder: str | Path) -> None:
        """Go on where an earlier run ended, whose files are in a folder.

        Raises
        ------
        InputError
            If there is none, or it had another rule, other faults or another healthy machine.
        """
        self._now, self._resumed = state.read(Path(folder), self._now, self._same)
