"""The closed form (1.1–1.12) against numpy, and as a test of the search engine."""

import numpy as np
import pytest

from fmuid.array_types import Floats
from fmuid.data import Parameter
from fmuid.estimation.cost_function import prepare
from fmuid.estimation.estimate import Marquardt
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.linear import linear_least_squares
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.search.loop import State, iterate
from fmuid.estimation.search.marquardt import Descent
from fmuid.identification import identify

TRUTH = np.array([1.5, -40.0, 2e-3])


def regression(seed: int = 3) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, 80)
    phi = np.column_stack([np.ones(80), t, 1e3 * np.sin(9.0 * t)])
    return phi, phi @ TRUTH + 0.3 * rng.standard_normal(80)


def test_closed_form() -> None:
    phi, y = regression()
    fit = linear_least_squares(phi, y)
    expected, (criterion,), _, _ = np.linalg.lstsq(phi, y, rcond=None)
    np.testing.assert_allclose(fit.values, expected, rtol=1e-10)
    assert fit.residual @ fit.residual == pytest.approx(criterion)
    assert fit.variance == pytest.approx(criterion / 77)
    np.testing.assert_allclose(fit.covariance, criterion / 77 * np.linalg.inv(phi.T @ phi), rtol=1e-8)


def test_badly_scaled_columns_keep_their_digits() -> None:
    """Columns of 1 to 1e-9 and nearly parallel: the normal equations lose all digits here."""
    t = np.linspace(0.0, 1.0, 50)
    phi = np.column_stack([np.ones(50), 1e-9 * (1.0 + 1e-6 * t)])
    fit = linear_least_squares(phi, phi @ np.array([1.0, 1e9]))
    np.testing.assert_allclose(fit.values, [1.0, 1e9], rtol=1e-8)


@pytest.mark.slow
def test_variance_is_unbiased_and_the_covariance_is_that_of_repeated_experiments() -> None:
    draws = [linear_least_squares(*regression(seed)) for seed in range(400)]
    assert np.mean([fit.variance for fit in draws]) == pytest.approx(0.09, rel=0.02)
    spread = np.cov(np.array([fit.values for fit in draws]).T)
    np.testing.assert_allclose(np.diag(spread), np.diag(draws[0].covariance) / draws[0].variance * 0.09, rtol=0.2)


@pytest.mark.parametrize("starts", [(1.0, -1.0, 1.0), (-500.0, 500.0, 1e-6)])
def test_the_search_finds_it_in_two_steps(starts: tuple[float, float, float]) -> None:
    """On a linear model the Gauss–Newton step is exact; what is left is the error of differences."""
    phi, y = regression()
    fit = linear_least_squares(phi, y)
    parameters = {name: Parameter(start) for name, start in zip("abc", starts, strict=True)}
    problem = LeastSquares.from_function(lambda theta: phi @ theta, y, parameters)
    start = prepare(Evaluator(problem))
    state = State(start.theta, start.residual, start.jacobian)
    states = list(iterate(Descent(Marquardt(first_radius=1e9)), start.criterion, state))
    state, steps = states[-1], [each.last for each in states if each.last is not None and each.last.number]
    assert len(steps) <= 2
    assert all(step.accepted for step in steps)
    np.testing.assert_allclose(state.theta, fit.values, rtol=1e-6)

    result = identify(problem)
    assert result.converged
    np.testing.assert_allclose(result.values, fit.values, rtol=1e-6)
    np.testing.assert_allclose(result.estimates.covariance_white_noise, fit.covariance, rtol=1e-5)
    assert result.fit.noise_variance["y"] == pytest.approx(fit.variance, rel=1e-9)
