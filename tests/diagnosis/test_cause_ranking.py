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
    rank_with_model_error,
)
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import MinPDistribution, fit
from fmuid.diagnosis.information_matrix import ScoreStatistics

INFORMATION = np.array([[4.0, 1.2, 0.3], [1.2, 2.0, -0.5], [0.3, -0.5, 3.0]])
GIVEN = ScoreStatistics(INFORMATION, np.array([3.0, -0.4, 1.5]))


@pytest.mark.parametrize("signs", [(1,), (-1,), (0,), (1, -1), (1, 1), (0, 1), (0, 0)])
def test_evidence_is_the_mean_likelihood_over_sizes(signs: tuple[int, ...]) -> None:
    scales, n = (0.7, 1.3)[: len(signs)], len(signs)
    causes = tuple(Cause(str(i), (i,), scale, sign) for i, (scale, sign) in enumerate(zip(scales, signs, strict=True)))
    lines = [np.linspace(0 if s > 0 else -9, 0 if s < 0 else 9, 401) for s in signs]
    sizes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    density = np.exp(sizes @ GIVEN.score[:n] - 0.5 * np.einsum("...i,ij,...j", sizes, INFORMATION[:n, :n], sizes))
    density *= np.prod([stats.norm(0.0, scale).pdf(sizes[..., i]) for i, scale in enumerate(scales)], axis=0)
    for line in reversed(lines):
        density = integrate.simpson(density, x=line)
    found = 2 ** sum(map(abs, signs)) * float(density)
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
@pytest.mark.parametrize(
    ("draws", "off"), [(150, 0.07), pytest.param(2000, 0.025, marks=pytest.mark.campaign)], ids=["150", "2000"]
)
def test_distinguishable_size_names_its_cause_alone(model_error: float, draws: int, off: float) -> None:
    """In 90 % of records with that size."""
    cosine = math.cos(0.6)
    information = np.array([[1.0, cosine], [cosine, 1.0]])
    causes = (Cause("one", (0,), 1e6), Cause("two", (1,), 1e6))
    blank = ScoreStatistics(information, np.zeros(2))
    size = distinguishable_size(blank, *causes, model_error=model_error)
    chance, root = MinPDistribution.of(blank, causes, draws=1000), np.linalg.cholesky(information)
    assert distinguishable_size(blank, *causes, model_error=math.sin(0.6) / 2) == math.inf
    alone = 0
    for z in np.random.default_rng(1).standard_normal((draws, 2)):
        news = ScoreStatistics(information, information[0] * size + root @ z)
        found = name(news, causes, 0.01, chance=chance, model_error=model_error)
        alone += [each.names for each in found.named] == [("one",)]
    assert alone / draws == pytest.approx(0.9, abs=off)


def causes_of(*angles: float) -> tuple[np.ndarray, tuple[Cause, ...]]:
    """Return the information of causes whose signatures lie in a plane and its normal."""
    columns = np.array([[math.cos(a), math.sin(a), 0.0] for a in angles] + [[0.0, 0.0, 1.0]])
    causes = tuple(Cause(str(i), (i,), 8.0) for i in range(len(columns)))
    return columns @ columns.T + 1e-9 * np.eye(len(columns)), causes


@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(1200, marks=pytest.mark.campaign)]
)
def test_names_over_draws(draws: int) -> None:
    """Nothing new: an alarm in one of a hundred; similar causes named together; two at once named as a pair."""
    information, causes = causes_of(0.0, 0.2)
    chance = MinPDistribution.of(ScoreStatistics(information, np.zeros(3)), causes)
    values, vectors = np.linalg.eigh(information)
    noise = np.random.default_rng(2).standard_normal((draws, 3)) @ (vectors * np.sqrt(np.maximum(values, 0))).T

    def named(*sizes: float) -> list[list[tuple[str, ...]]]:
        scores = information @ np.array(sizes) + noise
        found = [name(ScoreStatistics(information, score), causes, 0.01, chance=chance) for score in scores]
        return [[each.names for each in one.named] for one in found]

    assert np.mean([bool(each) for each in named(0.0, 0.0, 0.0)]) < 0.01 + 3 * math.sqrt(0.0099 / draws)
    near = named(8.0, 0.0, 0.0)
    assert np.mean([("0",) in each for each in near]) >= 0.95
    assert np.mean([("1",) in each for each in near]) > 0.5
    assert np.mean([each == [("2",)] for each in named(0.0, 0.0, 8.0)]) >= 0.9
    assert np.mean([("1", "2") in each for each in named(0.0, 10.0, 10.0)]) >= 0.95


def test_a_heavy_cause_may_be_far_larger_than_usual() -> None:
    """Of twenty usual sizes, weights 1, 1/3 and 1/10 of three scales leave more than one scale does."""
    plain = Cause("one", (0,), 0.1)
    news = ScoreStatistics(np.array([[100.0]]), np.array([200.0]))
    alone = [log_bayes_factor(news, [replace(plain, size=0.1 * scale)]) for scale in (1.0, 3.0, 10.0)]
    found = log_bayes_factor(news, [replace(plain, heavy=True)])
    assert found == pytest.approx(np.log(np.exp(alone) @ (1.0, 1 / 3, 0.1) / (1 + 1 / 3 + 0.1)))
    assert found > alone[0] + 50.0


