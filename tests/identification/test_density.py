"""The density that is sampled."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from fmuid.data import JointPrior, Parameter
from fmuid.data.noise import Noise
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.problem import LeastSquares
from fmuid.identification.sampler import log_density, sample_posterior
from tests.support.posteriors import Array, linear
from tests.support.results import identify_white as identify

# --- the density


def test_density_of_given_variances() -> None:
    """Differences of the log density are those of −J_C/2 (1.37)."""
    joint = JointPrior(["a", "b"], [1.8, 0.0], [[0.04, 0.01], [0.01, 0.09]])
    problem, phi = linear(noise=Noise(variance=0.5), joint_prior=joint)
    thetas = np.array([[2.0, -0.3], [1.0, 0.5], [2.5, -2.0]])
    away = thetas - joint.mean
    wanted = -0.5 * np.sum((problem.measured - thetas @ phi.T) ** 2, axis=1) / 0.5
    wanted -= 0.5 * np.einsum("mi,ij,mj->m", away, np.linalg.inv(joint.covariance), away)
    found = log_density(Evaluator(problem))(thetas)
    np.testing.assert_allclose(found - found[0], wanted - wanted[0], rtol=1e-10)


def test_density_of_estimated_variances() -> None:
    """One output's variance is given, the other's integrated out: against the integral itself."""
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 1.0, 9)
    measured = np.column_stack([2.0 * times, 1.0 - times]) + 0.2 * rng.normal(size=(9, 2))
    measured[4, 1] = np.nan
    problem = LeastSquares.from_function(
        lambda theta: np.column_stack([theta[0] * times, 1.0 - theta[1] * times]),
        measured,
        {"a": Parameter(1.0), "b": Parameter(2.0)},
        outputs=("y", "z"),
        noise=Noise(variance={"y": 0.04}),
    )

    def direct(a: float, b: float) -> float:
        square = float(np.nansum((measured[:, 1] - 1.0 + b * times) ** 2))

        def likelihood(log_variance: float) -> float:
            return math.exp(-4.0 * log_variance - square / 2.0 * math.exp(-log_variance))

        marginal, _ = quad(
            likelihood, -12.0, 12.0, epsabs=0.0, epsrel=1e-11, limit=500, points=[math.log(square / 8.0)]
        )
        return math.log(marginal) - 0.5 * float(np.sum((measured[:, 0] - a * times) ** 2)) / 0.04

    found = log_density(Evaluator(problem))(np.array([[2.0, 1.0], [1.9, 1.3], [2.2, 0.2]]))
    wanted = np.array([direct(2.0, 1.0), direct(1.9, 1.3), direct(2.2, 0.2)])
    np.testing.assert_allclose(found - found[0], wanted - wanted[0], rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_density_of_a_robust_loss() -> None:
    """−J_C/2 with scipy's formula of the loss, ρ(z) = 2 (√(1 + z) − 1), and the variance that is given."""
    problem, phi = linear(loss="soft_l1")
    thetas = np.array([[2.0, -0.3], [1.0, 0.5]])
    rho = 2.0 * (np.sqrt(1.0 + (problem.measured - thetas @ phi.T) ** 2 / 0.2) - 1.0)
    np.testing.assert_allclose(
        log_density(Evaluator(problem), np.array([0.2]))(thetas), -0.5 * rho.sum(axis=1), rtol=1e-12
    )
    result = identify(problem)
    posterior = sample_posterior(problem, result)
    # scaled to how the estimates scatter, of which a robust loss knows as little as of the colour of the noise
    bend = (
        result.fit.linearization.root @ result.fit.linearization.root.T
        if result.fit.linearization is not None
        else np.eye(2)
    )
    whole = log_density(Evaluator(problem), np.array([result.fit.variance["y"]]))
    away = posterior.chain[-1] - result.values
    freedom = 2.0 / float(np.sum(1.0 / result.estimates.variance_dof))
    wider = stats.t.ppf(0.975, result.estimates.variance_dof) / stats.t.ppf(0.975, freedom)
    scatter = result.covariance * np.outer(wider, wider)
    coloured, white = (np.einsum("mi,ij,mj->m", away, np.linalg.inv(each), away) for each in (scatter, bend))
    top = whole(result.values[None])[0]
    # twice the fall is quadratic near the optimum; two parameters
    square = 2.0 * coloured / white * (top - whole(posterior.chain[-1]))
    exact = top - 0.5 * (freedom + 2.0) * np.log1p(square / freedom)
    np.testing.assert_allclose(posterior.log_density[-1], exact, rtol=1e-8)
    assert posterior.converged


def test_density_outside_and_where_simulations_fail() -> None:
    def fragile(theta: Array) -> Array:
        if theta[0] < 0.0:
            raise ArithmeticError("negative")
        values: Array = theta[0] * np.arange(3.0)
        return values

    problem = LeastSquares.from_function(fragile, [0.0, 1.1, 2.0], {"a": Parameter(1.0, max=3.0)})
    found = log_density(Evaluator(problem))(np.array([[-0.5], [1.0], [3.0], [3.5]]))
    assert list(np.isfinite(found)) == [False, True, True, False]
    assert (found[[0, 3]] == -np.inf).all()
