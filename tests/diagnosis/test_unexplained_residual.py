"""Unexplained change: structure of the residual beside healthy records, its level and power."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fmuid.diagnosis.information_matrix import InformationMatrix
from fmuid.diagnosis.unexplained_residual import HealthyStructure, UnexplainedResidual, lagged, regression

SAMPLES = 300


def said(rng: np.random.Generator, share: float) -> InformationMatrix:
    """Return the regression of a record whose residual has a share of the input."""
    given, jacobian = np.sign(rng.standard_normal(SAMPLES)), rng.standard_normal((SAMPLES, 2))
    return regression(share * given + 0.2 + rng.standard_normal(SAMPLES), lagged(given[:, None]), jacobian)


def examined(rng: np.random.Generator, healthy: list[float], new: float) -> UnexplainedResidual:
    records = [said(rng, share) for share in healthy]
    structure = HealthyStructure({"all": tuple(range(7))}, records, SAMPLES * len(records))
    return structure.test(said(rng, new), 1.0)


@pytest.mark.slow
def test_level_and_power_beside_one_record() -> None:
    """Uniform where nothing changes, whatever both records have that the model has not; a late response is seen."""
    rng = np.random.default_rng(1)
    false, true = ([examined(rng, [0.3], new).probability for _ in range(150)] for new in (0.3, 0.65))
    assert stats.kstest(false, "uniform").pvalue > 0.01
    assert np.mean(np.array(true) < 0.01) > 0.6


@pytest.mark.slow
def test_structure_that_healthy_records_scatter_by_is_no_change() -> None:
    """Operating points with responses of their own: as much in a new record is healthy, four times as much is not."""
    rng = np.random.default_rng(4)
    false, true = [], []
    for _ in range(40):
        healthy = rng.normal(0.3, 0.3, 10).tolist()
        false.append(examined(rng, healthy, rng.normal(0.3, 0.3)).probability)
        true.append(examined(rng, healthy, 2.7).probability)
    assert np.mean(np.array(false) < 0.05) < 0.12
    assert np.mean(np.array(true) < 0.05) > 0.9


def test_directions_that_a_record_lacks_are_left_out() -> None:
    rng, scale = np.random.default_rng(2), np.array([1.0, 0.0, 1.0])
    jacobian = np.zeros((SAMPLES, 1))
    jacobian[0] = 1.0
    full, less, none = (
        regression(rng.standard_normal(SAMPLES), rng.standard_normal((SAMPLES, 3)) * each, jacobian)
        for each in (np.ones(3), scale, np.zeros(3))
    )
    structure = HealthyStructure({"all": (0, 1, 2)}, [full], SAMPLES)
    assert structure.test(less, 1.0).degrees == 2
    assert structure.test(none, 1.0).probability == pytest.approx(1.0)


def test_regressors_that_the_model_spans_say_nothing() -> None:
    """Rounding of a constant beside an offset was a change of a hundred deviations in one of thirty records."""
    rng, healthy = np.random.default_rng(3), list[InformationMatrix]()
    for _ in range(8):
        given = 20.0 + np.repeat(rng.choice([-3.0, 3.0], SAMPLES // 30), 30)
        jacobian = np.column_stack([np.ones(SAMPLES), 1e3 + rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES)])
        healthy.append(regression(rng.standard_normal(SAMPLES), lagged(given[:, None]), jacobian))
    assert all(each.matrix[0, 0] == each.score[0] == 0.0 < each.matrix[1, 1] for each in healthy)
