"""What charts show, read back from their layers."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmuid.reports.chart import Chart


def drawn(chart: Chart, mark: str, label: str | None = None) -> list[dict[str, Any]]:
    """Return the data of the layers of a kind, or of those with a label."""
    layers = [each for each in chart.layers if each.mark == mark and label in (None, each.label)]
    return [dict(each.data) for each in layers]


def entries(chart: Chart) -> list[str]:
    """Return the entries of the legend."""
    return list(dict.fromkeys(each.label for each in chart.layers if each.label))


def rules(chart: Chart, side: str = "y") -> list[float]:
    """Return where lines go across, from the axis of a side."""
    return [float(each) for data in drawn(chart, "rule") for each in np.atleast_1d(data.get(side, []))]
