"""The sampled posterior: closed forms within the error that the effective size allows, and what cannot be sampled."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats
from scipy.integrate import quad

from experiments.interval_coverage import coverage
from fmuid.assessment.sampling.chains import effective_size, r_hat
from fmuid.assessment.sampling.posterior import Posterior, Sampling, SamplingDoubt
from fmuid.assessment.sampling.sampler import log_density, sample
from fmuid.data.noise import Noise
from fmuid.data.parameters import JointPrior, Normal, Parameter
from fmuid.data.predictors import FunctionPredictions, Table
from fmuid.errors import InputError
from fmuid.estimation.least_squares import LeastSquares
from fmuid.estimation.result import Result
from fmuid.progress import Event, SamplingStep
from fmuid.reports.figures import uncertainty as figures_uncertainty
from fmuid.reports.words.uncertainty import posterior_words
from tests.support.results import identify_white as identify

Array = npt.NDArray[np.float64]
# Sampling errors are normal: four of their standard deviations are passed once in 16,000 times.
ERRORS = 4.0


def linear(samples: int = 30, **words: Any) -> tuple[LeastSquares, Array]:
    """Return a problem linear in two parameters, and its regressors."""
    rng = np.random.default_rng(5)
    phi = rng.normal([1.0, 0.0], 1.0, (samples, 2))
    measured = phi @ [2.0, -0.3] + 0.7 * rng.normal(size=samples)
    parameters = words.pop("parameters", {"a": Parameter(1.0), "b": Parameter(1.0)})
    return LeastSquares.from_function(lambda theta: phi @ theta, measured, parameters, **words), phi


def sampled(problem: LeastSquares, **settings: Any) -> tuple[Posterior, Result]:
    result = identify(problem)
    return sample(problem, result, Sampling(**settings)), result


def assert_moments(posterior: Posterior, mean: Array, covariance: Array) -> None:
    """Compare with the exact moments: the error of a mean is std/√ESS, that of a normal's covariance likewise."""
    assert posterior.converged, posterior.doubt
    std, size = np.sqrt(np.diag(covariance)), posterior.effective_size.min()
    assert size >= 2000
    np.testing.assert_array_less(np.abs(posterior.mean - mean), ERRORS * std / math.sqrt(size))
    correlation = covariance / np.outer(std, std)
    allowed = ERRORS * np.sqrt((1.0 + correlation**2) / size)
    np.testing.assert_array_less(np.abs(posterior.covariance - covariance) / np.outer(std, std), allowed)


def quantile_error(probability: float, density: float, size: float) -> float:
    """Return the standard deviation of a sampled quantile where the density is known."""
    return math.sqrt(probability * (1.0 - probability) / size) / density


# --- the density


def test_density_of_given_variances() -> None:
    """Differences of the log density are those of −J_C/2 (1.37)."""
    joint = JointPrior(["a", "b"], [1.8, 0.0], [[0.04, 0.01], [0.01, 0.09]])
    problem, phi = linear(noise=Noise(variance=0.5), joint_prior=joint)
    thetas = np.array([[2.0, -0.3], [1.0, 0.5], [2.5, -2.0]])
    away = thetas - joint.mean
    wanted = -0.5 * np.sum((problem.measured - thetas @ phi.T) ** 2, axis=1) / 0.5
    wanted -= 0.5 * np.einsum("mi,ij,mj->m", away, np.linalg.inv(joint.covariance), away)
    found = log_density(problem)(thetas)
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

    found = log_density(problem)(np.array([[2.0, 1.0], [1.9, 1.3], [2.2, 0.2]]))
    wanted = np.array([direct(2.0, 1.0), direct(1.9, 1.3), direct(2.2, 0.2)])
    np.testing.assert_allclose(found - found[0], wanted - wanted[0], rtol=1e-8, atol=1e-8)


def test_density_of_a_robust_loss() -> None:
    """−J_C/2 with scipy's formula of the loss, ρ(z) = 2 (√(1 + z) − 1), and the variance that is given."""
    problem, phi = linear(loss="soft_l1")
    thetas = np.array([[2.0, -0.3], [1.0, 0.5]])
    rho = 2.0 * (np.sqrt(1.0 + (problem.measured - thetas @ phi.T) ** 2 / 0.2) - 1.0)
    np.testing.assert_allclose(log_density(problem, np.array([0.2]))(thetas), -0.5 * rho.sum(axis=1), rtol=1e-12)
    result = identify(problem)
    posterior = sample(problem, result)
    # scaled to how the estimates scatter, of which a robust loss knows as little as of the colour of the noise
    bend = result.local.root @ result.local.root.T if result.local is not None else np.eye(2)
    whole = log_density(problem, np.array([result.variance["y"]]))
    away = posterior.chain[-1] - result.values
    wider = stats.t.ppf(0.975, result.freedom) / stats.t.ppf(0.975, result.degrees_of_freedom)
    scatter = result.covariance * np.outer(wider, wider)
    coloured, white = (np.einsum("mi,ij,mj->m", away, np.linalg.inv(each), away) for each in (scatter, bend))
    top = whole(result.values[None])[0]
    exact = top + coloured / white * (whole(posterior.chain[-1]) - top)
    np.testing.assert_allclose(posterior.log_density[-1], exact, rtol=1e-8)
    assert posterior.converged


