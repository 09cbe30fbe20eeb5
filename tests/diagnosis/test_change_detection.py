"""Sizes with signs against bounded least squares, levels against closed forms, power against draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, special

from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import MinPDistribution, detectable, fit, probability
from fmuid.diagnosis.information_matrix import ScoreStatistics

SIGNED = tuple(Cause(f"c{i}", (i,), 1.0, sign) for i, sign in enumerate((1, -1, 1, 0)))


def news(seed: int, information: np.ndarray | None = None) -> ScoreStatistics:
    random = np.random.default_rng(seed)
    if information is None:
        root = random.standard_normal((7, 4))
        information = root.T @ root
    return ScoreStatistics(information, np.linalg.cholesky(information) @ random.standard_normal(4))


@pytest.mark.parametrize("seed", range(12))
def test_sizes_with_signs(seed: int) -> None:
    """The quadratic form with bounds, by scipy's bounded least squares."""
    given = news(seed)
    root = np.linalg.cholesky(given.information).T
    target = np.linalg.solve(root.T, given.score)
    low = [0.0 if cause.sign > 0 else -np.inf for cause in SIGNED]
    high = [0.0 if cause.sign < 0 else np.inf for cause in SIGNED]
    sizes = optimize.lsq_linear(root, target, (low, high), tol=1e-14).x
    found = fit(given, SIGNED)
    assert found.sizes == pytest.approx(sizes, abs=1e-7)
    assert found.statistic == pytest.approx(2 * given.score @ sizes - sizes @ given.information @ sizes, abs=1e-9)


def test_a_cause_with_the_wrong_sign_explains_nothing() -> None:
    given = ScoreStatistics(np.eye(4), np.array([-2.0, 0.0, 0.0, 0.0]))
    assert fit(given, SIGNED[:1]).statistic == 0.0
    assert probability(0.0, SIGNED[0]) == 1.0
    assert fit(given, (Cause("free", (0,), 1.0),)).statistic == pytest.approx(4.0)
    assert probability(4.0, SIGNED[0]) == pytest.approx(special.ndtr(-2.0))


def test_the_smallest_probability_of_unlike_and_of_equal_causes() -> None:
    """m unlike causes: 1 − (1 − α)^(1/m), m times the same: α."""
    free = tuple(Cause(str(i), (i,), 1.0) for i in range(4))
    unlike = MinPDistribution.of(ScoreStatistics(np.eye(4), np.zeros(4)), free)
    assert unlike.limit(0.05) == pytest.approx(1 - 0.95**0.25, rel=0.08)
    assert unlike.adjusted(unlike.limit(0.05)) == pytest.approx(0.05, rel=0.02)
    assert unlike.adjusted(1e-6) == pytest.approx(4e-6)
    equal = MinPDistribution.of(
        ScoreStatistics(np.eye(4), np.zeros(4)), tuple(Cause(str(i), (0,), 1.0) for i in range(4))
    )
    assert equal.limit(0.05) == pytest.approx(0.05, rel=0.08)
    pair = MinPDistribution.of(ScoreStatistics(np.eye(4), np.zeros(4)), (Cause("plane", (1, 2), 1.0),))
    assert pair.limit(0.05) == pytest.approx(0.05, rel=0.08)
    both = MinPDistribution.of(
        ScoreStatistics(np.eye(4), np.zeros(4)), (Cause("up", (0,), 1.0, 1), Cause("down", (0,), 1.0, -1))
    )
    assert both.limit(0.05) == pytest.approx(0.025, rel=0.08)


@pytest.mark.parametrize("cause", [SIGNED[0], SIGNED[3], Cause("plane", (1, 2), 1.0)], ids=lambda cause: cause.name)
def test_the_detectable_size_is_called_as_often_as_it_says(cause: Cause) -> None:
    information = news(3).information
    limit, miss = 0.002, 0.1
    size = detectable(ScoreStatistics(information, np.zeros(4)), cause, limit, miss)
    values, vectors = np.linalg.eigh(information[np.ix_(cause.columns, cause.columns)])
    truth = np.zeros(4)
    truth[list(cause.columns)] = size * vectors[:, 0] * (np.sign(vectors[0, 0]) if cause.sign else 1.0)
    random, root = np.random.default_rng(9), np.linalg.cholesky(information)
    called = [
        probability(fit(ScoreStatistics(information, information @ truth + root @ z), (cause,)).statistic, cause)
        <= limit
        for z in random.standard_normal((2000, 4))
    ]
    assert values[0] > 0
    assert np.mean(called) == pytest.approx(1 - miss, abs=0.02)
