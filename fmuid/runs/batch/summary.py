"""Tables of a batch: estimates over the cases, failures, groups, optima of several starts."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid import codec
from fmuid.runs.batch.case import directions_of
from fmuid.runs.batch.statistics import (
    BatchColumns,
    converged,
    doubted,
    estimates,
    fit_cost,
    is_repetition,
    optimum_numbers,
    statistics,
)
from fmuid.runs.findings import Provenance

# Most levels of a setting that makes groups, and most groups.
MAX_LEVELS, MAX_GROUPS = 20, 100

OVERVIEW_FILE, BATCH_SCHEMA = "summary.json", "fmuid/batch/2"
STATUSES = ["converged", "not converged", "failed"]
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:0x[0-9a-fA-F]++|\d++(?:\.\d++)?+(?:[eE][-+]?\d++)?+)(?!\w)")
_TRUTH_COLUMNS = ["truth", "bias", "bias_std", "bias_p", "rms_error"]
_TRUTH_COLUMNS += ["coverage", "coverage_lower", "coverage_upper", "coverage_p"]


@dataclass(frozen=True)
class Dependence:
    """Range of a parameter's mean over groups; RMS of stated σ."""

    parameter: str
    unit: str
    low: float
    high: float
    at_low: Mapping[str, Any]
    at_high: Mapping[str, Any]
    stated_std: float


@dataclass(frozen=True)
class BatchOverview:
    """Content of ``summary.json``: facts that the tables of a batch lack."""

    statuses: Mapping[str, int]
    truth: Mapping[str, float]
    units: Mapping[str, str | None]
    given_noise: bool
    origin: Provenance | None = None


@dataclass(frozen=True, eq=False)
class Summary:
    """Findings of a batch."""

    columns: BatchColumns  # varied columns
    cases: int  # finished cases
    data_sets: int  # data sets with an estimate
    statuses: pd.DataFrame  # ``status``, ``cases`` and ``share``, a row each of converged, not converged and failed
    # ``status``, ``message`` with ``#`` for numbers, ``undetermined`` (pairs of an `IdentifiabilityLevel` and names),
    # ``cases`` and ``first``, the number of the first; the most frequent first
    failures: pd.DataFrame
    # A row a parameter: name, ``unit``, `statistics` over all data sets (true values only if known), and ``doubts``.
    parameters: pd.DataFrame
    # The same for each combination of settings of few levels, after columns of settings and ``failed``, the cases
    # without an estimate.
    groups: pd.DataFrame
    settings: tuple[str, ...]  # the first columns of `groups`
    # A row an optimum where starts vary, best first: ``optimum``, ``cases``, ``data_sets``, ``cost`` (median),
    # ``residual`` (RMS against the best, median), and the median of each parameter where no setting varies.
    optima: pd.DataFrame
    # Of the parameters whose mean varies with the settings by more than their stated std.
    dependences: tuple[Dependence, ...]
    wide: Mapping[str, float]  # without groups: spread over stated std of parameters, where above 1
    # Cases by outcome of the solver check, ``checked`` by own simulations, and searched by ``finer`` ones.
    accuracy: Mapping[str, int]
    reasons: Mapping[str, int]  # converged cases by `Reason` of their verdict, the most frequent first
    # ``output``, ``median`` and ``least`` of its fit over converged cases, %, and the ``case`` of the least
    fits: pd.DataFrame

    @property
    def has_truth(self) -> bool:
        """True if a true value of any parameter is known."""
        return "truth" in self.parameters

    @property
    def most(self) -> int:
        """The largest number of estimates of a parameter."""
        return int(self.parameters["cases"].max()) if len(self.parameters) else 0

    @property
    def few(self) -> bool:
        """True if there are too few estimates to test stated σ."""
        # below 30 the spread is uncertain by more than 13 %
        return self.most == 1 or (1 < self.most < 30 and bool(self.parameters["ratio"].notna().any()))

    @property
    def rivals(self) -> bool:
        """True if optima with other values fit as well as the best."""
        # 1000 samples do not distinguish residuals that are this close
        return len(self.optima) > 1 and bool((self.optima["residual"].iloc[1:] < 1.0 + 5e-4).any())


