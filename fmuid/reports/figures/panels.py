"""What the figures of a batch share: panels, clouds of points however many, marks of failures and of the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgba
from matplotlib.figure import Figure

from fmuid.arrays import Floats
from fmuid.batches import Columns, converged
from fmuid.reports.figures.style import AMBER, BLUE, MAX_PARAMETERS, RED, WIDTH, style

Units = Mapping[str, str | None]
Truth = Mapping[str, float]
Panel = Callable[[Axes, str], None]

# More points than this are drawn as counts in cells, along and across.
MAX_DOTS, CELLS = 2000, (150, 60)
# More marks at a border than this run into one another.
MAX_MARKS = 150
# So many points have room to be large.
LARGE_DOTS = 600
# Values further than so many quartile distances from the middle half are outside the picture, which says so, if they
# are less than such a share of all.
OUTSIDE_QUARTILES, RARE_SHARE = 6.0, 0.05
# Letters of a name that an axis has room for.
LONGEST_LABEL = 24
COUNTS = LinearSegmentedColormap.from_list("counts", ["#cfe0f7", BLUE, "#052a5c"])


def panels(frame: pd.DataFrame, panel: Panel, *, wide: bool = False, names: Sequence[str] = ()) -> Figure:
    """Draw panels and one legend.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    panel : callable
        Draws into axes what has a name.
    wide : bool
        Whether few panels stand below each other, each as wide as the figure.
    names : sequence of str, optional
        Of the panels; default every parameter that is estimated in any case.
    """
    known = [name for name in Columns.of(frame).parameters if np.isfinite(converged(frame)[f"value.{name}"]).any()]
    shown = (list(names) or known)[:MAX_PARAMETERS]
    columns = 1 if wide and len(shown) <= 4 else min(len(shown), 2 if len(shown) <= 4 else 3)
    rows = math.ceil(len(shown) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + (1.6 if wide else 2.2) * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharex=columns == 1).ravel()
        handles: dict[str, Any] = {}
        for axes, name in zip(grid, shown, strict=False):
            panel(axes, name)
            for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(text, handle)
        for axes in grid[len(shown) :]:
            axes.remove()
        if columns == 1:
            for axes in grid[:-1]:
                axes.set_xlabel("")
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside lower center",
            ncols=len(handles) if len(handles) <= 5 else 4,
        )
    return figure


def points(axes: Axes, x: Floats, y: Floats, color: Any, text: str, marker: str = "o") -> None:
    """Draw points, none of which leaves no word in the legend."""
    if x.size:
        size = 3.4 if x.size <= LARGE_DOTS else 2.0
        look: Any = {"ms": 5, "mew": 1.3} if marker == "x" else {"ms": size, "mew": 0}
        axes.plot(x, y, marker, color=color, ls="", label=text, **look)


def cloud(axes: Axes, x: Floats, y: Floats, text: str) -> None:
    """Draw points within the axes' limits of y, or where they are many, how many there are."""
    if x.size <= MAX_DOTS:
        points(axes, x, y, BLUE, text)
        return
    limits = axes.get_ylim()
    reach = [[float(x.min()), float(x.max())], list(limits)]
    counts, across, along = np.histogram2d(x, y, bins=CELLS, range=reach)
    mesh = np.where(counts > 0, counts, np.nan).T
    axes.pcolormesh(across, along, mesh, cmap=COUNTS, norm=LogNorm(1.0, max(2.0, counts.max())))
    axes.plot([], [], "s", color=BLUE, ms=5, label=f"{text} (the darker, the more)")


def mark_cases(axes: Axes, x: Floats, color: str, text: str, *, top: bool = False) -> None:
    """Mark cases at the lower or at the upper border; where they are many, the darker the more of them."""
    x = x[np.isfinite(x)]
    if not x.size:
        return
    where, height = axes.get_xaxis_transform(), 0.97 if top else 0.03
    if x.size <= MAX_MARKS:
        axes.plot(x, np.full(x.size, height), "|", color=color, ms=7, mew=1.2, transform=where)
    else:
        counts, edges = np.histogram(x, bins=CELLS[0])
        shades = [to_rgba(color, share) for share in counts / counts.max()]
        middles, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
        axes.bar(middles, 0.06, width, height - 0.03, color=shades, lw=0, transform=where)
    axes.plot([], [], "|", color=color, ms=7, mew=1.2, label=f"{text} ({x.size})")


def mark_truth(axes: Axes, name: str, truth: Truth, *, vertical: bool = False) -> None:
    """Draw the truth where it is known."""
    if name in truth:
        (axes.axvline if vertical else axes.axhline)(truth[name], color=AMBER, lw=1.2, label="truth")


def limits_of(values: Floats, true: float | None = None) -> tuple[float, float]:
    """Return the range of values to draw, with the truth and without the few that are far from all others."""
    values = values[np.isfinite(values)]
    if values.size:
        first, third = np.quantile(values, [0.25, 0.75])
        reach = OUTSIDE_QUARTILES * (third - first)
        near = (values >= first - reach) & (values <= third + reach)
        values = values[near] if reach > 0 and np.mean(~near) < RARE_SHARE else values
    if true is not None:
        values = np.append(values, true)
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def say_outside(axes: Axes, values: Floats, limits: tuple[float, float], also: str = "") -> None:
    """Say above a panel how many values the picture leaves out, after what else is to be said of it."""
    count = int(((values < limits[0]) | (values > limits[1])).sum())
    words = [*([also] if also else []), *([f"{count} outside"] if count else [])]
    axes.set_title(", ".join(words), loc="right", fontweight="normal", color=RED if count else BLUE)


def short(text: str) -> str:
    """Return the end of a long name, where the names of files differ."""
    return text if len(text) <= LONGEST_LABEL else f"…{text[1 - LONGEST_LABEL :]}"
