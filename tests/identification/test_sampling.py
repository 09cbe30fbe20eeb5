"""Runs of the sampler: its density, batches, seeds, interruptions, refusals, diagnostics of chains."""

import math

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from fmuid import InputError, Noise, Normal, Parameter, sample_posterior
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import SamplerSettings
from fmuid.identification.posterior import effective_size, r_hat
from fmuid.identification.sampler import log_density
from tests.support.posteriors import Array, linear, sampled
from tests.support.results import identify_white as identify


@pytest.mark.slow
def test_a_single_parameter_that_fails_nearby() -> None:
    """Walkers start only where the model works, however narrow that is."""

    def fragile(theta: Array) -> Array:
        if abs(theta[0] - 1.0) > 0.05:
            raise ArithmeticError("unstable")
        values: Array = theta[0] * np.ones(4)
        return values

    problem = LeastSquares.from_function(fragile, [1.5, 0.4, 1.2, 0.9], {"a": Parameter(1.0)}, noise=Noise(1.0))
    posterior, _ = sampled(problem)
    assert posterior.converged
    assert np.abs(posterior.samples - 1.0).max() <= 0.05
    assert np.isfinite(posterior.log_density).all()


def test_interrupted_inside_a_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    """The sampler's library would print the point at which anything is raised, and a traceback."""
    phi, calls, last = linear()[1], [0], [10**9]

    def model(theta: Array) -> Array:
        calls[0] += 1
        if calls[0] == last[0]:
            raise KeyboardInterrupt
        return phi @ theta

    problem = LeastSquares.from_function(
        model, model(np.ones(2)), {"a": Parameter(1.0), "b": Parameter(1.0)}, noise=Noise(1.0)
    )
    result = identify(problem)
    last[0] = calls[0] + 500
    posterior = sample_posterior(problem, result)
    assert posterior.interrupted
    assert 1 < len(posterior.chain) < 100
    assert calls[0] <= last[0] + 1
    assert capsys.readouterr() == ("", "")


def test_tables() -> None:
    problem, _ = linear()
    posterior, _ = sampled(problem, seed=1, max_steps=100)
    again, other = (sampled(problem, max_steps=20, seed=seed)[0].chain for seed in (1, 2))
    np.testing.assert_array_equal(again, posterior.chain[:20])
    assert not np.array_equal(other, again)
    assert list(posterior.table.columns) == ["a", "b"]
    np.testing.assert_array_equal(posterior.table.to_numpy(), posterior.chain[posterior.burn :].reshape(-1, 2))
    summary = posterior.summary.set_index("parameter")
    assert summary.loc["a", "lower"] == posterior.intervals(0.95).to_numpy()[0, 0]
    inside = posterior.table["a"].between(*posterior.intervals(0.8).to_numpy()[0])
    assert inside.mean() == pytest.approx(0.8, abs=1e-3)
    assert summary.loc["b", "std"] == pytest.approx(posterior.table["b"].std())
    np.testing.assert_allclose(posterior.std, np.sqrt(np.diag(posterior.covariance)))


WRONG = (
    ({"walkers": 3}, "walkers.* 4 .*3"),
    ({"walkers": 9}, "walkers.*even.*9"),
    ({"effective_size": 1.5}, "effective_size.*1.5"),
    ({"burn_in": 1.0}, "burn_in.*1.0"),
)


def test_wrong_use() -> None:
    for settings, said in WRONG:
        with pytest.raises(InputError, match=said):
            SamplerSettings(**settings)
    problem, phi = linear()
    result = identify(problem)
    six = {name: Parameter(1.0, prior=Normal(0.0, 1.0)) for name in "abcdef"}
    wide = LeastSquares.from_function(lambda theta: phi @ theta[:2], problem.measured, six)
    with pytest.raises(InputError, match=r"walkers: 4 .*12"):
        sample_posterior(wide, identify(wide), SamplerSettings(walkers=4))
    with pytest.raises(InputError, match="parameters are a, b"):
        sample_posterior(wide, result)
    line = np.arange(4.0)
    exact = LeastSquares.from_function(lambda theta: theta[0] * line, 2.0 * line, {"a": Parameter(2.0)})
    with pytest.raises(InputError, match="fits an output exactly"):
        sample_posterior(exact, identify(exact))


@pytest.mark.parametrize("memory", [-0.4, 0.0, 0.6, 0.9])
def test_effective_size_of_autoregressions(memory: float) -> None:
    """Of an autoregression the mean's effective size is n (1 − φ)/(1 + φ)."""
    rng = np.random.default_rng(7)
    draws = np.empty((2000, 16))
    draws[0] = rng.normal(size=16)
    for k in range(1, 2000):
        draws[k] = memory * draws[k - 1] + math.sqrt(1.0 - memory**2) * rng.normal(size=16)
    bulk = draws.size * (1.0 - memory) / (1.0 + memory)
    found = effective_size(draws)
    if memory >= 0.6:  # the tails forget sooner than the bulk
        assert found == pytest.approx(bulk, rel=0.1)
    else:
        assert 0.85 * min(bulk, draws.size) < found < 1.1 * draws.size
    assert 1.0 <= r_hat(draws) < 1.02


def test_r_hat_sees_other_means_spreads_and_drifts() -> None:
    """Identical draws, and too few, have none."""
    rng = np.random.default_rng(7)
    draws = rng.normal(size=(500, 8))
    assert r_hat(draws) < 1.01
    assert r_hat(draws + np.linspace(0.0, 1.0, 8)) > 1.03
    assert r_hat(draws * np.linspace(0.5, 1.5, 8)) > 1.03
    assert r_hat(draws + np.linspace(0.0, 1.0, 500)[:, None]) > 1.03
    apart = np.concatenate([draws[:, :4], 30.0 + draws[:, 4:]], axis=1)  # two optima that no walker leaves
    assert r_hat(apart) > 1.5
    assert effective_size(apart) < 30
    for draws in (np.ones((100, 4)), np.zeros((3, 4))):
        assert math.isnan(r_hat(draws))
        assert math.isnan(effective_size(draws))


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

        peak = math.log(square / 8.0)
        marginal, _ = quad(likelihood, -12.0, 12.0, epsabs=0.0, epsrel=1e-11, limit=500, points=[peak])
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
    assert result.fit.linearization is not None
    bend = result.fit.linearization.root @ result.fit.linearization.root.T
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
