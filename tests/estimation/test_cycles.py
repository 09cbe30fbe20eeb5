"""Errors that return with each cycle of an excitation: periods of inputs, folded rows, coverage.

``python -m tests.estimation.test_cycles 400`` counts how often intervals hold the truth.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
import pytest

from fmuid.arrays import Floats
from fmuid.data import Experiment, FunctionPredictor, Parameter
from fmuid.estimation.colour.cycles import Fold, period_of
from fmuid.estimation.colour.series import series_of
from fmuid.estimation.identification import identify
from fmuid.estimation.least_squares import LeastSquares
from tests.support.problems import ar1

STEP, PERIOD, CYCLES = 0.032, 125, 8
TRUTH = np.array([3.0, 1.0])
PARAMETERS = {"a": Parameter(2.5), "k": Parameter(1.3)}
CLOCK = STEP * np.arange(PERIOD)


def decay(theta: Floats) -> Floats:
    return np.asarray(theta[0] * np.exp(-theta[1] * CLOCK))


def recorded(inputs: Floats, output: Floats | None = None) -> Experiment:
    columns = {f"u{k}": own for k, own in enumerate(inputs.reshape(len(inputs), -1).T)}
    y = np.ones(len(inputs)) if output is None else output
    frame = pd.DataFrame({"time": STEP * np.arange(len(inputs)), **columns, "y": y})
    return Experiment(frame, list(columns), ["y"], interpolation="hold")


def square(cycles: float = CYCLES) -> Floats:
    return np.tile(np.repeat([1.0, 0.0], [60, 65]), CYCLES)[: round(cycles * PERIOD)]


def cyclic(seed: int, error: float, cycles: int = CYCLES) -> LeastSquares:
    """A decay in each cycle, with an error that returns, of so many times the noise, and the noise."""
    rng = np.random.default_rng(seed)
    again = np.tile(error * ar1(rng, 0.8, PERIOD), cycles)
    y = np.tile(decay(TRUTH), cycles) + 0.05 * (again + rng.standard_normal(again.size))
    predictor = FunctionPredictor(lambda theta: np.tile(decay(theta), cycles), (y.size, 1))
    return LeastSquares([predictor], [recorded(square(cycles), y)], PARAMETERS)


@pytest.mark.parametrize("cycles", [8, 3.6, 1.95])
def test_periods_of_inputs(cycles: float) -> None:
    assert period_of(recorded(square(cycles))) == pytest.approx(PERIOD * STEP)


def test_periods_of_measured_inputs_and_of_several() -> None:
    rng = np.random.default_rng(0)
    wave = np.sin(2.0 * np.pi * np.arange(1000) / 250)
    measured = wave + 0.01 * rng.standard_normal(1000)
    assert period_of(recorded(measured)) == pytest.approx(250 * STEP, abs=3 * STEP)
    assert period_of(recorded(np.column_stack([square(), wave, np.ones(1000)]))) == pytest.approx(250 * STEP)


@pytest.mark.parametrize("kind", ["ramp", "noise", "constant", "step", "short"])
def test_what_does_not_repeat_has_no_period(kind: str) -> None:
    n = np.arange(1000)
    inputs = {
        "ramp": 0.01 * n,
        "noise": np.random.default_rng(0).standard_normal(1000),
        "constant": np.ones(1000),
        "step": (n > 300).astype(float),
        "short": square(1.7),
    }
    assert period_of(recorded(inputs[kind])) == 0.0


def test_folded_rows_are_rows_turned() -> None:
    problem = cyclic(0, 1.0)
    fold = Fold.of(series_of(problem.experiments, ("y",)), problem.experiments, problem.measured.size)
    columns = np.random.default_rng(1).standard_normal((problem.measured.size, 3))
    folded = fold.columns(columns)
    np.testing.assert_allclose(folded.T @ folded, columns.T @ columns)
    means = columns.reshape(CYCLES, PERIOD, 3).mean(axis=0)
    left, mean = (folded[each.rows] for each in fold.series)
    np.testing.assert_allclose(mean, np.sqrt(CYCLES) * means)
    np.testing.assert_allclose(left, columns - np.tile(means, (CYCLES, 1)), atol=1e-12)
    # the variance of what is left of n cycles is that of n − 1
    assert np.var(fold.residual(columns[:, 0])[fold.series[0].rows]) == pytest.approx(
        np.var(left[:, 0]) * CYCLES / (CYCLES - 1)
    )


def test_sensitivities_that_repeat_are_judged_by_the_mean_cycle() -> None:
    """As if the mean cycle had been measured, and nothing else."""
    problem = cyclic(3, 2.0)
    mean = problem.measured.reshape(CYCLES, PERIOD).mean(axis=0)
    alone = identify(LeastSquares.from_function(decay, mean, PARAMETERS, times=CLOCK))
    result = identify(problem)
    np.testing.assert_allclose(result.values, alone.values, rtol=1e-5)
    np.testing.assert_allclose(result.covariance, alone.covariance, rtol=1e-3)
    assert result.noise is not None
    assert result.local is not None
    gram = result.noise.gram(result.local.jacobian @ result.local.root)
    np.testing.assert_allclose(result.local.root @ gram @ result.local.root.T, result.covariance, rtol=1e-6)


def covered(error: float, draws: int) -> tuple[float, float]:
    """Return the shares of 95 % intervals, and of those for white noise, that hold the truth."""
    inside, white = [], []
    for seed in range(draws):
        result = identify(cyclic(seed, error))
        ends = result.intervals().to_numpy()
        inside.append((ends[:, 0] <= TRUTH) & (ends[:, 1] >= TRUTH))
        white.append(np.abs(result.values - TRUTH) < 1.96 * result.white_std)
    return float(np.mean(inside)), float(np.mean(white))


@pytest.mark.slow
def test_intervals_hold_where_an_error_returns() -> None:
    inside, white = covered(3.0, 100)
    assert inside > 0.88
    assert white < 0.4


if __name__ == "__main__":
    for level in (0.0, 0.3, 1.0, 3.0):
        inside, white = covered(level, int(sys.argv[1]))
        print(f"| {level:g} | {100 * inside:.1f} | {100 * white:.1f} |", flush=True)
