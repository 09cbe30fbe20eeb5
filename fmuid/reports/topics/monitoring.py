"""Monitoring: alarms, onsets, sizes and windows over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import evenly, extremes
from fmuid.diagnosis import SOMETHING_ELSE, Alarm, BaselineSource, Onset, OnsetShape, RecordTime, SkippedWindow, Trend
from fmuid.formatting import label, listed, rounded, unit_text, with_std
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Data, Layer, stacked
from fmuid.reports.document import CONSOLE, Document, Remark, Section, Tone, origin_of, table_of
from fmuid.reports.topics.diagnosis_phrases import basis_notes, explanation_words
from fmuid.reports.topics.preprocessing import preprocessing_sections
from fmuid.runs import MonitoringRun

# Of more windows that are left out, the first are named.
MOST_GAPS = 5


def monitoring_words(found: MonitoringRun) -> str:
    """Return the verdict in one sentence."""
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
    """Return cause, onset, size and trend of an alarm."""
    raised = f"alarm at {alarm.time:.6g} s of {alarm.record}"
    if alarm.fault == SOMETHING_ELSE:
        return f"Something else is wrong: the residual is larger than the noise and no cause explains it; {raised}."
    head = "Fault" if all(each.faults for each in alarm.explanations) else "Something has changed"
    said = f"{head}: {alarm.fault}{'' if alarm.onset is None else onset_words(alarm.onset)}; {raised}"
    sizes = "; or ".join(map(explanation_words, alarm.explanations))
    trend = "" if alarm.trend is None else trend_words(alarm.trend, units.get(alarm.trend.column, ""))
    return f"{said}; since then {sizes}{trend}."


def onset_words(onset: Onset) -> str:
    """Return the onset with its 95 % interval."""
    span = f"{_at(onset.first, onset.likely)} to {_at(onset.last, onset.likely)}"
    how = "" if onset.shape is OnsetShape.STEP else ", growing"
    return f", since {_moment(onset.likely)} (95 %: {span}){how}"


def _moment(each: RecordTime) -> str:
    return f"{each.time:.6g} s of {each.record}" + (f", {each.date[:19].replace('T', ' ')}" if each.date else "")


def _at(each: RecordTime, likely: RecordTime) -> str:
    return f"{each.time:.6g} s" + (f" of {each.record}" if each.record != likely.record else "")


def trend_words(trend: Trend, unit: str) -> str:
    """Return the trend of a size and the time to its limit."""
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
    """Return onset and size of an alarm, for a table."""
    onset = "" if alarm.onset is None else _moment(alarm.onset.likely)
    return onset, "; or ".join(map(explanation_words, alarm.explanations))


def gap_words(gaps: Sequence[SkippedWindow]) -> list[str]:
    """Return the skipped windows, one sentence per recording."""
    said = []
    for source in dict.fromkeys(gap.source for gap in gaps):
        times = [f"{gap.time:.9g} s" for gap in gaps if gap.source == source]
        shown = listed(times if len(times) <= MOST_GAPS else [*times[:MOST_GAPS], f"{len(times) - MOST_GAPS} more"])
        said.append(f"{source}: the windows from {shown} on are left out, as no sample of some output counts in them")
    return said


TIMELINE = (
    "Estimates of each window alone, with their intervals of 95 %. Red dots are windows that are significant by "
    "themselves; the red dashed line is where an alarm was raised, the red ground how long it lasted; dotted lines "
    "part records. The variance of the residual should be that of the noise: a ratio that stays above 1 is something "
    "that no fault model explains."
)
WHITE_NOISE = (
    "The noise is taken as white: the baseline is a result alone. Name healthy data in [diagnosis] healthy_data."
)


def monitoring_document(found: MonitoringRun) -> Document:
    """Return the document of a monitoring."""
    said = [Remark(monitoring_words(found), "plain", "timeline")]
    said += [Remark(text, "doubt") for text in (*basis_notes(found.basis), *gap_words(found.gaps))]
    said += [Remark(WHITE_NOISE, "doubt")] if found.basis is BaselineSource.RESULT else []
    sections = [_alarms_section(found)] if found.alarms else []
    if len(found.table):
        sections.append(_windows_section(found))
        for k, fault in enumerate(found.sizes):
            key, caption = ("timeline", TIMELINE) if k == 0 else (f"timeline-{k + 1}", "")
            sections.append(Section(key, f"Over time: {fault}", caption, charts=(_timeline(found, fault),), beside=1))
    sections += preprocessing_sections(found.prepared, len(found.prepared) > 1, "monitored")
    tone: Tone = "bad" if found.alarms else "doubt" if found.undetermined else "good"
    state = "alarm" if found.alarms else "undecided" if found.undetermined else "no alarm"
    return Document("monitoring", "Monitoring", state, tone, tuple(said), tuple(sections), **origin_of(found.origin))


def _alarms_section(found: MonitoringRun) -> Section:
    windows, rows = found.table, []
    for alarm in found.alarms:
        since, size = alarm_words(alarm)
        last = windows.loc[alarm.last]
        until = f"{last['end']:g}" + ("" if last["record"] == alarm.record else f" of {last['record']}")
        rows.append(
            (alarm.fault, since, size, alarm.record, f"{alarm.time:g}", until, f"{alarm.last - alarm.first + 1}")
        )
    heads = ("what", "since", "size", "record", "alarm (s)", "to (s)", "windows")
    columns = {head: [row[k] for row in rows] for k, head in enumerate(heads)}
    return Section("alarms", "Alarms", table=table_of(columns, heads[:4]))


def _windows_section(found: MonitoringRun) -> Section:
    numbers, frame, rows, before = ("first", "least", "greatest"), found.table, [], ""
    columns = [(fault, name) for fault, sizes in found.sizes.items() for name in sizes]
    for fault, name in [*columns, *(("", name) for name in found.common)]:
        values, std = frame[name], frame[f"{name}.std"].tolist()
        cells = [rounded(float(each), std[-1]) for each in (values.iloc[0], values.min(), values.max())]
        last = with_std(float(values.iloc[-1]), std[-1]) if math.isfinite(std[-1]) else "not determined"
        said = (fault if fault != before else "", name.removeprefix(f"{fault}."))
        rows.append((*said, *cells, last, unit_text(found.units.get(name))))
        before = fault
    heads = ("fault", "parameter", *numbers, "last", "unit")
    table = {head: [row[k] for row in rows] for k, head in enumerate(heads)}
    return Section("windows", "Windows", table=table_of(table, ("parameter", "last", "unit")), shown=CONSOLE)


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
    hover = (("time", "@x{0.000}"), ("estimate", "@y{0.000000}"), ("record", "@record"))
    for name, (value, low, high) in estimates.items():
        said, layers = "estimate, with its interval of 95 %", list(ground)
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
    return middle + shift, borders, "time over all records (s)"
