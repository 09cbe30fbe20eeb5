"""Innovations of coloured noise against Cholesky's factor of its exact matrix of correlations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from fmuid.array_types import Floats, Indices
from fmuid.estimation.noise.autoregression import Autoregression, impulse_response
from fmuid.estimation.noise.model import innovations_matrix

FIRST = np.array([0.8])
SECOND = np.array([1.6, -0.9])
WHOLE = np.arange(60)


def model(coefficients: Floats, pole: float = 0.0, zero: float = 0.0) -> Autoregression:
    memory = impulse_response(coefficients, 5000).size + (500 if pole else 0)
    return Autoregression(coefficients, 1.0, 60, memory, pole, zero)


def correlations(found: Autoregression, places: Indices) -> Floats:
    """By the impulse response of a filter of scipy's, at the distances between places."""
    poles = np.convolve(np.r_[1.0, -found.coefficients], [1.0, -found.pole])
    response = lfilter([1.0, -found.zero], poles, np.r_[1.0, np.zeros(4999)])
    every = np.correlate(response, response, "full")[4999:]
    return np.asarray(every[np.abs(places[:, None] - places)] / every[0])


@pytest.mark.parametrize(
    ("noise", "places"),
    [
        (model(np.zeros(0)), WHOLE),
        (model(FIRST), WHOLE),
        (model(SECOND), WHOLE),
        (model(FIRST), np.flatnonzero(np.random.default_rng(1).random(90) < 0.6)),
        (model(np.zeros(0), 0.97, 0.9), WHOLE),
    ],
)
def test_rows_are_those_of_the_exact_factor(noise: Autoregression, places: Indices) -> None:
    matrix = correlations(noise, places)
    expected = np.linalg.inv(np.linalg.cholesky(matrix))
    found = innovations_matrix(noise, places).toarray()
    np.testing.assert_allclose(found, expected, atol=2e-3 if noise.coefficients.size or noise.pole else 1e-8)
    np.testing.assert_allclose(found @ matrix @ found.T, np.eye(places.size), atol=2e-3)


def test_beside_gaps_little_is_left_of_longer_memories() -> None:
    places = np.flatnonzero(np.random.default_rng(2).random(120) < 0.7)
    noise = model(SECOND)
    found = innovations_matrix(noise, places).toarray()
    left = found @ correlations(noise, places) @ found.T
    np.testing.assert_allclose(np.diag(left), 1.0, atol=2e-3)
    assert np.abs(left - np.diag(np.diag(left))).max() < 0.1


def test_a_sample_is_foretold_as_yule_and_walker_have_it() -> None:
    row = innovations_matrix(model(SECOND), WHOLE).toarray()[30]
    correlation = correlations(model(SECOND), np.arange(4))[0]
    expected = solve_toeplitz(correlation[:2], correlation[1:3])
    np.testing.assert_allclose(-row[[29, 28]] / row[30], expected, atol=1e-3)
    np.testing.assert_allclose(-row[[29, 28]] / row[30], SECOND, atol=1e-3)
