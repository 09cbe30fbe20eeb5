"""Robust losses: against scipy's, against outliers, and how often their intervals hold the truth."""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares, root

from fmuid import Marquardt, Noise, Normal, Parameter, Result, profile_likelihood
from fmuid.array_types import Floats
from fmuid.data import LOSSES, Loss, robust_variance
from fmuid.estimation import LeastSquares
from fmuid.identification import identify
from tests.support.quick import first

NORMAL_SHARE = 1.0 - math.sqrt(2.0 / (math.pi * math.e))
"""Mean of min(x², 1) over the standard normal distribution."""

ROBUST = ["soft_l1", "huber", "cauchy"]

TIMES = np.linspace(0.0, 3.0, 200)
TRUTH = np.array([3.0, 1.2, 0.5])
STD = 0.05
STARTS = {"a": Parameter(1.0), "k": Parameter(3.0), "c": Parameter(-1.0)}


def decay(theta: Floats) -> Floats:
    a, k, c = theta
    return np.asarray(a * np.exp(-k * TIMES) + c, dtype=np.float64)


def decay_jacobian(theta: Floats) -> Floats:
    a, k, _ = theta
    falling = np.exp(-k * TIMES)
    return np.column_stack([falling, -a * TIMES * falling, np.ones_like(TIMES)])


def clean(seed: int) -> Floats:
    return decay(TRUTH) + STD * np.random.default_rng(seed).standard_normal(TIMES.size)


def contaminated(seed: int, share: float = 0.05, *, lopsided: bool = False) -> Floats:
    """Return the same with gross errors in a share of the samples: 20 standard deviations, or 100 to one side."""
    rng = np.random.default_rng([seed, 1])
    gross = STD * rng.standard_normal(TIMES.size)
    return clean(seed) + np.where(
        rng.random(TIMES.size) < share, 100.0 * np.abs(gross) if lopsided else 20.0 * gross, 0
    )


def loss_of(name: str) -> Loss:
    loss = LOSSES[name]
    assert loss is not None
    return loss


def fit(y: Floats, loss: str, noise: float | None = STD**2, tolerance: float = 1e-6) -> Result:
    known = Noise() if noise is None else Noise(noise)
    return identify(
        LeastSquares.from_function(decay, y, STARTS, loss=loss, noise=known), Marquardt(tolerance=tolerance)
    )


# --- the losses -------------------------------------------------------------------------

DEFINITIONS: dict[str, Callable[[Floats], Floats]] = {
    "soft_l1": lambda z: np.asarray(2.0 * (np.sqrt(1.0 + z) - 1.0)),
    "huber": lambda z: np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0),
    "cauchy": lambda z: np.asarray(np.log1p(z)),
}


