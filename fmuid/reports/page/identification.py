"""The part of a report that an identification makes up."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.estimation import Result
from fmuid.formatting import rounded, unit_text, with_std
from fmuid.identification import CONFIDENCE_LEVEL, CORRELATIONS
from fmuid.reports.interactive import estimates, search, uncertainty
from fmuid.reports.interactive.style import MAX_PARAMETERS, Units, named
from fmuid.reports.messages.accuracy import shift_text
from fmuid.reports.messages.result import effort_words
from fmuid.reports.page import preparation
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.fits import fit_sections, residual_section
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.verdict import identification_words
from fmuid.runs import IdentificationRun, read_identification

CAPTIONS = {
    "fit": "Dots were measured, the line is simulated with the estimates, the residual is below. A good residual is "
    "noise without a pattern. What does not count is grey. Drag to enlarge a stretch; all outputs follow.",
    "parameters": "They should come to rest in the blue band, the interval of the estimate; the prior's ± 2 std is "
    "amber, the circle is the start.",
    "criterion": "The criterion falls with each accepted step; rejected trials are crosses. It begins anew where the "
    "noise variances are estimated again.",
    "belief": "What the prior said, what the data say alone, and both. Prior and data should overlap; where the data's "
    "curve is wide or missing, the estimate rests on the prior.",
    "parabolas": "The criterion of what the prior says, of what the data say, and of both, over each parameter with a "
    "prior: the narrower parabola decides where the estimate lies. Where both stands high above zero at its least, "
    "prior and data contradict each other.",
    "correlation": "Near ±1 two estimates are hardly told apart: their intervals (dashed) do not hold one by one, the "
    "ellipse does. Shown are the pairs that are correlated most.",
    "accuracy": "Each estimate's shift if the finer simulation took the place of the one used, in its standard "
    "deviations. In the band it spoils no interval.",
    "profiles": "Where the curve leaves the dashed parabola, the ± std are not the whole truth; the band is the "
    "interval.",
    "maps": "The darker, the better the fit. Where the dashed line leaves the ellipse, the local covariance is not the "
    "whole truth.",
    "posterior": "Contours hold 68 % and 95 % of the samples; red is the local approximation.",
    "walkers": "A line a walker; what lies in the grey part takes no part in the samples. Paths that wander off "
    "together, or walkers that stay where they are, show that there is no convergence.",
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
    found = read_identification(folder)
    result = found.result
    state = "converged" if result.converged else result.outcome.value.replace("_", " ")
    end = origin(found.origin, {"search": effort_words(result)})
    head = estimates_table(result, found.unit_of, found.assessment.level)
    return Part("Identification", state, found.succeeded, identification_words(found), head, sections_of(found), end)


def sections_of(found: IdentificationRun) -> list[Section]:
    """Return the sections of a page on an identification."""
    none = pd.DataFrame(columns=CORRELATIONS)
    correlations = none if found.assessment.residuals is None else found.assessment.residuals.correlations
    sections = [
        *fit_sections("fit", "Measured and simulated", CAPTIONS["fit"], found.fits),
        *preparation.sections(found.prepared),
        residual_section(found.fits, correlations),
        *_search(found),
        *_belief(found),
        *_correlation(found),
        *_accuracy(found),
        *_uncertainty(found),
    ]
    return [each for each in sections if each.figures]


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
        columns["parameter"].append(name)
        columns["value"].append("not determined" if math.isinf(std) else with_std(value, std))
        columns["unit"].append(unit_text(units.get(name)))
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


def _search(found: IdentificationRun) -> list[Section]:
    result, sections = found.result, []
    if len(result.trace):
        drawn = search.parameters(result.trace, found.estimates)
        sections.append(Section("parameters", "Parameters during the search", CAPTIONS["parameters"], drawn))
        drawn = search.criterion(result.trace)
        drawn += search.rounds(result.rounds, found.output_units) if len(result.rounds) > 1 else []
        sections.append(Section("criterion", "The criterion during the search", CAPTIONS["criterion"], drawn))
    if result.optima:
        drawn = search.optima(found.optima, found.unit_of)
        sections.append(Section("optima", "Optima found", CAPTIONS["optima"], drawn))
    return sections


def _belief(found: IdentificationRun) -> list[Section]:
    if found.assessment.prior_and_data is None or not found.has_prior:
        return []
    reading = found.assessment.prior_and_data.table
    parts = estimates.parabolas(reading, units=found.unit_of)
    return [
        Section("belief", "Prior, data, and both", CAPTIONS["belief"], estimates.belief(reading, found.unit_of)),
        Section("parabolas", "The criterion of prior, data, and both", CAPTIONS["parabolas"], parts),
    ]


def _correlation(found: IdentificationRun) -> list[Section]:
    result = found.result
    if len(result.names) < 2 or not np.isfinite(result.std).any():
        return []
    figures = [
        estimates.correlation(result.correlation),
        *estimates.ellipses(result, found.unit_of, found.assessment.level),
    ]
    return [Section("correlation", "Correlation of the estimates", CAPTIONS["correlation"], figures)]


def _accuracy(found: IdentificationRun) -> list[Section]:
    if not np.isfinite(found.result.numerical_shift).any():
        return []
    drawn = [estimates.accuracy(found.estimates)]
    return [Section("accuracy", "Error of the simulation", CAPTIONS["accuracy"], drawn, 1)]


def _uncertainty(found: IdentificationRun) -> list[Section]:
    optima = found.optima if found.result.optima else None
    maps = [uncertainty.criterion_map(chart, found.unit_of, optima) for chart in found.assessment.maps]
    sections = [
        Section("profiles", "Profiles", CAPTIONS["profiles"], _profiles(found), 2),
        Section("maps", "The criterion over two parameters", CAPTIONS["maps"], maps, 2),
    ]
    posterior = found.assessment.posterior
    if posterior is not None:
        drawn = [uncertainty.corner(posterior.table, found.result, found.unit_of)]
        sections.append(Section("posterior", "Samples of the posterior", CAPTIONS["posterior"], drawn, 1))
        drawn = uncertainty.walkers(uncertainty.paths(posterior), found.unit_of)
        sections.append(Section("walkers", "Paths of the sampling", CAPTIONS["walkers"], drawn, 1))
    return sections


def _profiles(found: IdentificationRun) -> list[object]:
    drawn: list[object] = []
    for each in found.assessment.profiles[:MAX_PARAMETERS]:
        if not len(each.table) or math.isnan(each.threshold):
            continue
        i = found.result.names.index(each.name)
        estimate = (float(found.result.values[i]), float(found.result.std[i]))
        curve = each.table.rename(columns={each.name: "value"})[["value", "criterion"]]
        ends = {"lower": -math.inf if math.isnan(each.lower) else each.lower}
        ends |= {"upper": math.inf if math.isnan(each.upper) else each.upper, "threshold": each.threshold}
        drawn.append(uncertainty.profile(curve, ends, estimate, named(each.name, found.unit_of), each.level))
    return drawn
