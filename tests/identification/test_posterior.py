"""Posterior: the sampler's ensemble and its convergence, against closed forms and known densities."""

import math
import sys

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from experiments.interval_coverage import coverage
from fmuid import InputError, JointPrior, Noise, Normal, Parameter, sample_posterior
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import Posterior, SamplerSettings, SamplingWarning
from fmuid.identification.posterior import effective_size, r_hat
from fmuid.identification.sampler import log_density
from tests.support.posteriors import Array, linear, sampled
from tests.support.results import identify_white as identify

# Sampling errors are normal: four of their standard deviations are passed once in 16,000 times.
ERRORS = 4.0


def test_linear_gaussian() -> None:
    """Given variance and a joint prior: normal, with the precision ΦᵀΦ/σ² + M₀⁻¹ (section 6)."""
    joint = JointPrior(["a", "b"], [1.8, 0.0], [[0.04, 0.01], [0.01, 0.09]])
    problem, phi = linear(noise=Noise(variance=0.5), joint_prior=joint)
    prior = np.linalg.inv(joint.covariance)
    covariance = np.linalg.inv(phi.T @ phi / 0.5 + prior)
    mean = covariance @ (phi.T @ problem.measured / 0.5 + prior @ joint.mean)
    posterior, _ = sampled(problem)
    assert posterior.converged, posterior.doubt
    std, size = np.sqrt(np.diag(covariance)), posterior.effective_size.min()
    assert size >= 2000
    np.testing.assert_array_less(np.abs(posterior.mean - mean), ERRORS * std / math.sqrt(size))
    unit = np.outer(std, std)
    allowed = ERRORS * np.sqrt((1.0 + (covariance / unit) ** 2) / size)
    np.testing.assert_array_less(np.abs(posterior.covariance - covariance) / unit, allowed)


@pytest.mark.slow
def test_bound_cuts_a_normal() -> None:
    """A bound half a standard deviation above the mean: a truncated normal."""
    phi = np.ones(20)
    measured = 3.0 + np.random.default_rng(1).normal(size=20)
    mean, std = float(measured.mean()), 1.0 / math.sqrt(20.0)
    problem = LeastSquares.from_function(
        lambda theta: theta[0] * phi, measured, {"a": Parameter(1.0, max=mean + 0.5 * std)}, noise=Noise(1.0)
    )
    posterior, _ = sampled(problem)
    exact = stats.truncnorm(-np.inf, 0.5, mean, std)
    size = posterior.effective_size.min()
    assert posterior.converged
    assert posterior.samples.max() <= mean + 0.5 * std
    assert posterior.mean[0] == pytest.approx(exact.mean(), abs=ERRORS * exact.std() / math.sqrt(size))
    assert abs(exact.mean() - mean) > 10.0 * exact.std() / math.sqrt(size)
    distance = stats.kstest(posterior.samples[:, 0], exact.cdf).statistic
    assert distance < stats.kstwo.ppf(0.9999, round(size))


def sum_only(a: Parameter, b: Parameter) -> LeastSquares:
    """Return a problem whose data determine a + b alone, with a standard deviation of 0.1."""
    measured = 3.0 + np.random.default_rng(2).normal(size=25) / 2.0
    return LeastSquares.from_function(
        lambda theta: (theta[0] + theta[1]) * np.ones(25), measured, {"a": a, "b": b}, noise=Noise(0.25)
    )


@pytest.mark.parametrize(
    ("distribution", "lower", "expected"),
    [
        (stats.expon(), 0.0, (0.0, -math.log(0.05))),  # densest at its bound
        (stats.norm(), -10.0, (-1.96, 1.96)),
        (stats.gamma(3.0), 0.0, (0.3035, 6.4012)),  # equal densities at both ends
        (stats.truncnorm(-3.0, 0.0), -3.0, (-1.9385, 0.0)),  # and at its upper bound
    ],
)
def test_intervals_of_highest_density(
    distribution: stats.rv_continuous, lower: float, expected: tuple[float, float]
) -> None:
    samples = np.random.default_rng(6).permutation(distribution.ppf((np.arange(20_000) + 0.5) / 20_000))
    upper = 0.0 if expected[1] == 0.0 else math.inf
    posterior = made_up(samples.reshape(-1, 4, 1), (lower,), (upper,))
    found = posterior.intervals().to_numpy()[0].tolist()
    assert found == pytest.approx(expected, abs=0.03)
    for end, bound in zip(expected, (lower, upper), strict=True):
        assert (bound in found) == (end == bound)


