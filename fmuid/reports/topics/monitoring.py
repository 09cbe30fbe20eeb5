"""Monitoring: alarms, onsets, sizes and windows over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import evenly, extremes
from fmuid.diagnosis import SOMETHING_ELSE, Alarm, BaselineSource, Onset, OnsetShape, RecordTime, SkippedWindow, Trend
from fmuid.formatting import label, listed, rounded, unit_text, with_std
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Data, Layer, stacked
from fmuid.reports.document import (
    CONSOLE,
    Document,
    Message,
    Remark,
    Section,
    Tone,
    doubt,
    origin_of,
    plain,
    table_of_rows,
)
from fmuid.reports.topics.diagnosis import basis_notes, explanation_words
from fmuid.runs import MonitoringRun


class MonitoringMessage(Message, section="timeline"):
    """Verdict of a monitoring, alarms and notes."""

    NO_WINDOW = plain("No window evaluated.")
    UNDECIDED = plain("UNDECIDED: no window determines {names}.", remedy="Use longer windows or another excitation.")
    NO_ALARM = plain("NO ALARM in {windows} windows at {level:g} % false-alarm rate {per}.")
    ALARM = plain(
        "ALARM {cause}{onset}, raised at {time:.6g} s{record}.",
    )
    UNEXPLAINED = plain(
        "ALARM unexplained change, raised at {time:.6g} s of {record}.",
        remedy="Add a fault model, or check sensors and inputs.",
    )
    ENDED = plain("Ended at {time:.6g} s{record}.")
    LASTED = plain("Lasted until {time:.6g} s{record}.")
    SIZE_AT_ALARM = plain("Size at the alarm: {sizes}.")
    SIZE_NOW = plain("Current size: {sizes}.")
    SIZE_SINCE = plain("Size until the end: {sizes}.")
    RATE = plain("{column} changes by {rate}.")
    LIMIT_REACHED = plain("{column} has reached its limit {limit}.")
    LIMIT_SAFE = plain("{column} stays below its limit {limit}.")
    LIMIT_AHEAD = plain("{column} reaches its limit {limit} in {when} (95 %: {early} to {late}).")
    LIMIT_OPEN = plain("{column} does not reach its limit {limit} at this rate (95 %: {early} to {late}).")
    SKIPPED = doubt("{source}: windows from {times} skipped.")
    WHITE_NOISE = doubt(
        "White noise assumed: the baseline is a result alone.", remedy="List healthy data in `diagnosis.healthy_data`."
    )


def monitoring_remarks(found: MonitoringRun) -> list[Remark]:
    """Return the verdict; of each alarm one line."""
    table, rule, alarms = found.table, found.rule, found.alarms
    if table.empty:
        return [MonitoringMessage.NO_WINDOW.said()]
    if alarms:
        return [_alarm_line(each, found) for each in alarms]
    if found.undetermined:
        return [MonitoringMessage.UNDECIDED.said(names=listed(found.undetermined))]
    per = "per recording" if rule.horizon is None else f"per {rule.horizon:g} s"
    given = {"windows": len(table), "level": 100 * rule.level, "per": per}
    return [MonitoringMessage.NO_ALARM.said(**given)]


def _alarm_line(alarm: Alarm, found: MonitoringRun) -> Remark:
    """Return all about an alarm in one line."""
    (first, *others), sizes = alarm_remarks(alarm, found.units), size_at_alarm(alarm, found)
    said = [first, *([MonitoringMessage.SIZE_AT_ALARM.said("", sizes=sizes)] if sizes else []), *others]
    if alarm.ended is None and alarm.last < found.table.index[-1]:
        last = found.table.loc[alarm.last]
        where = "" if last["record"] == alarm.record else f" of {last['record']}"
        said.append(MonitoringMessage.LASTED.said("", time=last["end"], record=where))
    return replace(first, text=" ".join(each.text for each in said))


def alarm_sentence(alarm: Alarm, units: Mapping[str, str]) -> str:
    """Return cause, onset, size and trend of an alarm."""
    return " ".join(each.text for each in alarm_remarks(alarm, units))


def alarm_remarks(alarm: Alarm, units: Mapping[str, str]) -> list[Remark]:
    """Return cause and onset, size and trend of an alarm."""
    if alarm.fault == SOMETHING_ELSE:
        return [MonitoringMessage.UNEXPLAINED.said(time=alarm.time, record=alarm.record)]
    onset, record = "", f" of {alarm.record}"
    if alarm.onset is not None:
        onset, likely = onset_words(alarm.onset), alarm.onset.likely
        record = "" if likely.record == alarm.record else record
    given = {"cause": alarm.fault, "onset": onset, "time": alarm.time, "record": record}
    said = [MonitoringMessage.ALARM.said(**given)]
    ended = alarm.ended
    if ended is not None:
        where = "" if ended.record == alarm.record else f" of {ended.record}"
        said.append(MonitoringMessage.ENDED.said("", time=ended.time, record=where))
    if alarm.explanations:
        size = MonitoringMessage.SIZE_NOW if ended is None else MonitoringMessage.SIZE_SINCE
        said.append(size.said("", sizes=" or ".join(map(explanation_words, alarm.explanations))))
    return said + ([] if alarm.trend is None else trend_remarks(alarm.trend, units.get(alarm.trend.column, "")))


def size_at_alarm(alarm: Alarm, found: MonitoringRun) -> str:
    """Return the sizes in the first window of an alarm."""
    row, said = found.table.loc[alarm.first].to_dict(), []
    for change in alarm.explanations[0].changes if alarm.explanations else ():
        value, std = (float(row.get(f"{change.label}{end}", math.nan)) for end in ("", ".std"))
        if math.isfinite(std):
            said.append(f"{change.label} = {with_std(value, std)} {unit_text(found.units.get(change.label))}".strip())
    return ", ".join(said)


def onset_words(onset: Onset) -> str:
    """Return the onset with its 95 % interval."""
    likely = onset.likely
    first, last = (_at(each, likely) for each in (onset.first, onset.last))
    date = f" ({_date(likely)})" if likely.date else ""
    how = "" if onset.shape is OnsetShape.STEP else ", growing"
    return f" since {likely.time:.6g} s (95 %: {first} to {last}) of {likely.record}{date}{how}"


def _at(each: RecordTime, likely: RecordTime) -> str:
    return f"{each.time:.6g} s" + (f" of {each.record}" if each.record != likely.record else "")


def _date(each: RecordTime) -> str:
    return each.date[:19].replace("T", " ")


def trend_remarks(trend: Trend, unit: str) -> list[Remark]:
    """Return the trend of a size and the time to its limit."""
    column, said = trend.column, []
    if trend.grows:
        rate = f"{with_std(trend.rate, trend.rate_std)} {unit}/s".replace(" /s", " 1/s")
        said.append(MonitoringMessage.RATE.said("", column=column, rate=rate))
    if math.isnan(trend.limit):
        return said
    likely, early, late = trend.reached
    if likely == 0.0:
        how = MonitoringMessage.LIMIT_REACHED
    elif math.isinf(early):
        how = MonitoringMessage.LIMIT_SAFE
    else:
        how = MonitoringMessage.LIMIT_OPEN if math.isinf(likely) else MonitoringMessage.LIMIT_AHEAD
    given = {"column": column, "limit": f"{trend.limit:g} {unit}".strip(), "when": f"{likely:.3g} s"}
    given |= {"early": f"{early:.3g} s", "late": "never" if math.isinf(late) else f"{late:.3g} s"}
    return [*said, how.said("", **given)]


def alarm_words(alarm: Alarm) -> tuple[str, str]:
    """Return onset and size of an alarm, for a table."""
    onset = ""
    if alarm.onset is not None:
        likely = alarm.onset.likely
        onset = f"{likely.time:.6g} s of {likely.record}" + (f", {_date(likely)}" if likely.date else "")
    return onset, " or ".join(map(explanation_words, alarm.explanations))


def gap_remarks(gaps: Sequence[SkippedWindow]) -> list[Remark]:
    """Return the skipped windows, a remark per recording; the first five are named."""
    said = []
    for source in dict.fromkeys(gap.source for gap in gaps):
        times = [f"{gap.time:.9g} s" for gap in gaps if gap.source == source]
        shown = listed(times if len(times) <= 5 else [*times[:5], f"{len(times) - 5} more"])
        said.append(MonitoringMessage.SKIPPED.said("", source=source, times=shown))
    return said


TIMELINE = (
    "Estimates of each window alone, with 95 % intervals. Red dots: windows that are significant alone. Red dashed "
    "line: alarm raised; red area: its duration. Dotted lines: borders of recordings. A variance ratio that stays "
    "above 1 is a change that no cause explains."
)


def monitoring_document(found: MonitoringRun) -> Document:
    """Return the document of a monitoring."""
    said = [*monitoring_remarks(found), *basis_notes(found.basis), *gap_remarks(found.gaps)]
    said += [MonitoringMessage.WHITE_NOISE.said("")] if found.basis is BaselineSource.WHITE_RESULT else []
    sections = [_alarms_section(found)] if found.alarms else []
    if len(found.table):
        sections.append(_windows_section(found))
        for k, fault in enumerate(found.sizes):
            key, caption = ("timeline", TIMELINE) if k == 0 else (f"timeline-{k + 1}", "")
            sections.append(Section(key, f"Over time: {fault}", caption, charts=(_timeline(found, fault),), beside=1))
    tone: Tone = "bad" if found.alarms else "doubt" if found.undetermined else "good"
    state = "alarm" if found.alarms else "undecided" if found.undetermined else "no alarm"
    return Document("monitoring", "Monitoring", state, tone, tuple(said), tuple(sections), **origin_of(found.origin))


def _alarms_section(found: MonitoringRun) -> Section:
    windows, rows = found.table, []
    for alarm in found.alarms:
        last = windows.loc[alarm.last]
        end, where = (last["end"], last["record"]) if alarm.ended is None else (alarm.ended.time, alarm.ended.record)
        until = f"{end:g}" + ("" if where == alarm.record else f" of {where}")
        onset, size = alarm_words(alarm)
        row = (alarm.fault, onset, size_at_alarm(alarm, found), size, alarm.record, f"{alarm.time:g}", until)
        rows.append((*row, f"{alarm.last - alarm.first + 1}"))
    heads = ("cause", "onset", "size at alarm", "current size", "recording", "alarm (s)", "until (s)", "windows")
    return Section("alarms", "Alarms", table=table_of_rows(heads, rows, heads[:5]))


def _windows_section(found: MonitoringRun) -> Section:
    frame, rows, before = found.table, [], ""
    columns = [(fault, name) for fault, sizes in found.sizes.items() for name in sizes]
    for fault, name in [*columns, *(("", name) for name in found.common)]:
        values, std = frame[name], float(frame[f"{name}.std"].iloc[-1])
        cells = [rounded(float(each), std) for each in (values.iloc[0], values.min(), values.max())]
        last = with_std(float(values.iloc[-1]), std) if math.isfinite(std) else "unknown"
        said = (fault if fault != before else "", name.removeprefix(f"{fault}."))
        rows.append((*said, *cells, last, unit_text(found.units.get(name))))
        before = fault
    heads = ("fault", "parameter", "first", "minimum", "maximum", "last", "unit")
    return Section("windows", "Windows", table=table_of_rows(heads, rows, (heads[1], *heads[5:])), shown=CONSOLE)


def _timeline(found: MonitoringRun, fault: str) -> ChartGrid:
    """Return sizes, common parameters and variance ratio over time, with alarms."""
    table = found.table
    clock, borders, text = clock_of(table)
    ordered = [*found.sizes[fault], *found.common][: LIMITS.outputs]
    half = 0.5 * float((table["end"] - table["start"]).median())
    estimates = {name: _estimate(table, name) for name in ordered}
    ratio, records = table["variance_ratio"].to_numpy(np.float64), table["record"].astype(str).to_numpy()
    kept = extremes(np.column_stack([ratio, *(each for one in estimates.values() for each in one)]), LIMITS.rows)
    thin, of = clock[kept], tuple(records[kept])
    reach = (float(clock[0]) - half, float(clock[-1]) + half)
    x, few = Axis(text, reach=reach, linked="time"), len(clock) <= LIMITS.bars
    ground = _grounds(found.alarms, clock, half, borders)
    charts = []
    hover = (("time", "@x{0.000}"), ("estimate", "@y{0.000000}"), ("recording", "@record"))
    for name, (value, low, high) in estimates.items():
        said, layers = "estimate, with 95 % interval", list(ground)
        data: Data = {"x": thin, "y": value[kept], "record": of}
        if few:
            ends: Data = {"x0": thin, "y0": low[kept], "x1": thin, "y1": high[kept]}
            layers.append(Layer("segments", ends, width=1, alpha=0.5, label=said))
            layers.append(Layer("points", data, size=5, label=said, hover=hover))
        else:
            layers.append(Layer("band", {"x": thin, "y0": low[kept], "y1": high[kept]}, alpha=0.18, label=said))
            layers.append(Layer("line", data, width=1.4, label=said, hover=hover))
        if name in found.sizes[fault]:
            layers.append(Layer("rule", {"y": 0.0}, "ink"))
            called = np.flatnonzero((table["significant"] == fault).to_numpy(bool))
            some = called[evenly(len(called), LIMITS.dots)] if len(called) else called
            if len(some):
                layers.append(Layer("points", {"x": clock[some], "y": value[some]}, "red", size=5, label="significant"))
        y = Axis(label(name.removeprefix(f"{fault}."), found.units.get(name)))
        charts.append(Chart(x, y, tuple(layers), 170))
    noise: Data = {"x": thin, "y": ratio[kept]}
    dots = [Layer("points", noise, "grey", size=4)] if few else []
    layers = [*ground, Layer("line", noise, "grey", width=1.4), *dots, Layer("rule", {"y": 1.0}, "ink")]
    charts.append(Chart(x, Axis("variance / noise"), tuple(layers), 170))
    return stacked(charts)


def _estimate(table: pd.DataFrame, name: str) -> tuple[Floats, Floats, Floats]:
    value, std = (table[f"{name}{end}"].to_numpy(np.float64) for end in ("", ".std"))
    known = np.isfinite(std)
    half = np.where(known, 1.96 * std, np.nan)
    return np.where(known, value, np.nan), value - half, value + half


def _grounds(alarms: Sequence[Alarm], clock: Floats, half: float, borders: Sequence[float]) -> list[Layer]:
    layers = []
    if alarms:
        begin, end = (clock[[getattr(each, side) for each in alarms]] + half for side in ("first", "last"))
        layers.append(Layer("zone", {"left": begin - 2 * half, "right": end}, "red", alpha=0.1))
        layers.append(Layer("rule", {"x": begin}, "red", dash="dashed"))
    if borders:
        layers.append(Layer("rule", {"x": np.array(borders)}, "grey", dash="dotted"))
    return layers


def clock_of(table: pd.DataFrame) -> tuple[Floats, list[float], str]:
    """Return window centers (s), borders of recordings, and the axis label."""
    start, end = table["start"].to_numpy(np.float64), table["end"].to_numpy(np.float64)
    middle = 0.5 * (start + end)
    if (np.diff(start) > 0).all():
        return middle, [], "time (s)"
    changes = np.flatnonzero(table["record"].to_numpy(str)[1:] != table["record"].to_numpy(str)[:-1]) + 1
    shift, borders = np.zeros(len(table)), []
    for k in changes:
        border = float(end[k - 1] + shift[k - 1])
        shift[k:] = border - min(0.0, start[k])
        borders.append(border)
    return middle + shift, borders, "time over all recordings (s)"
