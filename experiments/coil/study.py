"""Diagnosis of a coil (docs/method/coil.md, table 1.1): turns lost or gained, told from a warm winding.

    python -m experiments.coil.study

Run from the project's folder; it rewrites the tables (.csv), healthy/result.json and the figure (.png) beside it and
the tables in README.md. The data are the closed form of R i + L di/dt = u for a held voltage, made without any FMU.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import special
from scipy.signal import lfilter, max_len_seq

import fmuid
from experiments import pages
from experiments.pages import AMBER, BLUE, GREY, INK
from fmuid.array_types import Floats
from fmuid.reports.render.matplotlib_renderer import WIDTH, style

HERE = Path(__file__).parent
FMUS = HERE.parents[1] / "fmus"

R, L = 4.0, 0.1  # Ω, H: the healthy coil
TAU = L / R  # s
STEP, SAMPLES, BIT = 1e-3, 1200, 15  # s; samples of the record and of a bit of the ±1 V sequence
# Of the 127 phases of the sequence those of about 10 to 40 let the prior of R pull ΔR least, about 0.013 Ω in test 4;
# others up to 0.025 Ω.
PHASE = 30
RATIO = 10.0  # power of the healthy current over that of the noise
INFLATE = {"R": 10.0}  # of standard deviations: R follows the temperature, L does not
LEVEL = 0.01
DRAWS, ALARM_DRAWS, SEED = 200, 1000, 1


class Case(NamedTuple):
    """A test of table 1.1: the truth, and the chapter's estimates of R, L and ΔR."""

    R: float
    fault: float
    chapter: tuple[float, float, float]


TESTS = {
    1: Case(4.0, 1.0, (3.966, 0.0990, 1.066)),
    2: Case(5.0, 0.0, (4.965, 0.0988, 0.047)),
    3: Case(5.0, 0.2, (4.962, 0.0989, 0.172)),
    4: Case(5.0, 1.0, (5.066, 0.0989, 0.886)),
    5: Case(5.0, -0.2, (4.979, 0.0989, -0.148)),
}
WARM = (3.0, 4.0, 5.0, 6.0)  # Ω: resistances of a coil without fault


# --- the data ---------------------------------------------------------------------------


@cache
def voltage() -> Floats:
    """Return the voltage, V (SAMPLES,): a maximum-length sequence of ±1 V, from its bit number PHASE on."""
    bits = np.roll(2.0 * max_len_seq(7)[0] - 1.0, -PHASE)
    return np.asarray(bits[np.arange(SAMPLES) // BIT % bits.size])


def current(resistance: float, inductance: float) -> Floats:
    """Return the current from rest under the voltage, held between samples, A (SAMPLES,), in closed form."""
    decay = math.exp(-resistance / inductance * STEP)
    return np.asarray(lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage()))


def piecewise(voltage: Floats, coils: Iterable[tuple[float, float]], block: int, state: float = 0.0) -> Floats:
    """Return the current, A, under a held voltage, of a coil with other R (Ω) and L (H) in each block of samples."""
    current = np.empty(voltage.size)
    for k, (resistance, inductance) in enumerate(coils):
        part = slice(k * block, (k + 1) * block)
        decay = math.exp(-resistance / inductance * STEP)
        driven = lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage[part])
        current[part] = driven + state * decay ** np.arange(block)
        state = current[part][-1] * decay + (1.0 - decay) / resistance * voltage[part][-1]
    return current


NOISE_VARIANCE = float(np.mean(current(R, L) ** 2) / RATIO)  # A²