def made_up(chain: Array, lower: tuple[float, ...], upper: tuple[float, ...], burn: int = 0) -> Posterior:
    """Return a posterior with a chain (steps, walkers, N) that nothing has sampled."""
    names, optimum = tuple("RL"[: chain.shape[2]]), np.zeros((1, chain.shape[2]))
    bounds, density = (np.array(lower), np.array(upper)), chain.sum(axis=2)
    return Posterior("", False, 1, (), optimum, names, *bounds, chain, density, burn, 0.5, 28, 0.1)


@pytest.mark.slow
def test_a_bent_posterior() -> None:
    """a ~ N(0, 1), b ~ N(6 a², 1): E b = 6, Var b = 1 + 2·36."""
    parameters = {"a": Parameter(0.0, nominal=1.0), "b": Parameter(0.0, nominal=1.0)}
    problem = LeastSquares.from_function(
        lambda theta: np.array([theta[0], theta[1] - 6.0 * theta[0] ** 2]), [0.0, 0.0], parameters, noise=Noise(1.0)
    )
    found = sample_posterior(problem, identify(problem), SamplerSettings(effective_size=500))
    assert found.converged
    assert found.effective_size.min() > 500.0
    error = 5.0 / math.sqrt(found.effective_size.min())
    assert found.mean[0] == pytest.approx(0.0, abs=error)
    assert found.covariance[0, 0] == pytest.approx(1.0, abs=math.sqrt(2.0) * error)
    assert found.mean[1] == pytest.approx(6.0, abs=error * math.sqrt(73.0))
    ends = found.intervals(0.9).loc["a"]
    np.testing.assert_allclose(ends, stats.norm.ppf([0.05, 0.95]), atol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("prior", [None, Normal(2.0, 0.5)])
def test_two_optima(prior: Normal | None) -> None:
    """a² is measured: a and −a are as likely, unless something else tells them apart."""
    parameters = {"a": Parameter(1.5, min=-5.0, max=5.0, prior=prior)}
    problem = LeastSquares.from_function(
        lambda theta: np.full(10, theta[0] ** 2), np.full(10, 4.0), parameters, noise=Noise(0.25)
    )
    found = sample_posterior(problem, identify(problem), SamplerSettings(effective_size=200))
    assert found.converged
    if prior is None:
        np.testing.assert_allclose(found.optima, [[2.0], [-2.0]], atol=0.01)
        assert np.mean(found.samples > 0.0) == pytest.approx(0.5, abs=0.15)
    else:
        assert len(found.optima) == 1
        assert (found.samples > 0.0).all()


def test_nothing_holds_what_data_leave_open() -> None:
    posterior, _ = sampled(sum_only(Parameter(1.0), Parameter(1.0)))
    assert (posterior.doubt, posterior.doubtful) == (SamplingWarning.RUNAWAY, "a")
    assert posterior.intervals().to_numpy().tolist() == [[-math.inf, math.inf]] * 2


@pytest.mark.slow
def test_coverage_of_the_coil() -> None:
    """Of 12 draws a method that covers 95 % holds the truth at least 8 times but for one in 5,000 repetitions."""
    sampling = SamplerSettings(effective_size=400, walkers=8)
    shares = coverage("coil", 12, sampling=sampling)
    assert list(shares.index) == ["R", "L"]
    assert list(shares.columns) == ["local", "profile", "posterior"]
    assert shares.to_numpy().min() >= 8 / 12
    # and it is the intervals that decide
    assert coverage("coil", 3, level=0.1, sampling=sampling).to_numpy().mean() < 0.6


@pytest.mark.slow
def test_samples_as_arviz_takes_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chain a walker, in the order of the steps, without the burn-in."""
    posterior = made_up(np.random.default_rng(3).normal(size=(7, 4, 2)), (-1.0, -1.0), (1.0, 1.0), burn=2)
    tree = posterior.to_arviz()
    assert dict(tree["posterior"].sizes) == {"chain": 4, "draw": 5}
    np.testing.assert_array_equal(tree["posterior"]["L"].sel(chain=3, draw=1), posterior.chain[3, 3, 1])
    np.testing.assert_array_equal(tree["sample_stats"]["lp"].sel(chain=3, draw=1), posterior.log_density[3, 3])
    monkeypatch.setitem(sys.modules, "arviz_base", None)
    with pytest.raises(InputError, match="pip install"):
        posterior.to_arviz()


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
