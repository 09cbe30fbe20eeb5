"""Odds against integrals over the sizes, angles against vectors, and how often names are right."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from fmuid.diagnosis.cause_ranking import (
    _together,
    angle,
    distinguishable_size,
    estimate_sizes,
    log_bayes_factor,
    name,
)
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import MinPDistribution, fit
from fmuid.diagnosis.information_matrix import ScoreStatistics

INFORMATION = np.array([[4.0, 1.2, 0.3], [1.2, 2.0, -0.5], [0.3, -0.5, 3.0]])
GIVEN = ScoreStatistics(INFORMATION, np.array([3.0, -0.4, 1.5]))


def likelihood(columns: list[int], *sizes: float) -> float:
    """Return the likelihood ratio of some sizes against none."""
    size = np.array(sizes)
    return math.exp(GIVEN.score[columns] @ size - 0.5 * size @ INFORMATION[np.ix_(columns, columns)] @ size)


@pytest.mark.parametrize("sign", [1, -1, 0])
def test_evidence_of_one_cause_is_the_mean_likelihood_over_its_sizes(sign: int) -> None:
    cause, slab = Cause("one", (0,), 0.7, sign), stats.norm(0.0, 0.7)
    low, high = (0.0 if sign > 0 else -8.0), (0.0 if sign < 0 else 8.0)
    found = integrate.quad(lambda s: likelihood([0], s) * slab.pdf(s) * (2 if sign else 1), low, high)[0]
    assert log_bayes_factor(GIVEN, (cause,)) == pytest.approx(math.log(found), rel=1e-7)


@pytest.mark.parametrize("signs", [(1, -1), (1, 1), (0, 1), (0, 0)])
def test_evidence_of_two_causes(signs: tuple[int, int]) -> None:
    causes = (Cause("one", (0,), 0.7, signs[0]), Cause("two", (1,), 1.3, signs[1]))
    slabs = (stats.norm(0.0, 0.7), stats.norm(0.0, 1.3))
    share = 2 ** sum(bool(sign) for sign in signs)
    x, y = (np.linspace(0 if s > 0 else -9, 0 if s < 0 else 9, 401) for s in signs)
    both = np.stack(np.broadcast_arrays(x[:, None], y), axis=-1)
    exponent = both @ GIVEN.score[:2] - 0.5 * np.einsum("xyi,ij,xyj->xy", both, INFORMATION[:2, :2], both)
    density = np.exp(exponent) * slabs[0].pdf(x)[:, None] * slabs[1].pdf(y) * share
    found = integrate.simpson(integrate.simpson(density, x=y), x=x)
    assert log_bayes_factor(GIVEN, causes) == pytest.approx(math.log(found), abs=2e-4)


def test_angles_are_those_of_the_signatures() -> None:
    """Of columns of a Jacobian, also of a column and a plane."""
    jacobian = np.zeros((5, 4))
    jacobian[:2, 0] = (2.0, 0.0)
    jacobian[:2, 1] = (3.0 * math.cos(0.4), 3.0 * math.sin(0.4))
    jacobian[2, 2], jacobian[:, 3] = 1.0, (0.0, math.sin(0.3), math.cos(0.3), 0.0, 0.0)
    news = ScoreStatistics(jacobian.T @ jacobian + 1e-13 * np.eye(4), np.zeros(4))
    one, two = Cause("one", (0,), 1.0), Cause("two", (1,), 1.0)
    assert angle(news, one, two) == pytest.approx(0.4)
    assert angle(news, Cause("plane", (0, 2), 1.0), Cause("line", (3,), 1.0)) == pytest.approx(0.3)
    assert angle(news, one, one) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("model_error", [0.0, 0.05])
def test_the_size_from_which_a_rival_is_excluded(model_error: float) -> None:
    """Of records with that size, drawn, nine of ten exclude the rival; smaller angles than the models' error never."""
    sine = math.sin(0.6)
    information = np.array([[1.0, math.sqrt(1 - sine**2)], [math.sqrt(1 - sine**2), 1.0]])
    causes = (Cause("one", (0,), 1e6), Cause("two", (1,), 1e6))
    blank = ScoreStatistics(information, np.zeros(2))
    size = distinguishable_size(blank, *causes, model_error=model_error)
    chance, root = MinPDistribution.of(blank, causes, draws=1000), np.linalg.cholesky(information)
    excluded = []
    for z in np.random.default_rng(1).standard_normal((600, 2)):
        found = name(ScoreStatistics(information, information[0] * size + root @ z), causes, 0.01, chance=chance,
                     model_error=model_error)  # fmt: skip
        excluded.append([each.names for each in found.named] == [("one",)])
    assert np.mean(excluded) == pytest.approx(0.9, abs=0.05)
    assert distinguishable_size(blank, *causes, model_error=sine / 2) == math.inf