@pytest.mark.parametrize("name", ROBUST)
def test_losses_are_those_of_scipy(name: str) -> None:
    """ρ(f²) as its documentation gives it; ψ and ψ′ against differences of it; roots and their inverse."""
    loss, f, h = loss_of(name), np.linspace(-6.0, 6.0, 400), 1e-5

    def half(f: Floats) -> Floats:
        return 0.5 * DEFINITIONS[name](f**2)

    np.testing.assert_allclose(loss.root(f) ** 2, DEFINITIONS[name](f**2), rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(np.sign(loss.root(f)), np.sign(f))
    np.testing.assert_allclose(loss.influence(f), (half(f + h) - half(f - h)) / (2 * h), atol=1e-8)
    away = np.abs(np.abs(f) - 1.0) > 2 * h  # from the corner of huber
    bend = (loss.influence(f + h) - loss.influence(f - h)) / (2 * h)
    np.testing.assert_allclose(loss.curvature(f)[away], bend[away], atol=1e-8)
    np.testing.assert_allclose(loss.slope(f), (loss.root(f + h) - loss.root(f - h)) / (2 * h), atol=2e-5)
    f = np.concatenate([[0.0, 1e-100, 1e-12, 1.0], np.geomspace(1e-3, 1e8, 200)])
    np.testing.assert_allclose(loss.unroot(loss.root(-f)), -f, rtol=1e-9)
    assert loss.slope(np.zeros(1)).tolist() == [1.0]
    assert np.isfinite(loss.root(np.array([1e140]))).all()
    assert loss.root(np.array([1e200]))[0] > 5.0  # no warning; refused, or very large


# --- estimates against scipy ------------------------------------------------------------


@pytest.mark.parametrize(("name", "seed"), [("soft_l1", 1), ("huber", 2), ("cauchy", 3)])
def test_estimates_are_those_of_scipy(name: str, seed: int) -> None:
    y = contaminated(seed, lopsided=True)
    rows, jacobian = (lambda theta: (decay(theta) - y) / STD), (lambda theta: decay_jacobian(theta) / STD)
    reference = least_squares(rows, TRUTH, jacobian, loss=cast(Any, name), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    result = fit(y, name)
    assert result.converged
    assert (np.abs(result.values - reference.x) < 1e-3 * result.std).all()
    assert result.fit.cost == pytest.approx(2.0 * reference.cost, rel=1e-9)
    np.testing.assert_allclose(fit(y, name, tolerance=1e-8).values, reference.x, rtol=1e-6)


@pytest.mark.parametrize("name", ROBUST)
def test_priors_stay_squares(name: str) -> None:
    """The minimum of Σ ρ(f²) and the prior's plain square, which is not taken for an outlier."""
    y, prior = contaminated(4), Normal(1.0, 0.01)
    parameters = STARTS | {"k": Parameter(3.0, prior=prior)}
    problem = LeastSquares.from_function(decay, y, parameters, loss=name, noise=Noise(STD**2))

    def slope(theta: Floats) -> Floats:
        pull = np.array([0.0, (theta[1] - prior.mean) / prior.std**2, 0.0])
        return np.asarray(decay_jacobian(theta).T @ loss_of(name).influence((decay(theta) - y) / STD) / STD + pull)

    result = identify(problem, Marquardt(tolerance=1e-8))
    assert result.converged
    np.testing.assert_allclose(result.values, root(slope, result.values + 0.1 * result.std, tol=1e-13).x, rtol=1e-6)
    assert result.estimates.prior_z_score[1] > 1.5


# --- outliers ---------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "noise"), first(1, [("huber", STD**2), ("soft_l1", None), ("cauchy", None)]))
def test_outliers_hardly_move_estimates_and_noise(name: str, noise: float | None) -> None:
    """Five per cent gross errors to one side: plain least squares is thrown off by several standard deviations."""
    reference = fit(clean(7), "linear")
    y = contaminated(7, lopsided=True)
    plain, robust = fit(y, "linear", noise), fit(y, name, noise)
    assert (np.abs(plain.values - reference.values) / reference.std).max() > 8.0
    assert (np.abs(robust.values - reference.values) / reference.std).max() < 1.5
    assert robust.std.max() < 1.5 * reference.std.max()
    assert fit(contaminated(8), "linear", None).fit.noise_variance["y"] > 10.0 * STD**2
    assert fit(contaminated(8), name, None).fit.noise_variance["y"] == pytest.approx(STD**2, rel=0.4)
    assert fit(clean(8), name, None).fit.noise_variance["y"] == pytest.approx(STD**2, rel=0.25)


# --- the scale --------------------------------------------------------------------------


@pytest.mark.parametrize("count", [4, 50, 3001])
def test_robust_variance_is_proposal_2(count: int) -> None:
    """Against a root finder, with gross errors, and with ties; of normal noise the variance."""
    rng = np.random.default_rng(count)
    for residual in (rng.standard_normal(count), rng.standard_t(1, count), np.round(rng.standard_normal(count), 1)):
        free = count - 2.0

        def excess(variance: float, residual: Floats = residual, free: float = free) -> float:
            return float(np.minimum(residual**2 / variance, 1.0).sum() - free * NORMAL_SHARE)

        expected = brentq(excess, 1e-12, 1e12, xtol=1e-300, rtol=1e-14)
        assert robust_variance(residual, free) == pytest.approx(expected, rel=1e-9)
    x = np.linspace(-9.0, 9.0, 200_001)
    density = np.exp(-(x**2) / 2.0) / math.sqrt(2.0 * math.pi)
    assert pytest.approx(np.trapezoid(np.minimum(x**2, 1.0) * density, x), rel=1e-6) == NORMAL_SHARE
    assert robust_variance(np.zeros(5), 4.0) == 0.0
    assert robust_variance(np.array([0.0, 0.0, 0.0, 1.0, 2.0]), 5.0) == 0.0


# --- intervals --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "share", "draws"),
    [
        pytest.param("huber", 0.1, 40, marks=pytest.mark.slow),
        *(
            pytest.param(*case, 200, marks=pytest.mark.campaign)
            for case in (("soft_l1", 0.05), ("huber", 0.1), ("cauchy", 0.1), ("huber", 0.0))
        ),
    ],
)
def test_intervals_cover_as_often_as_they_say(name: str, share: float, draws: int) -> None:
    """95 % within 3.3 standard errors. Plain least squares covers too, with intervals several times as wide."""
    covered, wider = np.zeros(3), []
    for seed in range(draws):
        y = contaminated(seed, share)
        result = fit(y, name, None)
        assert result.converged
        interval = result.intervals()
        covered += (interval["lower"] < TRUTH) & (interval["upper"] > TRUTH)
        if share and seed < 20:
            wider.append(fit(y, "linear", None).std / result.std)
    assert (np.abs(covered / draws - 0.95) < 3.3 * math.sqrt(0.05 * 0.95 / draws)).all()
    assert share == 0.0 or (np.mean(wider, axis=0) > 2.0).all()


def test_covariance_of_a_linear_model() -> None:
    """σ² mean ψ²/(mean ψ′)² (XᵀX)⁻¹ of Huber (1981, section 7.6) where all samples share one noise."""
    phi = np.column_stack([np.ones(300), np.linspace(0.0, 1.0, 300)])
    y = phi @ [1.0, 2.0] + 0.1 * np.random.default_rng(12).standard_t(2, 300)
    parameters, words = {"a": Parameter(1.0), "b": Parameter(1.0)}, {"loss": "huber", "noise": Noise(0.01)}
    result = identify(LeastSquares.from_function(lambda theta: phi @ theta, y, parameters, **cast(Any, words)))
    f = (y - phi @ result.values) / 0.1
    inside = np.abs(f) <= 1.0
    power = np.sum(np.where(inside, f, np.sign(f)) ** 2) / 298.0
    expected = 0.01 * power / np.mean(inside) ** 2 * np.linalg.inv(phi.T @ phi)
    np.testing.assert_allclose(result.estimates.covariance_white_noise, expected, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBUST)
def test_profiles_agree_with_the_local_intervals(name: str) -> None:
    """As they do for plain squares, in the mean of some draws: the rise is measured by how the estimates scatter."""
    ratios = []
    for seed in range(12):
        problem = LeastSquares.from_function(decay, contaminated(seed, 0.1), STARTS, loss=name)
        result = identify(problem)
        (profile,) = profile_likelihood(problem, result, ["a"])
        lower, upper = result.intervals().to_numpy()[0]
        ratios.append((profile.upper - profile.lower) / (upper - lower))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.04)
    assert np.std(ratios) < 0.1
