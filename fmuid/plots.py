"""Figures of an identification: parameters and criterion against iteration, measured against simulated, residuals.

Drawn with matplotlib's objects directly, without pyplot: no window, no global state, and a faster start.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fmuid.report import has_unit, label, with_std

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.report import Fit

Array = npt.NDArray[np.float64]

# Wide enough to be read at the width of a README, about 1000 pixels.
WIDTH, DPI = 9.2, 110
# More panels than these make a figure nobody reads: the outputs and experiments that fit worst are kept.
MAX_OUTPUTS, MAX_EXPERIMENTS, MAX_PARAMETERS = 8, 6, 24
# Lines longer than this are drawn by the least and greatest of each stretch, which looks the same at this resolution.
MAX_POINTS = 3000
ZOOM_SHARE, ZOOM_SAMPLES = 0.06, 120
"""The zoom is this share of the record, and at least this many samples."""
# Characters that a third of the width has room for.
NARROW_HEADING = 30
# A band of ± 2 std thinner than this share of the path is shown once more, larger.
THIN_BAND = 0.15

INK, GREY, FAINT, BLUE, RED, AMBER = "#24292f", "#7d8590", "#d8dee4", "#0b61d0", "#c4432b", "#d99a1c"
STYLE: Any = {
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.formatter.useoffset": False,
    "axes.axisbelow": True,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "text.color": INK,
}


def save(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG files into `folder` (made where needed) and return their paths.

    Figures of an earlier run that would be taken for this one's are removed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        if old.stem.split("-")[0] in ("parameters", "criterion", "fit", "residuals"):
            old.unlink()
    paths = []
    with style():  # ticks take theirs when they are drawn
        for name, figure in figures.items():
            path = folder / f"{name}.png"
            figure.savefig(path, dpi=DPI)
            paths.append(path)
    return paths


def search(trace: pd.DataFrame, estimates: pd.DataFrame) -> dict[str, Figure]:
    """Draw the search: ``parameters`` and ``criterion`` against iteration."""
    return {"parameters": parameters(trace, estimates), "criterion": criterion(trace)}


def fits(records: Sequence[Fit], *, residuals: bool) -> dict[str, Figure]:
    """Draw measured against simulated for each experiment and, where asked, the residuals.

    Parameters
    ----------
    records
        One per experiment. Of more than `MAX_EXPERIMENTS` those with the greatest misfit are drawn, and of more than
        `MAX_OUTPUTS` outputs likewise.
    residuals
        Whether to draw the residuals' own figure too.

    Returns
    -------
    dict of str to Figure
        ``fit`` and ``residuals``, followed by ``-name`` of the experiment where there are several.
    """
    worst = sorted(records, key=lambda record: -np.nanmax([0.0, *record.misfit]))[:MAX_EXPERIMENTS]
    found = {}
    for record in (record for record in records if record in worst):
        name = record.experiment if len(records) > 1 else ""
        suffix = f"-{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}" if name else ""
        found[f"fit{suffix}"] = fit(record, name)
        if residuals:
            found[f"residuals{suffix}"] = residual(record, name)
    return found


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


def _parameter(axes: Axes, iterations: Array, values: Array, row: Any) -> None:
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


def _last_steps(axes: Axes, iterations: Array, values: Array, value: float, std: float) -> None:
    """Show in a corner, at the scale of the standard deviation, how the search ended; the path leaves it free."""
    above = np.median(values) <= 0.5 * sum(axes.get_ylim())
    inset = axes.inset_axes((0.62, 0.52 if above else 0.12, 0.36, 0.38))
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
    with style():
        figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        level = _zero_level(trace["lambda"].to_numpy(float))
        for number, (_, part) in enumerate(trace.groupby("round")):
            accepted = part["accepted"].to_numpy(bool)
            iterations, values, damping = (part[name].to_numpy(float) for name in ("iteration", "criterion", "lambda"))
            if number:
                for axes in (above, below):
                    axes.axvline(iterations[0], color=AMBER, lw=1, ls=(0, (4, 3)), label="noise variances renewed")
            _with_rejected(above, iterations, values, accepted)
            decades = np.log10(np.where(damping > 0, damping, 10.0**level))
            _with_rejected(below, iterations[1:], decades[1:], accepted[1:])
        above.set_yscale("log")
        above.set_ylabel("criterion")
        below.set_ylabel("λ")
        below.set_xlabel("iteration")
        below.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=2))
        below.yaxis.set_major_formatter(lambda tick, _: "0" if tick <= level else f"$10^{{{tick:.0f}}}$")
        below.set_ylim(bottom=level - 0.3)
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
        known = dict(zip(*reversed(above.get_legend_handles_labels()), strict=True))
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    return figure


def _zero_level(damping: Array) -> float:
    """Return the decade at which λ = 0, the Gauss–Newton step, is drawn: below all others."""
    used = damping[damping > 0]
    return math.floor(math.log10(used.min())) - 1.0 if used.size else -1.0


def _with_rejected(axes: Axes, iterations: Array, values: Array, accepted: npt.NDArray[np.bool_]) -> None:
    rejected = ~accepted & np.isfinite(values)
    axes.plot(iterations[accepted], values[accepted], color=BLUE, marker="o", ms=3.5, label="accepted")
    if rejected.any():
        axes.plot(iterations[rejected], values[rejected], "x", color=RED, ms=5, mew=1.3, label="rejected trial")


# --- measured against simulated ---------------------------------------------------------


def fit(record: Fit, name: str = "") -> Figure:
    """Draw measured against simulated, the residual below: the whole record, and where the outputs move most.

    `name` is the experiment's, where it needs one.
    """
    outputs = _worst_outputs(record)
    counted = np.asarray(record.counted.any(axis=1))
    start, stop = zoom(record.simulated[:, outputs], counted)
    with style():
        figure = Figure(figsize=(WIDTH, 0.5 + 2.35 * len(outputs)), layout="constrained")
        grid = figure.add_gridspec(2 * len(outputs), 2, width_ratios=(5, 4), height_ratios=(3, 1) * len(outputs))
        shared: list[Axes | None] = [None, None]
        for place, output in enumerate(outputs):
            for side, samples in enumerate((slice(None), slice(start, stop))):
                upper = figure.add_subplot(grid[2 * place, side], sharex=shared[side])
                lower = figure.add_subplot(grid[2 * place + 1, side], sharex=upper)
                shared[side] = shared[side] or upper
                _fit_panels(upper, lower, record, output, samples)
                if side == 0:
                    span = record.times[[start, stop - 1]]
                    upper.axvspan(span[0], span[1], color=AMBER, alpha=0.18, lw=0)
                    upper.set_title(f"{record.outputs[output]}, misfit {100 * record.misfit[output]:.3g} %")
                    upper.set_ylabel(label(record.outputs[output], record.units[output]))
                    lower.set_ylabel("residual\n" + label("", record.units[output]).strip())
                    _shade_uncounted(upper, record, counted)
                elif place == 0:
                    upper.set_title("zoom", color=AMBER)
                last = place == len(outputs) - 1
                lower.tick_params(labelbottom=last)
                if last:
                    lower.set_xlabel("time (s)")
        if name:
            figure.suptitle(name, x=0.01, ha="left", fontsize=10.5)
        figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=1.6)
    return figure


def _fit_panels(upper: Axes, lower: Axes, record: Fit, output: int, samples: slice) -> None:
    times, measured = record.times[samples], record.measured[samples, output]
    simulated = record.simulated[samples, output]
    if len(times) > MAX_POINTS:
        upper.plot(*thin(times, measured), color=GREY, lw=0.7, alpha=0.7, label="measured")
    else:
        size = 1.6 if len(times) > 4 * ZOOM_SAMPLES else 3.4
        upper.plot(times, measured, "o", color=GREY, ms=size, mew=0, alpha=0.75, label="measured")
    upper.plot(*thin(times, simulated), color=BLUE, label="simulated")
    upper.tick_params(labelbottom=False)
    lower.plot(*thin(times, measured - simulated), color=RED, lw=0.6)
    lower.axhline(0, color=INK, lw=0.6)
    lower.yaxis.set_major_locator(MaxNLocator(nbins=3, symmetric=True))
    upper.margins(x=0.01)


def _shade_uncounted(axes: Axes, record: Fit, counted: npt.NDArray[np.bool_]) -> None:
    """Grey over the transient that is simulated but not counted."""
    if counted.any() and not counted[0]:
        axes.axvspan(record.times[0], record.times[int(counted.argmax())], color=GREY, alpha=0.18, lw=0)


def zoom(simulated: Array, counted: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first sample and the one past the last of the stretch where the simulated outputs vary most.

    The total variation of each output, relative to its own over the record, is summed over the outputs: being
    simulated they carry no noise. Samples that do not count do not attract the zoom.
    """
    samples = len(simulated)
    width = min(samples, max(ZOOM_SAMPLES, round(ZOOM_SHARE * samples)))
    moves = np.abs(np.diff(simulated, axis=0, prepend=simulated[:1]))
    moves[~counted] = 0.0
    total = moves.sum(axis=0)
    activity = (moves / np.where(total > 0, total, 1.0)).sum(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(activity)])
    start = int(np.argmax(summed[width:] - summed[:-width])) if samples > width else 0
    return start, start + width