def causes_of(angles: list[float]) -> tuple[np.ndarray, tuple[Cause, ...]]:
    """Return the information of causes whose signatures lie in a plane and its normal."""
    columns = np.array([[math.cos(a), math.sin(a), 0.0] for a in angles] + [[0.0, 0.0, 1.0]])
    return columns @ columns.T + 1e-9 * np.eye(len(columns)), tuple(
        Cause(str(i), (i,), 8.0) for i in range(len(columns))
    )


@pytest.mark.slow
def test_level_names_and_pairs() -> None:
    """Nothing new: an alarm in one of a hundred; near rivals named together; two at once named as a pair."""
    information, causes = causes_of([0.0, 0.2])
    chance = MinPDistribution.of(ScoreStatistics(information, np.zeros(3)), causes)
    values, vectors = np.linalg.eigh(information)
    root = vectors * np.sqrt(np.maximum(values, 0))
    draws = np.random.default_rng(2).standard_normal((1200, 3))

    def named(sizes: tuple[float, ...], count: int) -> list[list[tuple[str, ...]]]:
        scores = information @ np.array(sizes) + draws[:count] @ root.T
        found = [name(ScoreStatistics(information, score), causes, 0.01, chance=chance) for score in scores]
        return [[each.names for each in one.named] for one in found]

    assert np.mean([bool(each) for each in named((0.0, 0.0, 0.0), 1200)]) == pytest.approx(0.01, abs=0.009)
    near = named((8.0, 0.0, 0.0), 200)
    assert np.mean([("0",) in each for each in near]) >= 0.95
    assert np.mean([("1",) in each for each in near]) > 0.5
    assert np.mean([each[:1] == [("2",)] and len(each) == 1 for each in named((0.0, 0.0, 8.0), 200)]) >= 0.9
    both = named((0.0, 10.0, 10.0), 200)
    assert np.mean([("1", "2") in each for each in both]) >= 0.95


def test_the_models_own_error_names_no_second_cause() -> None:
    """A strong fault whose model is off by 3 % along another signature: alone with that error stated, two without."""
    information, causes = causes_of([0.0, 1.2])
    score = information @ np.array([200.0, 0.0, 6.0])
    assert [each.names for each in name(ScoreStatistics(information, score), causes, 0.01).named] == [("0",)]
    strict = name(ScoreStatistics(information, score), causes, 0.01, model_error=0.0)
    assert strict.named[0].names == ("0", "2")
    assert strict.temper == 1.0
    assert name(ScoreStatistics(information, score), causes, 0.01).temper == pytest.approx(
        1 + 0.05**2 * 200**2, rel=0.05
    )


