"""How far a monitoring is, and what one more window makes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import BEGIN, Experiment
from fmuid.diagnosis.alarm_decision import AlarmDecision, decide_alarm
from fmuid.diagnosis.alarms import SOMETHING_ELSE, Alarm, Onset, RecordTime, Rule, label_of
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.cause_results import Explanation, changes
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import Cause, CauseKind
from fmuid.diagnosis.change_detection import fit, log_chances, log_limit
from fmuid.diagnosis.diagnosis_result import EXPLAINED_SHARE
from fmuid.diagnosis.information_matrix import LEAST, ChangePrior, ScoreStatistics
from fmuid.diagnosis.onset_tracker import OnsetTracker, statistics_of
from fmuid.diagnosis.unexplained_residual import VarianceRatio
from fmuid.diagnosis.windows import WindowSums


@dataclass(frozen=True)
class EvaluationSettings:
    """Numbers of the evaluation of a window.

    Attributes
    ----------
    far : float
        A window is linearised again where its estimate is further away: its distance in standard deviations
        times the largest relative change of a coordinate, about the error of the linear model in standard
        deviations.
    grown : float
        An alarm is judged again when D has grown by this share.
    free : float
        A cause that is named is free: by so many times its own size.
    """

    far: float = 0.3
    grown: float = 0.2
    free: float = 1e3


SETTINGS = EvaluationSettings()


@dataclass(frozen=True)
class WatchedRecord:
    """A record that was monitored.

    Attributes
    ----------
    name : str
    begin : float
        Of its time, s.
    clock : float
        The same by the clock of all records, s.
    date : str
        Of time zero, "" where the table has no dates.
    counts : float
        From when on its samples count, s.
    windows : int
        Which it was cut into so far.
    grows : bool
        Whether more of it may come.
    """

    name: str
    begin: float
    clock: float
    date: str = ""
    counts: float = 0.0
    windows: int = 0
    grows: bool = False

    def moment(self, clock: float) -> RecordTime:
        """Return a time of the record by the clock of all."""
        return self.moment_at(clock - self.clock + self.begin)

    def moment_at(self, time: float) -> RecordTime:
        """Return a time of the record with its date."""
        date = (pd.Timestamp(self.date) + pd.Timedelta(seconds=time)).isoformat() if self.date else ""
        return RecordTime(self.name, time, date)


@dataclass(frozen=True, eq=False)
class MonitorState:
    """How far a monitoring is.

    Attributes
    ----------
    watch : OnsetTracker
    point : (N,) array
        Where the next window is linearised.
    records : tuple of WatchedRecord
    tables : tuple of DataFrame
        The rows of each record.
    alarms : tuple of Alarm
    row : int
        Of the next window.
    forgotten : int
        Rows before those of the tables.
    judgement : AlarmDecision or None
        Of the alarm that there is.
    statistic : float
        D when that was judged.
    """

    watch: OnsetTracker
    point: Floats
    records: tuple[WatchedRecord, ...] = ()
    tables: tuple[pd.DataFrame, ...] = ()
    alarms: tuple[Alarm, ...] = ()
    row: int = 0
    forgotten: int = 0
    judgement: AlarmDecision | None = None
    statistic: float = 0.0

    def beginning(self, record: Experiment, transient: float) -> MonitorState:
        """Return how far it is where a record begins: an alarm that lasts is judged anew."""
        date, begin = record.frame.attrs.get(BEGIN), float(record.times[0])
        counts = begin + max(record.discard, transient)
        made = WatchedRecord(record.name, begin, self.watch.end, "" if date is None else str(date), counts)
        return replace(self, records=(*self.records, made), judgement=None, statistic=0.0)

    def cut(self, windows: int, *, grows: bool) -> MonitorState:
        """Return it with so many more windows of the last record."""
        last = self.records[-1]
        last = replace(last, windows=last.windows + windows, grows=grows)
        return replace(self, records=(*self.records[:-1], last))

    def table(self) -> pd.DataFrame:
        """Return the rows that are held, with their numbers as index."""
        found = pd.concat(self.tables, ignore_index=True) if self.tables else pd.DataFrame()
        found.index = found.index + self.forgotten
        return found

    def without(self, rows: int, alarms: int) -> MonitorState:
        """Return it with so many of the latest rows and alarms, and the records that onsets may lie in."""
        table = self.table().tail(rows)
        needed, kept = self.watch.clocks(), []
        for k, each in enumerate(self.records, start=1):
            last = k == len(self.records)
            low = int(np.searchsorted(needed, each.clock))
            if last or (low < needed.size and needed[low] < self.records[k].clock):
                kept.append(each)
        return replace(
            self, tables=(table,), forgotten=self.row - len(table), alarms=self.alarms[-alarms:], records=tuple(kept)
        )

    def moment(self, clock: float) -> RecordTime:
        """Return the record and its time at a time by the clock of all."""
        before = [each for each in self.records if each.clock <= clock]
        return (before[-1] if before else self.records[0]).moment(clock)

    def clock(self, moment: RecordTime) -> float:
        """Return a moment by the clock of all records."""
        record = next(each for each in self.records if each.name == moment.record)
        return moment.time - record.begin + record.clock

    def said(self, found: AlarmDecision) -> MonitorState:
        """Return it with an alarm that was judged again."""
        last = self.alarms[-1]
        if last.fault == SOMETHING_ELSE:
            return self
        last = replace(last, fault=label_of(found.explanations), onset=self._onset(found))
        return replace(self, alarms=(*self.alarms[:-1], replace(last, explanations=found.explanations)))

    def _onset(self, found: AlarmDecision) -> Onset:
        first, last = found.when.between
        return Onset(self.moment(found.when.clock), self.moment(first), self.moment(last), found.when.shape)

    def alarmed(self, label: str, time: float) -> tuple[Alarm, ...]:
        """Return the alarms with that of one more window, "" for none."""
        if not label:
            return self.alarms
        goes_on = bool(self.alarms) and self.alarms[-1].last == self.row - 1
        name = self.records[-1].name
        alarm = replace(self.alarms[-1], last=self.row) if goes_on else Alarm(label, name, time, self.row, self.row)
        explanations: tuple[Explanation, ...] = ()
        onset = None
        if self.judgement is not None:
            onset = self._onset(self.judgement)
            explanations = () if label == SOMETHING_ELSE else self.judgement.explanations
        alarm = replace(alarm, fault=label, onset=onset, explanations=explanations)
        return (*(self.alarms[:-1] if goes_on else self.alarms), alarm)


class MonitorReference:
    """What every window is compared with.

    Parameters
    ----------
    made : BaselineComparator
    rule : Rule
    model_error : float
    """

    def __init__(self, made: BaselineComparator, rule: Rule, model_error: float) -> None:
        self.made, self.rule = made, rule
        self.model_error = made.model_error(model_error, rule.level)
        self.coordinates = made.coordinates
        self.known = made.healthy.known.drifting(made.healthy.drift)
        kinds = {CauseKind.PARAMETER, CauseKind.FAULT}
        # offsets and delays are linear; gains are near 1
        exact = {CauseKind.OFFSET, CauseKind.DELAY}
        self.magnitude = np.array(
            [
                each.step / CAUSES.difference_step if each.kind in kinds else math.inf if each.kind in exact else 1.0
                for each in self.coordinates.each
            ]
        )
        self.lower, self.upper = np.full(self.magnitude.size, -np.inf), np.full(self.magnitude.size, np.inf)
        for i, each in enumerate(self.coordinates.each):
            of = made.baseline.common if each.kind is CauseKind.PARAMETER else None
            if each.kind is CauseKind.FAULT and each.variable not in made.faults[each.fault].located:
                of = dict(made.faults[each.fault].parameters)
            if of is not None:
                self.lower[i], self.upper[i] = of[each.variable].min, of[each.variable].max
        self.faulty = np.array([each.kind is CauseKind.FAULT for each in self.coordinates.each])
        self.limit = lru_cache(lambda level, windows: log_limit(level, self.coordinates.causes, windows))

    def free(self, columns: tuple[int, ...]) -> ChangePrior:
        """Return what is known where some coordinates may be anything."""
        std = np.zeros(self.magnitude.size)
        for cause in self.coordinates.causes:
            at = [i for i in cause.columns if i in columns]
            std[at] = SETTINGS.free * cause.size
        return self.known.drifting(std)


class WindowEvaluation:
    """One more window.

    Parameters
    ----------
    against : MonitorReference
    now : MonitorState
        Before the window.
    sums : WindowSums
    level : float
        Probability of a false alarm in this window.
    """

    def __init__(self, against: MonitorReference, now: MonitorState, sums: WindowSums, level: float) -> None:
        self.against, self.sums, self.level = against, sums, level
        self.watch, record = now.watch.copy(), now.records[-1]
        self.clock = sums.window.end + record.clock - record.begin
        self.watch.add(sums.blocks(record.clock - record.begin))
        causes = against.coordinates.causes
        statistics = self.watch.statistics(causes)[1]
        chances = log_chances(statistics, causes)
        windows = self.watch.windows
        # thresholds change little: by the next power of 2
        limit = against.limit(level, windows if windows < 16 else 1 << (windows - 1).bit_length())
        self.statistic = float(statistics.ravel()[int(np.argmin(chances))])
        self.now = self._judged(now) if chances.min() < limit else replace(now, judgement=None, statistic=0.0)
        found = self.now.judgement
        begin = sums.window.begin + record.clock - record.begin
        settled = found is not None and found.since <= begin + sums.window.slack
        self.free = found.columns if found is not None and settled else ()
        self.known = against.free(self.free) if self.free else against.known
        self.estimate = self.known.after_also(sums.whole)

    def _judged(self, now: MonitorState) -> MonitorState:
        old = now.judgement
        if old is not None and math.isfinite(old.since) and self.statistic < (1.0 + SETTINGS.grown) * now.statistic:
            return now
        made = self.against.made
        found = decide_alarm(self.watch, made.coordinates, made.faults, self.level, self.against.model_error)
        self.watch.pinned = found.when.between
        return replace(now, judgement=found, statistic=self.statistic)

    @cached_property
    def target(self) -> Floats:
        """Where the window would be linearised best (N,): at its estimate, with the faults that are named."""
        mean = self.estimate.mean.copy()
        hidden = self.against.faulty.copy()
        hidden[list(self.free)] = False
        mean[hidden] = 0.0
        point = self.against.coordinates.healthy + mean
        return np.clip(point, self.against.lower, self.against.upper)

    @property
    def far(self) -> bool:
        """Whether it was linearised too far from there."""
        off = self.target - self.now.point
        distance = math.sqrt(max(0.0, float(off @ self.sums.whole.matrix @ off)))
        return float(np.max(np.abs(off) / self.against.magnitude)) * distance > SETTINGS.far

    def taken(self) -> MonitorState:
        """Return how far the monitoring is with it."""
        end = self.sums.window.end
        return replace(self.now, watch=self.watch, alarms=self.now.alarmed(self.label, end), row=self.now.row + 1)

    @cached_property
    def _ratios(self) -> tuple[float, float]:
        """The variance of the residual over the noise, without anything new and with what is named."""
        null = self.against.known.after_also(self.sums.whole).mean if self.free else self.estimate.mean
        samples = max(1, self.sums.samples)
        return self.sums.squares(null) / samples, self.sums.squares(self.estimate.mean) / samples

    @cached_property
    def unexplained(self) -> bool:
        """Whether the residual is larger than the noise, whatever is named."""
        freedom = self.against.made.baseline.freedom
        return VarianceRatio.of(self._ratios[1], self.sums.samples, freedom, self.level).larger

    @property
    def label(self) -> str:
        """What an alarm is called, "" without."""
        found = self.now.judgement
        if found is None:
            return SOMETHING_ELSE if self.unexplained else ""
        without, with_ = self._ratios
        if self.free and self.unexplained and without - with_ < EXPLAINED_SHARE * (without - 1.0):
            return SOMETHING_ELSE
        return label_of(found.explanations)

    def row(self) -> dict[str, Any]:
        """Return the window's row of the table."""
        window, causes = self.sums.window, self.against.coordinates.causes
        news = ScoreStatistics.of(self.sums.whole, self.against.known)
        least = LEAST * np.diag(self.sums.whole.matrix)
        statistics = statistics_of((news.information + np.diag(least))[None], news.score[None], causes)
        chances = log_chances(statistics, causes)[0]
        best = causes[int(np.argmin(chances))]
        probability = min(1.0, len(causes) * math.exp(chances.min()))
        of = self.against.coordinates.each[best.columns[0]]
        row: dict[str, Any] = {
            "record": self.now.records[-1].name,
            "window": window.number,
            "start": window.begin,
            "end": window.end,
            "clock": self.clock,
            "samples": self.sums.samples,
            "significant": (of.fault or of.name) if probability <= self.against.rule.level else "",
            "probability": probability,
            "statistic": self.statistic,
            "variance_ratio": self._ratios[1],
            "unexplained": self.unexplained,
            "alarm": self.label,
        }
        std = np.sqrt(np.maximum(np.diag(self.estimate.covariance), 0.0))
        healthy = self.against.coordinates.healthy
        for i in self.against.coordinates.of(CauseKind.PARAMETER):
            name = self.against.coordinates.each[i].variable
            row |= {name: healthy[i] + self.estimate.mean[i], f"{name}.std": float(std[i])}
        for cause in causes:
            row |= self._alone(news, cause, least)
        return row

    def _alone(self, news: ScoreStatistics, cause: Cause, least: Floats) -> dict[str, float]:
        """Return the cells of a cause as this window shows it by itself."""
        first = self.against.coordinates.each[cause.columns[0]]
        name = first.name if first.kind is not CauseKind.PARAMETER else f"{first.name} drift"
        if len(cause.columns) > 1:
            found = fit(news, (cause,))
            change = changes((cause,), found, self.against.coordinates, self.against.made.faults)[0]
            return {name: change.value, f"{name}.std": change.std, f"{change.fault}.{change.angle}": change.angle_value}
        i = cause.columns[0]
        own, score = float(news.information[i, i]), float(news.score[i])
        if not own > least[i]:
            return {name: 0.0, f"{name}.std": math.inf}
        return {
            name: max(0.0, score * cause.sign) * cause.sign / own if cause.sign else score / own,
            f"{name}.std": own**-0.5,
        }
