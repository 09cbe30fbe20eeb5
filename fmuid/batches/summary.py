"""What a batch found, in tables and words: estimates over the cases, failures, groups, optima of several starts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.batches.statistics import Columns, converged, estimates, is_repetition, misfit, optimum_numbers, statistics
from fmuid.batches.words import count_words, estimate_words, noted, optima_words, setting_words
from fmuid.files import write_table

# A setting with more levels than this is no heading of a group; nor are there more groups than that.
MAX_LEVELS, MAX_GROUPS = 20, 100

_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:0x[0-9a-fA-F]++|\d++(?:\.\d++)?+(?:[eE][-+]?\d++)?+)(?!\w)")
_TRUTH_COLUMNS = (
    "truth",
    "bias",
    "bias_std",
    "bias_p",
    "rms_error",
    "coverage",
    "coverage_lower",
    "coverage_upper",
    "coverage_p",
)


@dataclass(frozen=True, eq=False)
class Summary:
    """What a batch found.

    Attributes
    ----------
    cases, data_sets : int
        Finished cases, and data sets with an estimate; fewer where several starts share one.
    statuses : DataFrame
        ``status``, ``cases`` and ``share``, a row each of converged, not converged and failed.
    failures : DataFrame
        ``status``, ``message`` with ``#`` in place of numbers, ``cases``, and ``first``, the number of the first of
        them; the most frequent first.
    parameters : DataFrame
        A row a parameter: its name, ``unit``, and `fmuid.batches.statistics.statistics` over all data sets (what has to
        do with the truth only where one is known), and ``note``.
    groups : DataFrame
        The same for every combination of those settings that have few levels, after columns of the settings and, in
        ``failed``, how many cases of the group have no estimate; empty where no setting varies.
    settings : tuple of str
        The first columns of `groups`.
    optima : DataFrame
        Where starts vary, a row an optimum, numbered in each data set by how well it fits: ``optimum``, ``cases``,
        ``data_sets``, ``criterion`` (median), ``residual`` (root mean square of the residual against the best's,
        geometric mean over outputs, median), and where no setting varies the median of each parameter. Empty where
        starts do not vary.
    words : tuple of str
        What the numbers mean.
    """

    cases: int
    data_sets: int
    statuses: pd.DataFrame
    failures: pd.DataFrame
    parameters: pd.DataFrame
    groups: pd.DataFrame
    settings: tuple[str, ...]
    optima: pd.DataFrame
    words: tuple[str, ...]

    @property
    def has_truth(self) -> bool:
        """Whether the truth of any parameter is known."""
        return "truth" in self.parameters

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the CSV tables by their names, those without a row left out."""
        found = {
            "summary": self.parameters,
            "groups": self.groups,
            "failures": self.failures,
            "optima": self.optima,
        }
        return {name: table for name, table in found.items() if len(table)}

    def write(self, folder: Path) -> list[Path]:
        """Write the tables into a folder and return their paths; those of an earlier summary go.

        Raises
        ------
        InputError
            If the folder cannot be written to.
        """
        written = [write_table(folder / f"{name}.csv", table) for name, table in self.tables().items()]
        for name in ("summary", "groups", "failures", "optima"):
            if (path := folder / f"{name}.csv") not in written:
                path.unlink(missing_ok=True)
        return written


def summarize(
    frame: pd.DataFrame,
    truth: Mapping[str, float] | None = None,
    units: Mapping[str, str | None] | None = None,
    *,
    given_noise: bool = False,
) -> Summary:
    """Summarize the cases of a batch.

    Parameters
    ----------
    frame : DataFrame
        A row a case, as a batch's dataset has them.
    truth : mapping of str to float, optional
        Of the parameters, where the measurements were simulated.
    units : mapping of str to str, optional
        Of the parameters.
    given_noise : bool
        Whether the study gives all noise variances, so that criteria of several starts compare; see
        `fmuid.batches.statistics.misfit`.
    """
    columns = Columns.of(frame)
    found = estimates(frame, given_noise=given_noise)
    truth = {name: value for name, value in (truth or {}).items() if name in columns.parameters}
    settings = _settings(frame, columns)
    parameters = noted(_table(found, columns, truth, units or {}))
    groups = _groups(frame, found, columns, settings, truth, units or {})
    optima = _optima(frame, columns, given_noise=given_noise) if columns.starts else pd.DataFrame()
    statuses = _statuses(frame)
    words = [
        *count_words(statuses, len(found), columns),
        *estimate_words(parameters, columns),
        *setting_words(parameters, groups, settings),
        *optima_words(optima),
    ]
    return Summary(
        len(frame), len(found), statuses, _failures(frame), parameters, groups, settings, optima, tuple(words)
    )


