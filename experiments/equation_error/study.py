"""Bias of estimates by equation error against the signal-to-noise ratio, on the coil of the method's section 10.

    python -m experiments.equation_error.study

Run from the project's folder; it rewrites bias.csv, the figure and the tables in README.md. The data are the closed
form of R i + L di/dt = u for a held voltage, made without any FMU; the output error is that of the FMU.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import fmuid
from experiments import pages
from experiments.coil.study import SAMPLES, STEP, L, R, current, experiment, models, voltage
from experiments.pages import AMBER, BLUE, GREY, INK
from fmuid.array_types import Floats
from fmuid.reports.render.matplotlib_renderer import WIDTH, style

HERE = Path(__file__).parent
RATIOS = (1000.0, 100.0, 10.0, 3.0)  # of the powers of the current and its noise
DRAWS, SEED = 50, 1
NEAR, FAST = R / L, 10.0 * R / L  # rad/s: the coil's own corner, and a filter ten times as fast
TIMES = STEP * np.arange(SAMPLES)
VOLTAGE = fmuid.estimation.Term(voltage(), interpolation="zoh")
TRUTH = np.array([R, L])


def terms(i: Floats) -> dict[str, fmuid.estimation.Term]:
    """Return what stands behind R and L in R i + L di/dt = u."""
    return {"R": fmuid.estimation.Term(i), "L": fmuid.estimation.Term(i, derivative=1)}


def of_difference(a: float, b: float) -> Floats:
    """Return R and L of i_k = a i_(k−1) + b u_(k−1): a = e^(−R h/L), b = (1 − a)/R."""
    resistance = (1.0 - a) / b
    return np.array([resistance, -resistance * STEP / math.log(a)])


def difference(i: Floats) -> Floats:
    """Return R and L by least squares of the difference equation."""
    rows = np.column_stack([i[:-1], voltage()[:-1]])
    a, b = fmuid.estimation.linear_least_squares(rows, i[1:], ["a", "b"]).values.tolist()
    return of_difference(a, b)


def filtered(cutoff: float) -> Callable[[Floats], Floats]:
    """Return the estimator by least squares of the filtered equation."""
    return lambda i: fmuid.estimation.equation_error(TIMES, VOLTAGE, terms(i), cutoff=cutoff).values


def instruments(cutoff: float) -> Callable[[Floats], Floats]:
    """Return the estimator by instruments, simulated by the closed form."""
    return lambda i: (
        fmuid.estimation.instrumental_variables(
            TIMES, VOLTAGE, terms(i), lambda theta: terms(current(*theta.tolist())), cutoff=cutoff
        ).values
    )


def output_error(i: Floats) -> Floats:
    """Return R and L by output error of the FMU, from the filtered equation's."""
    start = fmuid.estimation.equation_error(TIMES, VOLTAGE, terms(i), cutoff=NEAR)
    parameters = {name: fmuid.Parameter(start[name], min=1e-4) for name in start.names}
    record = experiment(pd.DataFrame({"time": TIMES, "u": voltage(), "i": i}))
    result = fmuid.identify(fmuid.Problem(models()[0], record, parameters, noise=fmuid.Noise(delay_std=0.0)))
    if not result.converged:
        raise RuntimeError(f"the search did not converge: {fmuid.Document.of(result)}")
    return result.values


METHODS: dict[str, Callable[[Floats], Floats]] = {
    "difference equation": difference,
    "filter at 40 rad/s": filtered(NEAR),
    "filter at 400 rad/s": filtered(FAST),
    "IV, filter at 40 rad/s": instruments(NEAR),
    "IV, filter at 400 rad/s": instruments(FAST),
    "output error": output_error,
}


# --- theory -----------------------------------------------------------------------------


def limit_of_difference(variance: float) -> Floats:
    """Return where the difference equation ends up: (M + diag(σ², 0))⁻¹ M θ, with M = Σ φφᵀ/K without noise."""
    clean = current(R, L)
    rows = np.column_stack([clean[:-1], voltage()[:-1]])
    moments, decay = rows.T @ rows / len(rows), math.exp(-R / L * STEP)
    a, b = np.linalg.solve(moments + np.diag([variance, 0.0]), moments @ [decay, (1.0 - decay) / R]).tolist()
    return of_difference(a, b)


def lags(cutoff: float, signal: Floats) -> Floats:
    """Return a signal that is linear between its samples, and its derivative, through 1/(s/λ + 1)² from rest (K, 2).

    The two states of the filter over a step of h, with v = v₀ + (v₁ − v₀) τ/h, in closed form.
    """
    x = cutoff * STEP
    fade, one, two, found = math.exp(-x), 0.0, 0.0, np.zeros((signal.size, 2))
    for k in range(1, signal.size):
        slope = (signal[k] - signal[k - 1]) / x  # a unit of λτ
        # particular solution: z₁ = v − s, z₂ = v − 2 s; the rest fades as c₁ e^(−x), (c₂ + c₁ x) e^(−x)
        c1, c2 = one - (signal[k - 1] - slope), two - (signal[k - 1] - 2.0 * slope)
        one, two = signal[k] - slope + c1 * fade, signal[k] - 2.0 * slope + (c2 + c1 * x) * fade
        found[k] = two, cutoff * (one - two)
    return found