def test_a_sensor_has_no_error_of_a_model() -> None:
    """A weak fault at a right angle to a strong sensor: both named; the sensor's effect is known."""
    information, causes = causes_of([0.0, math.pi / 2])
    news = ScoreStatistics(information, information @ np.array([200.0, 0.0, 7.0]))
    sensor = replace(causes[0], modelled=False)
    assert [each.names for each in name(news, causes, 0.01).named] == [("0",)]
    found = name(news, (sensor, *causes[1:]), 0.01)
    assert found.named[0].names == ("0", "2")
    assert found.temper == pytest.approx(1 + 0.05**2 * 49.0)
    pair = (sensor, causes[2])
    stated, plain = estimate_sizes(news, pair, 0.05).covariance, fit(news, pair).covariance
    assert stated[1, 1] == pytest.approx(plain[1, 1] * (1 + 0.0125**2 * 49.0))
    assert stated[0, 0] == pytest.approx(plain[0, 0] * (1 + 0.05**2 * 49.0))


def test_pairs_at_once_are_pairs_one_by_one() -> None:
    """Signs of either kind, a vector of the plane, and two causes with the same signature."""
    random = np.random.default_rng(4)
    for _ in range(50):
        columns = random.standard_normal((9, 7))
        columns[:, 6] = 2.0 * columns[:, 5]
        signs = random.integers(-1, 2, 5)
        causes = [Cause("plane", (0, 1), 1.0)]
        causes += [Cause(str(k), (k,), 1.0, int(sign)) for k, sign in enumerate(signs[:4], 2)]
        causes.append(Cause("like 5", (6,), 1.0, causes[-1].sign))
        score = columns.T @ (3.0 * random.standard_normal(9))
        news, pairs = ScoreStatistics(columns.T @ columns, score), list(itertools.combinations(causes, 2))
        found = _together(news, pairs)
        expected = [fit(news, pair).statistic for pair in pairs[:-1]]
        assert found[:-1] == pytest.approx(expected, rel=1e-7, abs=1e-9)
        assert found[-1] == pytest.approx(fit(news, (causes[-1],)).statistic)


def test_what_a_model_leaves_goes_into_the_other_size() -> None:
    """Each leaves κ of its effect orthogonal to its signature, a quarter of that along it: sizes scatter as stated."""
    kappa, random = 0.1, np.random.default_rng(5)
    columns = np.array([[1.0, 0.0, 0.0], [math.cos(0.8), math.sin(0.8), 0.0]]).T * (30.0, 50.0)
    sizes, causes = np.array([2.0, -1.0]), (Cause("one", (0,), 1.0), Cause("two", (1,), 1.0))
    units = columns / np.linalg.norm(columns, axis=0)
    cosine = float(units[:, 0] @ units[:, 1])
    across = (units[:, ::-1] - cosine * units) / math.sqrt(1.0 - cosine**2)
    clean = columns @ sizes
    pair, one = [], []
    for _ in range(4000):
        left = across * (kappa * np.abs(sizes) * np.linalg.norm(columns, axis=0) * random.standard_normal(2))
        left += columns * (0.25 * kappa * sizes * random.standard_normal(2))
        noise = random.standard_normal(3)
        pair.append(
            fit(ScoreStatistics(columns.T @ columns, columns.T @ (clean + left.sum(axis=1) + noise)), causes).sizes
        )
        alone = columns[:, 0] * sizes[0] + left[:, 0] + noise
        one.append(fit(ScoreStatistics(columns.T @ columns, columns.T @ alone), causes[:1]).sizes[0])
    news = ScoreStatistics(columns.T @ columns, columns.T @ clean)
    stated = estimate_sizes(news, causes, kappa).covariance
    assert np.cov(np.array(pair).T) == pytest.approx(stated, rel=0.1)
    assert stated[1, 1] > 5 * estimate_sizes(news, causes, 0.0).covariance[1, 1]
    first = ScoreStatistics(columns.T @ columns, columns.T @ columns[:, 0] * sizes[0])
    assert np.std(one) == pytest.approx(math.sqrt(estimate_sizes(first, causes[:1], kappa).covariance[0, 0]), rel=0.05)
