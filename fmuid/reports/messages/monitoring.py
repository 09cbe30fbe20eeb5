"""What monitoring found, in a sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from fmuid.diagnosis import SOMETHING_ELSE, OnsetShape
from fmuid.formatting import listed, with_std
from fmuid.reports.messages.diagnosis import basis_notes, explanation_words

if TYPE_CHECKING:
    from fmuid.diagnosis import Alarm, Onset, RecordTime, SkippedWindow, Trend
    from fmuid.runs import MonitoringRun

# Of more windows that are left out, the first are named.
MOST_GAPS = 5


def monitoring_sentences(found: MonitoringRun) -> list[str]:
    """Return what was found, and where the healthy machine is from."""
    return [monitoring_words(found), *basis_notes(found.basis)]


def monitoring_words(found: MonitoringRun) -> str:
    """Return what was found, in a sentence."""
    table, rule, alarms = found.table, found.rule, found.alarms
    if table.empty:
        return "No window has been examined."
    counted = f"{len(table)} windows"
    if not alarms:
        if found.undetermined:
            return f"Whether there is a fault stays open: no window determines {listed(found.undetermined)}."
        held = "in a record" if rule.horizon is None else f"in {rule.horizon:g} s"
        return f"No alarm in {counted}, at a level of {100 * rule.level:g} % for a false one {held}."
    return alarm_sentence(alarms[0], found.units)


def alarm_sentence(alarm: Alarm, units: Mapping[str, str]) -> str:
    """Return what an alarm says: what it is, since when, how large, where it goes; with the units of the columns."""
    raised = f"alarm at {alarm.time:.6g} s of {alarm.record}"
    if alarm.fault == SOMETHING_ELSE:
        return f"Something else is wrong: the residual is larger than the noise and no cause explains it; {raised}."
    head = "Fault" if all(each.faults for each in alarm.explanations) else "Something has changed"
    said = f"{head}: {alarm.fault}{'' if alarm.onset is None else onset_words(alarm.onset)}; {raised}"
    sizes = "; or ".join(map(explanation_words, alarm.explanations))
    trend = "" if alarm.trend is None else trend_words(alarm.trend, units.get(alarm.trend.column, ""))
    return f"{said}; since then {sizes}{trend}."


def onset_words(onset: Onset) -> str:
    """Return since when, with the set that holds the onset with 95 %."""
    span = f"{_at(onset.first, onset.likely)} to {_at(onset.last, onset.likely)}"
    how = "" if onset.shape is OnsetShape.STEP else ", growing"
    return f", since {_moment(onset.likely)} (95 %: {span}){how}"


def _moment(each: RecordTime) -> str:
    return f"{each.time:.6g} s of {each.record}" + (f", {each.date[:19].replace('T', ' ')}" if each.date else "")


def _at(each: RecordTime, likely: RecordTime) -> str:
    return f"{each.time:.6g} s" + (f" of {each.record}" if each.record != likely.record else "")


def trend_words(trend: Trend, unit: str) -> str:
    """Return how a size goes on, "" where it stays and has no limit."""
    said = ""
    if trend.grows:
        said = f"; {trend.column} changes by {with_std(trend.rate, trend.rate_std)} {unit}/s".replace(" /s", " 1/s")
    likely, early, late = trend.reached
    if math.isnan(trend.limit):
        return said
    limit = f"its limit of {trend.limit:g}{f' {unit}' if unit else ''}"
    if likely == 0.0:
        return f"{said}; {trend.column} has reached {limit}"
    if math.isinf(early):
        return f"{said}; {trend.column} stays below {limit}"
    when = "not at this rate" if math.isinf(likely) else f"in {likely:.3g} s"
    until = "never" if math.isinf(late) else f"{late:.3g} s"
    return f"{said}; {trend.column} reaches {limit} {when} (95 %: {early:.3g} s to {until})"


def alarm_words(alarm: Alarm) -> tuple[str, str]:
    """Return since when an alarm is, and what its size is, for a table."""
    onset = "" if alarm.onset is None else _moment(alarm.onset.likely)
    return onset, "; or ".join(map(explanation_words, alarm.explanations))


def gap_words(gaps: Sequence[SkippedWindow]) -> list[str]:
    """Return which windows are left out, a sentence a record."""
    said = []
    for source in dict.fromkeys(gap.source for gap in gaps):
        times = [f"{gap.time:.9g} s" for gap in gaps if gap.source == source]
        shown = listed(times if len(times) <= MOST_GAPS else [*times[:MOST_GAPS], f"{len(times) - MOST_GAPS} more"])
        said.append(f"{source}: the windows from {shown} on are left out, as no sample of some output counts in them")
    return said
