"""The sampled posterior: closed forms within the error that the effective size allows, and what cannot be sampled."""

import math
import sys

import numpy as np
import pytest
from scipy import stats

from experiments.interval_coverage import coverage
from fmuid import InputError, JointPrior, Noise, Normal, Parameter, sample_posterior
from fmuid.estimation import LeastSquares
from fmuid.identification import Posterior, SamplerSettings, SamplingWarning
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
