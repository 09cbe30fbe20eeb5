"""Series of samples: autocorrelation, whiteness, normality and cross-correlation, with samples missing or not."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmuid.array_types import Floats
from fmuid.estimation import Autoregression, FitProjection, LaggedSeries, NoiseModel, OutputSeries, normality, whiteness
from fmuid.estimation.noise.whiteness_tests import autocorrelation, ljung_box
from tests.support.problems import ar1


def campaign(*values: Any) -> Any:
    return pytest.param(*values, marks=pytest.mark.campaign)


def noise_model(grid: Floats) -> NoiseModel:
    """Return the noise of a series on a grid, NaN where a sample is missing."""
    places = np.flatnonzero(np.isfinite(grid))
    return NoiseModel.of(OutputSeries("run", "y", 0, np.arange(places.size), places, 1.0, True, 0, 0), grid[places])


def white_model(count: int) -> NoiseModel:
    places = np.arange(count)
    series = OutputSeries("run", "y", 0, places, places, 1.0, True, 0, 0)
    return NoiseModel(series, Autoregression(np.zeros(0), 1.0, count))


def test_autocorrelation_by_hand() -> None:
    grid = np.array([1.0, 3.0, np.nan, 2.0, 6.0])
    found, pairs = autocorrelation(grid, 3)
    assert pairs.tolist() == [4, 2, 1, 2]
    variance = (4.0 + 0.0 + 1.0 + 9.0) / 4.0  # the mean is 3
    expected = [1.0, (0.0 - 3.0) / 2 / variance, 0.0, (2.0 + 0.0) / 2 / variance]
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_ljung_box_is_the_published_formula() -> None:
    x = ar1(np.random.default_rng(5), 0.2, 150)
    statistic, probability = ljung_box(*autocorrelation(x, 7))
    centred = x - x.mean()
    r = [float(np.sum(centred[k:] * centred[: 150 - k]) / np.sum(centred**2)) for k in range(8)]
    expected = 150 * 152 * sum(r[k] ** 2 / (150 - k) for k in range(1, 8))
    assert statistic == pytest.approx(expected, rel=1e-12)
    assert probability == pytest.approx(stats.chi2(7).sf(expected), rel=1e-9)


@pytest.mark.slow
def test_whiteness_in_short_records_that_a_fit_has_smoothed() -> None:
    """A polynomial of five coefficients through 30 samples with gaps: the limit alarms in 6 % for 1 %."""
    places = np.flatnonzero(np.arange(36) % 6 != 4)
    columns = np.linalg.qr(np.vander(places / 30.0, 5))[0]
    rng, tested, limit = np.random.default_rng(3), [], []
    for _ in range(400):
        noise = rng.standard_normal(places.size)
        grid = np.full(int(places[-1]) + 1, np.nan)
        grid[places] = noise - columns @ (columns.T @ noise)
        limit.append(ljung_box(*autocorrelation(grid, 6))[1])
        tested.append(whiteness(grid, FitProjection(columns, np.eye(5))).probability)
    assert np.mean(np.array(limit) < 0.05) > 0.1
    assert np.mean(np.array(tested) < 0.05) == pytest.approx(0.05, abs=0.033)  # three standard errors
    assert np.mean(np.array(tested) < 0.01) < 0.03


def test_normality_of_white_noise_is_jarque_and_bera() -> None:
    x = np.random.default_rng(11).exponential(size=80)
    found = normality(x, white_model(80))
    assert found.skewness == pytest.approx(stats.skew(x))
    assert found.kurtosis == pytest.approx(stats.kurtosis(x))
    assert found.probability == pytest.approx(stats.jarque_bera(x).pvalue, rel=1e-9)


@pytest.mark.parametrize(("count", "least", "most"), [(30, 0.0, 0.17), campaign(300, 0.02, 0.09)])
def test_normal_coloured_noise_is_called_normal(count: int, least: float, most: float) -> None:
    """As if it were white, skewness and kurtosis of strongly coloured noise would be rejected most of the time."""
    rng = np.random.default_rng(12)
    draws = [ar1(rng, 0.95, 4000) for _ in range(count)]
    coloured = np.mean([normality(x, noise_model(x)).probability < 0.05 for x in draws])
    white = np.mean([normality(x, white_model(4000)).probability < 0.05 for x in draws])
    assert least <= coloured <= most
    assert white > 0.5


def lagged(values: Floats, lags: int) -> Floats:
    shifted = [np.concatenate([np.full(lag, np.nan), values[: values.size - lag]]) for lag in range(lags + 1)]
    return np.column_stack(shifted)


@pytest.mark.parametrize(("draws", "least", "most"), [(60, 0.0, 0.12), campaign(300, 0.02, 0.09)])
def test_unrelated_series_are_related_by_chance_only(draws: int, least: float, most: float) -> None:
    rng = np.random.default_rng(13)
    single, any_lag = [], []
    for _ in range(draws):
        x, u = ar1(rng, 0.9, 1000), ar1(rng, 0.9, 1000)
        cross = LaggedSeries(lagged(u, 10), u).correlate(x, noise_model(x).correlation)
        single.append(abs(cross.values[0]) > 1.96 * cross.std)
        any_lag.append(cross.probability < 0.05)
    assert least <= np.mean(single) <= most
    assert np.mean(any_lag) <= most  # Šidák's bound is on the safe side where lags depend on each other


def test_the_band_is_bartletts_sum() -> None:
    """Σ ρ(k) ρ'(k)/n over all k of both signs, by a loop over the definitions."""
    rng = np.random.default_rng(15)
    x, u = 0.2 * ar1(rng, 0.8, 400), 3.0 * ar1(rng, 0.9, 400)
    noise = noise_model(x).correlation
    centred = u - u.mean()
    own = [float(centred[: 400 - k] @ centred[k:]) / float(centred @ centred) for k in range(noise.size)]
    total = noise[0] * own[0] + 2.0 * sum(noise[k] * own[k] for k in range(1, noise.size))
    series = LaggedSeries(lagged(u, 10), u)
    found = series.correlate(x, noise)
    assert found.values[0] == pytest.approx(np.corrcoef(x, u)[0, 1])
    assert found.std == pytest.approx(math.sqrt(total / 400), rel=1e-9)
    assert series.correlate(x, np.ones(1)).std == pytest.approx(math.sqrt(1.0 / 400), rel=1e-9)
