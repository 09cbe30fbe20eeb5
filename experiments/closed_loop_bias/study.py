"""The bias of an output-error estimate from a closed loop, against signal-to-noise ratio (docs/method/covariance.md).

    python -m experiments.closed_loop_bias.study

Run from the project's folder; it rewrites bias.csv and bias.png beside it and the table in README.md.

A coil under a sampled PI control of its current: three coupled FMUs. The noise of the current's sensor is an input of
the simulation, so that the controller sees it. R and L are identified from the controller's voltage, which is known
exactly, and the measured current. Beside it: the predicted bias (1.29), the same noise in open loop, and the loop
identified as a whole, from its reference.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.linalg import toeplitz
from scipy.signal import lfilter, max_len_seq

import fmuid
from experiments import pages
from experiments.pages import AMBER, BLUE, GREY, INK
from fmuid.array_types import Floats
from fmuid.identification import Assessment, assess, find_model_errors, judge, refit
from fmuid.reports.render.matplotlib_renderer import WIDTH, style

HERE = Path(__file__).parent
FMUS = HERE.parents[1] / "fmus"

R, L = 4.0, 0.1  # Ω, H: the coil of docs/method/coil.md
NAMES, TRUTH = ("R", "L"), np.array([R, L])
STEP, SAMPLES, BIT = 1e-3, 1200, 15  # s; samples of the record and of a bit of the reference, as there
AMPLITUDE = 0.25  # A, of the reference
CONTROL = {"controller.K": 20.0, "controller.Ti": L / R}  # V/A, s: the current follows with L/K = 5 ms
COLOR = 0.8  # correlation of the colored noise from sample to sample: it lasts as long as the loop takes to answer

RATIOS = (300.0, 100.0, 30.0, 10.0, 3.0, 1.0)  # power of the current without noise over the power of the noise


class Kind(NamedTuple):
    """Whether noise passes the controller, its correlation, and whether the loop is identified from its reference."""

    closed: bool
    correlation: float
    whole: bool = False


KINDS = {
    "open loop, colored noise": Kind(False, COLOR),
    "closed loop, white noise": Kind(True, 0.0),
    "closed loop, colored noise": Kind(True, COLOR),
    "closed loop identified whole, colored noise": Kind(True, COLOR, whole=True),
}
SHORT = ("open", "white", "closed", "whole")
"""Names of the kinds in the table."""
DRAWS, SEED = 200, 1
JUDGED = 20  # records of each kind and ratio


# --- simulation and estimate ------------------------------------------------------------


def reference() -> Floats:
    """Return the wanted current, A (SAMPLES,): a maximum-length sequence."""
    bits = 2.0 * max_len_seq(7)[0] - 1.0
    return np.asarray(AMPLITUDE * bits[np.arange(SAMPLES) // BIT % bits.size])


@cache
def loop() -> fmuid.System:
    """Return the coil, the sensor and the controller; they exchange their values at every sample."""
    models = {"coil": "Coil", "sensor": "CurrentSensor", "controller": "CoilController"}
    run = {"controller": fmuid.Numerics(samples=True)}
    return fmuid.System(
        components={
            name: fmuid.Component(FMUS / model / f"{model}.fmu", run.get(name, fmuid.Numerics()))
            for name, model in models.items()
        },
        connections=[
            ("coil.i", "sensor.i"),
            ("sensor.measured", "controller.i"),
            ("controller.u", "coil.u"),
        ],
    )


@cache
def coil() -> fmuid.System:
    """Return the model that is identified, loaded once."""
    return fmuid.System.of(FMUS / "Coil" / "Coil.fmu")


def simulate(noise: Floats) -> pd.DataFrame:
    """Return what the loop does.

    Columns: ``time`` (s); voltage ``u`` (V); ``reference``, true current ``i`` and ``measured`` one (A).
    """
    times = STEP * np.arange(SAMPLES)
    inputs = {"controller.reference": "reference", "sensor.noise": "noise"}
    outputs = {"controller.u": "u", "coil.i": "i", "sensor.measured": "measured"}
    frame = pd.DataFrame(
        {"time": times, "reference": reference(), "noise": noise, **dict.fromkeys(outputs.values(), 0.0)}
    )
    experiment = fmuid.Experiment(frame, inputs, outputs, interpolation="zoh")
    found = fmuid.Simulator(loop(), experiment, values={"coil.R": R, "coil.L": L, **CONTROL})([])
    return frame[["time", "reference"]].assign(**dict(zip(outputs.values(), found.T, strict=True)))


def problem(record: pd.DataFrame, whole: bool) -> fmuid.Problem:
    """Return the identification of R and L from voltage (held between samples) and measured current."""
    inputs, outputs = {"u": "u"}, {"i": "measured"}
    if whole:
        inputs, outputs = {"controller.reference": "reference"}, {"sensor.measured": "measured"}
    experiment = fmuid.Experiment(record, inputs, outputs, interpolation="zoh")
    names = [f"coil.{name}" if whole else name for name in NAMES]
    parameters = {name: fmuid.Parameter(value) for name, value in zip(names, TRUTH.tolist(), strict=True)}
    model, values = (loop(), CONTROL) if whole else (coil(), None)
    return fmuid.Problem(model, experiment, parameters, values=values, noise=fmuid.Noise(delay_std=0.0))


def estimate(record: pd.DataFrame, whole: bool) -> fmuid.Result:
    """Identify R and L."""
    result = fmuid.identify(problem(record, whole))
    if not result.converged:
        raise RuntimeError(f"the search did not converge: {fmuid.Document.of(result)}")
    return result


def noise(rng: np.random.Generator, correlation: float) -> Floats:
    """Draw stationary noise of variance 1 (SAMPLES,), its correlation over m samples being correlation**m."""
    white = rng.standard_normal(SAMPLES)
    white[1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], white))


def records(kind: Kind, ratio: float, rng: np.random.Generator, count: int) -> Iterator[pd.DataFrame]:
    """Yield records with fresh noise; the open loop replays the voltage without noise."""
    clean = simulate(np.zeros(SAMPLES))
    std = np.sqrt(np.mean(clean["i"] ** 2) / ratio)
    for _ in range(count):
        added = std * noise(rng, kind.correlation)
        yield simulate(added) if kind.closed else clean.assign(measured=clean["i"] + added)


def draws(kind: Kind, ratio: float, rng: np.random.Generator, count: int) -> Floats:
    """Return estimates of R and L (count, 2)."""
    return np.array([estimate(each, kind.whole).values for each in records(kind, ratio, rng, count)])


def verdicts(kind: Kind, ratio: float, count: int = JUDGED) -> Counter[str]:
    """Count the verdicts of some records: passed, or the gravest doubt."""
    found = Counter[str]()
    for record in records(kind, ratio, np.random.default_rng([SEED, 2]), count):
        own = problem(record, kind.whole)
        result = fmuid.identify(own)
        tested = own.as_in(result)
        errors = find_model_errors(tested, result)
        again = refit(tested, result, errors) if errors is not None and errors.errors else None
        base, last = (tested, result) if again is None else (again.problem, again.result)
        known = Assessment(model_errors=errors if again is None else again.found)
        verdict = judge(last, assess(base, last, earlier=known))
        found[verdict.reasons[0].value if verdict.reasons else verdict.grade.value] += 1
    return found


# --- prediction -------------------------------------------------------------------------


def sensitivities(voltage: Floats) -> Floats:
    """Return ∂i/∂R and ∂i/∂L of the coil under a held voltage (K, 2), in closed form from sample to sample."""
    decay = np.exp(-R / L * STEP)
    # i[k+1] = decay i[k] + gain u[k], gain = (1 - decay)/R, and its derivatives
    decay_by = decay * STEP * np.array([-1.0 / L, R / L**2])
    gain_by = -decay_by / R - np.array([(1.0 - decay) / R**2, 0.0])
    current = lfilter([0.0, (1.0 - decay) / R], [1.0, -decay], voltage)
    return np.column_stack(
        [lfilter([0.0, 1.0], [1.0, -decay], a * current + b * voltage) for a, b in zip(decay_by, gain_by, strict=True)]
    )


def answer_to_noise() -> Floats:
    """Return the voltage (SAMPLES,) with which the loop answers to a sensor that is 1 A wrong in the first sample."""
    decay = np.exp(-R / L * STEP)
    gain, integral_time = CONTROL.values()
    current = integral = 0.0
    voltage = np.empty(SAMPLES)
    for k in range(SAMPLES):
        error = -current - (k == 0)
        voltage[k] = gain * error + integral
        integral += gain / integral_time * STEP * error
        current = decay * current + (1.0 - decay) / R * voltage[k]
    return voltage


@cache
def moments(correlation: float) -> tuple[Floats, Floats]:
    """Return E[Σ σ b] (2,) and E[Σ σ_b σ_bᵀ] (2, 2) for noise b of variance 1; σ_b is the share of b in σ."""
    covariance = toeplitz(correlation ** np.arange(SAMPLES))
    responses = sensitivities(answer_to_noise()).T
    spread = [toeplitz(response, np.zeros(SAMPLES)) for response in responses]  # σ_b = spread @ b
    passed = [each @ covariance for each in spread]
    gram = np.array([[np.sum(left * right) for right in spread] for left in passed])
    return np.array([np.trace(each) for each in passed]), gram


def predicted(kind: Kind, ratio: float) -> Floats:
    """Return the bias of R and L to first order, E[Σ σσᵀ]⁻¹ E[Σ σ b] (1.29), with σ at the truth, Ω and H (2,).

    It is zero where the inputs know nothing of the noise.
    """
    if kind.whole or not kind.closed:
        return np.zeros(len(NAMES))
    clean = simulate(np.zeros(SAMPLES))
    variance = np.mean(clean["i"] ** 2) / ratio
    own = sensitivities(clean["u"].to_numpy())
    with_noise, gram = moments(kind.correlation)
    return np.asarray(np.linalg.solve(own.T @ own + variance * gram, variance * with_noise))


# --- results ----------------------------------------------------------------------------


def cell(kind: str, ratio: float, count: int = DRAWS) -> pd.DataFrame:
    """Return bias, its error, std and prediction as shares of the truth, a row a parameter."""
    rng = np.random.default_rng([SEED, list(KINDS).index(kind), RATIOS.index(ratio)])
    found = draws(KINDS[kind], ratio, rng, count) / TRUTH - 1.0
    std = found.std(axis=0, ddof=1)
    return pd.DataFrame(
        {
            "kind": kind,
            "ratio": ratio,
            "parameter": NAMES,
            "bias": found.mean(axis=0),
            "error": std / np.sqrt(count),
            "std": std,
            "predicted": predicted(KINDS[kind], ratio) / TRUTH,
        }
    )


def table(found: pd.DataFrame) -> str:
    """Return the biases in per cent as Markdown, a row a ratio; those predicted, if not zero, in brackets."""
    rows = []
    for ratio, part in found.groupby("ratio", sort=False):
        cells = [f"{ratio:g}"]
        for bias, error, wanted in part[["bias", "error", "predicted"]].to_numpy(dtype=float).tolist():
            expected = f" [{100 * wanted:.2f}]" if wanted else ""
            cells.append(f"{100 * bias:.2f} ± {100 * error:.2f}{expected}".replace("-", "−"))
        rows.append(cells)
    return pages.table(["ratio", *(f"{name}, {kind}" for kind in SHORT for name in NAMES)], rows)


def verdict_table() -> str:
    """Return the verdicts as Markdown, a row a ratio."""
    rows = []
    for ratio in RATIOS[1:5]:
        told = (verdicts(kind, ratio) for kind in KINDS.values())
        rows.append(
            [f"{ratio:g}", *(", ".join(f"{count} {name}" for name, count in each.most_common()) for each in told)]
        )
    return pages.table(["ratio", *SHORT], rows)


def figure(found: pd.DataFrame) -> Figure:
    """Draw the bias against the signal-to-noise ratio: per cent above, in standard deviations of an estimate below."""
    with style():
        drawn = Figure(figsize=(WIDTH, 5.0), layout="constrained")
        panels = drawn.subplots(2, len(NAMES), sharex=True, sharey="row")
        for column, name in enumerate(NAMES):
            part = found[found["parameter"] == name]
            _panel(panels[0, column], part, pd.Series(100.0, part.index))
            _panel(panels[1, column], part, 1.0 / part["std"])
            panels[0, column].set_title(f"${name}$")
            panels[1, column].set_xlabel("power of the current / power of the noise")
        panels[0, 0].set_ylabel("bias (%)")
        panels[1, 0].set_ylabel("bias / std of one estimate")
        legend = sorted(zip(*panels[0, 0].get_legend_handles_labels(), strict=True), key=lambda pair: pair[1])
        drawn.legend(*zip(*legend[::-1], strict=True), loc="outside lower center", ncols=2)
    return drawn


def _panel(axes: Axes, part: pd.DataFrame, scale: pd.Series) -> None:
    """Draw one parameter's biases, times a scale, with two standard errors either way, beside their prediction."""
    axes.axhline(0.0, color=INK, lw=0.6)
    looks = ((GREY, 0.88), (BLUE, 0.96), (AMBER, 1.04), (INK, 1.12))  # side by side, not upon each other
    for (kind, rows), (colour, aside) in zip(part.groupby("kind", sort=False), looks, strict=True):
        factor = scale[rows.index]
        places, bars = rows["ratio"] * aside, 2.0 * rows["error"] * factor
        label = f"{kind}: drawn, ± 2 standard errors"
        axes.errorbar(places, rows["bias"] * factor, bars, color=colour, fmt="o", ms=3.4, capsize=2.5, label=label)
        if rows["predicted"].any():
            expected = rows["predicted"] * factor
            axes.plot(places, expected, color=colour, ls=(0, (4, 3)), label=f"{kind}: predicted")
    axes.set_xscale("log")
    axes.set_xticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axes.minorticks_off()


def main() -> None:
    """Rewrite table and figure, and the table in README.md."""
    began = time.perf_counter()
    found = pd.concat([cell(kind, ratio) for kind in KINDS for ratio in RATIOS], ignore_index=True)
    count = len(KINDS) * len(RATIOS) * DRAWS
    print(f"{count} simulations and identifications in {time.perf_counter() - began:.1f} s")
    pages.write(found, HERE / "bias.csv")
    pages.save(figure(found), HERE / "bias.png")
    pages.rewrite(HERE, {"bias": table(found), "verdicts": verdict_table()})


if __name__ == "__main__":
    main()
