"""Reproduce the chapter's estimates of the induction machine, with and without prior.

    python -m experiments.induction_machine.chapter

Run from the project's folder; it rewrites the tables (.csv) and figures (.png) beside it and the tables in README.md:

- `estimates`, `search`, `iterations`: without and with prior, from the same starts (figures 1.3 and 1.4);
- `variance`: the repetition on the noise variance from four first values (figures 1.5 and 1.6);
- `draws`: prior alone, data alone and both, over 100 draws of the noise and of the prior's mean.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

import fmuid
from experiments import pages
from experiments.induction_machine import make_table
from experiments.pages import AMBER, BLUE, GREY, INK
from fmuid.array_types import Floats
from fmuid.formatting import with_std
from fmuid.reports.render.matplotlib_renderer import WIDTH, style

HERE = Path(__file__).parent
MODEL = HERE.parents[1] / "fmus" / "InductionMachine" / "InductionMachine.fmu"
OUTPUTS = ("ids", "iqs")
UNITS = {"Rs": "Ω", "Rr": "Ω", "Lm": "H", "Lf": "H"}
SYMBOLS = {"Rs": "R_s", "Rr": "R_r", "Lm": "L_m", "Lf": "L_f"}
NAMES = tuple(make_table.TRUTH)
TRUTH: Floats = np.array(list(make_table.TRUTH.values()))

# The chapter's prior, from ten earlier estimates, and its noise variance.
PRIOR_MEAN: Floats = np.array([9.81, 3.83, 0.436, 0.0762])
PRIOR_STD: Floats = np.sqrt([2e-3, 2e-4, 6e-7, 1e-7])
NOISE_VARIANCE = 0.0462  # A²
FIRST_VARIANCES = (1e-3, NOISE_VARIANCE, 1.0, 10.0)  # A²
# Wrong by ten standard deviations in every parameter: then the weight of the prior shows in the residual.
WRONG_MEAN: Floats = PRIOR_MEAN + 10 * PRIOR_STD
# What the chapter prints; R_r is not among it.
CHAPTER = {"without prior": (9.507, None, 0.4364, 0.0751), "with prior": (9.667, None, 0.4366, 0.0762)}

START: Floats = TRUTH * (1.5, 0.5, 1.5, 0.5)  # that of study.toml
DRAWS, SEED = 100, 1
COLOURS = {"without prior": BLUE, "with prior": AMBER}
KINDS = ("prior alone", "data alone", "both")


# --- estimates --------------------------------------------------------------------------


@cache
def system() -> fmuid.System:
    """Return the machine, loaded once."""
    return fmuid.System.of(MODEL)


def experiment(table: pd.DataFrame) -> fmuid.Experiment:
    """Return a table with its roles."""
    return fmuid.Experiment(table, inputs=["uds", "uqs", "w"], outputs=OUTPUTS)


def estimate(
    data: fmuid.Experiment,
    start: Floats = START,
    *,
    prior_mean: Floats | None = None,
    noise: fmuid.Noise | None = None,
) -> fmuid.Result:
    """Identify the four parameters by the procedure of docs/method/noise-variances.md."""
    means = [None] * len(NAMES) if prior_mean is None else prior_mean.tolist()
    parameters = {
        name: fmuid.Parameter(value, min=0.0, prior=None if mean is None else fmuid.Normal(mean, std))
        for name, value, mean, std in zip(NAMES, start.tolist(), means, PRIOR_STD.tolist(), strict=True)
    }
    problem = fmuid.Problem(
        system(), data, parameters, noise=noise or fmuid.Noise(initial_variance=NOISE_VARIANCE, delay_std=0.0)
    )
    result = fmuid.identify(problem, restart=False)  # the search itself is looked at
    if not result.converged:
        raise RuntimeError(f"from {start}: {fmuid.Document.of(result)}")
    return result


def pair(data: fmuid.Experiment, start: Floats = START) -> dict[str, fmuid.Result]:
    """Return the estimates without and with prior from the same start."""
    return {"without prior": estimate(data, start), "with prior": estimate(data, start, prior_mean=PRIOR_MEAN)}


def corners(share: float) -> Floats:
    """Return the 16 starts that are off the truth by a share, each parameter above or below, (16, 4)."""
    return np.asarray(TRUTH * list(product((1.0 - share, 1.0 + share), repeat=len(NAMES))))


def iterations(data: fmuid.Experiment) -> pd.DataFrame:
    """Return how many iterations and simulations each start takes, without and with prior, a row a start."""
    starts = [("± 50 %", s) for s in corners(0.5)] + [("± 20 %", s) for s in corners(0.2)] + [("θ₀", PRIOR_MEAN)]
    rows = []
    for name, start in starts:
        row: dict[str, Any] = {"starts": name, **dict(zip(NAMES, start.tolist(), strict=True))}
        for kind, result in pair(data, start).items():
            row |= {f"iterations {kind}": result.history.iterations, f"simulations {kind}": result.history.simulations}
        rows.append(row)
    return pd.DataFrame(rows)


# --- noise variance ---------------------------------------------------------------------


def drawn_variance(clean: pd.DataFrame, table: pd.DataFrame) -> dict[str, float]:
    """Return the variance of the noise in a table, that of each output and of both together, A²."""
    noise = (table[list(OUTPUTS)] - clean[list(OUTPUTS)]).to_numpy()
    found = dict(zip(OUTPUTS, np.mean(noise**2, axis=0).tolist(), strict=True))
    return found | {"both": float(np.mean(noise**2))}


def repetition(data: fmuid.Experiment) -> pd.DataFrame:
    """Return the noise variance against repetition, from each of `FIRST_VARIANCES`, with a right and a wrong prior."""
    rows = []
    for (prior, mean), first in product(
        {"the chapter's": PRIOR_MEAN, "wrong by 10 std": WRONG_MEAN}.items(), FIRST_VARIANCES
    ):
        result = estimate(data, prior_mean=mean, noise=fmuid.Noise(initial_variance=first, delay_std=0.0))
        found = pd.DataFrame(result.history.rounds)[[f"estimated.{name}" for name in OUTPUTS]].to_numpy()
        for searches, values in enumerate(np.vstack([np.full(len(OUTPUTS), first), found])):
            outputs = dict(zip(OUTPUTS, values.tolist(), strict=True))
            rows.append({"prior": prior, "first": first, "searches": searches, **outputs, "both": float(values.mean())})
    return pd.DataFrame(rows)


# --- repeated draws ---------------------------------------------------------------------


def draws(clean: pd.DataFrame, count: int, seed: int) -> Floats:
    """Return errors in prior standard deviations (count, 3, 4) of `KINDS`, over draws of noise and prior mean."""
    rng = np.random.default_rng(seed)
    estimates = np.empty((count, len(KINDS), len(NAMES)))
    for drawn in estimates:
        data = experiment(make_table.add_noise(clean, NOISE_VARIANCE, rng))
        drawn[0] = rng.normal(TRUTH, PRIOR_STD)
        drawn[1] = estimate(data).values
        drawn[2] = estimate(data, prior_mean=drawn[0].copy()).values
    return np.asarray((estimates - TRUTH) / PRIOR_STD)


def root_mean_squares(errors: Floats) -> pd.DataFrame:
    """Return the root mean square of errors (count, 3, 4) over draws, a row a kind, ``all``: over parameters too."""
    squares = np.mean(errors**2, axis=0)
    table = pd.DataFrame(np.sqrt(squares), index=list(KINDS), columns=list(NAMES))
    return table.assign(all=np.sqrt(squares.mean(axis=1)))


# --- figures ----------------------------------------------------------------------------


def search_figure(found: Mapping[str, fmuid.Result]) -> Figure:
    """Draw the parameters against iteration, without and with prior (figures 1.3 and 1.4 in one)."""
    with style():
        figure = Figure(figsize=(WIDTH, 4.1), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True).ravel()
        for index, (axes, name) in enumerate(zip(panels, NAMES, strict=True)):
            _search_panel(axes, found, index)
            _search_end(_free_corner(axes, TRUTH[index]), found, index)
            axes.set_title(f"${SYMBOLS[name]}$")
            axes.set_ylabel(UNITS[name])
        for axes in panels[2:]:
            axes.set_xlabel("iteration")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def _search_panel(axes: Axes, found: Mapping[str, fmuid.Result], index: int) -> None:
    axes.axhline(TRUTH[index], color=INK, lw=0.8, ls=(0, (4, 3)), label="truth")
    for kind, result in found.items():
        taken = result.trace[result.trace["accepted"].astype(bool)]
        axes.plot(taken["iteration"], taken[NAMES[index]], color=COLOURS[kind], marker="o", ms=3.4, label=kind)
    axes.plot(0, START[index], "o", ms=6, mfc="white", mec=INK, mew=1.2, ls="", label="start")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5))


def _free_corner(axes: Axes, level: float) -> Axes:
    """Return an inset at the right end, above or below the level where all paths end, with room made for it."""
    low, high = axes.get_ylim()
    above = level - low < high - level
    axes.set_ylim(
        (low, max(high, low + (level - low) / 0.4)) if above else (min(low, high - (high - level) / 0.4), high)
    )
    return axes.inset_axes((0.6, 0.55 if above else 0.13, 0.39, 0.4))


def _search_end(inset: Axes, found: Mapping[str, fmuid.Result], index: int) -> None:
    """Show how the searches end, at the scale of the prior's standard deviation."""
    inset.axhline(0.0, color=INK, lw=0.8, ls=(0, (4, 3)))
    for kind, result in found.items():
        taken = result.trace[result.trace["accepted"].astype(bool)]
        errors = (taken[NAMES[index]] - TRUTH[index]) / PRIOR_STD[index]
        inset.plot(taken["iteration"], errors, color=COLOURS[kind], marker="o", ms=2.6, lw=1)
    last = max(result.history.iterations for result in found.values())
    inset.set_xlim(last - 3.3, last + 0.3)
    inset.set_ylim(-3.2, 3.2)
    inset.set_yticks([-2, 0, 2], ["−2 std", "truth", "+2 std"])
    inset.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
    inset.tick_params(labelsize=7, length=2, pad=1.5)
    inset.grid(visible=False)


