"""The part of a report that an identification makes up."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.assessment import CONFIDENCE_LEVEL
from fmuid.estimation import Result
from fmuid.reports.interactive import estimates, fit, residuals, search, uncertainty
from fmuid.reports.interactive.style import MAX_EXPERIMENTS, MAX_OUTPUTS, MAX_PARAMETERS, Units, named
from fmuid.reports.page import preparation
from fmuid.reports.page.contents import Identification
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.verdict import identification_words
from fmuid.reports.words.accuracy import shift_text
from fmuid.text import has_unit, rounded, with_std

CAPTIONS = {
    "fit": "Dots were measured, the line is simulated with the estimates, the residual is below. A good residual is "
    "noise without a pattern. What does not count is grey. Drag to enlarge a stretch; all outputs follow.",
    "residuals": "Left: the residual's distribution should follow the normal curve. Middle: its autocorrelation should "
    "stay in the band; else the model or the noise has dynamics of its own and the intervals are not as stated. Right: "
    "outside the band, the residual depends on an input, which the model does not take up rightly.",
    "search": "Parameters should come to rest in the blue band, the interval of the estimate; the prior's ± 2 std is "
    "amber, the circle is the start. The criterion falls with each accepted step; rejected trials are crosses.",
    "belief": "What the prior said, what the data say alone, and both. Prior and data should overlap; where the data's "
    "curve is wide or missing, the estimate rests on the prior.",
    "parabolas": "The criterion of what the prior says, of what the data say, and of both, over each parameter with a "
    "prior: the narrower parabola decides where the estimate lies. Where both stands high above zero at its least, "
    "prior and data contradict each other.",
    "correlation": "Near ±1 two estimates are hardly told apart: their intervals (dashed) do not hold one by one, the "
    "ellipse does. Shown are the pairs that are correlated most.",
    "accuracy": "Each estimate's shift if the finer simulation took the place of the one used, in its standard "
    "deviations. In the band it spoils no interval.",
    "uncertainty": "Profiles: where the curve leaves the dashed parabola, the ± std are not the whole truth; the band "
    "is the interval. Samples: contours hold 68 % and 95 %, red is the local approximation. Maps: the darker, the "
    "better the fit.",
    "optima": "Where the searches from points of the whole box ended; the larger a point, the more of them. Several "
    "low points apart from each other: the data do not tell which is true.",
}
"""How to read each section."""


def part(folder: Path) -> Part:
    """Return the part of a report on the identification in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    found = Identification.read(folder)
    result = found.result
    said = identification_words(found.content, result, found.fits)
    sections = [
        *_fits(found),
        *preparation.sections(found),
        *_residuals(found),
        *_search(found),
        *_belief(found),
        *_correlation(found),
        *_accuracy(found),
        *_uncertainty(found),
    ]
    state = "converged" if result.converged else result.outcome.value.replace("_", " ")
    more = found.content.get("uncertainty") or {}
    good = result.converged and bool(more.get("succeeded", True))
    rows = {f"model {each['name']}": f"SHA-256 {each['digest']}" for each in result.models.values()}
    end = origin(found.content, rows | {"search": _search_words(result)})
    shown = [each for each in sections if each.figures]
    return Part("Identification", state, good, said, estimates_table(result, found.units, found.level), shown, end)


def estimates_table(result: Result, units: Units, level: float = CONFIDENCE_LEVEL) -> str:
    """Return the table of the estimates, as HTML.

    Parameters
    ----------
    result : Result
    units : mapping of str to str
        Of the parameters.
    level : float
        Of the intervals.
    """
    ends = result.intervals(level)
    rows = zip(result.names, result.values.tolist(), result.std.tolist(), strict=True)
    columns: dict[str, list[str]] = {key: [] for key in ("parameter", "value", "unit", "relative std", "interval")}
    for i, (name, value, std) in enumerate(rows):
        unit = units.get(name)
        columns["parameter"].append(name)
        columns["value"].append("not determined" if math.isinf(std) else with_std(value, std))
        columns["unit"].append(str(unit) if has_unit(unit) else "")
        columns["relative std"].append(f"{100 * std / abs(value):.2g} %" if value and math.isfinite(std) else "")
        low, high = (rounded(float(end), std) for end in ends.iloc[i])
        columns["interval"].append(f"{low} to {high}" if math.isfinite(std) else "")
    columns[f"{100 * level:g} % interval"] = columns.pop("interval")
    if np.isfinite(result.prior_mean).any():
        pairs = zip(result.prior_mean.tolist(), result.prior_std.tolist(), strict=True)
        columns["prior"] = [with_std(mean, std) if math.isfinite(mean) else "" for mean, std in pairs]
    if result.accuracy is not None:
        columns["solver's shift (std)"] = [shift_text(shift) for shift in result.numerical_shift.tolist()]
    columns["start"] = [f"{start:.6g}" for start in result.start.tolist()]
    return table(columns, numbers=[name for name in columns if name not in ("parameter", "unit")])


