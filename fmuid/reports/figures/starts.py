"""Where searches from several starts ended: how much worse than the best, and each end over its start."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmuid.arrays import Floats
from fmuid.batches import INTERVAL_STDS, Columns, data_sets, misfit, optimum_numbers
from fmuid.reports.figures.panels import MAX_DOTS, Truth, Units, mark_cases, mark_truth, panels, points, say_outside
from fmuid.reports.figures.style import AMBER, BLUE, RED
from fmuid.text import label

# Optima of which all is inside the picture.
MAX_OPTIMA = 5
# The top of the panel of fits is at least there, in per cent or in units of the criterion.
LEAST_EXCESS = 1.0
# Starts that range over this ratio are shown logarithmically.
WIDE_RANGE = 100.0


def over_starts(frame: pd.DataFrame, truth: Truth, units: Units, *, given_noise: bool = False) -> Figure:
    """Draw where searches from several starts ended: how much worse they fit, in order, and each end over its start.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    truth : mapping of str to float
    units : mapping of str to str
    given_noise : bool
        See `fmuid.batches.statistics.misfit`.
    """
    columns = Columns.of(frame)
    number = optimum_numbers(frame, given_noise=given_noise)
    excess = _excess(frame, columns, given_noise=given_noise)

    failed, lost = (frame["status"] == "failed").to_numpy(bool), (frame["status"] != "converged").to_numpy(bool)

    def panel(axes: Axes, name: str) -> None:
        if not name:
            _waterfall(axes, excess, number, lost, given_noise=given_noise)
            return
        begin, end = (frame[f"{kind}.{name}"].to_numpy(np.float64) for kind in ("start", "value"))
        limits = _limits(end, INTERVAL_STDS * frame[f"std.{name}"].to_numpy(np.float64), number)
        axes.set_ylim(limits)
        mark_truth(axes, name, truth)
        for which, color, text in ((number > 1, RED, "another optimum"), (number == 1, BLUE, "best optimum")):
            points(axes, begin[which], end[which], color, text)
        astray = lost & np.isfinite(end)
        points(axes, begin[astray], np.clip(end[astray], *limits), AMBER, "not converged", "x")
        mark_cases(axes, begin[failed], RED, "failed")
        say_outside(axes, end[number > 0], limits)
        if np.nanmax(begin) > WIDE_RANGE * np.nanmin(begin) > 0:  # NaN where the parameter is not free
            axes.set_xscale("log")
        axes.set_xlabel(f"start of {label(name, units.get(name))}")
        axes.set_ylabel(label(name, units.get(name)))

    names = [name.removeprefix("start.") for name in columns.starts]
    return panels(frame, panel, names=["", *(name for name in names if name in columns.parameters)])


def _limits(end: Floats, half: Floats, number: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Return limits around the intervals of the best optima, so that differences that mean nothing look small."""
    near = (number > 0) & (number <= MAX_OPTIMA) & np.isfinite(end)
    half = np.where(np.isfinite(half), half, 0.0)
    low, high = float((end - half)[near].min()), float((end + half)[near].max())
    room = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    return low - room, high + room


def _excess(frame: pd.DataFrame, columns: Columns, *, given_noise: bool) -> Floats:
    """Return how much worse each converged case fits than the best of its data, NaN for the others.

    By the criterion where the noise variances are given, else the share by which the residual is larger.
    """
    fits = np.where(frame["status"] == "converged", misfit(frame, given_noise=given_noise), np.nan)
    for rows in data_sets(frame, columns):
        known = rows[np.isfinite(fits[rows])]
        fits[rows] -= fits[known].min() if known.size else 0.0
    return fits if given_noise else np.expm1(0.5 * fits / max(1, len(columns.outputs)))


def _waterfall(
    axes: Axes, excess: Floats, number: npt.NDArray[np.int64], lost: npt.NDArray[np.bool_], *, given_noise: bool
) -> None:
    order = np.argsort(np.where(lost, np.inf, excess), kind="stable")[: int((~lost).sum())]
    x, y = np.arange(1.0, order.size + 1), excess[order] * (1.0 if given_noise else 100.0)
    kept = np.unique(np.linspace(0, order.size - 1, min(order.size, MAX_DOTS)).astype(int))
    for which, color, text in ((number[order] > 1, RED, "another optimum"), (number[order] == 1, BLUE, "best optimum")):
        shown = kept[which[kept]]
        points(axes, x[shown], y[shown], color, text)
    # fits at one optimum differ by rounding alone, which a plain logarithm would spread over the panel
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_ylim(-0.02, max(LEAST_EXCESS, 1.5 * float(y.max(initial=0.0))))
    axes.set_xlabel("searches, the best first" + (f"; {lost.sum()} did not converge" if lost.any() else ""))
    axes.set_ylabel("criterion above the best" if given_noise else "residual above the best (%)")