def test_density_outside_and_where_simulations_fail() -> None:
    def fragile(theta: Array) -> Array:
        if theta[0] < 0.0:
            raise ArithmeticError("negative")
        values: Array = theta[0] * np.arange(3.0)
        return values

    problem = LeastSquares.from_function(fragile, [0.0, 1.1, 2.0], {"a": Parameter(1.0, max=3.0)})
    found = log_density(problem)(np.array([[-0.5], [1.0], [3.0], [3.5]]))
    assert list(np.isfinite(found)) == [False, True, True, False]
    assert (found[[0, 3]] == -np.inf).all()


# --- closed forms


def test_linear_gaussian() -> None:
    """Given variance and a joint prior: normal, with the precision ΦᵀΦ/σ² + M₀⁻¹ (section 6)."""
    joint = JointPrior(["a", "b"], [1.8, 0.0], [[0.04, 0.01], [0.01, 0.09]])
    problem, phi = linear(noise=Noise(variance=0.5), joint_prior=joint)
    prior = np.linalg.inv(joint.covariance)
    covariance = np.linalg.inv(phi.T @ phi / 0.5 + prior)
    mean = covariance @ (phi.T @ problem.measured / 0.5 + prior @ joint.mean)
    posterior, _ = sampled(problem)
    assert_moments(posterior, mean, covariance)
    assert posterior.r_hat.max() < 1.01
    assert posterior_words(posterior).startswith("converged: at least ")


def test_linear_student() -> None:
    """Variance estimated from few samples: the intervals are Student's, clearly wider than normal ones."""
    problem, phi = linear(samples=7)
    posterior, result = sampled(problem, effective_size=8000)
    theta, square, *_ = np.linalg.lstsq(phi, problem.measured)
    std = np.sqrt(square[0] / 5 * np.diag(np.linalg.inv(phi.T @ phi)))
    student = stats.t(5)
    allowed = ERRORS * quantile_error(0.025, student.pdf(student.ppf(0.025)), posterior.effective_size.min())
    assert student.ppf(0.975) - stats.norm.ppf(0.975) > 2.0 * allowed  # or the test could not tell them apart
    for quantile, end in ((student.ppf(0.025), "lower"), (student.ppf(0.975), "upper")):
        found = (posterior.intervals()[end].to_numpy() - theta) / std
        np.testing.assert_allclose(found, [quantile] * 2, rtol=0, atol=allowed)
        local = (result.intervals()[end].to_numpy() - theta) / std
        np.testing.assert_allclose(found, local, rtol=0, atol=allowed)


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


def test_estimate_on_a_bound() -> None:
    """The mean lies beyond the bound, where half of all walkers would start: what remains is the tail."""
    measured = 3.0 + np.random.default_rng(1).normal(size=20)
    mean, std = float(measured.mean()), 1.0 / math.sqrt(20.0)
    bound = mean + std
    problem = LeastSquares.from_function(
        lambda theta: theta[0] * np.ones(20), measured, {"a": Parameter(5.0, min=bound)}, noise=Noise(1.0)
    )
    posterior, result = sampled(problem)
    assert result["a"] == bound
    exact = stats.truncnorm(1.0, np.inf, mean, std)
    assert posterior.converged
    distance = stats.kstest(posterior.samples[:, 0], exact.cdf).statistic
    assert distance < stats.kstwo.ppf(0.9999, round(posterior.effective_size.min()))


# --- what the data leave open


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
    posterior, _ = sampled(linear()[0], steps=10)
    one = replace(
        posterior,
        names=("x",),
        lower=np.array([lower]),
        upper=np.array([upper]),
        chain=samples.reshape(-1, 4, 1),
        burn=0,
    )
    found = one.intervals().to_numpy()[0].tolist()
    assert found == pytest.approx(expected, abs=0.03)
    for end, bound in zip(expected, (lower, upper), strict=True):
        assert (bound in found) == (end == bound)