def write_overview(folder: Path, found: BatchOverview) -> Path:
    """Write ``summary.json``; return its path."""
    return codec.write(folder / OVERVIEW_FILE, BATCH_SCHEMA, found)


def summarize(
    frame: pd.DataFrame,
    truth: Mapping[str, float] | None = None,
    units: Mapping[str, str | None] | None = None,
    *,
    given_noise: bool = False,
) -> Summary:
    """Summarize the cases of a batch, a row each."""
    columns = BatchColumns.of(frame)
    found = estimates(frame, given_noise=given_noise)
    truth = {name: value for name, value in (truth or {}).items() if name in columns.parameters}
    settings = _settings(frame, columns)
    parameters = doubted(_table(found, columns, truth, units or {}))
    groups = _groups(frame, found, columns, list(settings), truth, units or {}) if settings else pd.DataFrame()
    optima = _optima(frame, columns, given_noise=given_noise) if columns.starts else pd.DataFrame()
    moving = [name for name in settings if name != "table"]
    return Summary(
        columns,
        len(frame),
        len(found),
        _statuses(frame),
        _failures(frame),
        parameters,
        groups,
        settings,
        optima,
        _dependences(groups, moving) if moving else (),
        {} if moving else _wide(parameters),
        _accuracy(frame),
        _reasons(frame),
        _fits(found, columns),
    )