def variance_figure(found: pd.DataFrame, drawn: float) -> Figure:
    """Draw the common noise variance against repetition (figures 1.5 and 1.6), and how a wrong prior delays it."""
    colours = (BLUE, INK, AMBER, GREY)
    with style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        panels = figure.subplots(1, 2)
        for axes, (prior, cases) in zip(panels, found.groupby("prior"), strict=True):
            axes.axhspan(0.98 * drawn, 1.02 * drawn, color=GREY, alpha=0.25, lw=0, label="noise drawn ± 2 %")
            # the smaller markers on the greater ones: what coincides is seen
            for (first, part), colour, size in zip(cases.groupby("first"), colours, (10, 7.5, 5, 2.5), strict=True):
                axes.plot(part["searches"], part["both"], color=colour, marker="o", ms=size, label=f"from {first:g} A²")
            steps = range(cases["searches"].max() + 1)
            axes.set_xticks(steps, ["first\nvalue", "first\nsearch", *(f"repetition\n{k}" for k in steps[1:-1])])
            axes.set_title(f"prior: {prior}")
        panels[0].set_yscale("log")
        panels[0].set_ylabel("noise variance (A²)")
        panels[1].set_xlim(0.7, found["searches"].max() + 0.3)
        panels[1].set_ylim(0.045, 0.054)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def draws_figure(errors: Floats) -> Figure:
    """Draw the errors of all draws, in prior standard deviations, and their root mean squares."""
    colours = (GREY, BLUE, AMBER)
    means = root_mean_squares(errors)
    spread = np.linspace(-0.32, 0.32, len(errors))
    with style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        panels = figure.subplots(1, len(NAMES), sharey=True)
        for index, (axes, name) in enumerate(zip(panels, NAMES, strict=True)):
            for place, (kind, colour) in enumerate(zip(KINDS, colours, strict=True)):
                half = float(means[name][kind])
                axes.plot(place + spread, errors[:, place, index], "o", color=colour, ms=2.4, mew=0, alpha=0.65)
                axes.hlines([-half, half], place - 0.4, place + 0.4, color=INK, lw=1.2, label="± root mean square")
                axes.text(place, 3.55, f"{half:.2f}", ha="center", color=INK, fontsize=8.5)
            axes.axhline(0.0, color=INK, lw=0.6)
            axes.set_xticks(range(len(KINDS)), [kind.replace(" ", "\n") for kind in KINDS])
            axes.set_title(f"${SYMBOLS[name]}$")
            axes.grid(visible=False, axis="x")
        panels[0].set_ylim(-3.4, 4.0)
        panels[0].set_ylabel("error / prior's std")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles[:1], labels[:1], loc="outside lower center")
    return figure


