"""Autoregressive and low-frequency noise: closed forms, scipy, Whittle's information, seeded draws."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fmuid.array_types import Floats, Indices
from fmuid.estimation import Autoregression
from fmuid.estimation.noise.autoregression import fit, impulse_response, most_orders
from fmuid.estimation.noise.low_frequency import Spectrum, slow_noise
from fmuid.estimation.noise.model import innovations_matrix
from tests.support.problems import ar1

SLOW, OSCILLATING, ONE = np.array([0.8]), np.array([1.6, -0.9]), np.ones(1)
WEAK, POLE = 0.08, 0.98
MODEL = Autoregression(np.array([0.6, -0.4]), 0.7, 100, 800, 0.97, 0.9)
LATE = np.concatenate([np.zeros(69), [0.7]])  # of a higher order than a block is long


def model(coefficients: Floats, pole: float = 0.0, zero: float = 0.0) -> Autoregression:
    memory = impulse_response(coefficients, 5000).size + (500 if pole else 0)
    return Autoregression(coefficients, 1.0, 60, memory, pole, zero)


def response_of(noise: Autoregression, count: int) -> Floats:
    """The impulse response of the noise by a filter of scipy."""
    poles = np.convolve(np.r_[1.0, -noise.coefficients], [1.0, -noise.pole])
    return np.asarray(lfilter([1.0, -noise.zero], poles, np.r_[1.0, np.zeros(count - 1)]))


# --- models given


def test_responses_and_gains_are_those_of_the_filter() -> None:
    for coefficients in (np.zeros(0), SLOW, OSCILLATING, np.array([0.3, 0.0, -0.4, 0.1]), LATE):
        found = impulse_response(coefficients, 5000)
        expected = response_of(Autoregression(coefficients, 1.0, 100), 5000)
        np.testing.assert_allclose(found, expected[: found.size], atol=1e-10)
        assert np.abs(expected[found.size :]).max() < 2e-4 * np.abs(expected).max()
    for noise in (model(OSCILLATING), MODEL):
        expected = response_of(noise, 4096)
        np.testing.assert_allclose(np.fft.irfft(noise.transfer(4096), 4096), expected, atol=1e-9)
        assert noise.gain == pytest.approx(float(expected @ expected), rel=1e-4)


def test_time_constant_is_that_of_the_slowest_real_pole() -> None:
    """Of poles 0.8, −0.95 and 0.9 e^(±i); of slow noise beneath; of white noise."""
    polynomial = np.convolve(np.convolve([1.0, -0.8], [1.0, 0.95]), [1.0, -1.8 * math.cos(1.0), 0.81])
    assert Autoregression(-polynomial[1:], 1.0, 100).time_constant == pytest.approx(-1.0 / math.log(0.8))
    assert MODEL.time_constant == pytest.approx(-1.0 / math.log(0.97))
    assert Autoregression(np.zeros(0), 1.0, 100).time_constant == 0.0


@pytest.mark.parametrize("noise", [MODEL, Autoregression(OSCILLATING, 0.7, 100, 800)])
def test_scatter_is_the_inverse_of_whittles_information(noise: Autoregression) -> None:
    """The mean over all frequencies of the products of the derivatives of log transfer, by differences."""
    length, h, size = 8192, 1e-5, 4 if noise.pole else 2

    def logs(values: Floats) -> Any:
        return np.log(Autoregression(values[:2], 1.0, 100, 800, *values[2:]).transfer(length))

    at = np.r_[noise.coefficients, noise.pole, noise.zero][:size]
    slopes = np.array([(logs(at + h * row) - logs(at - h * row)) / (2.0 * h) for row in np.eye(size)])
    weights = np.r_[1.0, np.full(length // 2 - 1, 2.0), 1.0] / length
    found = noise.scatter()
    np.testing.assert_allclose(found[1:, 1:], np.linalg.inv(((slopes * weights) @ slopes.conj().T).real), rtol=1e-3)
    assert found[0, 0] == 2.0


# --- models found


def test_fit_finds_the_model_of_a_long_record_with_gaps() -> None:
    rng = np.random.default_rng(3)
    noise = lfilter([0.5], [1.0, *-OSCILLATING], rng.standard_normal(20_500))[500:]
    there = rng.random(noise.size) < 0.7
    found = fit((noise * there)[None], there, ONE, 40)
    np.testing.assert_allclose(found.coefficients, OSCILLATING, atol=0.02)
    assert found.variance == pytest.approx(0.25, rel=0.1)
    assert found.samples == there.sum()


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_fit_subtracts_columns_of_negative_weight(share: float) -> None:
    rng = np.random.default_rng(14)
    columns, there = lfilter([1.0], [1.0, *-OSCILLATING], rng.standard_normal((3, 300))), rng.random(300) < share
    columns[2] = columns[1]
    before = columns.copy()
    found = fit(columns * there, there, np.array([1.0, 0.5, -0.5]), 10)
    alone = fit(columns[:1] * there, there, ONE, 10)
    np.testing.assert_allclose(found.coefficients, alone.coefficients, rtol=1e-9)
    assert found.variance == pytest.approx(alone.variance, rel=1e-9)
    np.testing.assert_array_equal(columns, before)


def test_fit_corrects_the_bias_of_short_records() -> None:
    """Burg's own is too small by 2 φ/n (Kendall), 0.03 here: 8 standard errors of the mean."""
    rng, there = np.random.default_rng(5), np.ones(50, dtype=np.bool_)
    found = [fit(ar1(rng, 0.8, 50)[None], there, ONE, 1).coefficients[0] for _ in range(600)]
    assert np.mean(found) == pytest.approx(0.8, abs=0.015)


