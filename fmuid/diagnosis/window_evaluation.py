"""State of a monitoring, and its update by a window."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import BEGIN, Experiment
from fmuid.diagnosis.alarms import SOMETHING_ELSE, Alarm, AlarmDecision, Onset, RecordTime, decide_alarm, label_of
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.cause_results import changes
from fmuid.diagnosis.causes import Cause, CauseKind
from fmuid.diagnosis.change_detection import as_normal, fit, log_chances, log_limit
from fmuid.diagnosis.diagnosis_result import EXPLAINED_SHARE
from fmuid.diagnosis.information_matrix import LEAST, ChangePrior, ScoreStatistics
from fmuid.diagnosis.noise_ratios import NoiseRatios
from fmuid.diagnosis.onset_tracker import OnsetTracker, statistics_of
from fmuid.diagnosis.population import SETTINGS as POPULATION
from fmuid.diagnosis.rule import Rule
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import VarianceRatio
from fmuid.diagnosis.windows import WatchedRecord, WindowSums


@dataclass(frozen=True)
class EvaluationSettings:
    """Numbers of the evaluation of a window."""

    far: float = 0.3  # error of the linear model, in standard deviations, beyond which a window is linearized again
    grown: float = 0.2  # share by which D grows before an alarm is decided again
    gone: float = 6.9  # log odds of no cause that end an alarm: 1000 : 1


SETTINGS = EvaluationSettings()


@dataclass(frozen=True, eq=False)
class MonitorState:
    """State of a monitoring between windows."""

    watch: OnsetTracker
    point: Floats  # (N,), of the next linearization
    records: tuple[WatchedRecord, ...] = ()
    tables: tuple[pd.DataFrame, ...] = ()  # rows of each record
    alarms: tuple[Alarm, ...] = ()
    row: int = 0  # of the next window
    forgotten: int = 0  # rows before those of the tables
    judgement: AlarmDecision | None = None  # of the present alarm
    gone: float = 0.0  # cumulated log-likelihood ratio of no cause against it, since `absent`
    absent: float = 0.0  # s of all data
    statistic: float = 0.0  # D of that decision

    def beginning(self, record: Experiment, transient: float) -> MonitorState:
        """Return the state at the begin of a record: a lasting alarm is decided again."""
        date, begin = record.frame.attrs.get(BEGIN), float(record.times[0])
        counts = begin + max(record.warmup, transient)
        made = WatchedRecord(record.name, begin, self.watch.end, "" if date is None else str(date), counts)
        return replace(self, records=(*self.records, made), statistic=0.0)

    def cut(self, windows: int, *, grows: bool) -> MonitorState:
        """Return the state with so many more windows of the last record."""
        last = self.records[-1]
        last = replace(last, windows=last.windows + windows, grows=grows)
        return replace(self, records=(*self.records[:-1], last))

    def table(self) -> pd.DataFrame:
        """Return the rows held, with their numbers as index."""
        found = pd.concat(self.tables, ignore_index=True) if self.tables else pd.DataFrame()
        found.index = found.index + self.forgotten
        return found

    def without(self, rows: int, alarms: int) -> MonitorState:
        """Return the state without old rows, alarms and records."""
        table = self.table().tail(rows)
        first = np.searchsorted(self.watch.clocks(), [each.clock for each in self.records])  # of the onsets
        said, last = self.alarms[-alarms:], len(self.records) - 1
        dated = {each.onset.last.record for each in said if each.onset is not None}
        kept = tuple(
            each for k, each in enumerate(self.records) if k == last or first[k] < first[k + 1] or each.name in dated
        )
        return replace(self, tables=(table,), forgotten=self.row - len(table), alarms=said, records=kept)

    def moment(self, clock: float) -> RecordTime:
        """Return the time of a record at s of all data."""
        record = next((each for each in reversed(self.records) if each.clock <= clock), self.records[0])
        return record.moment(clock - record.clock + record.begin)

    def clock(self, moment: RecordTime) -> float:
        """Return a time of a record in s of all data."""
        record = next(each for each in self.records if each.name == moment.record)
        return moment.time - record.begin + record.clock

    def said(self, found: AlarmDecision) -> MonitorState:
        """Return the state with the last alarm decided again."""
        last, why = self.alarms[-1], found.explanations
        if last.fault == SOMETHING_ELSE:
            return self
        last = replace(last, fault=label_of(why), onset=self._onset(found), explanations=why)
        return replace(self, alarms=(*self.alarms[:-1], last))

    def _onset(self, found: AlarmDecision) -> Onset:
        first, last = found.when.between
        return Onset(self.moment(found.when.clock), self.moment(first), self.moment(last), found.when.shape)

    def alarmed(self, label: str, time: float) -> tuple[Alarm, ...]:
        """Return the alarms after one more window, with label "" for none."""
        if not label:
            return self.alarms
        *before, last = *self.alarms, Alarm(label, self.records[-1].name, time, self.row, self.row)
        if before and before[-1].last == self.row - 1:
            last = replace(before.pop(), last=self.row)
        found = self.judgement
        why = found.explanations if found is not None else ()
        if label == SOMETHING_ELSE:  # a cause may begin or end within one window
            why = () if last.fault == SOMETHING_ELSE else last.explanations
        onset = None if found is None else self._onset(found)
        return (*before, replace(last, fault=label, onset=onset, explanations=why))


class MonitorReference:
    """Constants of the comparison of windows with a baseline."""

    def __init__(self, made: BaselineComparator, rule: Rule, model_error: float) -> None:
        self.made, self.rule = made, rule
        self.model_error = made.model_error(model_error, rule.level)
        self.coordinates = made.coordinates
        self.known = made.healthy.known.drifting(made.healthy.drift)
        self.magnitude = self.coordinates.magnitude
        common = made.baseline.common
        limits = [
            (common[each.variable].min, common[each.variable].max)
            if each.kind is CauseKind.PARAMETER
            else self.coordinates.limits(each)
            for each in self.coordinates.each
        ]
        self.lower, self.upper = np.array(limits).T
        known = made.healthy.noise
        self._healthy_ratios = None if known is None or len(known.ratios) < POPULATION.least else known.pooled
        self.limit = lru_cache(lambda level, windows: log_limit(level, self.coordinates.causes, windows))

    def noise(self, sums: WindowSums, at: Floats) -> VarianceRatio:
        """Compare a window's residual at some coordinates with healthy noise."""
        samples, share = max(1, sums.samples), self.made.healthy.whitening.share
        ratio = sums.whole.squares_at(at) / samples
        if self._healthy_ratios is None:
            return VarianceRatio.of(ratio, share * samples, share * self.made.baseline.freedom)
        new = NoiseRatios(np.array([[ratio]]), np.array([[share * samples]]))
        return self._healthy_ratios.compared(new)[0]

    @cached_property
    def all_free(self) -> ChangePrior:
        """Prior with the coordinates of all causes free."""
        return self.known.drifting(self.coordinates.free(self.coordinates.causes))