# --- tables -----------------------------------------------------------------------------


def estimates_table(found: Mapping[str, fmuid.Result]) -> str:
    """Return the estimates beside the chapter's, as Markdown."""
    heads, rows = ["", "truth", "prior", *(f"{whose} {kind}" for kind in found for whose in ("chapter", "ours"))], []
    for i, name in enumerate(NAMES):
        cells = [f"{SYMBOLS[name]} ({UNITS[name]})", f"{TRUTH[i]:g}", with_std(PRIOR_MEAN[i], PRIOR_STD[i])]
        for kind, result in found.items():
            cells += [f"{CHAPTER[kind][i] or '–'}", with_std(result.values[i], result.std[i])]
        rows.append(cells)
    return pages.table(heads, rows)


def iterations_table(found: pd.DataFrame) -> str:
    """Return iterations and simulations, mean and range over the starts of a kind, as Markdown."""
    columns = [f"{what} {kind}" for what in ("iterations", "simulations") for kind in COLOURS]
    rows = []
    for name, part in found.groupby("starts", sort=False):
        spans = [(part[c].mean(), part[c].min(), part[c].max()) for c in columns]
        cells = [f"{mean:.1f} ({low}–{high})" if low < high else f"{low}" for mean, low, high in spans]
        rows.append([str(name), str(len(part)), *cells])
    return pages.table(["starts", "how many", *columns], rows)


