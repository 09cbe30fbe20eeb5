"""Tables of a batch: over the cases, against true values, by setting, optima, failures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.files import write_table
from fmuid.formatting import rounded, unit_text, with_std
from fmuid.reports.document import Section, table_of, table_of_rows
from fmuid.reports.shared_phrases import open_words
from fmuid.reports.topics.termination import ENDS
from fmuid.runs import BatchOverview, BatchResult, EstimateWarning, Summary, made_from, write_overview
from fmuid.studies import Study

Row = Mapping[Any, Any]

MAX_COLUMNS = 6  # parameters in a table of groups or optima; the files contain all
MAX_ROWS = 8  # kinds of failures and optima in a table; the files contain all
TABLES = ("summary", "groups", "failures", "optima")


def write_summary(found: BatchResult, summary: Summary, study: Study) -> list[Path]:
    """Write the tables as CSV, and ``summary.json``; remove earlier ones."""
    folder = found.folder
    statuses = {str(row["status"]): int(row["cases"]) for row in summary.statuses.to_dict("records")}
    overview = BatchOverview(statuses, dict(found.truth), dict(found.units), found.given_noise, made_from(study))
    return [*write_tables(summary, folder), write_overview(folder, overview)]


def write_tables(summary: Summary, folder: Path) -> list[Path]:
    """Write the tables that have rows as CSV; remove earlier ones."""
    failures = summary.failures.assign(message=failure_texts(summary.failures)).drop(columns="undetermined")
    tables = (noted(summary.parameters), noted(summary.groups), failures, summary.optima)
    for name, table in zip(TABLES, tables, strict=True):
        if not len(table):
            (folder / f"{name}.csv").unlink(missing_ok=True)
    return [write_table(folder / f"{name}.csv", each) for name, each in zip(TABLES, tables, strict=True) if len(each)]


def noted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of statistics with ``note`` in place of ``doubts``."""
    if not len(table):
        return table
    return table.drop(columns="doubts").assign(note=[note(row) for row in table.to_dict("records")])


def note(row: Row) -> str:
    """Return the deviations of a row of statistics."""
    ratio, doubts, notes = row["ratio"], row["doubts"], []
    if EstimateWarning.STD_TOO_SMALL in doubts:
        notes.append(f"σ {ratio:.3g} × too small")
    if EstimateWarning.STD_TOO_LARGE in doubts:
        notes.append(f"σ {1.0 / ratio:.3g} × too large" if ratio else "σ too large")
    if EstimateWarning.BIASED in doubts:
        notes.append("biased")
    if doubts == (EstimateWarning.COVERAGE_OFF,):
        notes.append(f"coverage {100 * row['coverage']:.3g} %")
    if row["undetermined"]:
        notes.append(f"not identifiable in {row['undetermined']}")
    return ", ".join(notes)


def tables_of(summary: Summary) -> list[Section]:
    """Return the sections with a table each, those without rows left out."""
    # a parameter that is fixed in every case has no estimate to show
    rows = summary.parameters[summary.parameters["cases"] > 0].to_dict("records")
    names = [str(row["parameter"]) for row in rows][:MAX_COLUMNS]
    found = [_estimates(rows)] if rows else []
    if rows and summary.has_truth:
        found.append(_against_truth([row for row in rows if math.isfinite(row["truth"])]))
    if rows and len(summary.groups):
        found.append(_groups(summary, names))
    if len(summary.optima) > 1:
        found.append(_optima(summary, names))
    if summary.reasons:
        found.append(_reasons(summary))
    return [*found, _failures(summary.failures)] if len(summary.failures) else found


def _estimates(rows: Sequence[Row]) -> Section:
    columns = {
        "parameter": [str(row["parameter"]) for row in rows],
        "cases": [str(row["cases"]) for row in rows],
        "mean": [rounded(row["mean"], _scale(row)) for row in rows],
        "median": [rounded(row["median"], _scale(row)) for row in rows],
        "spread": [_two(row["spread"]) for row in rows],
        "stated σ": [_two(row["stated_std"]) for row in rows],
        "spread / stated σ": [_short(row["ratio"], 3) for row in rows],
        "unit": [unit_text(row["unit"]) for row in rows],
        "note": [note(row) for row in rows],
    }
    return Section("parameters", "Estimates over all cases", table=table_of(columns, ("unit", "note")))


