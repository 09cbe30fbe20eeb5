"""Figures of a batch: estimates over the cases and over what is set, and how they are distributed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fmuid.arrays import Floats
from fmuid.batches import INTERVAL_STDS, Columns, estimates, is_repetition
from fmuid.files import file_name
from fmuid.reports.figures.panels import (
    MAX_DOTS,
    Truth,
    Units,
    cloud,
    limits_of,
    mark_cases,
    mark_truth,
    panels,
    points,
    say_outside,
    short,
)
from fmuid.reports.figures.starts import over_starts
from fmuid.reports.figures.style import AMBER, BLUE, GREY, INK, RED
from fmuid.text import label

Line = tuple[str, Any, npt.NDArray[np.int64]]
"""Text, colour and rows of what is drawn alike."""

# Up to so many cases each has its interval.
MAX_BARS = 60
# Cases, and levels of a setting, that are written at the axis one by one.
MAX_NAMED = 25
# Lines of different colours in a panel, and values of a setting that a line of means is drawn through.
MAX_LINES, MAX_LEVELS = 6, 60
# Fewer estimates than this make no histogram, they are drawn themselves; fewer at a setting make no mean.
LEAST_COUNTED, LEAST_MEAN = 30, 3
# Bars of a histogram.
MIN_BINS, MAX_BINS = 8, 60
# A normal curve is drawn so many standard deviations wide.
SHOWN_STDS = 3.2
# Of lines side by side, told apart by all eyes; at most `MAX_LINES`.
COLORS = (BLUE, RED, AMBER, GREY, INK, "#7fb2f0")


def draw(
    frame: pd.DataFrame, truth: Truth | None = None, units: Units | None = None, *, given_noise: bool = False
) -> dict[str, Figure]:
    """Draw a batch: the figures by the names of their files; none of a batch without a converged case.

    Parameters
    ----------
    frame : DataFrame
        A row a case, as a batch's dataset has them.
    truth : mapping of str to float, optional
        Of the parameters, and of variables that are set.
    units : mapping of str to str, optional
        Of the same.
    given_noise : bool
        Whether the study gives all noise variances; see `fmuid.batches.statistics.misfit`.
    """
    columns, truth, units = Columns.of(frame), truth or {}, units or {}
    found = estimates(frame, given_noise=given_noise)
    if found.empty:
        return {}
    figures = {"estimates": over_cases(frame, truth, units)}
    if any(len(rows) >= LEAST_MEAN for _, _, rows in _groups(found)):
        figures["distributions"] = distributions(found, truth, units)
    repeated = ("table",) if "draw" in columns.repeats and "table" in columns.repeats else ()
    for name in (*columns.design, *repeated):
        if len(found[name].unique()) > 1:
            figures[f"swept-{file_name(name.removeprefix('set.'))}"] = over_setting(found, name, truth, units)
    if columns.starts:
        figures["starts"] = over_starts(frame, truth, units, given_noise=given_noise)
    return figures


# --- estimates over the cases


def over_cases(frame: pd.DataFrame, truth: Truth, units: Units) -> Figure:
    """Draw each parameter over the cases, a panel each, with intervals of 95 % where there are few.

    Parameters
    ----------
    frame : DataFrame
        Of a batch; failed cases are marked at the lower border.
    truth : mapping of str to float
    units : mapping of str to str
    """
    number, status = frame["case"].to_numpy(np.float64), frame["status"].to_numpy(str)
    bars = len(frame) <= MAX_BARS
    named = "table" in frame and len(frame["table"].unique()) == len(frame) <= MAX_NAMED

    def panel(axes: Axes, name: str) -> None:
        value = frame[f"value.{name}"].to_numpy(np.float64)
        half = INTERVAL_STDS * frame[f"std.{name}"].to_numpy(np.float64)
        good = (status == "converged") & np.isfinite(value)
        ends = np.concatenate([value[good] - half[good], value[good] + half[good]]) if bars else value[good]
        limits = limits_of(ends if np.isfinite(ends).any() else value[good], truth.get(name))
        axes.set_ylim(limits)
        if bars:
            _intervals(axes, number[good], value[good], half[good], truth.get(name))
        cloud(axes, number[good], value[good], "converged")
        mark_truth(axes, name, truth)
        mark_cases(axes, number[status == "failed"], RED, "failed")
        mark_cases(axes, number[status == "not converged"], GREY, "not converged", top=True)
        say_outside(axes, value[good], limits)
        axes.set_ylabel(label(name, units.get(name)))
        room = 0.5 if bars else 0.01 * len(frame)
        axes.set_xlim(number.min() - room, number.max() + room)
        if named:
            axes.set_xticks(number, [short(text) for text in frame["table"]], rotation=45, ha="right", fontsize=7.5)
        else:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8, min_n_ticks=1))
            axes.set_xlabel("case")

    return panels(frame, panel, wide=True)


def _intervals(axes: Axes, x: Floats, value: Floats, half: Floats, true: float | None) -> None:
    known = np.isfinite(half)
    missed = known & (np.abs(value - true) > half) if true is not None else np.zeros(len(x), bool)
    for which, color, text in ((known & ~missed, BLUE, "interval of 95 %"), (missed, RED, "misses the truth")):
        if which.any():
            axes.vlines(
                x[which], (value - half)[which], (value + half)[which], color=color, lw=1, alpha=0.6, label=text
            )


# --- distributions


def distributions(found: pd.DataFrame, truth: Truth, units: Units) -> Figure:
    """Draw how the estimates are distributed, a panel a parameter, beside what their stated std promises.

    Where few settings vary, each has its own outline; where many do, there is nothing to be held against the std.

    Parameters
    ----------
    found : DataFrame
        One case a data set, as `fmuid.batches.statistics.estimates` gives them.
    truth : mapping of str to float
    units : mapping of str to str
    """
    groups, repeated = _groups(found), is_repetition(found, Columns.of(found))

    def panel(axes: Axes, name: str) -> None:
        value, std = found[f"value.{name}"].to_numpy(np.float64), found[f"std.{name}"].to_numpy(np.float64)
        stated = math.sqrt(np.nanmean(std**2)) if np.isfinite(std).any() else math.nan
        true = truth.get(name)
        curve = repeated and stated > 0
        centre = float(np.nanmean(value)) if true is None else true
        promised = [centre - SHOWN_STDS * stated, centre + SHOWN_STDS * stated] if curve else []
        low, high = limits_of(np.append(value, promised), true)
        for text, color, rows in groups:
            _histogram(axes, value[rows][np.isfinite(value[rows])], (low, high), color, text, filled=len(groups) == 1)
        axes.set_title(name)
        words = ""
        if curve:
            grid = np.linspace(low, high, 300)
            normal = np.exp(-0.5 * ((grid - centre) / stated) ** 2) / (stated * math.sqrt(2.0 * math.pi))
            axes.plot(grid, normal, color=RED, lw=1.2, label="as the stated std says")
            ratio = float(np.nanstd(value, ddof=1)) / stated if np.isfinite(value).sum() > 1 else math.nan
            words = f"spread {ratio:.3g} x stated std" if math.isfinite(ratio) else ""
        say_outside(axes, value, (low, high), words)
        mark_truth(axes, name, truth, vertical=True)
        axes.set_xlim(low, high)
        axes.set_ylim(bottom=0.0)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
        axes.set_xlabel(label(name, units.get(name)))

    return panels(found, panel)


def _histogram(axes: Axes, values: Floats, limits: tuple[float, float], color: Any, text: str, *, filled: bool) -> None:
    inside = values[(values >= limits[0]) & (values <= limits[1])]
    if inside.size < LEAST_COUNTED:
        where = axes.get_xaxis_transform()
        axes.vlines(inside, 0.0, 0.25, color=color, lw=1.2, transform=where, label=text or "estimates")
        return
    count = min(MAX_BINS, max(MIN_BINS, round(2 * inside.size ** (1 / 3))))
    bins = np.histogram_bin_edges(inside, bins=count)
    if filled:
        axes.hist(inside, bins=bins.tolist(), density=True, color=color, alpha=0.35, lw=0, label="estimates")
    else:
        axes.hist(inside, bins=bins.tolist(), density=True, color=color, histtype="step", lw=1.3, label=text)


# --- over a setting


def over_setting(found: pd.DataFrame, name: str, truth: Truth, units: Units) -> Figure:
    """Draw each parameter over what is set: means with the spread over the cases, or the cases where none repeats.

    Parameters
    ----------
    found : DataFrame
        One case a data set, as `fmuid.batches.statistics.estimates` gives them.
    name : str
        Column of the setting.
    truth : mapping of str to float
    units : mapping of str to str
    """
    columns = Columns.of(found)
    others = [other for other in columns.design if other != name and len(found[other].unique()) > 1]
    lines, (position, ticks) = _lines(found, others), _positions(found[name])
    variable = name.removeprefix("set.")

    def panel(axes: Axes, parameter: str) -> None:
        value, std = (found[f"{kind}.{parameter}"].to_numpy(np.float64) for kind in ("value", "std"))
        limits = limits_of(value, truth.get(parameter))
        for text, color, rows in lines:
            known = rows[np.isfinite(value[rows])]
            at = position[known], value[known], std[known]
            if (len(lines) == 1 and others) or not _means(axes, *at, (text, color), joined=not ticks):
                _singles(axes, *at, limits, (text, color))
        mark_truth(axes, parameter, truth)
        if variable in truth and not ticks:
            axes.axvline(truth[variable], color=AMBER, lw=1, ls=(0, (1, 2)), label=f"{variable} is right")
        if ticks:
            axes.set_xticks(range(len(ticks)), ticks, rotation=30 if max(map(len, ticks)) > 8 else 0)
            axes.set_xlim(-0.5, len(ticks) - 0.5)
        axes.set_xlabel(variable if ticks else label(variable, units.get(variable)))
        axes.set_ylabel(label(parameter, units.get(parameter)))

    return panels(found, panel)


def _means(axes: Axes, x: Floats, value: Floats, std: Floats, line: tuple[str, Any], *, joined: bool) -> bool:
    """Draw means and how far cases spread around them; return whether there are cases enough for that."""
    levels, where, counts = np.unique(x, return_inverse=True, return_counts=True)
    if not 1 <= levels.size <= MAX_LEVELS or counts.min() < LEAST_MEAN:
        return False
    text, color = line
    parts = [np.flatnonzero(where == k) for k in range(levels.size)]
    mean = np.array([value[rows].mean() for rows in parts])
    spread = INTERVAL_STDS * np.array([value[rows].std(ddof=1) for rows in parts])
    stated = INTERVAL_STDS * np.array([math.sqrt(np.mean(std[rows] ** 2)) for rows in parts])
    words = "± 1.96 spread", "± 1.96 stated std"
    if joined:
        axes.fill_between(levels, mean - spread, mean + spread, color=color, alpha=0.18, lw=0, label=words[0])
        axes.plot(levels, mean, color=color, marker="o", ms=3.2, label=text or "mean")
        for sign in (-1.0, 1.0):
            axes.plot(levels, mean + sign * stated, color=color, lw=0.9, ls=(0, (4, 3)), label=words[1])
    else:
        axes.vlines(levels, mean - spread, mean + spread, color=color, alpha=0.18, lw=9, label=words[0])
        axes.vlines(levels, mean - stated, mean + stated, color=color, lw=1, label=words[1])
        points(axes, levels, mean, color, text or "mean")
    return True


def _singles(
    axes: Axes, x: Floats, value: Floats, std: Floats, limits: tuple[float, float], line: tuple[str, Any]
) -> None:
    text, color = line
    if x.size > MAX_DOTS:
        axes.set_ylim(limits)
        cloud(axes, x, value, text or "estimate")
        return
    if x.size <= MAX_BARS:
        half = np.where(np.isfinite(std), INTERVAL_STDS * std, 0.0)
        axes.vlines(x, value - half, value + half, color=color, lw=1, alpha=0.6, label="interval of 95 %")
    points(axes, x, value, color, text or "estimate")


def _groups(found: pd.DataFrame) -> list[Line]:
    return _lines(found, [name for name in Columns.of(found).design if len(found[name].unique()) > 1])


def _lines(found: pd.DataFrame, names: Sequence[str]) -> list[Line]:
    """Return text, colour and rows of every combination of settings; all rows as one where these are too many."""
    everything = [("", BLUE, np.arange(len(found), dtype=np.int64))]
    if not names or not 1 < len(found[list(names)].drop_duplicates()) <= MAX_LINES:
        return everything
    levels = list(found.reset_index(drop=True).groupby(list(names), dropna=False))
    lines = []
    for k, (key, part) in enumerate(levels):
        values: Any = key
        pairs = zip((name.removeprefix("set.") for name in names), values, strict=True)
        text = ", ".join(f"{name} = {_level(value)}" for name, value in pairs)
        lines.append((text, COLORS[k], part.index.to_numpy(np.int64)))
    return lines


def _positions(setting: pd.Series[Any]) -> tuple[Floats, list[str]]:
    """Return where on the axis each case lies, and what to write there where the settings are words."""
    if setting.dtype.kind in "fiu":
        return setting.to_numpy(np.float64), []
    texts, levels = pd.factorize(setting.astype(str))
    return texts.astype(np.float64), [short(str(level)) for level in levels] if len(levels) <= MAX_NAMED else []


def _level(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else short(str(value))
