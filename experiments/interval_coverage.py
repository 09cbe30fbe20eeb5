"""How often intervals that claim 95 % hold the truth: ``python -m experiments.interval_coverage``.

The same experiment is drawn many times with fresh noise; each draw is identified, and its local, profile and posterior
intervals are compared with the truth. Two machines: the coil of docs/method/coil.md, and the induction machine of
section 8 (its table simulated by `induction_machine/make_table.py`, independently of the FMU). Noise variances are
estimated, as usual.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import max_len_seq
from scipy.stats import binom

import fmuid
from experiments.induction_machine import make_table
from fmuid.identification.posterior import SamplerSettings
from fmuid.identification.profile_likelihood import profile_likelihood
from fmuid.identification.sampler import sample_posterior

FMUS = Path(__file__).parents[1] / "fmus"
METHODS = ("local", "profile", "posterior")
LEVEL = 0.95
# Of 200 draws one parameter in ten strays by more than 2.5 % from what its intervals really cover, of 400 one in fifty.
DRAWS = 400
# Enough to place the ends of an interval within a tenth of a standard deviation, with the fewest walkers that will do.
SAMPLING = SamplerSettings(effective_size=700, walkers=8)

# The coil's experiment, docs/method/coil.md: ±1 V PRBS, bits of 15 samples, signal-to-noise ratio (of powers) 10.
COIL_SAMPLES, COIL_STEP, COIL_BIT, COIL_RATIO = 1200, 1e-3, 15, 10.0


@dataclass(frozen=True, eq=False)
class Case:
    """An experiment that can be drawn again and again."""

    name: str
    model: fmuid.System
    truth: Mapping[str, float]
    parameters: Mapping[str, fmuid.Parameter]
    draw: Callable[[np.random.Generator], fmuid.Experiment]

    def problem(self, seed: int) -> fmuid.estimation.LeastSquares:
        """Return the problem of one draw."""
        return fmuid.Problem(
            self.model, self.draw(np.random.default_rng(seed)), self.parameters, noise=fmuid.Noise(delay_std=0.0)
        )


@cache
def induction_machine() -> Case:
    """Return the induction machine: four parameters, 4500 samples of two currents, starts 50 % away."""
    frame = make_table.simulate()

    def draw(rng: np.random.Generator) -> fmuid.Experiment:
        table = make_table.add_noise(frame, make_table.NOISE_VARIANCE, rng)
        return fmuid.Experiment(table, inputs=["uds", "uqs", "w"], outputs=["ids", "iqs"])

    parameters = {
        "Rs": fmuid.Parameter(14.7, min=0.0),
        "Rr": fmuid.Parameter(1.9, min=0.0),
        "Lm": fmuid.Parameter(0.654, min=1e-3),
        "Lf": fmuid.Parameter(0.0381, min=1e-4),
    }
    system = fmuid.System.of(FMUS / "InductionMachine" / "InductionMachine.fmu")
    return Case("induction machine", system, make_table.TRUTH, parameters, draw)


@cache
def coil() -> Case:
    """Return the coil: two parameters, 1200 samples of its current."""
    truth = {"R": 4.0, "L": 0.1}
    bits = 2.0 * max_len_seq(7)[0] - 1.0
    voltage = bits[np.arange(COIL_SAMPLES) // COIL_BIT % bits.size]
    # held voltage: from one sample to the next the current decays towards u/R
    decay = np.exp(-truth["R"] / truth["L"] * COIL_STEP)
    current = np.zeros(COIL_SAMPLES)
    for k in range(COIL_SAMPLES - 1):
        current[k + 1] = decay * current[k] + (1.0 - decay) * voltage[k] / truth["R"]
    std = float(np.sqrt(np.mean(current**2) / COIL_RATIO))
    frame = pd.DataFrame({"time": COIL_STEP * np.arange(COIL_SAMPLES), "u": voltage, "i": current})

    def draw(rng: np.random.Generator) -> fmuid.Experiment:
        table = frame.assign(i=current + std * rng.normal(size=COIL_SAMPLES))
        return fmuid.Experiment(table, inputs=["u"], outputs=["i"], interpolation="zoh")

    parameters = {"R": fmuid.Parameter(2.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-6)}
    return Case("coil", fmuid.System.of(FMUS / "Coil" / "Coil.fmu"), truth, parameters, draw)


CASES: dict[str, Callable[[], Case]] = {"coil": coil, "induction_machine": induction_machine}


def covered(case: str, level: float, sampling: SamplerSettings, seed: int) -> NDArray[np.bool_]:
    """Draw once and return which intervals hold the truth, (methods, parameters)."""
    drawn = CASES[case]()
    problem = drawn.problem(seed)
    result = fmuid.identify(problem)
    posterior = sample_posterior(problem, result, sampling)
    if not (result.converged and posterior.converged):
        raise RuntimeError(f"{case}, draw {seed}: {fmuid.Document.of(result)}; {fmuid.Document.of(posterior)}")
    ends = [
        result.intervals(level).to_numpy(),
        np.array([(p.lower, p.upper) for p in profile_likelihood(problem, result, level=level)]),
        posterior.intervals(level).to_numpy(),
    ]
    truth = np.array(list(drawn.truth.values()))
    return np.array([(lower <= truth) & (truth <= upper) for lower, upper in (pair.T for pair in ends)])


def coverage(
    case: str, draws: int, *, level: float = LEVEL, sampling: SamplerSettings = SAMPLING, processes: int = 1
) -> pd.DataFrame:
    """Return the share of draws whose intervals hold the truth, a row a parameter, a column a method."""
    job = partial(covered, case, level, sampling)
    if processes == 1:
        found = [job(seed) for seed in range(draws)]
    else:
        with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
            found = list(pool.map(job, range(draws)))
    shares = np.mean(found, axis=0)
    return pd.DataFrame(shares.T, index=list(CASES[case]().truth), columns=list(METHODS))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Coverage of 95 % intervals over repeated noise.")
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    low, high = (100 * count / given.draws for count in binom.interval(0.95, given.draws, LEVEL))
    print(f"{given.draws} draws; a method that covers exactly 95 % gives {low:.1f} to {high:.1f} %")
    for name in CASES:
        table = coverage(name, given.draws, processes=given.processes)
        print(f"\n{name}:")
        print((100 * table).round(1).to_string())


if __name__ == "__main__":
    main()
