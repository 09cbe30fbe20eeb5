"""All figures of a run, by the names of their files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from fmuid.reports.figures import fit as figures_fit
from fmuid.reports.figures import residuals as figures_residuals
from fmuid.reports.figures import search as figures_search

if TYPE_CHECKING:
    from fmuid.reports.findings import Findings


def draw(found: Findings) -> dict[str, Figure]:
    """Draw what an identification found: the search, the fit, the residuals."""
    result = found.result
    figures = {
        "parameters": figures_search.parameters(result.trace, found.estimates),
        "criterion": figures_search.criterion(result.trace),
    }
    if len(result.rounds) > 1:
        figures["rounds"] = figures_search.rounds(result.rounds, found.output_units)
    if len(result.optima) > 1:
        figures["optima"] = figures_search.optima(found.optima, found.unit_of)
    figures |= figures_fit.fits(found.fits)
    return figures | figures_residuals.residuals(found.diagnostics, found.output_units)


def draw_uncertainty(found: Findings) -> dict[str, Figure]:
    """Draw what was found beyond the local covariance: maps, profiles, the posterior."""
    there = found.uncertainty
    if there is None:
        return {}
    from fmuid.reports.figures import criterion_map as figures_map
    from fmuid.reports.figures import uncertainty as figures_uncertainty

    optima = found.optima if found.result.optima else None
    figures = {
        name: figures_map.criterion_map(chart, optima, found.unit_of, level=found.level)
        for name, chart in found.maps().items()
    }
    if there.profiles:
        figures["profiles"] = figures_uncertainty.profiles(there.profiles, found.unit_of)
    if there.posterior is not None:
        figures["posterior"] = figures_uncertainty.corner(there.posterior, found.result, found.unit_of)
        figures["posterior-walkers"] = figures_uncertainty.traces(there.posterior, found.unit_of)
    return figures
