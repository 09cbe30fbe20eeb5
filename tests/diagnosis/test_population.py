"""Healthy records as a population: EM against the truth that drew them, and the level of a further record."""

from __future__ import annotations

import numpy as np
import pytest

from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics
from fmuid.diagnosis.population import Population, Scales, tempered

UNITS = np.array([1e3, 1.0, 1e-5, 2.0])  # coordinates of very different magnitude, as ohms, henries and seconds are
DIRECTION = np.array([0.3, -0.4, 0.0, 0.2])  # in units: one direction of scatter ...
SCATTER = np.outer(DIRECTION, DIRECTION)
DRIFT = np.array([0.0, 0.0, 0.5, 0.0])  # ... and one coordinate that drifts
SCALES = Scales(1e3 * UNITS, DRIFT * UNITS, 0.01 * UNITS)


def drawn(rng: np.random.Generator, count: int, mean: np.ndarray) -> list[InformationMatrix]:
    """Return records of 60 samples, each with a Jacobian of its own."""
    found = []
    for _ in range(count):
        x = mean + DIRECTION * rng.standard_normal() + DRIFT * rng.standard_normal(4)
        jacobian = rng.standard_normal((60, 4))
        data = InformationMatrix.of(jacobian, jacobian @ x + rng.standard_normal(60))
        found.append(InformationMatrix(data.matrix / np.outer(UNITS, UNITS), data.score / UNITS))
    return found


def test_many_records_show_mean_and_scatter() -> None:
    """Drift is none of the scatter: its prior explains it."""
    mean = np.array([5.0, -2.0, 1.0, 0.5])
    found = Population.of(drawn(np.random.default_rng(1), 150, mean), SCALES)
    assert found.known.mean / UNITS == pytest.approx(mean, abs=0.12)
    assert found.scatter / np.outer(UNITS, UNITS) == pytest.approx(SCATTER, abs=0.05)


def test_few_records_are_pooled() -> None:
    records = drawn(np.random.default_rng(2), 3, np.zeros(4))
    found = Population.of(records, SCALES)
    alone = ChangePrior.after(sum(records[1:], start=records[0]), SCALES.normal)
    assert found.known.mean == pytest.approx(alone.mean)
    assert found.known.covariance == pytest.approx(alone.covariance)
    assert not found.scatter.any()


@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(1000, marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("count", [6, 10, 20])
def test_level_of_a_further_record(count: int, draws: int) -> None:
    """With a scatter known from few records a statistic has the tail of F; ten records keep twice the level."""
    rng, low, naive = np.random.default_rng([3, count]), 0, 0
    for _ in range(draws):
        *healthy, new = drawn(rng, count + 1, np.zeros(4))
        plain = Population.of(healthy, SCALES)
        population = tempered(plain, healthy, list(plain.without_each(healthy, SCALES)))
        raw = ScoreStatistics.of(new, population.known.drifting(SCALES.drift))
        judged = population.judged(raw)
        for news, how in ((judged, True), (raw, False)):
            chances = [news.tail(news.score[i] ** 2 / news.information[i, i], [i]) for i in range(4)]
            hit = min(chances) * 4 < 0.05
            low, naive = low + (hit and how), naive + (hit and not how)
    print(f"{count} records: {low} of {draws} below 5 %; {naive} by χ²")
    assert low <= 0.11 * draws + 2.0 * np.sqrt(0.1 * draws)
    assert low <= naive
