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
    assert news.squares == pytest.approx((residual - jacobian @ known.mean) @ weighted[:, 4], rel=1e-9)


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
