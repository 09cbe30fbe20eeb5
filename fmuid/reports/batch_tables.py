"""The tables and the overview of a batch, as files."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fmuid.files import write_json, write_table
from fmuid.reports.messages.batch import failure_words, note, summary_words
from fmuid.reports.provenance import made_from
from fmuid.runs import BatchResult, Summary
from fmuid.studies import Study

TABLES = ("summary", "groups", "failures", "optima")


def write_summary(summary: Summary, folder: Path) -> list[Path]:
    """Write the tables that have rows as CSV into a folder and return their paths; those of an earlier summary go.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    failures = summary.failures.assign(message=[failure_words(row) for row in summary.failures.to_dict("records")])
    failures = failures.drop(columns="undetermined")
    found = (noted(summary.parameters), noted(summary.groups), failures, summary.optima)
    tables = {name: table for name, table in zip(TABLES, found, strict=True) if len(table)}
    for name in set(TABLES) - set(tables):
        (folder / f"{name}.csv").unlink(missing_ok=True)
    return [write_table(folder / f"{name}.csv", table) for name, table in tables.items()]


def write_overview(summary: Summary, found: BatchResult, study: Study) -> Path:
    """Write ``summary.json``, which has what the tables of a batch do not say, and return its path.

    Parameters
    ----------
    summary : Summary
    found : BatchResult
    study : Study
        Of the batch.

    Raises
    ------
    InputError
        If the folder of the batch cannot be written to.
    """
    content = {
        **made_from(study),
        "words": summary_words(summary),
        "statuses": {str(row["status"]): row["cases"] for row in summary.statuses.to_dict("records")},
        "truth": found.truth,
        "units": found.units,
        "given_noise": found.given_noise,
    }
    return write_json(found.folder / "summary.json", content)


def noted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of statistics with ``note`` in place of ``doubts``: what is surely not as stated, by how much."""
    if not len(table):
        return table
    return table.drop(columns="doubts").assign(note=[note(row) for row in table.to_dict("records")])
