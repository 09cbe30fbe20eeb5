"""Sizes with signs against bounded least squares, levels against closed forms, power against draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, special, stats

from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import MinPDistribution, as_normal, fit, log_tail, probability
from fmuid.diagnosis.information_matrix import ScoreStatistics

SIGNED = tuple(Cause(f"c{i}", (i,), 1.0, sign) for i, sign in enumerate((1, -1, 1, 0)))
PLANE, BLANK = Cause("plane", (1, 2), 1.0), ScoreStatistics(np.eye(4), np.zeros(4))


def news(seed: int) -> ScoreStatistics:
    random = np.random.default_rng(seed)
    root = random.standard_normal((7, 4))
    information = root.T @ root
    return ScoreStatistics(information, np.linalg.cholesky(information) @ random.standard_normal(4))


def test_sizes_with_signs() -> None:
    """The quadratic form with bounds, by scipy's bounded least squares."""
    low, high = np.array([(0.0 if c.sign > 0 else -np.inf, 0.0 if c.sign < 0 else np.inf) for c in SIGNED]).T
    for seed in range(12):
        given = news(seed)
        root = np.linalg.cholesky(given.information).T
        sizes = optimize.lsq_linear(root, np.linalg.solve(root.T, given.score), (low, high), tol=1e-14).x
        found = fit(given, SIGNED)
        assert found.sizes == pytest.approx(sizes, abs=1e-7)
        assert found.statistic == pytest.approx(2 * given.score @ sizes - sizes @ given.information @ sizes, abs=1e-9)


@pytest.mark.parametrize(("degrees", "off"), [(1, 0.06), (2, 1e-9)])
def test_statistics_of_few_records_count_as_those_of_many(degrees: int, off: float) -> None:
    """The χ² with the tail of an F law, by scipy's inverse."""
    statistics, freedom = np.array([4.0, 9.0, 30.0, 100.0]), np.array([9.0, 19.0, 50.0, 9.0])
    expected = stats.chi2.isf(stats.f.sf(statistics / degrees, degrees, freedom), degrees)
    assert as_normal(statistics, freedom) == pytest.approx(expected, rel=off)
    assert as_normal(statistics, np.full(4, np.inf)) == pytest.approx(statistics)


@pytest.mark.parametrize("degrees", [1, 2, 3])
def test_log_tail(degrees: int) -> None:
    """Where the probability itself is 0, its logarithm goes on falling."""
    near, far = log_tail(np.array([40.0, 4000.0]), degrees)
    assert near == pytest.approx(stats.chi2.logsf(40.0, degrees))
    assert far == pytest.approx(-2000.0, abs=6.0)
    assert [probability(d, SIGNED[0], news(0)) for d in (0.0, 4.0)] == pytest.approx([1.0, special.ndtr(-2.0)])


@pytest.mark.parametrize(
    ("causes", "limit"),
    [
        ([Cause(str(i), (i,), 1.0) for i in range(4)], 1 - 0.95**0.25),
        ([Cause(str(i), (0,), 1.0) for i in range(4)], 0.05),
        ([PLANE], 0.05),
        ([Cause("up", (0,), 1.0, 1), Cause("down", (0,), 1.0, -1)], 0.025),
    ],
    ids=["unlike", "equal", "plane", "signs"],
)
def test_smallest_probability(causes: list[Cause], limit: float) -> None:
    """m unlike causes: 1 − (1 − α)^(1/m), m times the same: α."""
    found = MinPDistribution.of(BLANK, causes)
    assert found.limit(0.05) == pytest.approx(limit, rel=0.08)
    assert found.adjusted(found.limit(0.05)) == pytest.approx(0.05, rel=0.08)
    assert found.adjusted(1e-6) == pytest.approx(len(causes) * 1e-6)