def limit_of_filtered(cutoff: float, variance: float) -> Floats:
    """Return where the filtered equation ends up: (M + σ² Σ g gᵀ)⁻¹ M θ, g the filter's answers to one sample."""
    pulse = np.zeros(SAMPLES)
    pulse[1] = 1.0
    answers, clean = lags(cutoff, pulse), lags(cutoff, current(R, L))
    moments = clean.T @ clean / SAMPLES
    return np.asarray(np.linalg.solve(moments + variance * answers.T @ answers, moments @ TRUTH))


def theory(method: str, ratio: float) -> Floats:
    """Return the relative bias (2,) of R and L for a long record."""
    variance = float(np.mean(current(R, L) ** 2)) / ratio
    if method == "difference equation":
        return np.asarray(limit_of_difference(variance) / TRUTH - 1.0)
    if method.startswith("filter"):
        return np.asarray(limit_of_filtered(FAST if "400" in method else NEAR, variance) / TRUTH - 1.0)
    return np.zeros(2)


# --- results ----------------------------------------------------------------------------


def draws(method: str, ratio: float, count: int = DRAWS) -> Floats:
    """Return the relative errors (count, 2) of R and L; the noise is the same for all methods."""
    rng, clean = np.random.default_rng(SEED), current(R, L)
    std = math.sqrt(float(np.mean(clean**2)) / ratio)
    estimate = METHODS[method]
    found = [estimate(clean + std * rng.standard_normal(SAMPLES)) for _ in range(count)]
    return np.asarray(np.array(found) / TRUTH - 1.0)


def measure(count: int = DRAWS) -> pd.DataFrame:
    """Return mean, spread and theory of the errors in per cent, a row a method, ratio and parameter."""
    rows = []
    for method in METHODS:
        for ratio in RATIOS:
            errors, expected = 100.0 * draws(method, ratio, count), 100.0 * theory(method, ratio)
            for j, name in enumerate("RL"):
                rows.append((method, ratio, name, errors[:, j].mean(), errors[:, j].std(), expected[j]))
    return pd.DataFrame(rows, columns=["method", "ratio", "parameter", "mean", "std", "theory"])


def signed(value: float) -> str:
    """Return a number with a digit and its sign, but for zero."""
    text = f"{value:+.1f}".replace("-", "−")
    return "0.0" if text in ("+0.0", "−0.0") else text


def table(found: pd.DataFrame) -> str:
    """Return the errors as Markdown, a row a method and parameter, the theory in brackets."""
    rows = []
    for method in METHODS:
        for name in "RL":
            part = found[(found["method"] == method) & (found["parameter"] == name)].set_index("ratio")
            cells = []
            for mean, std, expected in part.loc[list(RATIOS)][["mean", "std", "theory"]].to_numpy().tolist():
                cells.append(f"{signed(mean)} ± {std:.1f}" + (f" ({signed(expected)})" if expected else ""))
            rows.append([method if name == "R" else "", name, *cells])
    return pages.table(["%", "", *(f"{ratio:g}" for ratio in RATIOS)], rows)


def figure(found: pd.DataFrame) -> Figure:
    """Draw the error of each estimator against the ratio, with its spread, and the theory."""
    marks = zip(METHODS, (AMBER, BLUE, INK, BLUE, INK, GREY), ("-", "-", "-", ":", ":", "--"), strict=True)
    with style():
        drawn = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        panels = drawn.subplots(1, 2)
        for method, colour, line in marks:
            for axes, name in zip(panels, "RL", strict=True):
                part = found[(found["method"] == method) & (found["parameter"] == name)]
                axes.errorbar(part["ratio"], part["mean"], part["std"], color=colour, ls=line, capsize=2, label=method)
        for axes, name in zip(panels, "RL", strict=True):
            axes.set_xscale("log")
            axes.set_xlabel("power of the current / of its noise")
            axes.set_ylabel(f"error of {name} (%)")
            axes.set_ylim(-80.0, 60.0)
        drawn.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


def main() -> None:
    """Rewrite data, table and figure."""
    began = time.perf_counter()
    found = measure()
    pages.write(found, HERE / "bias.csv", "%.4f")
    print(f"{DRAWS * len(RATIOS) * len(METHODS)} estimates in {time.perf_counter() - began:.0f} s")
    pages.save(figure(found), HERE / "bias.png")
    pages.rewrite(HERE, {"bias": table(found)})


if __name__ == "__main__":
    main()
