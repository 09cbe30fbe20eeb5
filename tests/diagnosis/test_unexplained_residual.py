"""Unexplained change: structure of the residual beside healthy records, its level and power."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import stats

from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix
from fmuid.diagnosis.unexplained_residual import (
    HealthyStructure,
    StructureStatistics,
    UnexplainedResidual,
    lagged,
    levels,
)

SAMPLES = 300


WIDE = ChangePrior(np.zeros(2), 1e4 * np.eye(2))


def regression(residual: np.ndarray, regressors: np.ndarray, jacobian: np.ndarray) -> InformationMatrix:
    return InformationMatrix.of(np.hstack([jacobian, regressors]), residual)


def said(rng: np.random.Generator, share: float) -> InformationMatrix:
    """Return the regression of a record whose residual has a share of the input."""
    given, jacobian = np.sign(rng.standard_normal(SAMPLES)), rng.standard_normal((SAMPLES, 2))
    return regression(share * given + 0.2 + rng.standard_normal(SAMPLES), lagged(given[:, None]), jacobian)


def examined(
    healthy: Sequence[InformationMatrix], new: InformationMatrix, known: ChangePrior = WIDE, columns: int = 7
) -> UnexplainedResidual:
    structure = HealthyStructure({"all": tuple(range(columns))}, healthy, SAMPLES * len(healthy))
    return StructureStatistics.of(structure, [known] * len(healthy)).test(new, known, 1.0)


@pytest.mark.slow
def test_level_and_power_beside_one_record() -> None:
    """Uniform where nothing changes, whatever both records have that the model has not; a late response is seen."""
    rng = np.random.default_rng(1)
    false, true = ([examined([said(rng, 0.3)], said(rng, new)).probability for _ in range(150)] for new in (0.3, 0.65))
    assert stats.kstest(false, "uniform").pvalue > 0.01
    assert np.mean(np.array(true) < 0.01) > 0.6


@pytest.mark.slow
def test_structure_that_healthy_records_scatter_by_is_no_change() -> None:
    """Operating points with responses of their own: as much in a new record is healthy, four times as much is not."""
    rng = np.random.default_rng(4)
    false, true = [], []
    for _ in range(40):
        healthy = [said(rng, share) for share in rng.normal(0.3, 0.3, 10)]
        false.append(examined(healthy, said(rng, rng.normal(0.3, 0.3))).probability)
        true.append(examined(healthy, said(rng, 2.7)).probability)
    assert np.mean(np.array(false) < 0.05) < 0.12
    assert np.mean(np.array(true) < 0.05) > 0.9


def test_directions_that_a_record_lacks_are_left_out() -> None:
    rng = np.random.default_rng(2)
    jacobian = np.zeros((SAMPLES, 2))
    jacobian[[0, 1], [0, 1]] = 1.0
    full, less, none = (
        regression(rng.standard_normal(SAMPLES), rng.standard_normal((SAMPLES, 3)) * each, jacobian)
        for each in (np.ones(3), np.array([1.0, 0.0, 1.0]), np.zeros(3))
    )
    assert examined([full], less, columns=3).degrees == 2
    assert examined([less], full, columns=3).degrees == 2
    assert examined([full], none, columns=3).probability == pytest.approx(1.0)
    assert examined([none], full, columns=3).probability == pytest.approx(1.0)


def test_known_coordinates_leave_what_they_cannot_explain() -> None:
    """A regressor along a coordinate shows by as much as the coordinate is known; a free one takes all of it."""
    rng, along = np.random.default_rng(5), np.zeros((SAMPLES, 2))
    along[:, 0], along[:, 1] = rng.standard_normal((2, SAMPLES))
    healthy = [regression(rng.standard_normal(SAMPLES), along[:, :1], along) for _ in range(8)]
    new = regression(rng.standard_normal(SAMPLES) + 0.5 * along[:, 0], along[:, :1], along)
    tight = ChangePrior(np.zeros(2), 0.01**2 * np.eye(2))
    assert examined(healthy, new, tight, 1).probability < 1e-3
    free = StructureStatistics.of(HealthyStructure({"all": (0,)}, healthy, SAMPLES * 8), [tight] * 8)
    assert free.test(new, tight.drifting(np.array([1e3, 0.0])), 1.0).probability > 0.1


def test_slow_levels_pass_what_lasts_and_fast_sizes_what_is_large() -> None:
    times = np.arange(800.0)
    fast, slow = levels(np.column_stack([np.sin(times), np.minimum(times / 300.0, 1.0)]))
    assert np.ptp(fast[200:, 0]) < 0.1
    assert slow[200:, 0].max() < 1e-3
    assert slow[-1, 1] == pytest.approx(1.0, abs=0.03)
    assert slow[300, 1] < fast[300, 1]
