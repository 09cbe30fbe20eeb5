"""Profile likelihood: closed forms of linear problems, brute force elsewhere, and what has no end."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq, least_squares
from scipy.stats import f as f_distribution

from fmuid import InputError, Noise, Parameter, Result
from fmuid.estimation import ActiveBound, LeastSquares
from fmuid.identification import EndKind, Profile, profile_likelihood
from tests.support.problems import coil as faulty_coil
from tests.support.results import identify_white as identify

Array = npt.NDArray[np.float64]
TIMES = np.linspace(0.0, 4.0, 25)
LEVEL = 0.95


def linear(**words: Any) -> tuple[LeastSquares, Array]:
    """Return a problem of 30 samples linear in its three parameters, and its regressors."""
    rng = np.random.default_rng(5)
    phi = rng.normal(size=(30, 3)) + 1.0
    measured = phi @ [2.0, -0.3, 40.0] + 0.7 * rng.normal(size=30)
    priors = words.pop("priors", {})
    parameters = {name: Parameter(1.0, prior=priors.get(name)) for name in ("a", "b", "c")}
    return LeastSquares.from_function(lambda theta: phi @ theta, measured, parameters, **words), phi


def saturating(theta: Array) -> Array:
    """Return a rise to theta[0] at the rate theta[1]."""
    rise: Array = theta[0] * (1.0 - np.exp(-theta[1] * TIMES))
    return rise


def rise_problem(std: float = 0.3, rate: float = 0.8, searched: Parameter | None = None) -> LeastSquares:
    measured = saturating(np.array([5.0, rate])) + std * np.random.default_rng(2).normal(size=TIMES.size)
    return LeastSquares.from_function(saturating, measured, {"top": Parameter(3.0), "rate": searched or Parameter(1.0)})


def coil(least: float = -math.inf) -> tuple[LeastSquares, Result]:
    """Return the coil with its fault parameter (docs/method/coil.md): only R + dR and L + 2 tau dR act."""
    voltage = np.sign(np.sin(0.13 * np.arange(400)) + 0.1)
    measured = faulty_coil(np.array([4.0, 0.1, 1.0]), voltage)
    measured += 0.03 * np.random.default_rng(4).normal(size=voltage.size)
    parameters = {"R": Parameter(4.0, min=least), "L": Parameter(0.1, min=least), "dR": Parameter(0.0, nominal=1.0)}

    def current(theta: Array) -> Array:
        with np.errstate(over="ignore"):
            return faulty_coil(theta, voltage)

    problem = LeastSquares.from_function(current, measured, parameters)
    return problem, identify(problem)


def only(problem: LeastSquares, result: Result, name: str, **words: Any) -> Profile:
    (profile,) = profile_likelihood(problem, result, [name], **words)
    return profile


def ends(found: tuple[Profile, ...]) -> Array:
    return np.array([(profile.lower, profile.upper) for profile in found])


def test_linear_equals_student() -> None:
    """Against the textbook's interval, from the regressors alone, and against the result's own."""
    level, (problem, phi) = 0.999, linear()
    result = identify(problem)
    theta, square, *_ = np.linalg.lstsq(phi, problem.measured)
    quantile = math.sqrt(f_distribution.ppf(level, 1, 27))
    half = quantile * np.sqrt(square[0] / 27 * np.diag(np.linalg.inv(phi.T @ phi)))
    found = ends(profile_likelihood(problem, result, level=level))
    np.testing.assert_allclose(found, np.column_stack([theta - half, theta + half]), rtol=0, atol=1e-6 * half.max())
    np.testing.assert_allclose(found, result.intervals(level).to_numpy(), rtol=0, atol=1e-6 * half.max())


def brute(problem: LeastSquares, result: Result, index: int, value: float) -> float:
    """Return the least cost with one parameter held, by scipy from several starts."""
    sigma = math.sqrt(next(iter(result.fit.noise_variance.values())))
    others = [i for i in range(len(result.names)) if i != index]

    def residual(free: Array) -> Array:
        theta = np.array(result.values)
        theta[index], theta[others] = value, free
        return (problem.measured - saturating(theta)) / sigma

    starts = [np.array(result.values)[others] * factor for factor in (0.5, 1.0, 2.0)]
    return min(2.0 * float(least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).cost) for start in starts)


def test_nonlinear_against_brute_force() -> None:
    problem, index = rise_problem(std=0.5), 1
    result = identify(problem)
    profile = only(problem, result, "rate")
    least = brute(problem, result, index, result.values[index])
    quantile = f_distribution.ppf(LEVEL, 1, TIMES.size - 2)
    assert profile.threshold == pytest.approx(quantile)
    for end, far in ((profile.lower, 0.3), (profile.upper, 4.0)):
        wanted = brentq(
            lambda value: brute(problem, result, index, value) - least - quantile,
            result.values[index],
            far * result.values[index],
            xtol=1e-9,
        )
        assert end == pytest.approx(wanted, abs=1e-4 * result.std[index])
    for value, cost in zip(profile.values, profile.cost, strict=True):
        assert cost == pytest.approx(brute(problem, result, index, value), rel=1e-6)
    # and the profile is not simply the local interval again
    local = result.intervals().to_numpy()[index]
    assert abs(profile.upper - local[1]) > 0.02 * result.std[index]
    assert list(profile.table.columns) == ["top", "rate", "cost"]
    assert (np.diff(profile.values) > 0).all()
    sigma = math.sqrt(result.fit.noise_variance["y"])
    for row in profile.table.itertuples():
        residual = (problem.measured - saturating(np.array([row.top, row.rate]))) / sigma
        assert row.cost == pytest.approx(float(residual @ residual), rel=1e-12)
    assert profile.minimum == profile.cost.min()
    assert profile.values[0] <= profile.lower < profile.value < profile.upper <= profile.values[-1]


def test_ends_by_the_bounds_of_others() -> None:
    """dR can rise only until L is on its bound; then the data end it."""
    problem, result = coil(least=1e-3)
    profile = only(problem, result, "dR")
    assert profile.lower == -math.inf
    total = result["L"] + 0.0494 * result["dR"]
    assert profile.upper == pytest.approx((total - 1e-3) / 0.0494, rel=0.1)
    assert profile.remarks[-1].other == ActiveBound("L", 1e-3)


@pytest.mark.parametrize(
    ("edge", "within", "std", "rate"), [(0.84, 0.005, 0.5, 0.8), (0.8525, 0.005, 0.5, 0.8), (100.0, 20.0, 0.6, 20.0)]
)
def test_simulations_fail_before_the_level(edge: float, within: float, std: float, rate: float) -> None:
    """However the steps meet the edge, they end there, also where the profile is flat and each step is shorter."""

    def fragile(theta: Array) -> Array:
        if theta[1] > edge:
            raise ArithmeticError("too fast")
        return saturating(theta)

    parameters = {"top": Parameter(4.0), "rate": Parameter(0.7)}
    problem = LeastSquares.from_function(fragile, rise_problem(std, rate).measured, parameters)
    profile = only(problem, identify(problem), "rate")
    assert len(profile.table) < 40
    assert profile.upper == math.inf
    assert profile.remarks[-1].kind is EndKind.FAILING
    assert profile.values[-1] == pytest.approx(edge, abs=within)


def test_estimate_on_its_bound() -> None:
    free = identify(rise_problem())
    bound = float(free["rate"] + free.std[1])
    problem = rise_problem(searched=Parameter(2.0, min=bound))
    result = identify(problem)
    profile = only(problem, result, "rate")
    assert result["rate"] == profile.lower == bound
    least = brute(problem, result, 1, bound)
    assert brute(problem, result, 1, profile.upper) - least == pytest.approx(profile.threshold, rel=1e-3)


def test_better_optimum_is_said() -> None:
    """A frequency in the wrong lobe: the profile walks into the right one and gives no interval."""
    times = np.linspace(0.0, 10.0, 200)
    measured = np.sin(3.0 * times) + 0.3 * np.random.default_rng(1).normal(size=200)

    # so large a variance that the data do not keep the lobes apart
    start, noise = {"w": Parameter(3.95, min=2.0, max=5.0)}, Noise(40.0)
    problem = LeastSquares.from_function(lambda theta: np.sin(theta[0] * times), measured, start, noise=noise)
    result = identify(problem)
    assert abs(result["w"] - 3.0) > 0.3
    profile = only(problem, result, "w")
    assert math.isnan(profile.lower)
    assert math.isnan(profile.upper)
    assert any(each.kind is EndKind.LOWER for each in profile.remarks)
    better = profile.values[np.argmin(profile.cost)]
    assert identify(problem, start=[better])["w"] == pytest.approx(3.0, abs=0.02)


def test_wrong_use() -> None:
    problem, _ = linear()
    result = identify(problem)
    for other, names, level, said in (
        (problem, ["d"], 0.95, "'d'"),
        (problem, None, 95.0, "95"),
        (rise_problem(), None, 0.95, "parameters are a, b, c"),
    ):
        with pytest.raises(InputError, match=said):
            profile_likelihood(other, result, names, level=level)