def _fits(found: Identification) -> list[Section]:
    shown = fit.worst(found.fits)
    caption, sections = CAPTIONS["fit"], []
    if len(shown) < len(found.fits):
        caption += f" Of {len(found.fits)} experiments the {MAX_EXPERIMENTS} that fit worst are drawn."
    if any(len(record.outputs) > MAX_OUTPUTS for record in shown):
        caption += f" Of more than {MAX_OUTPUTS} outputs those that fit worst are drawn."
    for k, record in enumerate(shown):
        heading = "Measured and simulated" + (f": {record.experiment}" if len(found.fits) > 1 else "")
        name = "fit" if k == 0 else f"fit-{k + 1}"
        sections.append(Section(name, heading, caption if k == 0 else "", [fit.fit(record)], 1))
    return sections


def _residuals(found: Identification) -> list[Section]:
    if "correlations" not in found.tables:
        return []
    shown, figures = found.tables["correlations"], []
    for record in fit.worst(found.fits):
        for j, output in list(enumerate(record.outputs))[:MAX_OUTPUTS]:
            rows = shown[(shown["experiment"] == record.experiment) & (shown["output"] == output)]
            if not len(rows):
                continue
            values = np.where(record.counted[:, j], record.measured[:, j] - record.simulated[:, j], np.nan)
            own, others = rows[rows["with"] == output], rows[rows["with"] != output]
            figures += [residuals.histogram(values, output), residuals.autocorrelation(own, output)]
            figures += [residuals.with_inputs(others, output)] if len(others) else []
    return [Section("residuals", "Residuals", CAPTIONS["residuals"], figures)]


def _search(found: Identification) -> list[Section]:
    tables, figures = found.tables, []
    if "trace" in tables and "estimates" in tables and len(tables["trace"]):
        figures = [*search.parameters(tables["trace"], tables["estimates"]), *search.criterion(tables["trace"])]
        figures += search.rounds(tables["rounds"], found.output_units) if len(tables.get("rounds", ())) > 1 else []
    sections = [Section("search", "The search", CAPTIONS["search"], figures)]
    if len(tables.get("optima", ())):
        drawn = search.optima(tables["optima"], found.units)
        sections.append(Section("optima", "Optima found", CAPTIONS["optima"], drawn))
    return sections


def _belief(found: Identification) -> list[Section]:
    reading = found.tables.get("reading", pd.DataFrame())
    figures = estimates.belief(reading, found.units) if len(reading) else []
    parts = estimates.parabolas(reading, units=found.units) if len(reading) else []
    return [
        Section("belief", "Prior, data, and both", CAPTIONS["belief"], figures),
        Section("parabolas", "The criterion of prior, data, and both", CAPTIONS["parabolas"], parts),
    ]


def _correlation(found: Identification) -> list[Section]:
    result = found.result
    if len(result.names) < 2 or not np.isfinite(result.std).any():
        return []
    figures = [estimates.correlation(result.correlation), *estimates.ellipses(result, found.units, found.level)]
    return [Section("correlation", "Correlation of the estimates", CAPTIONS["correlation"], figures)]


def _accuracy(found: Identification) -> list[Section]:
    table = found.tables.get("estimates", pd.DataFrame())
    if not len(table) or not np.isfinite(table["numerical_shift"].astype(float)).any():
        return []
    return [Section("accuracy", "Error of the simulation", CAPTIONS["accuracy"], [estimates.accuracy(table)], 1)]


def _uncertainty(found: Identification) -> list[Section]:
    tables = found.tables
    first = [*_profiles(found), *(uncertainty.criterion_map(chart, found.units) for chart in found.maps)]
    sections = [Section("uncertainty", "Profiles and maps", CAPTIONS["uncertainty"], first, 2)]
    if "posterior" in tables:
        drawn = [uncertainty.corner(tables["posterior"], found.result, found.units)]
        name = "posterior" if first else "uncertainty"
        sections.append(Section(name, "Samples of the posterior", "" if first else CAPTIONS["uncertainty"], drawn, 1))
    return sections


def _profiles(found: Identification) -> list[object]:
    points, given = found.tables.get("profiles", pd.DataFrame()), found.content.get("profiles") or {}
    drawn: list[object] = []
    for name, each in list(given.items())[:MAX_PARAMETERS]:
        rows = points[points["profiled"] == name]
        if not len(rows) or each.get("threshold") is None:
            continue
        ends = {"lower": _end(each["lower"], -math.inf), "upper": _end(each["upper"], math.inf)}
        i = found.result.names.index(name)
        estimate = (float(found.result.values[i]), float(found.result.std[i]))
        curve = rows.rename(columns={name: "value"})[["value", "criterion"]]
        limits = ends | {"threshold": float(each["threshold"])}
        drawn.append(uncertainty.profile(curve, limits, estimate, named(name, found.units), float(each["level"])))
    return drawn


def _end(value: float | None, open_: float) -> float:
    return open_ if value is None else float(value)


def _search_words(result: Result) -> str:
    likelihood = f", log-likelihood {result.log_likelihood:.7g}" if math.isfinite(result.log_likelihood) else ""
    return (
        f"{result.iterations} iterations, {result.simulations} simulations, {result.elapsed_s:.2f} s; criterion "
        f"{result.criterion:.6g}{likelihood}"
    )
