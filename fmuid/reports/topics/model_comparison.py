"""Model comparison by likelihood and on common data files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.formatting import fit_text, label, listed
from fmuid.identification import ModelComparison
from fmuid.reports.chart import LIMITS, Axis, Chart, Data, intervals, kinds, rows_of
from fmuid.reports.document import Document, Message, Remark, Section, Table, Tone, doubt, origin_of, plain, table_of
from fmuid.runs import ComparedEstimate, ComparisonRun

ALIKE_AIC = 2.0  # models with a smaller difference of AIC are equally good (Burnham and Anderson, section 2.6)
CLEAR_AIC = 10.0  # a larger difference of AIC is clear (same source)
BEHIND = "AIC of each result minus the lowest AIC. Differences below 2 are small, above 10 clear."
ERRORS = "100 % − fit of each result on the common data files. Shorter is better."
ESTIMATES = "Estimates that several results have, with 95 % intervals. The intervals should overlap."


class ComparisonMessage(Message, section="likelihood"):
    """Result that the data prefer."""

    APART = doubt("{reason}")
    ALIKE = plain("{names} are equally good (AIC differs by less than {limit:g}).", remedy="Prefer the simplest model.")
    BEST = plain("{best} is best by AIC, not clearly: {second} is {behind:.3g} higher.")
    CLEARLY_BEST = plain("{best} is clearly best by AIC: {second} is {behind:.3g} higher.")
    BY_BIC = plain("BIC prefers {best}.")
    REJECTED = plain("{smaller} is rejected against {larger}: it needs {freed} (p = {chance}).")
    NOT_REJECTED = plain("{smaller} is not rejected against {larger}: {freed} not needed (p = {chance}).")
    COLORED = plain(
        "Residuals are colored: {samples} samples count as {worth:.0f} (log-likelihoods divided by {dependence:.3g})."
    )
    PRIORS = plain("AIC and BIC of {names} are too high: they use priors.", remedy="Compare on a common data file.")
    NO_FIT = plain("Common data: fit undefined for constant outputs.", remedy="Compare the RMSE.")
    AS_GOOD = plain("Common data: {names} equally good (fit {most} for {best}; {others}).")
    BEST_FIT = plain("Common data: {best} is best (fit {most}; {others}).")


def comparison_document(found: ComparisonRun) -> Document:
    """Return the document of a comparison of results."""
    rows = found.table
    fits = dict(zip(rows["name"], rows["fit"].tolist(), strict=True)) if "fit" in rows else {}
    sections = [Section("results", "Results", table=_table(found))]
    for key, heading, caption, column, text in (
        ("likelihood", "By likelihood", BEHIND, "behind", "AIC above the lowest"),
        ("errors", "On common data", ERRORS, "error", "100 % − fit (%)"),
    ):
        values = 100.0 - rows["fit"] if column == "error" and fits else rows.get(column)
        if values is not None and values.notna().any():
            order = values.sort_values().index
            chart = ranked_bars([str(rows["name"][k]) for k in order], values[order].to_numpy(np.float64), text)
            sections.append(Section(key, heading, caption, charts=(chart,), beside=1))
    drawn = estimate_charts(found.estimates)
    sections += [Section("estimates", "Estimates", ESTIMATES, charts=tuple(drawn))] if drawn else []
    ordered = rows.sort_values("behind") if "behind" in rows else rows.sort_values("fit", ascending=False)
    alike = float(ordered["behind"].iloc[1]) < ALIKE_AIC if "behind" in rows else rows["fit"].isna().all()
    state = "equally good" if alike else f"best: {ordered['name'].iloc[0]}"
    said = [ComparisonMessage.APART.said("", reason=found.apart)] if found.apart else []
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
        said = [ComparisonMessage.ALIKE.said(names=names, limit=ALIKE_AIC)]
    else:
        second, behind = rest[0].name, rest[0].behind
        how = ComparisonMessage.CLEARLY_BEST if behind >= CLEAR_AIC else ComparisonMessage.BEST
        said = [how.said(best=best.name, second=second, behind=behind)]
    by_bic = min(found.ranks, key=lambda rank: rank.corrected_bic)
    if by_bic is not best:
        said.append(ComparisonMessage.BY_BIC.said(best=by_bic.name))
    for test in found.tests:
        tiny = test.probability < 1e-6
        how = ComparisonMessage.REJECTED if test.probability < 0.01 else ComparisonMessage.NOT_REJECTED
        values = {"smaller": test.smaller, "larger": test.larger, "freed": listed(test.freed)}
        chance = "below 1e-6" if tiny else f"{test.probability:.2g}"
        said.append(how.said(**values, chance=chance))
    if found.dependence > 1.25:  # a smaller factor changes no verdict
        worth: dict[str, Any] = {"samples": found.samples, "worth": found.samples / found.dependence}
        said.append(ComparisonMessage.COLORED.said(**worth, dependence=found.dependence))
    if found.with_priors:
        said.append(ComparisonMessage.PRIORS.said(names=listed(found.with_priors)))
    return said


def _by_fit(fits: Mapping[str, float]) -> Remark:
    if not any(map(math.isfinite, fits.values())):
        return ComparisonMessage.NO_FIT.said("errors")
    order = sorted(fits, key=lambda name: -fits[name] if math.isfinite(fits[name]) else math.inf)
    best, rest = order[0], order[1:]
    near = [name for name in rest if 100.0 - fits[name] <= 1.05 * (100.0 - fits[best])]
    others = listed([f"{fit_text(fits[name])} ({name})" for name in rest])
    values = {"best": best, "most": fit_text(fits[best]), "others": others}
    if near:
        return ComparisonMessage.AS_GOOD.said("errors", names=listed([best, *near]), **values)
    return ComparisonMessage.BEST_FIT.said("errors", **values)


def _table(found: ComparisonRun) -> Table:
    frame = found.table
    heads = {"name": "result", "parameters": "k", "log_likelihood": "log-likelihood", "aic": "AIC", "bic": "BIC"}
    heads |= {"corrected_aic": "corrected AIC", "corrected_bic": "corrected BIC", "behind": "AIC above lowest"}
    heads |= {f"rmse.{output}": label(f"RMSE {output}", unit) for output, unit in found.units.items()}
    heads |= {"fit": "fit", "verdict": "verdict"}
    shown = [name for name in heads if name in frame]
    columns = {heads[name]: [_cell(name, each) for each in frame[name].tolist()] for name in shown}
    return table_of(columns, ranks=("AIC", "BIC"))


def _cell(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value).replace("_", " ").upper() if name == "verdict" else str(value)
    if name == "fit":
        return fit_text(value)
    return f"{value:.4g}" if name.startswith("rmse.") else f"{value:.1f}"


def ranked_bars(names: Sequence[str], values: Floats, text: str) -> Chart:
    """Return a bar per name in their order, the first red."""
    names, values = names[: LIMITS.parameters], values[: LIMITS.parameters]
    best = np.arange(len(names)) == 0
    data: Data = {"y": tuple(names), "x": values}
    layers = kinds("bars", data, [("", "red", best), ("", "blue", ~best)], hover=(("", "@y"), ("value", "@x{0.0000}")))
    return rows_of(names, Axis(text, reach=(0.0, None)), layers)


def estimate_charts(rows: Sequence[ComparedEstimate]) -> list[Chart]:
    """Return the estimates of each parameter that several results have."""
    units = {each.parameter: each.unit for each in reversed(rows) if each.unit}
    groups: dict[tuple[str, str], list[ComparedEstimate]] = {}
    for each in rows:
        groups.setdefault((each.parameter, each.unit or units.get(each.parameter, "")), []).append(each)
    charts = []
    for (name, unit), mine in list(groups.items())[: LIMITS.parameters]:
        if len(mine) > 1:
            names = tuple(str(each.result) for each in mine)
            found = np.array([[each.value, each.lower, each.upper] for each in mine], dtype=np.float64).T
            value, low, high = np.where(np.isfinite(found), found, np.nan)
            charts.append(rows_of(names, Axis(label(name, unit)), intervals(names, value, low, high), head=90))
    return charts
