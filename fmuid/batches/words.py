"""What the numbers of a batch mean, in words: what is surely not as stated, what depends on what, how few cases are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from fmuid.batches.statistics import LEVEL, Columns
from fmuid.text import has_unit, rounded

# Probability, over all that is tested, of a word where there is nothing.
FALSE_WORD = 0.01
# Less than this is not worth a word, however many cases there are: of spread against stated std, and of the bias in
# stated std (coverage falls from 95 to 94.3 %, and to 94.8 %).
WORTH_RATIO, WORTH_BIAS, WORTH_COVERAGE = 1.05, 0.15, 0.01
# The spread of fewer cases is uncertain by more than 13 %, which is said.
FEW = 30
# Optima whose residuals differ by less than this share fit equally well: 1000 samples cannot tell them apart.
EQUALLY_WELL = 5e-4

Row = Mapping[Any, Any]


def noted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of statistics with a last column ``note``: what is surely not as stated, and by how much.

    Parameters
    ----------
    table : DataFrame
        As `fmuid.batches.summary.Summary.parameters`; the more of its rows are tested, the surer each word must be.
    """
    tested = [name for name in table if str(name).endswith("_p")]
    tests = max(1, int(table[tested].notna().to_numpy().sum()))
    return table.assign(note=[_note(row, tests) for row in table.to_dict("records")])


def _note(row: Row, tests: int) -> str:
    notes = []
    ratio = row["ratio"]
    if row["ratio_p"] * tests < FALSE_WORD and max(ratio, 1.0 / ratio if ratio else math.inf) > WORTH_RATIO:
        large = f"{1.0 / ratio:.3g} x too large" if ratio else "too large"
        notes.append(f"std {ratio:.3g} x too small" if ratio > 1.0 else f"std {large}")
    if row.get("bias_p", math.nan) * tests < FALSE_WORD and abs(row["bias"]) > WORTH_BIAS * row["stated_std"]:
        notes.append("biased")
    off = abs(row.get("coverage", math.nan) - LEVEL)
    if row.get("coverage_p", math.nan) * tests < FALSE_WORD and off > WORTH_COVERAGE and not notes:
        notes.append(f"95 % intervals hold {100 * row['coverage']:.3g} %")
    if row["undetermined"]:
        notes.append(f"not determined in {row['undetermined']}")
    return ", ".join(notes)


def count_words(statuses: pd.DataFrame, data_sets: int, columns: Columns) -> list[str]:
    """Return sentences on which cases the estimates are over.

    Parameters
    ----------
    statuses : DataFrame
        As `fmuid.batches.summary.Summary.statuses`.
    data_sets : int
        With an estimate.
    columns : Columns
    """
    done, *others = statuses["cases"].tolist()
    words = []
    if sum(others):
        kinds = [f"{n} {word}" for n, word in zip(others, ("did not converge", "failed"), strict=True) if n]
        words.append(
            f"{done} of {done + sum(others)} cases converged, {' and '.join(kinds)} and are left out of what follows"
        )
    if columns.starts and done > data_sets:
        words.append(
            f"searches from several starts share a data set: of each of the {data_sets} data sets the one that fits "
            "best is counted"
        )
    return words


def estimate_words(parameters: pd.DataFrame, columns: Columns) -> list[str]:
    """Return sentences on how the estimates lie over all cases, against what they state and against the truth.

    Parameters
    ----------
    parameters : DataFrame
        As `fmuid.batches.summary.Summary.parameters`.
    columns : Columns
    """
    most = int(parameters["cases"].max()) if len(parameters) else 0
    words = []
    if most == 1:
        words.append("one estimate has no spread: nothing can be said of how sure the stated std are")
    elif most and most < FEW and parameters["ratio"].notna().any():
        share = 1.0 / math.sqrt(2.0 * (most - 1))
        words.append(f"{most} cases are few: their spread is itself uncertain by {100 * share:.0f} %")
    several = "draw" not in columns.repeats and "table" in columns.repeats
    for row in parameters.to_dict("records"):
        words += [f"{row['parameter']}: {sentence}" for sentence in _sentences(row, tables=several)]
    return words