def _against_truth(rows: Sequence[Row]) -> Section:
    columns = {
        "parameter": [str(row["parameter"]) for row in rows],
        "true value": [f"{row['truth']:.6g}" for row in rows],
        "bias": [
            with_std(row["bias"], row["bias_std"]) if row["bias_std"] > 0 else _short(row["bias"], 3) for row in rows
        ],
        "RMS error": [_two(row["rms_error"]) for row in rows],
        "coverage (95 %)": [
            f"{100 * row['coverage']:.1f} %"
            + f" ({100 * row['coverage_lower']:.1f} to {100 * row['coverage_upper']:.1f})"
            * (not math.isnan(row["coverage_lower"]))
            for row in rows
        ],
        "unit": [unit_text(row["unit"]) for row in rows],
    }
    return Section("truth", "Estimates and true values", table=table_of(columns, ("unit",)))


def _groups(summary: Summary, names: Sequence[str]) -> Section:
    """Return a row per group: mean ± spread or stated σ."""
    settings = list(summary.settings)
    heads = [*(name.removeprefix("set.") for name in settings), "cases", "failed", *names]
    cells = []
    for key, part in summary.groups.groupby(settings, sort=False, dropna=False):
        levels: Any = key
        rows = {row["parameter"]: row for row in part.to_dict("records")}
        values = [with_std(rows[name]["mean"], _scale(rows[name])) if rows[name]["cases"] else "" for name in names]
        counts = (str(max(row["cases"] for row in rows.values())), str(part["failed"].iloc[0] or ""))
        cells.append((*(level_text(level) for level in levels), *counts, *values))
    single = summary.groups["cases"].max() == 1
    title = "By setting: " + ("estimate ± stated σ" if single else "mean ± spread")
    return Section("groups", title, table=table_of_rows(heads, cells))


def _optima(summary: Summary, names: Sequence[str]) -> Section:
    rows = summary.optima.head(MAX_ROWS).to_dict("records")
    columns = {
        "optimum": [str(row["optimum"]) for row in rows],
        "cases": [str(row["cases"]) for row in rows],
        "residual / best": [f"{row['residual']:.4g}" for row in rows],
    }
    columns |= {name: [_short(row[name], 5) for row in rows] for name in names if name in summary.optima}
    return Section("optima", "Optima (medians)", table=table_of(columns))


def _reasons(summary: Summary) -> Section:
    """Return the share of each reason in the converged cases."""
    total = int(summary.statuses["cases"].iloc[0])
    cells = [(reason.replace("_", " "), str(n), f"{100 * n / total:.3g} %") for reason, n in summary.reasons.items()]
    return Section("reasons", "Reasons of verdicts", table=table_of_rows(("reason", "cases", "share"), cells))


def _failures(failures: pd.DataFrame) -> Section:
    rows = failures.head(MAX_ROWS).to_dict("records")
    cells = [(str(row["cases"]), str(row["first"]), row["status"], failure_words(row)) for row in rows]
    if len(failures) > MAX_ROWS:
        rest = failures.iloc[MAX_ROWS:]
        cells.append((str(rest["cases"].sum()), str(rest["first"].min()), "", f"{len(rest)} other messages"))
    heads = ("cases", "first case", "status", "message")
    return Section("kinds", "Cases without estimate", table=table_of_rows(heads, cells, ("status", "message")))


def failure_texts(failures: pd.DataFrame) -> list[str]:
    """Return why cases have no estimate, a text per row of `Summary.failures`."""
    return [failure_words(row) for row in failures.to_dict("records")]


def failure_words(row: Row) -> str:
    """Return why the cases of one row of `Summary.failures` have no estimate."""
    said = str(row["message"])
    ends = {outcome.value: words for outcome, words in ENDS.items()} if row["status"] == "not converged" else {}
    return ": ".join(filter(None, [ends.get(said, said), "; ".join(open_words(*each) for each in row["undetermined"])]))


def _scale(row: Row) -> float:
    """Return the standard deviation whose digits a mean is printed to."""
    return float(row["spread"] if row["spread"] > 0 else row["stated_std"])


def _two(value: float) -> str:
    return rounded(value, value) if math.isfinite(value) else ""


def _short(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else ""


def level_text(level: Any) -> str:
    """Return a value of a setting as text."""
    return f"{level:.6g}" if isinstance(level, float) else str(level)
