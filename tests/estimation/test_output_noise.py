"""Noise of an output: lines, color and tails, against the spectrum and the distributions that made it."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.signal import lfilter

import fmuid
from fmuid.estimation import OutputNoise, output_noise

STEP, COUNT = 1e-3, 4000
TIME = STEP * np.arange(COUNT)


def noise_of(residual: np.ndarray, measured: np.ndarray | None = None) -> OutputNoise:
    values = residual if measured is None else measured
    frame = pd.DataFrame({"time": TIME, "u": 0.0, "y": values})
    return output_noise([(fmuid.Experiment(frame, ["u"], ["y"]), residual[:, None])])["y"]


def hum(amplitude: float, frequency: float = 50.3) -> np.ndarray:
    return np.asarray(amplitude * np.cos(2 * math.pi * frequency * TIME + 1.0))


def test_a_line_is_found_at_its_frequency() -> None:
    rng = np.random.default_rng(3)
    colored = lfilter([1.0], [1.0, -0.6], rng.standard_normal(COUNT))
    found = noise_of(colored + hum(0.7))
    assert found.lines == pytest.approx([50.3], abs=0.02)
    # beside the line: the process that was filtered
    assert found.process.coefficients[0] == pytest.approx(0.6, abs=0.06)
    assert found.process.std == pytest.approx(1.25, rel=0.05)
    assert found.limit == math.inf and (found.slope, found.power) == (1.0, 1.0)


def test_a_line_of_the_excitation_stays() -> None:
    """The model explains most of the measured line: only the rest is in the residual."""
    rng = np.random.default_rng(4)
    residual = rng.standard_normal(COUNT) + hum(0.5)
    assert noise_of(residual).lines.size == 1
    assert noise_of(residual, residual + hum(2.0)).lines.size == 0


@pytest.mark.slow
def test_few_lines_are_found_in_noise() -> None:
    counts = [noise_of(np.random.default_rng([5, k]).standard_normal(COUNT)).lines.size for k in range(40)]
    assert sum(counts) == 0


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_heavy_tails_are_limited(share: float) -> None:
    """The estimate of a mean has the stated variance, and less than that of least squares."""
    rng, draws, size = np.random.default_rng(6), 200, 500
    found = noise_of(lfilter([1.0], [1.0, -share], stats.t.rvs(3, size=COUNT, random_state=rng)))
    assert math.isfinite(found.limit)
    frame = pd.DataFrame({"time": TIME[:size], "u": 0.0, "y": 0.0})
    (series,) = fmuid.estimation.output_series([fmuid.Experiment(frame, ["u"], ["y"])], ["y"])
    scores, information = [], 0.0
    for _ in range(draws):
        values = lfilter([1.0], [1.0, -share], stats.t.rvs(3, size=size + 300, random_state=rng))[300:]
        white = found.whiten(series, np.column_stack([values, np.ones(size)]))
        scores.append(white[:, 1] @ white[:, 0])
        information = float(white[:, 1] @ white[:, 1])
    assert np.var(scores) == pytest.approx(information, rel=0.35)
    normal = size * (1.0 - share) ** 2 / 3.0  # information of least squares: variance of t3 is 3
    assert information > 1.2 * normal


def test_a_far_point_is_left_in_one_step() -> None:
    """Fifty deviations from the estimate all innovations were at the limit, and a step was one deviation."""
    rng = np.random.default_rng(16)
    found = noise_of(stats.t.rvs(3, size=COUNT, random_state=rng))
    (series,) = fmuid.estimation.output_series(
        [fmuid.Experiment(pd.DataFrame({"time": TIME, "u": 0.0, "y": 0.0}), ["u"], ["y"])], ["y"]
    )
    column = np.sin(0.01 * np.arange(COUNT))
    off = np.column_stack([50.0 * column + stats.t.rvs(3, size=COUNT, random_state=rng), column])
    white = found.whiten(series, off)
    information = float(white[:, 1] @ white[:, 1])
    assert math.isfinite(found.limit)
    assert white[:, 1] @ white[:, 0] / information == pytest.approx(50.0, abs=4.0 / math.sqrt(information))


def test_normal_noise_is_whitened_only() -> None:
    found = noise_of(np.random.default_rng(7).standard_normal(COUNT))
    assert (found.limit, found.slope, found.power) == (math.inf, 1.0, 1.0)
    assert found.share == pytest.approx(1.0, abs=0.1)
