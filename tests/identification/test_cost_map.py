"""Maps of the cost: against direct evaluation, and on linear problems against the exact confidence region."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmuid import InputError, Noise, Normal, Parameter, Result, map_cost
from fmuid.array_types import Floats
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import CostMap
from tests.support.results import changed
from tests.support.results import identify_white as identify

TIMES = np.linspace(0.0, 1.0, 40)
BASIS = np.stack([np.ones(40), TIMES, np.exp(-3.0 * TIMES)], axis=1)
TRUTH = np.array([1.0, 2.0, -1.5])
NAMES = ("a", "b", "c")


def linear(count: int = 3, *, noise: Noise | None = None, **words: Any) -> LeastSquares:
    """Return y = a + b t + c exp(−3t) with noise of variance 0.01, of which the first `count` terms are estimated."""
    basis, rest = BASIS[:, :count], BASIS[:, count:] @ TRUTH[count:]
    measured = BASIS @ TRUTH + 0.1 * np.random.default_rng(8).normal(size=40)
    parameters = {name: Parameter(1.0, **words) for name in NAMES[:count]}
    return LeastSquares.from_function(lambda theta: basis @ theta + rest, measured, parameters, noise=noise)


def chart_of(problem: LeastSquares, first: str = "a", second: str = "b", **words: Any) -> tuple[CostMap, Result]:
    result = identify(problem)
    return map_cost(problem, result, first, second, **words), result


def test_map_is_the_cost() -> None:
    """Each output with its own variance, a prior and a missing sample, point by point; the third at the estimate."""
    rng = np.random.default_rng(6)
    measured = np.stack([1.0 + TIMES, 3.0 - TIMES], axis=1) + rng.normal(size=(40, 2)) * [0.1, 0.5]
    measured[5:9, 0] = np.nan

    def simulate(theta: Floats) -> Floats:
        return np.stack([theta[0] + theta[1] * TIMES, theta[2] - theta[1] ** 2 * TIMES], axis=1)

    parameters = {"a": Parameter(0.8, prior=Normal(0.9, 0.03)), "b": Parameter(0.8), "c": Parameter(2.0)}
    noise = Noise({"x": 0.012})
    problem = LeastSquares.from_function(simulate, measured, parameters, outputs=("x", "y"), noise=noise)
    chart, result = chart_of(problem, points=7)
    assert (list(chart.table.columns), len(chart.table)) == (["a", "b", "cost"], 49)
    variance = np.array([0.012, result.fit.noise_variance["y"]])
    for a, b, value in chart.table.itertuples(index=False):
        squares = np.nansum((measured - simulate(np.array([a, b, result["c"]]))) ** 2, axis=0)
        assert value == pytest.approx(np.sum(squares / variance) + ((a - 0.9) / 0.03) ** 2, rel=1e-12)
    assert chart.held == {"c": result["c"]}
    first, second, values = chart.grid
    assert values[3, 3] == pytest.approx(chart.cost), "the estimate is in the middle"
    row = chart.table.iloc[2 * 7 + 5]
    assert (row["a"], row["b"], row["cost"]) == (first[2], second[5], values[2, 5])


def test_undetermined_parameters_reach_to_their_bounds() -> None:
    """Or, without bounds, as far as they are large; there is no ellipse."""
    problem = LeastSquares.from_function(
        lambda theta: theta[0] * theta[1] * TIMES,
        2.0 * TIMES + 0.1 * np.random.default_rng(2).normal(size=40),
        {"a": Parameter(1.0, min=0.5, max=4.0), "b": Parameter(1.0)},
    )
    chart, result = chart_of(problem, points=3)
    assert result.identifiability.non_identifiable
    np.testing.assert_allclose(chart.grid[0], [0.5, 2.25, 4.0])
    np.testing.assert_allclose(chart.grid[1], result["b"] * np.array([0.0, 1.0, 2.0]), atol=1e-12)
    assert chart.ellipse().shape == (0, 2)
    with pytest.raises(InputError, match="between 0 and 1"):
        chart.ellipse(95.0)


@pytest.mark.parametrize(
    ("names", "words", "match"),
    [
        (("a", "d"), {}, "'d' is not a parameter of the problem"),
        (("a", "a"), {}, "different parameters"),
        (("a", "b"), {"points": 1}, "whole number.*1"),
        (("a", "b"), {"ranges": {"b": (2.0, 1.0)}}, "range of 'b' .* 2 to 1"),
        (("a", "b"), {"ranges": {"a": (-10.0, 1.0)}}, "range of 'a' .* -10 to 1"),
        (("a", "b"), {"ranges": {"bb": (1.0, 2.0)}}, "'bb' is not a parameter"),
    ],
)
def test_wrong_wishes(names: tuple[str, str], words: Mapping[str, Any], match: str) -> None:
    problem = linear(2, min=-5.0)
    with pytest.raises(InputError, match=match):
        map_cost(problem, identify(problem), *names, **words)


def test_result_of_another_problem() -> None:
    other = identify(linear(2))
    for problem, result, match in (
        (linear(), other, "parameters are a, b,"),
        (linear(2), changed(other, noise_variance={"z": 1.0}), "outputs are z,"),
    ):
        with pytest.raises(InputError, match=match):
            map_cost(problem, result, "a", "b")


def squares(problem: LeastSquares, theta: Floats) -> float:
    return float(np.sum((problem.measured - Evaluator(problem).predict(theta[None])[0]) ** 2))


def test_ellipse_of_estimated_variance() -> None:
    """There the residual's sum of squares rises by the factor 1 + 2 F/(K − 2), F the quantile of F(2, K − 2)."""
    problem = linear(2)
    chart, result = chart_of(problem)
    expected = 1.0 + 2.0 / 38.0 * stats.f(2, 38).ppf(0.9)
    for point in chart.ellipse(0.9)[::20]:
        assert squares(problem, point) / squares(problem, result.values) == pytest.approx(expected, rel=1e-6)


def test_ellipse_among_more_parameters() -> None:
    """The others re-optimised, the cost rises by just the quantile; held, by more."""
    problem = linear(3, noise=Noise(0.01))
    chart, result = chart_of(problem)
    for a, b in chart.ellipse()[::10]:
        rest = problem.measured - BASIS[:, :2] @ [a, b]
        third = np.linalg.lstsq(BASIS[:, 2:], rest)[0]
        free = np.sum((rest - BASIS[:, 2:] @ third) ** 2) / 0.01 - chart.cost
        held = np.sum((rest - BASIS[:, 2] * result["c"]) ** 2) / 0.01 - chart.cost
        assert free == pytest.approx(stats.chi2(2).ppf(0.95), rel=1e-5)
        assert held > free
    np.testing.assert_allclose(chart.ellipse()[0], chart.ellipse()[-1])
