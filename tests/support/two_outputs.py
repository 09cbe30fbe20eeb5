"""A problem with two outputs of known noise."""

from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Parameter
from fmuid.estimation.problem import LeastSquares

TIMES = np.linspace(0.0, 3.0, 100)


def two_outputs(theta: Floats) -> Floats:
    k, gain = theta
    return np.column_stack([1e3 * gain * np.exp(-k * TIMES), 1e-3 * gain * np.sin(k * TIMES)])


def two_output_problem(seed: int = 1, **words: Any) -> LeastSquares:
    noise = np.random.default_rng(seed).standard_normal((100, 2)) * [20.0, 1e-4]
    parameters = {"k": Parameter(0.8, min=0.0), "gain": Parameter(3.0)} | words.pop("parameters", {})
    measured = two_outputs(np.array([1.5, 2.0])) + noise
    return LeastSquares.from_function(two_outputs, measured, parameters, outputs=("u", "i"), times=TIMES, **words)
