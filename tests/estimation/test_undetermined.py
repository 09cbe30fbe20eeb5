"""What a result says that data do not determine: directions, bounds, intervals."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.data import Parameter
from fmuid.estimation.covariance import ActiveBound, IdentifiabilityLevel
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.search.state import TerminationReason
from fmuid.identification import identify
from tests.support.problems import coil_problem
from tests.support.two_outputs import TIMES, two_output_problem


@pytest.mark.parametrize(
    "draws", [pytest.param(50, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.campaign)]
)
def test_intervals_cover_as_often_as_they_say(draws: int) -> None:
    """Of a nonlinear problem with 12 samples, where Student's t differs from the normal distribution."""
    times, inside = np.linspace(0.0, 2.0, 12), np.zeros(2)

    def decay(theta: Floats) -> Floats:
        return np.asarray(theta[0] * np.exp(-theta[1] * times))

    for seed in range(draws):
        y = decay(np.array([3.0, 1.0])) + 0.1 * np.random.default_rng(seed).standard_normal(12)
        result = identify(LeastSquares.from_function(decay, y, {"a": Parameter(2.0), "k": Parameter(1.5)}))
        assert result.converged
        interval = result.intervals()
        inside += (interval["lower"] < [3.0, 1.0]) & (interval["upper"] > [3.0, 1.0])
    assert (np.abs(inside / draws - 0.95) < 2.6 * math.sqrt(0.05 * 0.95 / draws)).all()


def test_indistinguishable_parameters_are_named() -> None:
    result = identify(coil_problem(prior=False))
    assert result.outcome is TerminationReason.UNDETERMINED
    (direction,) = result.identifiability.non_identifiable
    assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT, ("R", "L", "dR"))
    along = np.array(direction.coefficients) / direction.coefficients[2]
    assert along == pytest.approx([-1.0, -0.0494, 1.0], rel=0.01)
    assert np.isinf(result.std).all()
    assert result["R"] + result["dR"] == pytest.approx(5.0, abs=0.3)
    assert result["L"] + 0.0494 * result["dR"] == pytest.approx(0.1494, abs=0.01)
    written = as_json(result)
    assert written["parameters"]["R"]["std"] == "inf"
    json.dumps(written, allow_nan=False)


def test_prior_makes_them_identifiable() -> None:
    result = identify(coil_problem(prior=True))
    assert result.converged
    assert result.identifiability.non_identifiable == ()
    (direction,) = result.identifiability.prior_dominated
    assert direction.names == ("R", "L", "dR")
    assert result["dR"] == pytest.approx(1.0, abs=4 * result.std[2])
    assert result.std[2] < 0.3
    assert result.estimates.correlation.to_numpy()[0, 2] < -0.5


def test_two_alike_and_one_without_effect() -> None:
    """Two directions at once: a and b act as a sum, and c acts on nothing beyond the start."""
    y = 5.0 * TIMES + 0.01 * np.random.default_rng(1).standard_normal(100)

    def line(theta: Floats) -> Floats:
        return np.asarray((theta[0] + theta[1]) * TIMES + (theta[2] if theta[0] + theta[1] < 3.2 else 0.0))

    parameters = {"a": Parameter(1.0), "b": Parameter(2.0), "c": Parameter(1.0)}
    found = identify(LeastSquares.from_function(line, y, parameters)).identifiability.non_identifiable
    assert {(each.level, each.names) for each in found} == {
        (IdentifiabilityLevel.NOT, ("c",)),
        (IdentifiabilityLevel.NOT, ("a", "b")),
    }


def test_strong_correlations_are_listed() -> None:
    """A line whose abscissas lie far from zero: intercept and slope are correlated by −mean(t)/rms(t)."""
    t = np.linspace(10.0, 11.0, 40)
    y = 1.0 + 2.0 * t + 0.01 * np.random.default_rng(1).standard_normal(40)
    parameters = {"offset": Parameter(2.0), "slope": Parameter(1.0)}
    result = identify(LeastSquares.from_function(lambda theta: theta[0] + theta[1] * t, y, parameters))
    ((first, second, value),) = result.estimates.strong_correlations
    assert (first, second) == ("offset", "slope")
    assert value == pytest.approx(-np.mean(t) / np.sqrt(np.mean(t**2)), abs=1e-4)


def test_bounds_are_named_and_end_intervals() -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, min=0.0, max=1.2)}))
    assert result.converged
    assert result.estimates.at_bounds == (ActiveBound("k", 1.2),)
    assert result["k"] == 1.2
    # one-sided where the estimate stands on a bound
    lower, upper = result.intervals(0.9).to_numpy()[0].tolist()
    assert upper == 1.2
    assert lower == pytest.approx(1.2 - stats.t.ppf(0.9, result.estimates.variance_dof[0]) * result.std[0])
    free = identify(two_output_problem())
    lower, upper = free.intervals().to_numpy()[0].tolist()
    bound = 0.5 * (free["k"] + upper)
    held = identify(two_output_problem(parameters={"k": Parameter(1.0, min=0.0, max=bound)}))
    assert held.intervals().to_numpy()[0].tolist() == pytest.approx([lower, bound], rel=1e-5)
    assert not held.estimates.at_bounds


def test_few_samples_of_an_output_widen_what_depends_on_them_alone() -> None:
    """Three samples, of which one parameter takes one: Student's t of two degrees of freedom."""

    def both(theta: Floats) -> Floats:
        return np.column_stack([theta[0] * np.exp(-TIMES), np.full(100, theta[1])])

    y = both(np.array([1.0, 2.0])) + np.random.default_rng(4).standard_normal((100, 2)) * [0.1, 0.3]
    y[[*range(20), *range(21, 50), *range(51, 90), *range(91, 100)], 1] = np.nan
    parameters = {"a": Parameter(0.5), "c": Parameter(1.0)}
    result = identify(LeastSquares.from_function(both, y, parameters, outputs=("u", "i"), times=TIMES))
    assert result.estimates.variance_dof[1] == pytest.approx(2.0, rel=0.02)
    assert result.estimates.variance_dof[0] > 20.0
    assert result.std[1] == pytest.approx(np.nanstd(y[:, 1], ddof=1) / math.sqrt(3.0), rel=0.02)
