"""Unexplained change: change of the residual's regression on the inputs, its level and power."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fmuid.diagnosis.unexplained_residual import change, lagged, probability, regression

SAMPLES = 300


def test_level_and_power() -> None:
    """Uniform where nothing changes, whatever both records have that the model has not; a late response is seen."""
    random = np.random.default_rng(1)
    found: dict[bool, list[float]] = {False: [], True: []}
    inputs, jacobians = np.sign(random.standard_normal((2, SAMPLES + 1))), random.standard_normal((2, SAMPLES, 2))
    for changed in (False, True):
        for _ in range(150):
            said = []
            for given, jacobian, new in zip(inputs[:, :-1], jacobians, (False, True), strict=True):
                data = (0.65 if changed and new else 0.3) * given + 0.2 + random.standard_normal(SAMPLES)
                rest = data - jacobian @ np.linalg.lstsq(jacobian, data)[0]
                said.append(regression(rest, lagged(given[:, None]), jacobian))
            found[changed].append(probability(*change(*said)))
    assert stats.kstest(found[False], "uniform").pvalue > 0.01
    assert np.mean(np.array(found[True]) < 0.01) > 0.6


def test_directions_that_a_record_lacks_are_left_out() -> None:
    random = np.random.default_rng(2)
    regressors, jacobian = random.standard_normal((SAMPLES, 3)), np.zeros((SAMPLES, 1))
    jacobian[0] = 1.0
    scales = ((1.0, 1.0, 1.0), (1.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    both, less, none = (regression(random.standard_normal(SAMPLES), regressors * each, jacobian) for each in scales)
    assert change(both, less)[1] == 2
    assert change(both, none) == (0.0, 0)
    assert probability(0.0, 0) == 1.0
    assert change(both, both)[0] == pytest.approx(0.0)