# --- residuals --------------------------------------------------------------------------


def residual(record: Fit, name: str = "") -> Figure:
    """Draw each residual: against time, histogram with the normal curve, autocorrelation with its 95 % band."""
    outputs = _worst_outputs(record)
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 1.9 * len(outputs)), layout="constrained")
        panels = figure.subplots(len(outputs), 3, squeeze=False, width_ratios=(5, 2.2, 3))
        for (series, histogram, correlation), output in zip(panels, outputs, strict=True):
            error = np.where(
                record.counted[:, output], record.measured[:, output] - record.simulated[:, output], np.nan
            )
            series.plot(*thin(record.times, error), color=RED, lw=0.5)
            series.axhline(0, color=INK, lw=0.6)
            series.margins(x=0.01)
            series.set_ylabel(label(record.outputs[output], record.units[output]))
            _histogram(histogram, error[np.isfinite(error)])
            _correlation(correlation, error)
        for axes, text in zip(panels[0], ("residual", "distribution", "autocorrelation"), strict=True):
            axes.set_title(text)
        if name:
            figure.suptitle(name, x=0.01, ha="left", fontsize=10.5)
        for axes, text in zip(panels[-1], ("time (s)", "residual / its std", "lag (samples)"), strict=True):
            axes.set_xlabel(text)
    return figure


