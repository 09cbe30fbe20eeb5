"""Messages and sections of a batch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from fmuid.estimation import AccuracyOutcome
from fmuid.formatting import fit_text, has_unit, rounded
from fmuid.reports.document import Document, Message, Remark, Section, Tone, origin_of
from fmuid.reports.topics import case_charts as charts
from fmuid.reports.topics.batch_tables import failure_texts, level_text, tables_of
from fmuid.runs import (
    BatchColumns,
    BatchResult,
    Dependence,
    EstimateWarning,
    Summary,
    estimates,
    is_repetition,
    made_from,
)
from fmuid.studies import Study

Row = Mapping[Any, Any]

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


class BatchMessage(Message):
    """What the numbers of a batch mean."""

    LEFT_OUT = (
        "{done} of {total} cases converged, {others} and are left out of what follows",
        "`failures` has the reasons of the cases without an estimate",
    )
    BEST_OF_STARTS = (
        "searches from several starts share a data set: of each of the {sets} data sets the one that fits best is "
        "counted",
        "starts are no draws",
    )
    FIT = (
        "fit (NRMSE) of {output}: {median} in the median, {least} at least (case {case})",
        "of the cases that converged",
        "look at the case with the least",
    )
    ONE = (
        "one estimate has no spread: nothing can be said of how sure the stated std are",
        "a batch of a single estimate",
        "draw more",
    )
    FEW = (
        "{count} cases are few: their spread is itself uncertain by {share:.0f} %",
        "the spread is a rough number",
        "draw more",
    )
    STD_TOO_SMALL = (
        "{name}: varies {ratio:.3g} times as much {among} ({spread}) as its stated std ({stated}): {why}",
        "from case to case: the noise is not what it is taken for, or the problem is far from linear; from table to "
        "table: machines or operating points may differ, too",
    )
    STD_TOO_LARGE = (
        "{name}: varies less ({spread}) than its stated std says ({stated}): that is too large",
        "the noise is less than stated, or was drawn without what the real one has",
    )
    BIASED = ("{name}: biased by {size}, {share:.2g} times its stated std", "the mean misses the truth that is known")
    COVERAGE = (
        "{name}: the 95 % intervals hold the truth in {held:.3g} % ({low:.3g} to {high:.3g} %)",
        "counted, with the interval of such a count",
    )
    WIDE = (
        "{name} varies {times:.2g} times its stated std over what is set",
        "the settings matter more than the noise",
    )
    DEPENDS = (
        "{name} depends on what is set: its mean goes from {low} to {high}{times}",
        "the settings matter more than the noise",
    )
    IN_GROUPS = (
        "{name}: {what} in {count} of {groups} groups",
        "its stated std is too small or too large, or the mean misses the truth, in so many groups of the cases",
    )
    ONE_OPTIMUM = (
        "all {total} searches that converged ended at the same optimum{of}",
        "the start does not decide where a search ends",
    )
    OTHER_OPTIMA = (
        "of {total} searches that converged, {others} ended at another optimum than the best",
        "the start decides where a search ends",
    )
    RIVALS = (
        "optima with different values fit equally well: the data do not tell which is true; give bounds or priors",
        "one number would hide the others",
        "give bounds or priors",
    )
    CHECKED = (
        "the error of the simulation was looked at in {total} cases, in {checked} by new simulations: the others lie "
        "where it was known",
        "see [the error of the simulation](#the-error-of-the-simulation)",
    )
    FINER = ("{count} of them were searched by a finer simulation", "the one of the study was too coarse there")
    SHIFTED = (
        "{count} of them are shifted by that error, which their std include",
        "it is larger than a tenth of a standard deviation",
        "give a smaller step, or model exchange",
    )
    UNKNOWN = (
        "{count} of them may be shifted by that error: not all their std are known",
        "there is nothing to compare it with",
        "look at what is undetermined first",
    )
    COUPLED = (
        "{count} of them depend on how often the FMUs exchange values: give samples = true or false for the components",
        "controllers that act at each sample are other plants at another step",
    )
    UNCHECKABLE = (
        "{count} of them cannot be checked: nothing finer is offered, or it gives the same to the last bit",
        "nothing is known of that error",
        "export the FMU for model exchange, too",
    )
    CHECK_FAILED = (
        "{count} of them could not be checked: the finer simulation fails",
        "nothing is known of that error",
    )


IN_GROUPS = {
    EstimateWarning.STD_TOO_SMALL: "its stated std is too small",
    EstimateWarning.STD_TOO_LARGE: "its stated std is too large",
    EstimateWarning.BIASED: "it is biased",
}
ACCURACY = {
    AccuracyOutcome.SHIFTED: BatchMessage.SHIFTED,
    AccuracyOutcome.UNKNOWN: BatchMessage.UNKNOWN,
    AccuracyOutcome.COUPLED: BatchMessage.COUPLED,
    AccuracyOutcome.UNCHECKABLE: BatchMessage.UNCHECKABLE,
    AccuracyOutcome.FAILED: BatchMessage.CHECK_FAILED,
}
"""What is to be said of cases whose simulation did not pass its check."""


def batch_document(found: BatchResult, summary: Summary, frame: pd.DataFrame, study: Study) -> Document:
    """Return the document of a batch."""
    drawn = charts_of(frame, summary, found.truth, found.units, given_noise=found.given_noise)
    tone, state = state_of(summary)
    sections = (*tables_of(summary), *drawn)
    origin = origin_of(made_from(study), {"cases": state})
    return Document("batch", "Batch", state, tone, tuple(summary_remarks(summary)), sections, **origin)


def state_of(summary: Summary) -> tuple[Tone, str]:
    """Return the number of cases by status, and their tone."""
    statuses = zip(summary.statuses["status"], summary.statuses["cases"].tolist(), strict=True)
    known = {str(status): int(count) for status, count in statuses if count}
    if not known:
        return "bad", "no case has finished"
    good = known.get("converged", 0)
    tone: Tone = "good" if good == summary.cases else "doubt" if good else "bad"
    return tone, f"{summary.cases} cases, " + ", ".join(f"{count} {status}" for status, count in known.items())


def charts_of(
    frame: pd.DataFrame,
    summary: Summary,
    truth: Mapping[str, float],
    units: Mapping[str, str | None],
    *,
    given_noise: bool,
) -> list[Section]:
    """Return the sections with charts; one without any is left out."""
    found, columns = estimates(frame, given_noise=given_noise), BatchColumns.of(frame)
    over = charts.over_cases(frame, truth, units)
    sections = [Section("cases", "Estimates over the cases", CASES, charts=tuple(over), beside=2)]
    if len(found) > 1:
        drawn = charts.distributions(found, truth, units, repeated=is_repetition(found, columns))
        sections.append(Section("distributions", "Distributions", DISTRIBUTIONS, charts=tuple(drawn)))
    if len(summary.parameters) and np.isfinite(summary.parameters["ratio"].astype(float)).any():
        ratio = charts.spread(summary.parameters)
        sections.append(Section("spread", "Spread against stated std", SPREAD, charts=(ratio,), beside=1))
    tables = ("table",) if "table" in columns.repeats else ()
    settings = [name for name in (*columns.design, *tables) if len(found[name].unique()) > 1]
    for k, name in enumerate(settings):
        drawn = charts.over_setting(found, name, truth, units)
        heading = f"Over {name.removeprefix('set.')}"
        sections.append(Section(f"over-{k + 1}", heading, SETTING if k == 0 else "", charts=tuple(drawn)))
    if columns.starts:
        drawn = charts.over_starts(frame, truth, units, given_noise=given_noise)
        sections.append(Section("starts", "Where the searches ended", STARTS, charts=tuple(drawn)))
    if len(summary.failures):
        bars = charts.failures(summary.failures, failure_texts(summary.failures))
        sections.append(Section("failures", "Without an estimate", FAILURES, charts=(bars,), beside=1))
    return [each for each in sections if each.charts]


def summary_remarks(summary: Summary) -> list[Remark]:
    """Return the remarks on the statistics of a batch."""
    parts = _counts, _spreads, _settings, _ends, _accuracy
    return [said for part in parts for said in part(summary)]


def _counts(summary: Summary) -> Iterator[Remark]:
    done, *others = summary.statuses["cases"].tolist()
    if sum(others):
        kinds = [f"{n} {word}" for n, word in zip(others, ("did not converge", "failed"), strict=True) if n]
        total = done + sum(others)
        yield BatchMessage.LEFT_OUT.said("plain", "failures", done=done, total=total, others=" and ".join(kinds))
    if summary.columns.starts and done > summary.data_sets:
        yield BatchMessage.BEST_OF_STARTS.said("plain", "starts", sets=summary.data_sets)
    for row in summary.fits.to_dict("records"):
        values = {"median": fit_text(row["median"]), "least": fit_text(row["least"]), "case": row["case"]}
        yield BatchMessage.FIT.said("plain", "cases", output=row["output"], **values)


def _spreads(summary: Summary) -> Iterator[Remark]:
    if summary.few and summary.most == 1:
        yield BatchMessage.ONE.said("plain", "distributions")
    elif summary.few:
        share = 100.0 / math.sqrt(2.0 * (summary.most - 1))
        yield BatchMessage.FEW.said("plain", "distributions", count=summary.most, share=share)
    several = "draw" not in summary.columns.repeats and "table" in summary.columns.repeats
    for row in summary.parameters.to_dict("records"):
        yield from _not_as_stated(row, tables=several)


def _not_as_stated(row: Row, *, tables: bool) -> Iterator[Remark]:
    """Yield the deviations of one parameter from its stated σ."""
    unit, doubts, name = _after(row["unit"]), row["doubts"], str(row["parameter"])
    spread, stated = (rounded(row[each], row[each]) + unit for each in ("spread", "stated_std"))
    values = {"name": name, "spread": spread, "stated": stated}

    def said(message: BatchMessage, **more: object) -> Remark:
        return message.said("doubt", "distributions", (name,), **more)

    if EstimateWarning.STD_TOO_SMALL in doubts:
        why = "what was measured differs, or the stated std is too small" if tables else "that is too small"
        among = "from table to table" if tables else "from case to case"
        yield said(BatchMessage.STD_TOO_SMALL, **values, ratio=row["ratio"], among=among, why=why)
    if EstimateWarning.STD_TOO_LARGE in doubts:
        yield said(BatchMessage.STD_TOO_LARGE, **values)
    if EstimateWarning.BIASED in doubts:
        size = f"{rounded(row['bias'], row['bias_std'])} ± {rounded(row['bias_std'], row['bias_std'])}{unit}"
        yield said(BatchMessage.BIASED, name=name, size=size, share=abs(row["bias"]) / row["stated_std"])
    if doubts and math.isfinite(row.get("coverage_lower", math.nan)):
        held, low, high = (100.0 * row[f"coverage{end}"] for end in ("", "_lower", "_upper"))
        yield said(BatchMessage.COVERAGE, name=name, held=held, low=low, high=high)


def _settings(summary: Summary) -> Iterator[Remark]:
    for name, times in summary.wide.items():
        yield BatchMessage.WIDE.said("plain", "over-1", (name,), name=name, times=times)
    if all(name == "table" for name in summary.settings):
        return
    dependences = {each.parameter: each for each in summary.dependences}
    for parameter, rows in summary.groups[summary.groups["cases"] > 0].groupby("parameter", sort=False):
        name = str(parameter)
        if name in dependences:
            yield _dependence(dependences[name])
        for doubt, what in IN_GROUPS.items():
            if count := sum(doubt in doubts for doubts in rows["doubts"]):
                values = {"name": name, "what": what, "count": count, "groups": len(rows)}
                yield BatchMessage.IN_GROUPS.said("doubt", "over-1", (name,), **values)


def _dependence(found: Dependence) -> Remark:
    ends = []
    for mean, at in ((found.low, found.at_low), (found.high, found.at_high)):
        where = ", ".join(f"{name.removeprefix('set.')} = {level_text(level)}" for name, level in at.items())
        ends.append(f"{rounded(mean, found.stated_std)}{_after(found.unit)} ({where})")
    share = (found.high - found.low) / found.stated_std if found.stated_std > 0 else math.nan
    times = f", {share:.2g} times its stated std" if share > 0 else ""
    name = found.parameter
    return BatchMessage.DEPENDS.said("doubt", "over-1", (name,), name=name, low=ends[0], high=ends[1], times=times)


def _ends(summary: Summary) -> Iterator[Remark]:
    optima = summary.optima
    if not len(optima):
        return
    total, best, sets = int(optima["cases"].sum()), int(optima["cases"].iloc[0]), int(optima["data_sets"].iloc[0])
    if len(optima) == 1:
        yield BatchMessage.ONE_OPTIMUM.said("plain", "starts", total=total, of=" of their data" if sets > 1 else "")
        return
    yield BatchMessage.OTHER_OPTIMA.said("plain", "starts", total=total, others=total - best)
    if summary.rivals:
        yield BatchMessage.RIVALS.said("doubt", "starts")


def _accuracy(summary: Summary) -> Iterator[Remark]:
    counts, total = summary.accuracy, sum(summary.accuracy.get(each.value, 0) for each in AccuracyOutcome)
    if not total:
        return
    yield BatchMessage.CHECKED.said(total=total, checked=counts["checked"])
    if counts["finer"]:
        yield BatchMessage.FINER.said(count=counts["finer"])
    for outcome, message in ACCURACY.items():
        if count := counts.get(outcome.value, 0):
            yield message.said("doubt", count=count)


def _after(unit: str) -> str:
    return f" {unit}" if has_unit(unit) else ""
