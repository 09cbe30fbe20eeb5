"""The parts of a report that a diagnosis and a monitoring make up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fmuid.diagnosis import Alarm, Diagnosis, Onset
from fmuid.reports.interactive import diagnosis
from fmuid.reports.messages.diagnosis import causes_columns, change_name, diagnosis_words, explanation_words
from fmuid.reports.messages.monitoring import monitoring_sentences
from fmuid.reports.page import preparation
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.verdict import ReportStatement
from fmuid.runs import MonitoringRun, read_diagnosis, read_monitoring

RESIDUAL = (
    "What the healthy model leaves unexplained, and what is left with the fault. With the right fault only noise stays."
)
CAUSES = (
    "Every cause by itself: faults, sensors, the supply, parameters. Red is what explains the record; the table has "
    "what else the record does not exclude, with its odds. The pointer shows which other cause looks most alike: at a "
    "small angle the two can hardly be told apart."
)
CHANGES = "The sizes of what explains the record, with their intervals of 95 %."
TIMELINE = (
    "Estimates of each window alone, with their intervals of 95 %. Red dots are windows that are significant by "
    "themselves; the red dashed line is where an alarm was raised, the red ground how long it lasted; dotted lines "
    "part records. The variance of the residual should be that of the noise: a ratio that stays above 1 is something "
    "that no fault model explains."
)


def part_of_diagnosis(folder: Path) -> Part:
    """Return the part on the diagnosis in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    read = read_diagnosis(folder)
    found = read.diagnosis
    first, *others = diagnosis_words(found)
    said = [ReportStatement(first, "causes"), *(ReportStatement(text, "changes", doubtful=True) for text in others)]
    sections = sections_of(found)
    if found.residuals is not None:
        best = " and ".join(change_name(each) for each in found.evidence.explanations[0].changes)
        drawn = [diagnosis.residuals(found.residuals, best, read.units)]
        sections.append(Section("explained", "What the fault explains", RESIDUAL, drawn, 1))
    sections += preparation.sections(read.prepared, "prepared")
    healthy = found.kind == "healthy"
    return Part("Diagnosis", found.kind, healthy, said, causes_table(found), sections, origin(read.origin))


def sections_of(found: Diagnosis) -> list[Section]:
    """Return the sections of a page on a diagnosis."""
    evidence = found.evidence
    odds = table(
        {
            "explanation": [explanation_words(each) for each in evidence.explanations],
            "odds against the best": [f"{each.odds:.2g}" for each in evidence.explanations],
        },
        numbers=["odds against the best"],
    )
    body = odds if evidence.explanations else ""
    sections = [
        Section("causes", "What may be new", CAUSES, [diagnosis.causes(evidence)], 1, body),
        Section("changes", "How large it is", CHANGES, diagnosis.changes(evidence), 2),
    ]
    return [each for each in sections if each.figures]


def causes_table(found: Diagnosis) -> str:
    """Return the table of the causes that were looked at, as HTML."""
    columns = causes_columns(found)
    shown = {head: cells for head, cells in columns.items() if any(cells)}
    return table(shown, numbers=("size", "interval (95 %)", "D", "probability"))


def part_of_monitoring(folder: Path) -> Part:
    """Return the part on the monitoring in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read, or is of an earlier version.
    """
    found = read_monitoring(folder)
    said = [ReportStatement(text, "timeline") for text in monitoring_sentences(found)]
    drawn = [*_timelines(found), *preparation.sections(found.prepared, "monitored")]
    state = "alarm" if found.alarms else "no alarm"
    shown = _alarms(found.alarms)
    return Part("Monitoring", state, not found.alarms, said, shown, drawn, origin(found.origin))


def _timelines(found: MonitoringRun) -> list[Section]:
    sections = []
    for k, fault in enumerate(found.sizes):
        name, caption = ("timeline", TIMELINE) if k == 0 else (f"timeline-{k + 1}", "")
        figures = [diagnosis.timeline(found, fault)] if len(found.table) else []
        sections.append(Section(name, f"Over time: {fault}", caption, figures, 1))
    return [each for each in sections if each.figures]


def _alarms(alarms: Sequence[Alarm]) -> str:
    if not alarms:
        return ""
    columns = {
        "alarm": [each.fault for each in alarms],
        "since (s)": [_since(each.onset) for each in alarms],
        "raised in": [each.record for each in alarms],
        "at (s)": [f"{each.time:g}" for each in alarms],
        "windows": [str(each.last - each.first + 1) for each in alarms],
    }
    return table(columns, numbers=("at (s)", "windows"))


def _since(onset: Onset | None) -> str:
    """Return since when, with the record, and the date where there is one."""
    if onset is None:
        return ""
    likely = onset.likely
    date = f", {likely.date[:19].replace('T', ' ')}" if likely.date else ""
    return f"{likely.time:.6g} ({onset.first.time:.6g} to {onset.last.time:.6g}) of {likely.record}{date}"