def banana(bend: float) -> LeastSquares:
    """a ~ N(0, 1), b ~ N(bend a², 1)."""
    parameters = {"a": Parameter(0.0, nominal=1.0), "b": Parameter(0.0, nominal=1.0)}
    return LeastSquares.from_function(
        lambda theta: np.array([theta[0], theta[1] - bend * theta[0] ** 2]), [0.0, 0.0], parameters, noise=Noise(1.0)
    )


@pytest.mark.slow
def test_a_bent_posterior() -> None:
    """E b = 6, Var b = 1 + 2·36; differential evolution and local draws give some 350 independent samples."""
    problem = banana(6.0)
    found = sample(problem, identify(problem), Sampling(effective_size=500))
    assert found.converged
    assert found.effective_size.min() > 500.0
    error = 5.0 / math.sqrt(found.effective_size.min())
    assert found.mean[0] == pytest.approx(0.0, abs=error)
    assert found.covariance[0, 0] == pytest.approx(1.0, abs=math.sqrt(2.0) * error)
    assert found.mean[1] == pytest.approx(6.0, abs=error * math.sqrt(73.0))
    ends = found.intervals(0.9).loc["a"]
    np.testing.assert_allclose(ends, stats.norm.ppf([0.05, 0.95]), atol=0.25)


@pytest.mark.parametrize("prior", [None, Normal(2.0, 0.5)])
def test_two_optima(prior: Normal | None) -> None:
    """a² is measured: a and −a are as likely, unless something else tells them apart."""
    parameters = {"a": Parameter(1.5, min=-5.0, max=5.0, prior=prior)}
    problem = LeastSquares.from_function(
        lambda theta: np.full(10, theta[0] ** 2), np.full(10, 4.0), parameters, noise=Noise(0.25)
    )
    found = sample(problem, identify(problem), Sampling(effective_size=200))
    assert found.converged
    words = posterior_words(found)
    if prior is None:
        np.testing.assert_allclose(found.optima, [[2.0], [-2.0]], atol=0.01)
        assert np.mean(found.samples > 0.0) == pytest.approx(0.5, abs=0.15)
        assert "beside the estimate there are other optima of like probability: a = -2" in words
    else:
        assert len(found.optima) == 1
        assert (found.samples > 0.0).all()
        assert "other optima" not in words


def test_prior_decides_what_data_leave_open() -> None:
    problem = sum_only(Parameter(1.0, prior=Normal(1.0, 2.0)), Parameter(1.0))
    total = float(problem.measured.mean())
    posterior, _ = sampled(problem)
    covariance = np.array([[4.0, -4.0], [-4.0, 4.01]])
    assert_moments(posterior, np.array([1.0, total - 1.0]), covariance)


def test_bounds_alone_hold_what_data_leave_open() -> None:
    problem = sum_only(Parameter(1.0, min=0.0, max=2.0), Parameter(1.0, min=-100.0))
    posterior, result = sampled(problem)
    assert not np.isfinite(result.std).any()
    assert posterior.converged
    assert "a and b cannot be told apart" in posterior_words(posterior)
    assert "along this the samples show priors and bounds, not data" in posterior_words(posterior)
    distance = stats.kstest(posterior.samples[:, 0], stats.uniform(0.0, 2.0).cdf).statistic
    assert distance < stats.kstwo.ppf(0.9999, round(posterior.effective_size.min()))
    assert posterior.samples.sum(axis=1).std() == pytest.approx(0.1, rel=0.1)


def test_nothing_holds_what_data_leave_open() -> None:
    posterior, _ = sampled(sum_only(Parameter(1.0), Parameter(1.0)))
    assert (posterior.doubt, posterior.doubtful) == (SamplingDoubt.RUNAWAY, "a")
    assert posterior_words(posterior).startswith("nothing holds a, the samples run away: give a prior or bounds")


# --- the run


def test_ensembles_run_as_batches() -> None:
    """Half of the walkers, or all, are simulated at once, in the order of rows."""
    sizes: list[int] = []

    class Counting:
        def many(self, thetas: Any) -> FunctionPredictions:
            given = np.asarray(thetas, dtype=np.float64)
            sizes.append(len(given))
            return FunctionPredictions((given @ np.ones((2, 5)))[:, :, None], (None,) * len(given))

    rng = np.random.default_rng(0)
    table = Table("run", np.arange(5.0), ("y",), rng.normal(size=(5, 1)), np.ones((5, 1), dtype=np.bool_))
    priors = {name: Parameter(1.0, prior=Normal(0.0, 1.0)) for name in ("a", "b")}
    problem = LeastSquares([Counting()], [table], priors)
    result = identify(problem)
    sizes.clear()
    posterior = sample(problem, result, Sampling(walkers=20, steps=200))
    assert set(sizes[-len(posterior.chain) :]) <= {10, 20}
    assert posterior.simulations == sum(sizes)


