"""How often intervals hold the truth where the noise is coloured: seeded draws, few of them here.

``python -m tests.estimation.test_colour_coverage 400`` prints the table of docs/method.md section 12 over so many.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from fmuid.arrays import Floats
from fmuid.data.parameters import Parameter
from fmuid.estimation.identification import identify
from fmuid.estimation.least_squares import LeastSquares
from tests.support.problems import ar1

TRUTH = np.array([3.0, 1.0])


def oscillating(rng: np.random.Generator, count: int) -> Floats:
    noise = lfilter([1.0], [1.0, -1.6, 0.9], rng.standard_normal(count + 500))[500:]
    return np.asarray(noise / np.sqrt(18.1))


NOISE: dict[str, Callable[[np.random.Generator, int], Floats]] = {
    "white": lambda rng, count: rng.standard_normal(count),
    "AR(1) 0.2": lambda rng, count: ar1(rng, 0.2, count),
    "AR(1) 0.5": lambda rng, count: ar1(rng, 0.5, count),
    "AR(1) 0.8": lambda rng, count: ar1(rng, 0.8, count),
    "AR(2), oscillating": oscillating,
}


def coverage(kind: str, count: int, draws: int, missing: float = 0.0) -> tuple[float, float, float]:
    """Return the coverage, that of intervals for white noise, and by how much the ones are wider (median)."""
    times = np.linspace(0.0, 4.0, count)
    inside, white, wider = 0.0, 0.0, []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        y = TRUTH[0] * np.exp(-TRUTH[1] * times) + 0.05 * NOISE[kind](rng, count)
        y[rng.random(count) < missing] = np.nan
        parameters = {"a": Parameter(2.5), "k": Parameter(1.3)}
        problem = LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * times), y, parameters, times=times)
        result = identify(problem)
        off, half = np.abs(result.values - TRUTH), result.quantiles(0.95) * result.std
        plain = 1.96 * result.white_std
        inside, white = inside + np.mean(off < half), white + np.mean(off < plain)
        wider.append(np.mean(half / plain))
    return inside / draws, white / draws, float(np.median(wider))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "count", "missing"),
    [("AR(1) 0.8", 200, 0.0), ("AR(1) 0.8", 300, 1.0 / 3.0), ("AR(1) 0.5", 40, 0.0), ("AR(2), oscillating", 200, 0.0)],
)
def test_intervals_hold_where_those_of_white_noise_do_not(kind: str, count: int, missing: float) -> None:
    """Of 150 draws: 88 % is three standard errors of 95 % and more."""
    found, white, _ = coverage(kind, count, 150, missing)
    assert found > 0.88
    if kind.startswith("AR(1)"):
        assert white < 0.85


@pytest.mark.slow
def test_white_noise_costs_little() -> None:
    found, _, wider = coverage("white", 200, 100)
    assert found > 0.88
    assert wider < 1.05


if __name__ == "__main__":
    print("| noise | samples | coverage in % | (1.31) | width against (1.31) |\n|---|---|---|---|---|")
    for name in NOISE:
        for samples in (40, 200, 1000):
            held, before, width = coverage(name, samples, int(sys.argv[1]))
            print(f"| {name} | {samples} | {100 * held:.1f} | {100 * before:.1f} | {width:.2f} |", flush=True)
    for name in ("white", "AR(1) 0.8", "AR(2), oscillating"):
        held, before, width = coverage(name, 300, int(sys.argv[1]), 1.0 / 3.0)
        print(f"| {name} | 300, a third missing | {100 * held:.1f} | {100 * before:.1f} | {width:.2f} |", flush=True)