# --- tables


def _table(
    found: pd.DataFrame, columns: Columns, truth: Mapping[str, float], units: Mapping[str, str | None]
) -> pd.DataFrame:
    """Return the statistics of every parameter, a row each."""
    repeated = is_repetition(found, columns)
    rows: list[dict[str, Any]] = []
    for name in columns.parameters:
        values, stds = (found[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        told = statistics(values, stds, truth.get(name, math.nan), repeated=repeated)
        rows.append({"parameter": name, "unit": units.get(name) or "", **told})
    table = pd.DataFrame(rows)
    return table if truth else table.drop(columns=list(_TRUTH_COLUMNS))


def _settings(frame: pd.DataFrame, columns: Columns) -> tuple[str, ...]:
    """Return the settings with few levels, by which the cases are grouped; those of fewest levels come first."""
    names = [*columns.design, *(name for name in columns.repeats if name == "table")]
    levels = {name: len(frame[name].unique()) for name in names}
    chosen: list[str] = []
    for name in sorted(names, key=lambda name: levels[name]):
        if 2 <= levels[name] <= MAX_LEVELS and len(frame[[*chosen, name]].drop_duplicates()) <= MAX_GROUPS:
            chosen.append(name)
    return tuple(name for name in names if name in chosen)


def _groups(
    frame: pd.DataFrame,
    found: pd.DataFrame,
    columns: Columns,
    settings: tuple[str, ...],
    truth: Mapping[str, float],
    units: Mapping[str, str | None],
) -> pd.DataFrame:
    if not settings:
        return pd.DataFrame()
    names = list(settings)
    parts = dict(iter(found.groupby(names, dropna=False)))
    tables = []
    for key, cases in frame.groupby(names, dropna=False):
        table = _table(parts.get(key, found.iloc[:0]), columns, truth, units)
        table.insert(0, "failed", len(cases) - len(converged(cases)))
        levels: Any = key
        tables.append(pd.concat([pd.DataFrame([levels] * len(table), columns=names), table], axis=1))
    return noted(pd.concat(tables, ignore_index=True))


def _statuses(frame: pd.DataFrame) -> pd.DataFrame:
    kinds = ["converged", "not converged", "failed"]
    counts = [int((frame["status"] == kind).sum()) for kind in kinds]
    return pd.DataFrame({"status": kinds, "cases": counts, "share": np.divide(counts, max(1, len(frame)))})


def _failures(frame: pd.DataFrame) -> pd.DataFrame:
    """Group the messages of cases without an estimate, their numbers left out."""
    failed = frame[frame["status"] != "converged"]
    tables = failed["table"] if "table" in failed else [""] * len(failed)
    told = pd.DataFrame(
        {
            "status": failed["status"].astype(str),
            "message": [_pattern(*pair) for pair in zip(failed["message"].astype(str), tables, strict=True)],
            "case": failed["case"],
        }
    )
    grouped = told.groupby(["status", "message"])["case"].agg(cases="size", first="min").reset_index()
    return grouped.sort_values(["cases", "first"], ascending=[False, True], ignore_index=True)


def _pattern(message: str, table: str) -> str:
    """Return a message with ``#`` for numbers and for the name of the case's own table."""
    if table and table in message:
        message = re.sub(rf"(?<!\w){re.escape(str(table))}(?!\w)", "#", message)
    return _NUMBER.sub("#", message)


def _optima(frame: pd.DataFrame, columns: Columns, *, given_noise: bool) -> pd.DataFrame:
    numbers = optimum_numbers(frame, given_noise=given_noise)
    there = frame[numbers > 0]
    if there.empty:
        return pd.DataFrame()
    # of each case against the best of its data set: ln of the root of the geometric mean of the variances
    size = 0.5 * misfit(there, given_noise=False) / max(1, len(columns.outputs))
    keys = there[columns.data].assign(optimum=numbers[numbers > 0], size=size)
    best = keys["size"].where(keys["optimum"] == 1)
    best = best.groupby([keys[name] for name in columns.data], dropna=False).transform("min") if columns.data else best
    shown = columns.parameters if is_repetition(frame, columns) else ()  # elsewhere optima lie for other reasons too
    values = {name: there[f"value.{name}"] for name in shown}
    told = there[["criterion"]].assign(residual=np.exp(keys["size"] - (best if columns.data else best.min())), **values)
    grouped = told.groupby(keys["optimum"])
    sets = keys.drop_duplicates([*columns.data, "optimum"]).groupby("optimum").size()
    counts = pd.DataFrame({"cases": grouped.size(), "data_sets": sets})
    return pd.concat([counts, grouped.median()], axis=1).reset_index()