def test_fit_of_white_noise_and_of_few_samples() -> None:
    white = fit(np.random.default_rng(2).standard_normal((1, 300)), np.ones(300, dtype=np.bool_), ONE, 24)
    assert white.coefficients.size == 1
    assert abs(white.coefficients[0]) < 0.15
    few = fit(np.array([[1.0, -1.0, 2.0]]), np.ones(3, dtype=np.bool_), ONE, 0)
    assert (few.coefficients.size, few.variance) == (0, 2.0)
    assert [most_orders(count, count) for count in (24, 25, 1000)] == [0, 6, 30]


# --- low-frequency noise


def drawn(seed: int, count: int, share: float = WEAK) -> Floats:
    """White noise with a share of the variance, 1, at low frequencies."""
    rng = np.random.default_rng(seed)
    return math.sqrt(1.0 - share) * rng.standard_normal(count) + math.sqrt(share) * ar1(rng, POLE, count)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_spectrum_level_is_the_power_of_innovations(share: float) -> None:
    rng = np.random.default_rng(3)
    noise, there = lfilter([1.0], [1.0, -0.6, 0.4], rng.standard_normal(501)), rng.random(501) < share
    found = Spectrum.of((noise * there)[None], ONE, there, MODEL.coefficients)
    known = there[2:] & there[1:-1] & there[:-2]
    known[:13] = False  # a transform of 486 = 2 × 3⁵ samples is faster
    left = (noise[2:] - 0.6 * noise[1:-1] + 0.4 * noise[:-2])[known]
    assert found.samples == left.size
    assert found.level == pytest.approx(np.mean(left**2))
    assert (found.length, found.bins.counts.sum()) == (486, 243.0)


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_slow_noise_has_the_factors_of_the_spectrum(share: float) -> None:
    """κ (1 + θ²) and κ θ are the autocovariances of the sum times 1 − φq."""
    there = np.random.default_rng(1).random(60_000) < share
    found = slow_noise((drawn(2, 60_000) * there)[None], ONE, there, np.zeros(0))
    assert found is not None
    both = WEAK * (1.0 - POLE**2) + (1.0 - WEAK) * (1.0 + POLE**2)
    half = both / (2.0 * (1.0 - WEAK) * POLE)
    zero = half - math.sqrt(half**2 - 1.0)
    assert found.pole == pytest.approx(POLE, abs=0.008)
    if share == 1.0:
        assert found.zero == pytest.approx(zero, abs=0.01)
        assert found.variance == pytest.approx((1.0 - WEAK) * POLE / zero, rel=0.02)


def test_fit_states_the_power_at_low_frequencies() -> None:
    """Weak noise of 98 % from sample to sample is 9 times the white noise at frequency 0."""
    found = [fit(drawn(seed, 2000)[None], np.ones(2000, dtype=np.bool_), ONE, 33) for seed in range(20)]
    assert min(each.pole for each in found) > 0.9
    stated = np.median([each.variance * abs(each.transfer(4096)[0]) ** 2 for each in found])
    assert stated == pytest.approx((1.0 - WEAK) + WEAK * (1.0 + POLE) / (1.0 - POLE), rel=0.25)


def test_fit_hardly_ever_finds_slow_noise_in_white_noise() -> None:
    """Of 100 draws; one in thirty is stated: 9 are three standard errors more. Short records have none."""
    there = np.ones(400, dtype=np.bool_)
    assert sum(fit(drawn(seed, 400, 0.0)[None], there, ONE, 26).pole > 0 for seed in range(100)) < 9
    assert slow_noise(np.arange(12.0)[None] - 5.5, ONE, np.ones(12, dtype=np.bool_), np.zeros(0)) is None


# --- innovations


def correlations(found: Autoregression, places: Indices) -> Floats:
    every = np.correlate(response_of(found, 5000), response_of(found, 5000), "full")[4999:]
    return np.asarray(every[np.abs(places[:, None] - places)] / every[0])


@pytest.mark.parametrize(
    ("noise", "gaps", "atol"),
    [
        (model(np.zeros(0)), 0.0, 1e-8),
        (model(SLOW), 0.0, 2e-3),
        (model(OSCILLATING), 0.0, 2e-3),
        (model(SLOW), 0.4, 2e-3),
        (model(np.zeros(0), 0.97, 0.9), 0.0, 2e-3),
    ],
)
def test_innovations_are_those_of_the_exact_factor(noise: Autoregression, gaps: float, atol: float) -> None:
    """Cholesky's factor of the exact matrix of correlations."""
    places = np.flatnonzero(np.random.default_rng(1).random(60) >= gaps)
    matrix = correlations(noise, places)
    found = innovations_matrix(noise, places).toarray()
    np.testing.assert_allclose(found, np.linalg.inv(np.linalg.cholesky(matrix)), atol=atol)
    np.testing.assert_allclose(found @ matrix @ found.T, np.eye(places.size), atol=2e-3)
