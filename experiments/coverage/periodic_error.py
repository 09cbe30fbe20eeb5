"""Coverage of intervals beside a periodic model error: ``python -m experiments.coverage.periodic_error 400``.

It prints the table of the page over so many seeded draws. The problem is the linearized a e^(−kt) in each of eight
cycles; both parameters are 0 in truth.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy import stats

from experiments.coverage.colored_noise import ar1
from fmuid.array_types import Floats
from fmuid.data import Experiment, Parameter
from fmuid.estimation import LeastSquares, Result, sandwich_of
from fmuid.estimation.noise.sandwich import SandwichCovariance
from fmuid.identification import identify

STEP, PERIOD, CYCLES = 0.032, 125, 8
COUNT = PERIOD * CYCLES
CLOCK = STEP * np.arange(PERIOD)
JACOBIAN = np.tile(np.column_stack([np.exp(-CLOCK), -3.0 * CLOCK * np.exp(-CLOCK)]), (CYCLES, 1))
PARAMETERS = {"a": Parameter(0.1), "k": Parameter(0.1)}

Drawn = Callable[[np.random.Generator], Floats]


def recorded(inputs: Floats, output: Floats | None = None) -> Experiment:
    """Return an experiment of columns of inputs and outputs."""
    columns = {f"u{k}": own for k, own in enumerate(inputs.reshape(len(inputs), -1).T)}
    y = np.ones(len(inputs)) if output is None else output
    measured = {f"y{k or ''}": own for k, own in enumerate(y.reshape(len(y), -1).T)}
    frame = pd.DataFrame({"time": STEP * np.arange(len(inputs)), **columns, **measured})
    return Experiment(frame, list(columns), list(measured), interpolation="zoh")


def square(cycles: float = CYCLES) -> Floats:
    """Return an input of so many cycles."""
    return np.tile(np.repeat([1.0, 0.0], [60, 65]), CYCLES)[: round(cycles * PERIOD)]


def fitted(noise: Floats) -> tuple[LeastSquares, Result]:
    """Identify from noise (n,), or of several outputs (n, m)."""
    outputs = noise.size // COUNT
    names = tuple(f"y{k or ''}" for k in range(outputs))
    function = LeastSquares.from_function(
        lambda theta: np.repeat((JACOBIAN @ theta)[:, None], outputs, 1),
        noise.reshape(COUNT, outputs),
        PARAMETERS,
        outputs=names,
    )
    problem = LeastSquares(function.predictors, [recorded(square(), noise)], PARAMETERS)
    return problem, identify(problem)


def returns(level: float, share: float = 0.8) -> Drawn:
    """Return draws of one error in each cycle."""
    return lambda rng: level * np.tile(ar1(rng, share, PERIOD), CYCLES)


def ar(share: float) -> Drawn:
    """Return draws of `ar1`."""
    return lambda rng: ar1(rng, share, COUNT)


def white(rng: np.random.Generator) -> Floats:
    """Return white noise."""
    return rng.standard_normal(COUNT)


def walk(rng: np.random.Generator) -> Floats:
    """Return a random walk."""
    return 0.1 * np.cumsum(rng.standard_normal(COUNT))


def twice(level: float, *signs: float) -> Drawn:
    """One error in outputs of the same sensitivities, or in each an error of its own, beneath white noise."""

    def draw(rng: np.random.Generator) -> Floats:
        errors = np.column_stack([returns(level)(rng) for _ in range(1 if signs else 2)])
        return np.asarray(errors * np.array(signs or (1.0, 1.0)) + rng.standard_normal((COUNT, 2)))

    return draw


CASES: dict[str, tuple[Drawn, ...]] = {
    "white": (white,),
    "AR(1) 0.5": (ar(0.5),),
    "AR(1) 0.8": (ar(0.8),),
    "AR(1) 0.99": (ar(0.99),),
    "random walk": (walk,),
    "error 0.3 of white noise": (returns(0.3), white),
    "error 1": (returns(1.0), white),
    "error 3": (returns(3.0), white),
    "error 1, AR(1) 0.95": (returns(1.0, 0.95), white),
    "error 1, AR(1) 0.8 noise": (returns(1.0), ar(0.8)),
    "error 1, AR(1) 0.99 noise": (returns(1.0), ar(0.99)),
    "error 1, random walk": (returns(1.0), walk),
    "error 3, random walk and white": (returns(3.0), walk, white),
    "two outputs, error 1 in both": (twice(1.0, 1.0, 1.0),),
    "two outputs, error 1 with opposite signs": (twice(1.0, 1.0, -1.0),),
    "two outputs, error 1 of its own in each": (twice(1.0),),
    "two outputs, white": (twice(0.0),),
}


def without_error(problem: LeastSquares, result: Result) -> SandwichCovariance:
    """Return the covariance of the noise alone."""
    assert result.fit.linearization is not None
    aperiodic = problem._with(periods=dict.fromkeys(problem.periods, 0.0))
    return sandwich_of(aperiodic, result.fit.linearization, np.zeros(problem.counts.size, dtype=np.bool_))


def covered(parts: tuple[Drawn, ...], draws: int) -> tuple[float, float, float]:
    """Return coverage with and without the periodic error, and the ratio of the widths."""
    inside, without, wider = [], [], []
    for seed in range(draws):
        rng = np.random.default_rng([11, seed])
        problem, result = fitted(np.sum([part(rng) for part in parts], axis=0))
        ends = result.intervals().to_numpy()
        inside.append((ends[:, 0] <= 0.0) & (ends[:, 1] >= 0.0))
        before = without_error(problem, result)
        half = np.asarray(stats.t.ppf(0.975, before.freedom) * np.sqrt(np.diag(before.covariance)))
        without.append(np.abs(result.values) < half)
        wider.append(float(np.mean((ends[:, 1] - ends[:, 0]) / (2.0 * half))))
    return float(np.mean(inside)), float(np.mean(without)), float(np.median(wider))


if __name__ == "__main__":
    print("| noise and error | coverage | without what returns | width against it |")
    print("|---|---|---|---|")
    for name in sys.argv[2].split(";") if len(sys.argv) > 2 else CASES:
        inside, without, wider = covered(CASES[name], int(sys.argv[1]))
        print(f"| {name} | {100 * inside:.1f} | {100 * without:.1f} | {wider:.3f} |", flush=True)
