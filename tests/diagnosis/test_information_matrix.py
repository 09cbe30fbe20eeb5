"""Information of records and of changes in one, against generalized least squares over all samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics

UNITS = np.array([1e3, 1.0, 1e-5, 2.0])  # coordinates of very different magnitude, as ohms, henries and seconds are
SCALE = np.outer(UNITS, UNITS)


def record(seed: int, samples: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobian and a residual of white unit noise."""
    random = np.random.default_rng(seed)
    return random.standard_normal((samples, 4)) / UNITS, random.standard_normal(samples)


def test_changes_are_generalized_least_squares() -> None:
    """Noise and prior make one covariance of all samples, I + J C Jᵀ."""
    jacobian, residual = record(1)
    root = np.random.default_rng(2).standard_normal((4, 4))
    known = ChangePrior(0.1 * UNITS, root @ root.T * SCALE)
    news = ScoreStatistics.of(InformationMatrix.of(jacobian, residual), known)
    whole = np.eye(len(residual)) + jacobian @ known.covariance @ jacobian.T
    weighted = linalg.solve(whole, np.column_stack([jacobian, residual - jacobian @ known.mean]))
    assert news.information * SCALE == pytest.approx(jacobian.T @ weighted[:, :4] * SCALE, rel=1e-9)
    assert news.score * UNITS == pytest.approx(jacobian.T @ weighted[:, 4] * UNITS, rel=1e-8)


def test_prior_after_a_healthy_record() -> None:
    """m and C are those of the regression with a row for the normal range of each coordinate."""
    jacobian, residual = record(3)
    normal = np.array([5e2, 0.2, 1e-6, 30.0])
    known = ChangePrior.after(InformationMatrix.of(jacobian, residual), normal)
    stacked = np.vstack([jacobian * normal, np.eye(4)])
    mean = np.linalg.lstsq(stacked, np.concatenate([residual, np.zeros(4)]))[0] * normal
    covariance = np.linalg.inv(stacked.T @ stacked) * np.outer(normal, normal)
    assert known.mean / UNITS == pytest.approx(mean / UNITS, rel=1e-9)
    assert known.covariance / SCALE == pytest.approx(covariance / SCALE, rel=1e-9)


def test_scatter_of_records_is_model_error() -> None:
    """Where it is all that they scatter by, its covariance is theirs: once to find it, once for the next record."""
    jacobian, count = 1e6 * record(9)[0], 8
    truths = np.random.default_rng(10).standard_normal((count, 4)) * UNITS
    records = [InformationMatrix.of(jacobian, jacobian @ x) for x in truths]
    known = ChangePrior.after_several(records, 1e3 * UNITS)
    # of the inverse of a covariance of K records, (K - 1)/(K - 3): the variance of a t of K - 1 degrees of freedom
    expected = np.cov((truths / UNITS).T) * (1.0 + 1.0 / count) * (count - 1) / (count - 3)
    assert known.covariance / SCALE == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert known.mean / UNITS == pytest.approx(np.mean(truths / UNITS, axis=0))
    pooled = ChangePrior.after_several(records[:3], UNITS)
    alone = ChangePrior.after(sum(records[1:3], records[0]), UNITS)
    assert pooled.covariance == pytest.approx(alone.covariance)
    assert pooled.mean == pytest.approx(alone.mean)


@pytest.mark.campaign
def test_scores_without_changes_over_draws() -> None:
    """Over healthy and new records without a change, h ~ N(0, F): the level of every test rests on it."""
    random = np.random.default_rng(4)
    healthy, new = record(5)[0], record(6)[0]
    normal, drift = 50.0 * UNITS, 0.3 * UNITS
    scores = []
    for _ in range(4000):
        truth = normal * random.standard_normal(4)
        moved = truth + drift * random.standard_normal(4)
        known = ChangePrior.after(InformationMatrix.of(healthy, healthy @ truth + random.standard_normal(60)), normal)
        data = InformationMatrix.of(new, new @ moved + random.standard_normal(60))
        news = ScoreStatistics.of(data, known.drifting(drift))
        scores.append(linalg.solve_triangular(np.linalg.cholesky(news.information), news.score, lower=True))
    assert np.mean(scores, axis=0) == pytest.approx(np.zeros(4), abs=0.07)
    assert np.cov(np.array(scores).T) == pytest.approx(np.eye(4), abs=0.1)


@pytest.mark.campaign
def test_model_error_over_draws() -> None:
    """Scatter beyond the noise, in one direction, comes back as the covariance of a further record's estimate."""
    random, jacobian = np.random.default_rng(7), record(8)[0]
    error = np.outer([1.0, -1.0, 0.5, 0.0], [1.0, -1.0, 0.5, 0.0]) * SCALE
    off = []
    for _ in range(600):
        truths = random.multivariate_normal(np.zeros(4), error, size=13)
        records = [InformationMatrix.of(jacobian, jacobian @ x + random.standard_normal(60)) for x in truths]
        news = ScoreStatistics.of(records[0], ChangePrior.after_several(records[1:], 1e3 * UNITS))
        off.append(news.score @ np.linalg.solve(news.information, news.score))
    assert 2.5 < np.mean(off) < 5.5  # χ²_4; without the model's error far above
