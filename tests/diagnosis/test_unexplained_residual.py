"""Something else: the change of what the residual owes to the inputs, its level and what it sees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fmuid.diagnosis.unexplained_residual import change, lagged, probability, regression

SAMPLES = 300


def test_lagged_inputs() -> None:
    """A constant, and sums over spans of lags; before the record there is nothing."""
    inputs = np.arange(8.0).reshape(4, 2)
    found = lagged(inputs, (0, 1, 3))
    assert found[:, 0] == pytest.approx(np.ones(4))
    assert found[:, 1:3] == pytest.approx(inputs)
    assert found[:, 3:] == pytest.approx(np.array([[0, 0], [0, 1], [2, 4], [6, 8]]))


def test_level_and_power() -> None:
    """Uniform where nothing changes, whatever both records have that the model has not; a late response is seen."""
    random = np.random.default_rng(1)
    probabilities: dict[bool, list[float]] = {False: [], True: []}
    inputs = np.sign(random.standard_normal((2, SAMPLES + 1, 1)))
    jacobians = random.standard_normal((2, SAMPLES, 2))
    for changed in (False, True):
        for _ in range(300):
            said = []
            for inputs_, jacobian, new in zip(inputs, jacobians, (False, True), strict=True):
                unknown = 0.3 * inputs_[:-1, 0] + 0.2
                late = 0.35 * inputs_[:-1, 0] if changed and new else 0.0
                data = unknown + late + random.standard_normal(SAMPLES)
                rest = data - jacobian @ np.linalg.lstsq(jacobian, data)[0]
                said.append(regression(rest, lagged(inputs_[:-1]), jacobian))
            probabilities[changed].append(probability(*change(*said)))
    assert stats.kstest(probabilities[False], "uniform").pvalue > 0.01
    assert np.mean(np.array(probabilities[True]) < 0.01) > 0.6


def test_directions_that_a_record_lacks_are_left_out() -> None:
    random = np.random.default_rng(2)
    regressors, jacobian = random.standard_normal((SAMPLES, 3)), np.zeros((SAMPLES, 1))
    jacobian[0] = 1.0
    silent = regressors * (1.0, 0.0, 1.0)
    both = regression(random.standard_normal(SAMPLES), regressors, jacobian)
    less = regression(random.standard_normal(SAMPLES), silent, jacobian)
    assert change(both, less)[1] == 2
    none = regression(np.ones(SAMPLES), np.zeros((SAMPLES, 3)), jacobian)
    assert change(both, none) == (0.0, 0)
    assert probability(0.0, 0) == 1.0
    assert change(both, both)[0] == pytest.approx(0.0)
