"""The tables and the overview of a batch, as files."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fmuid import codec
from fmuid.files import write_table
from fmuid.reports.topics.batch import failure_words, note, summary_words
from fmuid.runs import BATCH_SCHEMA, BatchOverview, BatchResult, Summary
from fmuid.runs.provenance import made_from
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
    statuses = {str(row["status"]): int(row["cases"]) for row in summary.statuses.to_dict("records")}
    words, truth, units = tuple(summary_words(summary)), dict(found.truth), dict(found.units)
    overview = BatchOverview(words, statuses, truth, units, found.given_noise, made_from(study))
    return codec.write(found.folder / "summary.json", BATCH_SCHEMA, overview)


def noted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of statistics with ``note`` in place of ``doubts``: what is surely not as stated, by how much."""
    if not len(table):
        return table
    return table.drop(columns="doubts").assign(note=[note(row) for row in table.to_dict("records")])
