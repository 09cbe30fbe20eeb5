"""Residuals: distribution, autocorrelation, and correlation with the inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.reports.interactive.bokeh_spec import ColumnDataSource
from fmuid.reports.interactive.style import AMBER, BLUE, GREY, INK, RED, WHITE, Panel, normal

if TYPE_CHECKING:
    import pandas as pd

# The histogram reaches so many standard deviations to both sides; what lies beyond is in its last bars.
SHOWN_STDS, BARS, FEW_BARS, MANY_SAMPLES = 4.0, 41, 21, 300
# Correlations are drawn to a scale of at least so many half-widths of the band, so that white noise looks harmless.
BANDS = 3.0
# Inputs whose correlation is drawn: those of the largest. More lines cannot be told apart.
INPUT_LOOKS = ((RED, "solid"), (BLUE, "solid"), (AMBER, "solid"), (GREY, "dashed"))


def histogram(residual: Floats, output: str) -> Any:
    """Draw how a residual is distributed, in its standard deviations, beside the normal distribution.

    Parameters
    ----------
    residual : (K,) array
        NaN where a sample is missing or does not count.
    output : str
        Whose it is.
    """
    known = residual[np.isfinite(residual)]
    scaled = (known - known.mean()) / (known.std() or 1.0)
    edges = np.linspace(-SHOWN_STDS, SHOWN_STDS, BARS if known.size > MANY_SAMPLES else FEW_BARS)
    density, _ = np.histogram(np.clip(scaled, -SHOWN_STDS, SHOWN_STDS), bins=edges, density=True)
    plot = Panel(x=f"residual of {output} / its std", height=220)
    source = ColumnDataSource({"left": edges[:-1], "right": edges[1:], "top": density})
    bars = plot.quad("left", "right", "top", 0, source=source, fill_color=RED, fill_alpha=0.45, line_color=WHITE)
    fine = np.linspace(-SHOWN_STDS, SHOWN_STDS, 121)
    line = plot.line(fine, normal(fine, 0.0, 1.0), line_color=INK, line_width=1.4)
    plot.bare()
    plot.legend([("residual", [bars]), ("normal", [line])])
    return plot


def autocorrelation(table: pd.DataFrame, output: str) -> Any:
    """Draw the autocorrelation of a residual and the band in which 95 % of it lie if it is white.

    Parameters
    ----------
    table : DataFrame
        The rows of ``correlations.csv`` of this residual with itself, from lag 1 on.
    output : str
    """
    lags, values = table["lag"].to_numpy(np.float64), table["correlation"].to_numpy(np.float64)
    plot = Panel(x=f"lag (samples), residual of {output}", y="autocorrelation", height=220)
    band = _band(plot, table)
    source = ColumnDataSource({"lag": lags, "value": values, "zero": np.zeros(lags.size), "time": table["time"]})
    plot.segment("lag", "zero", "lag", "value", source=source, line_color=RED, line_width=1.6)
    dots = plot.scatter("lag", "value", source=source, size=4, fill_color=RED, line_color=None)
    plot.hover(dots, ("lag", "@lag samples, @time{0.00000} s"), ("autocorrelation", "@value{0.000}"))
    plot.legend([("residual; in the band 95 % of white noise", [dots])])
    _scale(plot, values, band)
    return plot


def with_inputs(table: pd.DataFrame, output: str) -> Any:
    """Draw the correlation of a residual with what each input was before.

    Parameters
    ----------
    table : DataFrame
        The rows of ``correlations.csv`` of this residual with inputs.
    output : str
    """
    plot = Panel(x=f"input's lead (samples), residual of {output}", y="correlation", height=220)
    band = _band(plot, table)
    largest = table.groupby("with", sort=False)["correlation"].apply(lambda one: float(one.abs().max()))
    names = [name for name in largest.index if name in set(largest.nlargest(len(INPUT_LOOKS)).index)]
    entries: list[tuple[str, list[Any]]] = []
    for name, (color, dash) in zip(names, INPUT_LOOKS, strict=False):
        part = table[table["with"] == name]
        source = ColumnDataSource({key: part[key].to_numpy(np.float64) for key in ("lag", "time", "correlation")})
        line = plot.line("lag", "correlation", source=source, line_color=color, line_dash=dash, line_width=1.4)
        plot.hover(line, ("lead", "@lag samples, @time{0.00000} s"), ("correlation", "@correlation{0.000}"))
        entries.append((str(name), [line]))
    plot.legend(entries)
    _scale(plot, table["correlation"].to_numpy(np.float64), band)
    return plot


def _band(plot: Any, table: pd.DataFrame) -> float:
    band = float(table["band"].max())
    plot.shade(BLUE, 0.14, bottom=-band, top=band)
    plot.level(0.0)
    return band


def _scale(plot: Any, values: Floats, band: float) -> None:
    most = min(1.15 * max(BANDS * band, float(np.nanmax(np.abs(values), initial=0.0))), 1.05)
    plot.reach(y=(-most, most))
