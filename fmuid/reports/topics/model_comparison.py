"""Model comparison by likelihood and on common data files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.formatting import fit_text, label, listed
from fmuid.identification import ModelComparison
from fmuid.reports.chart import LIMITS, Axis, Chart, Data, Layer, intervals, picked, rows_of
from fmuid.reports.document import Document, Message, Remark, Section, Table, Tone, origin_of, table_of
from fmuid.runs import ComparedEstimate, ComparisonRun

ALIKE_AIC, CLEAR_AIC = 2.0, 10.0
"""Criteria of Akaike's that differ by less than the first are as good as each other, by more than the second they tell
clearly (Burnham and Anderson, section 2.6)."""
SIGNIFICANT = 0.01
"""A smaller model that chance rejects this rarely is rejected."""
DEPENDENT = 1.25
"""Samples that depend on each other more than this make what takes them for independent too sure."""
AS_NEAR = 0.05
"""Errors, 100 % − fit, that differ by less than this share do not tell results apart."""
MOST_RESULTS = 24
"""Bars of a figure; more make one that nobody reads."""
BESIDE = "How far each result is behind the best, of which a bar is missing: 2 say little, 10 are clear."
ERRORS = "What the fit of each result over the common tables is below 100 %: the shorter, the better."
ESTIMATES = "What the results say of the parameters that several have, with intervals of 95 %: they should overlap."


class ComparisonMessage(Message):
    """Which of several results the data prefer."""

    APART = ("{reason}", "likelihoods are of the same data alone")
    ALIKE = (
        "The data do not tell {names} apart (Akaike's criterion differs by less than {limit:g}): prefer the simplest",
        "they explain the record alike",
    )
    BEST = (
        "{best} is the best, not clearly, by Akaike's criterion: {second} is {behind:.3g} behind",
        "less than ten behind is not clear",
    )
    CLEARLY_BEST = (
        "{best} is clearly the best by Akaike's criterion: {second} is {behind:.3g} behind",
        "ten and more behind is clear",
    )
    BY_BIC = ("Schwarz's criterion, which charges more for parameters, prefers {best}", "the larger model gains little")
    REJECTED = (
        "{smaller} is rejected against {larger}: were it right, freeing {freed} would gain as much with a probability "
        "of {chance}",
        "the smaller model is too small",
    )
    NOT_REJECTED = (
        "{smaller} is not rejected against {larger}: freeing {freed} gains no more than chance would (probability "
        "{chance})",
        "the smaller model does",
    )
    COLOURED = (
        "The residuals are coloured: {samples} samples are worth {worth:.0f} independent ones, and log-likelihoods are "
        "divided by {dependence:.3g} for that; the uncorrected criteria would be too sure",
        "the plain criteria would be too sure",
    )
    PRIORS = (
        "Priors cost {names} likelihood: a criterion with priors is too large",
        "likelihoods are of the data alone",
        "do not compare by criteria; by a common table",
    )
    NO_FIT = ("On the common tables no fit has a meaning: compare the RMSE", "all measured outputs are constant there")
    AS_GOOD = (
        "On the common tables {names} do as well as each other: a fit of {most} ({best}) and {others}",
        "what counts, if the table is of the kind that matters",
    )
    BEST_FIT = (
        "On the common tables {best} is the best: a fit of {most} against {others}",
        "what counts, if the table is of the kind that matters",
    )


def comparison_document(found: ComparisonRun) -> Document:
    """Return the document of a comparison of results."""
    rows = found.table
    fits = dict(zip(rows["name"], rows["fit"].tolist(), strict=True)) if "fit" in rows else {}
    sections = [Section("results", "Results beside each other", table=_table(found))]
    for key, heading, caption, column, text in (
        ("criteria", "By likelihood", BESIDE, "behind", "behind the best, Akaike's criterion"),
        ("errors", "On the common tables", ERRORS, "error", "100 % − fit (%)"),
    ):
        values = 100.0 - rows["fit"] if column == "error" and fits else rows.get(column)
        if values is not None and values.notna().any():
            order = values.sort_values().index
            chart = ranked_bars([str(rows["name"][k]) for k in order], values[order].to_numpy(np.float64), text)
            sections.append(Section(key, heading, caption, charts=(chart,), beside=1))
    drawn = estimate_charts(found.estimates)
    sections += [Section("estimates", "Estimates beside each other", ESTIMATES, charts=tuple(drawn))] if drawn else []
    ordered = rows.sort_values("behind") if "behind" in rows else rows.sort_values("fit", ascending=False)
    alike = float(ordered["behind"].iloc[1]) < ALIKE_AIC if "behind" in rows else rows["fit"].isna().all()
    state = "not told apart" if alike else f"best: {ordered['name'].iloc[0]}"
    said = [ComparisonMessage.APART.said("doubt", "", rows["name"].tolist(), reason=found.apart)] if found.apart else []
    said += comparison_remarks(found.comparison, fits)
    tone: Tone = "doubt" if alike else "good"
    return Document("comparison", "Comparison", state, tone, tuple(said), tuple(sections), **origin_of(found.origin))


def comparison_remarks(found: ModelComparison | None, fits: Mapping[str, float]) -> list[Remark]:
    """Return the remarks by likelihood and by `fits` (%)."""
    return [*([] if found is None else _by_likelihood(found)), *([_by_fit(fits)] if fits else [])]


def _by_likelihood(found: ModelComparison) -> list[Remark]:
    best, *rest = found.ranks
    near = [rank.name for rank in rest if rank.behind < ALIKE_AIC]
    if near:
        names = listed([best.name, *near])
        said = [ComparisonMessage.ALIKE.said("plain", "criteria", names=names, limit=ALIKE_AIC)]
    else:
        second, behind = rest[0].name, rest[0].behind
        how = ComparisonMessage.CLEARLY_BEST if behind >= CLEAR_AIC else ComparisonMessage.BEST
        said = [how.said("plain", "criteria", (best.name,), best=best.name, second=second, behind=behind)]
    by_bic = min(found.ranks, key=lambda rank: rank.corrected_bic)
    if by_bic is not best:
        said.append(ComparisonMessage.BY_BIC.said("plain", "criteria", best=by_bic.name))
    for test in found.tests:
        tiny = test.probability < 1e-6
        how = ComparisonMessage.REJECTED if test.probability < SIGNIFICANT else ComparisonMessage.NOT_REJECTED
        values = {"smaller": test.smaller, "larger": test.larger, "freed": listed(test.freed)}
        chance = "less than 1e-6" if tiny else f"{test.probability:.2g}"
        said.append(how.said("plain", "criteria", (test.smaller,), **values, chance=chance))
    if found.dependence > DEPENDENT:
        worth: dict[str, Any] = {"samples": found.samples, "worth": found.samples / found.dependence}
        said.append(ComparisonMessage.COLOURED.said("plain", "criteria", **worth, dependence=found.dependence))
    if found.with_priors:
        said.append(ComparisonMessage.PRIORS.said("plain", "criteria", names=listed(found.with_priors)))
    return said


def _by_fit(fits: Mapping[str, float]) -> Remark:
    if not any(map(math.isfinite, fits.values())):
        return ComparisonMessage.NO_FIT.said("plain", "errors")
    order = sorted(fits, key=lambda name: -fits[name] if math.isfinite(fits[name]) else math.inf)
    best, rest = order[0], order[1:]
    near = [name for name in rest if 100.0 - fits[name] <= (1.0 + AS_NEAR) * (100.0 - fits[best])]
    others = listed([f"{fit_text(fits[name])} ({name})" for name in rest])
    values = {"best": best, "most": fit_text(fits[best]), "others": others}
    if near:
        return ComparisonMessage.AS_GOOD.said("plain", "errors", names=listed([best, *near]), **values)
    return ComparisonMessage.BEST_FIT.said("plain", "errors", **values)


def _table(found: ComparisonRun) -> Table:
    frame = found.table
    heads = {"name": "result", "parameters": "k", "log_likelihood": "log-likelihood", "aic": "AIC", "bic": "BIC"}
    heads |= {"corrected_aic": "corrected AIC", "corrected_bic": "corrected BIC", "behind": "behind"}
    heads |= {f"rmse.{output}": label(f"RMSE {output}", unit) for output, unit in found.units.items()} | {"fit": "fit"}
    shown = [name for name in heads if name in frame]
    columns = {heads[name]: [_cell(name, each) for each in frame[name].tolist()] for name in shown}
    return table_of(columns, ranks=("AIC", "BIC"))


def _cell(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if name == "fit":
        return fit_text(value)
    return f"{value:.4g}" if name.startswith("rmse.") else f"{value:.1f}"


def ranked_bars(names: Sequence[str], values: Floats, text: str) -> Chart:
    """Return a bar per name in their order, the first red."""
    names, values = names[:MOST_RESULTS], values[:MOST_RESULTS]
    best = np.arange(len(names)) == 0
    data: Data = {"y": tuple(names), "x": values}
    hover = (("", "@y"), ("value", "@x{0.0000}"))
    layers = [Layer("bars", picked(data, best), "red", hover=hover)]
    layers += [Layer("bars", picked(data, ~best), hover=hover)] if len(names) > 1 else []
    return rows_of(names, Axis(text, reach=(0.0, None)), layers)


def estimate_charts(rows: Sequence[ComparedEstimate]) -> list[Chart]:
    """Return the estimates of each parameter that several results have."""
    known: dict[str, str] = {}
    for each in rows:
        if each.unit:
            known.setdefault(each.parameter, each.unit)
    groups: dict[tuple[str, str], list[ComparedEstimate]] = {}
    for each in rows:
        groups.setdefault((each.parameter, each.unit or known.get(each.parameter, "")), []).append(each)
    charts = []
    for (name, unit), mine in list(groups.items())[: LIMITS.parameters]:
        if len(mine) > 1:
            names = tuple(str(each.result) for each in mine)
            found = np.array([[each.value, each.lower, each.upper] for each in mine], dtype=np.float64).T
            value, low, high = np.where(np.isfinite(found), found, np.nan)
            charts.append(rows_of(names, Axis(label(name, unit)), intervals(names, value, low, high), head=90))
    return charts
