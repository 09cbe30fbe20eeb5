"""Estimates that weigh samples by the colour of their noise: generalised least squares in closed form, seeded draws."""

from __future__ import annotations

import numpy as np
import pytest

import fmuid
from fmuid.array_types import Floats
from fmuid.data.noise import Noise
from fmuid.data.parameters import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation.noise.prewhitening import Weights
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.identification import identify
from fmuid.identification.profile import profiles
from fmuid.identification.residual_analysis import examine_residuals
from fmuid.identification.sampling.posterior import Sampling
from fmuid.identification.sampling.sampler import sample
from fmuid.reports.messages.residuals import residual_words
from tests.support.problems import ar1

COUNT, COLOUR = 300, 0.8
TIMES = np.linspace(0.0, 10.0, COUNT)
STEPS = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], COUNT // 4), 4)
REGRESSORS = np.column_stack([np.ones(COUNT), TIMES, STEPS])
TRUTH = np.array([2.0, -1.0, 0.5])
COLOURED = Noise(coloured=True)


def problem(seed: int, missing: float = 0.0, noise: Noise = COLOURED, **words: object) -> LeastSquares:
    rng = np.random.default_rng(seed)
    y = REGRESSORS @ TRUTH + 0.3 * ar1(rng, COLOUR, COUNT)
    y[rng.random(COUNT) < missing] = np.nan
    parameters = {name: Parameter(1.0, prior=words.pop(name, None)) for name in "abc"}  # type: ignore[arg-type]
    return LeastSquares.from_function(lambda p: REGRESSORS @ p, y, parameters, noise=noise, **words)  # type: ignore[arg-type]


def weighed(made: LeastSquares) -> tuple[Result, Floats]:
    """Return a result, and the matrix of correlations that its weights rest on."""
    result = identify(made)
    assert made.weights is not None
    inverse = np.linalg.inv(made.weights.matrix.toarray())
    return result, inverse @ inverse.T


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_estimates_are_those_of_generalised_least_squares(missing: float) -> None:
    """By the exact matrix of correlations φ^|i − j| of an autoregression of order 1."""
    made = problem(1, missing)
    result, correlations = weighed(made)
    there = np.flatnonzero(made.experiments[0].counted[:, 0])
    colour = correlations[0, 1] ** (1.0 / (there[1] - there[0]))
    exact = colour ** np.abs(there[:, None] - there)
    np.testing.assert_allclose(correlations, exact, atol=2e-4)
    x, y = REGRESSORS[there], made.experiments[0].output_values[there, 0]
    inverse = np.linalg.inv(exact)
    expected = np.linalg.solve(x.T @ inverse @ x, x.T @ inverse @ y)
    np.testing.assert_allclose(result.values, expected, rtol=1e-4)
    left = y - x @ expected
    variance = left @ inverse @ left / (there.size - 3)
    covariance = variance * np.linalg.inv(x.T @ inverse @ x)
    np.testing.assert_allclose(result.white_covariance, covariance, rtol=5e-3, atol=1e-9)
    # the sandwich has its own estimate of the colour
    np.testing.assert_allclose(result.std, np.sqrt(np.diag(covariance)), rtol=0.15)


def test_the_likelihood_is_that_of_the_exact_matrix() -> None:
    made = problem(2)
    result, correlations = weighed(made)
    left = made.experiments[0].output_values[:, 0] - REGRESSORS @ result.values
    square = left @ np.linalg.solve(correlations, left)
    variance = square / COUNT
    expected = -0.5 * (COUNT * np.log(2.0 * np.pi * variance) + np.linalg.slogdet(correlations)[1] + COUNT)
    assert result.log_likelihood == pytest.approx(expected, rel=1e-4)


def test_the_fit_is_what_was_simulated() -> None:
    result, _ = weighed(problem(3, 0.3))
    np.testing.assert_allclose(result.fit[0]["simulated.y"], REGRESSORS @ result.values, rtol=1e-6)


@pytest.mark.slow
def test_intervals_hold_and_are_narrower() -> None:
    """What moves fast beneath slow noise."""
    held, errors = 0, []
    for seed in range(8):
        first, found = identify(problem(seed, noise=Noise())), identify(problem(seed))
        lower, upper = found.intervals().to_numpy()[2]
        held += lower < TRUTH[2] < upper
        errors.append((first.values[2] - TRUTH[2], found.values[2] - TRUTH[2]))
        assert found.std[2] < 0.8 * first.std[2]
    plain, weighed = np.std(errors, axis=0)
    assert held > 5
    assert weighed < 0.75 * plain


def test_a_prior_is_weighed_against_the_data() -> None:
    made = problem(4, a=Normal(2.1, 0.05))
    result, correlations = weighed(made)
    inverse, y = np.linalg.inv(correlations) / result.variance["y"], made.experiments[0].output_values[:, 0]
    own = np.diag([1.0 / 0.05**2, 0.0, 0.0])
    expected = np.linalg.solve(
        REGRESSORS.T @ inverse @ REGRESSORS + own, REGRESSORS.T @ inverse @ y + own @ [2.1, 0.0, 0.0]
    )
    np.testing.assert_allclose(result.values, expected, rtol=1e-3)


def test_weights_are_undone() -> None:
    result = identify(problem(5, noise=Noise()))
    assert result.noise is not None
    weights, rows = (
        Weights.of(result.noise.series, result.noise.models),
        np.random.default_rng(6).standard_normal((COUNT, 2)),
    )
    np.testing.assert_allclose(weights.undone(weights(rows)), rows, atol=1e-9)
    assert weights.log_determinant == pytest.approx(np.linalg.slogdet(weights.matrix.toarray())[1])


def test_what_comes_after_uses_the_same_weights() -> None:
    """Profile and posterior of a linear model are its local intervals, also by weights; the words say these."""
    made = problem(7)
    result = identify(made)
    local = result.intervals().to_numpy()
    (profile,) = profiles(made, result, ["c"])
    np.testing.assert_allclose([profile.lower, profile.upper], local[2], rtol=1e-3)
    samples = sample(made, result, Sampling(effective_size=300, walkers=8, seed=1))
    np.testing.assert_allclose(samples.intervals().to_numpy()[2], local[2], atol=0.2 * np.ptp(local[2]))
    assert any("weigh the samples by the colour" in line for line in residual_words(examine_residuals(made, result)))
    with pytest.raises(InputError, match="identify this very problem first"):
        profiles(problem(7), result)


def test_a_machine_is_identified_by_weights_too() -> None:
    coil = fmuid.datasets.coil()
    made = fmuid.Problem(coil.fmu, coil.experiment, coil.parameters, noise=COLOURED)
    result = fmuid.identify(made)
    assert result.converged
    assert result.noise is not None
    assert result.noise.weights is made.weights
    assert result.accuracy is not None
    assert abs(result["R"] - 4.0) < 3.0 * result["R"].std
    made.become(result)
    assert made.weights is result.noise.weights


def test_robust_losses_know_no_colour() -> None:
    with pytest.raises(InputError, match=r'noise\.coloured goes with loss = "linear", not "huber"'):
        problem(1, loss="huber")
