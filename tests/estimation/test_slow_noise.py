"""Slow noise beneath white noise: factors of spectra against closed forms, quadrature, differences and seeded draws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fmuid.array_types import Floats
from fmuid.estimation.noise.autoregression import Autoregression, fit
from fmuid.estimation.noise.low_frequency import Spectrum, slow_noise
from fmuid.estimation.noise.output_series import OutputSeries
from fmuid.estimation.noise.sample_grid import Rows, SampleGrid
from tests.support.problems import ar1

WEAK, POLE = 0.08, 0.98
ONE = np.ones(1)
MODEL = Autoregression(np.array([0.6, -0.4]), 0.7, 100, 800, 0.97, 0.9)


def drawn(seed: int, count: int, share: float = WEAK) -> Floats:
    """White noise with a share of the variance, 1, slow."""
    rng = np.random.default_rng(seed)
    return math.sqrt(1.0 - share) * rng.standard_normal(count) + math.sqrt(share) * ar1(rng, POLE, count)


def test_spectra_and_gains_are_those_of_the_filter() -> None:
    pulse = np.r_[1.0, np.zeros(4095)]
    expected = lfilter([1.0, -0.9], np.convolve([1.0, -0.97], [1.0, -0.6, 0.4]), pulse)
    np.testing.assert_allclose(np.fft.irfft(MODEL.transfer(4096), 4096), expected, atol=1e-9)
    assert MODEL.gain == pytest.approx(float(expected @ expected), rel=1e-4)


def test_the_time_constant_is_that_of_the_slowest_real_pole() -> None:
    """Of poles 0.8, −0.95 and 0.9 e^(±i); of slow noise beneath; of white noise."""
    polynomial = np.convolve(np.convolve([1.0, -0.8], [1.0, 0.95]), [1.0, -1.8 * math.cos(1.0), 0.81])
    own = Autoregression(-polynomial[1:], 1.0, 100)
    assert own.time_constant == pytest.approx(-1.0 / math.log(0.8))
    assert MODEL.time_constant == pytest.approx(-1.0 / math.log(0.97))
    assert Autoregression(np.zeros(0), 1.0, 100).time_constant == 0.0


def test_scatter_is_the_inverse_of_whittles_information() -> None:
    """The mean over all frequencies of the products of the derivatives of log transfer, by differences."""
    length, h = 8192, 1e-5

    def logs(values: Floats) -> Any:
        return np.log(Autoregression(values[:2], 1.0, 100, 800, values[2], values[3]).transfer(length))

    at = np.array([0.6, -0.4, 0.97, 0.9])
    slopes = np.array([(logs(at + h * row) - logs(at - h * row)) / (2.0 * h) for row in np.eye(4)])
    weights = np.r_[1.0, np.full(length // 2 - 1, 2.0), 1.0] / length
    information = ((slopes * weights) @ slopes.conj().T).real
    found = MODEL.scatter()
    np.testing.assert_allclose(found[1:, 1:], np.linalg.inv(information), rtol=1e-3)
    assert found[0, 0] == 2.0


@pytest.mark.parametrize("given", [False, True])
def test_slopes_of_variances_are_those_of_differences(given: bool) -> None:
    t = np.linspace(0.0, 5.0, 80)
    basis = np.linalg.qr(np.column_stack([np.exp(-t), np.ones(80)]))[0]
    flags = np.array([given]), np.array([False])
    rows = Rows(np.random.default_rng(4).standard_normal(80), basis, basis, np.eye(2), np.zeros((2, 2)), *flags)
    own = OutputSeries("a", "y", 0, np.arange(80), np.arange(80), 1.0, True, 0, 0)
    grid = SampleGrid(rows, [own], [0])

    def variances(values: Floats) -> Floats:
        variance = math.exp(values[0])
        model = Autoregression(values[1:3], variance, 100, 800, values[3], values[4])
        if given:
            model = Autoregression(values[1:3], 1.0 / model.gain, 100, 800, values[3], values[4])
        return np.diag(grid.take([model], basis))

    at, h = np.array([0.0, 0.6, -0.4, 0.97, 0.9]), 1e-5
    expected = [(variances(at + h * row) - variances(at - h * row)) / (2.0 * h) for row in np.eye(5)]
    variances(at)
    np.testing.assert_allclose(grid.slopes()[0], np.transpose(expected), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_the_power_of_innovations_is_their_variance(share: float) -> None:
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
def test_slow_noise_is_found_as_large_as_it_is(share: float) -> None:
    """Against the factors of the spectrum of the sum: κ (1 + θ²) and κ θ are its autocovariances times 1 − φq."""
    count = 60_000
    there = np.random.default_rng(1).random(count) < share
    found = slow_noise((drawn(2, count) * there)[None], ONE, there, np.zeros(0))
    assert found is not None
    both = WEAK * (1.0 - POLE**2) + (1.0 - WEAK) * (1.0 + POLE**2)
    half = both / (2.0 * (1.0 - WEAK) * POLE)
    zero = half - math.sqrt(half**2 - 1.0)
    assert found.pole == pytest.approx(POLE, abs=0.008)
    if share == 1.0:
        assert found.zero == pytest.approx(zero, abs=0.01)
        assert found.variance == pytest.approx((1.0 - WEAK) * POLE / zero, rel=0.02)


def test_what_the_model_states_is_the_power_at_low_frequencies() -> None:
    """Weak noise of 98 % from sample to sample is 9 times the white noise at frequency 0."""
    true = (1.0 - WEAK) + WEAK * (1.0 + POLE) / (1.0 - POLE)
    stated = []
    for seed in range(20):
        found = fit(drawn(seed, 2000)[None], np.ones(2000, dtype=np.bool_), ONE, 33)
        assert found.pole > 0.9
        stated.append(found.variance * abs(found.transfer(4096)[0]) ** 2)
    assert np.median(stated) == pytest.approx(true, rel=0.25)


def test_white_noise_hardly_ever_passes_for_slow() -> None:
    """Of 200 draws; so many are stated as one in thirty: 15 are three standard errors more."""
    there = np.ones(400, dtype=np.bool_)
    found = [fit(drawn(seed, 400, 0.0)[None], there, ONE, 26).pole > 0 for seed in range(200)]
    assert sum(found) < 15


def test_records_too_short_to_tell_have_none() -> None:
    assert slow_noise(np.arange(12.0)[None] - 5.5, ONE, np.ones(12, dtype=np.bool_), np.zeros(0)) is None


def test_rounding_between_neighbours_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products of some BLAS give other last digits in other rows; a random walk leads to a bound of the memory."""
    x = np.cumsum(np.random.default_rng(6).standard_normal(60))
    plain = slow_noise(x[None], ONE, np.ones(60, dtype=bool), np.zeros(0))
    fitted, calls = Spectrum.fitted, []

    def rounding(self: Spectrum, logs: Floats) -> tuple[Floats, Floats]:
        calls.append(logs)
        assert len(calls) < 1000, "it goes round in circles"
        levels, heights = fitted(self, logs)
        return levels, heights - 1e-12 * np.arange(len(heights))

    monkeypatch.setattr(Spectrum, "fitted", rounding)
    found = slow_noise(x[None], ONE, np.ones(60, dtype=bool), np.zeros(0))
    assert plain is not None
    assert found is not None
    assert found.pole == pytest.approx(plain.pole, rel=1e-9)