def test_an_excluded_cause_is_not_named() -> None:
    information, causes = causes_of(0.0, 0.3)
    news = ScoreStatistics(information, information @ np.array([9.0, 0.0, 0.0]))
    assert name(news, causes, 0.01).named[0].names == ("0",)
    assert [each.names for each in name(news, causes, 0.01, without={("0",)}).named][:1] == [("1",)]


def test_a_sensor_has_no_model_error() -> None:
    """A weak fault at a right angle to a strong sensor: both named; the sensor's effect is known."""
    information, causes = causes_of(0.0, math.pi / 2)
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
    for _ in range(15):
        columns = random.standard_normal((9, 7))
        columns[:, 6] = 2.0 * columns[:, 5]
        causes = [Cause("plane", (0, 1), 1.0)]
        causes += [Cause(str(k), (k,), 1.0, int(sign)) for k, sign in enumerate(random.integers(-1, 2, 4), 2)]
        causes.append(Cause("like 5", (6,), 1.0, causes[-1].sign))
        news = ScoreStatistics(columns.T @ columns, columns.T @ (3.0 * random.standard_normal(9)))
        pairs = list(itertools.combinations(causes, 2))
        expected = [fit(news, pair).statistic for pair in pairs[:-1]] + [fit(news, (causes[-1],)).statistic]
        assert _together(news, pairs) == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_model_error_moves_the_other_size() -> None:
    """Each leaves κ of its effect orthogonal to its signature, a quarter of that along it: sizes scatter as stated."""
    kappa, random, draws = 0.1, np.random.default_rng(5), 800
    columns = np.array([[1.0, 0.0, 0.0], [math.cos(0.8), math.sin(0.8), 0.0]]).T * (30.0, 50.0)
    sizes, causes = np.array([2.0, -1.0]), (Cause("one", (0,), 1.0), Cause("two", (1,), 1.0))
    norms, information = np.linalg.norm(columns, axis=0), columns.T @ columns
    units = columns / norms
    cosine = float(units[:, 0] @ units[:, 1])
    across = (units[:, ::-1] - cosine * units) / math.sqrt(1.0 - cosine**2) * kappa * np.abs(sizes) * norms
    along = columns * 0.25 * kappa * sizes
    off = random.standard_normal((draws, 1, 2)) * across + random.standard_normal((draws, 1, 2)) * along
    noise = random.standard_normal((draws, 3))
    pair = [
        fit(ScoreStatistics(information, columns.T @ y), causes).sizes for y in columns @ sizes + off.sum(2) + noise
    ]
    one = [
        fit(ScoreStatistics(information, columns.T @ y), causes[:1]).sizes[0]
        for y in columns[:, 0] * sizes[0] + off[:, :, 0] + noise
    ]
    stated = estimate_sizes(ScoreStatistics(information, information @ sizes), causes, kappa).covariance
    assert np.cov(np.array(pair).T) == pytest.approx(stated, rel=0.15)
    first = ScoreStatistics(information, information[:, 0] * sizes[0])
    assert np.std(one) == pytest.approx(math.sqrt(estimate_sizes(first, causes[:1], kappa).covariance[0, 0]), rel=0.1)


def test_variants_of_a_cause_are_averaged() -> None:
    """Evidence is the mean over the grid, the size has the law of the mixture, and no pair is of one cause twice."""
    one, two = Cause("turns", (0,), 1.5), Cause("turns", (1,), 1.5)
    other = Cause("gain", (2,), 1.0)
    news = ScoreStatistics(INFORMATION, np.array([3.0, 2.0, 3.0]))
    _, found = rank_with_model_error(news, (one, two, other), 0.01, 0.0)
    (turns,) = (each for each in found if each.names == ("turns",))
    weights = np.exp([log_bayes_factor(news, (one,)), log_bayes_factor(news, (two,))])
    fits = [fit(news, (each,)) for each in (one, two)]
    draws = np.random.default_rng(5).choice(2, 200_000, p=weights / weights.sum())
    sizes = np.array([each.sizes[0] for each in fits])[draws]
    sizes = sizes + np.sqrt([each.covariance[0, 0] for each in fits])[draws] * np.random.default_rng(6).standard_normal(
        draws.size
    )
    assert turns.fit.sizes[0] == pytest.approx(sizes.mean(), abs=0.01)
    assert turns.fit.covariance[0, 0] == pytest.approx(sizes.var(), rel=0.02)
    assert turns.causes == ((one, two)[int(np.argmax(weights))],)
    odds = {each.names: each.odds for each in found}
    expected = np.exp(log_bayes_factor(news, (other,))) / weights.mean()
    assert odds["gain",] / odds["turns",] == pytest.approx(expected)
    assert ("turns", "turns") not in odds
