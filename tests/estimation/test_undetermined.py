"""What a result says that data do not determine: directions, bounds, intervals."""

import json
import math
import re

import numpy as np
import pytest
from scipy import stats

from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.data import Parameter
from fmuid.estimation.covariance import ActiveBound, IdentifiabilityLevel
from fmuid.estimation.problem import LeastSquares
from fmuid.identification import identify
from tests.support.problems import coil_problem
from tests.support.said import direction_words, ending
from tests.support.two_outputs import TIMES, two_output_problem


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say() -> None:
    """200 draws of a nonlinear problem with 12 samples, where Student's t differs from the normal distribution."""
    times = np.linspace(0.0, 2.0, 12)

    def decay(theta: Floats) -> Floats:
        return np.asarray(theta[0] * np.exp(-theta[1] * times))

    inside = np.zeros(2)
    for seed in range(200):
        y = decay(np.array([3.0, 1.0])) + 0.1 * np.random.default_rng(seed).standard_normal(12)
        result = identify(LeastSquares.from_function(decay, y, {"a": Parameter(2.0), "k": Parameter(1.5)}))
        assert result.converged
        interval = result.intervals()
        inside += (interval["lower"] < [3.0, 1.0]) & (interval["upper"] > [3.0, 1.0])
    assert (inside >= 182).all()
    assert (inside <= 197).all()


def test_what_cannot_be_told_apart_is_named() -> None:
    result = identify(coil_problem(prior=False))
    assert not result.converged
    told = re.search(r"No output changes along dR \+1 %, R -(\S+) %, L -(\S+) %\.", ending(result))
    assert told is not None
    shares = [result["dR"] / result["R"], 0.0494 * result["dR"] / result["L"]]
    assert [float(share) for share in told.groups()] == pytest.approx(shares, rel=0.01)
    assert "R, L and dR are not identifiable; only R + dR and L + 0.0494 dR are." in ending(result)
    assert "add a prior" in ending(result)
    assert np.isinf(result.std).all()
    assert result["R"] + result["dR"] == pytest.approx(5.0, abs=0.3)
    assert result["L"] + 0.0494 * result["dR"] == pytest.approx(0.1494, abs=0.01)
    written = as_json(result)
    assert written["parameters"]["R"]["std"] == "inf"
    json.dumps(written, allow_nan=False)


def test_a_prior_tells_them_apart() -> None:
    result = identify(coil_problem(prior=True))
    assert result.converged
    assert result.identifiability.non_identifiable == ()
    assert len(result.identifiability.prior_dominated) == 1
    assert "only R + dR and L + 0.0494 dR are" in direction_words(result.identifiability.prior_dominated[0])
    assert result["dR"] == pytest.approx(1.0, abs=4 * result.std[2])
    assert result.std[2] < 0.3
    assert result.estimates.correlation.to_numpy()[0, 2] < -0.5


def test_two_alike_and_one_lost() -> None:
    """Two directions at once: a and b act as a sum, and c acts on nothing beyond the start."""
    parameters = {"a": Parameter(1.0), "b": Parameter(2.0), "c": Parameter(1.0)}
    result = identify(
        LeastSquares.from_function(
            lambda theta: (theta[0] + theta[1]) * TIMES + (theta[2] if theta[0] + theta[1] < 3.2 else 0.0),
            5.0 * TIMES + 0.01 * np.random.default_rng(1).standard_normal(100),
            parameters,
        )
    )
    assert all(each.level is IdentifiabilityLevel.NOT for each in result.identifiability.non_identifiable)
    assert {each.names for each in result.identifiability.non_identifiable} == {("c",), ("a", "b")}
    assert {direction_words(each).splitlines()[0] for each in result.identifiability.non_identifiable} == {
        "c is not identifiable: it has no effect on any output.",
        "a and b are not identifiable; only a + b is.",
    }


def test_a_hardly_determined_parameter_is_named() -> None:
    y = 2.0 * TIMES + 0.1 * np.random.default_rng(1).standard_normal(100)
    parameters = {"slope": Parameter(1.0), "bend": Parameter(1.0)}
    result = identify(
        LeastSquares.from_function(lambda theta: theta[0] * TIMES + 1e-4 * theta[1] * TIMES**2, y, parameters)
    )
    assert result.converged
    (direction,) = result.identifiability.weakly_identifiable
    assert (direction.level, direction.names) == (IdentifiabilityLevel.HARDLY, ("bend",))
    assert direction_words(direction).startswith("bend is weakly identifiable: σ is ")


def test_strong_correlations_are_listed() -> None:
    """A line whose abscissas lie far from zero: intercept and slope are correlated by −mean(t)/rms(t)."""
    t = np.linspace(10.0, 11.0, 40)
    y = 1.0 + 2.0 * t + 0.01 * np.random.default_rng(1).standard_normal(40)
    parameters = {"offset": Parameter(2.0), "slope": Parameter(1.0)}
    result = identify(LeastSquares.from_function(lambda theta: theta[0] + theta[1] * t, y, parameters))
    ((first, second, value),) = result.estimates.strong_correlations
    assert (first, second) == ("offset", "slope")
    assert value == pytest.approx(-np.mean(t) / np.sqrt(np.mean(t**2)), abs=1e-4)


def test_bounds_are_named() -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, min=0.0, max=1.2)}))
    assert result.converged
    assert result.estimates.at_bounds == (ActiveBound("k", 1.2),)
    assert "Widen the bound" in ending(result)
    assert result["k"] == 1.2
    # one-sided where the estimate stands on a bound
    lower, upper = result.intervals(0.9).to_numpy()[0].tolist()
    assert upper == 1.2
    assert lower == pytest.approx(1.2 - stats.t.ppf(0.9, result.estimates.variance_dof[0]) * result.std[0])


def test_intervals_end_at_bounds() -> None:
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
