"""Charts as a test reads them: the data of layers, and the legend."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmuid.reports.chart import Chart


def layers(chart: Chart, mark: str) -> list[dict[str, Any]]:
    """Return the data of all layers of a mark."""
    return [dict(each.data) for each in chart.layers if each.mark == mark]


def legend(chart: Chart) -> list[str]:
    """Return the entries of the legend."""
    return list(dict.fromkeys(each.label for each in chart.layers if each.label))


def rules(chart: Chart) -> list[tuple[str, float]]:
    """Return the axis and the place of each line across."""
    return [(side, float(place)) for data in layers(chart, "rule") for side, place in data.items()]


def drawn(chart: Chart, mark: str, label: str | None = None) -> list[dict[str, Any]]:
    """Return the data of the layers of a mark, or of those with a label."""
    return [dict(each.data) for each in chart.layers if each.mark == mark and label in (None, each.label)]


def places(chart: Chart, side: str = "y") -> list[float]:
    """Return where lines go across, from the axis of a side."""
    return [float(each) for data in drawn(chart, "rule") for each in np.atleast_1d(data.get(side, []))]