def variance_table(found: pd.DataFrame, drawn: Mapping[str, float]) -> str:
    """Return the noise variances after each search, A², as Markdown."""
    last = int(found["searches"].max())
    rows = []
    for (prior, first), part in found.groupby(["prior", "first"]):
        after = [f"{value:.5f}" for value in part["both"].tolist()[1:]]
        rows.append([str(prior), f"{first:g}", *after, *["–"] * (last - len(after))])
    rows.append(["**noise drawn**", *[""] * last, f"{drawn['both']:.5f}"])
    return pages.table(["prior", "first value", "first search", *(f"repetition {k}" for k in range(1, last))], rows)


def draws_table(errors: Floats) -> str:
    """Return the root mean squares of the errors, in units and together in prior standard deviations, as Markdown."""
    rows = []
    for kind, values in root_mean_squares(errors).iterrows():
        own = values[list(NAMES)].to_numpy(dtype=float) * PRIOR_STD
        rows.append([str(kind), *(f"{value:#.2g}" for value in own), f"{values['all']:.2f}"])
    return pages.table(["", *(f"{SYMBOLS[name]} ({UNITS[name]})" for name in NAMES), "all four, in prior std"], rows)


def main() -> None:
    """Rewrite tables, figures and the tables in README.md."""
    clean = make_table.simulate()
    table = fmuid.read_data(HERE / "table.csv")
    data = experiment(table)
    found, counts, variances, drawn = pair(data), iterations(data), repetition(data), drawn_variance(clean, table)
    began = time.perf_counter()
    errors = draws(clean, DRAWS, SEED)
    print(f"{2 * DRAWS} identifications in {time.perf_counter() - began:.1f} s")
    common = estimate(data, prior_mean=PRIOR_MEAN, noise=fmuid.Noise(NOISE_VARIANCE, delay_std=0.0))
    moved = np.abs(common.values - found["with prior"].values) / found["with prior"].std
    print(f"one common variance, {NOISE_VARIANCE} A², moves the estimates by {moved.max():.3f} std at most")

    pages.write(counts, HERE / "iterations.csv", "%.9g")
    pages.write(variances, HERE / "variance.csv")
    columns = [f"{name} {kind}" for kind in KINDS for name in NAMES]
    pages.write(pd.DataFrame(errors.reshape(len(errors), -1), columns=columns), HERE / "draws.csv", "%.4f")
    pages.save(search_figure(found), HERE / "search.png")
    pages.save(variance_figure(variances, drawn["both"]), HERE / "variance.png")
    pages.save(draws_figure(errors), HERE / "draws.png")
    tables = {
        "estimates": estimates_table(found),
        "iterations": iterations_table(counts),
        "variance": variance_table(variances, drawn),
        "draws": draws_table(errors),
    }
    pages.rewrite(HERE, tables)


if __name__ == "__main__":
    main()
