"""Messages and sections of a batch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from fmuid.estimation import AccuracyOutcome
from fmuid.formatting import fit_text, has_unit, rounded
from fmuid.reports.document import Document, Message, Remark, Section, Tone, doubt, origin_of, plain
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
    tests_cases,
)
from fmuid.studies import Study

Row = Mapping[Any, Any]

CASES = (
    "Estimates of the converged cases, with their intervals if there are few cases. Darker cells: more estimates. "
    "Amber line: true value. Marks at the lower edge: cases without estimate."
)
DISTRIBUTIONS = (
    "Distribution of the estimates. Curve: normal distribution of the stated σ. Bars wider than the curve: σ too "
    "small. Bars beside the amber line (true value): bias."
)
SPREAD = "Band: spread of the estimates if the stated σ is right. Right of it: σ too small."
SETTING = (
    "Dots: cases. Red: mean and spread of the cases; dashes: spread of the stated σ. A mean that changes with the "
    "setting depends on it."
)
STARTS = (
    "Cost above the best of each case, in order, and estimate over initial guess. Red: other optima than the best. "
    "A level line: all initial guesses lead to one optimum."
)
FAILURES = "Reasons for missing estimates. Red: failed. Amber: not converged."


class BatchMessage(Message):
    """Statistics of a batch."""

    LEFT_OUT = plain("{done} of {total} cases converged; the statistics omit {others}.")
    BEST_OF_STARTS = plain("Statistics use the best of all starting points for each of {sets} data sets.")
    FIT = plain(
        "Fit of {output}: median {median}, minimum {least} (case {case}).",
        remedy="Inspect the case with the lowest fit.",
    )
    ONE = plain("One estimate has no spread: the stated σ is not checked.", remedy="Add realizations.")
    FEW = plain("{count} cases are few: their spread is uncertain by {share:.0f} %.", remedy="Add realizations.")
    STD_TOO_SMALL = doubt(
        "{name}: spread {spread} is {ratio:.3g} × the stated σ ({stated}) {among}.",
        "wrong noise, a strongly nonlinear problem, or different machines",
    )
    STD_TOO_LARGE = doubt("{name}: spread {spread} is below the stated σ ({stated}).")
    BIASED = doubt("{name}: biased by {size} ({share:.2g} × the stated σ).")
    COVERAGE = doubt("{name}: {held:.3g} % of the 95 % intervals contain the true value ({low:.3g} to {high:.3g} %).")
    WIDE = plain("{name} varies by {times:.2g} × its stated σ over the settings.")
    DEPENDS = doubt("{name} depends on the settings: mean {low} to {high}{times}.")
    IN_GROUPS = doubt("{name}: {what} in {count} of {groups} groups.")
    ONE_OPTIMUM = plain("All {total} converged cases found the same optimum{of}.")
    OTHER_OPTIMA = plain("{others} of {total} converged cases found another optimum than the best.")
    EQUAL_OPTIMA = doubt("Several optima fit equally well.", remedy="Narrow the bounds or add priors.")
    DOUBTFUL = doubt(
        "{count} of {total} cases ({share}) are DOUBTFUL: {reason}.", remedy="Identify such a case by itself."
    )
    NOT_TESTED = plain(
        "Residuals and model errors were not tested in the cases.",
        remedy='Set `estimation.model_error = "report"` to test model errors, too.',
    )
    CHECKED = plain("Solver error checked in {total} cases, in {checked} by new simulations.")
    REFINED = plain("Solver refined in {count} cases.")
    SHIFTED = doubt(
        "Solver error shifts estimates in {count} cases; σ includes it.",
        remedy="Reduce `step_size`, or use Model Exchange.",
    )
    UNKNOWN = doubt(
        "Solver error unknown in {count} cases: some σ are unknown.",
        remedy="Check the parameters that are not identifiable first.",
    )
    COUPLED = doubt(
        "{count} cases depend on the communication step.",
        remedy="Set `discrete_time` of the components to true or false.",
    )
    UNCHECKABLE = doubt(
        "Solver error unknown in {count} cases: no more accurate solver exists.",
        remedy="Export the FMU for Model Exchange.",
    )
    FAILED = doubt("Solver error unknown in {count} cases: the more accurate simulation fails.")


IN_GROUPS = {
    EstimateWarning.STD_TOO_SMALL: "stated σ too small",
    EstimateWarning.STD_TOO_LARGE: "stated σ too large",
    EstimateWarning.BIASED: "biased",
}


def batch_document(found: BatchResult, summary: Summary, frame: pd.DataFrame, study: Study) -> Document:
    """Return the document of a batch."""
    drawn = charts_of(frame, summary, found.truth, found.units, given_noise=found.given_noise)
    tone, state = state_of(summary)
    sections = (*tables_of(summary), *drawn)
    origin = origin_of(made_from(study), {"cases": state})
    said = summary_remarks(summary) + ([] if tests_cases(study) else [BatchMessage.NOT_TESTED.said()])
    return Document("batch", "Batch", state, tone, tuple(said), sections, **origin)


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
    sections = [Section("cases", "Estimates by case", CASES, charts=tuple(over), beside=2)]
    if len(found) > 1:
        drawn = charts.distributions(found, truth, units, repeated=is_repetition(found, columns))
        sections.append(Section("distributions", "Distributions", DISTRIBUTIONS, charts=tuple(drawn)))
    if len(summary.parameters) and np.isfinite(summary.parameters["ratio"].astype(float)).any():
        ratio = charts.spread(summary.parameters)
        sections.append(Section("spread", "Spread and stated σ", SPREAD, charts=(ratio,), beside=1))
    tables = ("table",) if "table" in columns.repeats else ()
    settings = [name for name in (*columns.design, *tables) if len(found[name].unique()) > 1]
    for k, name in enumerate(settings):
        drawn = charts.over_setting(found, name, truth, units)
        heading = f"Over {name.removeprefix('set.')}"
        sections.append(Section(f"over-{k + 1}", heading, SETTING if k == 0 else "", charts=tuple(drawn)))
    if columns.starts:
        drawn = charts.over_starts(frame, truth, units, given_noise=given_noise)
        sections.append(Section("starts", "Starting points", STARTS, charts=tuple(drawn)))
    if len(summary.failures):
        bars = charts.failures(summary.failures, failure_texts(summary.failures))
        sections.append(Section("failures", "Cases without estimate", FAILURES, charts=(bars,), beside=1))
    return [each for each in sections if each.charts]


def summary_remarks(summary: Summary) -> list[Remark]:
    """Return the remarks on the statistics of a batch."""
    parts = _counts, _spreads, _settings, _ends, _accuracy, _doubts
    return [said for part in parts for said in part(summary)]


def _doubts(summary: Summary) -> Iterator[Remark]:
    total = int(summary.statuses["cases"].iloc[0])
    for reason, count in summary.reasons.items():
        words = reason.replace("_", " ")
        share = f"{100 * count / total:.3g} %"
        yield BatchMessage.DOUBTFUL.said("cases", count=count, total=total, share=share, reason=words)


def _counts(summary: Summary) -> Iterator[Remark]:
    done, *others = summary.statuses["cases"].tolist()
    if sum(others):
        kinds = [f"{n} {word}" for n, word in zip(others, ("did not converge", "failed"), strict=True) if n]
        total = done + sum(others)
        yield BatchMessage.LEFT_OUT.said("failures", done=done, total=total, others=" and ".join(kinds))
    if summary.columns.starts and done > summary.data_sets:
        yield BatchMessage.BEST_OF_STARTS.said("starts", sets=summary.data_sets)
    for row in summary.fits.to_dict("records"):
        values = {"median": fit_text(row["median"]), "least": fit_text(row["least"]), "case": row["case"]}
        yield BatchMessage.FIT.said("cases", output=row["output"], **values)


def _spreads(summary: Summary) -> Iterator[Remark]:
    if summary.few and summary.most == 1:
        yield BatchMessage.ONE.said("distributions")
    elif summary.few:
        share = 100.0 / math.sqrt(2.0 * (summary.most - 1))
        yield BatchMessage.FEW.said("distributions", count=summary.most, share=share)
    several = "draw" not in summary.columns.repeats and "table" in summary.columns.repeats
    for row in summary.parameters.to_dict("records"):
        yield from _not_as_stated(row, tables=several)


def _not_as_stated(row: Row, *, tables: bool) -> Iterator[Remark]:
    """Yield the deviations of one parameter from its stated σ."""
    unit, doubts, said = _after(row["unit"]), row["doubts"], []
    spread, stated = (rounded(row[each], row[each]) + unit for each in ("spread", "stated_std"))
    values: dict[str, object] = {"name": str(row["parameter"]), "spread": spread, "stated": stated}
    if EstimateWarning.STD_TOO_SMALL in doubts:
        values |= {"ratio": row["ratio"], "among": "across data files" if tables else "across cases"}
        said.append(BatchMessage.STD_TOO_SMALL)
    if EstimateWarning.STD_TOO_LARGE in doubts:
        said.append(BatchMessage.STD_TOO_LARGE)
    if EstimateWarning.BIASED in doubts:
        bias, error = (rounded(row[each], row["bias_std"]) for each in ("bias", "bias_std"))
        values["size"] = f"{bias} ± {error}{unit}"
        values["share"] = abs(row["bias"]) / row["stated_std"]
        said.append(BatchMessage.BIASED)
    if doubts and math.isfinite(row.get("coverage_lower", math.nan)):
        ends = {"held": "coverage", "low": "coverage_lower", "high": "coverage_upper"}
        values |= {key: 100.0 * row[column] for key, column in ends.items()}
        said.append(BatchMessage.COVERAGE)
    yield from (each.said("distributions", **values) for each in said)


def _settings(summary: Summary) -> Iterator[Remark]:
    for name, times in summary.wide.items():
        yield BatchMessage.WIDE.said("over-1", name=name, times=times)
    if all(name == "table" for name in summary.settings):
        return
    dependences = {each.parameter: each for each in summary.dependences}
    for parameter, rows in summary.groups[summary.groups["cases"] > 0].groupby("parameter", sort=False):
        name = str(parameter)
        if name in dependences:
            yield _dependence(dependences[name])
        for warning, what in IN_GROUPS.items():
            if count := sum(warning in doubts for doubts in rows["doubts"]):
                values = {"name": name, "what": what, "count": count, "groups": len(rows)}
                yield BatchMessage.IN_GROUPS.said("over-1", **values)


def _dependence(found: Dependence) -> Remark:
    ends = []
    for mean, at in ((found.low, found.at_low), (found.high, found.at_high)):
        where = ", ".join(f"{name.removeprefix('set.')} = {level_text(level)}" for name, level in at.items())
        ends.append(f"{rounded(mean, found.stated_std)}{_after(found.unit)} ({where})")
    share = (found.high - found.low) / found.stated_std if found.stated_std > 0 else math.nan
    times = f", {share:.2g} σ apart" if share > 0 else ""
    name = found.parameter
    return BatchMessage.DEPENDS.said("over-1", name=name, low=ends[0], high=ends[1], times=times)


def _ends(summary: Summary) -> Iterator[Remark]:
    if not len(optima := summary.optima):
        return
    total, best = int(optima["cases"].sum()), int(optima["cases"].iloc[0])
    if len(optima) == 1:
        of = " of their data" if optima["data_sets"].iloc[0] > 1 else ""
        yield BatchMessage.ONE_OPTIMUM.said("starts", total=total, of=of)
        return
    yield BatchMessage.OTHER_OPTIMA.said("starts", total=total, others=total - best)
    if summary.rivals:
        yield BatchMessage.EQUAL_OPTIMA.said("starts")


def _accuracy(summary: Summary) -> Iterator[Remark]:
    counts, total = summary.accuracy, sum(summary.accuracy.get(each.value, 0) for each in AccuracyOutcome)
    if not total:
        return
    yield BatchMessage.CHECKED.said(total=total, checked=counts["checked"])
    if counts["finer"]:
        yield BatchMessage.REFINED.said(count=counts["finer"])
    for outcome in AccuracyOutcome:
        if outcome.name in BatchMessage.__members__ and (count := counts.get(outcome.value, 0)):
            yield BatchMessage[outcome.name].said(count=count)


def _after(unit: str) -> str:
    return f" {unit}" if has_unit(unit) else ""