def _table(
    found: pd.DataFrame, columns: BatchColumns, truth: Mapping[str, float], units: Mapping[str, str | None]
) -> pd.DataFrame:
    """Return the statistics of every parameter, a row each."""
    repeated = is_repetition(found, columns)
    rows: list[dict[str, Any]] = []
    for name in columns.parameters:
        values, stds = (found[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("value", "std"))
        told = statistics(values, stds, truth.get(name, math.nan), repeated=repeated)
        rows.append({"parameter": name, "unit": units.get(name) or "", **told})
    table = pd.DataFrame(rows)
    return table if truth else table.drop(columns=_TRUTH_COLUMNS)


def _settings(frame: pd.DataFrame, columns: BatchColumns) -> tuple[str, ...]:
    """Return the settings for groups: those with few levels."""
    names = [*columns.design, *(name for name in columns.repeats if name == "table")]
    levels = frame[names].nunique(dropna=False)
    chosen: list[str] = []
    for name in levels[levels.between(2, MAX_LEVELS)].sort_values(kind="stable").index:
        if len(frame[[*chosen, name]].drop_duplicates()) <= MAX_GROUPS:
            chosen.append(name)
    return tuple(name for name in names if name in chosen)


def _groups(
    frame: pd.DataFrame,
    found: pd.DataFrame,
    columns: BatchColumns,
    names: list[str],
    truth: Mapping[str, float],
    units: Mapping[str, str | None],
) -> pd.DataFrame:
    parts = dict(iter(found.groupby(names, dropna=False)))
    tables = []
    for levels, cases in frame.groupby(names, dropna=False):
        table = _table(parts.get(levels, found.iloc[:0]), columns, truth, units)
        table.insert(0, "failed", len(cases) - len(converged(cases)))
        repeated: Any = [levels] * len(table)
        tables.append(pd.concat([pd.DataFrame(repeated, columns=names), table], axis=1))
    return doubted(pd.concat(tables, ignore_index=True))


def _dependences(groups: pd.DataFrame, moving: list[str]) -> tuple[Dependence, ...]:
    found = []
    for name, rows in groups[groups["cases"] > 0].groupby("parameter", sort=False):
        stated = math.sqrt(float((rows["stated_std"] ** 2).mean()))
        low, high = (rows.iloc[i] for i in (rows["mean"].argmin(), rows["mean"].argmax()))
        if len(rows) > 1 and high["mean"] - low["mean"] > stated:
            ends = [dict(row[moving]) for row in (low, high)]
            found.append(Dependence(str(name), low["unit"], low["mean"], high["mean"], ends[0], ends[1], stated))
    return tuple(found)


def _wide(parameters: pd.DataFrame) -> dict[str, float]:
    rows = parameters[
        parameters["ratio"].isna() & (parameters["spread"] > parameters["stated_std"]) & (parameters["stated_std"] > 0)
    ]
    return dict(zip(rows["parameter"], rows["spread"] / rows["stated_std"], strict=True))


def _fits(found: pd.DataFrame, columns: BatchColumns) -> pd.DataFrame:
    rows = []
    for output in columns.outputs:
        name = f"fit.{output}"
        known = found[["case", name]].dropna() if name in found else found.iloc[:0]
        if len(known):
            case, least = known.sort_values(name, kind="stable").iloc[0]
            rows.append({"output": output, "median": known[name].median(), "least": least, "case": int(case)})
    return pd.DataFrame(rows)


def _accuracy(frame: pd.DataFrame) -> dict[str, int]:
    if "accuracy" not in frame or not (frame["accuracy"] != "").any():
        return {}
    outcomes = frame["accuracy"].astype(str).value_counts()
    counts = {str(outcome): int(count) for outcome, count in outcomes.items() if outcome}
    return counts | {"checked": int((frame["checked"] > 0).sum()), "finer": int((frame["finer"] > 0).sum())}


def _statuses(frame: pd.DataFrame) -> pd.DataFrame:
    counts = [int((frame["status"] == kind).sum()) for kind in STATUSES]
    return pd.DataFrame({"status": STATUSES, "cases": counts, "share": np.divide(counts, max(1, len(frame)))})


def _reasons(frame: pd.DataFrame) -> dict[str, int]:
    """Return the number of converged cases with each reason of a verdict."""
    if "reasons" not in frame:
        return {}
    told = frame.loc[frame["status"] == "converged", "reasons"].astype(str).value_counts()
    counts: Counter[str] = Counter()
    for reasons, cases in told.items():
        counts.update(dict.fromkeys(str(reasons).split(), int(cases)))
    return dict(counts.most_common())


def _failures(frame: pd.DataFrame) -> pd.DataFrame:
    """Count the messages of cases without an estimate; numbers are left out, the most frequent is first."""
    failed = frame[frame["status"] != "converged"]
    tables = failed["table"] if "table" in failed else [""] * len(failed)
    weak = failed.get("undetermined", pd.Series("", failed.index))
    told = pd.DataFrame(
        {
            "status": failed["status"],
            "message": [_pattern(*pair) for pair in zip(failed["message"], tables, strict=True)],
            "undetermined": [tuple((each.level, each.names) for each in directions_of(text)) for text in weak],
            "case": failed["case"],
        }
    )
    kinds = told.groupby(["status", "message", "undetermined"], sort=False)["case"]
    found = kinds.agg(cases="size", first="min").reset_index()
    return found.sort_values(["cases", "first"], ascending=[False, True], ignore_index=True)


def _pattern(message: str, table: str) -> str:
    """Return a message with ``#`` for numbers and table names."""
    if table and table in message:
        message = re.sub(rf"(?<!\w){re.escape(str(table))}(?!\w)", "#", message)
    return _NUMBER.sub("#", message)


def _optima(frame: pd.DataFrame, columns: BatchColumns, *, given_noise: bool) -> pd.DataFrame:
    numbers = optimum_numbers(frame, given_noise=given_noise)
    there = frame[numbers > 0]
    if there.empty:
        return pd.DataFrame()
    # of each case against the best of its data set: ln of the root of the geometric mean of the variances
    size = 0.5 * fit_cost(there, given_noise=False) / max(1, len(columns.outputs))
    keys = there[columns.data].assign(optimum=numbers[numbers > 0], size=size)
    best = keys["size"].where(keys["optimum"] == 1)
    best = best.groupby([keys[name] for name in columns.data], dropna=False).transform("min") if columns.data else best
    shown = columns.parameters if is_repetition(frame, columns) else ()  # elsewhere optima lie for other reasons too
    values = {name: there[f"value.{name}"] for name in shown}
    told = there[["cost"]].assign(residual=np.exp(keys["size"] - (best if columns.data else best.min())), **values)
    grouped = told.groupby(keys["optimum"])
    sets = keys.drop_duplicates([*columns.data, "optimum"]).groupby("optimum").size()
    counts = pd.DataFrame({"cases": grouped.size(), "data_sets": sets})
    return pd.concat([counts, grouped.median()], axis=1).reset_index()
