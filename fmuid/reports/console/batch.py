"""What `fmuid batch` prints: estimates over the cases, against the truth, by group, optima, failures, what it means."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd
from rich.table import Table

from fmuid.formatting import rounded, unit_text, with_std
from fmuid.reports.console.layout import TERMINAL_ROWS, console, show_remarks, table_of_rows
from fmuid.reports.messages.batch import failure_words, note, summary_words

if TYPE_CHECKING:
    from fmuid.runs import Summary

Row = Mapping[Hashable, Any]

# Parameters side by side in a table of groups or optima; the files have all.
MAX_COLUMNS = 6
# Kinds of failures and optima printed.
MAX_KINDS = 8
COLORS = {"converged": "green", "not converged": "yellow", "failed": "red"}


def show_batch(summary: Summary) -> None:
    """Print the tables and sentences of a summary."""
    out = console()
    # a parameter that is held in every case has no estimate to show
    shown = summary.parameters[summary.parameters["cases"] > 0]
    rows = shown.to_dict("records")
    tables = [_estimates(rows)] if rows else []
    if rows and summary.has_truth:
        tables.append(_against_truth([row for row in rows if math.isfinite(row["truth"])]))
    names = [str(row["parameter"]) for row in rows][:MAX_COLUMNS]
    if rows and len(summary.groups):
        tables.append(_groups(summary, names))
    if len(summary.optima) > 1:
        tables.append(_optima(summary, names))
    if len(summary.failures):
        tables.append(_failures(summary.failures))
    for table in tables:
        out.print()
        out.print(table)
    out.print()
    show_remarks(summary_words(summary))
    out.print(_statuses(summary), soft_wrap=True)


def _estimates(rows: Sequence[Row]) -> Table:
    numbers = ("cases", "mean", "median", "spread", "stated std", "spread / stated")
    cells = [
        (
            row["parameter"],
            str(row["cases"]),
            rounded(row["mean"], _scale(row)),
            rounded(row["median"], _scale(row)),
            _two(row["spread"]),
            _two(row["stated_std"]),
            _short(row["ratio"], 3),
            unit_text(row["unit"]),
            note(row),
        )
        for row in rows
    ]
    return table_of_rows("Estimates over the cases", ("parameter", *numbers, "unit", "note"), cells, numbers)


def _against_truth(rows: Sequence[Row]) -> Table:
    numbers = ("truth", "bias", "RMS error", "95 % intervals hold it")
    cells = [
        (
            row["parameter"],
            f"{row['truth']:.6g}",
            with_std(row["bias"], row["bias_std"]) if row["bias_std"] > 0 else _short(row["bias"], 3),
            _two(row["rms_error"]),
            _coverage(row),
            unit_text(row["unit"]),
        )
        for row in rows
    ]
    return table_of_rows("Against the truth", ("parameter", *numbers, "unit"), cells, numbers)


def _coverage(row: Row) -> str:
    said = f"{100 * row['coverage']:.1f} %"
    if math.isnan(row["coverage_lower"]):
        return said
    return said + f" ({100 * row['coverage_lower']:.1f} to {100 * row['coverage_upper']:.1f})"


def _groups(summary: Summary, names: Sequence[str]) -> Table:
    """Return a row a group, with the mean of each parameter and its spread, or the stated std of a single case."""
    settings = list(summary.settings)
    cells = []
    for key, part in summary.groups.groupby(settings, sort=False, dropna=False):
        levels: Any = key
        rows = {row["parameter"]: row for row in part.to_dict("records")}
        values = [with_std(rows[name]["mean"], _scale(rows[name])) if rows[name]["cases"] else "" for name in names]
        counts = (str(max(row["cases"] for row in rows.values())), str(part["failed"].iloc[0] or ""))
        cells.append((*(_level(level) for level in levels), *counts, *values))
    heads = [*(name.removeprefix("set.") for name in settings), "cases", "failed", *names]
    single = summary.groups["cases"].max() == 1
    title = "By setting, " + ("estimate ± stated std" if single else "mean ± spread over the cases")
    return table_of_rows(title, heads, cells[:TERMINAL_ROWS], heads)


def _optima(summary: Summary, names: Sequence[str]) -> Table:
    names = [name for name in names if name in summary.optima]
    heads = ["optimum", "cases", "residual / best", *names]
    cells = [
        (str(row["optimum"]), str(row["cases"]), f"{row['residual']:.4g}", *(_short(row[name], 5) for name in names))
        for row in summary.optima.head(MAX_KINDS).to_dict("records")
    ]
    return table_of_rows("Optima that the starts led to, medians", heads, cells, heads)


def _failures(failures: pd.DataFrame) -> Table:
    heads = ("cases", "first case", "status", "message")
    cells = [
        (str(row["cases"]), str(row["first"]), row["status"], failure_words(row))
        for row in failures.head(MAX_KINDS).to_dict("records")
    ]
    if len(failures) > MAX_KINDS:
        rest = failures.iloc[MAX_KINDS:]
        cells.append((str(rest["cases"].sum()), str(rest["first"].min()), "", f"{len(rest)} other messages"))
    return table_of_rows("Cases without an estimate", heads, cells, ("cases", "first case"))


def _statuses(summary: Summary) -> str:
    parts = [
        f"[bold {COLORS[status]}]{count} {status}[/]"
        for status, count in zip(summary.statuses["status"], summary.statuses["cases"], strict=True)
        if count
    ]
    return f"{summary.cases} cases: " + ", ".join(parts) if parts else "No case has finished"


def _scale(row: Row) -> float:
    """Return the standard deviation whose digits a mean is printed to."""
    return float(row["spread"] if row["spread"] > 0 else row["stated_std"])


def _two(value: float) -> str:
    return rounded(value, value) if math.isfinite(value) else ""


def _short(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else ""


def _level(level: Any) -> str:
    return f"{level:.6g}" if isinstance(level, float) else str(level)