def test_same_seed_same_samples() -> None:
    problem, _ = linear()
    first, second, other = (sampled(problem, steps=50, seed=seed)[0].chain for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


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


def test_too_few_steps_are_not_trusted() -> None:
    problem, _ = linear()
    posterior, _ = sampled(problem, steps=12)
    assert not posterior.converged
    assert "raise steps" in posterior_words(posterior)
    few, _ = sampled(problem, steps=900, effective_size=1_000_000)
    assert few.doubt is SamplingDoubt.TOO_FEW
    assert "independent ones instead of 1000000: raise steps to about" in posterior_words(few)


def test_interrupted_keeps_what_there_is() -> None:
    problem, _ = linear()
    seen: list[SamplingStep] = []

    def stop(step: Event) -> None:
        assert isinstance(step, SamplingStep)
        seen.append(step)
        if step.step == 40:
            raise KeyboardInterrupt

    posterior = sample(problem, identify(problem), progress=stop)
    assert len(posterior.chain) == 40
    assert posterior.interrupted
    assert posterior_words(posterior).startswith("interrupted after 40 steps; ")
    assert not posterior.converged
    assert posterior.samples.shape == (30 * 16, 2)
    assert seen[-1].acceptance > 0.2
    assert seen[-1].wanted == 2000


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
    posterior = sample(problem, result)
    assert posterior.interrupted
    assert 1 < len(posterior.chain) < 100
    assert calls[0] <= last[0] + 1
    assert capsys.readouterr() == ("", "")


def test_tables() -> None:
    problem, _ = linear()
    posterior, _ = sampled(problem)
    assert list(posterior.table.columns) == ["a", "b"]
    np.testing.assert_array_equal(posterior.table.to_numpy(), posterior.chain[posterior.burn :].reshape(-1, 2))
    summary = posterior.summary.set_index("parameter")
    assert summary.loc["a", "lower"] == posterior.intervals(0.95).to_numpy()[0, 0]
    inside = posterior.table["a"].between(*posterior.intervals(0.8).to_numpy()[0])
    assert inside.mean() == pytest.approx(0.8, abs=1e-3)
    assert summary.loc["b", "std"] == pytest.approx(posterior.table["b"].std())
    np.testing.assert_allclose(posterior.std, np.sqrt(np.diag(posterior.covariance)))


# --- bad input


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"walkers": 3}, "walkers of the sampler must be a whole number from 4 on, not 3"),
        ({"walkers": 9}, "walkers of the sampler must be even, not 9"),
        ({"steps": 0}, "steps of the sampler must be a whole number from 10 on, not 0"),
        ({"effective_size": 1.5}, "effective_size of the sampler must be a whole number from 1 on, not 1.5"),
        ({"burn": 1.0}, "burn of the sampler must be a share from 0 to below 1, not 1.0"),
        ({"seed": -1}, "seed of the sampler must be a whole number from 0 on, not -1"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Sampling(**settings)


def test_wrong_use() -> None:
    problem, phi = linear()
    result = identify(problem)
    six = {name: Parameter(1.0, prior=Normal(0.0, 1.0)) for name in "abcdef"}
    wide = LeastSquares.from_function(lambda theta: phi @ theta[:2], problem.measured, six)
    with pytest.raises(InputError, match="4 walkers are too few for 6 parameters; the sampler needs at least 12"):
        sample(wide, identify(wide), Sampling(walkers=4))
    with pytest.raises(InputError, match="the result is of another problem: its parameters are a, b"):
        sample(wide, result)
    with pytest.raises(InputError, match="level of an interval"):
        sampled(problem, steps=20)[0].intervals(1.0)
    exact = LeastSquares.from_function(
        lambda theta: theta[0] * np.arange(4.0), 2.0 * np.arange(4.0), {"a": Parameter(2.0)}
    )
    with pytest.raises(InputError, match="fits an output exactly"):
        sample(exact, identify(exact))


# --- diagnostics


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
    rng = np.random.default_rng(7)
    draws = rng.normal(size=(500, 8))
    assert r_hat(draws) < 1.01
    assert r_hat(draws + np.linspace(0.0, 1.0, 8)) > 1.03
    assert r_hat(draws * np.linspace(0.5, 1.5, 8)) > 1.03
    assert r_hat(draws + np.linspace(0.0, 1.0, 500)[:, None]) > 1.03
    apart = np.concatenate([draws[:, :4], 30.0 + draws[:, 4:]], axis=1)  # two optima that no walker leaves
    assert r_hat(apart) > 1.5
    assert effective_size(apart) < 30


def test_diagnostics_of_what_tells_nothing() -> None:
    for draws in (np.ones((100, 4)), np.zeros((3, 4))):
        assert math.isnan(r_hat(draws))
        assert math.isnan(effective_size(draws))


# --- figures and coverage


def test_corner() -> None:
    problem, _ = linear()
    posterior, result = sampled(problem)
    figure = figures_uncertainty.corner(posterior, result, {"a": "Ohm"}, truths={"a": 2.0})
    above, below, _ = figure.axes
    assert above.get_title("left").startswith("a = ")
    assert above.get_title("left").endswith(" Ohm")
    assert below.get_xlabel() == "a (Ohm)"
    assert below.get_ylabel() == "b"
    ellipses = [np.asarray(line.get_xydata()) for line in below.get_lines() if len(np.asarray(line.get_xdata())) == 181]
    precision = np.linalg.inv(result.covariance)
    for ellipse, share in zip(ellipses, (0.68, 0.95), strict=True):
        away = ellipse - result.values
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", away, precision, away), stats.chi2(2).ppf(share), rtol=1e-6)
        away = posterior.samples - result.values
        inside = np.einsum("ni,ij,nj->n", away, precision, away) < stats.chi2(2).ppf(share)
        assert inside.mean() == pytest.approx(share, abs=0.05)


def test_corner_of_a_line_and_of_one() -> None:
    """A pair that lies on a line is drawn as points; without a covariance there is no ellipse."""
    problem = sum_only(Parameter(1.0, min=0.0, max=20.0), Parameter(1.0, min=-100.0))
    posterior, result = sampled(problem)
    below = figures_uncertainty.corner(posterior, result).axes[1]
    (points,) = below.get_lines()
    assert np.asarray(points.get_xydata()).sum(axis=1).std() == pytest.approx(0.1, rel=0.1)
    (single,) = figures_uncertainty.corner(posterior, names=["b"]).axes
    assert single.get_title("left").startswith("b = ")


def test_traces() -> None:
    problem, _ = linear()
    posterior, _ = sampled(problem, steps=60)
    figure = figures_uncertainty.traces(posterior, {"a": "Ohm"})
    assert len(figure.axes) == 2
    path = np.asarray(figure.axes[1].get_lines()[3].get_ydata())
    np.testing.assert_array_equal(path, posterior.chain[:, 3, 1])
    assert figure.axes[0].get_ylabel() == "a (Ohm)"
    assert "R-hat" in figure.axes[0].get_title("right")


@pytest.mark.slow
def test_coverage_of_the_coil() -> None:
    """Of 12 draws a method that covers 95 % holds the truth at least 8 times but for one in 5,000 repetitions."""
    sampling = Sampling(effective_size=400, walkers=8)
    shares = coverage("coil", 12, sampling=sampling)
    assert list(shares.index) == ["R", "L"]
    assert list(shares.columns) == ["local", "profile", "posterior"]
    assert shares.to_numpy().min() >= 8 / 12
    # and it is the intervals that decide
    assert coverage("coil", 3, level=0.1, sampling=sampling).to_numpy().mean() < 0.6


def test_samples_as_arviz_takes_them() -> None:
    """A chain a walker, in the order of the steps, without the burn-in."""
    rng = np.random.default_rng(3)
    chain, density = rng.normal(size=(7, 4, 2)), rng.normal(size=(7, 4))
    one = np.ones(2)
    posterior = Posterior(
        None, "", False, 1, (), np.zeros((1, 2)), ("R", "L"), -one, one, chain, density, 2, one, one, one, 0.5, 28, 0.1
    )  # fmt: skip
    tree = posterior.to_arviz()
    assert dict(tree["posterior"].sizes) == {"chain": 4, "draw": 5}
    np.testing.assert_array_equal(tree["posterior"]["L"].sel(chain=3, draw=1), chain[3, 3, 1])
    np.testing.assert_array_equal(tree["sample_stats"]["lp"].sel(chain=3, draw=1), density[3, 3])


def test_samples_without_arviz(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "arviz_base", None)
    posterior, _ = sampled(linear()[0], steps=20, effective_size=1)
    with pytest.raises(InputError, match=r"pip install 'fmuid\[arviz\]'"):
        posterior.to_arviz()