def _sentences(row: Row, *, tables: bool) -> list[str]:
    """Return what is surely not as stated of one parameter."""
    unit, note = _after(row["unit"]), row["note"]
    spread, stated = (rounded(row[name], row[name]) + unit for name in ("spread", "stated_std"))
    held = ""
    if math.isfinite(row.get("coverage_lower", math.nan)):
        low, high = (100.0 * row[f"coverage_{end}"] for end in ("lower", "upper"))
        held = f"the 95 % intervals hold the truth in {100 * row['coverage']:.3g} % ({low:.3g} to {high:.3g} %)"
    words = []
    if "too small" in note:
        why = "what was measured differs, or the stated std is too small" if tables else "that is too small"
        among = "from table to table" if tables else "from case to case"
        words.append(f"varies {row['ratio']:.3g} times as much {among} ({spread}) as its stated std ({stated}): {why}")
    if "too large" in note:
        words.append(f"varies less ({spread}) than its stated std says ({stated}): that is too large")
    if "biased" in note:
        share = abs(row["bias"]) / row["stated_std"]
        size = f"{rounded(row['bias'], row['bias_std'])} ± {rounded(row['bias_std'], row['bias_std'])}{unit}"
        words.append(f"biased by {size}, {share:.2g} times its stated std")
    return [*words, held] if held and (words or "intervals" in note) else words


def _after(unit: str) -> str:
    return f" {unit}" if has_unit(unit) else ""


def setting_words(parameters: pd.DataFrame, groups: pd.DataFrame, settings: tuple[str, ...]) -> list[str]:
    """Return sentences on how far estimates depend on the settings, and in how many groups they are not as stated.

    Parameters
    ----------
    parameters, groups : DataFrame
    settings : tuple of str
        As in `fmuid.batches.summary.Summary`.
    """
    moving = [name for name in settings if name != "table"]
    if not moving:
        wide = parameters[parameters["ratio"].isna() & (parameters["spread"] > parameters["stated_std"])]
        return [
            f"{row['parameter']} varies {row['spread'] / row['stated_std']:.2g} times its stated std over what is set"
            for row in wide.to_dict("records")
            if row["stated_std"] > 0
        ]
    words = []
    for name, rows in groups[groups["cases"] > 0].groupby("parameter", sort=False):
        stated = math.sqrt(float((rows["stated_std"] ** 2).mean()))
        low, high = (rows.iloc[i] for i in (rows["mean"].argmin(), rows["mean"].argmax()))
        unit = _after(low["unit"])
        if len(rows) > 1 and high["mean"] - low["mean"] > stated:
            ends = [f"{rounded(row['mean'], stated)}{unit} ({_where(row, moving)})" for row in (low, high)]
            times = f", {(high['mean'] - low['mean']) / stated:.2g} times its stated std" if stated > 0 else ""
            words.append(f"{name} depends on what is set: its mean goes from {ends[0]} to {ends[1]}{times}")
        kinds = {
            "too small": "its stated std is too small",
            "too large": "its stated std is too large",
            "biased": "it is biased",
        }
        for mark, said in kinds.items():
            if count := sum(mark in note for note in rows["note"]):
                words.append(f"{name}: {said} in {count} of {len(rows)} groups")
    return words


def _where(row: Any, names: list[str]) -> str:
    parts = [(name.removeprefix("set."), row[name]) for name in names]
    return ", ".join(
        f"{name} = {level:.6g}" if isinstance(level, float) else f"{name} = {level}" for name, level in parts
    )


def optima_words(optima: pd.DataFrame) -> list[str]:
    """Return sentences on where searches from several starts ended.

    Parameters
    ----------
    optima : DataFrame
        As `fmuid.batches.summary.Summary.optima`.
    """
    if not len(optima):
        return []
    total, best, sets = int(optima["cases"].sum()), int(optima["cases"].iloc[0]), int(optima["data_sets"].iloc[0])
    if len(optima) == 1:
        return [
            f"all {total} searches that converged ended at the same optimum" + (" of their data" if sets > 1 else "")
        ]
    words = [f"of {total} searches that converged, {total - best} ended at another optimum than the best"]
    rival = optima.iloc[1:].loc[optima["residual"].iloc[1:] < 1.0 + EQUALLY_WELL]
    if len(rival):
        words.append(
            "optima with different values fit equally well: the data do not tell which is true; give bounds or priors"
        )
    return words
