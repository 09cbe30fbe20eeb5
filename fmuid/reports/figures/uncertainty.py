"""Figures of uncertainty: profiles of the criterion, the posterior's corner, and the walkers' paths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter

from fmuid.arrays import Floats
from fmuid.reports.figures.style import AMBER, BLUE, GREY, INK, MAX_PARAMETERS, RED, WIDTH, style
from fmuid.text import has_unit, label, with_std

if TYPE_CHECKING:
    from fmuid.assessment import Posterior, Profile
    from fmuid.estimation import Result

Units = Mapping[str, str | None]

# Profiles are drawn up to so many times the rise at which the interval ends.
HEIGHT = 1.8
# A flat profile is drawn over at most so many times the width on the side that ends, or the parameter's size.
FLAT_SHARE = 1.5
# More parameters than these make panels that nobody can read.
MAX_CORNER = 8
# Shares of the samples inside the contours, those of one and two standard deviations in one dimension.
SHARES = (0.68, 0.95)
FILLS = (0.16, 0.38)
"""How dark the inside of the outer and of the inner contour is."""
BINS, SHOWN_QUANTILES = 32, (0.0005, 0.9995)
"""Bins of a histogram, and the quantiles of the samples between which they lie."""
# Width in bins of the Gaussian that smooths the counts before their contours are drawn.
SMOOTHING = 1.2
# Samples correlated more strongly lie on a line thinner than the bins: they are drawn themselves.
THIN_CORRELATION = 0.97
# Paths of more walkers, or more steps of each, cannot be told apart.
MAX_WALKERS, MAX_PATH = 24, 1500


# --- profiles


def profiles(found: Sequence[Profile], units: Units | None = None) -> Figure:
    """Draw profiles, a panel each: the rise of the criterion, the parabola of the local standard deviation beside it.

    The interval is where the profile lies below the level's line. A profile that has no end on a side is drawn on that
    side over a width that shows it.

    Parameters
    ----------
    found : sequence of Profile
    units : mapping of str to str, optional
        Of the parameters.
    """
    shown = found[:MAX_PARAMETERS]
    columns = min(len(shown), 2 if len(shown) <= 4 else 3)
    rows = math.ceil(len(shown) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 2.2 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for axes, profile in zip(panels, shown, strict=False):
            _profile(axes, profile, (units or {}).get(profile.name))
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[: len(shown) : columns]:
            axes.set_ylabel("rise of the criterion")
        handles = [
            Line2D([], [], color=BLUE, marker="o", ms=3.2, label="profile"),
            Line2D([], [], color=GREY, ls=(0, (4, 3)), lw=1, label="local parabola"),
            Line2D([], [], color=RED, lw=1, label=f"{100 * shown[0].level:.4g} % level"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _profile(axes: Axes, profile: Profile, unit: str | None) -> None:
    low, high = _window(profile)
    rise = profile.criterion - profile.minimum
    ends = max(profile.lower, low), min(profile.upper, high)
    if ends[0] < ends[1]:
        axes.axvspan(*ends, color=BLUE, alpha=0.12, lw=0)
    axes.axhline(profile.threshold, color=RED, lw=1)
    axes.axvline(profile.value, color=INK, lw=0.6, ls=(0, (1, 2)))
    if math.isfinite(profile.bend) and profile.bend > 0:
        grid = np.linspace(low, high, 200)
        axes.plot(grid, ((grid - profile.value) / profile.bend) ** 2, color=GREY, ls=(0, (4, 3)), lw=1)
    axes.plot(*_curve(profile.values, rise, profile.value), color=BLUE)
    axes.plot(profile.values, rise, "o", color=BLUE, ms=3.2)
    axes.set_xlim(low, high)
    axes.set_ylim(-0.04 * HEIGHT * profile.threshold, HEIGHT * profile.threshold)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    axes.set_title(profile.name)
    axes.set_title(_interval(profile, unit), loc="right", fontweight="normal", color=BLUE)
    axes.set_xlabel(label(profile.name, unit))


def _curve(values: Floats, rise: Floats, centre: float) -> tuple[Floats, Floats]:
    """Return a smooth line through the points: the signed root of the rise is nearly straight."""
    if values.size < 2:
        return values, rise
    root = np.sign(values - centre) * np.sqrt(np.maximum(rise, 0.0))
    grid = np.unique(np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(values)]))
    return grid, PchipInterpolator(values, root)(grid) ** 2


def _window(profile: Profile) -> tuple[float, float]:
    """Return what part of the axis to draw: the interval and some room; of a flat side enough to show it."""
    values = profile.values
    ends = np.array([profile.lower, profile.upper])
    reach = np.abs(ends - profile.value)
    known = reach[np.isfinite(reach) & (reach > 0)]
    flat = max(FLAT_SHARE * float(known.max()) if known.size else 0.0, FLAT_SHARE * abs(profile.value), 1e-300)
    room = 0.35 * float(known.max()) if known.size else 0.0
    sides = []
    for sign, end, furthest in ((-1.0, ends[0], values[0]), (1.0, ends[1], values[-1])):
        wanted = end + sign * room if math.isfinite(end) else profile.value + sign * flat
        # not beyond what was computed, unless that is the end itself
        sides.append(wanted if math.isfinite(end) else sign * min(sign * wanted, sign * furthest))
    if sides[0] == sides[1]:
        return profile.value - 1.0, profile.value + 1.0
    return sides[0], sides[1]


def _interval(profile: Profile, unit: str | None) -> str:
    ends = [profile.lower, profile.upper]
    if any(math.isnan(end) for end in ends):
        return "no interval"
    width = profile.upper - profile.lower
    decimals = 0
    if math.isfinite(width) and width > 0:
        decimals = max(0, 2 - math.floor(math.log10(width)))
    texts = [_number(end, decimals if math.isfinite(width) else None) for end in ends]
    return f"{texts[0]} to {texts[1]}" + (f" {unit}" if has_unit(unit) else "")


def _number(value: float, decimals: int | None) -> str:
    if math.isinf(value):
        return "−∞" if value < 0 else "∞"
    return f"{value:.4g}" if decimals is None or decimals > 8 else f"{value:.{decimals}f}"


# --- corner


def corner(
    posterior: Posterior,
    result: Result | None = None,
    units: Units | None = None,
    *,
    names: Sequence[str] | None = None,
    truths: Mapping[str, float] | None = None,
) -> Figure:
    """Draw the samples of every parameter and of every pair of them.

    Contours hold 68 % and 95 % of the samples; the ellipses, at the same shares, and the curves on the diagonal are
    those of the local covariance (1.31).

    Parameters
    ----------
    posterior : Posterior
    result : Result, optional
        Whose local approximation is drawn.
    units : mapping of str to str, optional
        Of the parameters.
    names : sequence of str, optional
        Which parameters; default the first `MAX_CORNER`.
    truths : mapping of str to float, optional
        Values to mark.
    """
    chosen = [posterior.names.index(name) for name in (names or posterior.names)][:MAX_CORNER]
    count = len(chosen)
    side = max(WIDTH, 1.75 * count) if count > 2 else 0.7 * WIDTH
    ranges = {i: _range(posterior.samples[:, i]) for i in chosen}
    with style():
        figure = Figure(figsize=(side, side if count > 1 else 0.6 * side), layout="constrained")
        panels = figure.subplots(count, count, squeeze=False, sharex="col")
        for row, i in enumerate(chosen):
            for column, j in enumerate(chosen):
                axes = panels[row, column]
                if column > row:
                    axes.remove()
                    continue
                axes.grid(visible=False)
                if i == j:
                    _single(axes, posterior, i, result, (units or {}).get(posterior.names[i]))
                else:
                    _pair(axes, posterior, (j, i), (ranges[j], ranges[i]), result)
                    axes.set_ylim(ranges[i])
                _mark(axes, posterior.names[j], None if i == j else posterior.names[i], truths or {})
                axes.set_xlim(ranges[j])
                _ticks(axes, posterior, (j, i), units or {}, (row == count - 1, column == 0 and row > 0))
        figure.legend(
            handles=_corner_legend(result, truths),
            loc="outside upper right" if count > 1 else "outside lower center",
            ncols=1 if count > 1 else 3,
        )
    return figure


def _range(samples: Floats) -> tuple[float, float]:
    low, high = np.quantile(samples, SHOWN_QUANTILES)
    room = 0.04 * (high - low) or 0.05 * abs(low) or 1.0
    return float(low - room), float(high + room)


def _single(axes: Axes, posterior: Posterior, i: int, result: Result | None, unit: str | None) -> None:
    samples = posterior.samples[:, i]
    edges = np.linspace(*_range(samples), BINS + 1)
    axes.hist(samples, bins=edges.tolist(), density=True, color=BLUE, alpha=0.35, lw=0)
    ends = posterior.intervals().to_numpy()[i]
    for end in ends:
        axes.axvline(end, color=BLUE, lw=0.8, ls=(0, (4, 3)))
    if result is not None and math.isfinite(result.std[i]) and result.std[i] > 0:
        grid = np.linspace(edges[0], edges[-1], 200)
        normal = np.exp(-0.5 * ((grid - result.values[i]) / result.std[i]) ** 2)
        axes.plot(grid, normal / (result.std[i] * math.sqrt(2.0 * math.pi)), color=RED, lw=1.1)
    text = with_std(float(samples.mean()), float(samples.std(ddof=1)))
    axes.set_title(f"{posterior.names[i]} = {text}" + (f" {unit}" if has_unit(unit) else ""), fontsize=8.5)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _pair(
    axes: Axes,
    posterior: Posterior,
    where: tuple[int, int],
    ranges: tuple[tuple[float, float], tuple[float, float]],
    result: Result | None,
) -> None:
    x, y = posterior.samples[:, where[0]], posterior.samples[:, where[1]]
    if abs(np.corrcoef(x, y)[0, 1]) > THIN_CORRELATION:
        some = slice(None, None, math.ceil(x.size / MAX_PATH))
        axes.plot(x[some], y[some], ".", color=BLUE, ms=2, alpha=0.4)
    else:
        counts, first, second = np.histogram2d(x, y, bins=BINS, range=ranges)
        smooth = gaussian_filter(counts.T, SMOOTHING)
        levels = _share_levels(smooth)
        middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (first, second)]
        axes.contourf(*middles, smooth, [*levels, math.inf], colors=[to_rgba(BLUE, alpha) for alpha in FILLS])
        axes.contour(*middles, smooth, levels, colors=BLUE, linewidths=1.0)
    if result is not None:
        for share in SHARES:
            ellipse = _ellipse(result, where, share)
            if ellipse is not None:
                axes.plot(*ellipse, color=RED, lw=0.9, ls=(0, (4, 3)))


def _share_levels(counts: Floats) -> list[float]:
    """Return the heights above which the given shares of all counts lie, the largest share first."""
    ordered = np.sort(counts.ravel())[::-1]
    total = np.cumsum(ordered)
    heights = [float(ordered[np.searchsorted(total, share * total[-1])]) for share in sorted(SHARES, reverse=True)]
    return [height for k, height in enumerate(heights) if k == 0 or height > heights[k - 1]]


def _ellipse(result: Result, where: tuple[int, int], share: float) -> Floats | None:
    """Return the border (2, n) within which a normal density of the local covariance has the share."""
    covariance = result.covariance[np.ix_(where, where)]
    std = np.sqrt(np.diag(covariance))
    if not np.isfinite(covariance).all() or not (std > 0).all():
        return None
    # [cos t, ρ cos t + sqrt(1 − ρ²) sin t]: the circle by the triangle of the correlation matrix
    rho = float(np.clip(covariance[0, 1] / (std[0] * std[1]), -1.0, 1.0))
    angles = np.linspace(0.0, 2.0 * np.pi, 181)
    radius = math.sqrt(-2.0 * math.log(1.0 - share))
    unit = np.array([np.cos(angles), rho * np.cos(angles) + math.sqrt(1.0 - rho**2) * np.sin(angles)])
    return np.asarray(result.values[list(where)][:, None] + radius * std[:, None] * unit, dtype=np.float64)


def _mark(axes: Axes, x: str, y: str | None, truths: Mapping[str, float]) -> None:
    if x in truths:
        axes.axvline(truths[x], color=AMBER, lw=1)
    if y is not None and y in truths:
        axes.axhline(truths[y], color=AMBER, lw=1)


def _ticks(axes: Axes, posterior: Posterior, where: tuple[int, int], units: Units, outer: tuple[bool, bool]) -> None:
    """Label the panels at the lower and the left border only."""
    x, y = (posterior.names[i] for i in where)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, prune="both"))
    axes.tick_params(labelbottom=outer[0], labelsize=7.5)
    axes.tick_params(axis="x", labelrotation=35)
    if outer[0]:
        axes.set_xlabel(label(x, units.get(x)))
    if x != y:
        axes.yaxis.set_major_locator(MaxNLocator(nbins=4, prune="both"))
        axes.tick_params(labelleft=outer[1])
        if outer[1]:
            axes.set_ylabel(label(y, units.get(y)))


def _corner_legend(result: Result | None, truths: Mapping[str, float] | None) -> list[Any]:
    handles = [Line2D([], [], color=BLUE, label="posterior, 68 % and 95 %")]
    if result is not None and np.isfinite(result.std).any():
        handles.append(Line2D([], [], color=RED, ls=(0, (4, 3)), label="local approximation"))
    if truths:
        handles.append(Line2D([], [], color=AMBER, label="truth"))
    return handles


# --- the walkers' paths


def traces(posterior: Posterior, units: Units | None = None) -> Figure:
    """Draw every walker's path, a panel a parameter; what lies in the grey part takes no part in the samples.

    Paths that wander off together, or walkers that stay where they are, show that there is no convergence.

    Parameters
    ----------
    posterior : Posterior
    units : mapping of str to str, optional
        Of the parameters.
    """
    names = posterior.names[:MAX_PARAMETERS]
    steps = len(posterior.chain)
    thinned = slice(None, None, math.ceil(steps / MAX_PATH))
    numbers = np.arange(1, steps + 1)[thinned]
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 1.25 * len(names)), layout="constrained")
        panels = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
        for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
            axes.plot(numbers, posterior.chain[thinned, :MAX_WALKERS, i], color=BLUE, lw=0.5, alpha=0.35)
            if posterior.burn:
                axes.axvspan(0.5, posterior.burn + 0.5, color=GREY, alpha=0.18, lw=0)
            axes.set_ylabel(label(name, (units or {}).get(name)))
            size, agreement = posterior.effective_size[i], posterior.r_hat[i]
            axes.set_title(name)
            axes.set_title(
                f"{size:.0f} independent samples, R-hat {agreement:.3f}", loc="right", fontweight="normal", color=BLUE
            )
            axes.margins(x=0.01)
        panels[-1].set_xlabel("step")
        panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure
