"""What the summary of a batch says in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from fmuid.estimation import AccuracyOutcome
from fmuid.formatting import fit_text, has_unit, rounded
from fmuid.reports.messages.identifiability import open_words
from fmuid.reports.messages.result import ENDS
from fmuid.runs import Dependence, EstimateWarning, Summary

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
