"""A batch: its cases, their spread against the stated one, the truth, settings, failures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.estimation import AccuracyOutcome
from fmuid.formatting import fit_text, has_unit, rounded, unit_text, with_std
from fmuid.reports.chart import Units
from fmuid.reports.document import CONSOLE, Document, Remark, Section, Table, Tone, capitalised, table_of
from fmuid.reports.shared_phrases import open_words
from fmuid.reports.topics.case_charts import (
    distributions,
    failure_chart,
    over_cases,
    over_setting,
    over_starts,
    spread_chart,
)
from fmuid.reports.topics.provenance import origin_of
from fmuid.reports.topics.termination import ENDS
from fmuid.runs import BatchColumns, Dependence, EstimateWarning, Summary, estimates, is_repetition

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.runs import BatchResult, Provenance

Row = Mapping[Any, Any]

IN_GROUPS = {
    EstimateWarning.STD_TOO_SMALL: "its stated std is too small",
    EstimateWarning.STD_TOO_LARGE: "its stated std is too large",
    EstimateWarning.BIASED: "it is biased",
}
ACCURACY = {
    AccuracyOutcome.SHIFTED: "are shifted by that error, which their std include",
    AccuracyOutcome.UNKNOWN: "may be shifted by that error: not all their std are known",
    AccuracyOutcome.COUPLED: (
        "depend on how often the FMUs exchange values: give samples = true or false for the components"
    ),
    AccuracyOutcome.UNCHECKABLE: "cannot be checked: nothing finer is offered, or it gives the same to the last bit",
    AccuracyOutcome.FAILED: "could not be checked: the finer simulation fails",
}
"""What is to be said of cases whose simulation did not pass its check."""


def summary_words(summary: Summary) -> list[str]:
    """Return sentences on what the numbers of a batch mean.

    They are on which cases the estimates are over, how well these fit, how they lie against what they state and against
    the truth, how far they depend on the settings, and where searches from several starts ended.
    """
    parts = _counts, _fits, _estimates, _settings, _optima, _accuracy
    return [said for part in parts for said in part(summary)]


def note(row: Row) -> str:
    """Return in a few words what is not as stated of one row of a table of statistics."""
    ratio, doubts, notes = row["ratio"], row["doubts"], []
    if EstimateWarning.STD_TOO_SMALL in doubts:
        notes.append(f"std {ratio:.3g} x too small")
    if EstimateWarning.STD_TOO_LARGE in doubts:
        notes.append(f"std {1.0 / ratio:.3g} x too large" if ratio else "std too large")
    if EstimateWarning.BIASED in doubts:
        notes.append("biased")
    if doubts == (EstimateWarning.COVERAGE_OFF,):
        notes.append(f"95 % intervals hold {100 * row['coverage']:.3g} %")
    if row["undetermined"]:
        notes.append(f"not determined in {row['undetermined']}")
    return ", ".join(notes)


def failure_words(row: Row) -> str:
    """Return why the cases of one row of `Summary.failures` have no estimate."""
    said = str(row["message"])
    ends = {outcome.value: words for outcome, words in ENDS.items()} if row["status"] == "not converged" else {}
    return ": ".join(filter(None, [ends.get(said, said), "; ".join(open_words(*each) for each in row["undetermined"])]))


def _counts(summary: Summary) -> Iterator[str]:
    done, *others = summary.statuses["cases"].tolist()
    if sum(others):
        kinds = [f"{n} {word}" for n, word in zip(others, ("did not converge", "failed"), strict=True) if n]
        yield f"{done} of {done + sum(others)} cases converged, {' and '.join(kinds)} and are left out of what follows"
    if summary.columns.starts and done > summary.data_sets:
        yield (
            f"searches from several starts share a data set: of each of the {summary.data_sets} data sets the one that "
            "fits best is counted"
        )


def _fits(summary: Summary) -> Iterator[str]:
    for row in summary.fits.to_dict("records"):
        median, least = fit_text(row["median"]), fit_text(row["least"])
        yield f"fit (NRMSE) of {row['output']}: {median} in the median, {least} at least (case {row['case']})"


def _estimates(summary: Summary) -> Iterator[str]:
    if summary.few and summary.most == 1:
        yield "one estimate has no spread: nothing can be said of how sure the stated std are"
    elif summary.few:
        share = 1.0 / math.sqrt(2.0 * (summary.most - 1))
        yield f"{summary.most} cases are few: their spread is itself uncertain by {100 * share:.0f} %"
    several = "draw" not in summary.columns.repeats and "table" in summary.columns.repeats
    for row in summary.parameters.to_dict("records"):
        yield from (f"{row['parameter']}: {sentence}" for sentence in _not_as_stated(row, tables=several))


def _not_as_stated(row: Row, *, tables: bool) -> Iterator[str]:
    """Give what is surely not as stated of one parameter."""
    unit, doubts = _after(row["unit"]), row["doubts"]
    spread, stated = (rounded(row[name], row[name]) + unit for name in ("spread", "stated_std"))
    if EstimateWarning.STD_TOO_SMALL in doubts:
        why = "what was measured differs, or the stated std is too small" if tables else "that is too small"
        among = "from table to table" if tables else "from case to case"
        yield f"varies {row['ratio']:.3g} times as much {among} ({spread}) as its stated std ({stated}): {why}"
    if EstimateWarning.STD_TOO_LARGE in doubts:
        yield f"varies less ({spread}) than its stated std says ({stated}): that is too large"
    if EstimateWarning.BIASED in doubts:
        share = abs(row["bias"]) / row["stated_std"]
        size = f"{rounded(row['bias'], row['bias_std'])} ± {rounded(row['bias_std'], row['bias_std'])}{unit}"
        yield f"biased by {size}, {share:.2g} times its stated std"
    if doubts and math.isfinite(row.get("coverage_lower", math.nan)):
        low, high = (100.0 * row[f"coverage_{end}"] for end in ("lower", "upper"))
        yield f"the 95 % intervals hold the truth in {100 * row['coverage']:.3g} % ({low:.3g} to {high:.3g} %)"


def _settings(summary: Summary) -> Iterator[str]:
    for name, times in summary.wide.items():
        yield f"{name} varies {times:.2g} times its stated std over what is set"
    if all(name == "table" for name in summary.settings):
        return
    dependences = {each.parameter: each for each in summary.dependences}
    for parameter, rows in summary.groups[summary.groups["cases"] > 0].groupby("parameter", sort=False):
        name = str(parameter)
        if name in dependences:
            yield _dependence(dependences[name])
        for doubt, said in IN_GROUPS.items():
            if count := sum(doubt in doubts for doubts in rows["doubts"]):
                yield f"{name}: {said} in {count} of {len(rows)} groups"


def _dependence(found: Dependence) -> str:
    ends = (found.low, found.at_low), (found.high, found.at_high)
    low, high = (f"{rounded(mean, found.stated_std)}{_after(found.unit)} ({_where(at)})" for mean, at in ends)
    share = (found.high - found.low) / found.stated_std if found.stated_std > 0 else math.nan
    times = f", {share:.2g} times its stated std" if share > 0 else ""
    return f"{found.parameter} depends on what is set: its mean goes from {low} to {high}{times}"


def _where(at: Mapping[str, Any]) -> str:
    levels = {name: f"{level:.6g}" if isinstance(level, float) else str(level) for name, level in at.items()}
    return ", ".join(f"{name.removeprefix('set.')} = {level}" for name, level in levels.items())


def _after(unit: str) -> str:
    return f" {unit}" if has_unit(unit) else ""


def _optima(summary: Summary) -> Iterator[str]:
    optima = summary.optima
    if not len(optima):
        return
    total, best, sets = int(optima["cases"].sum()), int(optima["cases"].iloc[0]), int(optima["data_sets"].iloc[0])
    if len(optima) == 1:
        yield f"all {total} searches that converged ended at the same optimum" + (" of their data" if sets > 1 else "")
        return
    yield f"of {total} searches that converged, {total - best} ended at another optimum than the best"
    if summary.rivals:
        yield "optima with different values fit equally well: the data do not tell which is true; give bounds or priors"


def _accuracy(summary: Summary) -> Iterator[str]:
    """Give in how many cases the simulation was checked, and what came of it."""
    counts, total = summary.accuracy, sum(summary.accuracy.get(each.value, 0) for each in AccuracyOutcome)
    if not total:
        return
    yield (
        f"the error of the simulation was looked at in {total} cases, in {counts['checked']} by new simulations: the "
        "others lie where it was known"
    )
    if counts["finer"]:
        yield f"{counts['finer']} of them were searched by a finer simulation"
    for outcome, said in ACCURACY.items():
        if count := counts.get(outcome.value, 0):
            yield f"{count} of them {said}"


# --- document -------------------------------------------------------------------------------

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
MAX_COLUMNS = 6
"""Parameters side by side in a table of groups or optima; the files have all."""
MAX_KINDS = 8
"""Kinds of failures and optima in a table."""


def batch_document(found: BatchResult, origin: Provenance | None = None) -> Document:
    """Return the document of a batch.

    Parameters
    ----------
    found : BatchResult
    origin : Provenance, optional
        What it was made from.
    """
    summary, _ = found.summary()
    units, given = dict(found.units), found.given_noise
    sections = batch_sections(found.frame, summary, dict(found.truth), units, given_noise=given)
    return summary_document(summary, sections, units, origin)


def summary_document(
    summary: Summary, sections: Sequence[Section] = (), units: Units | None = None, origin: Provenance | None = None
) -> Document:
    """Return the document of the summary of a batch, with sections on its cases."""
    counts = {str(row["status"]): int(row["cases"]) for row in summary.statuses.to_dict("records")}
    done, total = counts.get("converged", 0), sum(counts.values())
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    said = [Remark(f"{done} of {total} cases converged", "plain", "failures")]
    said += [Remark(capitalised(text, units or ()), "doubt", "distributions") for text in summary_words(summary)]
    tone: Tone = "good" if done == total else "bad"
    state = f"{total} cases: {told}" if told else "no case has finished"
    shown = (*_tables(summary), *sections)
    return Document("batch", "Batch", state, tone, tuple(said), shown, **origin_of(origin, {"cases": told}))


def batch_sections(
    frame: pd.DataFrame, summary: Summary, truth: Mapping[str, float], units: Units, *, given_noise: bool
) -> list[Section]:
    """Return the sections with charts of a batch.

    Parameters
    ----------
    frame : DataFrame
        A row a case.
    summary : Summary
    truth, units : mapping
        Of the parameters.
    given_noise : bool
        Whether the noise was given, not estimated.
    """
    counted, columns = estimates(frame, given_noise=given_noise), BatchColumns.of(frame)
    drawn = tuple(over_cases(frame, truth, units))
    sections = [Section("cases", "Estimates over the cases", CASES, charts=drawn, beside=2)]
    if len(counted) > 1:
        drawn = tuple(distributions(counted, truth, units, repeated=is_repetition(counted, columns)))
        sections.append(Section("distributions", "Distributions", DISTRIBUTIONS, charts=drawn))
    if len(summary.parameters) and np.isfinite(summary.parameters["ratio"].astype(float)).any():
        drawn = (spread_chart(summary.parameters),)
        sections.append(Section("spread", "Spread against stated std", SPREAD, charts=drawn, beside=1))
    tables = ("table",) if "table" in columns.repeats else ()
    for k, name in enumerate(name for name in (*columns.design, *tables) if len(counted[name].unique()) > 1):
        drawn = tuple(over_setting(counted, name, truth, units))
        heading = f"Over {name.removeprefix('set.')}"
        sections.append(Section(f"over-{k + 1}", heading, SETTING if k == 0 else "", charts=drawn))
    if columns.starts:
        drawn = tuple(over_starts(frame, truth, units, given_noise=given_noise))
        sections.append(Section("starts", "Where the searches ended", STARTS, charts=drawn))
    if len(failures := summary.failures):
        messages = [failure_words(row) for row in failures.to_dict("records")]
        chart = failure_chart(messages, failures["status"].tolist(), failures["cases"].to_numpy(np.float64))
        sections.append(Section("failures", "Without an estimate", FAILURES, charts=(chart,), beside=1))
    return [each for each in sections if each.charts]


def _tables(summary: Summary) -> list[Section]:
    # a parameter that is held in every case has no estimate to show
    rows = summary.parameters[summary.parameters["cases"] > 0].to_dict("records")
    names = [str(row["parameter"]) for row in rows][:MAX_COLUMNS]
    sections = [Section("summary", "Estimates over the cases", table=summary_table(summary))] if rows else []
    if rows and summary.has_truth:
        sections.append(_against_truth([row for row in rows if math.isfinite(row["truth"])]))
    if rows and len(summary.groups):
        sections.append(_groups(summary, names))
    if len(summary.optima) > 1:
        sections.append(_optima_section(summary, names))
    return [*sections, *([_failures(summary.failures)] if len(summary.failures) else [])]


def summary_table(summary: Summary) -> Table:
    """Return the table of the estimates of a batch, a row a parameter that there are estimates of."""
    rows = summary.parameters[summary.parameters["cases"] > 0].to_dict("records")
    columns = {
        "parameter": [str(row["parameter"]) for row in rows],
        "cases": [str(row["cases"]) for row in rows],
        "mean": [rounded(row["mean"], _scale(row)) for row in rows],
        "median": [rounded(row["median"], _scale(row)) for row in rows],
        "spread": [_digits(row["spread"]) for row in rows],
        "stated std": [_digits(row["stated_std"]) for row in rows],
        "spread / stated": [_short(row["ratio"], 3) for row in rows],
        "unit": [unit_text(row["unit"]) for row in rows],
        "note": [note(row) for row in rows],
    }
    return table_of(columns, ("unit", "note"), ("median",))


def _against_truth(rows: Sequence[Row]) -> Section:
    columns = {
        "parameter": [str(row["parameter"]) for row in rows],
        "truth": [f"{row['truth']:.6g}" for row in rows],
        "bias": [
            with_std(row["bias"], row["bias_std"]) if row["bias_std"] > 0 else _short(row["bias"], 3) for row in rows
        ],
        "RMS error": [_digits(row["rms_error"]) for row in rows],
        "95 % intervals hold it": [_coverage(row) for row in rows],
        "unit": [unit_text(row["unit"]) for row in rows],
    }
    return Section("truth", "Against the truth", table=table_of(columns, ("unit",)))


def _bias(row: Row) -> str:
    return with_std(row["bias"], row["bias_std"]) if row["bias_std"] > 0 else _short(row["bias"], 3)


def _coverage(row: Row) -> str:
    said = f"{100 * row['coverage']:.1f} %"
    if math.isnan(row["coverage_lower"]):
        return said
    return said + f" ({100 * row['coverage_lower']:.1f} to {100 * row['coverage_upper']:.1f})"


def _groups(summary: Summary, names: Sequence[str]) -> Section:
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
    columns = {head: [row[k] for row in cells] for k, head in enumerate(heads)}
    return Section("groups", title, table=table_of(columns), shown=CONSOLE)


def _optima_section(summary: Summary, names: Sequence[str]) -> Section:
    shown = summary.optima.head(MAX_KINDS)
    columns = {
        "optimum": [str(each) for each in shown["optimum"]],
        "cases": [str(each) for each in shown["cases"]],
        "residual / best": [f"{each:.4g}" for each in shown["residual"]],
        **{name: [_short(each, 5) for each in shown[name]] for name in names if name in shown},
    }
    return Section("ends", "Optima that the starts led to, medians", table=table_of(columns))


def _failures(failures: pd.DataFrame) -> Section:
    rows = [
        (str(row["cases"]), str(row["first"]), str(row["status"]), failure_words(row))
        for row in failures.head(MAX_KINDS).to_dict("records")
    ]
    if len(failures) > MAX_KINDS:
        rest = failures.iloc[MAX_KINDS:]
        rows.append((str(rest["cases"].sum()), str(rest["first"].min()), "", f"{len(rest)} other messages"))
    heads = ("cases", "first case", "status", "message")
    columns = {head: [row[k] for row in rows] for k, head in enumerate(heads)}
    return Section("lost", "Cases without an estimate", table=table_of(columns, ("status", "message")), shown=CONSOLE)


def _scale(row: Row) -> float:
    """Return the standard deviation whose digits a mean is printed to."""
    return float(row["spread"] if row["spread"] > 0 else row["stated_std"])


def _digits(value: float) -> str:
    return rounded(value, value) if math.isfinite(value) else ""


def _short(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else ""


def _level(level: Any) -> str:
    return f"{level:.6g}" if isinstance(level, float) else str(level)