def record(resistance: float, fault: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return a record of the coil with ΔR = `fault` and ΔL = 2 τ ΔR: time, s; u, V; i with white noise, A."""
    clean = current(resistance + fault, L + 2.0 * TAU * fault)
    noise = math.sqrt(NOISE_VARIANCE) * rng.standard_normal(SAMPLES)
    return pd.DataFrame({"time": STEP * np.arange(SAMPLES), "u": voltage(), "i": clean + noise})


# --- identification and diagnosis -------------------------------------------------------


@cache
def models() -> tuple[fmuid.System, fmuid.System]:
    """Return the healthy and the faulty coil, loaded once."""
    healthy, faulty = (fmuid.System.of(FMUS / name / f"{name}.fmu") for name in ("Coil", "FaultyCoil"))
    return healthy, faulty


def experiment(table: pd.DataFrame) -> fmuid.Experiment:
    """Return a record as an experiment."""
    return fmuid.Experiment(table, ["u"], ["i"], interpolation="zoh")


def identify(table: pd.DataFrame) -> fmuid.Result:
    """Identify R and L of a healthy coil."""
    parameters = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-4)}
    result = fmuid.identify(fmuid.Problem(models()[0], experiment(table), parameters, noise=fmuid.Noise(delay_std=0.0)))
    if not result.converged:
        raise RuntimeError(f"the search did not converge: {fmuid.Document.of(result)}")
    return result


def diagnose(
    table: pd.DataFrame, healthy: fmuid.Result, inflate: float | dict[str, float] | None = None
) -> fmuid.Diagnosis:
    """Look for turns lost or gained."""
    coil, faulty = models()
    tau = healthy["L"] / healthy["R"]
    turns = fmuid.Fault(faulty, {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": tau})
    return fmuid.diagnose(
        experiment(table),
        fmuid.Baseline(healthy, INFLATE if inflate is None else inflate),
        {"turns": turns},
        coil,
        fmuid.diagnosis.DiagnosisSettings(LEVEL),
    )


def draws(resistance: float, fault: float, count: int, key: int) -> pd.DataFrame:
    """Return diagnoses of fresh records, each with a fresh healthy record."""
    rng = np.random.default_rng([SEED, key])
    rows = []
    for _ in range(count):
        healthy = identify(record(R, 0.0, rng))
        found = diagnose(record(resistance, fault, rng), healthy)
        size, common, evidence = found["turns.dR"], found.nominal, found.evidence
        numbers = (common["R"][0], common["L"][0], size.value, size.std, evidence.suspects[0].statistic)
        rows.append((*numbers, evidence.alarm, found.kind != "healthy"))
    return pd.DataFrame(rows, columns=["R", "L", "dR", "std", "D", "called", "alarm"])


# --- theory -----------------------------------------------------------------------------


def sensitivities(resistance: float, inductance: float) -> Floats:
    """Return ∂i/∂R and ∂i/∂L (SAMPLES, 2), by central differences of the closed form."""
    columns = []
    for step in ((1e-5, 0.0), (0.0, 1e-7)):
        ends = [current(resistance + sign * step[0], inductance + sign * step[1]) for sign in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * sum(step)))
    return np.column_stack(columns)


class Theory(NamedTuple):
    """Bias, spread over records and healthy records, stated σ of ΔR (Ω), and rate of calls, to first order."""

    bias: float
    spread: float
    stated: float
    rate: float


def theory(resistance: float, fault: float) -> Theory:
    """Return what to expect, from the sensitivities at the truth.

    The estimate is θ + C [Sᵀb/σ² + M₀⁻¹ (θ₀ − θ)] with C = (M₀⁻¹ + SᵀS/σ²)⁻¹ (1.47); the healthy estimate is the prior
    mean θ₀ of R and L, and gives the time constant of the fault model.
    """
    own = sensitivities(R, L)
    known = NOISE_VARIANCE * np.linalg.inv(own.T @ own)
    total = sensitivities(resistance + fault, L + 2.0 * TAU * fault)
    columns = np.column_stack([total, total[:, 0] + 2.0 * TAU * total[:, 1]])
    std = np.sqrt(np.diag(known)) * [INFLATE["R"], 1.0]
    prior = np.diag([*std**-2.0, 0.0])
    covariance = np.linalg.inv(prior + columns.T @ columns / NOISE_VARIANCE)
    bias = float((covariance @ prior @ [R - resistance, 0.0, 0.0])[2])
    # a healthy estimate that is off moves the prior mean and the time constant τ = L/R
    by_tau = -(covariance @ columns.T @ (2.0 * fault * total[:, 1]) / NOISE_VARIANCE)[2]
    by_healthy = (covariance @ prior)[2, :2] + by_tau * np.array([-L / R**2, 1.0 / R])
    noise = covariance @ (columns.T @ columns / NOISE_VARIANCE) @ covariance
    spread = math.sqrt(float(noise[2, 2] + by_healthy @ known @ by_healthy))
    stated = math.sqrt(float(covariance[2, 2]))
    limit = math.sqrt(special.fdtri(1, SAMPLES - 2, 1.0 - LEVEL)) * stated
    above, below = ((fault + bias - limit) / spread, (-limit - fault - bias) / spread)
    return Theory(bias, spread, stated, float(special.ndtr(above) + special.ndtr(below)))


# --- results ----------------------------------------------------------------------------


def single_table(found: dict[int, fmuid.Diagnosis]) -> str:
    """Return table 1.1 as Markdown: the truth, the chapter's row and ours for each test."""
    rows: list[tuple[object, ...]] = []
    for number, case in TESTS.items():
        size, common = found[number]["turns.dR"], found[number].nominal
        statistic = f"{found[number].kind}, D = {found[number].evidence.suspects[0].statistic:.4g}"
        ours = (f"{common['R'][0]:.3f}", f"{common['L'][0]:.4f}", f"{size.value:.3f} ± {size.std:.3f}")
        rows.append((number, "truth", f"{case.R:g}", f"{L:g}", signed(case.fault, "g")))
        rows.append(("", "chapter", f"{case.chapter[0]:.3f}", f"{case.chapter[1]:.4f}", signed(case.chapter[2], ".3f")))
        rows.append(("", "ours", *(each.replace("-", "−") for each in ours), statistic))
    return pages.table(["test", "", "R (Ω)", "L (H)", "ΔR (Ω)", "verdict"], rows)


def signed(value: float, digits: str) -> str:
    """Return a number with a minus sign of print."""
    return format(value, digits).replace("-", "−")


def draws_table(found: pd.DataFrame) -> str:
    """Return bias, spread and rate of the draws of each test, the theory in brackets, as Markdown."""
    heads = ["test", "mean error (Ω)", "spread (Ω)", "stated std", "called (%)", "any alarm (%)"]
    rows = []
    for number, case in TESTS.items():
        part, expected = found[found["test"] == number], theory(case.R, case.fault)
        error = part["dR"] - case.fault
        cells = [
            f"{error.mean():.4f} ± {error.std() / math.sqrt(len(part)):.4f} [{expected.bias:.4f}]",
            f"{error.std():.4f} [{expected.spread:.4f}]",
            f"{part['std'].mean():.4f}",
            f"{100 * part['called'].mean():.1f} [{100 * expected.rate:.1f}]",
            f"{100 * part['alarm'].mean():.1f}",
        ]
        rows.append([number, *(each.replace("-", "−") for each in cells)])
    return pages.table(heads, rows)


def alarms_table(found: pd.DataFrame) -> str:
    """Return the rates of false alarms against the resistance of the coil, the theory in brackets, as Markdown."""
    rows = []
    for resistance, count, called, alarms in found.to_numpy(dtype=float).tolist():
        expected = 100 * theory(resistance, 0.0).rate
        rows.append((f"{resistance:g}", f"{100 * called / count:.2f} [{expected:.2f}]", f"{100 * alarms / count:.2f}"))
    return pages.table(["R (Ω)", "fault called (%)", "any alarm (%)"], rows)


def figure(found: pd.DataFrame) -> Figure:
    """Draw the estimates of ΔR over the draws of each test, the truth, the chapter's, and the theory's density."""
    with style():
        drawn = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        panels = drawn.subplots(1, len(TESTS), sharey=True)
        for axes, (number, case) in zip(panels, TESTS.items(), strict=True):
            values, expected = found.loc[found["test"] == number, "dR"], theory(case.R, case.fault)
            axes.hist(values, bins=20, density=True, color=GREY, alpha=0.55, label=f"{len(values)} draws")
            grid = case.fault + expected.bias + expected.spread * np.linspace(-4.0, 4.0, 200)
            z = (grid - case.fault - expected.bias) / expected.spread
            density = np.exp(-0.5 * z**2) / (math.sqrt(2.0 * math.pi) * expected.spread)
            axes.plot(grid, density, color=BLUE, label="theory")
            axes.axvline(case.fault, color=INK, lw=1.0, label="truth")
            axes.axvline(case.chapter[2], color=AMBER, lw=1.4, ls=(0, (4, 2)), label="chapter's")
            axes.set_title(f"test {number}: R = {case.R:g} Ω")
            axes.set_xlabel("ΔR (Ω)")
        panels[0].set_ylabel("density (1/Ω)")
        drawn.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return drawn


def main() -> None:
    """Rewrite data, tables and figure."""
    began, rng = time.perf_counter(), np.random.default_rng(SEED)
    tables = {"healthy": record(R, 0.0, rng)}
    tables |= {f"test{number}": record(case.R, case.fault, rng) for number, case in TESTS.items()}
    for name, table in tables.items():
        table.round(6).to_csv(HERE / f"{name}.csv", index=False, lineterminator="\n")
    healthy = fmuid.Study.read(HERE / "healthy.toml").identify()
    (HERE / "healthy").mkdir(exist_ok=True)
    healthy.to_json(HERE / "healthy" / "result.json")
    single = {
        number: fmuid.Study.read(HERE / "test.toml", [f"experiments.0.data=test{number}.csv"]).diagnose()
        for number in TESTS
    }
    found = pd.concat(
        [draws(case.R, case.fault, DRAWS, number).assign(test=number) for number, case in TESTS.items()],
        ignore_index=True,
    )
    found = pages.write(found, HERE / "draws.csv")  # as the page is checked against it
    counts = []
    for k, resistance in enumerate(WARM):
        part = draws(resistance, 0.0, ALARM_DRAWS, 100 + k)
        counts.append((resistance, len(part), int(part["called"].sum()), int(part["alarm"].sum())))
    alarms = pd.DataFrame(counts, columns=["R", "draws", "called", "alarms"])
    pages.write(alarms, HERE / "alarms.csv")
    print(f"all diagnoses in {time.perf_counter() - began:.0f} s")
    pages.save(figure(found), HERE / "draws.png")
    written = {"single": single_table(single), "draws": draws_table(found), "alarms": alarms_table(alarms)}
    pages.rewrite(HERE, written)


if __name__ == "__main__":
    main()
