"""Figures of a search: parameters and criterion against iteration, noise variances against repetition, optima."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from fmuid.arrays import Floats
from fmuid.reports.figures.style import AMBER, BLUE, INK, MAX_PARAMETERS, RED, WIDTH, style
from fmuid.text import has_unit, label, with_std

if TYPE_CHECKING:
    import pandas as pd


# Characters that a third of the width has room for.
NARROW_HEADING = 30
# A band of ± 2 std thinner than this share of the path is shown once more, larger.
THIN_BAND = 0.15
# Variances and criteria are drawn logarithmically where they range over this ratio.
WIDE_RANGE = 5.0
# Values that differ by less than about this share are shown side by side, and not spread over a panel.
LEAST_ROOM = 0.01
# Areas of the points of optima, from few fits to many, in points².
LEAST_POINT, MOST_POINT = 12.0, 70.0


# --- parameters and criterion against iteration -----------------------------------------


def parameters(trace: pd.DataFrame, estimates: pd.DataFrame) -> Figure:
    """Draw each parameter against the iterations of the search, a panel each (figures 1.3 and 1.4 of the method).

    Parameters
    ----------
    trace
        As in ``trace.csv``. Rejected trials are left out: a parameter stays where it is during them.
    estimates
        As in ``estimates.csv``: the band is the estimate ± 2 standard deviations, and the one of the prior likewise.
    """
    shown = estimates.iloc[:MAX_PARAMETERS]
    rows = zip(shown["parameter"], shown["value"], shown["std"], strict=True)
    headings = [f"{name}  {with_std(value, std)}" for name, value, std in rows]
    wide = max(map(len, headings)) > NARROW_HEADING
    columns = min(len(shown), 2 if len(shown) <= 4 or wide else 3)
    lines = math.ceil(len(shown) / columns)
    accepted = trace[trace["accepted"].astype(bool)]
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 1.75 * lines), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
        for axes, (_, row) in zip(panels, shown.iterrows(), strict=False):
            _parameter(axes, accepted["iteration"].to_numpy(), accepted[row["parameter"]].to_numpy(float), row)
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[max(0, len(shown) - columns) : len(shown)]:
            axes.set_xlabel("iteration")
            axes.tick_params(labelbottom=True)
        known: dict[str, Any] = {}
        for axes in panels[: len(shown)]:
            known |= {text: handle for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    return figure


def _parameter(axes: Axes, iterations: Floats, values: Floats, row: Any) -> None:
    """One panel: the path of one parameter, from its start to its estimate."""
    value, std, unit = float(row["value"]), float(row["std"]), row["unit"]
    if math.isfinite(std) and std > 0:
        axes.axhspan(value - 2 * std, value + 2 * std, color=BLUE, alpha=0.16, lw=0, label="estimate ± 2 std")
    axes.axhline(value, color=BLUE, lw=0.8, ls=(0, (4, 3)))
    low, high = min(values.min(), value), max(values.max(), value)
    if math.isfinite(row["prior_mean"]):
        half = 2 * row["prior_std"]
        axes.axhspan(
            row["prior_mean"] - half, row["prior_mean"] + half, color=AMBER, alpha=0.16, lw=0, label="prior ± 2 std"
        )
        axes.axhline(row["prior_mean"], color=AMBER, lw=0.8, ls=(0, (1, 2)))
        low, high = min(low, row["prior_mean"]), max(high, row["prior_mean"])
    axes.plot(iterations, values, color=BLUE, marker="o", ms=3.2, label="accepted steps")
    axes.plot(iterations[:1], values[:1], "o", ms=6, mfc="white", mec=INK, mew=1.2, ls="", label="start")
    # A parameter that did not move still gets a scale around it.
    known = math.isfinite(std) and std > 0
    room = 0.12 * (high - low) or (2.5 * std if known else 0.05 * abs(value) or 1.0)
    axes.set_ylim(low - room, high + room)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5))
    axes.set_title(row["parameter"])
    text = with_std(value, std) + (f" {unit}" if has_unit(unit) else "")
    axes.set_title(text, loc="right", fontweight="normal", color=BLUE)
    axes.set_ylabel(unit if has_unit(unit) else "no unit")
    if known and 4 * std < THIN_BAND * (high - low) and len(iterations) > 3:
        _last_steps(axes, iterations, values, value, std)


def _last_steps(axes: Axes, iterations: Floats, values: Floats, value: float, std: float) -> None:
    """Show in a corner, at the scale of the standard deviation, how the search ended; the path leaves it free."""
    above = np.median(values) <= 0.5 * sum(axes.get_ylim())
    inset = axes.inset_axes((0.62, 0.52 if above else 0.12, 0.36, 0.38))
    inset.set_in_layout(False)  # it lies inside and takes no room
    near = int(np.argmax(np.abs(values - value) < 6 * std))
    first = max(0, min(near, len(values) - 3))
    inset.axhspan(value - 2 * std, value + 2 * std, color=BLUE, alpha=0.16, lw=0)
    inset.axhline(value, color=BLUE, lw=0.8, ls=(0, (4, 3)))
    inset.plot(iterations, values, color=BLUE, marker="o", ms=2.6, lw=1)
    inset.set_xlim(iterations[first] - 0.4, iterations[-1] + 0.4)
    inset.set_ylim(value - 4 * std, value + 4 * std)
    inset.set_yticks([value - 2 * std, value + 2 * std], ["−2 std", "+2 std"])
    inset.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=3))
    inset.tick_params(labelsize=7, length=2, pad=1.5)
    inset.grid(visible=False)


def criterion(trace: pd.DataFrame) -> Figure:
    """Draw the criterion and Marquardt's λ against the iteration, both logarithmic; rejected trials are crosses.

    Parameters
    ----------
    trace
        As in ``trace.csv``. Its rounds use different noise variances, so that their criteria cannot be compared: each
        has its own line.
    """
    damped = bool((trace["lambda"] > 0).any())  # else there are only Gauss–Newton steps, and no λ to show
    with style():
        figure = Figure(figsize=(WIDTH, 4.2 if damped else 2.8), layout="constrained")
        ratios = (3, 2) if damped else (1,)
        above, *others = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
        level = _zero_level(trace["lambda"].to_numpy(float))
        for number, (_, part) in enumerate(trace.groupby("round")):
            accepted = part["accepted"].to_numpy(bool)
            iterations, values, damping = (part[name].to_numpy(float) for name in ("iteration", "criterion", "lambda"))
            if number:
                for axes in (above, *others):
                    axes.axvline(iterations[0], color=AMBER, lw=1, ls=(0, (4, 3)), label="noise variances renewed")
            _with_rejected(above, iterations, values, accepted)
            decades = np.log10(np.where(damping > 0, damping, 10.0**level))
            for below in others:
                _with_rejected(below, iterations[1:], decades[1:], accepted[1:])
        above.set_yscale("log")
        above.set_ylabel("criterion")
        for below in others:
            below.set_ylabel("λ")
            below.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=2))
            below.yaxis.set_major_formatter(lambda tick, _: "0" if tick <= level else f"$10^{{{tick:.0f}}}$")
            below.set_ylim(bottom=level - 0.3)
        lowest = others[-1] if others else above
        lowest.set_xlabel("iteration")
        lowest.xaxis.set_major_locator(MaxNLocator(integer=True))
        known = dict(zip(*reversed(above.get_legend_handles_labels()), strict=True))
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    return figure


def _zero_level(damping: Floats) -> float:
    """Return the decade at which λ = 0, the Gauss–Newton step, is drawn: below all others."""
    used = damping[damping > 0]
    return math.floor(math.log10(used.min())) - 1.0 if used.size else -1.0


def _with_rejected(axes: Axes, iterations: Floats, values: Floats, accepted: npt.NDArray[np.bool_]) -> None:
    rejected = ~accepted & np.isfinite(values)
    axes.plot(iterations[accepted], values[accepted], color=BLUE, marker="o", ms=3.5, label="accepted")
    if rejected.any():
        axes.plot(iterations[rejected], values[rejected], "x", color=RED, ms=5, mew=1.3, label="rejected trial")


# --- noise variances against repetition ----------------------------------------------------


def rounds(found: pd.DataFrame, units: Mapping[str, str | None] | None = None) -> Figure:
    """Draw each output's noise variance against the repetition (figures 1.5 and 1.6 of the method).

    The first value, at 0, is the one that the search began with; after each round stands what its residual gave.

    Parameters
    ----------
    found
        As in ``rounds.csv``.
    units : mapping of str to str, optional
        Of the outputs.
    """
    outputs = [name.removeprefix("used.") for name in found.columns if name.startswith("used.")][:MAX_PARAMETERS]
    columns = min(len(outputs), 2)
    lines = math.ceil(len(outputs) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 1.9 * lines), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
        for axes, output in zip(panels, outputs, strict=False):
            used, estimated = found[f"used.{output}"].to_numpy(float), found[f"estimated.{output}"].to_numpy(float)
            _variance(axes, used, estimated)
            axes.set_title(output)
            axes.set_title(f"{estimated[-1]:.4g}", loc="right", fontweight="normal", color=BLUE)
            unit = (units or {}).get(output)
            axes.set_ylabel(label("variance", f"{unit}²" if has_unit(unit) else None))
        for axes in panels[len(outputs) :]:
            axes.remove()
        for axes in panels[max(0, len(outputs) - columns) : len(outputs)]:
            axes.set_xlabel("round of the search")
            axes.tick_params(labelbottom=True)
        known: dict[str, Any] = {}
        for axes in panels[: len(outputs)]:
            known |= {text: handle for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    return figure


def _variance(axes: Axes, used: Floats, estimated: Floats) -> None:
    """One panel: what the rounds used and what their residuals gave."""
    numbers = np.arange(len(used) + 1)
    axes.axhline(estimated[-1], color=BLUE, lw=0.8, ls=(0, (4, 3)))
    axes.plot(numbers, [used[0], *estimated], color=BLUE, marker="o", ms=4, label="estimated from the residual")
    axes.plot([0], used[:1], "o", ms=6, mfc="white", mec=INK, mew=1.2, ls="", label="start")
    values = np.append(used, estimated)
    if values.max() > WIDE_RANGE * values.min() > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(numticks=5))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.margins(y=0.15)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


# --- optima of a global search ---------------------------------------------------------------


def optima(table: pd.DataFrame, units: Mapping[str, str | None] | None = None) -> Figure:
    """Draw the criterion of the optima found over each parameter; the larger a point, the more fits ended there.

    Parameters
    ----------
    table : DataFrame
        As in ``optima.csv``.
    units : mapping of str to str, optional
        Of the parameters.
    """
    names = [str(name) for name in table.columns.drop(["criterion", "hits", "converged"])][:MAX_PARAMETERS]
    sure, values = table["converged"].to_numpy(bool), table["criterion"].to_numpy(float)
    sizes = LEAST_POINT + (MOST_POINT - LEAST_POINT) * table["hits"].to_numpy(float) / table["hits"].max()
    columns = min(len(names), 2 if len(names) <= 4 else 3)
    lines = math.ceil(len(names) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 1.9 * lines), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
        for axes, name in zip(panels, names, strict=False):
            places = table[name].to_numpy(float)
            axes.scatter(places[sure], values[sure], sizes[sure], color=BLUE, alpha=0.75, lw=0, label="optimum")
            if not sure.all():
                axes.plot(places[~sure], values[~sure], "x", color=RED, ms=5, mew=1.3, ls="", label="not converged")
            axes.scatter(places[:1], values[:1], sizes[:1], color=AMBER, edgecolor=INK, lw=0.9, label="best")
            if values.max() > WIDE_RANGE * values.min() > 0:
                axes.set_yscale("log")
            axes.set_xlim(_room(places))
            axes.xaxis.set_major_locator(MaxNLocator(nbins=5))
            axes.set_xlabel(label(name, (units or {}).get(name)))
        for axes in panels[len(names) :]:
            axes.remove()
        for axes in panels[: len(names) : columns]:
            axes.set_ylabel("criterion")
        if panels[0].get_yscale() == "linear":
            panels[0].set_ylim(_room(values))
            panels[0].yaxis.set_major_locator(MaxNLocator(nbins=5))
        known = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    return figure


def _room(values: Floats) -> tuple[float, float]:
    """Return limits around values, not so narrow that their last digits fill the panel."""
    low, high = float(values.min()), float(values.max())
    room = max(0.12 * (high - low), LEAST_ROOM * max(abs(low), abs(high))) or 1.0
    return low - room, high + room