def _histogram(axes: Axes, error: Array) -> None:
    spread = error.std() if len(error) > 1 else 0.0
    if spread > 0:
        edges = np.linspace(-4, 4, 33 if len(error) > 300 else 17)
        axes.hist((error - error.mean()) / spread, bins=list(edges), density=True, color=RED, alpha=0.45)
        axes.plot(edges, np.exp(-(edges**2) / 2) / math.sqrt(2 * math.pi), color=INK, lw=1, label="normal")
        axes.legend(loc="upper right", handlelength=1.0, borderaxespad=0.0)
    axes.set_xlim(-4.4, 4.4)
    axes.set_xticks([-4, -2, 0, 2, 4])
    axes.set_yticks([])
    axes.grid(visible=False)


def _correlation(axes: Axes, error: Array) -> None:
    lags, values, band = autocorrelation(error)
    axes.axhspan(-band, band, color=BLUE, alpha=0.16, lw=0, label="95 % if white")
    axes.vlines(lags[1:], 0, values[1:], color=RED, lw=1.4)
    axes.axhline(0, color=INK, lw=0.6)
    reach = 1.3 * max(3 * band, float(np.abs(values[1:]).max(initial=0.0)))
    axes.set_ylim(-min(reach, 1.0), min(reach, 1.0))
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.0)


def autocorrelation(error: Array, lags: int = 40) -> tuple[Array, Array, float]:
    """Return lags, autocorrelation (1 at lag 0) and the half-width of the 95 % band of a white series.

    Missing samples (NaN) take no part; `error` has shape (K,).
    """
    centred = np.nan_to_num(error - np.nanmean(error))
    power = float(centred @ centred) or 1.0
    reach = min(lags, len(error) - 1)
    values = np.array([centred[: len(error) - lag] @ centred[lag:] / power for lag in range(reach + 1)])
    return np.arange(reach + 1.0), values, 1.96 / math.sqrt(np.isfinite(error).sum())


# --- small parts ------------------------------------------------------------------------


def style() -> Any:
    """Return the context in which every figure is drawn."""
    return matplotlib.rc_context(STYLE)


def thin(x: Array, y: Array) -> tuple[Array, Array]:
    """Return about `MAX_POINTS` points that draw the same line: the least and greatest of each stretch, in order."""
    if len(x) <= MAX_POINTS:
        return x, y
    step = math.ceil(2 * len(x) / MAX_POINTS)
    stretches = len(x) // step
    blocks = y[: stretches * step].reshape(stretches, step)
    first = np.arange(stretches) * step
    least = first + np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    greatest = first + np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    kept = np.unique(np.concatenate([[0], least, greatest, np.arange(stretches * step, len(x)), [len(x) - 1]]))
    return x[kept], y[kept]


def _worst_outputs(record: Fit) -> list[int]:
    """Return the outputs to draw, in their own order: all, or the `MAX_OUTPUTS` of greatest misfit."""
    order = np.argsort(-np.nan_to_num(np.asarray(record.misfit)), kind="stable")
    return sorted(int(output) for output in order[:MAX_OUTPUTS])
