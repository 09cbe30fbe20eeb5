"""The parts of a report that a diagnosis and a monitoring make up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.diagnosis import Diagnosis
from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.reports.interactive import diagnosis
from fmuid.reports.messages.diagnosis import causes_columns, change_name, diagnosis_words, explanation_words
from fmuid.reports.page import preparation
from fmuid.reports.page.contents import read_table
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.saved import read_json
from fmuid.reports.page.verdict import ReportStatement

PREPARED_FILE, MONITORED_FILE = "diagnosis-preparation.csv", "monitoring-preparation.csv"
"""What was done with the tables of a diagnosis, and of a monitoring, as in ``preparation.csv``."""
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
    found = Diagnosis.from_json(folder / "diagnosis.json")
    content = read_json(folder / "diagnosis.json")
    units = content.get("units") or {}
    first, *others = diagnosis_words(found)
    said = [ReportStatement(first, "causes"), *(ReportStatement(text, "changes", doubtful=True) for text in others)]
    sections = sections_of(found)
    residuals = folder / "diagnosis-residuals.csv"
    if is_file(residuals):
        best = " and ".join(change_name(each) for each in found.evidence.explanations[0].changes)
        drawn = [diagnosis.residuals(read_table(residuals), best, units)]
        sections.append(Section("explained", "What the fault explains", RESIDUAL, drawn, 1))
    sections += _prepared(folder / PREPARED_FILE, content, "prepared")
    return Part("Diagnosis", found.kind, found.kind == "healthy", said, causes_table(found), sections, origin(content))


def _prepared(path: Path, content: dict[str, Any], name: str) -> list[Section]:
    """Return the sections on what was done with tables, where it is kept."""
    return preparation.sections(read_table(path), content.get("experiments", []), name) if is_file(path) else []


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
    content = read_json(folder / "monitoring.json")
    rows = read_table(folder / "monitoring.csv") if content.get("windows") else pd.DataFrame()
    try:
        said = [ReportStatement(text, "timeline") for text in content["words"]]
        alarms = content["alarms"]
        drawn = _timelines(rows, content)
        shown = _alarms(alarms)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"{folder} has no whole results of fmuid monitor ({error}): monitor again") from None
    drawn += _prepared(folder / MONITORED_FILE, content, "monitored")
    state = "alarm" if alarms else "no alarm"
    return Part("Monitoring", state, not alarms, said, shown, drawn, origin(content))


def _timelines(rows: pd.DataFrame, content: dict[str, Any]) -> list[Section]:
    sections = []
    for k, fault in enumerate(content["sizes"]):
        name, caption = ("timeline", TIMELINE) if k == 0 else (f"timeline-{k + 1}", "")
        figures = [diagnosis.timeline(rows, fault, content)] if len(rows) else []
        sections.append(Section(name, f"Over time: {fault}", caption, figures, 1))
    return [each for each in sections if each.figures]


def _alarms(alarms: list[dict[str, Any]]) -> str:
    if not alarms:
        return ""
    columns = {
        "alarm": [str(each["fault"]) for each in alarms],
        "since (s)": [_since(each["onset"]) for each in alarms],
        "raised in": [str(each["record"]) for each in alarms],
        "at (s)": [f"{each['time']:g}" for each in alarms],
        "windows": [str(each["last"] - each["first"] + 1) for each in alarms],
    }
    return table(columns, numbers=("at (s)", "windows"))


def _since(onset: dict[str, Any] | None) -> str:
    """Return since when, with the record, and the date where there is one."""
    if onset is None:
        return ""
    likely = onset["likely"]
    date = f", {likely['date'][:19].replace('T', ' ')}" if likely["date"] else ""
    first, last = (f"{onset[end]['time']:.6g}" for end in ("first", "last"))
    return f"{likely['time']:.6g} ({first} to {last}) of {likely['record']}{date}"
