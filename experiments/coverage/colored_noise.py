"""Coverage of intervals, and rejections by tests, under colored noise, over seeded draws.

``python -m experiments.coverage.colored_noise 400`` prints the table of the page over so many draws. Further arguments:
profile and posterior in one of so many draws, the cases, and the samples.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import stats
from scipy.signal import lfilter

from fmuid.array_types import Floats
from fmuid.data import Parameter
from fmuid.estimation import Evaluator, LeastSquares, Result
from fmuid.identification import identify
from fmuid.identification.posterior import SamplerSettings
from fmuid.identification.profile_likelihood import profile_likelihood
from fmuid.identification.sampler import sample_posterior

SEED, STD, LEVEL, TEST = 2026, 0.05, 0.95, 0.01
SAMPLING = SamplerSettings(effective_size=700, walkers=8)

Noise = Callable[[np.random.Generator, int], Floats]


def white(rng: np.random.Generator, count: int) -> Floats:
    """Return white noise."""
    return rng.standard_normal(count)


def oscillating(rng: np.random.Generator, count: int) -> Floats:
    """Return an autoregression of order 2."""
    noise = lfilter([1.0], [1.0, -1.6, 0.9], rng.standard_normal(count + 500))[500:]
    return np.asarray(noise / np.sqrt(18.1))


def ar1(rng: np.random.Generator, share: float, count: int) -> Floats:
    """Return noise of variance 1 whose autocorrelation is share^lag, from a start in its own distribution."""
    steps = rng.standard_normal(count) * math.sqrt(1.0 - share**2)
    steps[0] /= math.sqrt(1.0 - share**2)
    return np.asarray(lfilter([1.0], [1.0, -share], steps))


def ar(share: float) -> Noise:
    """Return draws of `ar1`."""
    return lambda rng, count: ar1(rng, share, count)


def slow(rng: np.random.Generator, count: int) -> Floats:
    """White noise with 8 % of the variance slow: weak at each sample, nine times the white noise at frequency 0."""
    return math.sqrt(0.92) * rng.standard_normal(count) + math.sqrt(0.08) * ar1(rng, 0.98, count)


@dataclass(frozen=True)
class Draw:
    """A problem and its truth."""

    problem: LeastSquares
    truth: Floats


def decay(noise: Noise, rng: np.random.Generator, count: int, missing: float = 0.0) -> Draw:
    """Return a e^(−kt) with `count` samples beside a share of missing ones."""
    times, truth = np.linspace(0.0, 4.0, round(count / (1.0 - missing))), np.array([3.0, 1.0])
    y = truth[0] * np.exp(-truth[1] * times) + STD * noise(rng, times.size)
    y[rng.random(times.size) < missing] = np.nan
    parameters = {"a": Parameter(2.5), "k": Parameter(1.3)}
    return Draw(LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * times), y, parameters, times=times), truth)


def crossed(rng: np.random.Generator, count: int) -> Draw:
    """Two outputs of different colors whose innovations are correlated by 0.8."""
    times, truth = np.linspace(0.0, 4.0, count), np.array([3.0, 1.0])
    common = np.linalg.cholesky([[1.0, 0.8], [0.8, 1.0]]) @ rng.standard_normal((2, count + 200))
    noise = [lfilter([np.sqrt(1 - f**2)], [1.0, -f], own)[200:] for f, own in zip((0.8, 0.3), common, strict=True)]

    def both(p: Floats) -> Floats:
        return np.column_stack([p[0] * np.exp(-p[1] * times), p[0] * (1.0 - np.exp(-p[1] * times))])

    parameters = {"a": Parameter(2.5), "k": Parameter(1.3)}
    y = both(truth) + STD * np.column_stack(noise)
    return Draw(LeastSquares.from_function(both, y, parameters, times=times, outputs=("u", "v")), truth)


def unequal(rng: np.random.Generator, count: int) -> Draw:
    """Three outputs: every sample, every fourth and every tenth, with a parameter of its own each but the first."""
    times, truth = np.linspace(0.0, 4.0, count), np.array([3.0, 1.0, 2.0, 1.0])

    def three(p: Floats) -> Floats:
        shape = np.exp(-p[1] * times)
        return np.column_stack([p[0] * shape, p[2] * (1.0 - shape), p[3] * np.cos(p[1] * times)])

    y = three(truth) + STD * np.column_stack([ar1(rng, 0.5, count) for _ in range(3)])
    y[np.arange(count) % 4 > 0, 1] = np.nan
    y[np.arange(count) % 10 > 0, 2] = np.nan
    parameters = {"a": Parameter(2.5), "k": Parameter(1.3), "b": Parameter(1.5), "c": Parameter(0.7)}
    return Draw(LeastSquares.from_function(three, y, parameters, times=times, outputs=("u", "v", "w")), truth)


def on_bound(rng: np.random.Generator, count: int) -> Draw:
    """Return a e^(−kt) + c, c ≥ 0 and 0 in truth."""
    times, truth = np.linspace(0.0, 4.0, count), np.array([3.0, 1.0, 0.0])
    y = truth[0] * np.exp(-truth[1] * times) + STD * ar1(rng, 0.5, count)
    parameters = {"a": Parameter(2.5), "k": Parameter(1.3), "c": Parameter(0.1, min=0.0)}
    return Draw(
        LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * times) + p[2], y, parameters, times=times), truth
    )


CASES: dict[str, Callable[[np.random.Generator, int], Draw]] = {
    "white": partial(decay, white),
    "AR(1) 0.2": partial(decay, ar(0.2)),
    "AR(1) 0.5": partial(decay, ar(0.5)),
    "AR(1) 0.8": partial(decay, ar(0.8)),
    "AR(2), oscillating": partial(decay, oscillating),
    "white and slow": partial(decay, slow),
    "two outputs, crossed": crossed,
    "AR(1) 0.5, a third missing": partial(decay, ar(0.5), missing=1.0 / 3.0),
    "three outputs, unequal": unequal,
    "truth on a bound": on_bound,
}


@dataclass
class Count:
    """Over draws: shares of parameters inside their intervals, tests that reject, and widths against white noise."""

    draws: int = 0
    more: int = 0
    local: float = 0.0
    plain: float = 0.0
    profile: float = 0.0
    posterior: float = 0.0
    ratio: float = 0.0
    wald: float = 0.0
    wider: tuple[float, ...] = ()

    def add(self, draw: Draw, result: Result, more: bool, seed: int) -> None:
        """Count one draw."""
        truth = draw.truth
        self.draws += 1
        self.local += held(result.intervals(LEVEL).to_numpy(), truth)
        self.plain += float(np.mean(np.abs(result.values - truth) < 1.96 * result.estimates.std_white_noise))
        self.wider += (
            float(np.mean(result.estimates.quantiles(LEVEL) * result.std / (1.96 * result.estimates.std_white_noise))),
        )
        names, count = list(result.names), truth.size
        freedom = result.estimates.test_dof(names)
        fall = rise(draw, result)
        self.ratio += fall / result.estimates.test_scale(names) / count > stats.f.ppf(1.0 - TEST, count, freedom)
        off = result.values - truth
        square = float(off @ np.linalg.solve(result.covariance, off))
        self.wald += square / count > stats.f.ppf(1.0 - TEST, count, freedom)
        if more:
            self.more += 1
            found = profile_likelihood(draw.problem, result, level=LEVEL)
            self.profile += held(np.array([(each.lower, each.upper) for each in found]), truth)
            samples = sample_posterior(draw.problem, result, SamplerSettings(**{**vars(SAMPLING), "seed": seed}))
            self.posterior += held(samples.intervals(LEVEL).to_numpy(), truth)


def held(ends: Floats, truth: Floats) -> float:
    """Return the share of the truths within intervals (N, 2)."""
    return float(np.mean((ends[:, 0] <= truth) & (truth <= ends[:, 1])))


def rise(draw: Draw, result: Result) -> float:
    """Return by how much the criterion is higher at the truth, with the variances of the result."""
    problem = draw.problem
    weights = np.array([result.fit.variance[name] for name in problem.output_names])[problem.groups]
    misses = problem.measured - Evaluator(problem).predict(np.array([draw.truth, result.values]))
    there, least = np.sum(misses**2 / weights, axis=1)
    return float(there - least)


def count(case: str, samples: int, draws: int, every: int = 0) -> Count:
    """Count over seeded draws of a case; one in `every` has profile and posterior too."""
    found = Count()
    for seed in range(draws):
        draw = CASES[case](np.random.default_rng([SEED, seed]), samples)
        result = identify(draw.problem)
        found.add(draw, result, bool(every) and seed % every == 0, seed)
    return found


def main(draws: int, every: int, names: list[str], samples: list[int]) -> None:
    """Print the table."""
    print("| noise | samples | local | profile | posterior | of (1.31) | width against (1.31) | LR test | F test |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in names:
        for n in samples:
            found = count(name, n, draws, every)
            cells = [f"{100 * found.local / found.draws:.1f}"]
            cells += [
                f"{100 * each / found.more:.1f}" if found.more else "–" for each in (found.profile, found.posterior)
            ]
            cells += [f"{100 * found.plain / found.draws:.1f}", f"{np.median(found.wider):.2f}"]
            cells += [f"{100 * value / found.draws:.1f}" for value in (found.ratio, found.wald)]
            print(f"| {name} | {n} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(
        int(words[0]),
        int(words[1]) if len(words) > 1 else 4,
        words[2].split(";") if len(words) > 2 else list(CASES),
        [int(n) for n in words[3].split(",")] if len(words) > 3 else [40, 200, 1000],
    )
