"""The part of a report that a batch makes up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.formatting import rounded, unit_text
from fmuid.reports.interactive import batch
from fmuid.reports.interactive.starts import over_starts
from fmuid.reports.messages.result import capitalised
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.verdict import ReportStatement
from fmuid.runs import BatchColumns, estimates, is_repetition, read_overview, read_rows, read_table

CASES = (
    "Estimates of the cases that converged, with their intervals where there are few; of very many, the fuller a cell, "
    "the more lie there; the amber line is the truth. At the lower edge are cases without an estimate."
)
DISTRIBUTIONS = (
    "How the estimates are distributed. The curve is what their stated standard deviations promise: wider bars "
    "than the curve mean that the std are too small, bars beside the amber line, the truth, a bias."
)
SPREAD = "In the band the spread over the cases is what the stated std say; to the right of it they are too small."
SETTING = (
    "Each dot is a case, red are means, with the spread of the cases and, between the dashes, what their std "
    "promise. A mean that moves with the setting depends on it."
)
STARTS = (
    "How much worse than the best each search fits, in order, and where it ended over where it began. A level line is "
    "an optimum that any start leads to; red ones are others."
)
FAILURES = "Why cases have no estimate: red failed, amber did not converge."


def part(folder: Path) -> Part:
    """Return the part of a report on the batch in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    found = read_overview(folder)
    tables = {name: read_table(folder / f"{name}.csv") for name in _TABLES if is_file(folder / f"{name}.csv")}
    try:
        frame = read_rows(folder, _wanted)
        truth, units, counts = dict(found.truth), dict(found.units), dict(found.statuses)
        said = [ReportStatement(capitalised(text, units), "distributions") for text in found.words]
        sections = sections_of(frame, tables, truth, units, given_noise=found.given_noise)
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{folder} has no whole results of fmuid batch ({error}): run the same command again"
        ) from None
    done, total = counts.get("converged", 0), sum(counts.values())
    said.insert(0, ReportStatement(f"{done} of {total} cases converged", "failures"))
    shown = [each for each in sections if each.figures]
    rows = {"cases": ", ".join(f"{count} {name}" for name, count in counts.items())}
    head = summary_table(tables["summary"]) if "summary" in tables else ""
    return Part("Batch", f"{done} of {total}", done == total, said, head, shown, origin(found.origin, rows))


_TABLES = ("summary", "failures")


def _wanted(name: str) -> bool:
    """Return whether figures need a column; messages are the most of a batch, and counted already."""
    return name in _PLAIN or name.startswith(("value.", "std.", "noise.", "set.", "start."))


_PLAIN = ("case", "status", "criterion", "table", "draw", "free")


def sections_of(
    frame: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    truth: dict[str, float],
    units: dict[str, str | None],
    *,
    given_noise: bool,
) -> list[Section]:
    """Return the sections of a page on a batch, of which one without figures is left out.

    Parameters
    ----------
    frame : DataFrame
        A row a case.
    tables : dict of str to DataFrame
        ``summary`` and ``failures``, as far as they are there.
    truth, units, given_noise
        As ``summary.json`` has them.
    """
    found, columns = estimates(frame, given_noise=given_noise), BatchColumns.of(frame)
    sections = [Section("cases", "Estimates over the cases", CASES, batch.over_cases(frame, truth, units), 2)]
    if len(found) > 1:
        drawn = batch.distributions(found, truth, units, repeated=is_repetition(found, columns))
        sections.append(Section("distributions", "Distributions", DISTRIBUTIONS, drawn))
    summary = tables.get("summary", pd.DataFrame())
    if len(summary) and np.isfinite(summary["ratio"].astype(float)).any():
        sections.append(Section("spread", "Spread against stated std", SPREAD, [batch.spread(summary)], 1))
    for k, name in enumerate(name for name in (*columns.design, *_tables(columns)) if len(found[name].unique()) > 1):
        drawn = batch.over_setting(found, name, truth, units)
        heading = f"Over {name.removeprefix('set.')}"
        sections.append(Section(f"over-{k + 1}", heading, SETTING if k == 0 else "", drawn))
    if columns.starts:
        drawn = over_starts(frame, truth, units, given_noise=given_noise)
        sections.append(Section("starts", "Where the searches ended", STARTS, drawn))
    if "failures" in tables:
        sections.append(Section("failures", "Without an estimate", FAILURES, [batch.failures(tables["failures"])], 1))
    return sections


def _tables(columns: BatchColumns) -> tuple[str, ...]:
    return ("table",) if "table" in columns.repeats else ()


def summary_table(summary: pd.DataFrame) -> str:
    """Return what ``summary.csv`` has, a row a parameter that there are estimates of, as HTML."""
    rows = summary[summary["cases"] > 0].to_dict("records")
    columns = {
        "parameter": [str(row["parameter"]) for row in rows],
        "cases": [str(row["cases"]) for row in rows],
        "mean": [rounded(row["mean"], row["stated_std"]) for row in rows],
        "spread": [_digits(row["spread"], 2) for row in rows],
        "stated std": [_digits(row["stated_std"], 2) for row in rows],
        "spread / stated": [_digits(row["ratio"], 3) for row in rows],
        "unit": [unit_text(row["unit"]) for row in rows],
    }
    if "truth" in summary:
        columns["truth"] = [_digits(row["truth"], 6) for row in rows]
        held = [_digits(100 * row["coverage"], 3) for row in rows]
        columns["95 % intervals hold it"] = [f"{share} %" if share else "" for share in held]
    columns["note"] = ["" if pd.isna(row["note"]) else str(row["note"]) for row in rows]
    words = ("parameter", "unit", "note")
    return table(columns, numbers=[name for name in columns if name not in words])


def _digits(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if np.isfinite(value) else ""
