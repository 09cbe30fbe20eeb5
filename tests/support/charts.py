"""Charts as a test reads them: the data of layers, and the legend."""

import math
from typing import Any

import numpy as np

from fmuid.reports.chart import Axis, Chart, ChartGrid, Layer, Shades, rows_of, stacked

EVIL = '</script><script>alert(1)</script><img src=x onerror=alert(2)> & "quoted" $$x$$'
"""A name that is markup and mathematics."""


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


def labels(chart: Chart) -> tuple[str, str]:
    """Return the labels of both axes."""
    return chart.x.label, chart.y.label


def area_of(data: dict[str, Any]) -> float:
    """Return the area of bars."""
    return float(np.sum(data["top"] * (data["right"] - data["left"])))


def every_mark() -> ChartGrid:
    """Return charts with every mark, and names that are markup."""
    T = np.linspace(0.0, 1.0, 5)
    across = Axis("t (s)", reach=(0.0, 1.0), linked="t")
    layers = [
        Layer("line", {"x": T, "y": T**2, "z": T}, label="line", hover=(("at", "@x{0.0} s"), ("z", "@z"))),
        Layer("points", {"x": T, "y": np.array([1.0, math.nan, 2.0, math.inf, 3.0]), "size": 4 + T}, "red"),
        Layer("points", {"x": T, "y": T}, "amber", marker="bar", label="bars"),
        Layer("band", {"x": T, "y0": T - 1, "y1": T + 1}, alpha=0.2),
        Layer("segments", {"x0": T, "y0": 0.0, "x1": T, "y1": T}, dash="dashed"),
        Layer("step", {"x": T, "y": T}),
        Layer("patch", {"x": T, "y": T}, alpha=0.1),
        Layer("cells", {"left": T, "right": T + 0.1, "bottom": T, "top": T + 0.1, "alpha": T}),
        Layer("rule", {"y": 0.0}, "ink"),
        Layer("zone", {"left": 0.1, "right": 0.2}, "grey", alpha=0.2),
    ]
    names = ("R", EVIL)
    value, shades = np.array([0.5, math.nan]), Shades("diverging", -1.0, 1.0)
    texts: dict[str, Any] = {"x": ("R", "L"), "y": ("L", "L"), "text": ("0.5", "?"), "value": value}
    matrix = [Layer("cells", texts, shades=shades), Layer("text", texts)]
    axes = (Axis(kind="names", names=("R", "L")), Axis(kind="names", names=("L", "R")))
    bars = rows_of(names, Axis("D", kind="log"), [Layer("bars", {"y": names, "x": T[1:3], "x0": 0.1}, label="D")])
    return stacked([Chart(across, Axis("y"), tuple(layers), crosshair=True), bars, Chart(*axes, tuple(matrix))])
