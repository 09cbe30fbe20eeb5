"""Reference distributions of the likelihood ratio against counts over random draws and published weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize, stats

from fmuid.diagnosis.hypothesis_tests import NullDistribution, at_least_one, orthant_weights, rivals
from fmuid.errors import InputError

CORRELATED = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 1.0]])


def projected(covariance: np.ndarray, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return D and the number of positive components over draws of an estimate without fault."""
    factor = np.linalg.cholesky(covariance)
    z = np.random.default_rng(seed).standard_normal((draws, len(covariance)))
    inverse = np.linalg.inv(factor)
    found = [optimize.nnls(inverse, row) for row in z]
    statistic = (z**2).sum(axis=1) - np.array([rest**2 for _, rest in found])
    return statistic, np.array([(x > 0).sum() for x, _ in found])


def test_one_parameter_on_its_bound_is_half_and_half() -> None:
    weights = orthant_weights(np.array([[4.0]]))
    assert weights == (0.5, 0.5)
    # the 1 % point of half χ²_0, half χ²_1 is the 2 % point of χ²_1
    assert NullDistribution(0, weights).threshold(0.01) == pytest.approx(stats.chi2.isf(0.02, 1))
    assert NullDistribution(0, weights).threshold(0.6) == 0.0


def test_independent_parameters_have_binomial_weights() -> None:
    for k in (2, 3):
        assert orthant_weights(np.eye(k)) == pytest.approx(stats.binom.pmf(range(k + 1), k, 0.5))
    assert orthant_weights(np.eye(4)) == pytest.approx(stats.binom.pmf(range(5), 4, 0.5), abs=0.012)


@pytest.mark.parametrize("k", [2, 3])
def test_weights_and_tail_against_counts(k: int) -> None:
    covariance = CORRELATED[:k, :k] * np.outer([1.0, 5.0, 0.1][:k], [1.0, 5.0, 0.1][:k])
    weights = orthant_weights(covariance)
    statistic, positive = projected(covariance, 20_000, seed=k)
    assert sum(weights) == pytest.approx(1.0)
    assert weights == pytest.approx(np.bincount(positive, minlength=k + 1) / len(positive), abs=0.012)
    reference = NullDistribution(0, weights)
    for level in (0.1, 0.01):
        share = np.mean(statistic > reference.threshold(level))
        assert share == pytest.approx(level, abs=4 * math.sqrt(level / len(statistic)))


def test_drawn_weights_agree_with_the_closed_form_of_a_part() -> None:
    """A fourth parameter that is independent of the other three convolves their weights with (1/2, 1/2)."""
    covariance = np.eye(4)
    covariance[:3, :3] = CORRELATED
    three = np.array(orthant_weights(CORRELATED))
    assert orthant_weights(covariance) == pytest.approx(np.convolve(three, [0.5, 0.5]), abs=0.015)


def test_free_and_constrained_parameters_together() -> None:
    """D of one free and one constrained parameter, correlated, is that of a half plane."""
    reference = NullDistribution(1, (0.5, 0.5))
    draws = np.random.default_rng(5).standard_normal((50_000, 2))
    statistic = draws[:, 0] ** 2 + np.maximum(draws[:, 1], 0.0) ** 2
    assert np.mean(statistic > reference.threshold(0.05)) == pytest.approx(0.05, abs=0.004)


def test_size_and_angle_are_a_vector_of_the_plane() -> None:
    assert NullDistribution(2).threshold(0.01) == pytest.approx(-2.0 * math.log(0.01))
    assert NullDistribution(2).probability(0.0) == 1.0


def test_an_estimated_variance_gives_f() -> None:
    assert NullDistribution(2, freedom=30.0).threshold(0.01) == pytest.approx(2.0 * stats.f.isf(0.01, 2, 30))
    assert NullDistribution(1, freedom=1e9).threshold(0.01) == pytest.approx(stats.chi2.isf(0.01, 1), rel=1e-6)


def test_bonferroni_keeps_the_level_of_any_alarm() -> None:
    assert at_least_one([0.004, 0.3, 0.9]) == pytest.approx((0.012, 0.9, 1.0))


def test_rivals_are_those_near_the_best() -> None:
    assert rivals([10.0, -20.0, -14.5, -13.9]) == (1, 2)
    assert rivals([3.0]) == (0,)


def test_refusals() -> None:
    with pytest.raises(InputError, match="not positive definite"):
        orthant_weights(np.ones((2, 2)))
    with pytest.raises(InputError, match="the level of a test must lie between 0 and 1"):
        NullDistribution(1).threshold(0.0)