class WindowEvaluation:
    """Change statistics after one more window, at its false-alarm level."""

    def __init__(self, against: MonitorReference, now: MonitorState, sums: WindowSums, level: float) -> None:
        self.against, self.raw, self.level = against, sums, level
        # its noise may be larger than healthy noise, beside causes of any size
        noise = against.noise(sums, against.all_free.after_also(sums.whole).mean)
        self.sums = sums = sums.quieter(noise.ratio) if noise.is_larger(against.rule.level) else sums
        self.watch, record = now.watch.copy(), now.records[-1]
        self.clock = sums.window.end + record.clock - record.begin
        self.watch.add(sums.blocks(record.clock - record.begin))
        causes = against.coordinates.causes
        statistics, freedom = self.watch.statistics(causes)
        chances = log_chances(as_normal(statistics, freedom), causes)
        windows = self.watch.windows
        # thresholds change little: by the next power of 2
        limit = against.limit(level, windows if windows < 16 else 1 << (windows - 1).bit_length())
        self.statistic = float(statistics.ravel()[int(np.argmin(chances))])
        begin = sums.window.begin + record.clock - record.begin
        # the alarm so far is of a change before this window
        self.now = now if now.judgement is None else self._ended(now, now.judgement, begin)
        self.ended = self.now.judgement is not now.judgement
        if not self.ended:
            self.now = self._judged(self.now) if chances.min() < limit else replace(now, judgement=None, statistic=0.0)
        found = self.now.judgement
        named = () if found is None or found.since > begin + sums.window.slack else found.causes
        self.free = [i for cause in named for i in cause.columns]
        self.known = against.known.drifting(against.coordinates.free(named))
        self.estimate = self.known.after_also(sums.whole)

    def _judged(self, now: MonitorState) -> MonitorState:
        old = now.judgement
        if old is not None and math.isfinite(old.since) and self.statistic < (1.0 + SETTINGS.grown) * now.statistic:
            return now
        found = decide_alarm(self.watch, self.against.coordinates, self.level, self.against.model_error)
        self.watch.pinned = found.when.between
        return replace(now, judgement=found, statistic=self.statistic)

    def _ended(self, now: MonitorState, found: AlarmDecision, begin: float) -> MonitorState:
        """Return the state, without the alarm if its causes are gone."""
        columns = list(found.columns)
        information, score = self._news.part(columns)
        gone = now.gone + float(0.5 * found.sizes @ information @ found.sizes - score @ found.sizes)
        if gone <= 0.0:
            return replace(now, gone=0.0)
        absent = begin if now.gone == 0.0 else now.absent
        if gone >= SETTINGS.gone and self._alone_probability <= self.against.rule.level:
            return replace(now, gone=0.0, statistic=0.0)  # another change than that: it is decided again
        if gone < SETTINGS.gone:
            return replace(now, gone=gone, absent=absent)
        self.watch = self.watch.restarted(found.when.between[0])
        alarms = now.alarms
        for last in alarms[-1:]:
            name = label_of(last.explanations) or last.fault
            alarms = (*alarms[:-1], replace(last, fault=name, ended=now.moment(absent)))
        return replace(now, judgement=None, statistic=0.0, gone=0.0, alarms=alarms)

    @cached_property
    def target(self) -> Floats:
        """Next point of linearization (N,): toward the estimate, with the named faults only."""
        coordinates = self.against.coordinates
        point = coordinates.without_faults(coordinates.healthy + self.estimate.mean, self.free)
        return coordinates.toward(self.now.point, np.clip(point, self.against.lower, self.against.upper))

    @property
    def far(self) -> bool:
        """True if the window was linearized too far from the target."""
        off, whole = self.target - self.now.point, self.sums.whole
        if whole.curvature(off, self.against.coordinates.magnitude) > SETTINGS.far:
            return True
        # innovations are limited about the point
        limited = math.isfinite(self.against.made.healthy.whitening.limit)
        return limited and whole.distance(off) > SETTINGS.far * math.sqrt(self.sums.samples)

    def taken(self) -> MonitorState:
        """Return the state with this window."""
        end = self.sums.window.end
        return replace(self.now, watch=self.watch, alarms=self.now.alarmed(self.label, end), row=self.now.row + 1)

    @cached_property
    def _variance(self) -> VarianceRatio:
        """Residual with the named causes, against healthy noise."""
        return self.against.noise(self.raw, self.estimate.mean)

    @property
    def unexplained(self) -> bool:
        """True if the residual is larger than the noise in any case."""
        return self._variance.is_larger(UNEXPLAINED_RESIDUAL.level_share * self.level)

    @property
    def _is_poorly_explained(self) -> bool:
        """True if the named causes explain little beyond the noise."""
        null = self.against.known.after_also(self.sums.whole).mean
        without = self.against.noise(self.raw, null).ratio
        return without - self._variance.ratio < EXPLAINED_SHARE * (without - 1.0)

    @property
    def label(self) -> str:
        """Name of the alarm, "" without."""
        found = self.now.judgement
        if self.ended:  # a part of the window may still have the cause
            return ""
        if found is None:
            return SOMETHING_ELSE if self.unexplained else ""
        ending = self.now.gone > 0.0  # a part of the window has the cause
        if self.free and self.unexplained and not ending and self._is_poorly_explained:
            return SOMETHING_ELSE
        return label_of(found.explanations)

    @cached_property
    def _news(self) -> ScoreStatistics:
        """Changes of this window alone."""
        return ScoreStatistics.of(self.sums.whole, self.against.known)

    @cached_property
    def _least(self) -> Floats:
        """Least information on each coordinate (N,)."""
        return LEAST * np.diag(self.sums.whole.matrix)

    @cached_property
    def _alone_chances(self) -> Floats:
        causes, information = self.against.coordinates.causes, self._news.information + np.diag(self._least)
        found = log_chances(statistics_of(information[None], self._news.score[None], causes), causes)
        return np.asarray(found[0])

    @property
    def _alone_probability(self) -> float:
        """Probability of this window alone by chance, for all causes."""
        return min(1.0, len(self._alone_chances) * math.exp(self._alone_chances.min()))

    def row(self) -> dict[str, Any]:
        """Return the window's row of the table."""
        window, causes = self.sums.window, self.against.coordinates.causes
        probability = self._alone_probability
        best = causes[int(np.argmin(self._alone_chances))]
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
            "variance_ratio": self._variance.ratio,
            "unexplained": self.unexplained,
            "alarm": self.label,
        }
        std = np.sqrt(np.maximum(np.diag(self.estimate.covariance), 0.0))
        healthy = self.against.coordinates.healthy
        for i in self.against.coordinates.of(CauseKind.PARAMETER):
            name = self.against.coordinates.each[i].variable
            row |= {name: healthy[i] + self.estimate.mean[i], f"{name}.std": float(std[i])}
        for cause in causes:
            row |= self._alone(cause)
        return row

    def _alone(self, cause: Cause) -> dict[str, float]:
        """Return the cells of a cause from this window alone."""
        first = self.against.coordinates.each[cause.columns[0]]
        name = first.name if first.kind is not CauseKind.PARAMETER else f"{first.name} drift"
        if len(cause.columns) > 1:
            found = fit(self._news, (cause,))
            change = changes((cause,), found, self.against.coordinates)[0]
            return {name: change.value, f"{name}.std": change.std, f"{change.fault}.{change.angle}": change.angle_value}
        i = cause.columns[0]
        own, score = float(self._news.information[i, i]), float(self._news.score[i])
        if not own > self._least[i]:
            return {name: 0.0, f"{name}.std": math.inf}
        return {
            name: max(0.0, score * cause.sign) * cause.sign / own if cause.sign else score / own,
            f"{name}.std": own**-0.5,
        }
